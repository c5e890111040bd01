"""How the arm's motion begins and stops, call by call, on a controller that does nothing by itself."""

import math

import pytest

from drivers.arm.guidance import CYCLE_S
from drivers.arm.link import ArmRow, Seen
from drivers.arm.motion import MotionControl, MotionState
from drivers.arm.settings import ArmSettings
from drivers.core.messages import (
    Home,
    Lead,
    MoveAt,
    MovePose,
    MoveTo,
    Reached,
    Refused,
    Sent,
    Stalled,
    Standstill,
    Stop,
    Tare,
    Twist,
)

START = (0.4, 0.1, 0.3, 0.0, 3.0, 0.0)
REST = (0.0,) * 6
AT = MoveAt("arm", 0.02, 0.04, id=3)
TO = MoveTo("arm", 0.03, 0.01, id=3)
LEAD = Lead("arm", id=3)
STOP = Stop("arm", id=9)
ESTOP = "the emergency stop is pressed"


class Client:
    """Notes what it is asked; takes it while `takes`."""

    def __init__(self):
        self.calls, self.takes, self.is_busy, self.ill = [], True, False, ""

    def __getattr__(self, name):
        def asked(*details):
            self.calls.append((name, *details))
            return self.takes

        return asked

    def busy(self):
        return self.is_busy

    def recover(self):
        self.calls.append(("recover",))
        return self.ill


class Arm:
    """Time, the arm's latest row, and calls and statuses since last taken."""

    def __init__(self):
        self.now_s, self.fault, self.running, self.speed_m_s = 100.0, "", True, 0.0
        self.pose, self.still_since_s = START, 0.0
        self.statuses, self.client = [], Client()
        settings = ArmSettings(rate_hz=500.0, host="-", start_pose=START)
        self.motion = MotionControl(
            "arm", settings, self.client, lambda: self.now_s, self.statuses.append, self.seen
        )

    @property
    def seen(self):
        twist = (0.0, 0.0, -self.speed_m_s, 0.0, 0.0, 0.0)
        row = ArmRow(self.now_s, self.now_s, self.pose, twist, REST, self.fault, self.running)
        return Seen(row, self.still_since_s)

    @property
    def state(self):
        return self.motion.state

    def moves(self, speed_m_s=0.02):
        self.speed_m_s, self.still_since_s = speed_m_s, math.inf

    def stands(self):
        self.speed_m_s, self.still_since_s = 0.0, self.now_s

    def order(self, command):
        self.motion.order(command)
        return self.taken()

    def step(self, after_s=0.0):
        """A cycle, some time later; the program looks at the arm."""
        self.now_s += after_s
        self.motion.heartbeat()
        self.motion.step(self.seen)
        return self.taken()

    def taken(self):
        calls, statuses = self.client.calls[:], self.statuses[:]
        self.client.calls.clear()
        self.statuses.clear()
        return calls, statuses


def sent(arm, command):
    return Sent(arm.now_s, "arm", command)


def brought(state):
    """An arm in a state, with another motion waiting where it brakes or stops."""
    arm = Arm()
    if state is not MotionState.STANDING:
        travels = state in (MotionState.TRAVELLING, MotionState.STOPPING)
        arm.order(TO if travels else LEAD if state is MotionState.LED else AT)
        arm.moves()
        arm.step(0.01)
    if state in (MotionState.BRAKING, MotionState.STOPPING):
        arm.order(MoveTo("arm", 0.0, 0.01, id=4))
    if state is MotionState.HALTED:
        arm.fault = ESTOP
        arm.step()
        arm.fault = ""
    assert arm.state is state
    arm.now_s += 0.1
    return arm


BRAKE, END_MOVE, FEED = ("speed", REST, 3.0), ("end_move", 3.0), ("feed_watchdog",)


@pytest.mark.parametrize(
    ("state", "at_once", "while_it_moves", "at_rest"),
    [
        (MotionState.STANDING, [], [FEED], [FEED]),
        (MotionState.SPEEDING, [BRAKE], [BRAKE], [("end_speed",)]),
        (MotionState.BRAKING, [BRAKE], [BRAKE], [("end_speed",)]),
        (MotionState.TRAVELLING, [END_MOVE], [FEED], [FEED]),
        (MotionState.STOPPING, [], [FEED], [FEED]),
        (MotionState.LED, [("lead", False)], [FEED], [FEED]),
    ],
)
def test_a_stop_in_every_state_is_sent_kept_up_and_ends_in_a_standstill(
    state, at_once, while_it_moves, at_rest
):
    arm = brought(state)
    arm.moves()
    assert arm.order(STOP) == (at_once, [sent(arm, STOP)])
    assert arm.step(0.01) == (while_it_moves, [])
    arm.stands()
    assert arm.step(0.0195) == (while_it_moves, []), "not yet 20 ms"
    arm.pose = (0.4, 0.1, 0.29, 0.0, 3.0, 0.0)
    standstill = [Standstill(arm.now_s + 0.001, "arm", pytest.approx(0.01), command_id=9)]
    assert arm.step(0.001) == (at_rest, standstill)
    assert arm.state is MotionState.STANDING
    assert arm.step(0.01) == ([FEED], []), "nothing that waited is begun"


def test_an_arm_that_stood_before_the_stop_is_looked_at_for_20_ms_from_then_on():
    arm = Arm()
    arm.order(STOP)
    assert arm.step(0.0195) == ([FEED], [])
    assert [type(status) for status in arm.step(0.001)[1]] == [Standstill]


def test_a_halted_arm_answers_a_stop_once_it_stands():
    arm = brought(MotionState.HALTED)
    assert arm.order(STOP) == ([], [])
    assert arm.step(0.01) == ([], [])
    arm.stands()
    assert arm.step(0.021) == ([], [Standstill(arm.now_s, "arm", 0.0, command_id=9)])
    assert arm.step(0.01) == ([], [])
    assert arm.state is MotionState.HALTED


@pytest.mark.parametrize("state", [MotionState.TRAVELLING, MotionState.STOPPING])
def test_a_move_is_not_over_while_the_controller_is_busy_with_it(state):
    arm = brought(state)
    arm.order(STOP)
    arm.stands()
    arm.client.is_busy = True
    assert arm.step(0.1) == ([FEED], [])
    arm.client.is_busy = False
    assert [type(status) for status in arm.step(0.0)[1]] == [Standstill]


@pytest.mark.parametrize(
    ("state", "kept", "bound_s"),
    [(MotionState.SPEEDING, [BRAKE], 2.0 + 0.3 / 3.0), (MotionState.TRAVELLING, [FEED], 2.0)],
)
def test_an_arm_that_does_not_stop_in_time_is_stopped_from_outside(state, kept, bound_s):
    """Speed over deceleration, and two seconds."""
    arm = brought(state)
    arm.moves(0.3)
    arm.motion.step(arm.seen)
    arm.order(STOP)
    assert arm.step(bound_s - 0.001) == (kept, [])
    last = [] if state is MotionState.SPEEDING else kept
    assert arm.step(0.002) == ([*last, ("halt",)], [])


@pytest.mark.parametrize("state", [MotionState.BRAKING, MotionState.STOPPING, MotionState.LED])
def test_a_motion_that_waits_begins_when_the_last_has_come_to_rest(state):
    arm = brought(state)
    if state is MotionState.LED:
        assert arm.order(MoveTo("arm", 0.0, 0.01, id=4)) == ([("lead", False)], [])
    arm.stands()
    calls, statuses = arm.step(0.03)
    assert calls[-1][0] == "move" and calls[-1][2:] == (0.01, 0.5)
    assert statuses == [sent(arm, MoveTo("arm", 0.0, 0.01, id=4))]
    assert arm.state is MotionState.TRAVELLING


@pytest.mark.parametrize("state", [MotionState.BRAKING, MotionState.STOPPING])
def test_a_halt_refuses_what_waits_and_says_what_to_do(state):
    arm = brought(state)
    arm.fault = ESTOP
    assert arm.step()[1] == [
        Refused(arm.now_s, "arm", MoveTo("arm", 0.0, 0.01, id=4), ESTOP),
        Stalled(arm.now_s, "arm", f"{ESTOP}; look at the arm, then send it Home", command_id=3),
    ]
    assert arm.step(0.01) == ([], [])
    for command in (AT, Tare("arm", "arm.force")):
        reason = ESTOP if isinstance(command, Tare) else f"{ESTOP}; look at the arm, then send it Home"
        assert arm.order(command) == ([], [Refused(arm.now_s, "arm", command, reason)])
    home = Home("arm", id=5)
    arm.client.ill = "it stays pressed"
    assert arm.order(home) == ([("recover",)], [Refused(arm.now_s, "arm", home, "it stays pressed")])
    arm.client.ill = arm.fault = ""
    calls, statuses = arm.order(home)
    assert (calls[0], statuses) == (("recover",), [sent(arm, home)])
    arm.moves()
    arm.step(0.01)
    arm.stands()
    later = [status for _ in range(100) for status in arm.step(0.01)[1]]
    assert [type(status) for status in later] == [Reached], "what was refused is not begun after all"


def test_a_stop_under_way_is_answered_though_the_arm_halts():
    arm = brought(MotionState.SPEEDING)
    arm.order(STOP)
    arm.fault = ESTOP
    assert [type(status) for status in arm.step()[1]] == [Stalled]
    arm.stands()
    assert arm.step(0.021)[1] == [Standstill(arm.now_s, "arm", 0.0, command_id=9)]


def test_a_halted_arm_that_goes_on_is_stopped_from_outside_every_half_second():
    arm = brought(MotionState.HALTED)
    arm.moves()
    halts_s = [round(arm.now_s - 100.01, 2) for _ in range(150) if arm.step(0.01)[0] == [("halt",)]]
    assert halts_s == [pytest.approx(at_s, abs=0.011) for at_s in (0.5, 1.0, 1.5)]
    arm.running, arm.fault = False, "its program has ended"
    assert all(arm.step(0.1) == ([], []) for _ in range(20)), "its program has ended: it brakes by itself"


def test_a_controller_that_takes_nothing_for_a_tenth_of_a_second_is_halted():
    arm = brought(MotionState.STANDING)
    arm.step()
    arm.client.takes = False
    assert arm.step(0.0995) == ([FEED], [])
    why = "the controller takes no commands; look at the arm, then send it Home"
    assert arm.step(0.001) == ([FEED, ("halt",)], [Stalled(arm.now_s, "arm", why)])


def test_a_move_that_takes_too_long_is_stopped_and_stalls():
    """3 cm at 1 cm/s, the ramps of 0.5 m/s2, and two seconds."""
    arm = Arm()
    arm.order(TO)
    arm.moves()
    assert arm.step(3.0 + 2.0 * 0.01 / 0.5 + 2.0 - 0.001) == ([FEED], [])
    assert arm.step(0.002) == ([FEED, END_MOVE], [])
    arm.stands()
    assert arm.step(0.021)[1] == [Stalled(arm.now_s, "arm", "it takes too long to get there", command_id=3)]


def test_a_move_that_has_not_begun_after_50_ms_and_stands_elsewhere_is_a_stall():
    arm = Arm()
    arm.order(TO)
    assert arm.step(0.0495) == ([FEED], [])
    reason = "it stands 30.0 mm and 0.000 rad from where it was sent"
    assert arm.step(0.001) == ([FEED], [Stalled(arm.now_s, "arm", reason, command_id=3)])


@pytest.mark.parametrize(
    ("command", "kept"), [(AT, [BRAKE]), (TO, [END_MOVE, FEED]), (LEAD, [("lead", False), FEED])]
)
def test_an_arm_unsupervised_for_half_a_second_stops(command, kept):
    arm = Arm()
    arm.order(command)
    arm.moves()
    arm.now_s += 0.5
    arm.motion.step(arm.seen)
    assert arm.state in (MotionState.SPEEDING, MotionState.TRAVELLING, MotionState.LED)
    arm.taken()
    arm.now_s += 0.01
    arm.motion.step(arm.seen)
    assert arm.taken()[0][: len(kept)] == kept
    arm.stands()
    arm.now_s += 0.021
    arm.motion.step(arm.seen)
    reason = "the program has not looked at it for 0.51 s; what held its loop up?"
    assert arm.taken()[1] == [Stalled(arm.now_s, "arm", reason, command_id=3)]


def beside(x_m=0.0, down_m=0.0):
    x, y, z, *turn = START
    return (x + x_m, y, z - down_m, *turn)


ASIDE = Twist("arm", (0.01, 0.0, 0.0, 0.0, 0.0, 0.0), 1.0, id=3)
BEGINNINGS = [
    (AT, ("speed", (0.0, 0.0, -0.02, 0.0, 0.0, 0.0), 0.5)),
    (ASIDE, ("speed", (0.01 * CYCLE_S * 0.5 / 0.01, 0.0, 0.0, 0.0, 0.0, 0.0), 0.5)),
    (TO, ("move", beside(down_m=0.03), 0.01, 0.5)),
    (MovePose("arm", (0.02, 0.0, 0.0, 0.0, 0.0, 0.0), 0.01, id=3), ("move", beside(0.02), 0.01, 0.5)),
    (Home("arm", id=3), ("move", START, 0.02, 0.5)),
    (Tare("arm", "arm.force", id=3), ("tare",)),
    (LEAD, ("lead", True)),
]


@pytest.mark.parametrize(("command", "call"), BEGINNINGS)
def test_a_command_is_sent_to_the_controller_and_reported(command, call):
    arm = Arm()
    ((name, *details),), statuses = arm.order(command)
    assert name == call[0]
    assert details == [pytest.approx(each, abs=1e-12) for each in call[1:]]
    assert statuses == [sent(arm, command)]


@pytest.mark.parametrize(("command", "call"), BEGINNINGS)
def test_a_command_that_the_controller_does_not_take_is_refused(command, call):
    arm = Arm()
    arm.client.takes = False
    calls, statuses = arm.order(command)
    assert [called[0] for called in calls] == [call[0]] * (2 if call[0] == "speed" else 1)
    reason = (
        "a program cannot let it be led by hand" if command is LEAD else "the controller does not take it"
    )
    assert statuses == [Refused(arm.now_s, "arm", command, reason)]


@pytest.mark.parametrize(
    ("command", "end", "after_s"),
    [(AT, beside(down_m=0.04), 0.0), (TO, beside(down_m=0.03), 0.1), (ASIDE, beside(0.01), 1.03)],
)
def test_a_motion_that_has_come_to_its_end_is_reported_under_its_number(command, end, after_s):
    arm = Arm()
    arm.order(command)
    arm.moves()
    arm.step(after_s)
    arm.pose = end
    arm.step()
    arm.stands()
    place_m = pytest.approx(START[2] - end[2], abs=1e-9)
    assert arm.step(0.021)[1] == [Reached(arm.now_s, "arm", place_m, command_id=3)]
    assert arm.state is MotionState.STANDING


def test_a_twist_is_brought_up_kept_and_ends_at_the_leash():
    arm = Arm()
    arm.order(ASIDE)
    arm.moves()
    assert arm.step(0.5)[0] == [("speed", ASIDE.twist, 0.5)]
    slower = Twist("arm", (0.005, 0.0, 0.0, 0.0, 0.0, 0.0), 1.0, id=4)
    ((_, twist, _),), _ = arm.order(slower)
    assert 0.005 < twist[0] < 0.01, "from the last twist that was sent"
    arm.pose = beside(0.2)
    x_twist = (0.02, 0.0, 0.0, 0.0, 0.0, 0.0)
    row = arm.seen.row._replace(twist=x_twist)
    arm.motion.step(Seen(row, math.inf))
    assert arm.taken()[0] == [BRAKE]
    arm.stands()
    reason = "it is at the end of its leash of 0.2 m"
    assert arm.step(0.021)[1] == [Stalled(arm.now_s, "arm", reason, command_id=4)]


def test_an_arm_that_moves_is_not_tared_and_one_beyond_its_leash_not_sent_home():
    arm = brought(MotionState.SPEEDING)
    tare = Tare("arm", "arm.force")
    assert arm.order(tare) == ([], [Refused(arm.now_s, "arm", tare, "the arm is not standing still")])
    arm = Arm()
    arm.pose = beside(0.3)
    arm.step()
    home, reason = Home("arm"), "the tool is 0.300 m from start_pose, its leash is 0.2 m"
    assert arm.order(home) == ([], [Refused(arm.now_s, "arm", home, reason)])


def test_a_command_that_a_stop_has_overtaken_is_refused():
    arm = Arm()
    arm.motion.refuse_overtaken(AT)
    assert arm.taken() == ([], [Refused(arm.now_s, "arm", AT, "a stop came before it was begun")])


def test_what_waits_is_refused_without_supervision():
    arm = brought(MotionState.BRAKING)
    arm.moves()
    arm.motion.heartbeat()
    arm.now_s += 0.51
    arm.motion.step(arm.seen)
    reason = "the program has not looked at it for 0.51 s; what held its loop up?"
    assert arm.taken()[1] == [Refused(arm.now_s, "arm", MoveTo("arm", 0.0, 0.01, id=4), reason)]
    arm.stands()
    assert arm.step(0.021) == ([("end_speed",)], [])


def test_the_last_of_several_waiting_motions_is_made_and_each_stop_is_sent():
    arm = brought(MotionState.BRAKING)
    last = MoveTo("arm", 0.02, 0.01, id=6)
    for command in (MoveTo("arm", 0.01, 0.01, id=5), last):
        assert arm.order(command) == ([], [])
    arm.stands()
    calls, statuses = arm.step(0.03)
    assert [name for name, *_ in calls] == ["end_speed", "move"] and statuses == [sent(arm, last)]
    again = Stop("arm", id=10)
    assert [arm.order(stop)[1] for stop in (STOP, again)] == [[sent(arm, STOP)], [sent(arm, again)]]
    assert arm.step(0.03)[1] == [Standstill(arm.now_s, "arm", 0.0, command_id=10)]


def test_a_newer_approach_takes_over_without_a_stop():
    arm = brought(MotionState.SPEEDING)
    slower = MoveAt("arm", -0.01, -0.04, id=4)
    assert arm.order(slower) == ([("speed", (0.0, 0.0, 0.01, 0.0, 0.0, 0.0), 0.5)], [sent(arm, slower)])

"""The arm's process listens: what it makes of rows, and what ends it. In virtual time, without a client."""

import math
import socket

import pytest

from drivers.arm.guidance import CYCLE_S
from drivers.arm.link import CALLS_S, ArmRow, LinkError
from drivers.arm.motion import MotionControl
from drivers.arm.pipe import Pipe
from drivers.arm.process import BACKLOG, LEAVE_S
from drivers.core.errors import PortError, SilentError
from drivers.core.messages import Home, MoveAt, Sent, Standstill, Stop
from tests.unit.drivers.arm.arm_process_bench import BEGIN_S, GONE, REST, SETTINGS, Arm, Deaf, EndError

MOVING = (0.0, 0.0, -0.01, 0.0, 0.0, 0.0)
CABLE = "is the cable in, and the controller up?"


@pytest.fixture
def arm(monkeypatch):
    made = Arm(monkeypatch)
    yield made
    made.close()


def test_it_stands_from_the_first_row_on_that_shows_it(arm):
    def stands_since(twist):
        arm.clock.rest(0.01)
        arm.sees(arrival_s=arm.clock.monotonic_s(), twist=twist)
        return arm.process._seen.still_since_s

    assert stands_since(REST) == BEGIN_S
    assert stands_since(MOVING) == math.inf
    at_s = stands_since(REST)
    assert at_s == arm.clock.monotonic_s()
    assert stands_since(REST) == at_s


def test_rows_go_up_as_they_come_and_a_controller_whose_time_stands_is_lost(arm):
    def cycle():
        if arm.clock.monotonic_s() < BEGIN_S + 0.02:
            arm.link.device_s = 7.0 + 0.002 * math.floor((arm.clock.monotonic_s() - BEGIN_S) / 0.002 + 1e-6)

    *rows, broken = arm.listens(cycle)
    assert [row.device_s for row in rows] == pytest.approx(
        [7.0 + 0.002 * number for number in range(len(rows))]
    )
    assert len(rows) in (10, 11)
    silent_s = arm.clock.monotonic_s() - rows[-1].arrival_s
    assert 0.1 < silent_s < 0.102
    assert broken.args == (SilentError, "the controller's time has stood still for 0.10 s", CABLE)
    assert arm.clock.held_s == pytest.approx([row.arrival_s + 0.00225 for row in rows])
    assert arm.clock.left == 1


def test_a_link_that_is_gone_ends_the_process_at_once(arm):
    row, broken = arm.listens(lambda: setattr(arm.link, "gone", True))
    assert isinstance(row, ArmRow)
    assert broken.args == GONE.args
    assert arm.clock.monotonic_s() - BEGIN_S < 0.002


def rows_come(arm):
    def cycle():
        if arm.clock.monotonic_s() - arm.process._seen.row.arrival_s > 0.002:
            arm.link.device_s += 0.002

    return cycle


@pytest.mark.parametrize("patience_s", [1.0, 5.0])
def test_a_client_that_is_blocked_ends_the_process(arm, patience_s):
    """A second for a command, and `recover_s` more for a recovery."""
    arm.process._patience_s = patience_s
    *rows, broken = arm.listens(rows_come(arm))
    assert broken.args == (
        SilentError,
        "the client is blocked in a command",
        "restart the controller's program",
    )
    assert arm.clock.monotonic_s() - BEGIN_S == pytest.approx(patience_s, abs=0.004)
    assert len(rows) > 300 * patience_s


def test_a_program_that_is_suspended_for_longer_than_five_seconds_finds_every_status_and_the_latest_rows(arm):
    process, row = arm.process, arm.process._seen.row
    numbered = [row._replace(device_s=float(number)) for number in range(BACKLOG + 3000)]
    for one in numbered[:10]:
        process._send(one)
    statuses = [Sent(0.0, "arm", Stop("arm")), Standstill(0.0, "arm", 0.0)]
    for number, one in enumerate(numbered[10:]):
        if number in (1500, 2500):
            process._send(statuses[number == 2500])
        process._send(one)
    assert len(process._outbox) == BACKLOG
    found = []
    while (message := arm.messages()) or process._outbox:
        found += message
        with process._sending:
            while process._outbox and process._pipe.send(process._outbox[0]):
                process._outbox.popleft()
    kept = [message.device_s for message in found if isinstance(message, ArmRow)]
    assert [message for message in found if not isinstance(message, ArmRow)] == statuses
    assert kept == sorted(kept)
    assert kept[-(BACKLOG - 2) :] == [one.device_s for one in numbered[-(BACKLOG - 2) :]]


def test_the_last_message_waits_for_room_in_the_pipe_and_need_not_be_read(arm):
    waits_s = []
    arm.process._pipe.drain = waits_s.append
    error = LinkError(PortError, "no", "do")
    with pytest.raises(EndError, match="1"):
        arm.process.end(error)
    assert [message.args for message in arm.messages()] == [error.args]
    assert waits_s == [0.1]
    arm.ends[0].close()
    with pytest.raises(EndError, match="1"):
        arm.process.end(error)


class Ordered:
    """A motion control that notes its orders and how patient the listener was meanwhile."""

    def __init__(self, arm):
        self.arm, self.orders, self.passed, self.patience_s, self.took_s = arm, [], [], [], 0.0

    def order(self, command):
        self.orders.append(command)
        self.patience_s.append(self.arm.process._patience_s)
        self.arm.clock.rest(self.took_s)

    def refuse_overtaken(self, command):
        self.passed.append(command)


def test_commands_are_taken_in_order_with_patience_for_a_recovery(arm):
    home, move = Home("arm"), MoveAt("arm", 0.01, 0.02)
    for command in (home, move):
        arm.pipe.send(command)
    motion = Ordered(arm)
    motion.took_s = 0.5
    arm.process._take(motion)
    assert (motion.orders, motion.passed) == ([home, move], [])
    assert motion.patience_s == [5.0, 1.0]
    assert arm.process._patience_s == 1.0
    assert arm.process._heartbeat_s == arm.clock.monotonic_s()


def test_a_stop_overtakes_all_that_waits_and_nothing_that_comes_after_it(arm):
    home, first, last, stop = Home("arm"), MoveAt("arm", 0.01, 0.02), MoveAt("arm", 0.01, 0.03), Stop("arm")
    for command in (home, first, stop, last):
        arm.pipe.send(command)
    motion = Ordered(arm)
    arm.process._take(motion)
    assert (motion.orders, motion.passed) == ([stop, last], [home, first])


def test_a_stop_that_comes_during_a_command_overtakes_what_waited_behind_it(arm):
    home, move, stop = Home("arm"), MoveAt("arm", 0.01, 0.02), Stop("arm")
    arm.pipe.send(home)
    arm.pipe.send(move)
    motion = Ordered(arm)
    arm.clock.each = lambda: arm.pipe.send(stop) if len(motion.orders) == 1 else None
    motion.took_s = 0.1
    arm.process._take(motion)
    assert (motion.orders, motion.passed) == ([home, stop], [move])


@pytest.mark.parametrize("stops", [True, False])
def test_an_arm_whose_program_is_gone_is_stopped_seen_standing_and_its_program_ended(arm, stops):
    client = arm.link.client = Deaf()
    motion = MotionControl(
        "arm", SETTINGS, client, arm.clock.monotonic_s, arm.process._send, arm.process._seen
    )
    motion.order(MoveAt("arm", 0.01, 0.04))
    now_s = arm.clock.monotonic_s()
    arm.sees(twist=MOVING)
    motion.step(arm.process._seen)
    beats_s = []

    def each():
        beats_s.append(arm.clock.monotonic_s() - arm.process._heartbeat_s)
        if stops and arm.clock.monotonic_s() > now_s + 0.1:
            arm.sees(arrival_s=arm.clock.monotonic_s(), twist=REST)

    arm.clock.each = each
    arm.process._leave(motion)
    took_s = arm.clock.monotonic_s() - now_s
    assert took_s == pytest.approx(0.12 if stops else LEAVE_S, abs=2 * CYCLE_S)
    assert client.calls[-1] == "leave"
    assert max(beats_s) == pytest.approx(CYCLE_S), "the listener sees it alive"
    assert (
        arm.clock.held_s[0] == pytest.approx(now_s + CALLS_S)
        and min(b - a for a, b in zip(arm.clock.held_s, arm.clock.held_s[1:], strict=False)) > 0
    )
    statuses = [status for status in arm.messages() if isinstance(status, Sent | Standstill)]
    assert statuses[1].command == Stop("arm")
    assert any(isinstance(status, Standstill) for status in statuses) == stops


def test_a_controller_without_rows_ends_the_process_from_its_other_thread_too(arm):
    """Twice the time-out of the link: the listener speaks first."""
    arm.link.client = Deaf()
    arm.process._pipe.wait = arm.clock.rest
    with pytest.raises(LinkError, match="no rows come through") as caught:
        arm.process._obey()
    assert caught.value.args == (SilentError, "no rows come through", "is the program still listening?")
    assert arm.clock.monotonic_s() - BEGIN_S == pytest.approx(0.2, abs=2 * CYCLE_S)


class Wait:
    """A wait at the pipe takes virtual time; at one time a message arrives."""

    def __init__(self, arm, comes_s=math.inf, comes=lambda: None):
        self.arm, self.comes_s, self.comes, self.waits_s = arm, comes_s, comes, []

    def __call__(self, seconds):
        self.waits_s.append(seconds)
        assert len(self.waits_s) < 100, "it waits for ever"
        left_s = max(0.0, self.comes_s - self.arm.clock.monotonic_s())
        self.arm.clock.rest(min(seconds, left_s))
        if left_s > seconds:
            return False
        self.comes_s = math.inf
        self.comes()
        return True


@pytest.mark.parametrize(("comes_s", "waited_s"), [(math.inf, 0.008), (0.003, 0.003), (0.0, 0.0)])
def test_a_cycle_waits_for_the_program_until_it_is_due_and_bench_time_may_go_on(arm, comes_s, waited_s):
    wait = arm.process._pipe.wait = Wait(arm, BEGIN_S + comes_s)
    assert arm.process._await_command(BEGIN_S + 0.008) == (comes_s < math.inf)
    assert arm.clock.monotonic_s() == pytest.approx(BEGIN_S + waited_s)
    assert wait.waits_s == [pytest.approx(0.008)]
    assert arm.clock.held_s == [pytest.approx(BEGIN_S + 0.008 + CALLS_S)]


def test_a_cycle_that_is_due_or_late_waits_for_no_one(arm):
    wait = arm.process._pipe.wait = Wait(arm, BEGIN_S)
    assert not arm.process._await_command(BEGIN_S - 0.001)
    assert not arm.process._await_command(BEGIN_S)
    assert wait.waits_s == []


def test_what_comes_between_two_cycles_is_begun_before_the_next(arm):
    begun_s, ages_s = [], []
    arm.link.client = Deaf()
    arm.link.client.speed = lambda *_: begun_s.append(arm.clock.monotonic_s()) or True
    arm.process._pipe.wait = Wait(arm, BEGIN_S + 0.011, lambda: arm.pipe.send(MoveAt("arm", 0.01, 0.04)))
    arm.clock.each = lambda: ages_s.append(arm.clock.monotonic_s() - arm.process._heartbeat_s)
    with pytest.raises(LinkError):
        arm.process._obey()
    assert begun_s[:3] == [pytest.approx(BEGIN_S + after_s) for after_s in (0.011, 0.016, 0.024)]
    assert max(ages_s) <= CYCLE_S + 1e-9, "the listener sees it alive"


def test_an_end_that_was_reset_is_gone() -> None:
    """What the other end had not read when it was closed resets the connection."""
    ours, theirs = socket.socketpair(type=socket.SOCK_SEQPACKET)
    pipe = Pipe(ours)
    with ours, theirs:
        assert pipe.send("unread")
        theirs.close()
        with pytest.raises(EOFError):
            pipe.receive()

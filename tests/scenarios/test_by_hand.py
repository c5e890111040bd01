"""A bench by hand, on the mock bench in virtual time: the guard and the limits are those of a run."""

import io
import signal
from dataclasses import replace

import numpy as np
import pytest
from rich.console import Console as Terminal

from behaviors.events import Tick
from config.profile import load_profile
from config.verbs import by_hand as verbs
from controller import by_hand, hand_view, jogging
from drivers.core.axis import AxisLimits
from drivers.core.errors import SilentError
from drivers.core.messages import MOTION, Grip, Home, Lead, MoveAt, MoveTo, Reached, Release, Standstill, Stop
from simulator.devices.faults import Fault
from simulator.mocks.zaber_stage import MockZaberStage
from tests.refusals import check_refusal

SLOWLY = {"loop__rate_hz": "50.0"}
"""Where nothing is timed to a turn."""


class Hand:
    """A person who interrupts when the test says so."""

    def __init__(self):
        self.request = None

    def poll(self):
        return self.request

    def suspend(self):
        raise AssertionError("nobody asked for it")


@pytest.fixture
def session():
    """Opens a bench by hand, for one of its movers; closes all at the end."""
    opened = []

    def opener(name="mock/transient", mover="stage", faults=(), **sets):
        profile = load_profile(name, {key.replace("__", "."): value for key, value in sets.items()})
        profile = replace(profile, faults=tuple(Fault(**fault) for fault in faults))
        devices = verbs.needed(profile, mover)
        one = verbs.session_on(profile, devices, Hand())
        opened.append(one)
        return one.__enter__()

    yield opener
    for one in opened:
        one.__exit__()


def driven(mover, velocity_m_s=0.002, limit_m=0.01):
    """Home, then along the axis until it is stopped or there."""
    commands = [MoveAt(mover, velocity_m_s, limit_m), Home(mover)]

    def steer(event):
        begins = len(commands) == 2 or isinstance(event, Reached)
        if begins and not commands:
            return None
        return [commands.pop()] if begins else ()

    return steer


@pytest.mark.parametrize(
    ("name", "mover", "opened"),
    [
        ("mock/transient", "stage", {"stage", "board"}),
        ("mock/slip", "arm", {"arm"}),
        ("mock/grasp", "gripper", {"arm", "gripper"}),
        ("mock/pointer", "arm", {"arm", "board"}),
    ],
)
def test_a_mover_needs_itself_and_what_its_limits_are_watched_by(session, name, mover, opened):
    one = session(name, mover, **SLOWLY)
    assert one.infos.keys() == opened
    assert by_hand.home(one, mover, 60.0).outcome == "done"


def test_it_moves_as_far_as_it_was_sent_and_the_last_second_of_a_stream_is_kept_and_no_more(session):
    one = session()
    result = one.run(driven("stage"), "stage", streams=["board.load_cell", "stage.position"], deadline_s=60.0)
    assert (result.outcome, result.reason) == ("done", "")
    assert position_m(one, "stage") == pytest.approx(0.01, abs=1e-5)
    times_s = one.latest.times("board.load_cell")
    assert len(times_s) == len(one.latest.values("board.load_cell"))
    assert times_s[-1] - times_s[0] == pytest.approx(by_hand.WINDOW_S, abs=0.05)
    assert np.diff(times_s) == pytest.approx(1e-3)


@pytest.mark.parametrize(
    ("how", "outcome", "named"),
    [
        ({"limits__force_n": "0.002"}, "guard", ("board.load_cell", "limits.force_n")),
        ({"limits__speed_m_s": "0.001"}, "guard", ("limits.speed_m_s",)),
        ({"limits__travel_m": "0.008"}, "guard", ("0.01", "travel_m")),
        (
            {"faults": [{"device": "board", "kind": "silent", "at_s": 1.0}]},
            "fault",
            ("board", "silent", "cable"),
        ),
        ({"faults": [{"device": "stage", "kind": "stall", "at_s": 3.0}]}, "fault", ("stage", "stalled")),
    ],
)
def test_what_stops_a_trial_stops_a_hand(session, how, outcome, named):
    one = session(**SLOWLY, **how)
    result = one.run(driven("stage"), "stage", deadline_s=60.0)
    assert result.outcome == outcome
    check_refusal(result.reason, *named)
    assert not one.rig.devices["stage"].axis.moving(one.rig.clock.now())
    assert one.rig.devices["stage"].axis.position(one.rig.clock.now()) < 0.01


def test_an_interruption_stops_what_moves(session):
    one = session()
    sent, commands = [], [Home("stage")]
    stage = one.rig.devices["stage"]
    apply = stage.apply
    stage.apply = lambda command: (sent.append(command), apply(command))[1]

    def steer(event):
        one.operator.request = "abort" if event.t_s > 0.1 else None
        return [commands.pop()] if commands else ()

    assert one.run(steer, "stage").outcome == "interrupted"
    assert Stop("stage") in sent
    assert not stage.axis.moving(one.rig.clock.now())


def test_what_was_commanded_is_commanded_anew_after_a_pause(session):
    one = session()
    requests = ["resume", "pause"]
    one.operator.poll = lambda: requests.pop() if requests and one.rig.clock.now() > 1.0 else None

    def script():
        yield from by_hand.until(Home("stage"), Reached)
        yield from by_hand.until(MoveTo("stage", 0.01, 0.002), Reached)

    result = one.run(by_hand.scripted(script()), "stage", ["stage.position"], deadline_s=60.0)
    assert (result.outcome, requests) == ("done", [])
    assert position_m(one, "stage") == pytest.approx(0.01, abs=1e-5)


def test_ctrl_c_at_a_terminal_ends_a_way_home(verb, monkeypatch, at_terminal):
    apply = MockZaberStage.apply

    def applied(self, command):
        if isinstance(command, Home):
            signal.raise_signal(signal.SIGINT)
        return apply(self, command)

    monkeypatch.setattr(MockZaberStage, "apply", applied)
    code, out, err = verb("home", "mock/transient")
    assert (code, out) == (130, "stage: going home\n")
    assert err == "interrupted: the bench is still\n"


@pytest.mark.parametrize("pressed", [signal.SIGINT, signal.SIGTERM])
def test_a_stop_between_two_movers_keeps_the_second_from_going_home(verb, monkeypatch, at_terminal, pressed):
    leave = by_hand.HandSession.__exit__

    def left(self, *error):
        signal.raise_signal(pressed)
        leave(self, *error)

    monkeypatch.setattr(by_hand.HandSession, "__exit__", left)
    code, out, err = verb("home", "mock/grasp", "--set", "loop.rate_hz=50")
    assert (code, err.strip()) == (130, "interrupted")
    assert out.count("going home") == out.count("stands at home") == 1


def test_a_mover_that_was_not_seen_standing_is_named(session):
    one = session(faults=[{"device": "stage", "kind": "unplug", "at_s": 0.5}])
    result = one.run(driven("stage"), "stage", deadline_s=60.0)
    assert result.outcome == "fault"
    check_refusal(result.reason, "stage", "the link is gone", "NOT seen standing still")


def test_a_tare_takes_the_level_away(session):
    one = session("mock/slip", "arm")
    one.rig.devices["arm"]._zero -= 0.5
    result, (before, after) = by_hand.tare(one, "arm.force")
    assert result.outcome == "done"
    assert before == pytest.approx(0.0, abs=0.2)
    assert after == pytest.approx(0.0, abs=0.2)


@pytest.mark.parametrize("alone", ["stage", "board"])
def test_what_moves_nothing_needs_no_second_sensor_of_a_device_that_is_not_open(alone):
    pair = '{ streams = ["stage.position", "board.load_cell"], most = 1.0 }'
    profile = load_profile("mock/transient", {"loop.rate_hz": "50.0", "limits.agree.both": pair})
    with verbs.session_on(profile, [alone], Hand()) as one:
        if alone == "stage":
            limits = by_hand.unwatched(one.limits)
            assert one.run(lambda event: None, "stage", limits=limits).reason == "", "as `stop` stops it"
        else:
            assert by_hand.tare(one, "board.load_cell")[0].reason == ""


class Keyboard:
    """Keys at bench times, each held as a terminal repeats it."""

    def __init__(self, session, *held):
        self._session = session
        self._left = sorted((t_s, key) for key, times_s in held for t_s in times_s)

    def __call__(self):
        now_s = self._session.rig.clock.now()
        due = [key for t_s, key in self._left if t_s <= now_s]
        self._left = self._left[len(due) :]
        return due


def hold(key, since_s, until_s):
    """A key that is held: after its first it pauses, then it comes every 33 ms."""
    return key, [since_s, *np.arange(since_s + 0.4, until_s, 0.033)]


def jogged(session, mover, *held, **limits):
    """Jogs a mover; gives the result and its motions' commands as (bench time, command)."""
    own = by_hand.limits_of(session.limits, mover)
    settings = session.rig.devices[mover]._settings
    axis = settings if isinstance(settings, AxisLimits) else None
    motions, refused = jogging.motions(session, mover, own, axis)
    device, sent = session.rig.devices[mover], []
    apply = device.apply
    device.apply = lambda command: (
        isinstance(command, (*MOTION, Stop)) and sent.append((session.rig.clock.now(), command)),
        apply(command),
    )[1]
    jog = jogging.Jog(mover, motions, Keyboard(session, *held))
    streams = list(session.infos[mover].streams)
    return session.run(jog, mover, streams, limits=own, deadline_s=60.0), sent, refused


def position_m(session, mover):
    return session.latest.values(f"{mover}.position")[-1, 0]


def test_a_key_moves_while_it_is_held_and_no_longer(session):
    one = session()
    result, sent, _ = jogged(one, "stage", ("h", [0.1]), hold("f", 1.0, 3.0), ("q", [4.0]))
    assert result.outcome == "done"
    times_s, commands = zip(*sent[:5], strict=True)
    forward = MoveAt("stage", jogging.SLOW_M_S, 0.012)
    assert commands == (Home("stage"), forward, Stop("stage"), forward, Stop("stage"))
    last_key_s = hold("f", 1.0, 3.0)[1][-1]
    assert times_s[1:4] == pytest.approx((1.0, 1.0 + jogging.HOLD_S, 1.4), abs=0.011)
    assert times_s[4] == pytest.approx(last_key_s + jogging.HOLD_S, abs=0.011)
    moved_s = times_s[2] - times_s[1] + times_s[4] - times_s[3]
    assert position_m(one, "stage") == pytest.approx(jogging.SLOW_M_S * moved_s, abs=1e-4)
    assert by_hand.place(one, "stage").startswith(f"start_m = {round(position_m(one, 'stage'), 6)}")


@pytest.mark.parametrize("other", ["b", "F", " ", "x", "\x1b[A"])
def test_any_other_key_stops(session, other):
    one = session()
    _, sent, _ = jogged(one, "stage", ("h", [0.1]), hold("f", 1.0, 2.0), (other, [1.7]), ("q", [1.71]))
    assert (1.7, Stop("stage")) in [(pytest.approx(t_s, abs=0.006), command) for t_s, command in sent]
    assert not any(
        isinstance(command, MoveAt) and command.velocity_m_s != jogging.SLOW_M_S for _, command in sent
    )


def test_keys_that_a_terminal_held_up_move_nothing_later(session):
    one = session()
    _, sent, _ = jogged(one, "stage", ("h", [0.1]), ("f", [1.0] * 50), ("q", [3.0]))
    stopped_s = [t_s for t_s, command in sent if t_s > 1.0 and isinstance(command, Stop)]
    assert stopped_s[0] == pytest.approx(1.0 + jogging.HOLD_S, abs=0.011)
    assert sum(isinstance(command, MoveAt) for _, command in sent) == 1


def test_shift_is_faster_and_no_faster_than_the_limit(session):
    one = session(limits__speed_m_s="0.008", devices__stage__max_speed_m_s="0.02")
    _, sent, _ = jogged(one, "stage", ("h", [0.1]), hold("F", 1.0, 2.0), ("q", [2.5]))
    assert MoveAt("stage", 0.008, 0.012) in [command for _, command in sent]


def test_it_goes_no_farther_than_the_travel_and_back_again(session):
    one = session(limits__travel_m="0.004")
    held = ("h", [0.1]), hold("f", 1.0, 5.0), hold("b", 6.0, 7.5), ("q", [8.0])
    result, sent, _ = jogged(one, "stage", *held)
    assert result.outcome == "done"
    forth = [command for t_s, command in sent if 1.3 < t_s < 5.9]
    assert forth == [MoveAt("stage", jogging.SLOW_M_S, 0.004)], "what has come to its end is not sent again"
    reached = [event.position_m for event in result.events if isinstance(event, Reached)]
    assert reached[1] == pytest.approx(0.004, abs=1e-5)
    assert 0.0 < position_m(one, "stage") < 0.003


def test_a_stage_that_does_not_know_where_it_is_says_so(session):
    result, _, _ = jogged(session(), "stage", ("f", [1.0]), ("q", [2.0]))
    assert result.outcome == "fault"
    check_refusal(result.reason, "stage", "Home")


def test_an_arm_moves_along_the_axes_of_its_tool(session):
    one = session("mock/slip", "arm")
    before = one.rig.devices["arm"]._settings.start_pose
    jogged(one, "arm", hold("e", 1.0, 3.0), ("q", [4.0]))
    way_m = one.latest.values("arm.pose")[-1, :3] - before[:3]
    # the tool points down: its z is the base's −z
    assert way_m[2] < -0.002
    assert way_m[:2] == pytest.approx([0.0, 0.0], abs=1e-5)
    assert by_hand.place(one, "arm").startswith("start_pose = [")


def test_an_arm_without_a_reach_has_no_steps_and_says_why(session):
    one = session("mock/transient_arm", "arm")
    own = by_hand.limits_of(one.limits, "arm")
    keys, refused = jogging.motions(one, "arm", own)
    assert set("fFbBghH") == keys.keys()
    assert all("limits.reach_m" in line for line in refused)
    assert len(refused) == 6


def test_after_g_an_arm_may_be_led_until_the_next_key(session):
    one = session("mock/slip", "arm")
    motions, _ = jogging.motions(one, "arm", by_hand.limits_of(one.limits, "arm"))
    keys = []
    jog = jogging.Jog("arm", motions, lambda: [keys.pop()] if keys else [])

    def tick(t_s, *pressed):
        keys.extend(pressed)
        return list(jog(Tick(t_s)))

    assert tick(0.1, "g") == [Lead("arm")]
    assert tick(0.5, "g") == [], "the key is held"
    assert tick(20.0) == [], "both hands are at the arm"
    assert tick(21.0, "g") == [Stop("arm")]
    jog(Standstill(21.1, "arm", 0.0))
    assert tick(22.0, "g") == [Lead("arm")]
    assert tick(22.1, "f") == [Stop("arm")]


def test_a_simulated_arm_cannot_be_led_and_says_so(session):
    result, _, _ = jogged(session("mock/slip", "arm"), "arm", ("g", [1.0]), ("q", [2.0]))
    assert result.outcome == "fault"
    check_refusal(result.reason, "arm", "simulated", "by hand")


def test_a_gripper_opens_and_closes_gently(session):
    one = session("mock/grasp", "gripper", **SLOWLY)
    _, sent, _ = jogged(one, "gripper", hold("h", 0.1, 6.0), ("c", [8.0]), ("o", [9.0]), ("q", [10.0]))
    commands = [command for t_s, command in sent if 8.0 <= t_s < 10.0]
    closed_m = one.infos["gripper"].details["closed_width_m"]
    close = Grip("gripper", closed_m, jogging.SLOW_M_S, jogging.PRESS_N)
    assert commands == [close, Stop("gripper"), Release("gripper", jogging.SLOW_M_S), Stop("gripper")]


def test_jog_wants_a_terminal(verb):
    code, _, err = verb("jog", "mock/transient", "stage")
    assert code == 2
    check_refusal(err.strip(), "jog", "terminal")


def test_ctrl_c_while_an_arm_opens_whose_start_pose_is_not_known_ends_a_jog(verb, monkeypatch, at_terminal):
    enter = by_hand.HandSession.__enter__

    def opened(self):
        signal.raise_signal(signal.SIGINT)
        return enter(self)

    monkeypatch.setattr(by_hand.HandSession, "__enter__", opened)
    unset = "devices.arm.start_pose=? jog there"
    code, out, err = verb("jog", "mock/slip", "arm", "--set", unset)
    assert (code, out, err.strip()) == (130, "", "interrupted")


def test_where_the_start_pose_is_not_known_it_is_where_the_arm_stands():
    unset = {"devices.arm.start_pose": "? jog there"}
    profile = verbs.started_here(load_profile("mock/slip", unset), "arm", unset, None)
    assert profile.deferred == {}
    pose = profile.resolved["devices"]["arm"]["start_pose"]
    assert pose == pytest.approx(load_profile("mock/slip").resolved["devices"]["arm"]["start_pose"])


def test_a_monitor_leaves_out_what_has_no_port_yet(verb):
    code, out, err = verb(
        "monitor", "mock/transient", "--seconds", "0.2", "--set", "devices.stage.microstep_m=? m"
    )
    assert code == 0
    check_refusal(err.strip(), "stage is left out", "microstep_m")
    assert "stage." not in out
    assert "board.load_cell" in out


def test_a_monitor_shows_each_stream_with_its_rate_its_noise_and_its_margin(verb):
    code, out, err = verb(
        "monitor", "mock/transient", "board.load_cell", "stage.position", "--seconds", "1.05"
    )
    assert (code, err) == (0, "")
    rows = [line.split() for line in out.splitlines()[-2:]]
    name, value, unit, *limit, rate, hertz, _age, ms, noise, lost = rows[0]
    assert (name, unit, rate, hertz, ms, lost) == ("board.load_cell", "N", "1000", "Hz", "ms", "0")
    assert 0.0 < float(noise) < 0.001
    assert limit == [f"{float(value.replace('−', '-')):z.3f}", "of", "2", "N"]
    assert rows[1][0] == "stage.position"
    assert rows[1][2:7] == ["mm", "0.000", "of", "12", "mm"]


def test_a_monitor_opens_only_what_it_shows(verb, monkeypatch):
    opened = []
    session_on = verbs.session_on
    monkeypatch.setattr(
        verbs,
        "session_on",
        lambda loaded, devices, *more, **how: (
            opened.extend(devices),
            session_on(loaded, devices, *more, **how),
        )[1],
    )
    assert verb("monitor", "mock/slip", "signals.tip", "--seconds", "0.2")[0] == 0
    assert opened == ["board"]


def test_a_monitor_goes_on_without_a_device_that_is_switched_off(verb, monkeypatch):
    def off(stage):
        raise SilentError("stage", "opening", "no reply", "is it on?")

    monkeypatch.setattr("simulator.mocks.zaber_stage.MockZaberStage.open", off)
    code, out, err = verb("monitor", "mock/transient", "--seconds", "0.2")
    assert code == 0
    check_refusal(err.strip(), "stage", "no reply", "is it on?")
    assert "board.load_cell" in out
    assert "stage." not in out
    assert verb("monitor", "mock/transient", "stage.position")[0] == 3


def test_a_monitor_of_a_signal_that_cannot_use_its_stream_says_so_and_shows_the_cursor_again(
    verb, monkeypatch
):
    drawn = io.StringIO()
    screen = Terminal(file=drawn, force_terminal=True)
    monkeypatch.setattr("config.verbs.terminal", lambda: screen)
    code, _, err = verb("monitor", "mock/pretouch", "signals.right", "--set", "signals.right.channel=5")
    assert code == 2
    check_refusal(err.strip(), "audio.fingers", "4 channels", "signals.right needs 12")
    assert "unexpected" not in err
    assert drawn.getvalue().count("\x1b[?25l") == drawn.getvalue().count("\x1b[?25h") == 1


def test_a_monitor_shows_a_silent_stream_and_ends_with_a_device_that_failed(session, verb):
    one = session(faults=[{"device": "board", "kind": "silent", "at_s": 0.5}])
    for t_s, _ in one.listen(["board.load_cell"]):
        if t_s > 2.0:
            break
    row = hand_view.table(one, ["board.load_cell"], t_s)[1]
    assert "silent 1.5" in row


def test_the_verbs_say_what_they_did(verb):
    assert verb("home", "mock/transient") == (
        0,
        "stage: going home\nstage: stands at home, at 0.000 mm\n",
        "",
    )
    code, out, err = verb("tare", "mock/transient")
    assert (code, err) == (0, "")
    assert out.startswith("board.load_cell: ")
    assert "N is zero now" in out
    assert "to keep it" not in out, "the board keeps it"


@pytest.mark.parametrize(
    ("name", "tared"), [("mock/grasp", ["arm.force"]), ("mock/first_contact", ["board.load_cell"])]
)
def test_a_bench_with_a_gripper_or_a_person_is_tared_where_that_is_possible(verb, name, tared):
    code, out, err = verb("tare", name, "--set", "loop.rate_hz=50")
    assert (code, err) == (0, "")
    assert [line.partition(":")[0] for line in out.splitlines()] == tared


def test_a_zero_that_no_device_keeps_is_the_line_to_paste(verb):
    code, out, err = verb(
        "tare", "tests/data/serial_lines.toml", "uno", "--set", "devices.uno.streams.force.offset=512"
    )
    assert (code, err) == (0, "")
    told, _, line = out.partition("to keep it: ")
    assert "lost as the program ends" in told
    setting, _, table = line.partition("  # in ")
    assert table == "[devices.uno.streams.force]\n"
    # the simulated board prints this number where nothing presses, give or take its cell's noise of a few steps
    assert float(setting.removeprefix("offset = ")) == pytest.approx(512.0, abs=20.0)


@pytest.mark.parametrize(
    ("arguments", "code", "named"),
    [
        (["home", "mock/transient", "stag"], 2, ("stag", "stage")),
        (["home", "mock/transient", "board"], 2, ("board", "move")),
        (["monitor", "mock/transient", "boar.load_cell"], 2, ("boar", "board")),
        (["monitor", "mock/transient", "board.load"], 2, ("board.load", "board.load_cell")),
        (
            ["home", "mock/slip", "--set", "devices.arm.start_pose=? jog there"],
            2,
            ("start_pose", "jog there"),
        ),
        (["home", "mock/transient", "--set", "limits.force_n=? newtons"], 2, ("force_n", "newtons")),
        (["home", "mock/weights"], 2, ("mock/weights", "nothing that moves")),
        (["home", "papers/slip"], 2, ("papers/slip", "parts", "mock/weights")),
        (["tare", "mock/transient", "stage"], 2, ("stage", "N")),
        (["tare", "mock/grasp", "gripper"], 2, ("gripper", "N")),
    ],
)
def test_what_cannot_be_done_is_one_line(verb, arguments, code, named):
    ended, _, err = verb(*arguments)
    assert ended == code
    check_refusal(err.strip(), *named)

import math
import re
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from controller.guard import BRAKING_S, Guard, GuardRefusal, GuardSettings
from controller.limits import MoverLimits, shown_limits
from controller.redundancy import LATEST_S
from drivers.core.messages import (
    MOTION,
    Command,
    Excite,
    Grip,
    Home,
    Lead,
    MoveAt,
    MovePose,
    MoveTo,
    Reached,
    Release,
    SampleBlock,
    Saturated,
    SetTendon,
    Standstill,
    Stop,
    StreamInfo,
    Tare,
    Twist,
)
from drivers.core.settings import HomeSpeed, Settings
from tests.refusals import refused


def guard(*, quiet=True, **changes):
    """A guard that has received a moment of no force, unless it is not `quiet`."""
    settings = {"force_n": 2.0, "travel_m": 0.012, "speed_m_s": 0.02}
    made = Guard(GuardSettings(**{**settings, **changes}))
    limits = made.settings
    if quiet and limits.force_n is not None and limits.force_stream is not None:
        width = max(limits.force_channels) + 1
        block = SampleBlock(limits.force_stream, 0, 0.0, np.zeros((1, width)), rate_hz=1000.0, unit="N")
        assert made.check(0.0, [block], moving=False) is None
    return made


def arm(**changes):
    return guard(position_stream="arm.position", **changes)


def force(values_n, start=0, rate_hz=1000.0):
    values = np.asarray(values_n, dtype=float)[:, None]
    return SampleBlock("board.load_cell", start, start / rate_hz, values, rate_hz=rate_hz, unit="N")


def position(values_m, t0_s=0.0):
    times_s = t0_s + np.arange(len(values_m)) * 0.01
    return SampleBlock("stage.position", 0, t0_s, np.array(values_m)[:, None], times_s=times_s, unit="m")


def pose(*places_m):
    values = np.array([(*place, 0.0, 3.1416, 0.0) for place in places_m])
    return SampleBlock("arm.pose", 0, 0.0, values, rate_hz=500.0, unit="m")


BOX = {"workspace_min_m": [-0.1, -0.1, 0.0], "workspace_max_m": [0.1, 0.1, 0.3], "pose_stream": "arm.pose"}
"""Lists, as a profile gives them."""

WRIST = {"force_stream": "arm.force", "position_stream": None}
ALL_THREE = {**WRIST, "force_channels": (0, 1, 2)}


def sent(stream, values, **more):
    """A block of 1 kHz."""
    return SampleBlock(stream, 0, 0.0, np.asarray(values), rate_hz=1000.0, **more)


def wrist(*forces_n, **more):
    return sent("arm.force", np.tile(forces_n, (20, 1)), **more)


def among_three(number, odd, others):
    return [odd if each == number else others for each in range(3)]


OUTSIDE = ((-0.11, 0, 0.1), (0.11, 0, 0.1), (0, -0.11, 0.1), (0, 0, -0.01))
FAR, NEAR = (0.0, 0.0, 0.31), (0.0, 0.0, 0.1)
BEYOND = Saturated(0.0, "signals", "signals.fingertip", 1.62)
SPIKE = force(np.where((np.arange(40) >= 10) & (np.arange(40) < 14), 50.0, 0.0))
WINDOW = force(np.where((np.arange(60) >= 40) & (np.arange(60) < 50), 3.0, 0.0))
PRESSED = force(np.full(20, 2.5))

SEEN: dict[str, Any] = {
    "a spike shorter than half the median": ({}, [SPIKE], None),
    "a lasting force": ({}, [PRESSED], "board.load_cell is at 2.500 N (10 ms median), beyond limits.force_n"),
    "a force that lasts for one window of a long block": ({}, [WINDOW], "3.000 N (10 ms median)"),
    "a force that grows": ({"force_median_s": 0.001}, [force([1.0, 1.9, 2.1, 5.0])], "2.100 N"),
    "a pull": ({}, [force(np.full(20, -2.5))], "at -2.500 N"),
    "a force that is no number": ({}, [force([0.0, math.nan])], "board.load_cell reads nan"),
    "one sample, the median over less than two": ({"force_median_s": 0.001}, [force([2.5])], "2.500 N"),
    "another channel": (WRIST, [wrist(0.0, 0.0, 2.5)], None),
    "the channel": ({**WRIST, "force_channels": (2,)}, [wrist(0.0, 0.0, 2.5)], "2.500 N"),
    "the size of three channels, within": ({**ALL_THREE, "force_n": 2.01}, [wrist(1.2, 0.0, 1.6, 9.0)], None),
    "the size of three channels": ({**ALL_THREE, "force_n": 1.99}, [wrist(1.2, 0.0, 1.6, 9.0)], "2.000 N"),
    "counts of 1.5 N": ({}, [sent("board.load_cell", [[150_000]] * 20, scale=1e-5)], None),
    "counts of 3 N": ({}, [sent("board.load_cell", [[300_000]] * 20, scale=1e-5)], "3.000 N"),
    "counts of channels, within": ({**ALL_THREE, "force_n": 2.6}, [wrist(1500, 2000, 0, scale=1e-3)], None),
    "counts of channels": ({**ALL_THREE, "force_n": 2.4}, [wrist(1500, 2000, 0, scale=1e-3)], "2.500 N"),
    "the travel": ({}, [position([-0.0005, 0.0119, 0.012])], None),
    "beyond the travel": ({}, [position([0.0119, 0.0121])], "stage.position is at 0.012100 m"),
    "before the travel": ({}, [position([-0.00051])], "-0.000510 m"),
    "counts within the travel": ({}, [sent("stage.position", [[24_000]], scale=0.5e-6)], None),
    "counts beyond the travel": ({}, [sent("stage.position", [[24_200]], scale=0.5e-6)], "0.012100 m"),
    "an empty block before one": ({}, [position([]), position([0.02])], "0.020000 m"),
    "a tool in its box": (BOX, [pose((0.0, 0.0, 0.1), (0.1, -0.1, 0.3))], None),
    "a tool that leaves its box": (
        BOX,
        [pose((0.0, 0.0, 0.1), (0.0, 0.1001, 0.1))],
        "arm.pose is at (0.0000, 0.1001, 0.1000) m, outside limits.workspace_min_m",
    ),
    "a pose that is no number": (BOX, [pose((math.nan, 0.0, 0.1))], "nan"),
    "counts in the box": (BOX, [sent("arm.pose", np.full((1, 6), 90), scale=1e-3)], None),
    "counts beyond the box": (BOX, [sent("arm.pose", np.full((1, 6), 110), scale=1e-3)], "(0.1100, 0.1100, "),
    "an unknown stream": ({}, [sent("board.accelerometer", np.full((5, 1), 99.0))], None),
    **{f"place {n} of 3": ({}, [position(among_three(n, 0.0121, 0.005))], "0.012100 m") for n in range(3)},
    **{f"pose {n} of three": (BOX, [pose(*among_three(n, FAR, NEAR))], "0.3100") for n in range(3)},
    **{f"beyond the box at {place_m}": (BOX, [pose(place_m)], "outside") for place_m in OUTSIDE},
}


@pytest.mark.parametrize("moving", [False, True])
@pytest.mark.parametrize("name", SEEN)
def test_what_is_beyond_a_limit_stops_the_bench_moving_or_not(name, moving):
    changes, blocks, words = SEEN[name]
    reason = guard(**changes).check(0.04, blocks, moving=moving)
    assert reason is None if words is None else words in reason


def test_a_late_loop_stops_what_moves():
    for late_s, moving, stops in ((0.125, True, False), (0.126, True, True), (0.3, False, False)):
        reason = guard(late_s=0.125).check(0.0, [position([0.0])], moving=moving, late_s=late_s)
        assert (reason is not None and "the loop is" in reason) == stops


def test_a_sensor_beyond_its_range_stops_the_bench_and_is_the_first_of_several_reasons():
    for blocks, late_s in (([], 0.0), ([position([0.02])], 1.0)):
        reason = guard().check(0.0, blocks, moving=bool(blocks), late_s=late_s, saturated=[BEYOND])
        assert reason.startswith("signals.fingertip is beyond its range, at 1.62")


@pytest.mark.parametrize("size", [1, 3, 7, 25])
def test_the_median_is_the_same_however_the_samples_come(size):
    """A step in the middle: the median passes 2 N when six of ten samples are above it."""
    values = np.concatenate([np.zeros(25), np.full(25, 3.0)])
    watched = guard()
    for start in range(0, 50, size):
        end = min(start + size, 50)
        reason = watched.check(end / 1000, [force(values[start:end], start)], moving=True)
        # Ten samples: with five above, numpy's median is their mean with the five below, 1.5 N.
        assert (reason is not None) == (end - 25 >= 6), (start, end)
        if reason is not None:
            return


def test_a_trial_may_have_the_range_of_its_own_streams_watched_and_the_next_one_has_not():
    watched = guard()
    watched.reset(frozenset({"signals.tip"}))
    assert watched.inputs == {"board.load_cell", "stage.position", "signals.tip"}
    watched.reset()
    assert watched.inputs == {"board.load_cell", "stage.position"}


def test_what_the_guard_watches_must_arrive_while_anything_moves_and_nothing_of_the_trial_before():
    watched = guard(range_streams=["signals.tip"])
    watched.arrivals.expect(frozenset({"stage.position", "signals.tip"}), 0.0)
    assert watched.arrivals.check(0.1, [], moving=True) is None
    assert watched.arrivals.check(0.19, [position([0.0], t0_s=0.19)], moving=True) is None
    failed = watched.arrivals.check(0.21, [], moving=True)
    assert failed is not None
    assert failed.reason.startswith("signals.tip is silent")
    watched = guard()
    watched.arrivals.expect(frozenset({"board.load_cell"}), 0.0)
    watched.reset()
    assert watched.arrivals.check(90.0, [], moving=True) is None


def test_the_inputs_of_an_armed_detector_must_arrive_while_anything_moves_and_not_when_it_is_disarmed():
    watched = guard()
    watched.arrivals.expect(frozenset({"board.period"}), 0.0)
    watched.arm(frozenset({"board.period"}))
    watched.arrivals.check(0.0, [], moving=True)
    assert watched.arrivals.check(0.2, [], moving=True) is not None
    watched.arm(frozenset())
    assert watched.arrivals.check(0.2, [], moving=True) is None


def test_a_range_that_nothing_reports_is_refused_before_anything_moves():
    streams = {name: StreamInfo(name, ("x",), "N") for name in ("board.load_cell", "signals.tip")}
    streams["stage.position"] = StreamInfo("stage.position", ("x",), "m")
    guard(range_streams=["signals.tip"]).check_streams(streams)
    with refused(GuardRefusal, "limits.range_streams = signals.tap", "no such stream"):
        guard(range_streams=["signals.tap"]).check_streams(streams)


def twist(*rates, for_s=1.0):
    return Twist("arm", rates, for_s)


def along_axis(axis, rate):
    return twist(*np.roll([rate, 0.0, 0.0, 0.0, 0.0, 0.0], axis))


def goes(*offset, speed_m_s=0.01):
    return MovePose("arm", offset, speed_m_s)


ARM = {"position_stream": "arm.position"}
REACH = {**ARM, "reach_m": 0.1, "reach_rad": 1.5}
TURNS = {**REACH, "turn_rad_s": 0.5}
LIFT_LIMITS = {"travel_m": 0.1, "speed_m_s": 0.3, "position_stream": "lift.position", "blind_travel_m": 0.01}
LIFT = {"movers": {"lift": LIFT_LIMITS}}
JAWS = {"movers": {"gripper": {"travel_m": 0.1, "speed_m_s": 0.1}}}
ONLY_TURNS = twist(0.0, 0.0, 0.0, 0.0, 0.1, 0.0, for_s=0.1)
FREE = [
    goes(0.01, 0.0, 0.0, 0.0, 0.0, 0.0),
    goes(0.0, 0.0, 0.0, 0.0, 0.1, 0.0),
    goes(*[0.0] * 6),
    twist(0.01, 0.0, 0.0, 0.0, 0.0, 0.0, for_s=0.1),
    ONLY_TURNS,
]

REFUSED = [
    ({}, MoveAt("stage", 0.03, 0.01), "0.03 m/s is beyond limits.speed_m_s = 0.02"),
    ({}, MoveAt("stage", -0.03, 0.01), "0.03 m/s is beyond limits.speed_m_s"),
    ({}, MoveAt("stage", 0.01, 0.013), "0.013 m is outside limits.travel_min_m .. travel_m"),
    ({}, MoveTo("stage", -0.01, 0.01), "-0.01 m is outside"),
    ({}, MoveTo("stage", math.nan, 0.01), "position_m is nan"),
    ({}, MoveAt("stage", 0.0, 0.01), "0 m/s is no speed"),
    ({}, MoveTo("stage", 0.01, -5.0), "-5 m/s is no speed"),
    ({}, Release("gripper", 0.0), "0 m/s is no speed"),
    ({}, Release("gripper", 0.03), "0.03 m/s is beyond"),
    *(({}, Grip("gripper", 0.01, 0.01, n), "is outside 0 .. limits.grip_n = 80") for n in (0.0, -5.0, 80.1)),
    ({}, MoveTo("lift", 0.01, 0.01), "are those of stage; give lift its own in [limits.movers.lift]"),
    (LIFT, MoveTo("lift", 0.11, 0.3), "outside limits.movers.lift.travel_min_m .. travel_m = -0.0005 .. 0.1"),
    (LIFT, MoveAt("lift", -0.31, 0.1), "beyond limits.movers.lift.speed_m_s = 0.3"),
    (LIFT, MoveTo("stage", 0.1, 0.02), "outside limits.travel_min_m"),
    (JAWS, Grip("gripper", 0.01, 0.11, 10.0), "0.11 m/s is beyond limits.movers.gripper.speed_m_s"),
    (ARM, goes(*[0.0] * 6, speed_m_s=-0.01), "-0.01 m/s is no speed"),
    (ARM, twist(0.03, 0.0, 0.0, 0.0, 0.0, 0.0), "0.03 m/s is beyond limits.speed_m_s"),
    *(({**ARM, "reach_rad": 1.5}, command, "without limits.reach_m") for command in FREE),
    ({**ARM, "reach_m": 0.1}, twist(0.01, 0.0, 0.0, 0.0, 0.1, 0.0, for_s=5.0), "limits.reach_rad = 0"),
    (REACH, twist(0.01, 0.0, 0.0, 0.0, 0.0, 0.0, for_s=11.0), "limits.reach_m = 0.1"),
    (REACH, twist(0.0, 0.0, 0.0, 0.0, 1.01, 0.0), "limits.turn_rad_s = 1"),
    (REACH, twist(0.0, 0.0, 0.0, 0.0, 0.5, 0.0, for_s=3.1), "turns by 1.55 rad, beyond limits.reach_rad"),
    (REACH, twist(0.02, 0.0, 0.0, 0.0, 0.0, 0.0, for_s=-60.0), "-60 s is no duration"),
    (REACH, twist(0.02, 0.0, 0.0, 0.0, 0.0, 0.0, for_s=0.0), "0 s is no duration"),
    (REACH, goes(0.06, 0.08, 0.03, 0.0, 0.0, 0.0), "limits.reach_m = 0.1"),
    (REACH, goes(0.05, 0.0, 0.0, 0.0, 0.0, 0.0, speed_m_s=0.021), "limits.speed_m_s = 0.02"),
    (REACH, goes(0.0, 0.0, 0.0, 1.8, 2.4, 0.0), "turns by 3 rad, beyond limits.reach_rad = 1.5"),
    # what turns on its way takes the same number for rad/s
    ({**REACH, "turn_rad_s": 0.009}, goes(0.0, 0.0, 0.0, 0.0, 0.5, 0.0), "0.01 rad/s is beyond limits.turn"),
    *((TURNS, along_axis(3 + axis, 0.51), "0.51 rad/s is beyond limits.turn_rad_s") for axis in range(3)),
    *((TURNS, along_axis(axis, 0.021), "0.021 m/s is beyond limits.speed_m_s") for axis in range(3)),
]


@pytest.mark.parametrize(("changes", "command", "reason"), REFUSED)
def test_what_is_unsafe_is_refused_with_the_command_and_the_reason(changes, command, reason):
    what = f"{type(command).__name__}({command.device}): "
    with pytest.raises(GuardRefusal, match=f"^{re.escape(what)}.*{re.escape(reason)}"):
        guard(**changes).admit(command)


ADMITTED = [
    ({}, Stop("stage")),
    ({}, Home("stage")),
    ({}, Excite("board", True)),
    ({}, Grip("gripper", 0.01, 0.02, 80.0)),
    ({}, Grip("gripper", 0.01, 0.02, 0.5)),
    ({}, Release("gripper", 0.02)),
    ({}, MoveAt("stage", 0.02, 0.012)),
    ({}, MoveAt("stage", -0.02, -0.0005)),
    ({}, MoveTo("stage", 0.012, 0.02)),
    (LIFT, MoveTo("lift", 0.1, 0.3, blind_travel_m=0.01)),
    (LIFT, MoveTo("stage", 0.012, 0.02)),
    (JAWS, Grip("gripper", 0.01, 0.1, 10.0)),
    *((REACH, command) for command in FREE),
    ({**REACH, "turn_rad_s": 0.015}, goes(0.0, 0.0, 0.0, 0.0, 0.5, 0.0, speed_m_s=0.015)),
    (TURNS, twist(0.02, 0.0, 0.0, 0.5, 0.0, 0.0)),
    ({**REACH, "reach_m": 0.125}, goes(0.125, 0.0, 0.0, 0.0, 0.0, 0.0)),
    (REACH, goes(0.0, 0.0, 0.0, 1.5, 0.0, 0.0)),
]


@pytest.mark.parametrize(("changes", "command"), ADMITTED)
def test_what_is_just_within_its_limits_passes_as_it_is(changes, command):
    assert guard(**changes).admit(command) == command


def test_a_bench_without_a_force_limit_or_some_streams_fits_and_lists_what_it_has_where_it_does_not():
    watched = guard(force_n=None)
    assert watched.inputs == {"stage.position"}
    watched.check_streams({"stage.position": StreamInfo("stage.position", ("x",), "m")})
    guard(force_n=None, force_stream=None, position_stream=None).check_streams({})
    with pytest.raises(GuardRefusal, match=r"no such stream; it has a.b, c.d$"):
        guard().check_streams({name: StreamInfo(name, ("x",), "m") for name in ("c.d", "a.b")})


def test_a_window_begins_anew_with_a_trial_and_what_is_no_number_is_forgotten_once_it_was_reported():
    watched = guard()
    watched.check(0.005, [force(np.full(5, 9.0))], moving=True)
    watched.reset()
    assert watched.check(0.01, [force(np.full(6, 0.1))], moving=True) is None
    watched = guard()
    assert "reads nan" in watched.check(0.001, [force([math.nan])], moving=True)
    assert watched.check(0.02, [force(np.zeros(20))], moving=True) is None


@dataclass(frozen=True, slots=True)
class _Jump(Command):
    height_m: float


def test_a_motion_that_no_limit_is_known_for_is_refused(monkeypatch):
    monkeypatch.setattr("controller.guard.MOTION", (*MOTION, _Jump))
    with pytest.raises(GuardRefusal, match=r"Jump\(stage\): no limit is known for this motion"):
        guard().admit(_Jump("stage", 0.1))


@pytest.mark.parametrize(
    ("streams", "reason"),
    [
        ({"stage.position": 1}, "limits.force_stream = board.load_cell: the bench has no such stream"),
        ({"board.load_cell": 1}, "limits.position_stream = stage.position: the bench has no such stream"),
        ({"board.load_cell": 0, "stage.position": 1}, "channel 0 is to be watched, but it has 0"),
        ({"board.load_cell": 1, "stage.position": 1}, "limits.pose_stream = arm.pose: the bench has no"),
        ({"board.load_cell": 1, "stage.position": 1, "arm.pose": 2}, "channel 2 is to be watched, but it"),
    ],
)
def test_streams_that_do_not_fit_are_refused_before_anything_moves(streams, reason):
    units = {"board.load_cell": "N"}
    there = {name: StreamInfo(name, tuple("xyz"[:n]), units.get(name, "m")) for name, n in streams.items()}
    with pytest.raises(GuardRefusal, match=reason):
        guard(**BOX).check_streams(there)


@pytest.mark.parametrize(
    ("name", "unit", "reason"),
    [
        ("board.load_cell", "kg", r"limits.force_stream = board.load_cell: it is in kg, its limit is in N"),
        ("stage.position", "mm", r"limits.position_stream = stage.position: it is in mm, its limit is in m"),
        ("arm.pose", "", r"limits.pose_stream = arm.pose: it is in no unit, its limit is in m"),
    ],
)
def test_a_limit_is_held_against_no_stream_in_another_unit(name, unit, reason):
    units = {"board.load_cell": "N", "stage.position": "m", "arm.pose": "m", name: unit}
    with pytest.raises(GuardRefusal, match=reason):
        guard(**BOX).check_streams(
            {each: StreamInfo(each, tuple("xyz"), unit) for each, unit in units.items()}
        )
    units |= {name: "N" if name == "board.load_cell" else "m", "lift.position": "mm"}
    with pytest.raises(GuardRefusal, match=r"limits.movers.lift.position_stream = .*: it is in mm"):
        guard(**LIFT).check_streams({each: StreamInfo(each, ("x",), unit) for each, unit in units.items()})


# --- limits of each mover


def test_each_mover_has_its_own_limits_position_and_blind_travel():
    limits = guard(position_stream=None)
    limits.admit(MoveTo("stage", 0.01, 0.01))
    with pytest.raises(GuardRefusal, match=r"those of stage"):
        limits.admit(MoveTo("lift", 0.01, 0.01))
    limits = guard(**LIFT)
    assert limits.inputs == {"board.load_cell", "stage.position", "lift.position"}
    assert limits.check(0.0, [sent("lift.position", [[0.05]])], moving=True) is None
    reason = limits.check(0.0, [sent("lift.position", [[0.11]])], moving=True)
    assert "outside limits.movers.lift.travel_min_m" in reason
    for command in (MoveAt("stage", 0.01, 0.01), MoveTo("stage", 0.01, 0.01)):
        assert guard(blind_travel_m=0.004).admit(command).blind_travel_m == 0.004


# --- a way out of contact

ONWARD = [
    MoveAt("stage", 0.01, 0.012),
    MoveTo("stage", 0.0101, 0.01),
    Twist("stage", (-0.01, 0.0, 0.0, 0.0, 0.0, 0.0), 0.1),
    MovePose("stage", (0.0,) * 6, 0.01),
]


def pressed(force_n=6.0, **changes):
    """A guard whose trial begins in contact."""
    watched = guard(quiet=False, **changes)
    assert watched.check(0.02, [force(np.full(20, force_n)), position([0.01])], moving=True) is None
    return watched


def test_a_trial_that_begins_in_contact_may_go_home_and_back():
    watched = pressed()
    back = [MoveAt("stage", -0.01, 0.0), *(MoveTo("stage", place_m, 0.01) for place_m in (0.0, 0.005))]
    for command in (Home("stage"), *back, Stop("stage")):
        assert watched.admit(command) == command
    command = MoveAt("stage", 0.01, 0.012)
    assert guard(quiet=False).admit(command) == command


@pytest.mark.parametrize("command", ONWARD)
def test_a_trial_that_begins_in_contact_goes_nowhere_else(command):
    with refused(GuardRefusal, f"{type(command).__name__}(stage): the trial began in contact, at 6 N still"):
        pressed().admit(command)


def test_what_pressed_at_the_start_may_not_grow():
    assert pressed().check(0.04, [force(np.full(20, 6.19), 20)], moving=True) is None
    assert "6.210 N" in pressed().check(0.04, [force(np.full(20, 6.21), 20)], moving=True)


@pytest.mark.parametrize("block", [1, 7, 100])
def test_what_pressed_at_the_start_may_not_grow_however_the_samples_are_cut(block):
    """It grows from 6 N to 6.3 N and is below the limit of 2 N at the end."""
    force_n = np.concatenate([np.full(20, 6.0), np.full(20, 6.3), np.full(60, 1.0)])
    watched = guard(quiet=False)
    blocks = [force(force_n[begin : begin + block], begin) for begin in range(0, 100, block)]
    reasons = [reason for each in blocks if (reason := watched.check(0.1, [each], moving=False))]
    assert "6.300 N" in reasons[0]


@pytest.mark.parametrize("median_s", [0.01, 0.001])
def test_the_limit_follows_a_force_that_falls_within_one_block(median_s):
    watched = pressed(force_median_s=median_s)
    falling = [force(np.linspace(6.0, 3.0, 40), 20)]
    assert watched.check(0.06, falling, moving=True) is None
    assert "3.700 N" in watched.check(0.08, [force(np.full(20, 3.7), 60)], moving=True)
    watched = pressed()
    assert watched.check(0.06, [force(np.linspace(6.0, 1.9, 100)[:96], 20)], moving=True) is None
    assert watched.in_contact_from_start
    assert watched.check(0.06, [force(np.full(5, 1.9), 116)], moving=True) is None
    assert not watched.in_contact_from_start


def test_the_limit_follows_the_force_down_and_is_the_settings_again_below_it():
    watched = pressed()
    assert watched.check(0.04, [force(np.full(20, 3.0), 20)], moving=True) is None
    assert "3.300 N" in watched.check(0.06, [force(np.full(20, 3.3), 40)], moving=True)
    watched = pressed()
    assert watched.check(0.04, [force(np.full(20, 1.9), 20)], moving=True) is None
    watched.admit(MoveAt("stage", 0.01, 0.012))
    assert "2.050 N" in watched.check(0.06, [force(np.full(20, 2.05), 40)], moving=True)


def test_a_contact_that_comes_later_is_none_that_was_there_but_the_next_trial_may_begin_in_one():
    watched = guard(quiet=False)
    watched.check(0.02, [force(np.full(20, 0.1))], moving=True)
    assert "2.100 N" in watched.check(0.04, [force(np.full(20, 2.1), 20)], moving=True)
    watched = guard()
    watched.reset()
    assert watched.check(0.02, [force(np.full(20, 6.0))], moving=True) is None
    watched = guard(quiet=False, force_n=0.5)
    watched.check(0.02, [force(np.full(20, 0.8))], moving=True)
    with pytest.raises(GuardRefusal, match=r"at 0.8 N still, beyond limits.force_n = 0.5"):
        watched.admit(MoveAt("stage", 0.01, 0.012))


# --- a stop holds


def stopped(*before, **changes):
    """A guard whose trial was stopped at 1 s, after these motions."""
    watched = guard(**changes)
    for command in before:
        watched.admit(command)
    watched.latch(1.0)
    return watched


@pytest.mark.parametrize(
    "command",
    [
        Stop("stage"),
        Home("stage"),
        Release("gripper", 0.02),
        MoveAt("stage", -0.01, 0.0),
        MoveTo("stage", 0.0, 0.01),
        SetTendon("board", 0.0),
        Excite("board", True),
    ],
)
@pytest.mark.parametrize("before", [[MoveAt("stage", 0.01, 0.012)], []], ids=["forward", "never moved"])
def test_after_a_stop_what_takes_load_away_is_admitted(before, command):
    assert stopped(*before).admit(command) == command


@pytest.mark.parametrize("command", [*ONWARD, Grip("gripper", 0.01, 0.01, 5.0), SetTendon("board", 0.001)])
def test_after_a_stop_nothing_else_moves_until_the_next_trial(command):
    watched = stopped(reach_m=0.1, reach_rad=1.0)
    for _ in range(2):
        with refused(GuardRefusal, "the trial was stopped", "only Stop, Home, Release"):
            watched.admit(command)
    watched.reset()
    assert watched.admit(command) == command


def test_after_a_stop_a_motion_to_a_place_leads_back_if_it_lies_behind_where_its_mover_was_seen():
    for seen_m, back_m, on_m in ((0.006, 0.002, 0.007), (-0.02, -0.021, 0.0)):
        watched = guard(travel_min_m=-0.03)
        watched.check(0.9, [position([0.003, seen_m])], moving=True)
        watched.latch(1.0)
        assert watched.admit(MoveTo("stage", back_m, 0.01)).position_m == back_m
        with pytest.raises(GuardRefusal, match="the trial was stopped"):
            watched.admit(MoveTo("stage", on_m, 0.01))


@pytest.mark.parametrize("before", [MoveAt("stage", -0.01, 0.0), MoveTo("stage", 0.0, 0.01), Home("stage")])
def test_after_a_stop_on_the_way_back_there_is_no_way_but_home(before):
    watched = stopped(MoveAt("stage", 0.01, 0.012), before)
    with pytest.raises(GuardRefusal, match="the trial was stopped"):
        watched.admit(MoveAt("stage", -0.01, 0.0))
    assert watched.admit(Home("stage")) == Home("stage")


def test_after_a_stop_what_presses_may_grow_while_movers_brake_and_then_only_fall():
    watched = stopped()
    then_s = 1.0 + BRAKING_S
    for t_s, force_n in ((1.02, 3.0), (1.04, 6.0)):
        assert watched.check(t_s, [force(np.full(20, force_n), round(t_s * 1000) - 20)], moving=True) is None
    assert watched.check(then_s + 0.02, [force(np.full(20, 5.0), 1320)], moving=True) is None
    assert watched.check(then_s + 0.04, [force(np.full(20, 5.19), 1340)], moving=True) is None
    assert "5.210 N" in watched.check(then_s + 0.06, [force(np.full(20, 5.21), 1360)], moving=True)


def test_after_a_stop_the_place_is_no_reason_to_stop_the_way_back_but_lateness_and_a_range_are():
    watched = stopped()
    assert watched.check(2.0, [position([0.013])], moving=True) is None
    watched.reset()
    assert watched.check(0.1, [position([0.013])], moving=True)
    assert "late" in stopped().check(2.0, [], moving=True, late_s=0.2)
    beyond = Saturated(2.0, "board", "signals.tip", 9.0)
    assert "beyond its range" in stopped().check(2.0, [], moving=True, saturated=[beyond])


def test_what_views_show_beside_its_limit_is_force_and_travel_where_they_are_watched():
    limits = GuardSettings(travel_m=0.01, force_stream="board.force", force_n=0.5, force_channels=(1,))
    force, travel = shown_limits(limits)
    assert force == ("force", "board.force", (1,), 0.5, "N")
    assert travel == ("travel", "stage.position", (0,), 0.01, "m")
    assert list(shown_limits(GuardSettings(travel_m=0.01, position_stream=None))) == []


class HomingSettings(Settings):
    """Of a mover that homes at a speed of its own."""

    home_speed_m_s: HomeSpeed = 0.02


def test_homing_is_no_faster_than_its_mover_may_be():
    stage = HomingSettings()
    other = {"other": MoverLimits(travel_m=0.01, speed_m_s=0.02)}  # just as fast
    limits = GuardSettings(travel_m=0.01, speed_m_s=0.01, movers=other)
    (found,) = limits.mismatches((), {("devices", "stage"): stage, ("devices", "other"): stage})
    assert (found.path, found.key) == (("devices", "stage"), "home_speed_m_s")
    assert "speed_m_s = 0.01" in found.mistake


def test_a_limit_that_was_not_given_is_none_and_what_is_no_limit_stays():
    limits = GuardSettings(travel_m=0.01, force_n=2.0, retreat_n=4.0, peak_n=5.0)
    own = limits.without(["travel_m", "retreat_n", "stale_s"])
    assert (own.travel_m, own.force_n, own.retreat_n, own.peak_n) == (math.inf, 2.0, None, 5.0)
    assert own.stale_s == limits.stale_s


# --- a force for which a stop is not enough

CRUSHED = force(np.full(40, 7.0))
TIERS = {"retreat_n": 4.0, "retreat_m": 0.003}


def crushed(*before, brakes=None, **changes):
    watched = guard(**{**TIERS, **changes})
    for command in before:
        watched.sent(watched.admit(command))
    reason = watched.check(0.04, [CRUSHED if brakes is None else PRESSED], moving=True)
    assert "limits.force_n" in reason
    watched.latch(0.04)
    watched.see_braking([position([0.01])] if brakes is None else [force(brakes, 20)])
    return watched


@pytest.mark.parametrize("before", [MoveAt("stage", 0.01, 0.012), MoveTo("stage", 0.012, 0.02)])
def test_what_pressed_beyond_the_second_tier_goes_back_once(before):
    watched = crushed(before)
    way, for_s = watched.way_out()
    assert isinstance(way, MoveAt)
    assert (way.device, way.velocity_m_s) == ("stage", -0.01)
    assert for_s == pytest.approx(0.3), "3 mm at 10 mm/s"
    assert watched.way_out() is None


def test_the_way_back_is_that_of_what_moved_last_within_its_own_limits_and_jaws_open():
    lift, stage = MoveAt("lift", 0.004, 0.1), MoveAt("stage", 0.01, 0.012)
    movers = {"lift": {**LIFT_LIMITS, "speed_m_s": 0.005}}
    way, for_s = crushed(lift, stage, lift, movers=movers).way_out()
    assert (way.device, way.velocity_m_s, way.blind_travel_m) == ("lift", -0.005, 0.01)
    assert for_s == pytest.approx(0.6), "3 mm at 5 mm/s"
    way, for_s = crushed(MoveAt("stage", 0.01, 0.012), Grip("gripper", 0.01, 0.02, 5.0)).way_out()
    assert way == Release("gripper", 0.02)
    assert for_s == pytest.approx(0.15)


@pytest.mark.parametrize(
    ("seen_m", "travel_min_m", "end_m"),
    [([0.01], -0.02, 0.0), ([-0.001], -0.02, -0.02), ([], -0.0005, 0.0)],
)
def test_it_goes_back_no_farther_than_where_approaches_begin_unless_it_was_seen_behind_that(
    seen_m, travel_min_m, end_m
):
    watched = guard(**TIERS, travel_min_m=travel_min_m)
    watched.admit(MoveAt("stage", 0.01, 0.012))
    watched.check(0.04, [CRUSHED, position(seen_m)], moving=True)
    assert watched.way_out()[0].limit_m == end_m


def test_where_no_way_back_is_known_there_is_none():
    forward = MoveAt("stage", 0.01, 0.012)
    for last in (MoveAt("stage", -0.01, 0.0), Home("stage"), Lead("stage")):
        assert crushed(forward, last).way_out() is None
    for before in ([], [Twist("stage", (0.01, 0, 0, 0, 0, 0), 0.1)]):
        assert crushed(*before, reach_m=0.1).way_out() is None


def test_a_stop_below_the_second_tier_is_enough_and_one_that_brakes_beyond_it_is_not():
    watched = crushed(MoveAt("stage", 0.01, 0.012), brakes=np.full(40, 3.9))
    assert watched.looks_on_s == pytest.approx(0.02)
    watched.see_braking([sent("board.accelerometer", np.full((40, 1), 9.0))])
    assert watched.way_out() is None
    watched = crushed(MoveAt("stage", 0.01, 0.012), brakes=np.full(40, 4.1))
    for start in (60, 100):
        watched.see_braking([force(np.full(40, 3.9), start)])
    assert watched.way_out() is not None
    assert guard(**TIERS).looks_on_s == 0.0


def test_where_nothing_goes_back_what_presses_after_a_stop_may_not_grow_either():
    watched = crushed(MoveAt("stage", 0.01, 0.012), brakes=np.full(40, 2.5), force_median_s=0.001)
    assert watched.way_out() is None
    assert "beyond limits.force_n" in watched.see_braking([force(np.full(40, 3.9), 60)])


def test_where_a_mover_stood_in_the_trial_before_is_not_where_it_stands():
    watched = guard()
    watched.check(0.05, [position([0.01])], moving=False)
    watched.latch(0.06)
    assert watched.admit(MoveTo("stage", 0.005, 0.01))
    watched.reset()
    watched.latch(0.06)
    with refused(GuardRefusal, "MoveTo(stage): the trial was stopped"):
        watched.admit(MoveTo("stage", 0.005, 0.01))


def test_a_contact_from_before_the_trial_is_no_crush():
    watched = guard(quiet=False, **TIERS)
    assert watched.check(0.04, [CRUSHED], moving=True) is None
    watched.admit(MoveAt("stage", -0.01, 0.0))
    watched.check(0.08, [force(np.zeros(40), 40)], moving=True)
    watched.admit(MoveAt("stage", 0.01, 0.012))
    assert watched.way_out() is None


def test_half_a_box_and_tiers_that_are_not_in_order_are_refused():
    with pytest.raises(ValueError, match="give all or none"):
        guard(workspace_min_m=(0.0, 0.0, 0.0))
    for key in ("retreat_n", "peak_n"):
        with pytest.raises(ValueError, match=f"{key} = 2 is not above force_n = 2"):
            guard(**{key: 2.0})
        guard(force_n=None, **{key: 2.0})


# --- what is forecast of an approach

STIFF = {"stiffness_n_m": 1e4, "braking_m_s2": 0.5}
"""At 10 mm/s: 0.05 mm in a turn and 0.1 mm of braking, 1.5 N; 1 N more for the median, 2 N for a detector of 20 ms."""


def test_a_forecast_is_a_spring_times_the_way_after_the_touch():
    found = guard(**STIFF, detector_delay_s=0.02).foreseen(1.5, MoveAt("stage", 0.01, 0.012))
    assert (found.t_s, found.device, found.speed_m_s) == (1.5, "stage", 0.01)
    assert found.travel_m == pytest.approx(0.15e-3)
    assert found.peak_n == pytest.approx(3.5)
    assert found.most_n == pytest.approx(4.5)


def test_what_goes_back_or_on_or_knows_no_stiffness_has_no_forecast_and_is_admitted():
    watched = guard(**STIFF)
    assert watched.foreseen(0.0, MoveTo("stage", 0.01, 0.01)).peak_n is None
    assert watched.foreseen(0.1, MoveTo("stage", 0.012, 0.01)) is None
    assert watched.foreseen(0.2, MoveTo("stage", 0.012, 0.005)) is not None
    assert watched.foreseen(0.3, MoveAt("stage", -0.01, 0.0)) is None
    assert watched.foreseen(0.4, Home("stage")) is None
    assert guard().foreseen(0.0, MoveAt("stage", 0.01, 0.012)) is None
    assert guard(**STIFF, force_n=None).foreseen(0.0, MoveAt("stage", 0.01, 0.012)) is None
    guard(peak_n=4.0).admit(MoveAt("stage", 0.02, 0.012))


def test_beside_a_forecast_stands_what_happened_as_far_as_a_stop_and_a_position_show_it():
    watched = guard(**STIFF)
    watched.foreseen(0.0, MoveAt("stage", 0.01, 0.012))
    watched.check(0.02, [position([0.004]), force(np.full(20, -0.7))], moving=True)
    watched.sent(Stop("stage"))
    watched.check(0.04, [position([0.0041]), force(np.full(20, 0.3), 20)], moving=True)
    watched.sent(Stop("lift"))
    assert watched.answered(Standstill(0.04, "lift", 0.0)) is None
    found = watched.answered(Standstill(0.05, "stage", 0.0042))
    assert (found.t_s, found.device) == (0.05, "stage")
    assert found.travel_m == pytest.approx(0.2e-3)
    assert found.pressed_n == pytest.approx(0.7)
    assert watched.answered(Standstill(0.06, "stage", 0.0042)) is None
    watched = guard(**STIFF)
    watched.foreseen(0.0, MoveAt("stage", 0.01, 0.012))
    assert math.isnan(watched.answered(Reached(0.05, "stage", 0.012)).travel_m)
    watched = guard(**STIFF, position_stream=None)
    watched.foreseen(0.0, MoveAt("stage", 0.01, 0.012))
    watched.sent(Stop("stage"))
    assert math.isnan(watched.answered(Standstill(0.05, "stage", 0.012)).travel_m)


def fastest(**changes):
    """The fastest approach that is admitted, by halving, m/s."""
    watched, least_m_s, most_m_s = guard(speed_m_s=1.0, **changes), 0.0, 1.0
    for _ in range(40):
        middle_m_s = 0.5 * (least_m_s + most_m_s)
        try:
            watched.admit(MoveAt("stage", middle_m_s, 0.012))
            least_m_s = middle_m_s
        except GuardRefusal:
            most_m_s = middle_m_s
    return least_m_s


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"peak_n": 4.0}, "4.5 N where it is ended by limits.force_n alone, beyond limits.peak_n = 4"),
        ({"detector_delay_s": 0.02}, "3.5 N where it is ended by the detector, beyond limits.force_n = 2"),
        ({"peak_n": 4.0, "detector_delay_s": 0.02}, "beyond limits.peak_n = 4"),
    ],
)
def test_an_approach_that_would_press_too_hard_is_refused_with_the_fastest_that_would_not(changes, reason):
    watched = guard(**STIFF, **changes)
    with pytest.raises(GuardRefusal, match=re.escape(reason)) as refusal:
        watched.admit(MoveAt("stage", 0.01, 0.012))
    said_m_s = float(re.findall(r"at most (\S+) m/s", str(refusal.value))[0])
    watched.admit(MoveAt("stage", said_m_s, 0.012))
    assert said_m_s == pytest.approx(fastest(**STIFF, **changes), rel=0.01)
    watched.admit(MoveAt("stage", -0.01, 0.0))


# --- the commanded and the measured position


def moving(*commands, **changes):
    watched = guard(**changes)
    for command in commands:
        watched.sent(watched.admit(command))
    return watched


def along(from_m, speed_m_s, seconds, t0_s=0.0):
    """Positions at 100 Hz, from a place on, at a speed."""
    return position(from_m + speed_m_s * 0.01 * np.arange(round(seconds * 100)), t0_s)


FORWARD = MoveAt("stage", 0.002, 0.012)
"""0.4 mm in 0.2 s: 1.4 mm off is what is allowed."""


@pytest.mark.parametrize(
    ("commands", "block", "off"),
    [
        ([FORWARD], along(0.001, 0.002, 3.0), False),
        ([FORWARD], along(0.001, 0.0014, 2.0), False),  # 1.2 mm behind
        ([FORWARD], along(0.001, 0.001, 2.0), True),
        ([FORWARD], along(0.001, 0.004, 1.0), True),
        ([FORWARD], along(0.001, -0.001, 0.6), True),
        ([MoveTo("stage", 0.003, 0.002)], along(0.001, 0.002, 1.5), False),  # it goes 1 mm too far
        ([MoveTo("stage", 0.003, 0.002)], along(0.001, 0.002, 2.0), True),
        ([MoveTo("stage", 0.0, 0.002)], along(0.005, -0.002, 2.0), False),
        ([FORWARD, Stop("stage")], along(0.005, 0.0, 2.0), False),
        ([FORWARD, Stop("stage")], along(0.005, 0.002, 1.0), True),
        ([FORWARD, Home("stage")], along(0.005, 0.002, 2.0), False),
        ([Stop("stage")], along(0.0, 0.002, 3.0), False),
        ([], along(0.0, 0.002, 3.0), False),
    ],
)
@pytest.mark.parametrize("pieces", [1, 7])
def test_a_mover_that_does_not_do_what_it_was_commanded_is_stopped(commands, block, off, pieces):
    watched = moving(*commands)
    cuts = zip(np.array_split(block.values[:, 0], pieces), np.array_split(block.times, pieces), strict=True)
    parts = [position(places_m, float(times_s[0])) for places_m, times_s in cuts]
    reasons = [watched.check(1.0, [part], moving=True) for part in parts]
    assert any(reason is not None and "limits.follow_m = 0.001" in reason for reason in reasons) == off


def test_a_slow_command_after_a_fast_one_may_brake_first_and_after_a_rest_may_not():
    fast, slow = MoveAt("stage", 0.02, 0.012), MoveAt("stage", 0.0001, 0.012)
    ahead = [position([0.001]), position([0.003], 0.01)]
    watched = moving(fast, slow)
    assert watched.check(0.02, ahead, moving=True) is None
    watched = moving(fast)
    watched.answered(Standstill(0.0, "stage", 0.001))
    watched.sent(slow)
    assert "limits.follow_m" in watched.check(0.02, ahead, moving=True)


def test_a_mover_need_not_be_compared_and_another_ones_command_is_not_its_own():
    far = along(0.001, 0.0, 3.0)
    assert moving(FORWARD, follow_m=None).check(1.0, [far], moving=True) is None
    assert moving(MoveTo("lift", 0.05, 0.02), **LIFT).check(1.0, [far], moving=True) is None
    watched = moving(FORWARD)
    watched.reset()
    assert watched.check(1.0, [far], moving=True) is None


# --- two sensors of one quantity

PAIR = {"streams": ["board.load_cell", "arm.force"], "channels": [0, 2], "factor": -1.0, "most": 0.5}
BOTH = {"agree": {"force": PAIR}}


def loads(first_n, second_n, start=0, zero_n=0.0):
    """A load cell at 1 kHz; the same of an arm at 500 Hz, of the other sign."""
    times_s = (start + np.arange(0, len(second_n), 2)) / 1000
    values = np.zeros((len(times_s), 6))
    values[:, 2] = zero_n - np.asarray(second_n)[::2]
    second = SampleBlock("arm.force", start, times_s[0], values, times_s=times_s, unit="N")
    return [force(first_n, start), second]


@pytest.mark.parametrize(("second_n", "off"), [(1.0, False), (0.6, False), (0.4, True), (1.6, True)])
@pytest.mark.parametrize("size", [20, 600])
def test_two_sensors_that_disagree_for_long_enough_stop_the_bench(second_n, off, size):
    """Both begin at another zero of their own, and then feel 1 N, or another force, for 0.3 s."""
    first_n, second_n = np.repeat([0.0, 1.0], 300), np.repeat([0.0, second_n], 300)
    watched, reasons = guard(**BOTH), []
    for start in range(0, 600, size):
        cut = slice(start, start + size)
        blocks = loads(first_n[cut], second_n[cut], start, zero_n=-20.0)
        reasons.append(watched.check(1.0, blocks, moving=True))
    told = [reason for reason in reasons if reason]
    assert bool(told) == off
    assert all("board.load_cell and arm.force disagree: they have changed by 1 and" in each for each in told)
    assert all("limits.agree.force.most = 0.5" in each for each in told)


def test_they_may_disagree_for_a_moment_and_begin_anew_with_a_tare_or_a_trial():
    short_n = np.append(np.zeros(300), np.append(np.ones(40), np.zeros(260)))
    assert guard(**BOTH).check(1.0, loads(short_n, np.zeros(600)), moving=True) is None
    for begin_anew in (lambda one: one.sent(Tare("board", "board.load_cell")), lambda one: one.reset()):
        watched = guard(**BOTH)
        assert watched.check(1.0, loads(np.zeros(300), np.zeros(300)), moving=True) is None
        begin_anew(watched)
        assert watched.check(1.0, loads(np.ones(300), np.zeros(300), 300), moving=True) is None
    watched = guard(**BOTH)
    watched.check(1.0, loads(np.zeros(300), np.zeros(300)), moving=True)
    watched.sent(Tare("board", "board.other"))
    assert watched.check(1.0, loads(np.ones(300), np.zeros(300), 300), moving=True) is not None


def test_one_sensor_alone_is_not_compared_and_both_must_be_there():
    watched = guard(**BOTH)
    assert watched.check(1.0, [force(np.ones(300))], moving=True) is None
    assert watched.inputs == {"board.load_cell", "stage.position", "arm.force"}
    units = {"board.load_cell": "N", "stage.position": "m"}
    there = {name: StreamInfo(name, ("x",), unit) for name, unit in units.items()}
    with pytest.raises(GuardRefusal, match=r"limits.agree.force.streams = arm.force: the bench has no such"):
        watched.check_streams(there)
    both = there | {"arm.force": StreamInfo("arm.force", ("x", "y"), "N")}
    with pytest.raises(GuardRefusal, match=r"arm.force: channel 2 is to be watched, but it has 2"):
        watched.check_streams(both)
    with pytest.raises(GuardRefusal, match=r"limits.position_stream = stage.position: the bench has no such"):
        watched.check_streams({name: info for name, info in both.items() if name != "stage.position"})


def test_samples_of_one_do_not_pile_up_at_rest_while_the_other_is_silent_and_count_when_it_is_back():
    watched = guard(**BOTH)
    watched.check(1.0, loads(np.zeros(1000), np.zeros(1000)), moving=True)
    for start in range(1000, 20_000, 1000):
        watched.check(1.0, [force(np.ones(1000), start)], moving=False)
    (agreeing,) = watched._agreeing
    assert len(agreeing._waiting[0][0]) <= 1000 * LATEST_S + 1
    assert watched.check(1.0, loads(np.ones(300), np.zeros(300), 20_000), moving=True) is not None

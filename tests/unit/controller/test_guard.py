import math

import numpy as np
import pytest

from controller.guard import Guard, GuardRefusal, GuardSettings
from drivers.messages import (
    Grip,
    MoveAt,
    MovePose,
    MoveTo,
    Release,
    SampleBlock,
    Saturated,
    Stop,
    StreamInfo,
    Twist,
)


def guard(**changes):
    settings = {"force_n": 2.0, "travel_m": 0.012, "speed_m_s": 0.02}
    return Guard(GuardSettings(**{**settings, **changes}))


def force(values_n, start=0, rate_hz=1000.0):
    values = np.asarray(values_n, dtype=float)[:, None]
    return SampleBlock("board.load_cell", start, start / rate_hz, values, rate_hz=rate_hz, unit="N")


def position(values_m, t0_s=0.0):
    times_s = t0_s + np.arange(len(values_m)) * 0.01
    return SampleBlock("stage.position", 0, t0_s, np.array(values_m)[:, None], times_s=times_s, unit="m")


def test_the_force_may_be_another_channel_of_its_stream():
    values = np.zeros((20, 6))
    values[:, 2] = 2.5
    block = SampleBlock("arm.force", 0, 0.0, values, rate_hz=500.0, unit="N")
    watching = {"force_stream": "arm.force", "position_stream": None}
    assert guard(**watching).watch(0.04, [block], moving=False) is None
    assert "2.500 N" in guard(**watching, force_channels=(2,)).watch(0.04, [block], moving=False)


def test_a_spike_shorter_than_half_the_median_stops_nothing():
    values = np.zeros(40)
    values[10:14] = 50.0
    assert guard().watch(0.04, [force(values), position([0.0])], moving=True) is None


def test_a_lasting_force_stops_the_bench_and_says_which_limit():
    reason = guard().watch(0.02, [force(np.full(20, 2.5)), position([0.0])], moving=True)
    assert reason is not None
    assert "2.500 N" in reason
    assert "limits.force_n = 2" in reason


def test_a_pull_counts_like_a_push():
    assert guard().watch(0.02, [force(np.full(20, -2.5)), position([0.0])], moving=True)


@pytest.mark.parametrize("size", [1, 3, 7, 25])
def test_the_median_is_the_same_however_the_samples_come(size):
    """A step in the middle: the median passes 2 N when six of ten samples are above it."""
    values = np.concatenate([np.zeros(25), np.full(25, 3.0)])
    watched = guard()
    for start in range(0, 50, size):
        end = min(start + size, 50)
        reason = watched.watch(end / 1000, [force(values[start:end], start)], moving=True)
        # Ten samples: with five above, numpy's median is their mean with the five below, 1.5 N.
        assert (reason is not None) == (end - 25 >= 6), (start, end)
        if reason is not None:
            return


def test_a_force_that_is_not_a_number_stops_the_bench():
    reason = guard().watch(0.0, [force([0.0, math.nan])], moving=True)
    assert reason == "board.load_cell reads nan"


def test_a_silent_stream_stops_what_moves_and_nothing_else():
    still, moving = guard(), guard()
    still.watch(0.0, [], moving=False)
    assert still.watch(5.0, [], moving=False) is None
    moving.watch(0.0, [force(np.zeros(5)), position([0.0])], moving=True)
    reason = moving.watch(0.2, [position([0.0], t0_s=0.2)], moving=True)
    assert reason is not None
    assert reason.startswith("board.load_cell is silent for")


def test_a_stream_is_not_stale_at_the_start_of_a_motion_that_wakes_it():
    watched = guard()
    watched.watch(0.0, [], moving=False)
    assert watched.watch(90.0, [], moving=True) is None
    assert watched.watch(90.2, [], moving=True) is not None


def test_a_late_loop_stops_what_moves():
    blocks = [force(np.zeros(5)), position([0.0])]
    assert "late" in (guard().watch(0.0, blocks, moving=True, late_s=0.3) or "")
    assert guard().watch(0.0, blocks, moving=False, late_s=0.3) is None


def test_force_counts_while_nothing_moves_as_well():
    assert guard().watch(0.02, [force(np.full(20, 2.5))], moving=False)


def test_a_stream_that_a_detector_decides_by_is_watched_like_the_guards_own():
    watched = guard()
    watched.arm(frozenset({"board.period"}))
    both = [force(np.zeros(5)), position([0.0])]
    assert watched.watch(0.0, both, moving=True) is None
    late = [force(np.zeros(5), start=200), position([0.0], t0_s=0.2)]
    reason = watched.watch(0.2, late, moving=True)
    assert reason is not None
    assert reason.startswith("board.period is silent")


def test_a_stream_that_nobody_decides_by_any_more_may_fall_silent():
    watched = guard()
    watched.arm(frozenset({"board.period"}))
    watched.watch(0.0, [], moving=True)
    watched.arm(frozenset())
    own = [force(np.zeros(5), start=200), position([0.0], t0_s=0.2)]
    assert watched.watch(0.2, own, moving=True) is None


def test_what_was_silent_before_another_stream_was_armed_is_as_stale_after_it():
    watched = guard()
    watched.watch(0.0, [], moving=True)
    watched.watch(0.08, [position([0.0], t0_s=0.08)], moving=True)
    watched.arm(frozenset({"board.period"}))
    reason = watched.watch(0.12, [position([0.0], t0_s=0.12)], moving=True)
    assert reason is not None
    assert reason.startswith("board.load_cell is silent for 0.120 s")


def test_a_motion_that_ends_as_others_are_armed_leaves_nothing_to_be_stale():
    watched = guard()
    watched.watch(0.0, [], moving=True)
    watched.arm(frozenset({"board.period"}))
    assert watched.watch(0.3, [], moving=False) is None
    assert watched.watch(9.0, [], moving=True) is None


def test_a_stream_whose_range_is_watched_must_be_alive_in_every_motion():
    watched = guard(range_streams=["signals.tip"])
    assert "signals.tip" in watched.inputs
    own = [force(np.zeros(5)), position([0.0])]
    watched.watch(0.0, own, moving=True)
    late = [force(np.zeros(5), start=200), position([0.0], t0_s=0.2)]
    assert watched.watch(0.2, late, moving=True).startswith("signals.tip is silent")


def test_a_trial_may_have_the_range_of_its_own_streams_watched_and_the_next_one_has_not():
    watched = guard()
    watched.reset(frozenset({"signals.tip"}))
    assert watched.inputs == {"board.load_cell", "stage.position", "signals.tip"}
    watched.reset()
    assert watched.inputs == {"board.load_cell", "stage.position"}


def test_a_range_that_nobody_tells_of_is_refused_before_anything_moves():
    streams = {
        name: StreamInfo(name, ("x",), "N") for name in ("board.load_cell", "stage.position", "signals.tip")
    }
    guard(range_streams=["signals.tip"]).fit(streams)
    with pytest.raises(
        GuardRefusal, match=r"limits.range_streams = signals.tap: the bench has no such stream"
    ):
        guard(range_streams=["signals.tap"]).fit(streams)


def test_a_time_stamp_from_the_future_keeps_no_stream_alive():
    watched = guard()
    watched.watch(0.0, [force(np.zeros(5), start=30_000), position([0.0])], moving=True)
    reason = watched.watch(0.3, [position([0.0], t0_s=0.3)], moving=True)
    assert reason is not None
    assert reason.startswith("board.load_cell is silent")


def test_travel_beyond_the_limit_stops_the_bench():
    reason = guard().watch(0.0, [force([0.0]), position([0.0119, 0.0121])], moving=True)
    assert reason is not None
    assert "stage.position is at 0.012100 m" in reason


@pytest.mark.parametrize(
    ("command", "said"),
    [
        (MoveAt("stage", 0.03, 0.01), "0.03 m/s is beyond limits.speed_m_s"),
        (MoveAt("stage", -0.03, 0.01), "0.03 m/s is beyond limits.speed_m_s"),
        (MoveAt("stage", 0.01, 0.013), "0.013 m is outside"),
        (MoveTo("stage", -0.01, 0.01), "-0.01 m is outside"),
        (MoveTo("stage", math.nan, 0.01), "position_m is nan"),
        (MoveAt("stage", math.inf, 0.01), "velocity_m_s is inf"),
        (MoveAt("stage", 0.0, 0.01), "0 m/s is no speed"),
        (MoveTo("stage", 0.01, -5.0), "-5 m/s is no speed"),
        (MovePose("arm", (0.0,) * 6, -0.01), "-0.01 m/s is no speed"),
        (Release("gripper", 0.0), "0 m/s is no speed"),
        (Twist("arm", (0.03, 0.0, 0.0, 0.0, 0.0, 0.0), 0.1), "0.03 m/s is beyond limits.speed_m_s"),
        (Twist("arm", (0.0, 0.0, math.nan, 0.0, 0.0, 0.0), 0.1), "twist is nan"),
        (Grip("gripper", 0.01, 0.01, 90.0), "90 N is outside"),
        (Release("gripper", 0.03), "0.03 m/s is beyond"),
    ],
)
def test_what_is_unsafe_is_refused_with_the_reason(command, said):
    with pytest.raises(GuardRefusal, match=said):
        guard().admit(command)


def test_stop_always_passes():
    assert guard().admit(Stop("stage")) == Stop("stage")


def test_a_bench_without_a_force_stream_watches_none():
    assert guard(force_n=None).inputs == {"stage.position"}


def pose(*places_m):
    values = np.array([(*place, 0.0, 3.1416, 0.0) for place in places_m])
    return SampleBlock("arm.pose", 0, 0.0, values, rate_hz=500.0, unit="m")


def boxed():
    # Lists, as a profile gives them.
    return guard(workspace_min_m=[-0.1, -0.1, 0.0], workspace_max_m=[0.1, 0.1, 0.3], pose_stream="arm.pose")


def test_a_tool_that_leaves_its_box_stops_the_bench():
    watched = boxed()
    assert "arm.pose" in watched.inputs
    assert watched.watch(0.0, [pose((0.0, 0.0, 0.1), (0.1, -0.1, 0.3))], moving=True) is None
    reason = watched.watch(0.0, [pose((0.0, 0.0, 0.1), (0.0, 0.1001, 0.1))], moving=True)
    assert reason == (
        "arm.pose is at (0.0000, 0.1001, 0.1000) m, outside limits.workspace_min_m .. workspace_max_m"
    )


def test_a_pose_that_is_not_a_number_is_in_no_box():
    assert boxed().watch(0.0, [pose((math.nan, 0.0, 0.1))], moving=True)


def test_half_a_box_is_refused():
    with pytest.raises(ValueError, match="give all or none"):
        guard(workspace_min_m=(0.0, 0.0, 0.0))


def test_a_sensor_beyond_its_range_stops_the_bench():
    saturated = Saturated(0.0, "signals", "signals.fingertip", 1.62)
    reason = guard().watch(0.0, [], moving=False, saturated=[saturated])
    assert reason is not None
    assert reason.startswith("signals.fingertip is beyond its range, at 1.62")


@pytest.mark.parametrize(
    ("command", "said"),
    [
        (Twist("arm", (0.01, 0.0, 0.0, 0.0, 0.0, 0.0), 11.0), "limits.reach_m = 0.1"),
        (Twist("arm", (0.0, 0.0, 0.0, 0.0, 1.01, 0.0), 1.0), "limits.turn_rad_s = 1"),
        (
            Twist("arm", (0.0, 0.0, 0.0, 0.0, 0.5, 0.0), 3.1),
            "turns by 1.55 rad, beyond limits.reach_rad = 1.5",
        ),
        (Twist("arm", (0.02, 0.0, 0.0, 0.0, 0.0, 0.0), -60.0), "-60 s is no duration"),
        (Twist("arm", (0.02, 0.0, 0.0, 0.0, 0.0, 0.0), 0.0), "0 s is no duration"),
        (MovePose("arm", (0.06, 0.08, 0.03, 0.0, 0.0, 0.0), 0.01), "limits.reach_m = 0.1"),
        (MovePose("arm", (0.05, 0.0, 0.0, 0.0, 0.0, 0.0), 0.021), "limits.speed_m_s = 0.02"),
        (
            MovePose("arm", (0.0, 0.0, 0.0, 1.8, 2.4, 0.0), 0.01),
            "turns by 3 rad, beyond limits.reach_rad = 1.5",
        ),
    ],
)
def test_a_free_motion_is_held_to_speed_turn_and_reach(command, said):
    with pytest.raises(GuardRefusal, match=said):
        guard(reach_m=0.1, reach_rad=1.5).admit(command)


def test_a_move_that_turns_is_held_to_the_turn_by_the_same_number():
    turning = MovePose("arm", (0.0, 0.0, 0.0, 0.0, 0.5, 0.0), 0.015)
    assert guard(reach_m=0.1, reach_rad=1.5, turn_rad_s=0.015).admit(turning) is turning
    with pytest.raises(GuardRefusal, match=r"0.015 rad/s is beyond limits.turn_rad_s = 0.01"):
        guard(reach_m=0.1, reach_rad=1.5, turn_rad_s=0.01).admit(turning)


@pytest.mark.parametrize(
    "command",
    [
        MovePose("arm", (0.01, 0.0, 0.0, 0.0, 0.0, 0.0), 0.01),
        MovePose("arm", (0.0, 0.0, 0.0, 0.0, 0.1, 0.0), 0.01),
        MovePose("arm", (0.0,) * 6, 0.01),
        Twist("arm", (0.01, 0.0, 0.0, 0.0, 0.0, 0.0), 0.1),
        Twist("arm", (0.0, 0.0, 0.0, 0.0, 0.1, 0.0), 0.1),
    ],
)
def test_no_free_motion_without_a_reach_one_that_only_turns_included(command):
    with pytest.raises(GuardRefusal, match=r"without limits.reach_m"):
        guard(reach_rad=1.5).admit(command)
    assert guard(reach_m=0.1, reach_rad=1.5).admit(command) is command


def test_no_turn_without_a_reach_in_radians():
    with pytest.raises(GuardRefusal, match=r"limits.reach_rad = 0"):
        guard(reach_m=0.1).admit(Twist("arm", (0.01, 0.0, 0.0, 0.0, 0.1, 0.0), 5.0))


def test_of_several_channels_the_size_of_the_force_counts():
    values = np.tile([1.2, 0.0, 1.6, 9.0], (20, 1))  # 2 N of the first three
    block = SampleBlock("arm.force", 0, 0.0, values, rate_hz=1000.0, unit="N")
    watching = {"force_stream": "arm.force", "force_channels": (0, 1, 2)}
    assert guard(**watching, force_n=2.01).watch(0.02, [block], moving=False) is None
    assert "2.000 N" in guard(**watching, force_n=1.99).watch(0.02, [block], moving=False)

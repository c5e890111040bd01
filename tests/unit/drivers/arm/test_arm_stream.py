"""The arm's rows as blocks, and its axis."""

import math

import numpy as np
import pytest
from pydantic import ValidationError

from drivers.arm.axis import Axis, way
from drivers.arm.link import ArmRow
from drivers.arm.settings import ArmSettings
from drivers.arm.stream import Streams
from drivers.core.clock import VirtualClock
from drivers.core.messages import MoveTo, Refused
from drivers.ur_arm.driver import UrArm
from drivers.ur_arm.settings import UrArmSettings

START = (0.4, 0.0, 0.2, 0.0, math.pi, 0.0)
SETTINGS = ArmSettings(rate_hz=500.0, host="127.0.0.2", start_pose=START, approach_axis=(0.0, 0.0, -1.0))
EPOCH_S = 100.0
"""Host time of the controller's zero, and of a row that arrives at once."""

FORCE, POSITION = "arm.force", "arm.position"


def row(cycle: int, late_s: float = 0.0, force_z: float = 0.0, cycle_s: float = 0.002) -> ArmRow:
    device_s = cycle * cycle_s
    pose = (0.4, 0.0, 0.2 - 1e-4 * cycle, 0.0, 3.1, 0.0)
    return ArmRow(EPOCH_S + device_s + late_s, device_s, pose, (0.0,) * 6, (0.0, 0.0, force_z, 0.0, 0.0, 0.0))


def listening(settings: ArmSettings) -> Streams:
    bench = VirtualClock()
    bench.wait_until(EPOCH_S)
    bench.restart()
    made = Streams("arm", settings, bench)
    made.listen({FORCE}, 0.0)
    return made


@pytest.fixture
def streams() -> Streams:
    return listening(SETTINGS)


def test_consecutive_rows_are_one_block_with_the_controller_s_time(streams: Streams) -> None:
    assert streams.take([row(cycle, force_z=cycle) for cycle in range(5, 9)]) == []
    (block,) = streams.blocks()
    assert block.stream == FORCE
    assert block.values[:, 2].tolist() == [5.0, 6.0, 7.0, 8.0]
    assert block.device_t0_s == pytest.approx(0.010)
    assert block.times == pytest.approx([0.010, 0.012, 0.014, 0.016])
    assert block.arrival_s == pytest.approx(0.016)


def test_a_skipped_row_is_a_reported_jump_in_the_sequence(streams: Streams) -> None:
    lost = streams.take([row(1), row(2), row(5), row(6)])
    assert [(loss.stream, loss.samples) for loss in lost] == [(FORCE, 2)]
    first, second = streams.blocks()
    assert second.seq == first.seq + len(first) + 2


def test_blocks_of_successive_reads_join(streams: Streams) -> None:
    streams.take([row(1), row(2)])
    (first,) = streams.blocks()
    streams.take([row(3)])
    (second,) = streams.blocks()
    assert second.seq == first.seq + 2
    assert streams.blocks() == []


def test_each_stream_that_is_listened_to_says_its_loss(streams: Streams) -> None:
    streams.listen({FORCE, POSITION}, 0.0)
    lost = streams.take([row(1), row(3)])
    assert {loss.stream for loss in lost} == {FORCE, POSITION}


def test_rows_without_a_subscriber_are_counted_and_not_lost(streams: Streams) -> None:
    streams.take([row(1)])
    (first,) = streams.blocks()
    streams.listen(frozenset(), 0.0)
    assert streams.take([row(cycle) for cycle in range(2, 50)]) == []
    streams.listen({FORCE}, 0.0)
    streams.take([row(50)])
    (second,) = streams.blocks()
    assert second.seq == first.seq + 49


def test_rows_that_waited_before_a_subscription_are_no_samples_of_it(streams: Streams) -> None:
    streams.listen({FORCE, POSITION}, EPOCH_S + 0.015)
    lost = streams.take([row(1), row(5), row(7), row(9), row(10)])
    assert [(loss.stream, loss.samples) for loss in lost] == [
        (FORCE, 3),
        (FORCE, 1),
        (FORCE, 1),
        (POSITION, 1),
    ]
    assert [(block.stream, len(block)) for block in streams.blocks() if block.stream == POSITION] == [
        (POSITION, 2)
    ]


def test_a_controller_that_starts_anew_begins_a_new_segment(streams: Streams) -> None:
    streams.take([row(500), row(501)])
    lost = streams.take([row(1), row(2)])
    assert [loss.samples for loss in lost] == [0]
    first, second = streams.blocks()
    assert second.seq > first.seq + len(first)


def test_the_position_is_the_way_along_the_axis(streams: Streams) -> None:
    streams.listen({POSITION}, 0.0)
    streams.take([row(10), row(11)])
    (block,) = streams.blocks()
    assert block.values == pytest.approx(np.array([[1.0e-3], [1.1e-3]]))
    assert block.unit == "m"


@pytest.mark.parametrize("rate_hz", [500.0, 250.0, 125.0])
def test_at_any_rate_what_follows_on_is_whole_and_what_was_skipped_is_counted(rate_hz: float) -> None:
    streams = listening(SETTINGS.model_copy(update={"rate_hz": rate_hz}))
    numbers = [*range(1, 1000), *range(1004, 2000)]
    lost = streams.take([row(number, cycle_s=1.0 / rate_hz) for number in numbers])
    assert [loss.samples for loss in lost] == [4]
    assert [len(block) for block in streams.blocks()] == [999, 996]
    info = streams.info[FORCE]
    assert (info.rate_hz, info.longest_s) == (rate_hz, pytest.approx(10 / rate_hz))


STREAMS = ("arm.force", "arm.pose", "arm.position")
NAN, INF = math.nan, math.inf


def settings(**changes: object) -> UrArmSettings:
    given = {
        "host": "127.0.0.2",
        "start_pose": START,
        "max_speed_m_s": 0.05,
        "max_turn_rad_s": 0.5,
        **changes,
    }
    return UrArmSettings.model_validate(given)


def test_an_offset_turns_after_the_start_pose_in_the_base_frame() -> None:
    axis = Axis(settings(start_pose=(0.4, 0.0, 0.2, 0.0, 0.0, math.pi / 2.0)))
    pose = axis.displaced((0.01, 0.02, 0.03, math.pi / 2.0, 0.0, 0.0))
    # A quarter about z, then one about x: the tool's axes x, y, z end on z, -x, -y. That is a third of a turn.
    third = 2.0 * math.pi / 3.0 / math.sqrt(3.0)
    assert pose == pytest.approx((0.41, 0.02, 0.23, third, -third, third))
    assert axis.displaced((0.0,) * 6) == axis.pose(0.0)


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"travel_min_m": 0.05, "travel_max_m": 0.05}, "travel_min_m"),
        ({"approach_axis": [0.0, 0.0, -2.0]}, "approach_axis"),
        ({"start_pose": [0.4, 0.0, 0.2]}, "start_pose"),
        ({"start_pose": [0.4, 0.0, 0.2, 0.0, NAN, 0.0]}, "start_pose"),
        ({"start_pose": (400.0, -133.3, 250.0, 0.0, 3.1416, 0.0)}, "start_pose = .* write m and rad"),
        ({"start_pose": (0.4, -0.1333, 0.25, 0.0, 180.0, 0.0)}, "start_pose = .* write m and rad"),
        ({"tcp_offset": (0.0, 0.0, 100.0, 0.0, 0.0, 0.0)}, "tcp_offset = .* write m and rad"),
        ({"payload_cog_m": (0.0, 0.0, 50.0)}, "payload_cog_m = .* write m and rad"),
        ({"max_speed_m_s": 0.3}, "max_speed_m_s"),
        ({"watchdog_hz": 0.0}, "watchdog_hz"),
        ({"link_timeout_s": 0.01}, "link_timeout_s"),
        ({"speed": 1.0}, "speed"),
    ],
)
def test_settings_that_make_no_sense_are_refused(changes: dict[str, object], named: str) -> None:
    with pytest.raises(ValidationError, match=named):
        settings(**changes)


def test_lists_of_a_profile_are_vectors() -> None:
    assert settings(start_pose=[0, 0, 0.5, 0, 3, 0]).start_pose == (0.0, 0.0, 0.5, 0.0, 3.0, 0.0)


def test_a_position_is_a_place_on_the_axis_and_back() -> None:
    axis = Axis(settings(approach_axis=(0.6, 0.0, -0.8)))
    pose = axis.pose(0.01)
    assert pose == pytest.approx((0.406, 0.0, 0.192, 0.0, math.pi, 0.0))
    assert axis.position_m(pose) == pytest.approx(0.01)
    assert axis.twist(0.02) == pytest.approx((0.012, 0.0, -0.016, 0.0, 0.0, 0.0))


def test_the_way_between_poses_is_a_length_and_an_angle() -> None:
    assert way((0.0, 0.0, 0.0, 0.1, 0.0, 0.0), (0.0, 0.3, 0.4, -0.2, 0.0, 0.0)) == pytest.approx((0.5, 0.3))
    # The same orientation, written twice.
    assert way(START, (0.4, 0.0, 0.2, 0.0, -math.pi, 0.0)) == pytest.approx((0.0, 0.0), abs=1e-7)


def test_an_arm_that_is_not_open_refuses_and_closes_in_peace() -> None:
    arm, command = UrArm("arm", settings(), VirtualClock()), MoveTo("arm", 0.0, 0.01)
    arm.apply(command)
    assert arm.poll() == [Refused(0.0, "arm", command, "it is not open")]
    assert not arm.read()
    arm.close()
    arm.close()

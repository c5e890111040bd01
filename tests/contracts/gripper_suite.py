"""What every gripper promises: run for mock drivers and for the real ones on emulated grippers, in virtual time."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np
import pytest

from drivers.core.messages import (
    Command,
    Grip,
    Gripped,
    Home,
    Listen,
    Reached,
    Refused,
    Release,
    Sent,
    Stalled,
    Standstill,
    Stop,
)
from simulator.physics.jaws_drive import JawsDrive
from simulator.physics.jaws_kernel import PRESENT
from tests.contracts.crank import Crank

CLOSED_M = 0.020

OBJECTS_M = {"mug": 0.040, "worn mug": 0.038}

GRIP = Grip("gripper", 0.030, 0.1, 20.0)


def put(
    jaws: JawsDrive, width_m: float | None, stiffness_n_m: float = 2e4, damping_n_s_m: float = 20.0
) -> None:
    """Put an object between jaws, or take away what is there."""
    jaws.clear()
    if width_m is not None:
        jaws.show(width_m, stiffness_n_m, damping_n_s_m)
        jaws.flags[PRESENT] = True


def calibrated_jaws() -> JawsDrive:
    """Jaws that know their ends and stand open, at rest."""
    drive = JawsDrive(CLOSED_M)
    drive.advance(0.0)
    drive.calibrate()
    drive.advance(3.0)
    drive.go(0.0, 20_000.0, 300.0)
    drive.advance(6.0)
    drive.restart()
    return drive


class GripperBench(Crank):
    """A gripper called `gripper`.

    `change(scene)` calls `scene(drive)` where nothing else touches the jaws.
    """

    def __init__(
        self,
        device: Any,
        clock: Any,
        change: Callable[[Callable[[JawsDrive], object]], None],
        opens: bool = True,
    ) -> None:
        super().__init__(device, clock, opens)
        self.change = change

    def place(self, name: str | None) -> None:
        def scene(drive: JawsDrive) -> None:
            put(drive, None if name is None else OBJECTS_M[name])
            drive.disturb()

        self.change(scene)

    def force_n(self) -> float:
        """How hard the jaws really press."""
        forces: list[float] = []
        self.change(lambda drive: forces.append(drive.contact_n))
        return forces[0]


class GripperContract:
    """Subclasses give a fixture `bench` whose jaws know their ends, stand open and close to `CLOSED_M`."""

    feels: ClassVar[bool] = True
    """Whether it tells a force."""

    count_n: ClassVar[float] = 0.05
    """How far a force may be from the one that was asked for."""

    def test_it_has_a_width_and_a_force_and_moves(self, bench: GripperBench) -> None:
        assert bench.info.mover
        assert {name: stream.unit for name, stream in bench.info.streams.items()} == {
            "gripper.width": "m",
            **({"gripper.force": "N"} if self.feels else {}),
        }
        assert bench.info.details["open_width_m"] == pytest.approx(0.068)

    def test_homing_ends_at_a_reached_position(self, bench: GripperBench) -> None:
        bench.device.apply(Home("gripper"))
        assert bench.until(Reached).position_m == pytest.approx(0.068, abs=0.2e-3)

    def test_an_object_is_gripped_held_tightened_and_released(self, bench: GripperBench) -> None:
        bench.place("mug")
        bench.device.apply(GRIP)
        sent = bench.until(Sent)
        gripped = bench.until(Gripped)
        assert gripped.object
        assert gripped.force_n == pytest.approx(20.0, abs=self.count_n)
        assert gripped.width_m == pytest.approx(0.039, abs=0.3e-3)
        assert gripped.t_s - sent.t_s > 0.2, "28 mm at 100 mm/s"
        assert bench.force_n() == pytest.approx(20.0, abs=0.6)
        bench.device.apply(Grip("gripper", 0.030, 0.1, 40.0))
        assert bench.until(Gripped).force_n == pytest.approx(40.0, abs=self.count_n)
        assert bench.force_n() == pytest.approx(40.0, abs=0.6 + self.count_n)
        bench.device.apply(Release("gripper", 0.1))
        assert bench.until(Reached).position_m == pytest.approx(0.068, abs=0.2e-3)
        assert bench.force_n() == 0.0

    def test_jaws_that_meet_nothing_say_so(self, bench: GripperBench) -> None:
        bench.device.apply(Grip("gripper", 0.050, 0.1, 20.0))
        gripped = bench.until(Gripped)
        assert not gripped.object
        assert gripped.width_m == pytest.approx(0.050, abs=0.3e-3)

    def test_a_lost_object_is_reported(self, bench: GripperBench) -> None:
        bench.place("mug")
        bench.device.apply(GRIP)
        assert bench.until(Gripped).object
        bench.place(None)
        assert not bench.until(Gripped).object

    def test_stop_holds_and_is_answered(self, bench: GripperBench) -> None:
        bench.device.apply(Grip("gripper", 0.030, 0.05, 20.0))
        bench.turn(0.2)
        bench.device.apply(Stop("gripper"))
        still = bench.until(Standstill)
        assert 0.035 < still.position_m < 0.067
        assert not [status for status in bench.statuses if isinstance(status, Gripped)]
        bench.device.apply(Stop("gripper"))
        assert bench.until(Standstill).position_m == pytest.approx(still.position_m, abs=0.3e-3)

    def test_stop_keeps_what_is_held(self, bench: GripperBench) -> None:
        bench.place("mug")
        bench.device.apply(GRIP)
        bench.until(Gripped)
        bench.device.apply(Stop("gripper"))
        bench.until(Standstill)
        assert bench.force_n() == pytest.approx(20.0, abs=0.6)

    def test_a_status_names_the_command_that_it_is_about(self, bench: GripperBench) -> None:
        bench.place("mug")
        bench.device.apply(replace(GRIP, id=5))
        assert bench.until(Sent).command_id == 5
        assert bench.until(Gripped).command_id == 5
        bench.place(None)
        assert bench.until(Gripped).command_id == 5
        bench.device.apply(Release("gripper", 0.1, id=6))
        bench.device.apply(Stop("gripper", id=7))
        assert bench.until(Standstill).command_id == 7
        bench.device.apply(Release("gripper", 0.1, id=8))
        assert bench.until(Reached).command_id == 8
        bench.device.apply(Home("gripper", id=9))
        assert bench.until(Reached).command_id == 9

    @pytest.mark.parametrize("first", [Stop("gripper"), Home("gripper")])
    def test_a_stop_upon_a_stop_or_home_still_keeps_what_is_held(
        self, bench: GripperBench, first: Command
    ) -> None:
        bench.place("mug")
        bench.device.apply(GRIP)
        bench.until(Gripped)
        for command in (first, Stop("gripper"), Stop("gripper")):
            bench.device.apply(command)
        bench.until(Standstill)
        bench.turn(0.2)
        assert bench.force_n() == pytest.approx(20.0, abs=0.6)
        # Jaws that were only kept in their place would not follow what gives way.
        bench.place("worn mug")
        bench.turn(0.3)
        assert bench.force_n() == pytest.approx(20.0, abs=0.6)

    @pytest.mark.parametrize("first", [Stop("gripper"), Home("gripper")])
    def test_what_an_earlier_program_gripped_survives_every_stop(
        self, bench: GripperBench, first: Command
    ) -> None:
        bench.place("mug")
        bench.device.apply(GRIP)
        bench.until(Gripped)
        bench.device.close()
        bench.device.open()
        for command in (first, Stop("gripper"), Stop("gripper")):
            bench.device.apply(command)
        bench.until(Standstill)
        bench.turn(0.2)
        bench.device.close()
        assert bench.force_n() == pytest.approx(20.0, abs=0.6)

    def test_a_stop_upon_home_stops_jaws_on_their_way(self, bench: GripperBench) -> None:
        bench.device.apply(Grip("gripper", 0.030, 0.05, 20.0))
        bench.turn(0.2)
        bench.device.apply(Home("gripper"))
        bench.until(Reached)
        bench.device.apply(Stop("gripper"))
        assert bench.until(Standstill).position_m > 0.035

    def test_jaws_that_jam_while_they_open_have_stalled(self, bench: GripperBench) -> None:
        bench.device.apply(Grip("gripper", 0.050, 0.1, 20.0))
        bench.until(Gripped)
        bench.change(lambda drive: drive.jam())
        bench.device.apply(Release("gripper", 0.1))
        assert "something holds its jaws" in bench.until(Stalled).reason

    def test_jaws_that_a_grip_does_not_move_have_stalled_and_hold_nothing(self, bench: GripperBench) -> None:
        bench.device.apply(Release("gripper", 0.1))
        bench.until(Reached)
        bench.change(lambda drive: drive.jam())
        bench.device.apply(GRIP)
        assert "68.0 mm, where they stood before" in bench.until(Stalled).reason
        bench.turn(0.1)
        assert not [status for status in bench.statuses if isinstance(status, Gripped | Stalled)]

    def test_width_and_force_come_while_they_are_subscribed(self, bench: GripperBench) -> None:
        bench.turn(0.1)
        assert bench.blocks == []
        expected = {"gripper.width": 0.039, **({"gripper.force": 20.0} if self.feels else {})}
        bench.device.apply(Listen("gripper", frozenset(expected)))
        bench.place("mug")
        bench.device.apply(GRIP)
        bench.until(Gripped)
        bench.turn(0.1)
        for stream, value in expected.items():
            times_s = bench.times(stream)
            assert len(times_s) > 20
            assert (np.diff(times_s) > 0.0).all()
            assert bench.values(stream)[-1, 0] == pytest.approx(value, rel=0.01)
        bench.device.apply(Listen("gripper", frozenset()))
        bench.turn(0.05)
        bench.blocks.clear()
        bench.turn(0.1)
        assert bench.blocks == []

    def test_closing_twice_is_no_error_and_keeps_what_is_held(self, bench: GripperBench) -> None:
        bench.place("mug")
        bench.device.apply(GRIP)
        bench.until(Gripped)
        bench.device.close()
        bench.device.close()
        assert bench.force_n() == pytest.approx(20.0, abs=0.6)


class FreshGripperContract:
    """Subclasses give a fixture `fresh` whose jaws do not know their ends."""

    def test_nothing_is_gripped_before_homing(self, fresh: GripperBench) -> None:
        fresh.device.apply(GRIP)
        assert "send Home first" in fresh.until(Refused).reason

    def test_homing_finds_the_ends_and_ends_closed(self, fresh: GripperBench) -> None:
        fresh.device.apply(Home("gripper"))
        assert fresh.until(Reached).position_m == pytest.approx(0.020, abs=0.2e-3)

"""The Robotiq's driver on its emulated twin, in virtual time: what it writes, and what can go wrong."""

from types import SimpleNamespace
from typing import Any

import pytest

from drivers.core.clock import VirtualClock
from drivers.core.errors import CommandError, ProtocolError, SilentError
from drivers.core.messages import (
    Excite,
    Failed,
    Grip,
    Gripped,
    Home,
    Listen,
    Reached,
    Refused,
    Release,
    Stalled,
    Standstill,
    Stop,
)
from drivers.robotiq.driver import Robotiq
from drivers.robotiq.settings import RobotiqSettings
from simulator.devices.robotiq import EmulatedRobotiq
from simulator.mocks.base import MemoryLine
from simulator.physics.jaws_drive import JawsDrive
from tests.contracts.gripper_suite import CLOSED_M, GripperBench, calibrated_jaws
from tests.refusals import refused


class Spoken:
    """The twin, and what it hears; `says` answers in its place where it is not None."""

    def __init__(self, twin: EmulatedRobotiq) -> None:
        self.twin, self.heard = twin, b""
        self.says: bytes | None = None

    def receive(self, data: bytes, t_s: float) -> bytes:
        self.heard += data
        answer = self.twin.receive(data, t_s)
        return answer if self.says is None else self.says

    def step(self, t_s: float) -> bytes:
        return self.twin.step(t_s)

    def orders(self) -> list[str]:
        return [line for line in self.heard.decode().splitlines() if line.startswith("SET")]


def gripper(drive: JawsDrive, **settings: Any) -> tuple[GripperBench, Spoken]:
    given = RobotiqSettings(port="-", closed_width_m=CLOSED_M, open_width_m=0.068, **settings)
    clock = VirtualClock()
    far = Spoken(EmulatedRobotiq(given, SimpleNamespace(jaws=drive)))
    device = Robotiq("gripper", given, clock, MemoryLine(far, clock).connect)
    return GripperBench(device, clock, lambda scene: scene(drive), opens=False), far


def width_m(bench: GripperBench) -> float:
    """Where the jaws really are."""
    widths_m: list[float] = []
    bench.change(lambda drive: widths_m.append(drive.width_m))
    return widths_m[0]


@pytest.fixture
def opened() -> tuple[GripperBench, Spoken]:
    bench, far = gripper(calibrated_jaws())
    bench.info = bench.device.open()
    return bench, far


def test_opening_asks_and_moves_nothing(opened: tuple[GripperBench, Spoken]) -> None:
    bench, far = opened
    assert far.orders() == []
    assert (bench.info.model, bench.info.details["calibrated"], bench.info.details["faults"]) == (
        "Robotiq 2f-85",
        True,
        [],
    )


def test_a_grip_is_one_line_and_its_stop_another(opened: tuple[GripperBench, Spoken]) -> None:
    bench, far = opened
    bench.device.apply(Grip("gripper", 0.030, 0.1, 20.0))
    assert far.orders() == ["SET POS 183 SPE 156 FOR 0 GTO 1"]
    bench.turn(0.1)
    bench.device.apply(Stop("gripper"))
    assert far.orders()[1:] == ["SET GTO 0"]


def test_jaws_that_a_dead_host_left_moving_are_stopped_at_opening(
    opened: tuple[GripperBench, Spoken],
) -> None:
    bench, far = opened
    bench.device.apply(Grip("gripper", 0.030, 0.02, 20.0))
    bench.turn(0.1)
    bench.device._link = None  # the program was killed
    bench.device.open()
    assert far.orders()[-1] == "SET GTO 0"
    bench.device.close()


def test_homing_resets_then_activates_and_only_where_it_must() -> None:
    bench, far = gripper(JawsDrive(CLOSED_M))
    bench.device.open()
    bench.device.apply(Home("gripper"))
    bench.until(Reached)
    assert far.orders() == ["SET ACT 0", "SET ACT 1"]
    bench.device.apply(Home("gripper"))
    bench.until(Reached)
    assert len(far.orders()) == 2


def test_a_stop_while_it_is_activated_takes_its_power_away() -> None:
    bench, far = gripper(JawsDrive(CLOSED_M))
    bench.device.open()
    bench.device.apply(Home("gripper"))
    bench.turn(0.3)
    bench.device.apply(Stop("gripper"))
    assert far.orders()[-1] == "SET ACT 0"
    bench.until(Standstill)
    bench.device.apply(Stop("gripper"))
    bench.until(Standstill)
    assert far.orders() == ["SET ACT 0", "SET ACT 1", "SET ACT 0"], "jaws at rest are only asked"
    bench.device.apply(Release("gripper", 0.1))
    assert "send Home first" in bench.until(Refused).reason


def test_a_fault_is_a_stall_in_words_and_home_clears_it(opened: tuple[GripperBench, Spoken]) -> None:
    bench, far = opened
    bench.place("mug")
    bench.device.apply(Grip("gripper", 0.030, 0.1, 20.0))
    bench.until(Gripped)
    far.twin.inject("overheat", bench.clock.now())
    assert "it is too hot; send Home" in bench.until(Stalled).reason
    bench.device.apply(Release("gripper", 0.1))
    assert "has a fault" in bench.until(Refused).reason
    bench.place(None)
    bench.device.apply(Home("gripper"))
    bench.until(Reached)
    bench.device.apply(Release("gripper", 0.1))
    bench.until(Reached)


@pytest.mark.parametrize("after_s", [0.1, 2.0], ids=["in motion", "holding"])
def test_a_power_failure_is_a_stall_in_motion_and_holding(
    opened: tuple[GripperBench, Spoken], after_s: float
) -> None:
    bench, far = opened
    bench.turn(0.5)
    bench.place("mug")
    bench.device.apply(Grip("gripper", 0.030, 0.05, 20.0, id=7))
    bench.turn(after_s)
    far.twin.inject("reboot", bench.clock.now())
    stalled = bench.until(Stalled)
    assert "no longer knows its ends" in stalled.reason
    assert stalled.command_id == 7
    bench.turn(1.0)
    assert bench.of(Stalled) == []


def test_an_order_that_was_not_taken_yet_has_not_arrived(opened: tuple[GripperBench, Spoken]) -> None:
    """The URCap's registers lag behind: `OBJ` may still be about the position before."""
    bench, far = opened
    far.twin._obey = lambda values: None  # type: ignore[method-assign]
    bench.listen("gripper.width")
    bench.device.apply(Grip("gripper", 0.030, 0.1, 20.0))
    bench.turn(1.0)
    assert bench.of(Gripped) == []
    assert bench.blocks_of("gripper.width")[-1].physical[-1, 0] == pytest.approx(0.068, abs=0.2e-3)
    assert bench.device.account()["states"] >= 10


def test_what_it_cannot_do_is_refused(opened: tuple[GripperBench, Spoken]) -> None:
    bench, _ = opened
    for command, named in (
        (Grip("gripper", 0.030, 0.01, 20.0), ("as slowly as 0.01", "0.02 m/s or more")),
        (Grip("gripper", 0.070, 0.1, 20.0), ("70 mm", "20 to 68 mm")),
        (Grip("gripper", 0.030, 0.1, 10.0), ("10 N is out of range", "20 to 235 N")),
        (Listen("gripper", frozenset({"gripper.force"})), ("gripper.force", "gripper.width")),
        (Excite("gripper", True), ("Grip, Release",)),
    ):
        with refused(CommandError, "gripper: ", *named):
            bench.device.apply(command)


@pytest.mark.parametrize(
    ("says", "error", "named"),
    [
        (b"", SilentError, ("no answer in 2 s", "URCap")),
        (b"Connected: Universal Robots Dashboard Server\n", ProtocolError, ("Connected", "63352")),
    ],
)
def test_a_port_without_a_gripper_is_refused(
    says: bytes, error: type[Exception], named: tuple[str, ...]
) -> None:
    bench, far = gripper(calibrated_jaws())
    far.says = says
    with refused(error, "gripper", *named):
        bench.device.open()


@pytest.mark.parametrize(("says", "words"), [(b"", "no answer in 1 s"), (b"FLT 0", "answers FLT where PRE")])
def test_silence_and_another_answer_are_failures(
    opened: tuple[GripperBench, Spoken], says: bytes, words: str
) -> None:
    bench, far = opened
    bench.turn(0.3)
    far.says = says
    assert words in bench.until(Failed).reason


def test_jaws_that_close_on_as_their_gripper_fails_are_stopped_again_and_again_and_at_the_end(
    opened: tuple[GripperBench, Spoken],
) -> None:
    """The URCap hears again what it did not answer for a second: it has no watchdog that would stop them."""
    bench, far = opened
    bench.device.apply(Grip("gripper", 0.020, 0.02, 60.0))
    bench.turn(0.1)
    far.says = b""
    bench.until(Failed)
    far.says = None
    moving_m = width_m(bench)
    for stop in (Stop("gripper", id=7), Stop("gripper", id=8)):
        bench.device.apply(stop)
        assert [status.command_id for status in bench.device.poll()] == [stop.id]
    bench.device.apply(Release("gripper", 0.1))
    assert "no answer in 1 s" in bench.until(Refused).reason
    assert far.orders()[1:] == ["SET GTO 0"] * 2
    bench.device.close()
    assert far.orders()[1:] == ["SET GTO 0"] * 3
    bench.clock.rest(0.5)
    far.step(bench.clock.now())
    assert width_m(bench) == pytest.approx(moving_m, abs=0.5e-3), "10 mm less, were it not stopped"


def test_what_is_held_as_the_gripper_fails_is_held_on(opened: tuple[GripperBench, Spoken]) -> None:
    bench, far = opened
    bench.place("mug")
    bench.device.apply(Grip("gripper", 0.030, 0.1, 20.0))
    bench.until(Gripped)
    far.says = b""
    bench.until(Failed)
    bench.device.apply(Stop("gripper"))
    bench.device.close()
    assert far.orders()[1:] == []
    assert bench.force_n() == pytest.approx(20.0, abs=1.0)


def test_closing_during_an_activation_takes_the_power_of_the_drive_away() -> None:
    bench, far = gripper(JawsDrive(CLOSED_M))
    bench.device.open()
    bench.device.apply(Home("gripper"))
    bench.turn(0.3)
    bench.device.close()
    assert far.orders() == ["SET ACT 0", "SET ACT 1", "SET ACT 0"]


def test_closing_stops_jaws_that_move(opened: tuple[GripperBench, Spoken]) -> None:
    bench, far = opened
    bench.device.apply(Grip("gripper", 0.030, 0.05, 20.0))
    bench.turn(0.1)
    bench.device.close()
    assert far.orders()[-1] == "SET GTO 0"

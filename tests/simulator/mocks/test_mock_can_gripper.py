"""The mock gripper: its faults, and that turns of any length give the same states."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from drivers.core.clock import VirtualClock
from drivers.core.messages import (
    Failed,
    Gripped,
    Listen,
    Lost,
    Refused,
    Sent,
    Stalled,
    Standstill,
    Status,
    Stop,
)
from simulator.devices.faults import Fault, FaultSchedule
from simulator.mocks.can_gripper import MockCanGripper, MockCanGripperSettings
from tests.contracts.gripper_suite import GRIP, calibrated_jaws, put


def run(turn_s: float, *faults: dict[str, Any], seconds: float = 1.0) -> tuple[list[Status], Any, float]:
    """Grip a mug; statuses, the widths received, and the force at the end."""
    drive = calibrated_jaws()
    put(drive, 0.040)
    clock = VirtualClock()
    schedule = FaultSchedule([Fault(device="gripper", **fault) for fault in faults])
    gripper = MockCanGripper(
        "gripper", MockCanGripperSettings(), clock, SimpleNamespace(jaws=drive), schedule
    )
    gripper.open()
    gripper.apply(Listen("gripper", frozenset({"gripper.width"})))
    clock.wait_until(0.05)
    gripper.apply(GRIP)
    statuses: list[Status] = []
    widths_m: list[float] = []
    while clock.now() < seconds:
        clock.wait_until(clock.now() + turn_s)
        widths_m += [value for block in gripper.read() for value in block.physical[:, 0]]
        statuses += gripper.poll()
    return statuses, np.array(widths_m), drive.contact_n


@pytest.mark.parametrize("turn_s", [0.001, 0.013, 0.95])
def test_turns_of_any_length_report_the_same(turn_s: float) -> None:
    expected, widths_m, _ = run(0.005)
    statuses, others_m, _ = run(turn_s)
    assert any(isinstance(status, Gripped) and status.object for status in expected)
    assert statuses == expected
    assert others_m[:95] == pytest.approx(widths_m[:95], abs=0.0)


@pytest.mark.parametrize(
    ("kind", "status"), [("unplug", Failed), ("refuse", Refused), ("lose", Lost), ("stall", Gripped)]
)
def test_faults_are_reported(kind: str, status: type[Status]) -> None:
    statuses, _, _ = run(0.005, {"kind": kind, "at_s": 0.02})
    assert status in {type(one) for one in statuses}
    assert not any(isinstance(one, Stalled) for one in statuses)


def test_stops_in_the_next_trial_keep_what_was_gripped_in_the_last() -> None:
    drive = calibrated_jaws()
    put(drive, 0.040)
    drive.go(0.8, 20_000.0, 433.0)
    drive.advance(3.0)
    drive.restart()
    clock = VirtualClock()
    gripper = MockCanGripper("gripper", MockCanGripperSettings(), clock, SimpleNamespace(jaws=drive))
    gripper.open()
    gripper.apply(Stop("gripper"))
    gripper.apply(Stop("gripper"))
    clock.wait_until(0.5)
    assert [type(status) for status in gripper.poll()] == [Sent, Sent, Standstill]
    gripper.close()
    assert drive.contact_n == pytest.approx(20.0, abs=0.6)  # 433 mA at 0.0462 N/mA


def test_a_gripper_that_is_unplugged_lets_go() -> None:
    statuses, _, held_n = run(0.005, {"kind": "unplug", "at_s": 0.9}, seconds=1.2)
    assert [type(status).__name__ for status in statuses] == ["Sent", "Gripped", "Failed"]
    assert held_n < 1.0


def test_a_silent_gripper_reports_nothing() -> None:
    statuses, widths_m, _ = run(0.005, {"kind": "silent", "at_s": 0.0})
    assert statuses == []
    assert len(widths_m) == 0

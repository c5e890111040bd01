"""A small table of classes: the profile code is tested without the program's own."""

from typing import Any, Literal

from pydantic import Field

from controller.registry import DriverKind, ExperimentKind, PlainKind
from drivers.core.settings import Address, DeviceName, Settings, StreamName


class Anything:
    """Has what a class of any family has, and is never made."""

    open = close = apply = read = poll = account = push = reset = begin = handle = table = states = None


for _name in ("MockStage", "Stage", "Network", "Resonance", "Level", "Touch", "Finger"):
    globals()[_name] = type(_name, (Anything,), {"__module__": __name__})


class MockStageSettings(Settings):
    travel_m: float = Field(default=0.02, gt=0.0, le=1.0)


class StageSettings(Settings):
    baud: int = Field(default=115200, ge=1200)


class NetworkSettings(Settings):
    address: Address = Field(min_length=1)
    patience_s: float = 1.0


class ResonanceSettings(Settings):
    input: StreamName = "stage.position"
    average_samples: int = Field(default=10, ge=1)
    threshold_sigma: float = Field(default=3.0, gt=0.0, le=100.0)
    sample_hz: float = Field(default=15.0, gt=0.0, le=1000.0)


class LevelSettings(Settings):
    input: StreamName = "stage.position"
    gamma: float = 3.0


class TouchSettings(Settings):
    mover: DeviceName = "stage"
    measures: tuple[StreamName, ...] = ("stage.position",)
    settle_s: float = Field(default=90.0, ge=0.0)
    direction: Literal["forward", "backward"] = "forward"
    ready: bool = True


class LimitsSettings(Settings):
    force_n: float = Field(default=2.0, gt=0.0, le=10.0)


class LoopSettings(Settings):
    rate_hz: float | None = 200.0


class FingerSettings(Settings):
    noise_scale: float = Field(default=1.0, ge=0.0)


class FaultsSettings(Settings):
    device: DeviceName
    kind: Literal["unplug", "stall"]
    at_s: float = Field(ge=0.0)


class TouchFactors(Settings):
    speed_m_s: float = Field(gt=0.0, le=0.05)
    """Speed of the approach. On the mover's axis."""

    location: str = "f"


COLUMNS = ()


def measure(*given: Any) -> Any: ...


SIMULATED: dict[str, Any] = dict.fromkeys(("mock", "emulated"), f"{__name__}:MockStage")
SIMULATED["emulated_faults"] = ("unplug",)
KINDS: dict[str, dict[str, PlainKind]] = {
    "driver": {
        "zaber_stage": DriverKind(
            f"{__name__}:Stage", **SIMULATED, mock_faults=("unplug", "stall"), streams=("position",)
        ),
        "sensor_board": DriverKind(f"{__name__}:Stage", **SIMULATED, mock_faults=("unplug",)),
        "ur_arm": DriverKind(f"{__name__}:Network", mock=f"{__name__}:Network"),
    },
    "detector": {
        "resonance": PlainKind(f"{__name__}:Resonance"),
        "resonance.paper": PlainKind(f"{__name__}:Resonance"),
        "level": PlainKind(f"{__name__}:Level"),
    },
    "signal": {"scaled": PlainKind(f"{__name__}:Level")},
    "experiment": {"touch": ExperimentKind(f"{__name__}:Touch", measures=__name__)},
    "plant": {"finger": PlainKind(f"{__name__}:Finger")},
}
PARTS = {part: f"{__name__}:{part.capitalize()}Settings" for part in ("limits", "loop", "faults")}

"""The bench as the controller sees it: devices, a clock, and nothing about what they are made of."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

from controller.own_modules import KindError
from drivers.core.clock import Clock
from drivers.core.messages import DeviceInfo, Listen, SampleBlock, Status, StreamInfo
from drivers.core.protocols import Asking, Device

BenchKind = Literal["mock", "emulated", "hardware"]
BenchTime = Literal["virtual", "held", "wall"]


@dataclass(frozen=True)
class TrialScene:
    """What a simulated bench is given before a trial; a real one is set by hand.

    Attributes:
        trial: Number of the trial, which keys the noise together with `seed`.
        factors: The trial's factors, flat, with dotted names.
        plant: The profile's plant section with the trial's factors laid over it.
    """

    trial: int
    seed: int
    factors: Mapping[str, Any]
    plant: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Rig:
    """Devices wired together.

    Attributes:
        kind: What the bench is made of.
        begin_trial: Puts a simulated bench into the trial's scene; nothing on a real one.
        known: After a trial: what really happened, as far as the bench knows (`TrialEvidence`: truth, slips, lifts,
            slides), where it is simulated in this process. For scoring alone; no detector or behavior is given it.
        account: What the plant did: tiers, what was skipped; for the manifest.
        place: Where things really stand, on a simulated bench, in metres by name; for judging that they stand still.
        endpoints: Where the devices of an emulated bench are, for another program that joins it.
        close: Closes what is not a device (an emulator's process).
        time: Of the clock: it jumps, waits for a process that is late, or is the host's.
        ahead: Lets turns in which nothing happens pass as one, where time may be tried and taken back: see
            `simulator.look_ahead.LookAhead.skip`.
        entered: Is told each state that a trial enters, and when: faults may count from it.
        pressed: Which key a simulated person presses now, as `LoopOperator.poll`.
        disk: How long a simulated disk takes besides for what is recorded now, s; infinite: it is full.
    """

    kind: BenchKind
    devices: Mapping[str, Device]
    clock: Clock
    begin_trial: Callable[[TrialScene], None] = lambda scene: None
    known: Callable[[], Mapping[str, Any]] = dict
    account: Callable[[], Mapping[str, Any]] = dict
    place: Callable[[], Mapping[str, float]] = dict
    endpoints: Mapping[str, Any] | None = None
    close: Callable[[], None] = lambda: None
    ahead: Callable[..., int] | None = None
    entered: Callable[[str, float], None] = lambda state, t_s: None
    pressed: Callable[[], str | None] = lambda: None
    disk: Callable[[], float] = float
    time: BenchTime = "virtual"

    def listen(self, streams: Collection[str]) -> None:
        """Have these streams sent, and no others."""
        for name, device in self.devices.items():
            own = frozenset(stream for stream in streams if stream.partition(".")[0] == name)
            device.apply(Listen(name, own))

    def gathered(self) -> tuple[list[SampleBlock], list[Status]]:
        """What the devices have sent since they were read last."""
        blocks: list[SampleBlock] = []
        statuses: list[Status] = []
        for device in self.devices.values():
            blocks += device.read()
            statuses += device.poll()
        return blocks, statuses

    @property
    def asking(self) -> Sequence[Asking]:
        """The devices that ask the person at the console."""
        return [device for device in self.devices.values() if isinstance(device, Asking)]


def opened(name: str, device: Device) -> DeviceInfo:
    """Open a device; what it found.

    Raises:
        KindError: one of the user's own that does not say.
    """
    info: object = device.open()
    if not isinstance(info, DeviceInfo):
        raise KindError(f"devices.{name}: open() returns {info!r}, no DeviceInfo")
    return info


def streams_of(infos: Mapping[str, DeviceInfo]) -> dict[str, StreamInfo]:
    """What opened devices send, by `device.stream`."""
    return {name: stream for info in infos.values() for name, stream in info.streams.items()}

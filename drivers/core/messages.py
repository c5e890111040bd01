"""What travels between the packages: sample blocks up, commands down, statuses back.

All times are bench time: seconds since the present trial began, on the clock that the loop runs on.
Lengths are metres, forces newtons; the unit stands in the name of every scalar.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Values = Floats | Ints | NDArray[np.int32]


@dataclass(frozen=True, slots=True)
class StreamInfo:
    """One stream that a device can send.

    Attributes:
        name: `device.stream`, as profiles write it.
        unit: SI unit of `scale` times a raw count.
        scale: Units per raw count.
        rate_hz: Sample rate; None where samples come at irregular times, each with its own.
        longest_s: Longest time between two samples while all is well; a longer one is a hole. By default one and a half
            of the rate's intervals; None where samples come only on a change, so that silence means nothing.
        noisy: Whether the sensor's own noise moves its raw values all the time, so that one which stands still is
            stuck. A position may stand for as long as it likes.
        tared: Whether its device takes a `Tare` of it, where it is one of forces.
    """

    name: str
    channels: tuple[str, ...]
    unit: str
    scale: float = 1.0
    rate_hz: float | None = None
    longest_s: float | None = None
    noisy: bool = False
    tared: bool = True

    def __post_init__(self) -> None:
        if self.longest_s is None and self.rate_hz is not None:
            object.__setattr__(self, "longest_s", 1.5 / self.rate_hz)

    def block(
        self,
        seq: int,
        t0_s: float,
        values: Values,
        *,
        times_s: NDArray[np.float64] | None = None,
        device_t0_s: float | None = None,
        arrival_s: float | None = None,
    ) -> SampleBlock:
        """Consecutive samples of this stream; see `SampleBlock`."""
        return SampleBlock(
            self.name, seq, t0_s, values, self.rate_hz, times_s, self.unit, self.scale, device_t0_s, arrival_s
        )


@dataclass(frozen=True, slots=True)
class SampleBlock:
    """Consecutive samples of one stream.

    Attributes:
        stream: `device.stream`.
        seq: Number of the first sample since the stream began; a jump is loss. Extended, never wraps.
        values: Shape (n, channels), raw counts or floats.
        rate_hz: Sample rate, or None where `times_s` gives each sample's bench time, shape (n,).
        unit: Unit of `values * scale`.
        device_t0_s: The device's own time of the first sample, unwrapped, before any clock model.
        arrival_s: Bench time at which the host had the whole block in hand.
    """

    stream: str
    seq: int
    t0_s: float
    values: Values
    rate_hz: float | None = None
    times_s: NDArray[np.float64] | None = None
    unit: str = ""
    scale: float = 1.0
    device_t0_s: float | None = None
    arrival_s: float | None = None

    def __len__(self) -> int:
        return len(self.values)

    @property
    def times(self) -> NDArray[np.float64]:
        """Bench time of each sample, shape (n,)."""
        if self.times_s is not None:
            return self.times_s
        rate_hz, tick, since_s = self._grid()
        times_s: NDArray[np.float64] = np.arange(tick, tick + len(self.values))
        times_s /= rate_hz
        if since_s:
            times_s += since_s
        return times_s

    @property
    def last_s(self) -> float:
        """Bench time of the last sample; the block must hold one."""
        if self.times_s is not None:
            return float(self.times_s[-1])
        rate_hz, tick, since_s = self._grid()
        return (tick + len(self.values) - 1) / rate_hz + since_s

    def _grid(self) -> tuple[float, float, float]:
        """Rate, number and time that samples count from: from zero where their times are k / rate, the same to the bit
        however the stream is cut."""
        assert self.rate_hz is not None, f"{self.stream}: neither times nor a rate"
        ticks = self.t0_s * self.rate_hz
        if abs(ticks) < 2**52 and (tick := float(round(ticks))) / self.rate_hz == self.t0_s:
            return self.rate_hz, tick, 0.0
        return self.rate_hz, 0.0, self.t0_s

    def read_only(self) -> SampleBlock:
        """The same samples; who writes to them gets a `ValueError`, for others and the recording have them as well."""
        values, times_s = self.values.view(), None if self.times_s is None else self.times_s.view()
        for array in (values, times_s):
            if array is not None:
                array.flags.writeable = False
        return replace(self, values=values, times_s=times_s)

    @property
    def physical(self) -> NDArray[np.float64]:
        """Values in `unit`, shape (n, channels)."""
        return np.asarray(self.values * self.scale, dtype=np.float64)


# --- commands: imperative, one device each -------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Command:
    """Asks one device for one thing.

    Attributes:
        id: Number that the loop gives it on its way to the device, from 1 within a trial; 0 where it has none.
            What a command asks for is the same under any number.
    """

    device: str
    id: int = field(default=0, kw_only=True, compare=False, repr=False)


@dataclass(frozen=True, slots=True)
class Home(Command):
    """Find the reference position, where the device does not know it yet; answered by `Reached`."""


BLIND_TRAVEL_M = 0.002
"""How far a mover may go unsupervised, unless a profile sets it. Assumption: Table I's fastest
approach (12.7 mm/s; Backus and Dollar) covers it in 0.16 s, and the guard stops what moves when a loop is so late."""


@dataclass(frozen=True, slots=True)
class MoveAt(Command):
    """Move along the device's approach axis at a signed speed, never beyond `limit_m`.

    The device itself holds the limit, and nearer bounds before it: it is never sent farther than `blind_travel_m`
    beyond where it was last seen. A host that dies or is stopped leaves a mover that halts by itself within that; one
    whose controller has a watchdog is stopped by that instead. The guard fills the bound in from the mover's limits.
    """

    velocity_m_s: float
    limit_m: float
    blind_travel_m: float = field(default=BLIND_TRAVEL_M, kw_only=True, repr=False)


@dataclass(frozen=True, slots=True)
class MoveTo(Command):
    """Move to a position on the approach axis at a given (unsigned) speed; `blind_travel_m` as in `MoveAt`."""

    position_m: float
    speed_m_s: float
    blind_travel_m: float = field(default=BLIND_TRAVEL_M, kw_only=True, repr=False)


@dataclass(frozen=True, slots=True)
class Twist(Command):
    """Move the tool at a velocity for a while, then stop; answered by `Reached`.

    Attributes:
        twist: Linear velocity in m/s and angular velocity in rad/s of the tool's point, along the axes of the
            device's base frame.
        duration_s: How long; a newer motion replaces what is left of it.
    """

    twist: tuple[float, float, float, float, float, float]
    duration_s: float


@dataclass(frozen=True, slots=True)
class MovePose(Command):
    """Move the tool in a straight line to a place beside its zero; answered by `Reached`.

    Attributes:
        offset: Where to, as a displacement from the device's start pose (its position 0): metres along the axes of
            its base frame, then a rotation vector in rad, in the base frame as well, applied after the start pose's.
        speed_m_s: Of the tool's point; a move that only turns takes it for rad/s.
    """

    offset: tuple[float, float, float, float, float, float]
    speed_m_s: float


@dataclass(frozen=True, slots=True)
class Lead(Command):
    """Let a person lead the tool by hand, until another command comes; a `Stop` is answered by `Standstill`."""


@dataclass(frozen=True, slots=True)
class Stop(Command):
    """Stop moving, as fast as the device's own limits allow; answered by `Standstill`, moving or not."""


@dataclass(frozen=True, slots=True)
class Grip(Command):
    """Move the jaws towards an opening, pressing no harder than a force; answered by `Gripped`.

    What is in their way they hold. A newer `Grip` replaces an older one: more force on the way to the same
    opening tightens what is held.

    Attributes:
        width_m: Opening to go to: less than the object's width grips it from outside, more from inside.
        force_n: How hard the jaws press at the most.
    """

    width_m: float
    speed_m_s: float
    force_n: float


@dataclass(frozen=True, slots=True)
class Release(Command):
    """Open the jaws as far as they go; answered by `Reached`, where the position is the opening."""

    speed_m_s: float


@dataclass(frozen=True, slots=True)
class Excite(Command):
    """Switch the finger's excitation."""

    on: bool


@dataclass(frozen=True, slots=True)
class Tone(Command):
    """Drive a finger's transducer with one frequency until something else is asked for; `Excite` off ends it.

    Attributes:
        frequency_hz: Of the drive.
        level: Amplitude as a share of full scale, 0 to 1.
    """

    frequency_hz: float
    level: float


@dataclass(frozen=True, slots=True)
class Chirp(Command):
    """Sweep the drive's frequency linearly, once, then be silent; answered by `Reached`, where the position is 0.

    Attributes:
        from_hz: Frequency at the beginning.
        to_hz: Frequency at the end.
        level: Amplitude as a share of full scale, 0 to 1.
    """

    from_hz: float
    to_hz: float
    duration_s: float
    level: float


@dataclass(frozen=True, slots=True)
class SetTendon(Command):
    """Set the tendon's position; 0 is the finger extended."""

    position_m: float


@dataclass(frozen=True, slots=True)
class Tare(Command):
    """Take a stream's present level as its zero."""

    stream: str


@dataclass(frozen=True, slots=True)
class Ask(Command):
    """Ask the person at the bench to do something; answered by `Answered`.

    A newer request to the same person, of either kind, replaces an older one.
    """

    request: str


@dataclass(frozen=True, slots=True)
class LoadWeight(Command):
    """Ask the person at the bench to hang weights on one bridge of a fingertip; answered by `Loaded`.

    Attributes:
        bridge: "x", "y" or "t".
        force_n: What shall hang there when they are done, and nothing anywhere else; 0 takes all away.
    """

    bridge: str
    force_n: float


@dataclass(frozen=True, slots=True)
class Listen(Command):
    """Send these streams (`device.stream`) and no others."""

    streams: frozenset[str]


MOTION = (Home, MoveAt, MoveTo, MovePose, Twist, Lead, Grip, Release)
"""Commands after which a device may be moving."""

ANSWERED = (*MOTION, Stop, Chirp, Ask, LoadWeight)
"""Commands that a later status answers; a newer one to the same device replaces an older one."""


# --- statuses: outcomes of commands, and reports --------------------------------------------------


@dataclass(frozen=True, slots=True)
class Status:
    """Something that a device reported, at bench time `t_s`.

    Attributes:
        command_id: The command that it is about (`Command.id`); 0 where it is about the device and no command.
    """

    t_s: float
    device: str
    command_id: int = field(default=0, kw_only=True)


@dataclass(frozen=True, slots=True)
class Sent(Status):
    """A command left the host (its last byte is written)."""

    command: Command

    def __post_init__(self) -> None:
        object.__setattr__(self, "command_id", self.command.id)


@dataclass(frozen=True, slots=True)
class Reached(Status):
    """A mover reached its target or the limit of a `MoveAt`, and stands still there."""

    position_m: float


@dataclass(frozen=True, slots=True)
class Standstill(Status):
    """A mover stands still after a `Stop`."""

    position_m: float


@dataclass(frozen=True, slots=True)
class Gripped(Status):
    """The jaws stand still after a `Grip`: on an object, or where they were sent.

    A later one with `object` False means that the object is gone.
    """

    object: bool
    width_m: float
    force_n: float


@dataclass(frozen=True, slots=True)
class Answered(Status):
    """The person at the bench has done what they were asked for."""

    request: str


@dataclass(frozen=True, slots=True)
class Loaded(Status):
    """The person at the bench has hung this force on a bridge, and nothing anywhere else."""

    bridge: str
    force_n: float


@dataclass(frozen=True, slots=True)
class Refused(Status):
    """A device rejected a command."""

    command: Command
    reason: str

    def __post_init__(self) -> None:
        object.__setattr__(self, "command_id", self.command.id)


@dataclass(frozen=True, slots=True)
class Stalled(Status):
    """A mover lost its way: stall, displaced, limit error, driver disabled."""

    reason: str


@dataclass(frozen=True, slots=True)
class Lost(Status):
    """Samples of a stream were lost on the way, or a new segment began."""

    stream: str
    samples: int


@dataclass(frozen=True, slots=True)
class Saturated(Status):
    """A stream left its sensor's valid range, at `value` in its unit; reported once for each excursion."""

    stream: str
    value: float


@dataclass(frozen=True, slots=True)
class Failed(Status):
    """The device can no longer be trusted: link gone, silent, another protocol. The run ends."""

    reason: str


ANSWERS = (Reached, Standstill, Gripped, Answered, Loaded)
"""Statuses that answer a command; one that answers an older command than the device's newest ends nothing."""


@dataclass(frozen=True, slots=True)
class DeviceInfo:
    """What `open` found.

    Attributes:
        version: Firmware, or "".
        clock: Name of the clock that stamps its samples.
        details: Limits and settings found or set in the device, for the manifest.
    """

    device: str
    model: str
    serial: str = ""
    version: str = ""
    streams: Mapping[str, StreamInfo] = field(default_factory=dict)
    mover: bool = False
    clock: str = "host"
    details: Mapping[str, object] = field(default_factory=dict)

"""What goes wrong on a bench of software, and when: timed by the scene, unknown to detectors."""

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Annotated, Any, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from drivers.core.clock import VirtualClock
from drivers.core.messages import Command, SampleBlock, Status
from drivers.core.settings import Settings

Kind = Literal[
    "unplug", "silent", "stall", "refuse", "lose", "corrupt", "double", "full_scale",
    "stuck", "wrong", "drift", "late", "nan", "overrun",
    "overheat", "reboot", "restart", "disable",
    "hang", "pause", "abort", "full", "slow",
]  # fmt: skip

SENSED: tuple[Kind, ...] = ("stuck", "wrong", "drift", "late")
"""What any device with streams can show: between its driver and the loop, whatever the driver is."""

READ: tuple[Kind, ...] = ("stuck", "wrong", "drift", "nan")
"""Those that change what is read, each sample by its own time: turns may be taken as one meanwhile."""

OF_THE_BENCH: Mapping[str, tuple[Kind, ...]] = {
    "loop": ("hang",),
    "keys": ("pause", "abort"),
    "disk": ("full", "slow"),
}
"""What is no device and can go wrong: the program's own loop, a person's keys, the disk. All but the last in virtual
time alone."""

INJECTED: tuple[Kind, ...] = ("stall", "refuse", "overheat", "reboot", "restart", "disable")
"""What a device is told when it begins: it knows itself what follows."""

ONCE: tuple[Kind, ...] = (
    "unplug",
    "stall",
    "overheat",
    "reboot",
    "restart",
    "disable",
    "hang",
    "pause",
    "abort",
)
"""What happens at an instant, in the turn that meets it; of these `unplug` alone lasts."""

COMMANDED: tuple[Kind, ...] = ("refuse", "overrun")
"""What shows in what a device does with a command: turns in which none is sent may be taken as one meanwhile."""

AMOUNTS: Mapping[Kind, float] = {
    "wrong": -1.0,
    "drift": 0.001,
    "late": 0.05,
    "overrun": 0.002,
    "hang": 0.2,
    "slow": 0.5,
}
"""How much, where a fault does not say. Assumption: a sensor that is wired the wrong way round; a millimetre or
millinewton a second; a buffer of 50 ms; 2 mm; twice what the guard tolerates of a loop; a disk that wakes up."""


class Fault(Settings):
    """One fault of one device."""

    device: str
    """Name in the profile; "loop" is the program's own loop, "keys" the person at the console, "disk" what the
    run is written to."""

    kind: Kind
    """unplug: the link is gone (`for_s` later it is plugged in again); silent: nothing comes; stall: a mover loses its
    way; refuse: motion is refused; lose: what it sends vanishes; corrupt: bytes are altered on the wire (in process:
    the same as lose); double: bytes come twice; full_scale: its sensors read their negative full scale (on the mock
    bench alone); stuck: they repeat their last value; wrong: they read `amount` times too much; drift: they go away by
    `amount` a second; late: samples and answers come `amount` seconds later; nan: numbers that are none; overrun: a
    mover goes `amount` m farther than it was sent; overheat, reboot, disable (its motor is switched off), restart (its
    sample counters begin anew): what the device itself makes of it; full: nothing can be written any more; slow: what
    is recorded in a turn takes the disk `amount` seconds by the wall; hang: a turn of the loop comes `amount` seconds
    late; pause: Ctrl+C, and Enter at the next turn; abort: Ctrl+C twice."""

    at_s: float = Field(default=0.0, ge=0.0)
    """When it begins, in seconds since the trial began, or since what `after` names."""

    after: Annotated[str, Field(pattern=r"^([A-Z][A-Z_]*|[A-Za-z_]\w* [1-9]\d{0,8})?$")] = ""
    """From when `at_s` counts: the first entry of a state ("APPROACH"), the n-th command to the device ("write 3", or
    of one kind: "MoveAt 2"), or the n-th sample of one of its streams ("load_cell 400"); "" is the trial's begin."""

    for_s: float | None = Field(default=None, gt=0.0)
    """How long it lasts; None is until the end of the trial."""

    every_s: float | None = Field(default=None, gt=0.0)
    """After how long it comes again; None is never."""

    times: int | None = Field(default=None, ge=1)
    """How often it comes, of one that comes again; None is for good."""

    amount: float | None = None
    """How much, where its kind has that; None is the kind's own."""

    trial: int | None = Field(default=None, ge=0)
    """In which trial; None is in every one."""

    @model_validator(mode="after")
    def _periodic(self) -> Self:
        if self.every_s is None and self.times is not None:
            raise ValueError("times needs every_s: after how long it comes again")
        if self.every_s is not None and (self.for_s or math.inf) >= self.every_s:
            raise ValueError("every_s needs for_s, and a shorter one: it must end before it comes again")
        return self

    @property
    def much(self) -> float:
        """How much."""
        return AMOUNTS.get(self.kind, 0.0) if self.amount is None else self.amount

    def phase(self, since_s: float) -> tuple[int, float]:
        """Which time it is, from 0 on, so long after it first began, and how long ago that time began."""
        times = 0 if self.every_s is None else math.floor(since_s / self.every_s)
        if self.times is not None:
            times = min(times, self.times - 1)
        return times, since_s - times * (self.every_s or 0.0)


class FaultSchedule:
    """The faults of one device.

    Args:
        faults: Those of this device alone.
        tell: Is told what has come that a fault counts from: for another schedule, of the same faults.

    Attributes:
        effects: Which faults took effect: trial, and when that was first noticed in it.
    """

    def __init__(self, faults: Sequence[Fault] = (), tell: Callable[[str], None] | None = None) -> None:
        self._all = tuple(faults)
        self._tell = tell
        self.effects: dict[tuple[int | None, Fault], float] = {}
        self.restart()

    def restart(self, trial: int | None = None) -> None:
        """Begin a trial: no fault has begun."""
        self._trial = trial
        self._faults = [fault for fault in self._all if fault.trial is None or fault.trial == trial]
        self._begun: dict[Fault, int] = {}
        self._last: dict[tuple[int, str], NDArray[Any]] = {}
        self._since_s = {"": 0.0}
        self._counts: dict[str, int] = {}
        self._counted = {fault.after for fault in self._faults if " " in fault.after}

    def copy_kept(self) -> Self:
        """Itself, for one without faults does not change; of a bench, one with some is kept by itself."""
        return self

    def add(self, fault: Fault) -> None:
        """One more, in this trial alone."""
        self._faults.append(fault)

    @property
    def any(self) -> bool:
        """Whether there is one, in any trial."""
        return bool(self._all)

    def mark(self, what: str, t_s: float) -> None:
        """What a fault may count from has come at `t_s`: a state, or the n-th of something."""
        if what not in self._since_s and any(fault.after == what for fault in self._faults):
            self._since_s[what] = t_s
            if self._tell is not None:
                self._tell(what)

    @property
    def counts(self) -> bool:
        """Whether one of them counts from the n-th of something."""
        return bool(self._counted)

    def count(self, what: str, times_s: Sequence[float] | NDArray[np.float64]) -> None:
        """More commands or samples of a kind: when each was."""
        if self._counted:
            before = self._counts.get(what, 0)
            self._counts[what] = before + len(times_s)
            for after in self._counted:
                name, _, number = after.partition(" ")
                if name == what and before < int(number) <= before + len(times_s):
                    self.mark(after, float(times_s[int(number) - before - 1]))

    def on(self, t_s: float, *kinds: Kind) -> Fault | None:
        """The first fault of these kinds that is on at `t_s`."""
        for fault in self._faults:
            if fault.kind in kinds and self._on(fault, t_s):
                self._noticed(fault, t_s)
                return fault
        return None

    def active(self, t_s: float, *kinds: Kind) -> bool:
        """Whether a fault of one of these kinds is on at `t_s`; where several are, the first kind has been shown."""
        return bool(self._faults) and any(self.on(t_s, kind) is not None for kind in kinds)

    def begun(self, t_s: float, kind: Kind) -> Fault | None:
        """A fault of this kind that has begun by `t_s`; each is returned once, one that comes again each time."""
        for fault in self._faults:
            since_s = self._since_s.get(fault.after)
            if fault.kind == kind and since_s is not None and since_s + fault.at_s <= t_s:
                times, _ = fault.phase(t_s - since_s - fault.at_s)
                if self._begun.get(fault, -1) < times:
                    self._begun[fault] = times
                    self._noticed(fault, t_s)
                    return fault
        return None

    def quiet_until_s(self, t_s: float) -> float:
        """Until when nothing begins, is on or ends; `t_s` where that is unknown."""
        quiet_s = math.inf
        for fault in self._faults:
            since_s = self._since_s.get(fault.after)
            if fault.kind in READ or fault.kind in COMMANDED:
                continue
            if since_s is None:
                if fault.after in self._counted and fault.after[0].islower() and fault.after[:6] != "write ":
                    return t_s  # the n-th sample; a command is sent in a turn of its own
                continue
            begins_s = since_s + fault.at_s
            if begins_s <= t_s:
                times, ago_s = fault.phase(t_s - begins_s)
                waits = fault.kind in ONCE and self._begun.get(fault, -1) < times
                lasts = fault.kind not in ONCE or fault.kind == "unplug"
                # what came last is on its way for so long
                held_s = fault.much if fault.kind == "late" else 0.0
                if waits or (lasts and ago_s < (fault.for_s or math.inf) + held_s):
                    return t_s
                if fault.every_s is None or times + 1 == fault.times:
                    continue
                begins_s += (times + 1) * fault.every_s
            quiet_s = min(quiet_s, begins_s)
        return quiet_s

    def shown(self) -> list[dict[str, Any]]:
        """The effects, for a manifest."""
        return [
            {"trial": trial, **fault.model_dump(mode="json", exclude_defaults=True), "effect_s": t_s}
            for (trial, fault), t_s in self.effects.items()
        ]

    def seen(self, block: SampleBlock) -> SampleBlock:
        """A block as its sensor reads it, each sample at its own time: stuck, wrong, drifting."""
        if not any(fault.kind in READ for fault in self._faults):
            return block
        values: Any = block.values
        times_s = block.times
        for kind in READ:
            for number, fault in enumerate(self._faults):
                if fault.kind != kind:
                    continue
                ago_s = self._ago_s(fault, times_s)
                on = ago_s >= 0.0
                if on.any() and (kind != "nan" or np.issubdtype(values.dtype, np.floating)):
                    self._noticed(fault, float(times_s[on.argmax()]))
                if kind == "stuck":
                    values = self._held((number, block.stream), values, on)
                elif on.any() and kind == "nan":
                    if np.issubdtype(values.dtype, np.floating):
                        values = np.where(on[:, None], math.nan, values)
                elif on.any() and kind == "wrong":
                    values = _like(values, np.where(on[:, None], values * fault.much, values))
                elif on.any():
                    gone = np.where(on, fault.much * ago_s / block.scale, 0.0)
                    values = _like(values, values + gone[:, None])
        return block if values is block.values else replace(block, values=values)

    def _held(self, which: tuple[int, str], values: NDArray[Any], stuck: NDArray[np.bool_]) -> NDArray[Any]:
        """Values of which the stuck ones repeat the last that was not, by the fault of that number on that stream."""
        free = np.flatnonzero(~stuck)
        last = self._last.setdefault(which, values[0])
        if len(free):
            self._last[which] = values[free[-1]]
        if len(free) == len(values):
            return values
        since = np.maximum.accumulate(np.where(stuck, -1, np.arange(len(values))))
        return np.where((since < 0)[:, None], last, values[since])

    def _ago_s(self, fault: Fault, times_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """How long ago a fault began that is on, at each of these times; NaN where it is not on."""
        since_s = self._since_s.get(fault.after)
        if since_s is None:
            return np.full(len(times_s), math.nan)
        first_s = times_s - since_s - fault.at_s
        times = np.zeros(len(times_s)) if fault.every_s is None else np.floor(first_s / fault.every_s)
        ago_s = first_s - np.minimum(times, (fault.times or math.inf) - 1) * (fault.every_s or 0.0)
        return np.where((first_s >= 0.0) & (ago_s < (fault.for_s or math.inf)), ago_s, math.nan)

    def _on(self, fault: Fault, t_s: float) -> bool:
        since_s = self._since_s.get(fault.after)
        if since_s is None or t_s < since_s + fault.at_s:
            return False
        return fault.phase(t_s - since_s - fault.at_s)[1] < (fault.for_s or math.inf)

    def _noticed(self, fault: Fault, t_s: float) -> None:
        self.effects.setdefault((self._trial, fault), t_s)


def _like(values: NDArray[Any], changed: NDArray[Any]) -> NDArray[Any]:
    """Changed values as the same converter gives them."""
    if not np.issubdtype(values.dtype, np.integer):
        return changed.astype(values.dtype)
    ends = np.iinfo(values.dtype)
    return np.asarray(np.rint(changed).clip(ends.min, ends.max), values.dtype)


class FaultySamples:
    """Goes before a driver's class, real or mock: what the loop gets of it is late or not what the driver made of it.

    Attributes:
        shown_faults: Of its device; set before its first trial.
    """

    shown_faults: FaultSchedule

    def restart(self) -> None:
        """Begin a trial."""
        self._late: list[tuple[float, SampleBlock | Status]] = []
        if hasattr(super(), "restart"):
            super().restart()  # type: ignore[misc]

    def apply(self, command: Command) -> Command:
        """See `Driver.apply`."""
        t_s = self._clock.now()  # type: ignore[attr-defined]
        for what in ("write", type(command).__name__):
            self.shown_faults.count(what, [t_s])
        applied: Command = super().apply(command)  # type: ignore[misc]
        return applied

    def read(self) -> Sequence[SampleBlock]:
        """See `Driver.read`."""
        blocks = []
        for block in super().read():  # type: ignore[misc]
            if len(block):
                if self.shown_faults.counts:
                    self.shown_faults.count(block.stream.partition(".")[2], block.times)
                blocks.append(self.shown_faults.seen(block))
        return self._later(blocks, SampleBlock)

    def poll(self) -> Sequence[Status]:
        """See `Driver.poll`."""
        return self._later(super().poll(), Status)  # type: ignore[misc]

    def _later(self, come: Sequence[Any], what: Any) -> Sequence[Any]:
        """What is due of what has come, in its order; all of it but while it is late."""
        t_s = self._clock.now()  # type: ignore[attr-defined]
        fault = self.shown_faults.on(t_s, "late") if come else None
        if fault is None and not self._late:
            return come
        due_s = max([t_s + (fault.much if fault else 0.0), *(due_s for due_s, _ in self._late)])
        waiting = [*self._late, *((due_s, each) for each in come)]
        due = [each for due_s, each in waiting if due_s <= t_s and isinstance(each, what)]
        self._late = [(due_s, each) for due_s, each in waiting if due_s > t_s or not isinstance(each, what)]
        return due


def faulty(made: type, schedule: FaultSchedule) -> type:
    """A driver's class whose samples and answers the schedule's faults are seen in."""
    return type(made.__name__, (FaultySamples, made), {"shown_faults": schedule})


class FaultyClock(VirtualClock):
    """Time of a bench whose loop comes late.

    Args:
        faults: Of the loop.
    """

    def __init__(self, faults: FaultSchedule) -> None:
        super().__init__()
        self._faults = faults

    def wait_until(self, t_s: float) -> None:
        """See `Clock.wait_until`."""
        fault = self._faults.begun(t_s, "hang")
        super().wait_until(t_s + (fault.much if fault else 0.0))


class Keys:
    """A simulated person at the console: see `LoopOperator.poll`.

    Args:
        faults: When which key is pressed.
    """

    def __init__(self, faults: FaultSchedule, clock: VirtualClock) -> None:
        self._faults, self._clock = faults, clock
        self._last: str | None = None

    def pressed(self) -> str | None:
        """Which key is pressed now; time stands still in a pause, so that it ends when it is next looked at."""
        resumes = self._last == "pause"
        t_s = self._clock.now()
        keys = OF_THE_BENCH["keys"] if self._faults.any else ()
        self._last = next((key for key in keys if self._faults.begun(t_s, key)), None)
        return self._last or ("resume" if resumes else None)


def disk_takes_s(faults: FaultSchedule, t_s: float) -> float:
    """How long the disk is busy with what is recorded at `t_s`; infinite where it takes no more."""
    if faults.active(t_s, "full"):
        return math.inf
    slow = faults.on(t_s, "slow")
    return slow.much if slow else 0.0


def inject_begun(faults: FaultSchedule, device: Any, trial_s: float, t_s: float) -> None:
    """Tell a device at `t_s` what has begun by `trial_s`; one that cannot do it does not."""
    for kind in INJECTED:
        if faults.begun(trial_s, kind) is not None:
            with suppress(ValueError):
                device.inject(kind, t_s)


def corrupted(faults: FaultSchedule, out: bytes, t_s: float, whole: bool = False) -> bytes:
    """What arrives of the bytes that a device has sent at `t_s`; datagrams come `whole` or not at all."""
    if not out:
        return out
    if faults.active(t_s, "silent", "lose"):
        return b""
    if faults.active(t_s, "corrupt"):
        if whole:
            return b""
        return bytes(byte ^ 0x10 if place % 7 == 3 else byte for place, byte in enumerate(out))
    return out + out if faults.active(t_s, "double") else out

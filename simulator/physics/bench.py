"""A bench: parts around one tool that a mover carries, in one time, and what devices are wired to.

A part lets its own time pass, knows where things are and how it acts on the tool; what devices need, each part
offers by name. A bench that profiles name is a function beside its part, as `finger_part.finger_bench`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, Literal, NamedTuple

import numpy as np

from drivers.core.errors import RefusedError
from drivers.core.messages import Floats
from drivers.core.settings import Settings


class StreamSpec(NamedTuple):
    """What a bench's sensor board has of one stream: one raw count is `scale` times `unit`; without a rate it comes as
    events."""

    name: str
    channels: tuple[str, ...]
    unit: str
    scale: float
    rate_hz: float | None


class BenchPart:
    """A part of a bench. What is here is what a part does that has nothing of the kind.

    Args:
        bench: That it becomes a part of, after those that it depends on.
    """

    offers: ClassVar[tuple[str, ...]] = ()
    """What devices, and the scoring of a trial, may get from the bench."""

    def __init__(self, bench: Bench) -> None:
        self.bench = bench
        bench.add(self)

    def warm_up(self) -> None:
        """Let compiled code load, or compile on first use, before an answer is due."""

    def restart(self) -> None:
        """Time begins anew."""

    def check(self, settings: Any, factors: Mapping[str, Any]) -> None:
        """See that a trial can be; nothing is computed.

        Raises:
            RefusedError: it cannot.
        """

    def begin(self, settings: Any, factors: Mapping[str, Any]) -> None:
        """Be as a trial begins that can be, at the bench's present time."""

    def advance(self, t_s: float) -> None:
        """Let the part's own time pass until `t_s`, which is later than the bench's."""

    def replan(self) -> None:
        """The tool's motion has changed at the bench's present time."""

    def wrench(self, times_s: Floats, direction: Sequence[float]) -> Floats:
        """What it does to the tool; see `Bench.wrench`."""
        return np.zeros((len(times_s), 6))

    def excite(self, on: bool) -> None:
        """The board switches what it excites: nothing."""

    def set_tendon(self, position_m: float) -> None:
        """The board sets a tendon: there is none."""

    def events(self, stream: str) -> tuple[Floats, Floats]:
        """Times and values of an irregular stream of the board since the last call, shapes (n,): it has none."""
        return np.empty(0), np.empty(0)

    def scene(self, t_s: float) -> Mapping[str, float]:
        """Where things stand."""
        return {}

    def account(self) -> Mapping[str, Any]:
        """What it computed."""
        return {}


class Bench:
    """Parts around one tool. Its time is the devices', continuous from trial to trial.

    Args:
        settings: Of the plant; a trial's may differ.
        tool: What the mover carries, for messages.
        one_axis: Why a mover along one axis alone is not enough, for messages; "" where it is.

    Attributes:
        t_s: How far time has passed here.
        key: Seed of the run and number of the trial, which key every noise.
        observed: What the sensor board and others read of the sensors.
        felt: Whether the mover's own force sensor is read.
    """

    def __init__(self, settings: Settings, tool: str, one_axis: str = "") -> None:
        self.t_s = self.origin_s = 0.0
        self.key = (0, 0)
        self.observed: frozenset[str] = frozenset()
        self._read: dict[str, frozenset[str]] = {}
        self.felt = False
        self.mover: Any = None
        self._settings = settings
        self._tool, self._one_axis = tool, one_axis
        self._parts: list[BenchPart] = []

    def add(self, part: BenchPart) -> None:
        """One more part; what it offers, no other may."""
        taken = {name for other in self._parts for name in other.offers} & set(part.offers)
        assert not taken, taken
        self._parts.append(part)

    def __getattr__(self, name: str) -> Any:
        """What one of the parts offers."""
        for part in self.__dict__.get("_parts", ()):
            if name in part.offers:
                return getattr(part, name)
        raise AttributeError(f"this bench has no {name}")

    def warm_up(self) -> None:
        """Let compiled code load, or compile on first use, before an answer is due."""
        for part in self._parts:
            part.warm_up()

    def mount(self, carrier: Any) -> None:
        """Fix the tool to what carries it: it has `place`, `position`, `velocity` and `pieces` of `StageAxis`, and
        `ToolTrack.offsets` where one axis will not do.

        Raises:
            RefusedError: something carries it already, or the mover cannot do what this bench needs.
        """
        if self.mover is not None:
            advice = 'leave one mover on this bench: devices.NAME = "none" takes another away'
            raise RefusedError(self._tool, "being mounted", "another mover carries it already", advice)
        if self._one_axis and not hasattr(carrier, "offsets"):
            advice = 'take an arm: driver = "ur_arm"'
            raise RefusedError(self._tool, "being mounted", self._one_axis, advice)
        self.mover = carrier

    def restart(self) -> None:
        """Time begins anew: the tool stands at its start pose."""
        self.origin_s = 0.0
        self._read = {}
        for part in self._parts:
            part.restart()
        if self.mover is not None:
            self.mover.place(0.0, 0.0)

    def begin(
        self, t_s: float, seed: int, trial: int, factors: Mapping[str, Any], plant: Mapping[str, Any]
    ) -> None:
        """Put the bench into a trial's scene at time `t_s`: the tool is where it is.

        Args:
            seed: Of the run; keys the noise together with `trial`.
            factors: Its factors; those that are settings of this plant stand before the plant section.
            plant: The profile's plant section for this trial.

        Raises:
            RefusedError: a part cannot be so.
        """
        settings = self.check(factors, plant)
        self.t_s = self.origin_s = t_s
        self.key = (seed, trial)
        self.observed = self._others()
        for part in self._parts:
            part.begin(settings, factors)

    def check(self, factors: Mapping[str, Any], plant: Mapping[str, Any]) -> Any:
        """The settings of a trial that can be; arguments and errors as of `begin`."""
        known = type(self._settings).model_fields
        chosen = {name: value for name, value in factors.items() if name in known and value is not None}
        settings = type(self._settings).model_validate({**plant, **chosen})
        for part in self._parts:
            part.check(settings, factors)
        return settings

    def on_plan(self, t_s: float) -> None:
        """The tool's motion changes at `t_s`, or changed there already where time has passed it."""
        self.advance(t_s)
        for part in self._parts:
            part.replan()

    def feel(self, on: bool) -> None:
        """Whether the mover's own force sensor is read."""
        self.felt = on

    def read(self, device: str, streams: frozenset[str]) -> None:
        """What another device than the board reads of the same sensors, from now on."""
        self._read[device] = streams
        self.observed |= streams

    def _others(self) -> frozenset[str]:
        return frozenset().union(*self._read.values())

    def advance(self, t_s: float, observe: frozenset[str] | None = None) -> None:
        """Let time pass until `t_s`; `observe` names the board's subscribed streams, None those of last
        time."""
        if observe is not None:
            self.observed = observe | self._others() if self._read else observe
        if t_s <= self.t_s:
            return
        for part in self._parts:
            part.advance(t_s)
        self.t_s = t_s

    def places(self, times_s: Floats) -> Floats:
        """Displacement of the tool from its start pose, m, and its turn, rad, shape (n, 6)."""
        if self.mover is None:
            return np.zeros((len(times_s), 6))
        found: Floats = self.mover.offsets(times_s)
        return found

    def wrench(self, times_s: Floats, direction: Sequence[float]) -> Floats:
        """What the bench does to the tool at instants of the last advance, base axes, N and N m, shape (n, 6).

        Args:
            times_s: Shape (n,).
            direction: The approach direction, unit vector in the base frame.
        """
        found: Floats = sum(
            (part.wrench(times_s, direction) for part in self._parts), start=np.zeros((len(times_s), 6))
        )
        return found

    def scene(self, t_s: float) -> Mapping[str, float]:
        """Where things stand: what a person at the bench would see."""
        return {name: value for part in self._parts for name, value in part.scene(t_s).items()}

    def account(self) -> Mapping[str, Any]:
        """What was computed."""
        return {name: value for part in self._parts for name, value in part.account().items()}


PARTS = {
    "jaws": ("the jaws of a gripper", "aura"),
    "forces_n": ("the fingers of a hand", "slip"),
    "texels_v": ("tactile matrices", "slip"),
    "carrier": ("fingers that sound", "aura"),
    "streams": ("the sensors of a board", "finger"),
    "load": ("a fingertip for weights", "slip"),
    "excite": ("anything that is excited", "finger"),
}
"""What a device may look for on a bench, and a kind of plant that has it."""


def part(
    bench: object,
    name: Literal["jaws", "forces_n", "texels_v", "carrier", "streams", "load", "excite"],
    device: str,
) -> Any:
    """What a device is wired to.

    Args:
        device: Name of the device that needs it.

    Raises:
        RefusedError: this bench has none.
    """
    if hasattr(bench, name):
        return getattr(bench, name)
    what, kind = PARTS[name]
    advice = f'choose a plant that has them (kind = "{kind}"), or devices.NAME = "none" takes it away'
    raise RefusedError(device, "being wired to the bench", f"this bench does not have {what}", advice)

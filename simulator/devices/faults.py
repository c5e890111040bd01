"""What goes wrong on a bench of software, and when: timed by the scene, unknown to detectors."""

import math
from collections.abc import Sequence
from contextlib import suppress
from typing import Any, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from drivers.core.messages import Failed
from drivers.core.settings import DeviceName, Settings

Kind = Literal["unplug", "silent", "stall", "refuse", "lose", "corrupt", "full_scale", "stuck"]


Number = TypeVar("Number", bound=np.generic)


class Fault(Settings):
    """One fault of one device."""

    device: DeviceName
    """Name in the profile."""

    kind: Kind
    """unplug: the link is gone; silent: nothing comes; stall: a mover loses its way; refuse: motion is refused;
    lose: what it sends vanishes; corrupt: bytes are altered on the wire (in process: the same as lose); full_scale: its
    sensors read their negative full scale; stuck: they repeat their last value (both on the mock bench alone)."""

    at_s: float = Field(ge=0.0)
    """When it begins, in seconds since the trial began."""

    for_s: float | None = Field(default=None, gt=0.0)
    """How long it lasts; None is until the end of the trial."""

    trial: int | None = Field(default=None, ge=0)
    """In which trial; None is in every one."""


class FaultSchedule:
    """The faults of one device.

    Args:
        faults: Those of this device alone.
    """

    def __init__(self, faults: Sequence[Fault] = ()) -> None:
        self._all = tuple(faults)
        self.restart()

    def restart(self, trial: int | None = None) -> None:
        """Begin a trial: no fault has begun."""
        self._faults = [fault for fault in self._all if fault.trial is None or fault.trial == trial]
        self._begun: set[Fault] = set()
        self._last: dict[str, NDArray[Any]] = {}

    def add(self, fault: Fault) -> None:
        """One more, in this trial alone."""
        self._faults.append(fault)

    @property
    def any(self) -> bool:
        """Whether there is one in this trial."""
        return bool(self._faults)

    def active(self, t_s: float, kind: Kind) -> bool:
        """Whether a fault of this kind is on at `t_s`."""
        return bool(self._faults) and any(
            fault.kind == kind and fault.at_s <= t_s < fault.at_s + (fault.for_s or math.inf)
            for fault in self._faults
        )

    def held(self, t_s: float, stream: str, values: NDArray[Number]) -> NDArray[Number]:
        """What a sensor reads in place of `values`, shape (n, channels), the last of them at `t_s`: while it is stuck,
        the last value from before."""
        if not self.active(t_s, "stuck"):
            self._last[stream] = values[-1]
            return values
        held = np.empty_like(values)
        held[:] = self._last.get(stream, 0)
        return held

    def begun(self, t_s: float, kind: Kind) -> Fault | None:
        """A fault of this kind that has begun by `t_s`; each is returned once."""
        for fault in self._faults:
            if fault.kind == kind and fault.at_s <= t_s and fault not in self._begun:
                self._begun.add(fault)
                return fault
        return None

    def failure(self, t_s: float, device: str) -> Failed | None:
        """What a driver reports when the plug is pulled; once."""
        fault = self.begun(t_s, "unplug")
        if fault is None:
            return None
        return Failed(t_s, device, f"the link is gone ({fault.kind} injected at {fault.at_s:g} s)")


def inject_begun(faults: FaultSchedule, device: Any, trial_s: float, t_s: float) -> None:
    """Let a device stall or refuse at `t_s` where that has begun by `trial_s`; one that cannot does not."""
    for kind in ("stall", "refuse"):
        if faults.begun(trial_s, kind) is not None:
            with suppress(ValueError):
                device.inject(kind, t_s)


FRAME_FAULTS = ("drop", "flip", "truncate")


class FrameFaults:
    """What happens to the next frames that a device sends: dropped, one bit flipped, or truncated."""

    def __init__(self) -> None:
        self._next: list[str] = []
        self._flips = 0

    def add(self, kind: str, frames: int) -> None:
        """So many more."""
        self._next += [kind] * frames

    def sent(self, frame: bytes, delimiter: int = 0) -> bytes:
        """What is sent of a frame; no bit is flipped in its `delimiter`, the last bytes."""
        kind = self._next.pop(0) if self._next else None
        if kind == "drop":
            return b""
        if kind == "truncate":
            return frame[: len(frame) // 2]
        if kind == "flip":
            self._flips += 1
            byte, bit = divmod(37 * self._flips % (8 * (len(frame) - delimiter)), 8)
            return frame[:byte] + bytes([frame[byte] ^ 1 << bit]) + frame[byte + 1 :]
        return frame


def corrupted(faults: FaultSchedule, out: bytes, t_s: float, whole: bool = False) -> bytes:
    """What arrives of the bytes that a device has sent at `t_s`; datagrams come `whole` or not at all."""
    if faults.active(t_s, "silent") or faults.active(t_s, "lose"):
        return b""
    if faults.active(t_s, "corrupt"):
        if whole:
            return b""
        return bytes(byte ^ 0x10 if place % 7 == 3 else byte for place, byte in enumerate(out))
    return out

"""What emulated devices share, and what every far end of a wire does: faults of the line and of the device."""

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any, ClassVar

from drivers.core.clock import Clock
from simulator.devices.faults import FaultSchedule, inject_begun


class EmulatedDevice:
    """A device made of software, without a port or a clock: bytes in, bytes out, and time from outside. A node on a bus
    has frames in their place."""

    called: ClassVar[str]
    """What it is, in a sentence."""

    def __init__(self) -> None:
        self._outbox = b""

    def receive(self, data: Any, t_s: float) -> Any:
        """Take what the host sends at `t_s`; returns what was due until then and what is answered at once."""
        raise NotImplementedError

    def step(self, t_s: float) -> Any:
        """What it sends by `t_s` on its own."""
        self._run(t_s)
        return self._take(t_s)

    def inject(self, kind: str, t_s: float) -> None:
        """Break it at `t_s` in one of the ways that it has of its own.

        Raises:
            ValueError: it has no such way.
        """
        self._run(t_s)
        ways = self._ways(t_s)
        if kind not in ways:
            raise ValueError(
                f"{self.called} has no fault {kind!r} of its own; it has {', '.join(ways) or 'none'}"
            )
        ways[kind]()

    def _ways(self, t_s: float) -> Mapping[str, Callable[[], object]]:
        """In which ways it can break at `t_s`; what befalls its line is `faults.corrupted`."""
        return {}

    def _run(self, t_s: float) -> object:
        """Let time pass until `t_s`."""

    def _take(self, t_s: float) -> bytes:
        sent, self._outbox = self._outbox, b""
        return sent


class FarEnd:
    """One device's end of the wire.

    Attributes:
        endpoint: Where the host finds it: settings of its driver.
    """

    endpoint: Mapping[str, Any]

    _faults = FaultSchedule()
    _t_s = 0.0  # of the latest exchange

    def open(self, faults: FaultSchedule, clock: Clock) -> None:
        """Accept the host; times come from `clock`, what goes wrong from `faults`."""
        self._faults = faults

    def waited(self) -> Sequence[Any]:
        """What to select on."""
        return ()

    def due_s(self) -> float:
        """When it has something to do by itself that is worth waking up for."""
        return math.inf

    def exchange(self, ready: Collection[Any], t_s: float, trial_s: float) -> bool:
        """Let the faults happen that have begun, and carry bytes both ways.

        Args:
            ready: What of `waited` can be read.
            trial_s: Present time since the trial began, as faults count it.

        Returns:
            False where nobody is served: the emulator may take longer steps.
        """
        self._t_s = t_s
        if self._faults.begun(trial_s, "unplug"):
            self.unplug()
        inject_begun(self._faults, self, trial_s, t_s)
        return self._carry(ready, t_s, trial_s)

    def _carry(self, ready: Collection[Any], t_s: float, trial_s: float) -> bool:
        """Carry bytes both ways: see `exchange`."""
        raise NotImplementedError

    def inject(self, kind: str, t_s: float) -> None:
        """Break the device: see `EmulatedDevice.inject`."""
        raise NotImplementedError

    def unread(self) -> bool:
        """Whether the host has bytes before it that it has not read."""
        return False

    def unplug(self) -> None:
        """Disconnect; may be called twice."""
        raise NotImplementedError

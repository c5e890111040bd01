"""Every mover of a bench stopped from a fresh process, beside whatever runs; of each, whether it stands still."""

from collections import defaultdict
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from threading import Lock
from typing import Any

from controller.by_hand import HandSession, unwatched
from controller.holding import Addresses, Holder, holders
from drivers.core.errors import DeviceError

SOON_S, PATIENCE_S = 1.0, 10.0
"""How long a program that has the bench may take to end: before an arm is stopped past it, and before it counts as
hanging. Assumption: a loop stops within a turn; closing waits 2 s for standstill, and for the disk."""

NOT_KNOWN = "whether it stands still is not known: look at the bench"


class Stopping:
    """Stops the movers of a bench.

    Args:
        profile: Whose runs are stopped, wherever their devices are; "" where the addresses alone tell.
        where: The movers' addresses, as far as they are known.
        entries: By mover what the profile has of it: `made` and `settings`.
        open_one: A session with one mover, which closes; None where its bench ends with its program.
    """

    def __init__(
        self,
        profile: str,
        where: Addresses,
        entries: Mapping[str, Any],
        say: Callable[[str], None],
        open_one: Callable[[str], HandSession] | None,
    ) -> None:
        self._entries = entries
        self._say = say
        self._open_one = open_one
        self._holders = list(holders(profile, where))
        lines: defaultdict[str, Lock] = defaultdict(Lock)
        self._line = {name: lines[str(where.get(name, name))] for name in entries}

    def run(self) -> bool:
        """Stop them, all at once, since a silent one takes its time; whether each is known to stand still."""
        for holder in self._holders:
            self._say(f"{holder} is asked to stop")
            holder.ask()
        for holder in self._holders:
            holder.ended(SOON_S)
        self._asides = {name: self._aside(name) for name in self._entries}
        with ThreadPoolExecutor(max(1, len(self._entries))) as pool:
            found = list(pool.map(self._stopped, self._entries))
        for name, (still, line) in zip(self._entries, found, strict=True):
            self._say(f"{name}: {line}" if still else f"{name}: NOT seen standing still: {line}")
        return all(still for still, _ in found)

    def _stopped(self, name: str) -> tuple[bool, str]:
        holder, aside = self._holder(name), self._asides[name]
        if holder is not None:
            if not holder.ended(0.0 if aside else PATIENCE_S):
                return aside or (False, self._hangs(name, holder))
            if self._open_one is None:
                return self._told(name, holder)
        if self._open_one is None:
            return True, "no program has this bench, which is simulated: nothing moves"
        return self._from_here(name)

    def _holder(self, name: str) -> Holder | None:
        return next((each for each in self._holders if name in each.devices), None)

    def _aside(self, name: str) -> tuple[bool, str] | None:
        """What became of a stop past the program that has the mover: whether it stands still, and how that is known;
        None where that has ended, or there is no such way."""
        entry, holder = self._entries[name], self._holder(name)
        stop_beside = getattr(entry.made, "stop_beside", None)
        if stop_beside is None or holder is None or holder.ended(0.0):
            return None
        reason = stop_beside(entry.settings.model_copy(update=dict(holder.devices[name])))
        if reason:
            return False, f"{reason}; press the emergency stop"
        told = f"its controller was told to stop, and it stands still; {holder} does not end"
        return True, f"{told}: kill -9 {holder.pid}"

    def _hangs(self, name: str, holder: Holder) -> str:
        port = ", ".join(str(each) for each in holder.devices[name].values())
        return f"{port} is held by {holder}, which does not end: press the emergency stop, then: kill -9 {holder.pid}"

    def _told(self, name: str, holder: Holder) -> tuple[bool, str]:
        """What a program said at its end of a bench that has ended with it."""
        if holder.not_at_rest is None:
            return False, f"{holder} has ended without a word; {NOT_KNOWN}"
        if name in holder.not_at_rest:
            return False, f"{holder} has stopped it; look at the bench"
        return True, f"stopped by {holder}, which saw its movers stand still"

    def _from_here(self, name: str) -> tuple[bool, str]:
        """Open it, stop it, see it stand; movers on one line one after the other."""
        try:
            with self._line[name], self._open_one(name) as session:  # type: ignore[misc]
                if name not in session.movers:
                    return True, "does not move by itself"
                result = session.run(lambda event: None, name, limits=unwatched(session.limits))
                if result.outcome == "done":
                    return True, "stopped, and stands still"
                return False, result.reason
        except DeviceError as error:
            return self._refused(name, error)

    def _refused(self, name: str, error: DeviceError) -> tuple[bool, str]:
        """A mover that does not open may be stopped past its driver."""
        entry = self._entries[name]
        stop_beside = getattr(entry.made, "stop_beside", None)
        reason = stop_beside(entry.settings) if stop_beside else "nothing else reaches it"
        if reason:
            return False, f"{error}; {reason}: press the emergency stop if it moves"
        return True, f"its controller was told to stop, and it stands still ({error})"

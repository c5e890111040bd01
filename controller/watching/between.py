"""Between two trials: a campaign that is held there, and what those who watch have done by hand meanwhile."""

from collections.abc import Callable, Iterator, Mapping
from typing import Any

from controller import by_hand
from controller.console import PAUSED, ConsoleOperator
from controller.loop import Aborted


class Between:
    """Whether a campaign is to be held before its next trial, and what is asked for there: `home` and `tare`.

    Within a trial both are refused: its behavior counts on where things stand.

    Args:
        poll: Polls the person, and shows them how it stands.
    """

    def __init__(
        self, operator: ConsoleOperator, poll: Callable[[], str | None], show: Callable[[str, float], None]
    ) -> None:
        self._operator, self._poll, self._show = operator, poll, show
        self.possible = self.hold = False
        self._offer: Mapping[str, list[str]] = {}
        self._asked: tuple[str, str] | None = None
        self._doing = self._resumed = self._aborted = False
        self._said = ""

    # on the publishing thread

    def ask(self, do: str, target: str, on: bool = True) -> str:
        """`hold` (no longer where not `on`), `home` of a mover or `tare` of a stream; returns why it is refused."""
        if do == "hold":
            if not self.possible:
                return "hold: the trials of this run are computed elsewhere; nothing is held between them"
            self.hold = on
            return ""
        if not self._offer:
            return f"{do}: a trial runs; hold the run after it first"
        if self._asked is not None:
            return f"{do}: {' '.join(self._asked)} is still being done"
        if target not in self._offer[do]:
            return f"{do}: it is offered for {', '.join(self._offer[do]) or 'nothing here'}"
        self._asked = do, target
        return ""

    def news(self) -> dict[str, Any]:
        """For the page."""
        doing = " ".join(self._asked) if self._asked else ""
        news = {"possible": self.possible, "hold": self.hold, "offer": self._offer}
        return {**news, "doing": doing, "said": self._said}

    # on the loop's thread

    def wait(self, session: by_hand.HandSession) -> Iterator[tuple[str, by_hand.HandResult]]:
        """Hold until the person goes on; gives what was done and how it ended.

        Raises:
            Aborted: they end the run.
        """
        self._resumed = self._aborted = False
        self._operator.press("pause", "the live page, between two trials")
        self._show(PAUSED, 0.0)
        self._offer = {
            "home": list(session.movers),
            "tare": [each.name for each in by_hand.forces(session.infos)],
        }
        self._said = ""
        try:
            while True:
                for _ in session.listen(()):  # what is sent meanwhile is taken, and watchdogs are fed
                    pass
                if self._aborted:
                    raise Aborted
                if self._asked is None:
                    return
                self._doing = True
                yield self._done(session, *self._asked)
                self._doing, self._asked = False, None
        finally:
            self._offer, self.hold, self._asked, self._doing = {}, False, None, False

    def _done(self, session: by_hand.HandSession, do: str, target: str) -> tuple[str, by_hand.HandResult]:
        if do == "home":
            result = by_hand.home(session, target, by_hand.HOME_S)
        else:
            result, _ = by_hand.tare(session, target)
        self._said = f"{do} {target}: {result.reason or result.outcome}"
        return f"{do} {target}", result

    def poll(self) -> str | None:
        """For the session: "abort" ends what it does, or its waiting."""
        request = self._poll()
        self._aborted |= request == "abort"
        self._resumed |= request == "resume"
        awaited = not self._doing and (self._resumed or self._asked is not None)
        return "abort" if self._aborted or awaited else None

    def suspend(self) -> None:
        """The terminal's; here it is only paused."""

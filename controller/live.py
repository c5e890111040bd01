"""A campaign as a live view on a terminal."""

from collections.abc import Callable, Collection, Iterable, Sequence
from contextlib import suppress
from pathlib import Path
from queue import Empty, Queue
from textwrap import wrap
from threading import Thread

from rich.console import Console as Terminal
from rich.live import Live
from rich.text import Text

from controller.console import LAST_S, PAUSED, Console, ConsoleOperator, key_results
from controller.outcomes import UNMEASURED, counted, is_success
from controller.scales import Scale, scale_of
from drivers.core.clock import monotonic_s

REFRESH_S = 0.2
"""Shortest time between two drawings. Each takes the loop 0.2 ms and the thread that draws 0.9 ms (measured), as it is
plain text; a table of rich's takes 4 ms, and the loop would wait for Python's lock that long."""

ANSWER_S = 0.2
"""Longest time until a key that was pressed is answered, while the loop hands over no picture."""

ROWS = 8
"""How many of the last trials are shown: with the rest, they fit into 24 lines."""

BAR = 24
"""Width of the progress bar, in characters."""

NUMBER, OUTCOME = 8, 13
"""Least width of a column of numbers, which every number fits into, and of the outcomes, in characters."""

GAP = 2
"""Characters between two columns."""

_GOOD, _MISSED, _BAD = "green", "yellow", "red"
"""Colours of a trial that succeeded, of one that did not, and of one that was broken off."""


class Drawer:
    """Draws in a thread of its own: a terminal that takes nothing holds up that thread and no other.

    Args:
        pressed: What was pressed and not heeded yet, as a line; shown even while no picture is handed over.
    """

    def __init__(self, terminal: Terminal, pressed: Callable[[], str] = str) -> None:
        self._terminal = terminal
        self._pressed = pressed
        self._pictures: Queue[tuple[Text, bool]] = Queue(maxsize=1)  # each, and whether it is the last
        # A thread that is held up may outlive the campaign, but not the program.
        self._thread = Thread(target=self._draw, name="live view", daemon=True)
        self._thread.start()

    def show(self, picture: Text, last: bool = False) -> None:
        """Hand over a picture, in the place of one that is not drawn yet. Never waits."""
        with suppress(Empty):
            self._pictures.get_nowait()
        self._pictures.put_nowait((picture, last))

    def end(self, picture: Text) -> None:
        """Draw for the last time; a terminal that takes nothing is waited for no longer than `LAST_S`."""
        self.show(picture, last=True)
        self._thread.join(LAST_S)

    def _draw(self) -> None:
        picture, last, drawn = Text(), False, None
        with suppress(OSError), Live(console=self._terminal, auto_refresh=False) as live:  # it may hang up
            while not last:
                with suppress(Empty):  # a loop that loads what it computes with hands none over
                    picture, last = self._pictures.get(timeout=ANSWER_S)
                said = "" if last else self._pressed()
                if drawn != (picture, said):
                    drawn = picture, said
                    shown = [picture, Text(said, "bold yellow")] if said else [picture]
                    live.update(Text("\n").join(shown), refresh=True)


class LiveConsole(Console):
    """Trial, state, time and the last results, drawn anew a few times a second.

    The picture is made when the loop polls, never between a decision and its command, and drawn by a thread: the
    loop waits for no terminal.
    """

    def __init__(
        self, operator: ConsoleOperator, terminal: Terminal, successes: Collection[str] | None = None
    ) -> None:
        super().__init__(operator, successes)
        self._operator = operator
        self._terminal = terminal
        self._drawn_s = monotonic_s()
        self._drawer: Drawer | None = None

    def campaign_started(self, title: str, trials: int, folder: Path) -> None:
        """Begins to draw."""
        super().campaign_started(title, trials, folder)
        self._drawer = Drawer(self._terminal, self._operator.pressed_yet)
        self._refresh()

    def poll(self) -> str | None:
        """Shows how it stands where it is time to, and polls the operator."""
        if monotonic_s() - self._drawn_s > REFRESH_S:
            self._refresh()
        return super().poll()

    def suspend(self) -> None:
        """Leaves the terminal to the shell meanwhile."""
        if self._drawer is not None:
            self._drawer.end(self._picture())
        super().suspend()
        if self._drawer is not None:
            self._drawer = Drawer(self._terminal, self._operator.pressed_yet)

    def campaign_ended(self, line: str) -> None:
        """Draws for the last time."""
        super().campaign_ended(line)
        if self._drawer is not None:
            self._drawer.end(self._picture())
            self._drawer = None

    def _refresh(self) -> None:
        self._drawn_s = monotonic_s()
        if self._drawer is not None:
            self._drawer.show(self._picture())

    # the picture

    def _picture(self) -> Text:
        lines = [self._header(), self._progress(), Text(), *self._table(), Text(), *self._present()]
        return Text("\n", no_wrap=True, overflow="ellipsis").join(lines)

    def _header(self) -> Text:
        return Text.assemble((self.title, "bold"), "  ", (str(self.folder), "dim"))

    def _progress(self) -> Text:
        done, elapsed_s = self.counts.total(), monotonic_s() - self.begun_s
        filled = BAR * done // max(self.count, 1)
        left_s = self.left_s if self.present.trial is not None else None
        left = "" if left_s is None else f"  about {_clock(left_s)} left"
        return Text.assemble(
            ("━" * filled, "cyan"),
            ("─" * (BAR - filled), "bright_black"),
            f"  {done} of {self.count} trials  {_clock(elapsed_s)}",
            (left, "dim"),
        )

    def _table(self) -> list[Text]:
        if not self.rows:
            return []
        last = [*self.rows][-ROWS:]
        _, factors, _, results = last[-1]
        names, found = [_scales(columns) for columns in (factors, key_results(results))]
        heads, more = ([scale.heading for scale in scales.values()] for scales in (names, found))
        rows = [["trial", *heads, "outcome", *more]]
        for trial, values, outcome, row in last:
            cells, more = (
                [scale.cell(of.get(name), NUMBER) for name, scale in scales.items()]
                for scales, of in ((names, values), (found, row))
            )
            rows.append([str(trial), *cells, outcome.replace("_", " "), *more])
        least = [0, *[NUMBER] * len(names), OUTCOME, *[NUMBER] * len(found)]
        widths = [max(size, *map(len, cells)) for size, *cells in zip(least, *rows, strict=True)]
        # Results that a narrow terminal has no room for are left out whole.
        while sum(widths) + GAP * (len(widths) - 1) > self._terminal.width and len(widths) > len(names) + 2:
            widths.pop()
        styles = ["dim", *(self._style(outcome) for _, _, outcome, _ in last)]
        left = len(names) + 1
        return [Text(_row(row, widths, left), style) for row, style in zip(rows, styles, strict=True)]

    def _style(self, outcome: str) -> str:
        if outcome in UNMEASURED:
            return _BAD
        return _GOOD if is_success(outcome, self.successes) else _MISSED

    def _present(self) -> list[Text]:
        number, values, name, t_s = self.present
        if number is None:
            return []
        counts = Text(counted(self.counts, self.successes))
        scales = _scales(values)
        factors = "  ".join(scales[key].said(value) for key, value in values.items())
        stay = f" since {t_s:.2f} s, for {monotonic_s() - self.entered_s:.0f} s" if name else ""
        trial = (f"trial {number}", "bold")
        now = Text.assemble(trial, "  ", (name, "cyan"), (stay, "dim"), f"  {factors}")
        seen = [Text(line, "dim") for line in self.view.lines(self._terminal.width)] if self.view else []
        if name == PAUSED:
            hint = "paused: nothing moves, all is watched. Enter goes on, Ctrl+C aborts"
        elif (question := self._operator.question) is not None:
            hint = question.text
        else:
            return [now, *seen, counts, Text("Ctrl+C pauses", "dim")]
        return [now, *seen, counts, *(Text(line, "bold yellow") for line in wrap(hint, self._terminal.width))]


def _scales(columns: Iterable[str]) -> dict[str, Scale]:
    """The scale of each column; a setting's path by its last part, for want of room."""
    return {name: scale_of(name.rpartition(".")[2]) for name in columns}


def _row(cells: Sequence[str], widths: Sequence[int], left: int) -> str:
    """As many cells as there are widths side by side, to the right; the one numbered `left` to the left."""
    return (" " * GAP).join(
        cell.ljust(width) if place == left else cell.rjust(width)
        for place, (cell, width) in enumerate(zip(cells, widths, strict=False))
    )


def _clock(seconds: float) -> str:
    minutes, rest = divmod(int(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{rest:02}" if hours else f"{minutes}:{rest:02}"

"""What a person sees of a bench by hand: its streams and margins, drawn on a terminal or printed line by line."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from textwrap import wrap

import numpy as np
from rich.console import Console as Terminal
from rich.text import Text

from controller.by_hand import HandSession
from controller.jogging import HOLD_S, Motions
from controller.limits import GuardSettings, shown_limits
from controller.live import REFRESH_S, Drawer
from controller.scales import displayed, figure, shown_in
from drivers.core.clock import monotonic_s

PRINT_S = 1.0
"""How often values are printed where no terminal is drawn on."""

CHANNELS = 3
"""How many channels of a stream are shown; of the others the number."""

WIDTH, NARROW = 78, "\u00a0"
"""Characters in a line of keys, and what keeps a key and its meaning together."""

HEADING = ("stream", "value", "unit", "limit", "rate", "age", "noise", "lost")

VALUE, LEAST = 8, (12, 8, 4, 5, 7, 5, 6, 4)
"""Characters of a number, and least widths of the columns: what is read at a glance stays where it is."""

AGED_S = 1.0
"""A stream without a sample for so long is shown as silent."""


class HandScreen:
    """Shows lines, now and then, and waits for no terminal. Use as a context manager: whatever ends it, the terminal is
    as it was.

    Args:
        terminal: Where to draw; None prints.
        lines: Makes the lines, as they are now.
    """

    def __init__(
        self, terminal: Terminal | None, show: Callable[[str], None], lines: Callable[[], Sequence[str]]
    ) -> None:
        self._drawer = Drawer(terminal) if terminal else None
        self._print, self._lines = show, lines
        self._shown = Text()
        self._due_s = -math.inf

    def __enter__(self) -> HandScreen:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        """Draws for the last time; what is printed was printed."""
        if self._drawer is not None:
            self._drawer.end(self._shown if kind else picture(self._lines()))

    def show(self, now_s: float) -> None:
        """Show the lines, where it is time to; `now_s` is bench time."""
        if self._drawer is not None:
            now_s = monotonic_s()
        if now_s < self._due_s:
            return
        self._due_s = now_s + (PRINT_S if self._drawer is None else REFRESH_S)
        if self._drawer is not None:
            self._shown = picture(self._lines())
            self._drawer.show(self._shown)
        else:
            for line in self._lines():
                self._print(line)


def picture(lines: Sequence[str]) -> Text:
    """Lines as they are drawn."""
    return Text("\n", no_wrap=True, overflow="ellipsis").join(Text(line) for line in lines)


def table(session: HandSession, streams: Sequence[str], now_s: float) -> Sequence[str]:
    """A line for each stream under a heading, in columns."""
    rows = [HEADING, *(_row(session, stream, now_s) for stream in streams)]
    columns = zip(*rows, strict=True)
    widths = [max(least, *map(len, column)) for least, column in zip(LEAST, columns, strict=True)]
    looks = "<><<>>>>"  # text to the left, numbers to the right
    lines = (zip(row, looks, widths, strict=True) for row in rows)
    return ["  ".join(f"{cell:{look}{width}}" for cell, look, width in line).rstrip() for line in lines]


def _row(session: HandSession, stream: str, now_s: float) -> Sequence[str]:
    """Value, unit, rate, age, noise, loss and margin of a stream, as its last second has them."""
    info = session.streams[stream]
    values, times_s = session.latest.values(stream), session.latest.times(stream)
    lost = str(session.lost.get(stream, 0))
    limit = "; ".join(text.partition(" ")[2] for text in margins(session, session.limits, stream))
    if not len(values):
        silent = f"silent for {now_s:.1f} s" if info.rate_hz or now_s > AGED_S else ""
        return (stream, silent, shown_in(info.unit)[0], limit, "", "", "", lost)
    shown, unit = displayed(stream, values, info.unit)
    more = f" +{shown.shape[1] - CHANNELS}" if shown.shape[1] > CHANNELS else ""
    value = " ".join(figure(float(each), VALUE).rjust(VALUE) for each in shown[-1, :CHANNELS]) + more
    spread = float(np.nanmax(shown.std(axis=0))) if len(shown) > 1 else math.nan
    noise = figure(spread if spread > 1e-9 * np.abs(shown).max() else 0.0)
    span_s = float(times_s[-1] - times_s[0])
    rate = f"{(len(times_s) - 1) / span_s:.0f} Hz" if span_s > 0.0 else ""
    age_s = max(0.0, now_s - float(times_s[-1]))
    age = f"silent {age_s:.1f} s" if age_s > AGED_S else f"{age_s * 1e3:.0f} ms"
    return (stream, value, unit, limit, rate, age, noise, lost)


def margins(session: HandSession, limits: GuardSettings, stream: str = "") -> Iterator[str]:
    """How far each limit is: `force 0.04 of 2 N`; of one stream, or of all."""
    for name, source, channels, limit, unit in shown_limits(limits):
        values = session.latest.values(source)
        if len(values) and stream in ("", source):
            shown, factor = shown_in(unit)
            read = values[-1, list(channels)] * factor
            size = float(read[0]) if len(read) == 1 else float(np.linalg.norm(read))
            yield f"{name} {size:z.3f} of {limit * factor:.4g} {shown}"


def jog_lines(
    session: HandSession, mover: str, limits: GuardSettings, keys: Motions, refused: Sequence[str], doing: str
) -> Sequence[str]:
    """What a person who moves a device by keys looks at: the keys, what goes on, where it stands, the margins."""
    named = "   ".join(
        f"{key} {what}".replace(" ", NARROW) for key, (what, _) in keys.items() if key.islower()
    )
    places = []
    for stream, info in session.infos[mover].streams.items():
        values = session.latest.values(stream)
        if len(values) and stream != f"{mover}.force":
            shown, unit = displayed(stream, values[-1:], info.unit)
            numbers = " ".join(f"{value:z.3f}" for value in shown[0, :CHANNELS].tolist())
            places.append(f"{stream}  {numbers} {unit}")
    return [
        f"{mover} by hand: {doing}",
        "",
        *places,
        "  ".join(margins(session, limits)),
        "",
        *(line.replace(NARROW, " ") for line in wrap(named, WIDTH)),
        f"Shift is faster; let go, or press any other key, and it stops within {HOLD_S:g} s; q ends",
        *refused,
    ]

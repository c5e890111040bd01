"""What a name says of a number, and how it is shown: the only place that scales a number for people.

A name ends in the SI unit of its value, as in `stop_travel_m`. Heading and cell of a column, in every table, plot,
line and page, are both made from its one `Scale`.
"""

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import fields
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from behaviors.events import Event
from drivers.core.messages import Command, Floats

NOTHING = "–"
"""In place of what was not seen."""

DIGITS = 4
"""Significant digits of a number for the eye: a sensor here has three that mean something."""

SUFFIXES: Mapping[str, str] = {
    "s": "s",
    "m": "m",
    "n": "N",
    "v": "V",
    "hz": "Hz",
    "rad": "rad",
    "db": "dB",
    "fs": "FS",
    "kg": "kg",
    "ppm": "ppm",
    "m_s": "m/s",
    "m_s2": "m/s²",
    "m_s2_rt_hz": "m/s²/√Hz",
    "rad_s": "rad/s",
    "v_n": "V/N",
    "db_m": "dB/m",
    "kg_m2": "kg m²",
}
"""What a name ends in, and the unit of its value. Others joined by `_`, such as `n_m`, do not say whether they are
multiplied or divided: such a value is shown as it is, under its whole name."""

SHOWN: Mapping[str, tuple[str, float]] = {
    "m": ("mm", 1e3),
    "m/s": ("mm/s", 1e3),
    "m/s2": ("m/s²", 1.0),
    "rad": ("°", 180.0 / math.pi),
    "rad/s": ("°/s", 180.0 / math.pi),
}
"""Unit of a value → the unit that it is shown in, and how many of those it is. Any other is shown as it is."""

_TOKENS = frozenset(token for suffix in SUFFIXES for token in suffix.split("_")) | {"per"}
_LATENCY = re.compile(r"(^|_)to_[a-z_]+_s$")
"""From one instant of a stop to another, as `slip_to_stop_s`: milliseconds."""
_WHOSE = ("_paper", "_ours")
"""After the unit where a column is of one method: `delay_s_paper`."""
_EXPONENT = re.compile(r"e(?:\+|(-))0*")
"""Sign and zeros of an exponent that carry no information: `6.323e-05` is `6.323e-5`."""


class Scale(NamedTuple):
    """How the values of a column are shown.

    Attributes:
        label: Its name without the unit, in words.
        unit: That it is shown in; "" where the name has none.
        factor: What a value is multiplied with.
    """

    label: str
    unit: str
    factor: float

    @property
    def heading(self) -> str:
        """`stop travel, mm`."""
        return f"{self.label}, {self.unit}" if self.unit else self.label

    def cell(self, value: object, width: int = 0) -> str:
        """A value under the heading; see `figure`."""
        if isinstance(value, int | float | np.integer) and not isinstance(value, bool) and self.factor != 1.0:
            value = float(value) * self.factor
        return figure(value, width)

    def said(self, value: object) -> str:
        """`stop travel 1.37 mm`."""
        cell = self.cell(value)
        return f"{self.label} {cell} {self.unit}".rstrip() if cell != NOTHING else f"{self.label} {cell}"


@lru_cache(maxsize=4096)
def scale_of(name: str) -> Scale:
    """The scale of a column, factor, setting or field, by its name; of a setting's path by the path's last part."""
    path, _, last = name.rpartition(".")
    whose = next((ending for ending in _WHOSE if last.endswith(ending)), "")
    stem, unit = _parted(last.removesuffix(whose))
    label = f"{path}.{stem}{whose}".lstrip(".").replace("_", " ")
    if _LATENCY.search(last):
        return Scale(label, "ms", 1e3)
    return Scale(label, *shown_in(unit))


def shown_in(unit: str) -> tuple[str, float]:
    """The unit that values in `unit` are shown in, and the factor to it."""
    return SHOWN.get(unit, (unit, 1.0))


def displayed(stream: str, values: Floats, unit: str) -> tuple[Floats, str]:
    """A signal as it is shown: a period as a frequency, in which thresholds are; any other by its unit."""
    if stream.endswith(".period"):
        return 1.0 / values, "Hz"
    shown, factor = shown_in(unit)
    return factor * values, shown


def si_unit(name: str) -> str:
    """The unit of a name's value (`speed_m_s` → `m/s`), or ""."""
    return _parted(name)[1]


def _parted(name: str) -> tuple[str, str]:
    """A name without its unit, and the unit."""
    tokens = name.split("_")
    first = len(tokens)
    while first > 1 and tokens[first - 1] in _TOKENS:
        first -= 1
    unit = SUFFIXES.get("_".join(tokens[first:]), "")
    return ("_".join(tokens[:first]) if unit else name), unit


def figure(value: object, width: int = 0) -> str:
    """A value for the eye: four significant digits, or as many as fit; a dash for what was not seen.

    From ten thousand to a million it is shown whole: 39188 Hz, where it fits.

    Args:
        value: What to show; anything but a float is shown whole, however long.
        width: Characters that a float may take, seven at least (`-1e-308`), 0 for any number of them.
    """
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return NOTHING
    if not isinstance(value, float):
        return str(value)
    texts = [_EXPONENT.sub(r"e\1", f"{value:.{digits}g}") for digits in range(DIGITS, 0, -1)]
    if 10.0**DIGITS <= abs(value) < 1e6:
        texts.insert(0, f"{value:.0f}")
    return next(text for text in texts if not width or len(text) <= width).replace("-", "−")


def spaced(name: str) -> str:
    """A class's name as separate words: `MoveTo` as `move to`."""
    return re.sub(r"(?<!^)(?=[A-Z])", " ", name).lower()


def as_text(message: Command | Event) -> str:
    """A command or an event: `stage: move to 3 mm, speed 5 mm/s`, `stage: sent “move to 3 mm, speed 5 mm/s”`."""
    source = getattr(message, "device", None) or getattr(message, "detector", None)
    return f"{source}: {_deed(message)}" if source else _deed(message)


def _deed(message: Command | Event) -> str:
    name = spaced(type(message).__name__)
    parts = list(_parts(message, bare=name.endswith((" to", " at"))))
    if parts and (parts[0].startswith("“") or name.endswith((" to", " at"))):
        name = f"{name} {parts.pop(0)}"
    return ", ".join([name, *parts])


def _parts(message: Command | Event, bare: bool) -> Iterator[str]:
    """What its fields hold; the first without its name where the verb wants that."""
    for field in fields(message):
        value = getattr(message, field.name)
        if field.name in ("t_s", "device", "detector", "command_id") or not field.repr or value is None:
            continue
        if isinstance(value, Command):
            yield f"“{_deed(value)}”"
        elif isinstance(value, bool):
            yield "off" if field.name == "on" and not value else f"{'' if value else 'no '}{field.name}"
        elif isinstance(value, frozenset):
            yield ", ".join(sorted(map(str, value))) or "nothing"
        elif isinstance(value, str):
            yield value if field.name in ("reason", "request", "stream") else f"{field.name} {value}"
        elif isinstance(value, tuple):
            yield f"{scale_of(field.name).label} ({', '.join(map(figure, value))})"
        else:
            scale = scale_of(field.name)
            yield f"{scale.cell(value)} {scale.unit}".strip() if bare else scale.said(value)
            bare = False

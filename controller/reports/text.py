"""Numbers as they are printed."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from controller.scales import NOTHING, scale_of

if TYPE_CHECKING:
    from controller.reports.approaches import Mean


def number(value: object, digits: int = 2, scale: float = 1.0) -> str:
    """A number times `scale` with a fixed number of decimals, without the sign of what is rounded to zero; a dash for
    None and NaN.
    """
    if not isinstance(value, int | float) or math.isnan(value):
        return NOTHING
    return f"{value * scale:z.{digits}f}".replace("-", "−")


def quantity(name: str, value: object, digits: int = 2) -> str:
    """A column's value with its unit, for a sentence: `3.81 mm`."""
    scale = scale_of(name)
    return f"{number(value, digits, scale.factor)} {scale.unit}".rstrip()


def signed(value: float, digits: int = 2, scale: float = 1.0) -> str:
    """A difference, with its sign."""
    if math.isnan(value):
        return NOTHING
    text = f"{value * scale:+.{digits}f}"
    return f"{0.0:.{digits}f}" if float(text) == 0.0 else text.replace("-", "−")


def spread(mean: Mean, digits: int = 2, scale: float = 1.0) -> str:
    """`mean (sigma)`, as Table I prints it."""
    if math.isnan(mean.mean):
        return NOTHING
    return f"{number(mean.mean, digits, scale)} ({number(mean.sigma, digits, scale)})"


def share(part: int, whole: int) -> str:
    """`3 of 42 (7 %)`."""
    return f"{part} of {whole} ({100.0 * part / whole:.0f} %)" if whole else "none of 0"


def title(name: str) -> str:
    """An identifier as text: `no_contact` as `no contact`."""
    return name.replace("_", " ")

"""What was probably meant by a name that does not exist."""

from collections.abc import Collection

_SI = {
    "nm": ("m", 1e-9),
    "um": ("m", 1e-6),
    "mm": ("m", 1e-3),
    "cm": ("m", 1e-2),
    "km": ("m", 1e3),
    "in": ("m", 0.0254),
    "inch": ("m", 0.0254),
    "um_s": ("m_s", 1e-6),
    "mm_s": ("m_s", 1e-3),
    "cm_s": ("m_s", 1e-2),
    "mm_min": ("m_s", 1e-3 / 60.0),
    "mm_s2": ("m_s2", 1e-3),
    "g": ("m_s2", 9.80665),
    "us": ("s", 1e-6),
    "ms": ("s", 1e-3),
    "min": ("s", 60.0),
    "h": ("s", 3600.0),
    "khz": ("hz", 1e3),
    "mn": ("n", 1e-3),
    "kn": ("n", 1e3),
    "kg": ("n", 9.80665),
    "gf": ("n", 9.80665e-3),
    "lbf": ("n", 4.4482216152605),
    "deg": ("rad", 0.017453292519943295),
    "mv": ("v", 1e-3),
}
"""Units that people write at the end of a name: the SI unit that this program keeps, and how many of it
(exact by definition: NIST SP 811, appendix B; a mass stands for its weight under standard gravity)."""

_SI_UNITS = ("m_s2", "m_s", "hz", "rad", "m", "s", "n", "v")

_MANY = 12
"""More known names than this are not listed in full."""


def did_you_mean(given: str, known: Collection[str]) -> str:
    """`did you mean 'force_n'?`, or "" where nothing known is near."""
    from difflib import get_close_matches

    near = get_close_matches(given, known, n=3, cutoff=0.6)
    return f"did you mean {' or '.join(repr(name) for name in near)}?" if near else ""


def near_or_all(given: str, known: Collection[str]) -> str:
    """The names near to the given one; where none is, all that there are."""
    names = sorted(known)
    listed = ", ".join(names[:_MANY]) + (", …" if len(names) > _MANY else "")
    return did_you_mean(given, known) or f"known: {listed or 'none'}"


def unknown_key(key: str, value: object, known: Collection[str]) -> str:
    """The hint for an unknown key: the SI name where only the unit is off, else the near ones."""
    stem, unit = _stem(key, tuple(_SI) + _SI_UNITS)
    for name in sorted(known):
        known_stem, known_unit = _stem(name, _SI_UNITS)
        if known_unit and known_stem == stem:
            return (
                f"SI is meant: {name}{_converted(value, unit, known_unit)}"
                if unit
                else f"did you mean '{name}'?"
            )
    return near_or_all(key, known)


def _stem(key: str, units: Collection[str]) -> tuple[str, str]:
    for unit in sorted(units, key=len, reverse=True):
        if key.lower().endswith(f"_{unit}"):
            return key[: -len(unit) - 1], unit
    return key, ""


def _converted(value: object, unit: str, known_unit: str) -> str:
    si, factor = _SI.get(unit, ("", 0.0))
    if si != known_unit or isinstance(value, bool) or not isinstance(value, int | float):
        return ""
    return f" = {value * factor:.6g}"

"""How far an approach will go on after a touch, and how hard it will press at the most; pure."""

import math
from typing import NamedTuple

from controller.limits import GuardSettings


class Foreseen(NamedTuple):
    """What is expected of an approach.

    Attributes:
        travel_m: From the decision to stop to standstill: a turn of the loop, and braking.
        peak_n: Where the detector ends it; None where its delay is not known.
        most_n: Where the guard's force limit alone ends it.
    """

    travel_m: float
    peak_n: float | None
    most_n: float


def forecast(limits: GuardSettings, speed_m_s: float, turn_s: float) -> Foreseen | None:
    """What an approach at a speed would do; None where no stiffness or no force limit is known.

    The contact is a spring, touched at full speed; the mover stays at it until it brakes, evenly.

    Args:
        turn_s: Of the loop: a decision waits for it.
    """
    k_n_m, force_n, delay_s = limits.stiffness_n_m, limits.force_n, limits.detector_delay_s
    if k_n_m is None or force_n is None:
        return None
    travel_m = speed_m_s * turn_s + speed_m_s**2 / (2.0 * limits.braking_m_s2)
    most_n = force_n + k_n_m * (speed_m_s * limits.force_median_s + travel_m)
    peak_n = None if delay_s is None else k_n_m * (speed_m_s * delay_s + travel_m)
    return Foreseen(travel_m, peak_n, most_n)


def refusal(limits: GuardSettings, speed_m_s: float, turn_s: float) -> str:
    """Why an approach must not be made so fast, with the fastest that may; "" where it may."""
    found = forecast(limits, speed_m_s, turn_s)
    if found is None:
        return ""
    k_n_m, force_n = limits.stiffness_n_m, limits.force_n
    assert k_n_m is not None
    assert force_n is not None
    rows: list[tuple[str, str, float, float, float]] = []
    if limits.peak_n is not None and found.most_n > limits.peak_n:
        bound_n, delay_s = limits.peak_n - force_n, limits.force_median_s + turn_s
        rows.append(("ended by limits.force_n alone", "peak_n", found.most_n, bound_n, delay_s))
    if found.peak_n is not None and limits.detector_delay_s is not None and found.peak_n > force_n:
        delay_s = limits.detector_delay_s + turn_s
        rows.append(("ended by the detector", "force_n", found.peak_n, force_n, delay_s))
    if not rows:
        return ""
    said, key, peak_n, _, _ = rows[0]
    fastest_m_s = min(
        _fastest_m_s(bound_n / k_n_m, delay_s, limits.braking_m_s2) for *_, bound_n, delay_s in rows
    )
    return (
        f"{speed_m_s:.6g} m/s would press {peak_n:.3g} N where it is {said}, beyond limits.{key} ="
        f" {getattr(limits, key):g}; at most {_rounded_down(fastest_m_s)} m/s"
    )


def _fastest_m_s(way_m: float, delay_s: float, braking_m_s2: float) -> float:
    """The speed at which a delay and braking take this way."""
    return braking_m_s2 * (math.sqrt(delay_s**2 + 2.0 * way_m / braking_m_s2) - delay_s)


def _rounded_down(speed_m_s: float) -> str:
    """To three digits: what is printed is safe."""
    digit = 10.0 ** (math.floor(math.log10(speed_m_s)) - 2)
    return f"{math.floor(speed_m_s / digit) * digit:.3g}"

"""The one rule by which a detector's event is true or false where the truth is known."""

from __future__ import annotations

STEP_S = 1e-3
"""How well the time of a simulated touch or slip is known, s: one step of the benches, which look for them at the
samples of the aura (`ENVELOPE_HZ`) and of the slip plant (`SlipPlantSettings.rate_hz`), each 1 kHz. The resonant
finger's touch is located exactly."""

ROUNDING_S = 1e-9
"""Of times that are a step apart, s."""


def not_before(reported_s: float, true_s: float) -> bool:
    """Whether an event was reported no sooner than it happened, beyond the uncertainty of the truth's own time.

    What is reported sooner is a false alarm, however soon the event follows.
    """
    return reported_s >= true_s - STEP_S - ROUNDING_S


def delay_s(reported_s: float, true_s: float) -> float:
    """From what happened to its report, s; 0 within the uncertainty of the truth's own time."""
    return max(0.0, reported_s - true_s)

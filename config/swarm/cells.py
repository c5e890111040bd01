"""Which cells of the coverage can be: experiment, state, device, kind of fault."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from controller.by_hand import sources
from controller.campaign import TrialPlan

Cell = tuple[str, str, str, str]

MOVING = frozenset((
    "APPROACH", "APPROACHING", "PLACING", "NUDGING", "RETRACTING", "ENTERING", "LEAVING", "OPENING", "CLOSING",
    "SEEKING_FORWARD", "SEEKING_BACKWARD", "CENTERING", "DESCENDING", "PRESSING", "LOADING", "ROLLING", "SLIPPING",
    "LIFTING", "SHAKING", "LOWERING", "DRIVING_ON",
))  # fmt: skip
"""States in which something moves: every second led seed goes there, for what goes wrong then does harm."""

SAMPLES, ANSWERS = "samples", "answers"
_MOTIONS = ("MoveAt", "MoveTo", "MovePose", "Twist", "Grip", "Release", "Home", "Tone", "Chirp", "Ask")

NEEDS: Mapping[str, Sequence[str]] = {
    **dict.fromkeys(
        ("lose", "corrupt", "double", "full_scale", "stuck", "wrong", "drift", "nan"), (SAMPLES,)
    ),
    "late": (SAMPLES, ANSWERS),
    "refuse": _MOTIONS,
    "overrun": ("MoveAt", "MoveTo"),
}
"""What a state must have of the device for a fault to take effect in it, any of these: its samples are subscribed to,
something is commanded that it answers, a command of this kind. Kinds that are not named need nothing but a turn."""

PLANS = 12
"""So many different trials of an experiment are asked at the most."""


def had(trials: Sequence[TrialPlan]) -> Mapping[tuple[str, str], frozenset[str]]:
    """By state and device, what it has of `NEEDS` in any of these trials, as their behaviors foresee them."""
    found: dict[tuple[str, str], set[str]] = {}
    for trial in trials:
        made = {signal.info.name: signal for signal in trial.signals}
        for state, plans in trial.behavior.foreseen.items():
            commands = trial.behavior.rehearse(state)
            for command in commands:
                found.setdefault((state, command.device), set()).update((type(command).__name__, ANSWERS))
            streams = {stream for plan in plans for stream in plan.measures}
            for name in frozenset[str]().union(*(plan.detectors for plan in plans)):
                streams |= frozenset(trial.detectors[name].inputs)
            if streams or commands or state in MOVING:
                streams |= trial.guard.inputs
            for device in sources(streams, made):
                found.setdefault((state, device), set()).add(SAMPLES)
            if state in MOVING:  # what is commanded there may follow from what the trial sees
                mover = trial.behavior.answering
                found.setdefault((state, mover), set()).update((ANSWERS, "MoveAt", "Grip"))
    return {place: frozenset(each) for place, each in found.items()}

"""What a run of a profile would be refused, before anything is opened: each trial's scene, each state's commands."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace

from config.profile import Profile
from controller.campaign import TrialPlan
from controller.guard import GuardRefusal
from controller.numbers import normalised
from controller.rig import TrialScene
from drivers.arm.commands import valid
from drivers.arm.settings import ArmSettings
from drivers.core.axis import AxisLimits
from drivers.core.errors import CommandError, DeviceError
from drivers.core.messages import Command, MoveAt, MoveTo, Twist


def refusals(
    profile: Profile, trials: Iterable[TrialPlan], scene_check: Callable[[TrialScene], object]
) -> Iterator[str]:
    """A line for each thing that plant, guard or a mover's own bounds would refuse, with the first trial that meets it.

    Args:
        scene_check: Raises what a simulated bench refuses of a trial's scene.
    """
    met: dict[str, list[int]] = {}
    for trial in trials:
        try:
            scene_check(trial.scene)
        except DeviceError as error:
            met.setdefault(str(error), []).append(trial.trial)
        behavior = trial.behavior
        commanded = [(state, _begun(each)) for state in behavior.states for each in behavior.rehearse(state)]
        for state, command in (each for each in commanded if _is_settled(each[1])):
            try:
                trial.guard.admit(command)
                _bounded(profile, command)
            except (GuardRefusal, CommandError) as error:
                met.setdefault(f"{state}: {error}", []).append(trial.trial)
    for reason, (first, *others) in met.items():
        more = f" and {len(others)} more" if others else ""
        yield f"{profile.name}: trial {first}{more}: a run would be refused: {reason}"


def _begun(command: Command) -> Command:
    """A twist that leads as far as a trial has yet to see has its speed already."""
    return replace(command, duration_s=command.duration_s or 1e-3) if isinstance(command, Twist) else command


def _is_settled(command: Command) -> bool:
    """Whether no number of it is one that a trial has yet to see: not finite, or no speed or duration so far."""
    try:
        command = normalised(command)
    except GuardRefusal:
        return False
    return all(getattr(command, key, 1.0) for key in ("speed_m_s", "velocity_m_s", "duration_s"))


def _bounded(profile: Profile, command: Command) -> None:
    """See that the mover's own bounds let it through; `CommandError` where they do not."""
    entry = profile.devices.get(command.device)
    if entry and isinstance(entry.settings, ArmSettings):
        taken = valid(command.device, entry.settings, (f"{command.device}.force",), command)
        if isinstance(command, Twist) and isinstance(taken, Twist):
            _see_that_it_goes_as_far(entry.settings, command, taken)
    elif entry and isinstance(entry.settings, AxisLimits) and isinstance(command, MoveAt | MoveTo):
        entry.settings.checked(command.device, command)


def _see_that_it_goes_as_far(arm: ArmSettings, command: Twist, taken: Twist) -> None:
    """A twist lasts for a time: an arm that makes it slower makes it lead less far."""
    if all(
        math.isclose(asked, made, rel_tol=1e-9)
        for asked, made in zip(command.twist, taken.twist, strict=True)
    ):
        return
    speed_m_s, turn_rad_s = math.hypot(*command.twist[:3]), math.hypot(*command.twist[3:])
    reason = (
        f"it would lead less far: [devices.{command.device}] has max_speed_m_s = {arm.max_speed_m_s:g},"
        f" max_turn_rad_s = {arm.max_turn_rad_s:g}"
    )
    doing = f"moving at {speed_m_s:.6g} m/s and {turn_rad_s:.6g} rad/s"
    raise CommandError(command.device, doing, reason, "ask for less, or give it more")

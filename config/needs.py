"""What the chosen trials of a profile use; nothing else is opened, and nothing else has to be there."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

from behaviors.machine import Behavior
from config.profile import Profile
from config.sections import SIGNALS, Entry, references
from config.source import KeyPath, ProfileError
from config.trials import Trial
from controller.guard import GuardSettings
from controller.own_modules import is_own
from controller.registry import row

Part = tuple[str, str]
"""Section and name: `("devices", "arm")`."""


class Needs(NamedTuple):
    """What trials use.

    Attributes:
        parts: Devices that they command or read, signals that they subscribe to, detectors that they arm.
        moves: Whether a device of these may move: then the streams of `[limits]` are read as well.
    """

    parts: frozenset[Part]
    moves: bool

    @property
    def devices(self) -> frozenset[str]:
        """Names of the devices that are opened."""
        return self.named("devices")

    def named(self, section: str) -> frozenset[str]:
        """Names of a section that are used."""
        return frozenset(name for of, name in self.parts if of == section)

    @classmethod
    def of_devices(cls, names: Iterable[str], moves: bool = False) -> Needs:
        """Some devices by themselves."""
        return cls(frozenset(("devices", name) for name in names), moves)


def needs_of(profile: Profile, behavior: Behavior) -> Needs:
    """What one trial uses, by its behavior's own declarations.

    Args:
        profile: With the trial's factors laid over it.
        behavior: Of the trial: what its states arm and measure, and the devices that its settings name as
            `DeviceName`. One that names none may command any of the bench.
    """
    plans = [plan for plans in behavior.foreseen.values() for plan in plans]
    armed = {name for plan in plans for name in plan.detectors}
    streams = {name for plan in plans for name in plan.measures} | behavior.range_streams
    commanded = {name for _, to, name in references(profile.behavior) if to == "device"}
    commanded |= {behavior._mover} - {""}
    parts = _followed(profile, streams, {("detectors", name) for name in armed})
    parts |= {("devices", name) for name in commanded or profile.devices}
    return with_limits(profile, parts)


def with_limits(profile: Profile, parts: Iterable[Part]) -> Needs:
    """Some parts of a profile, and what must be read beside them while a device of them moves."""
    limits: Any = profile.limits
    used = frozenset(parts)
    moves = any(
        may_move(profile.devices[name]) for of, name in used if of == "devices" and name in profile.devices
    )
    if moves:
        devices = {name for of, name in used if of == "devices"}
        used |= _followed(profile, guarded(limits, devices), set())
    return Needs(used, moves)


def guarded(limits: GuardSettings, devices: Collection[str]) -> set[str]:
    """The streams that the guard needs while any of some devices moves."""
    watched = [limits, *(each for name, each in limits.movers.items() if name in devices)]
    streams = {stream for each in watched for stream in (each.position_stream, each.pose_stream)}
    streams |= {limits.force_stream if limits.force_n is not None else None, *limits.range_streams}
    streams |= {stream for agreement in limits.agree.values() for stream in agreement.streams}
    return {stream for stream in streams if stream is not None}


def within(limits: GuardSettings, needs: Needs) -> GuardSettings:
    """The limits of what trials use: where nothing may move, nothing is watched that no trial reads."""
    movers = {name: each for name, each in limits.movers.items() if name in needs.devices}
    if needs.moves:
        return limits.model_copy(update={"movers": movers})
    absent: dict[str, Any] = {
        "position_stream": None,
        "workspace_min_m": None,
        "workspace_max_m": None,
        "pose_stream": None,
        "force_stream": None,
        "range_streams": (),
        "agree": {},
    }
    return limits.model_copy(update={"movers": {}, **absent})


def refuse_missing(used: Sequence[tuple[Profile, Trial | None, Needs]]) -> None:
    """See that everything is there which is used: each value that the lab has to give, and what settings refer to.

    Args:
        used: The profile with each trial's factors laid over it, the trial (None of what is used by hand), and
            what that uses.

    Raises:
        ProfileError: a line for each thing that is missing.
    """
    lines: dict[str, None] = {}
    for profile, trial, needs in used:
        for path, line in profile.deferred.items():
            if path not in profile.excused and _is_used(path, profile, trial, needs):
                lines[line] = None
    if lines:
        raise ProfileError(list(lines))


def _is_used(path: KeyPath, profile: Profile, trial: Trial | None, needs: Needs) -> bool:
    """Whether a setting counts: it is of something that is used."""
    match path:
        case ("devices" | "signals" | "detectors" as section, name, *_):
            return (section, name) in needs.parts
        case ("limits", "movers", name, *_):
            return name in needs.devices
        case ("limits", *_):
            return needs.moves
        case ("behavior", table, name, _, *_) if trial is not None:
            # of tables among which a factor chooses (`sensor`), only those that are chosen
            among = getattr(profile.behavior, table)
            names = among.keys() if isinstance(among, Mapping) else ()
            asked = {value for value in trial.own.values() if value in names}
            return name in asked or not asked
        case ("behavior", *_):
            return trial is not None
    return True


def _followed(profile: Profile, streams: Collection[str], parts: set[Part]) -> set[Part]:
    """Parts, what they are made of, and what sends some streams, down to the devices."""
    found: set[Part] = set()
    waiting = [*parts, *(_sender(stream) for stream in streams)]
    while waiting:
        part = waiting.pop()
        if part in found:
            continue
        found.add(part)
        section, name = part
        of, known = ("signal", profile.signals) if section == SIGNALS else ("detector", profile.detectors)
        if section != "devices" and (entry := known.get(name)) is not None:
            waiting += [_sender(stream) for stream in entry.make(of, name).inputs]
    return found


def _sender(stream: str) -> Part:
    owner, _, name = stream.partition(".")
    return (SIGNALS, name) if owner == SIGNALS else ("devices", owner)


def may_move(entry: Entry) -> bool:
    """Whether a device may: one of the user's own, unless it is a sensor that sends lines."""
    if is_own(entry.kind):
        from drivers.core.line_sensor import (
            LineSensor,
        )  # loads the serial ports, which most profiles do not need

        return not issubclass(entry.made, LineSensor)
    moves: bool = row("driver", entry.kind).moves
    return moves

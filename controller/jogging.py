"""A mover led by keys: it moves while a key is held, slowly, and stops when the key no longer comes."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from behaviors.events import Event, Resumed, Tick
from controller.by_hand import HandSession
from controller.guard import Guard, GuardRefusal
from controller.limits import GuardSettings, MoverLimits
from drivers.core.axis import AxisLimits
from drivers.core.messages import ANSWERS, Command, Grip, Home, Lead, MoveAt, Release, Status, Stop, Twist

HOLD_S = 0.2
"""How long a motion goes on after its last key. A held key comes again every 30 to 90 ms (usual terminals); before it
comes again first, there is a pause of a quarter to half a second, in which the motion stops: a tap is a small step."""

REPEATED_S = 0.6
"""The longest pause of a key that is held, beyond that: what comes later was pressed anew (assumption)."""

SLOW_M_S, FAST_M_S = 0.002, 0.010
"""Speeds without and with Shift, where the limits allow them. Assumption: at 2 mm/s a person sees the gap close."""

PRESS_N = 10.0
"""How hard jaws that are closed by hand press (assumption: little more than the SSG-48's least, 6.9 N)."""

FORWARD, BACK = "\x1b[C", "\x1b[D"
ARROWS = {FORWARD: "f", BACK: "b", "\x1b[1;2C": "F", "\x1b[1;2D": "B", "\x1bOC": "f", "\x1bOD": "b"}
"""Arrow keys, with Shift or without, as terminals send them, and the letters that mean the same."""

ENDING = ("q", "\x1b", "\x03", "\x04")
"""Keys that end: q, Escape, and Ctrl+C or Ctrl+D where the terminal passes them on."""

LEAD = "g"
"""Key after which an arm can be led by hand, until the next key."""

Motions = Mapping[str, tuple[str, Callable[[], Command]]]
"""By key: what it does, and what makes the command that does it."""


def motions(
    session: HandSession, mover: str, limits: GuardSettings, axis: AxisLimits | None = None
) -> tuple[Motions, Sequence[str]]:
    """The keys of a mover, and why others do nothing: what its guard would refuse is none.

    Args:
        session: The bench, open.
        axis: What it takes itself; None of a kind of its own.
    """
    own: MoverLimits = limits.movers.get(mover, limits)
    streams = session.infos[mover].streams
    details: Mapping[str, Any] = session.infos[mover].details
    least_m_s = details.get("least_speed_m_s", 0.0)
    slow_m_s = max(min(SLOW_M_S, own.speed_m_s), least_m_s)
    fast_m_s = max(min(FAST_M_S, own.speed_m_s), least_m_s)
    pairs: list[tuple[str, str, Callable[[float], Command]]] = []
    if f"{mover}.width" in streams:
        pairs.append(("o", "open", lambda speed: Release(mover, speed)))
        if isinstance(closed_m := details.get("closed_width_m"), float):
            press_n = min(max(PRESS_N, details.get("least_force_n", 0.0)), limits.grip_n)
            pairs.append(("c", "close", lambda speed: Grip(mover, closed_m, speed, press_n)))
    if f"{mover}.position" in streams:
        least_m, most_m = own.travel_min_m, own.travel_m
        if axis is not None:
            least_m, most_m = max(least_m, axis.travel_min_m), min(most_m, axis.travel_max_m)
        pairs.append(("f", "forward", lambda speed: MoveAt(mover, speed, most_m)))
        pairs.append(("b", "back", lambda speed: MoveAt(mover, -speed, least_m)))
    if (pose := f"{mover}.pose") in streams:
        for number, (name, keys) in enumerate((("x", "da"), ("y", "ws"), ("z", "ec"))):
            for key, sign in zip(keys, (1, -1), strict=True):
                what = f"tool {'+' if sign > 0 else '−'}{name}"
                pairs.append((key, what, _along(session, pose, mover, number, sign)))
        pairs.append((LEAD, "led by hand", lambda speed: Lead(mover)))
    pairs.append(("h", "home", lambda speed: Home(mover)))
    found: dict[str, tuple[str, Callable[[], Command]]] = {}
    refused: dict[str, None] = {}
    for key, what, made in pairs:
        speeds = {key: slow_m_s} if key == LEAD else {key: slow_m_s, key.upper(): fast_m_s}
        for name, speed_m_s in speeds.items():
            try:
                Guard(limits).admit(made(speed_m_s))
            except GuardRefusal as refusal:
                refused[f"{key}: {what}: {refusal}"] = None
            else:
                found[name] = (what, lambda made=made, speed_m_s=speed_m_s: made(speed_m_s))  # type: ignore[misc]
    return found, list(refused)


def _along(session: HandSession, pose: str, mover: str, axis: int, sign: int) -> Callable[[float], Command]:
    """A step along an axis of the tool, as it is turned now; along the base's before its pose is known."""

    from scipy.spatial.transform import Rotation  # now: in the loop it would be late by a tenth of a second

    def made(speed_m_s: float) -> Command:
        way = [0.0, 0.0, 0.0]
        way[axis] = sign * speed_m_s
        poses = session.latest.values(pose)
        if len(poses):
            way = Rotation.from_rotvec(poses[-1, 3:]).apply(way).tolist()
        return Twist(mover, (way[0], way[1], way[2], 0.0, 0.0, 0.0), HOLD_S)

    return made


@dataclass
class Jog:
    """Steers a mover by keys (`controller.by_hand.Steer`).

    One motion at a time: while one goes on, each other key stops it, and what a key begins, it begins from standstill.
    A motion goes on for `HOLD_S` after its last key. Keys that came together count once: what a terminal held up moves
    nothing later.

    Args:
        keys: What was pressed since it was asked last.
        show: Is told in every turn what goes on.
    """

    mover: str
    motions: Motions
    keys: Callable[[], Sequence[str]]
    show: Callable[[str], None] = lambda doing: None
    _key: str = ""  # whose motion goes on
    _until_s: float = -math.inf
    _stopping: bool = False
    _spent: str = ""

    def __call__(self, event: Event) -> Sequence[Command] | None:
        """The commands that follow from an event, None at the end."""
        if isinstance(event, Resumed):
            self._key, self._stopping = "", False
        if isinstance(event, ANSWERS) and isinstance(event, Status) and event.device == self.mover:
            # What has come to its end is not begun anew by the same key, as long as that is held.
            self._spent = "" if self._stopping else self._key
            self._key, self._stopping = "", False
        if not isinstance(event, Tick):
            return ()
        pressed = [ARROWS.get(key, key) for key in self.keys()]
        if any(key in ENDING for key in pressed):
            return None
        steered = self._goes_on if self._key else self._begins
        commands = () if self._stopping else steered(pressed, event.t_s)
        what = self.motions[self._key][0] if self._key else ""
        self.show("stopping" if self._stopping else what or "stands still")
        return commands

    def _begins(self, pressed: Sequence[str], t_s: float) -> Sequence[Command]:
        key = pressed[-1] if pressed else ""
        if key and key == self._spent and t_s <= self._until_s:
            self._until_s = t_s + HOLD_S
        elif key in self.motions:
            self._key, self._until_s, self._spent = key, t_s + HOLD_S, ""
            return [self.motions[key][1]()]
        return ()

    def _goes_on(self, pressed: Sequence[str], t_s: float) -> Sequence[Command]:
        led = self._key == LEAD
        # What is led by hand goes on without its key, until that is pressed anew.
        over = t_s > self._until_s + (REPEATED_S if led else 0.0) and bool(pressed) == led
        if over or any(key != self._key for key in pressed):
            self._stopping = True
            return [Stop(self.mover)]
        if not pressed:
            return ()
        self._until_s = t_s + HOLD_S
        # A motion along the axis goes on by itself; a step has to be made anew.
        command = () if led else (self.motions[self._key][1](),)
        return [each for each in command if isinstance(each, Twist)]

"""Leads a behavior through its states by the events that a bench would send."""

import math

from behaviors.events import Contact, ContactHeld, ContactLost, PreTouch
from drivers.core.messages import Reached, Standstill


def tell(behavior, *events):
    """Handles the events; gives what the last one commands."""
    commands = []
    for event in events:
        commands = list(behavior.handle(event))
    return commands


def lead(behavior, path, state):
    """Begins a trial and goes to a state; gives behavior and last commands. `path`: the events into each state."""
    commands = list(behavior.begin(0.0))
    for name, events in path.items():
        commands = tell(behavior, *events) if events else commands
        if name == state:
            break
    assert behavior.state == state
    return behavior, commands


def arm(t_s, position_m=0.0):
    return Reached(t_s, "arm", position_m)


def jaws(t_s):
    return Reached(t_s, "gripper", 0.056)


def still(t_s, position_m=0.0):
    return Standstill(t_s, "arm", position_m)


def seen(t_s, detector, position_m=math.nan):
    return PreTouch(t_s, detector, 1.0, 0.5, position_m)


def touch(t_s, detector):
    return Contact(t_s, detector, 9.0, 5.0)


def held(t_s, detector):
    return ContactHeld(t_s, detector, 9.0, 5.0)


def lost(t_s, detector):
    return ContactLost(t_s, detector, 0.0, 5.0)

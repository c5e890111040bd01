"""The gripper that carries the sonic fingers: its drive, in the bench's time."""

from __future__ import annotations

from collections.abc import Callable

from simulator.physics.aura_objects import OBJECTS
from simulator.physics.jaws import GripObject, JawsSettings
from simulator.physics.jaws_drive import JawsDrive


class AuraJaws(JawsDrive):
    """Jaws whose time is the bench's: where the arm takes them matters to what they hold.

    Args:
        settings: Of the jaws and of all that they may meet.
        follow: Lets the bench pass time, and the jaws with it.
    """

    def __init__(self, settings: JawsSettings, follow: Callable[[float], None]) -> None:
        super().__init__(settings)
        self._follow = follow
        self._start_m = self.jaws.width_m

    def advance(self, t_s: float) -> None:
        """Let time pass on the whole bench until `t_s`."""
        self._follow(t_s)

    def renew(self) -> None:
        """Be as on the first day: open, without power, at time zero."""
        self.jaws.place(None)
        self.jaws.width_m, self.jaws.rate_m_s = self._start_m, 0.0
        self._flags[:] = 0
        self.power_up()


def jaws_settings(closed_width_m: float) -> JawsSettings:
    """Jaws on their brackets, and all that they may meet."""
    return JawsSettings(
        closed_width_m=closed_width_m,
        objects={
            name: GripObject(width_m=thing.width_m, stiffness_n_m=thing.stiffness_n_m)
            for name, thing in OBJECTS.items()
        },
    )


def fits(settings: JawsSettings, name: str) -> bool:
    """Whether the jaws on these brackets close on an object at all."""
    try:
        settings.check(name)
    except ValueError:
        return False
    return True

"""The events that a behavior handles.

Statuses of devices (`drivers.core.messages.Status`) are events too; detectors and the loop add those below.
"""

import math
from dataclasses import dataclass

from drivers.core.messages import Status


@dataclass(frozen=True, slots=True)
class Detected:
    """What a detector found at the sample of bench time `t_s`.

    `value` is the statistic that decided and `threshold` what it was held against, in the detector's unit.
    """

    t_s: float
    detector: str
    value: float
    threshold: float


@dataclass(frozen=True, slots=True)
class BaselineReady(Detected):
    """The detector has seen enough to know what no contact looks like: `value` is the mean."""


@dataclass(frozen=True, slots=True)
class BaselineRefused(Detected):
    """The baseline is unusable (no samples, no variance, not finite)."""

    reason: str = ""


@dataclass(frozen=True, slots=True)
class Contact(Detected):
    """Contact began."""


@dataclass(frozen=True, slots=True)
class ContactLost(Detected):
    """Contact ended."""


@dataclass(frozen=True, slots=True)
class ContactHeld(Detected):
    """Contact persists: reported once, when it has lasted as long as the detector's settings ask for."""


@dataclass(frozen=True, slots=True)
class PreTouch(Detected):
    """An object came near a finger that has not touched it.

    `position_m` is where the mover was at `t_s`, along the direction in the detector's settings; NaN where it
    subscribes to no encoder.
    """

    position_m: float = math.nan


@dataclass(frozen=True, slots=True)
class PreTouchLost(Detected):
    """Nothing is near any more."""

    position_m: float = math.nan


@dataclass(frozen=True, slots=True)
class SlipStarted(Detected):
    """A fingertip began to slip."""


@dataclass(frozen=True, slots=True)
class SlipEnded(Detected):
    """It holds again."""


@dataclass(frozen=True, slots=True)
class BorderNear(Detected):
    """The contact came near the border of a fingertip: `angle_rad` is its angle from the middle, with its sign."""

    angle_rad: float = math.nan


@dataclass(frozen=True, slots=True)
class BorderLeft(Detected):
    """It is back in the middle."""


@dataclass(frozen=True, slots=True)
class Impact(Detected):
    """Something struck the sensor, and it is over: it began at `began_s`."""

    began_s: float = math.nan


@dataclass(frozen=True, slots=True)
class Onset(Detected):
    """Something knocked or touched: it began at `began_s`, known to a standard deviation of `sigma_s`."""

    began_s: float = math.nan
    sigma_s: float = math.nan


@dataclass(frozen=True, slots=True)
class LoadChanged(Detected):
    """What a finger carries is `value` now, N: by more than `threshold` another load than was told last."""


@dataclass(frozen=True, slots=True)
class GuardStopped:
    """The guard stopped every mover at `t_s`."""

    t_s: float
    reason: str


@dataclass(frozen=True, slots=True)
class Forecast:
    """An approach begins: what is expected of it (`controller.forecast.Foreseen`)."""

    t_s: float
    device: str
    speed_m_s: float
    travel_m: float
    peak_n: float | None
    most_n: float


@dataclass(frozen=True, slots=True)
class Approached:
    """It is over: how far the mover went after the command to stop, NaN where no position shows it, and the largest
    force that the guard's sensor read."""

    t_s: float
    device: str
    travel_m: float
    pressed_n: float


@dataclass(frozen=True, slots=True)
class Retreated:
    """After the guard's stop, which was not enough, the device was sent back."""

    t_s: float
    device: str


@dataclass(frozen=True, slots=True)
class Tick:
    """Nothing but time: a state's deadline may have passed."""

    t_s: float


@dataclass(frozen=True, slots=True)
class Paused:
    """The operator paused the trial: every mover was commanded to stop."""

    t_s: float


@dataclass(frozen=True, slots=True)
class Resumed:
    """The operator let a paused trial go on."""

    t_s: float


Event = Detected | Status | GuardStopped | Forecast | Approached | Retreated | Tick | Paused | Resumed

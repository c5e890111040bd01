"""What real recordings of slip have beside slip: numbers of the plant, all of them off by default."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, Strict

from drivers.core.settings import Settings


class SlipNuisances(Settings):
    """Disturbances of one sensor and its table.

    Those of the read-out act where the plant's own bridges have their noise and converter: on both fingertips, and on
    the BarrettHand's noise.
    """

    change_s: float = Field(default=2.0, ge=0.0, le=1e6)
    """When noise and hum change, from the beginning of a trial, s."""

    noise_factor: float = Field(default=1.0, ge=0.0, le=100.0)
    """Multiplies the noise from then on. Seen in recordings: 1.2 to 3."""

    hum: float = Field(default=0.0, ge=0.0, le=1e3)
    """Root mean square of a hum that is switched on then, in standard deviations of the noise."""

    hum_hz: Annotated[tuple[float, ...], Strict(False)] = (160.0, 320.0, 480.0)
    """Its sines, equally strong, Hz. Those of the recorded tribometer's servo."""

    converter: float = Field(default=0.0, ge=0.0, le=1e3)
    """Step of the converter in standard deviations of the noise; 0 keeps the bridge's own."""

    tails: float = Field(default=1.0, ge=1.0, le=3.0)
    """Heaviness of the noise's tails: sinh(tails x asinh(x)) instead of a normal x, over its value at 1. 1.4 puts
    2 % beyond three standard deviations as estimated from its median, as the recorded quiet has."""

    tremor_n: float = Field(default=0.0, ge=0.0, le=10.0)
    """Root mean square of the tangential force of a tremor while the tip is loaded, N; fingers press with some
    5 N."""

    tremor_hz: Annotated[tuple[float, ...], Strict(False)] = (6.0, 9.0, 13.0, 21.0)
    """Its sines, equally strong, Hz. Assumption: those of a hand, and of an arm's controller."""

    smoothness: float = Field(default=1.0, ge=1.0, le=100.0)
    """Divides the patches' length and the static excess: at 10 and 10 mm/s friction changes 3,300 times a second, more
    often than it can be counted."""

    bounces: int = Field(default=0, ge=0, le=20)
    """How often a bump bounces."""

    bounce_s: float = Field(default=0.04, gt=0.0, le=1.0)
    """Time to the first bounce, s; to the next it is `bounce_ratio` as long, and the blow as strong. Assumption: a
    light tip on metal."""

    bounce_ratio: float = Field(default=0.6, ge=0.0, lt=1.0)
    """See `bounce_s`."""

    table_m_s: float = Field(default=0.0, ge=-1.0, le=1.0)
    """Speed of the table under the tip, m/s: slip that is in progress from the first contact on."""

"""The weights that lie on a simulated bench, and the hands that hang them: none is quite what is written on it."""

from __future__ import annotations

import numpy as np
from pydantic import Field

from drivers.core.settings import Settings
from simulator.physics.bench import Bench

STREAM_WEIGHTS = 64
"""Number of the weights' errors among the bench's counter-based streams; plant, arm and idle sensors are below."""


class HandSettings(Settings):
    """A simulated person and their weights."""

    answer_s: float = Field(default=0.4, ge=0.0, le=3600.0)
    """How long they take for a request. Assumption: far less than a person's, which is not measured here."""

    weight_error: float = Field(default=0.001, ge=0.0, le=0.1)
    """Relative standard deviation of what a weight really pulls with. Assumption: a laboratory's slotted weights, local
    gravity included."""


class Hands:
    """Hangs weights on a bench: one load at a time.

    A weight of a given size is the same piece in all trials of a run, with the same error.

    Args:
        settings: Of the person.
        bench: With the fingertip.
    """

    def __init__(self, settings: HandSettings, bench: Bench) -> None:
        self._settings = settings
        self._bench = bench

    def hang(self, t_s: float, bridge: str, force_n: float) -> None:
        """Let this force hang, and nothing else, from `t_s` on.

        Raises:
            RefusedError: the tip carries another sensor.
        """
        self._bench.advance(t_s)
        for name in ("x", "y", "t"):
            self._bench.load(name, self.true_n(force_n) if name == bridge else 0.0)

    def true_n(self, force_n: float) -> float:
        """What pulls when this is written on the weight, N."""
        from simulator.physics.noise import gaussian_at

        if force_n == 0.0:
            return 0.0
        number = np.array([round(force_n * 1e6)])
        deviate = float(gaussian_at((self._bench.key[0], 0), STREAM_WEIGHTS, number)[0])
        return force_n * (1.0 + self._settings.weight_error * deviate)

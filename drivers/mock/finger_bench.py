"""Finger, probe and stage on one table: what mock drivers and emulated devices of this bench share."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from drivers.mock.plants.finger import FingerPlant, FingerSettings
from drivers.mock.plants.stage_axis import StageAxis


class StreamSpec(NamedTuple):
    """What the sensor board of this bench has of one stream."""

    name: str
    channels: tuple[str, ...]
    unit: str
    scale: float
    rate_hz: float | None


STREAMS = (
    # 16 bits over the ADXL335's +-3.6 g (data sheet); the converter is an assumption.
    StreamSpec("accelerometer", ("z",), "m/s2", 1e-3, 1000.0),
    # A 24-bit converter over 5 lbf (22 N; the paper's cell) resolves 3 uN; 10 uN are kept. Assumption.
    StreamSpec("load_cell", ("force",), "N", 1e-5, 1000.0),
    # The loop's period, counted at 10 MHz. Assumption: the paper does not say how frequency was read.
    StreamSpec("period", ("period",), "s", 1e-7, None),
)


class FingerBenchSettings(FingerSettings):
    """The plant section of a profile: the finger's own parameters, and where things stand."""

    surface_m: float = Field(default=0.003, gt=0.0, le=0.1)
    """Where the resting finger's surface is, on the stage's axis. Assumption: a 3 mm gap at the start."""

    stage_acceleration_m_s2: float = Field(default=0.5, gt=0.0, le=100.0)
    """Of the stage. Assumption: 12 mm/s in 24 ms, ordinary for a small lead-screw stage."""

    stage_max_speed_m_s: float = Field(default=0.026, gt=0.0, le=1.0)
    """Of the stage. Assumption: a small lead-screw stage."""


class FingerBench:
    """The finger plant with a probe that the stage's axis carries.

    Its time is that of the devices, continuous from trial to trial; the plant's begins anew with each.

    Args:
        settings: Of the plant.
    """

    def __init__(self, settings: FingerBenchSettings) -> None:
        self.axis = StageAxis(
            acceleration_m_s2=settings.stage_acceleration_m_s2, max_speed_m_s=settings.stage_max_speed_m_s
        )
        self._settings = settings
        self._plant = FingerPlant(settings)
        self._origin_s = 0.0
        self._observe: frozenset[str] = frozenset()
        self._period_times_s: NDArray[np.float64] = np.empty(0)
        self._periods_s: NDArray[np.float64] = np.empty(0)
        self.contacts: list[tuple[float, bool]] = []
        self._begin((0, 0), "f")

    def warm_up(self) -> None:
        """Let compiled code load, or compile on first use, before anybody waits for an answer."""
        bench = FingerBench(self._settings)
        bench.excite(True)
        bench.advance(0.01, frozenset(stream.name for stream in STREAMS))
        for stream in STREAMS:
            if stream.rate_hz is not None:
                bench.sample(stream.name, np.array([0.005]))
        bench.axis.move_to(0.01, 0.001, 0.005)
        bench.on_plan(0.01)
        bench.advance(0.02, frozenset())

    def restart(self) -> None:
        """Time begins anew: the stage stands at zero."""
        self._origin_s = 0.0
        self.axis.place(0.0, 0.0)

    def begin(
        self, t_s: float, seed: int, trial: int, factors: Mapping[str, Any], plant: Mapping[str, Any]
    ) -> None:
        """Put the bench into a trial's scene at time `t_s`: the finger at rest, the stage where it stands.

        Args:
            t_s: Present time of the devices.
            seed: Of the run; keys the noise together with `trial`.
            trial: Number of the trial.
            factors: Its factors; `location` is the one that matters here.
            plant: The profile's plant section for this trial.
        """
        settings = FingerBenchSettings.model_validate(plant)
        if settings != self._settings:
            self._settings = settings
            self._plant = FingerPlant(settings)
        self.axis.place(t_s, self.axis.position(t_s))
        self._origin_s = t_s
        self._begin((seed, trial), str(factors.get("location", "f")))
        self.on_plan(t_s)

    def _begin(self, key: tuple[int, int], location: str) -> None:
        self._plant.begin(key=key, location=location, gap_m=self._settings.surface_m)
        self._observe = frozenset()
        self._period_times_s = self._periods_s = np.empty(0)
        self.contacts = []

    # what the stage tells

    def on_plan(self, t_s: float) -> None:
        """The axis has a new plan from `t_s` on."""
        self.advance(t_s, self._observe)
        self._plant.move_probe([(piece[0] - self._origin_s, *piece[1:]) for piece in self.axis.pieces(t_s)])

    # what the board is wired to

    def streams(self) -> Sequence[StreamSpec]:
        """What the board has, in the order of its stream ids."""
        return STREAMS

    def excite(self, on: bool) -> None:
        """Switch the excitation, from the plant's present time on."""
        self._plant.excite(on)

    def set_tendon(self, position_m: float) -> None:
        """Set the tendon, from the plant's present time on."""
        self._plant.set_tendon(position_m)

    def advance(self, t_s: float, observe: frozenset[str]) -> None:
        """Let time pass until `t_s`; `observe` names the streams that somebody hears."""
        until_s = t_s - self._origin_s
        self._observe = observe
        if until_s <= self._plant.t_s:
            return
        self._plant.advance(until_s, observe)
        ends_s, periods_s = self._plant.periods()
        if "period" in observe:
            self._period_times_s = np.concatenate([self._period_times_s, ends_s + self._origin_s])
            self._periods_s = np.concatenate([self._periods_s, periods_s])
        self.contacts += [(t + self._origin_s, made) for t, made in self._plant.contacts()]

    def sample(self, stream: str, times_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """A waveform at some instants of the last advance, in its SI unit."""
        return self._plant.sample(stream, times_s - self._origin_s)

    def events(self, stream: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Period counts since the last call: when each ended, and its length, both in seconds."""
        assert stream == "period", stream
        taken = self._period_times_s, self._periods_s
        self._period_times_s = self._periods_s = np.empty(0)
        return taken

    def scene(self, t_s: float) -> Mapping[str, float]:
        """Where things stand: what a person at the bench would see."""
        return {"stage_m": self.axis.position(t_s), "stage_m_s": self.axis.velocity(t_s)}

    def account(self) -> Mapping[str, Any]:
        """What the plant did: tiers, what was skipped."""
        return self._plant.account()

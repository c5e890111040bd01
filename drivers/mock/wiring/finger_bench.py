"""Finger and probe on one table: what mock drivers and emulated devices of this bench share."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from drivers.mock.physics.bench import Carrier, StreamSpec, mountable
from drivers.mock.physics.finger import FingerPlant, FingerSettings
from drivers.mock.physics.stage_axis import AxisMotion, Piece

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
    """Where the resting finger's surface is, on the approach axis. Assumption: a 3 mm gap at the start."""


class FingerBench:
    """The finger plant with a probe that a mover carries.

    Its time is that of the devices, continuous from trial to trial; the plant's begins anew with each.

    Args:
        settings: Of the plant.

    Attributes:
        t_s: How far time has passed here, on the devices' clock.
        key: Seed of the run and number of the trial, which key every noise.
        contacts: The truth: when contact began (True) and ended (False) in this trial.
    """

    def __init__(self, settings: FingerBenchSettings) -> None:
        self._carrier: Carrier | None = None
        self._settings = settings
        self._plant = FingerPlant(settings)
        self._origin_s = 0.0
        self._observe: frozenset[str] = frozenset()
        self._felt: frozenset[str] = frozenset()
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
        carrier = AxisMotion()
        bench.mount(carrier)
        carrier.replace(0.01, [Piece(0.01, 0.0, 0.005, 0.0)])
        bench.on_plan(0.01)
        bench.advance(0.02, frozenset())

    def mount(self, carrier: Carrier) -> None:
        """Fix the probe to what carries it.

        Raises:
            RefusedError: something carries it already.
        """
        mountable(self._carrier, carrier, "probe")
        self._carrier = carrier

    def restart(self) -> None:
        """Time begins anew: the probe stands at zero."""
        self._origin_s = 0.0
        if self._carrier is not None:
            self._carrier.place(0.0, 0.0)

    def begin(
        self, t_s: float, seed: int, trial: int, factors: Mapping[str, Any], plant: Mapping[str, Any]
    ) -> None:
        """Put the bench into a trial's scene at time `t_s`: the probe where it is, the finger at rest, perhaps on it.

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
        self._origin_s = t_s
        self._begin((seed, trial), str(factors.get("location", "f")))
        self.on_plan(t_s)
        self._plant.rest_against_probe()

    def _begin(self, key: tuple[int, int], location: str) -> None:
        self._plant.begin(key=key, location=location, gap_m=self._settings.surface_m)
        self.t_s = self._origin_s
        self.key = key
        self._observe = frozenset()
        self._period_times_s = self._periods_s = np.empty(0)
        self.contacts = []

    # what the mover tells and feels

    def on_plan(self, t_s: float) -> None:
        """The probe's motion changes at `t_s`, or changed there already where time has passed it."""
        if self._carrier is None:
            return
        self.advance(t_s)
        pieces = self._carrier.pieces(self.t_s)
        self._plant.move_probe([(piece[0] - self._origin_s, *piece[1:]) for piece in pieces])

    def feel(self, on: bool) -> None:
        """Whether the mover's own sensor feels the contact force: then `sample` has the load cell as well."""
        self._felt = frozenset({"load_cell"}) if on else frozenset()

    @property
    def force_n(self) -> float:
        """What the finger presses against the probe with at `t_s`, without noise, compression positive."""
        return self._plant.force_n

    def wrench(self, times_s: NDArray[np.float64], direction: Sequence[float]) -> NDArray[np.float64]:
        """What the finger does to the tool that carries the probe: N and N m, base axes, shape (n, 6).

        Args:
            times_s: Instants of the last advance, shape (n,). While nobody feels the force, what presses now is told
                for all of them.
            direction: The approach direction, unit vector in the base frame.
        """
        pressed_n = self.sample("load_cell", times_s) if self._felt else np.full(len(times_s), self.force_n)
        found = np.zeros((len(times_s), 6))
        found[:, :3] = -pressed_n[:, None] * np.asarray(direction)
        return found

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

    def advance(self, t_s: float, observe: frozenset[str] | None = None) -> None:
        """Let time pass until `t_s`; `observe` names the streams that somebody hears, None those of last time."""
        until_s = t_s - self._origin_s
        if observe is not None:
            self._observe = observe
        if until_s <= self._plant.t_s:
            return
        self._plant.advance(until_s, self._observe | self._felt)
        self.t_s = t_s
        ends_s, periods_s = self._plant.periods()
        if "period" in self._observe:
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
        if self._carrier is None:
            return {}
        return {"probe_m": self._carrier.position(t_s), "probe_m_s": self._carrier.velocity(t_s)}

    def account(self) -> Mapping[str, Any]:
        """What the plant did: tiers, what was skipped."""
        return self._plant.account()

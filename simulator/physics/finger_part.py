"""The resonant finger as a part of a bench: a probe in the tool meets it, a board reads it."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from pydantic import Field

from drivers.core.messages import Floats
from simulator.physics.bench import Bench, BenchPart, StreamSpec
from simulator.physics.finger import CHANNELS, FingerPlant, FingerSettings

STREAMS = (
    # 16 bits over the ADXL335's +-3.6 g (data sheet); the converter is an assumption.
    StreamSpec("accelerometer", ("z",), "m/s2", 1e-3, 1000.0),
    # A 24-bit converter over 5 lbf (22 N; the paper's cell) resolves 3 uN; 10 uN are kept. Assumption.
    StreamSpec("load_cell", ("force",), "N", 1e-5, 1000.0),
    # The loop's period, counted at 10 MHz. Assumption: the paper does not state how frequency was read.
    StreamSpec("period", ("period",), "s", 1e-7, None),
    # Where the board holds the tendon, as its motor's encoder reports it. Assumption: micrometres, 100 times a second.
    StreamSpec("tendon", ("position",), "m", 1e-6, 100.0),
)
DISTAL = StreamSpec("distal", ("z",), "m/s2", 1e-3, 1000.0)
"""The second accelerometer, where there is one."""

FELT = frozenset({"load_cell"})
"""What is computed for a mover whose own sensor feels the contact."""


class FingerBenchSettings(FingerSettings):
    """The plant section of a profile: the finger's own parameters, and where things stand."""

    surface_m: float = Field(default=0.003, gt=0.0, le=0.1)
    """Where the resting finger's surface is, on the approach axis. Assumption: a 3 mm gap at the start."""
    always_excited: bool = False
    """Whether the loop that excites the finger is on from the start: a bench on which no device switches it."""


class FingerPart(BenchPart):
    """The finger's plant, whose own time begins anew with each trial.

    Attributes:
        contacts: The truth: when contact began (True) and ended (False) in this trial.
    """

    offers = ("streams", "sample", "events", "excite", "set_tendon", "contacts", "force_n")

    def __init__(self, bench: Bench, settings: FingerBenchSettings) -> None:
        super().__init__(bench)
        self._settings = settings
        self._plant = FingerPlant(settings)
        self._before: Mapping[str, Any] = {}
        self._begin("f")

    def warm_up(self) -> None:
        """See `BenchPart`."""
        bench = Bench(self._settings, "probe")
        FingerPart(bench, self._settings).excite(True)
        bench.advance(0.01, frozenset(stream.name for stream in STREAMS))
        for stream in STREAMS:
            if stream.rate_hz is not None:
                bench.sample(stream.name, np.array([0.005]))

    def begin(self, settings: FingerBenchSettings, factors: Mapping[str, Any]) -> None:
        """The probe is where it is, the finger at rest, perhaps on it; the factor `location` names where it is met."""
        if settings != self._settings:
            self._before = self.account()
            self._settings = settings
            self._plant = FingerPlant(settings)
        self._begin(str(factors.get("location", "f")))
        self.replan()
        self._plant.rest_against_probe()

    def _begin(self, location: str) -> None:
        self._plant.begin(key=self.bench.key, location=location, gap_m=self._settings.surface_m)
        self._period_times_s = self._periods_s = np.empty(0)
        self._felt_s = math.inf  # since when the force is computed with its noise
        self._tendon_s, self._tendon_m = [self.bench.origin_s], [0.0]
        self.contacts: list[tuple[float, bool]] = []
        if self._settings.always_excited:
            self._plant.excite(True)

    # motion and force of the mover

    def replan(self) -> None:
        """See `BenchPart`."""
        if self.bench.mover is None:
            return
        pieces = self.bench.mover.pieces(self.bench.t_s)
        self._plant.move_probe([(piece[0] - self.bench.origin_s, *piece[1:]) for piece in pieces])

    @property
    def force_n(self) -> float:
        """What the finger presses against the probe with now, without noise, compression positive."""
        return self._plant.force_n

    def wrench(self, times_s: Floats, direction: Sequence[float]) -> Floats:
        """See `Bench.wrench`; where the force was not read yet, the present one stands for all instants."""
        felt = self.bench.felt and times_s[0] > self._felt_s
        pressed_n = self.sample("load_cell", times_s) if felt else np.full(len(times_s), self.force_n)
        found = np.zeros((len(times_s), 6))
        found[:, :3] = -pressed_n[:, None] * np.asarray(direction)
        return found

    # what the board is wired to

    def streams(self) -> Sequence[StreamSpec]:
        """What the board has, in the order of its stream ids."""
        return (*STREAMS, DISTAL) if self._settings.distal_accelerometer_arm_m else STREAMS

    def excite(self, on: bool) -> None:
        """Switch the excitation, from the plant's present time on."""
        self._plant.excite(on)

    def set_tendon(self, position_m: float) -> None:
        """Set the tendon, from the plant's present time on."""
        self._plant.set_tendon(position_m)
        self._tendon_s.append(self.bench.origin_s + self._plant.t_s)
        self._tendon_m.append(position_m)

    def advance(self, t_s: float) -> None:
        """See `BenchPart`; what is not observed is not computed."""
        origin_s, observed = self.bench.origin_s, self.bench.observed & CHANNELS
        until_s = t_s - origin_s
        if until_s <= self._plant.t_s:
            return
        begun_s = min(self._felt_s, origin_s + self._plant.t_s)
        self._felt_s = begun_s if self.bench.felt else math.inf
        self._plant.advance(until_s, observed | FELT if self.bench.felt else observed)
        ends_s, periods_s = self._plant.periods()
        if "period" in observed:
            self._period_times_s = np.concatenate([self._period_times_s, ends_s + origin_s])
            self._periods_s = np.concatenate([self._periods_s, periods_s])
        self.contacts += [(t + origin_s, made) for t, made in self._plant.contacts()]

    def sample(self, stream: str, times_s: Floats) -> Floats:
        """A waveform at some instants of the last advance, in its SI unit."""
        if stream == "tendon":
            held = np.searchsorted(self._tendon_s, times_s, side="right") - 1
            return np.asarray(self._tendon_m)[np.maximum(held, 0)]
        return self._plant.sample(stream, times_s - self.bench.origin_s)

    def events(self, stream: str) -> tuple[Floats, Floats]:
        """Period counts since the last call: when each ended, and its length, both in seconds."""
        assert stream == "period", stream
        taken = self._period_times_s, self._periods_s
        self._period_times_s = self._periods_s = np.empty(0)
        return taken

    def scene(self, t_s: float) -> Mapping[str, float]:
        """Where the probe is."""
        carrier = self.bench.mover
        if carrier is None:
            return {}
        return {"probe_m": carrier.position(t_s), "probe_m_s": carrier.velocity(t_s)}

    def account(self) -> Mapping[str, Any]:
        """What the plants of all trials did: tiers, what was skipped."""
        own, before = self._plant.account(), self._before
        if before:
            own["seconds"] = {tier: s + before["seconds"][tier] for tier, s in own["seconds"].items()}
            own["error_bound_rad"] = max(own["error_bound_rad"], before["error_bound_rad"])
        return own


def finger_bench(settings: FingerBenchSettings) -> Bench:
    """A probe and the resonant finger that it meets."""
    bench = Bench(settings, "probe")
    FingerPart(bench, settings)
    return bench

"""A tip with a force sensor, in an arm's tool, on a table, as a part of a bench."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from drivers.core.errors import RefusedError
from drivers.core.messages import Floats
from simulator.physics.bench import Bench, BenchPart, StreamSpec
from simulator.physics.fingertip_settings import (
    BRIDGES,
    FINGER,
    MATRIX,
    PATCH_TEXELS,
    PLANTS,
    STREAM_IDLE,
    STREAM_TEXELS,
    STREAMS,
    Bridge,
    Matrix,
    Sensor,
    SlipBenchSettings,
)
from simulator.physics.noise import gaussian_at
from simulator.physics.slip import SENSORS, SlipPlant
from simulator.physics.slip_track import SlipTruth, Track


class FingertipPart(BenchPart):
    """One plant, the one whose sensor the tip carries; the others' sensors touch nothing and read their noise.

    The table lies flat in the arm's base frame: the tool presses along -z, slides along x, rolls about y. The arm
    turns the tip about the axis of its cylinder: moving by radius x angle while it turns, it rolls without slipping.

    Attributes:
        truth: When contact and slip really began and ended in this trial.
    """

    offers = (
        *("streams", "sample", "events", "excite", "set_tendon", "load", "sensor", "contacts", "slips"),
        *("forces_n", "matrices", "texels_v"),
    )

    def __init__(self, bench: Bench, settings: SlipBenchSettings) -> None:
        super().__init__(bench)
        self._settings = settings
        self._plant = SlipPlant(settings.of("fingertip"))
        self._computed = dict.fromkeys(PLANTS, 0)
        self._begin("fingertip")

    def warm_up(self) -> None:
        """Let compiled code load, or compile on first use, before an answer is due."""
        plant = SlipPlant(self._settings.of("fingertip"))
        plant.begin(key=(0, 0))
        ramp = np.linspace(0.0, 1.0, 50)
        plant.advance(1e-3 * ramp, 1e-4 * ramp, 0.1 * ramp)
        gaussian_at((0, 0), STREAM_IDLE, np.arange(1))

    def check(self, settings: SlipBenchSettings, factors: Mapping[str, Any]) -> None:
        """The factor `sensor` names what the tip carries."""
        sensor = factors.get("sensor", "fingertip")
        if sensor not in PLANTS:
            raise RefusedError(
                "tip", f"carrying {sensor}", "no such sensor", f"choose one of {', '.join(PLANTS)}"
            )

    def begin(self, settings: SlipBenchSettings, factors: Mapping[str, Any]) -> None:
        """Nothing has slid yet, the tool is where it is."""
        self._settings = settings
        self._begin(factors.get("sensor", "fingertip"))

    def _begin(self, sensor: Sensor) -> None:
        wanted = self._settings.of(sensor)
        if wanted != self._plant.settings:
            self._plant = SlipPlant(wanted)
        self.sensor = sensor
        arm_m, press_m, roll_rad = (float(track[0]) for track in self._tracks(np.array([self.bench.t_s])))
        self._plant.begin(key=self.bench.key, arm_m=arm_m, press_m=press_m, roll_rad=roll_rad)
        self._track = Track(wanted.rate_hz, len(wanted.bridges) + len(_BEHIND))
        self.truth = SlipTruth(wanted.rate_hz, self.bench.origin_s)

    # what the arm feels

    def wrench(self, times_s: Floats, direction: Sequence[float]) -> Floats:
        """What the table does; see `Bench.wrench`."""
        tangential_n, normal_n = self._behind(times_s)[:, :2].T
        found = np.zeros((len(times_s), 6))
        found[:, 0] = -tangential_n
        found[:, 2] = normal_n
        if self.sensor == "wrist":
            found[:, 2] += self._plant.settings.bridges[0].tangential * tangential_n
        return found

    def load(self, bridge: Bridge, force_n: float) -> None:
        """Hang a weight on a bridge of the fingertip, in the air, from the present time on; 0 takes it away.

        Raises:
            RefusedError: the tip carries another sensor.
        """
        if self.sensor != "fingertip":
            raise RefusedError(
                "fingertip", "being loaded", f"the tip carries {self.sensor}", "run it with the fingertip"
            )
        self._plant.load_n[BRIDGES[bridge]] = force_n

    # what devices are wired to

    def streams(self) -> Sequence[StreamSpec]:
        """What the board has, in the order of its stream ids."""
        return STREAMS

    def advance(self, t_s: float) -> None:
        """See `BenchPart`; the tip's own state is followed whatever is subscribed."""
        for numbers in self._track.due(t_s - self.bench.origin_s):
            times_s = self.bench.origin_s + numbers / self._plant.settings.rate_hz
            plant, tracks = self._plant, self._tracks(times_s)
            values = plant.feel(*tracks)
            self.truth.follow(numbers, plant.slid_m, plant.normal_n)
            self._computed[self.sensor] += len(numbers)
            self._track.push(np.column_stack([values, plant.tangential_n, plant.normal_n, tracks[2]]))

    def sample(self, stream: str, times_s: Floats) -> Floats:
        """What a sensor of the board shows at recent instants, V, shape (n, channels)."""
        number = next(number for number, spec in enumerate(STREAMS) if spec.name == stream)
        carried: Sensor = ("fingertip", "flexible_finger")[number]
        if self.sensor == carried:
            return self._shown(times_s)
        return np.column_stack(
            [
                self._settings.noise_scale * bridge.noise * self._idle(8 * number + channel, times_s)
                for channel, bridge in enumerate(SENSORS[PLANTS[carried]].bridges)
            ]
        )

    def forces_n(self, finger: int, times_s: Floats) -> Floats:
        """What a finger of the hand feels at recent instants, N, shape (n,)."""
        bridge = SENSORS[PLANTS["barrett_finger"]].bridges[0]
        if self.sensor == "barrett_finger" and finger == FINGER:
            return self._shown(times_s)[:, 0] / bridge.gain
        sigma_n = self._settings.noise_scale * bridge.noise / bridge.gain
        return sigma_n * self._idle(finger, times_s)

    def matrices(self) -> Sequence[Matrix]:
        """One matrix: the tip has one fingertip."""
        return (MATRIX,)

    def texels_v(self, times_s: Floats) -> Floats:
        """What the texels show at recent instants, V, shape (n, cells): the patch, and each texel's own noise.

        The patch wanders across the rows as the tip rolls; in its middle it is as strong as the plant's one taxel.
        """
        bridge = SENSORS[PLANTS["dsa"]].bridges[0]
        cells = MATRIX.rows * MATRIX.columns
        numbers = self._track.number(times_s - self.bench.origin_s)
        noise = gaussian_at(
            self.bench.key, STREAM_TEXELS, (numbers[:, None] * cells + np.arange(cells)).ravel()
        )
        values_mv = self._settings.noise_scale * bridge.noise * noise.reshape(-1, cells)
        if self.sensor == "dsa":
            roll_rad = self._behind(times_s)[:, -1]
            center = (MATRIX.rows - 1) / 2.0 + self._settings.radius_m * roll_rad / MATRIX.texel_m
            across = np.arange(MATRIX.rows) - center[:, None]
            along = np.arange(MATRIX.columns) - (MATRIX.columns - 1) / 2.0
            spread = across[:, :, None] ** 2 + along**2
            weights = np.exp(-spread / (2.0 * PATCH_TEXELS**2)).reshape(-1, cells)
            values_mv += self._shown(times_s)[:, :1] * weights
        return 1e-3 * values_mv

    @property
    def contacts(self) -> Sequence[tuple[float, bool]]:
        """The truth: when contact began (True) and ended (False) in this trial."""
        return self.truth.contacts

    @property
    def slips(self) -> Sequence[tuple[float, bool]]:
        """The truth: when slip began (True) and ended (False) in this trial."""
        return self.truth.slips

    def scene(self, t_s: float) -> Mapping[str, float]:
        """Where the tip is."""
        arm_m, press_m, roll_rad = (float(track[0]) for track in self._tracks(np.array([t_s])))
        return {"arm_m": arm_m, "press_m": press_m, "roll_rad": roll_rad}

    def account(self) -> Mapping[str, Any]:
        """What was computed: samples of each sensor."""
        return {"computed": {sensor: n for sensor, n in self._computed.items() if n}}

    # its own ways

    def _tracks(self, times_s: Floats) -> tuple[Floats, Floats, Floats]:
        """Place of the tip along the table, how far it presses, and its angle, at each instant."""
        places = self.bench.places(times_s)
        roll_rad = places[:, 4]
        return (
            places[:, 0] - self._settings.radius_m * roll_rad,
            -places[:, 2] - self._settings.surface_m,
            roll_rad,
        )

    def _shown(self, times_s: Floats) -> Floats:
        """What the sensor's channels show, shape (n, channels): noise is made for subscribed channels alone."""
        numbers = self._track.known(times_s - self.bench.origin_s)
        values = self._plant.shown(self._track.kept(numbers)[:, : -len(_BEHIND)], numbers - 1)
        values[numbers == 0] = 0.0  # when the trial begins
        return values

    def _behind(self, times_s: Floats) -> Floats:
        return self._track.at(times_s - self.bench.origin_s)[:, -len(_BEHIND) :]

    def _idle(self, stream: int, times_s: Floats) -> Floats:
        """Deviates of a sensor that touches nothing, one for each sample of 1 kHz."""
        numbers = np.floor((times_s - self.bench.origin_s) * 1000.0 + 1e-6).astype(np.int64)
        return gaussian_at(self.bench.key, STREAM_IDLE + stream, np.maximum(numbers, 0))


_BEHIND = ("tangential_n", "normal_n", "roll_rad")
"""What is kept beside the bridges' values, in the last columns."""


def slip_bench(settings: SlipBenchSettings) -> Bench:
    """A tip with one of five force sensors, on a table."""
    bench = Bench(settings, "tip", one_axis="this mover cannot slide and roll")
    FingertipPart(bench, settings)
    return bench

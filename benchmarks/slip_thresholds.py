"""Thresholds of the slip detectors on the slip bench's streams: for one false alarm in an hour without slip.

    python -m benchmarks slip_thresholds [--quick]

Everything here is simulated: what the devices of `mock/bench_slip` would send while the arm rolls the pressed tip to
and fro, smoothly and with a bump a second. The thresholds of the profile `mock/slip` are from here, except the two
that the paper prints.
"""

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from benchmarks.results import kept, save
from controller.detectors.calibration import Statistic, span_maxima, threshold_for
from controller.detectors.slip import SlipDetector, SlipPaperDetector, SlipPaperSettings, SlipSettings
from controller.reports.slip_scores import VERDICTS
from drivers.core.messages import Floats
from simulator.physics.fingertip_part import slip_bench
from simulator.physics.fingertip_settings import CONVERTER_V, FINGER, Sensor, SlipBenchSettings
from simulator.physics.noise import gaussian_at

RATES_HZ: Mapping[Sensor, float] = {
    "fingertip": 1000.0,
    "flexible_finger": 1000.0,
    "barrett_finger": 1000.0,
    "wrist": 500.0,
    "dsa": 100.0,
}

HAND_N = 2.0 * 9.80665 / 2048.0
TEXEL_V = 1e-3
ARM_N = 0.5
"""One count of the hand and of a texel; standard deviation of the arm's own force sensor: as the devices have them."""

HOURS, QUICK_HOURS = 6.0, 1.0 / 3.0
"""Hours of recordings for each threshold: six expected alarms, known to within a factor of two and a half (Poisson,
95 %)."""

SETTLE_S = 5.0
"""Omitted at a recording's beginning, while a detector learns."""

SEED = 77
PIECE_S = 600.0
CHUNK_S = 2.0
SURFACE_M = 0.003

PAPER_THRESHOLDS = {"fingertip": 10.0, "flexible_finger": 0.25}
"""Printed in 4.3 and 5.1; none for the others."""

CARRIED: Mapping[str, tuple[Sensor, float, str]] = {
    "fingertip_ours": ("fingertip", 1.0, "slip"),
    "flexible_ours": ("flexible_finger", 1.0, "slip"),
    "barrett_paper": ("barrett_finger", 0.0, "slip.paper"),
    "barrett_ours": ("barrett_finger", 1.0, "slip"),
    "wrist_paper": ("wrist", 0.0, "slip.paper"),
    "wrist_ours": ("wrist", 1.0, "slip"),
    "dsa_paper": ("dsa", 0.0, "slip.paper"),
    "dsa_ours": ("dsa", 0.0, "slip"),
}
"""Detectors of `mock/slip` whose thresholds come from here: sensor, bumps a second, kind. The paper prints the other
two."""


class Rolling:
    """An arm that presses 1 mm and rolls to and fro at 0.05 rad/s without slipping."""

    def __init__(self, radius_m: float) -> None:
        self._radius_m = radius_m

    def place(self, t_s: float, position_m: float) -> None:
        """It is led."""

    def offsets(self, times_s: Floats) -> Floats:
        """Where it is."""
        found = np.zeros((len(times_s), 6))
        found[:, 2] = -SURFACE_M - 1e-3
        found[:, 4] = 0.5 * np.abs((times_s / 10.0) % 2.0 - 1.0)
        found[:, 0] = self._radius_m * found[:, 4]
        return found


def read(bench: Any, sensor: Sensor, times_s: Floats) -> Any:
    """The samples of the sensor's device, in the unit of its stream, shape (n, channels)."""
    if sensor == "fingertip":
        return CONVERTER_V * np.rint(bench.sample("fingertip", times_s)[:, 2:] / CONVERTER_V)
    if sensor == "flexible_finger":
        return CONVERTER_V * np.rint(bench.sample("flexible", times_s) / CONVERTER_V)
    if sensor == "barrett_finger":
        return HAND_N * np.rint(bench.forces_n(FINGER, times_s) / HAND_N)[:, None]
    if sensor == "wrist":
        ticks = np.rint(times_s * RATES_HZ[sensor]).astype(np.int64)
        noise_n = ARM_N * gaussian_at(bench.key, 32, 6 * ticks + 2)
        return (bench.wrench(times_s, (0.0, 0.0, -1.0))[:, 2] + noise_n)[:, None]
    return TEXEL_V * np.rint(bench.texels_v(times_s).clip(0.0) / TEXEL_V)


def recording(sensor: Sensor, number: int, bumps_hz: float) -> Floats:
    """Ten minutes without slip.

    Raises:
        RuntimeError: it slipped.
    """
    settings = SlipBenchSettings(bumps_hz=bumps_hz)
    bench = slip_bench(settings)
    bench.mount(Rolling(settings.radius_m))
    bench.begin(0.0, SEED, number, {"sensor": sensor}, settings.model_dump())
    rate_hz = RATES_HZ[sensor]
    parts = []
    for chunk in range(round(PIECE_S / CHUNK_S)):
        begin = round(chunk * CHUNK_S * rate_hz)
        end = round((chunk + 1) * CHUNK_S * rate_hz)
        bench.advance(end / rate_hz)
        parts.append(read(bench, sensor, np.arange(begin + 1, end + 1) / rate_hz))
    if bench.slips:
        raise RuntimeError(f"{sensor}: it slipped {len(bench.slips) // 2} times in recording {number}")
    return np.concatenate(parts)


def detectors(sensor: Sensor, bumps_hz: float) -> dict[str, Statistic]:
    """Detectors whose thresholds a profile takes from here."""
    block_s = 0.16 if sensor == "dsa" else 0.064
    both: dict[str, Statistic] = {
        "slip.paper": SlipPaperDetector("paper", SlipPaperSettings(block_s=block_s)),
        "slip": SlipDetector("ours", SlipSettings()),
    }
    return {name: both[name] for name in both if (sensor, bumps_hz, name) in CARRIED.values()}


def maxima_of(sensor: Sensor, bumps_hz: float, number: int) -> dict[str, Floats]:
    """Each detector's maxima on a recording, second by second once it has settled."""
    values, rate_hz = recording(sensor, number, bumps_hz), RATES_HZ[sensor]
    settled = round(SETTLE_S * rate_hz)
    return {
        name: span_maxima(judge.statistic(values, rate_hz)[settled:], rate_hz)
        for name, judge in detectors(sensor, bumps_hz).items()
    }


def figures(sensor: Sensor, bumps_hz: float, pieces: Sequence[Mapping[str, Floats]]) -> list[dict[str, Any]]:
    """Both detectors on the recordings of a sensor, for the JSON file."""
    rows = []
    for name in pieces[0]:
        found = threshold_for(
            np.concatenate([each[name] for each in pieces]), VERDICTS["false_alarm_interval_s"]
        )
        row: dict[str, Any] = {"sensor": sensor, "bumps_hz": bumps_hz, "detector": name}
        row["carried_by"] = [key for key, what in CARRIED.items() if what == (sensor, bumps_hz, name)]
        row |= {"threshold": found.threshold, "threshold_low": found.low}
        row |= {"threshold_high": found.high if np.isfinite(found.high) else None}
        rows.append(row | {"extrapolated": found.extrapolated, "recording_s": found.recording_s})
    return rows


def main(quick: bool = False) -> None:
    """Find all thresholds; writes results/slip_thresholds.json. Maxima are kept: an interrupted run continues."""
    hours = QUICK_HOURS if quick else HOURS
    numbers = range(round(hours * 3600.0 / PIECE_S))
    rows = []
    for sensor, bumps_hz in dict.fromkeys((sensor, bumps_hz) for sensor, bumps_hz, _ in CARRIED.values()):
        pieces = [
            kept(f"thresholds_{sensor}_{bumps_hz:g}_{n}", partial(maxima_of, sensor, bumps_hz, n))
            for n in numbers
        ]
        rows += figures(sensor, bumps_hz, pieces)
    about = {"simulated": True, "hours": hours, "seed": SEED, "recordings": len(numbers)}
    interval = {"false_alarm_interval_s": VERDICTS["false_alarm_interval_s"]}
    save("slip_thresholds", {**about, **interval, "thresholds": rows}, quick=quick)


if __name__ == "__main__":
    main()

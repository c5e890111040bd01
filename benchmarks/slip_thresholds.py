"""Thresholds of the slip detectors on the slip bench's streams: for one false alarm in an hour of rolling without slip.

    python -m benchmarks.slip_thresholds [--hours 2] [--bumps 0] [sensor …]

Everything here is simulated: what the devices of `mock/bench_slip` would send while the arm rolls the pressed tip to
and fro. The profile `mock/slip` has what this prints, rounded.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from controller.detectors.calibration import calibrate
from controller.detectors.slip import SlipDetector, SlipPaperDetector, SlipPaperSettings, SlipSettings
from drivers.mock.noise import gaussian_at
from drivers.mock.slip_bench import SlipBench
from drivers.mock.slip_scene import CONVERTER_V, FINGER, PLANTS, SlipBenchSettings

Floats = NDArray[np.float64]

RATES_HZ: Mapping[str, float] = {
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

PIECE_S = 600.0
SETTLE_S = 5.0
CHUNK_S = 2.0
SURFACE_M = 0.003


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


def read(bench: SlipBench, sensor: str, times_s: Floats) -> Floats:
    """What the sensor's device sends, in the unit of its stream, shape (n, channels)."""
    if sensor == "fingertip":
        return CONVERTER_V * np.rint(bench.sample("fingertip", times_s)[:, 2:] / CONVERTER_V)
    if sensor == "flexible_finger":
        return CONVERTER_V * np.rint(bench.sample("flexible", times_s) / CONVERTER_V)
    if sensor == "barrett_finger":
        return HAND_N * np.rint(bench.finger_n(FINGER, times_s) / HAND_N)[:, None]
    if sensor == "wrist":
        ticks = np.rint(times_s * RATES_HZ[sensor]).astype(np.int64)
        noise_n = ARM_N * gaussian_at(bench.key, 32, 6 * ticks + 2)
        return (bench.wrench(times_s, (0.0, 0.0, -1.0))[:, 2] + noise_n)[:, None]
    return TEXEL_V * np.rint(bench.texels_v(times_s).clip(0.0) / TEXEL_V)


def recording(sensor: str, number: int, bumps_hz: float) -> Floats:
    """Ten minutes without slip."""
    settings = SlipBenchSettings(bumps_hz=bumps_hz)
    bench = SlipBench(settings)
    bench.mount(Rolling(settings.radius_m))
    bench.begin(0.0, 77, number, {"sensor": sensor}, settings.model_dump())
    rate_hz = RATES_HZ[sensor]
    parts = []
    for chunk in range(round(PIECE_S / CHUNK_S)):
        begin = round(chunk * CHUNK_S * rate_hz)
        end = round((chunk + 1) * CHUNK_S * rate_hz)
        bench.advance(end / rate_hz)
        parts.append(read(bench, sensor, np.arange(begin + 1, end + 1) / rate_hz))
    if bench.slips:
        print(f"  {sensor}: it slipped {len(bench.slips) // 2} times in recording {number}")
    return np.concatenate(parts)


def main() -> None:
    """Print a line for each sensor and detector."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("sensors", nargs="*", default=list(PLANTS))
    parser.add_argument("--hours", type=float, default=2.0)
    parser.add_argument("--bumps", type=float, default=0.0, help="bumps a second")
    given = parser.parse_args()
    for sensor in given.sensors:
        rate_hz = RATES_HZ[sensor]
        block_s = 0.16 if sensor == "dsa" else 0.064
        judges = {
            "slip.paper": SlipPaperDetector("paper", SlipPaperSettings(block_s=block_s)),
            "slip": SlipDetector("ours", SlipSettings()),
        }
        shown: dict[str, list[Floats]] = {name: [] for name in judges}
        for number in range(max(1, round(given.hours * 3600.0 / PIECE_S))):
            values = recording(sensor, number, given.bumps)
            for name, judge in judges.items():
                shown[name].append(judge.statistic(values, rate_hz)[round(SETTLE_S * rate_hz) :])
        for name, pieces in shown.items():
            found = calibrate(_Shown(np.concatenate(pieces)), np.empty(0), rate_hz, 3600.0)
            label = ", extrapolated" if found.extrapolated else ""
            print(
                f"{sensor} {name}: {found.threshold:.4g} ({found.low:.4g} to {found.high:.4g}{label})",
                flush=True,
            )


class _Shown:
    """A statistic that has been worked out already, piece by piece."""

    def __init__(self, statistic: Floats) -> None:
        self._statistic = statistic

    def statistic(self, values: Floats, rate_hz: float) -> Floats:
        """As it was."""
        return self._statistic


if __name__ == "__main__":
    main()

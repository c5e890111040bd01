"""A thousand million samples through the slip detector: does it drift? `python -m benchmarks slip_endurance`."""

from __future__ import annotations

import time

import numpy as np
from numpy.typing import NDArray

from benchmarks.results import save
from benchmarks.slip.reference import Reference
from controller.detectors.slip import SlipDetector, SlipSettings
from drivers.messages import SampleBlock

RATE_HZ = 1000.0
CHUNK = 1_000_000
WINDOW = 800_000
COMPARED = 100_000
"""Last samples that the reference hears, and those of them that are compared. Detectors with different pasts forget
the difference by a factor of 3 in 40 s (measured: the weights decide which rows count, so that the memory is longer
than 4 s); 700 s leave 1e-9 of it."""

OFFSET = 1000.0
"""In standard deviations of the noise."""

GLITCH = 1e9
TOLERANCE = 1e-9


def chunk(number: int) -> NDArray[np.float64]:
    """Noise of deviation 1 on the offset, with about one ringing bump a second; no two chunks are alike."""
    rng = np.random.default_rng([20, number])
    x = OFFSET + rng.standard_normal(CHUNK)
    ring = np.exp(-np.arange(200) / 30.0) * np.sin(2.0 * np.pi * 0.18 * np.arange(200))
    for start in rng.integers(0, CHUNK - 200, size=CHUNK // 1000):
        x[start : start + 200] += rng.exponential(60.0) * ring
    return x


def main(quick: bool = False) -> None:
    """Run 1e9 samples (1e7 if quick) with a glitch and a gap on the way; compare the end with the reference."""
    chunks = 10 if quick else 1000
    detector = SlipDetector("slip", SlipSettings(threshold=1e6))
    heard_s = 0.0
    for number in range(chunks):
        x = chunk(number)
        if number == chunks // 2:
            x[1000] = GLITCH
            # with the two differences behind it a multiple of 8: weights are then solved for at the same samples
            x[5000:5294] = np.nan
        block = SampleBlock(
            "board.tangential", number * CHUNK, number * CHUNK / RATE_HZ, x[:, None], rate_hz=RATE_HZ
        )
        started = time.process_time()
        trace = detector.hear(block)
        heard_s += time.process_time() - started
    reference = Reference(SlipSettings(), RATE_HZ).push(x[-WINDOW:])
    error = float(np.max(np.abs(trace[-COMPARED:] - reference[-COMPARED:])))
    result = {
        "samples": chunks * CHUNK,
        "offset_sigma": OFFSET,
        "glitch": GLITCH,
        "largest_evidence_nats": float(np.max(reference[-COMPARED:])),
        "error_nats": error,
        "tolerance_nats": TOLERANCE,
        "met": error <= TOLERANCE,
        "ns_per_sample": 1e9 * heard_s / (chunks * CHUNK),
    }
    if not quick:
        save("slip_endurance", result)
    for name, value in result.items():
        print(f"{name:24} {value}")


if __name__ == "__main__":
    main()

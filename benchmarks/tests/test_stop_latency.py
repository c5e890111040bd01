"""The benchmark of the stop, a few stops short: what it times is there, and in the order in which it happens."""

import pytest

from benchmarks.stop_latency import measure
from simulator.wiring.bench_clock import SLACK_S

STOPS = 4


@pytest.mark.parametrize("mover", ["stage", "arm"])
def test_each_stop_is_timed_from_its_sample_to_standstill(mover):
    latencies, how = measure(mover, STOPS, realtime=False)
    assert {way: len(seconds) for way, seconds in latencies.items()} == dict.fromkeys(
        ("sample to host", "host to wire", "sample to wire", "wire to standstill", "sample to standstill"),
        STOPS,
    )
    # The model of the board's clock dates samples late by their least delay so far, which on a bench's clock is the
    # slack of one thread at most; all else is timed by one clock, which may stand still between decision and stop.
    assert min(latencies["sample to host"]) >= -SLACK_S
    assert min(latencies["host to wire"]) >= 0.0
    assert min(latencies["wire to standstill"]) > 0.0
    assert min(latencies["sample to standstill"]) > 0.0
    for way, parts in {
        "sample to wire": ("sample to host", "host to wire"),
        "sample to standstill": ("sample to wire", "wire to standstill"),
    }.items():
        both = [sum(pair) for pair in zip(*(latencies[part] for part in parts), strict=True)]
        assert latencies[way] == pytest.approx(both)
    # the arm's own rows may be lost where the program is late; no other sample may
    assert {stream for stream, samples in how["lost"].items() if samples} <= {"arm.position", "arm.force"}

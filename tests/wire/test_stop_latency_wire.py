"""The benchmark of the stop, a few stops short: what it times is there, and in the order in which it happens."""

import pytest

from benchmarks.stop_latency import measure

STOPS = 4


@pytest.mark.parametrize("mover", ["stage", "arm"])
def test_each_stop_is_timed_from_its_sample_to_standstill(mover):
    latencies, how = measure(mover, STOPS, realtime=False)
    assert {way: len(seconds) for way, seconds in latencies.items()} == dict.fromkeys(
        ("sample to host", "host to wire", "sample to wire", "wire to standstill", "sample to standstill"),
        STOPS,
    )
    assert all(seconds > 0.0 for of_way in latencies.values() for seconds in of_way)
    for way, parts in {
        "sample to wire": ("sample to host", "host to wire"),
        "sample to standstill": ("sample to wire", "wire to standstill"),
    }.items():
        both = [sum(pair) for pair in zip(*(latencies[part] for part in parts), strict=True)]
        assert latencies[way] == pytest.approx(both)
    # the arm's own rows may be lost where the program is late; no other sample may
    assert {stream for stream, samples in how["lost"].items() if samples} <= {"arm.position", "arm.force"}

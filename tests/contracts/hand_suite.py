"""What every hand promises: run for the mock driver in virtual time, for the real one on a pty."""

from itertools import pairwise

import numpy as np
import pytest

from drivers.core.messages import Home, Listen, Lost, Refused, Saturated, Sent, Tare
from tests.contracts.crank import Crank
from tests.contracts.sensor_suite import SensorContract

FORCES_N = {11: 1.0, 12: -2.0, 13: 18.0}
"""On the fingers; the third is beyond the range in which the hand works."""

F1, F2, F3 = (f"hand.strain_{finger}" for finger in FORCES_N)


class HandBench(Crank):
    """A hand called `hand`."""


class HandContract(SensorContract):
    """Subclasses give a fixture `bench` whose fingers feel `FORCES_N`."""

    stream = F1
    senseless = (Home("hand"), Tare("hand", "hand.strain_14"), Listen("hand", frozenset({"hand.palm"})))

    def check_pause(self, bench: HandBench, missing: int, pause: float) -> None:
        assert missing >= 0
        # a busy bus may be too slow for some cycles of the last fifth of a second, and the pause was twice as long
        assert sum(lost.samples for lost in bench.of(Lost)) < 0.6 * pause, "the pause itself is not lost"

    def test_each_finger_has_a_stream_in_newtons(self, bench: HandBench) -> None:
        assert {name: (stream.unit, len(stream.channels)) for name, stream in bench.info.streams.items()} == {
            F1: ("N", 1),
            F2: ("N", 1),
            F3: ("N", 1),
        }
        assert not bench.info.mover

    def test_the_forces_on_the_fingers_are_read(self, bench: HandBench) -> None:
        bench.listen(F1, F2, F3)
        bench.turn(0.3)
        for stream, force_n in zip((F1, F2, F3), FORCES_N.values(), strict=True):
            assert bench.blocks_of(stream)[-1].physical[-1, 0] == pytest.approx(force_n, abs=0.005)

    def test_one_finger_can_be_subscribed_alone(self, bench: HandBench) -> None:
        bench.listen(F2)
        bench.turn(0.2)
        assert {block.stream for block in bench.blocks} == {F2}

    def test_samples_stand_on_one_grid_and_what_is_missing_is_reported(self, bench: HandBench) -> None:
        bench.listen(F1, F2)
        bench.turn(0.4)
        bench.listen()
        bench.turn(0.05)
        blocks = bench.blocks_of(F1)
        rate_hz = bench.info.streams[F1].rate_hz
        gaps = 0
        for before, after in pairwise(blocks):
            steps = after.seq - before.seq
            gaps += steps - len(before)
            assert steps >= len(before)
            assert after.t0_s - before.t0_s == pytest.approx(steps / rate_hz, abs=1e-6)
        assert gaps == sum(lost.samples for lost in bench.of(Lost) if lost.stream == F1)
        assert all(block.rate_hz == rate_hz for block in blocks)
        assert all(np.issubdtype(block.values.dtype, np.integer) for block in blocks), "raw counts"

    def test_a_finger_beyond_its_range_is_reported_once(self, bench: HandBench) -> None:
        bench.listen(F1, F3)
        bench.turn(0.3)
        (saturated,) = bench.of(Saturated)
        assert saturated.stream == F3
        assert saturated.value == pytest.approx(18.0, abs=0.005)

    def test_a_tare_makes_the_present_reading_zero(self, bench: HandBench) -> None:
        bench.device.apply(Tare("hand", F1))
        bench.turn(0.02)
        assert "listen to it first" in bench.of(Refused)[0].reason
        bench.listen(F1)
        bench.turn(0.2)
        bench.device.apply(Tare("hand", F1))
        bench.turn(0.2)
        assert len(bench.of(Sent)) == 1
        assert bench.blocks_of(F1)[-1].physical[-1, 0] == pytest.approx(0.0, abs=0.01)

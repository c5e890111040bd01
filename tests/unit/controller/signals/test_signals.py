"""Signals: subscriptions; level, spectrum and strain."""

import math
from typing import Any

import numpy as np
import pytest

from controller.signals.level import window, z_scores
from controller.signals.protocol import Signals
from controller.signals.spectrum import BlockCutter, block_peaks
from controller.signals.strain import CHANNELS, Strain, StrainSettings
from drivers.core.messages import SampleBlock, Saturated, StreamInfo
from tests.refusals import refused


class Doubled:
    """Twice its input; reports a value beyond ten."""

    def __init__(self, name, source):
        self.name = name
        self.inputs = (source,)
        self.info = StreamInfo(f"signals.{name}", ("x",), "V", rate_hz=1000.0)
        self.resets = 0

    def push(self, block):
        made = SampleBlock(self.info.name, block.seq, block.t0_s, 2.0 * block.physical, rate_hz=block.rate_hz)
        beyond = made.values[np.abs(made.values) > 10.0][:1]
        return [made, *(Saturated(block.last_s, "signals", self.info.name, float(x)) for x in beyond)]

    def reset(self):
        self.resets += 1


def block(*values, stream="board.bridge"):
    return SampleBlock(stream, 0, 0.0, np.array(values, dtype=float)[:, None], rate_hz=1000.0)


def test_a_signal_without_a_subscriber_computes_nothing_and_beyond_its_range_is_reported():
    signals = Signals([Doubled("a", "board.bridge")])
    assert signals.subscribe(frozenset({"board.bridge"})) == {"board.bridge"}
    assert signals.push([block(1.0)]) == ([], [])
    signals.subscribe(frozenset({"signals.a"}))
    _, saturated = signals.push([block(1.0, 6.0)])
    assert [(status.stream, status.value) for status in saturated] == [("signals.a", 12.0)]


@pytest.mark.parametrize("given", [None, block(1.0), [block(1.0), 3]])
def test_a_signal_that_returns_no_list_of_blocks_is_named(given):
    signal: Any = Doubled("a", "board.bridge")
    signal.push = lambda block: given
    signals = Signals([signal])
    signals.subscribe(frozenset({"signals.a"}))
    with refused(ValueError, "signals.a", "push returns", "list of blocks"):
        signals.push([block(1.0)])


def test_a_subscribed_signal_needs_its_sources():
    signals = Signals([Doubled("a", "board.bridge"), Doubled("b", "signals.a")])
    assert signals.streams == {"signals.a", "signals.b"}
    assert signals.subscribe(frozenset({"signals.b", "stage.position"})) == {"board.bridge", "stage.position"}
    made, _ = signals.push([block(1.0, 2.0)])
    found = [(one.stream, one.values[:, 0].tolist()) for one in made]
    assert found == [("signals.a", [2.0, 4.0]), ("signals.b", [4.0, 8.0])]


def test_a_signal_is_reset_when_activated_and_not_while_active():
    signal = Doubled("a", "board.bridge")
    signals = Signals([signal])
    streams = frozenset({"signals.a"})
    signals.subscribe(streams)
    signals.subscribe(streams | {"stage.position"})
    assert signal.resets == 1
    signals.subscribe(frozenset())
    signals.subscribe(streams)
    assert signal.resets == 2


def scores(y, size, missing=None, pieces=1):
    state, found = window(size), []
    missing = np.zeros(len(y), np.int64) if missing is None else missing
    for part, lost in zip(np.array_split(y, pieces), np.array_split(missing, pieces), strict=True):
        out = np.empty(len(part))
        z_scores(state, np.ascontiguousarray(part), lost, out)
        found.append(out)
    return np.concatenate(found)


def plain(y, size):
    found = np.full(len(y), np.nan)
    for i in range(size - 1, len(y)):
        inside = y[i - size + 1 : i + 1]
        found[i] = (y[i] - inside.mean()) / inside.std(ddof=1)
    return found


@pytest.mark.parametrize("pieces", [1, 17, 500])
def test_it_is_the_plain_formula_however_the_samples_come(pieces):
    y = 0.2 + 1e-5 * np.random.default_rng(1).standard_normal(500)
    assert scores(y, 40, pieces=pieces) == pytest.approx(plain(y, 40), rel=1e-6, nan_ok=True)


@pytest.mark.parametrize("size", [3, 10, 100])
def test_no_sample_can_be_farther_than_its_window_allows_and_a_constant_one_gives_no_score(size):
    y = np.zeros(size)
    y[-1] = 1.0
    assert abs(scores(y, size)[-1]) == pytest.approx((size - 1) / math.sqrt(size), rel=1e-6)
    assert np.isnan(scores(np.full(300, 0.1), size)).all()


def test_a_gap_begins_the_window_anew_and_what_is_not_finite_or_far_off_leaves_no_error_behind():
    y = np.random.default_rng(3).standard_normal(100)
    y[20] = np.nan
    missing = np.zeros(100, np.int64)
    missing[60] = 5
    found = scores(y, 10, missing)
    assert np.flatnonzero(np.isnan(found)).tolist() == [*range(9), 20, *range(60, 69)]
    y = 50.0 + 1e-5 * np.random.default_rng(2).standard_normal(5000)
    y[1000] = -99.0
    assert scores(y, 100)[2000:] == pytest.approx(plain(y, 100)[2000:], rel=1e-4)


def defined_peak(block, rate_hz):
    """Section 3 of the paper, literally: equation (3), equation (4), no DC, the largest."""
    n = len(block)
    powers = []
    for k in range(1, n // 2 + 1):
        phi = sum(block[m] * np.exp(-2j * np.pi * k * m / n) for m in range(n))
        powers.append(abs(phi) ** 2 / n)
    best = int(np.argmax(powers))
    return powers[best], (best + 1) * rate_hz / n


@pytest.mark.parametrize("size", [2, 16, 63, 64])
def test_the_peak_is_that_of_the_papers_definition(size):
    block = np.random.default_rng(size).standard_normal(size) + 5.0
    power, frequency_hz = block_peaks(block[None, :, None], 1000.0)
    expected_power, expected_hz = defined_peak(block, 1000.0)
    assert power[0] == pytest.approx(expected_power, rel=1e-12)
    assert frequency_hz[0] == expected_hz


@pytest.mark.parametrize("sizes", [[1] * 200, [7] * 29, [200], [63, 1, 65, 71]])
def test_blocks_do_not_depend_on_how_samples_arrive(sizes):
    values = np.random.default_rng(2).standard_normal((203, 2))
    cutter, start, ends, blocks = BlockCutter(64), 0, [], []
    for size in sizes:
        found, complete = cutter.push(values[start : start + size])
        ends += (start + found).tolist()
        blocks.append(complete)
        start += size
    assert ends == [63, 127, 191]
    assert np.array_equal(np.concatenate(blocks), values[:192].reshape(3, 64, 2))


def test_after_a_reset_the_next_sample_begins_a_block_of_two_samples_at_least():
    cutter = BlockCutter(4)
    cutter.push(np.ones((3, 1)))
    cutter.reset()
    assert cutter.push(np.ones((4, 1)))[0].tolist() == [3]
    with pytest.raises(ValueError, match="longer"):
        BlockCutter(1)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_value_that_is_not_finite_spoils_its_own_block_only(bad):
    blocks = np.random.default_rng(3).standard_normal((3, 4, 1))
    blocks[1, 1] = bad
    power, frequency_hz = block_peaks(blocks, 1000.0)
    assert np.isnan(power).tolist() == np.isnan(frequency_hz).tolist() == [False, True, False]


GAINS = np.array([0.0694, 0.0326, 1.0291])
COUNT_V = 20.0 / 2**16


def bridges(forces_n, seq=0, rate_hz=1000.0):
    counts = np.rint(np.asarray(forces_n) * GAINS / COUNT_V).astype(np.int32)
    about = {"rate_hz": rate_hz, "unit": "V", "scale": COUNT_V, "arrival_s": 9.0}
    return SampleBlock("board.fingertip", seq, seq / rate_hz, counts, **about)


def strain(**settings):
    return Strain("tip", StrainSettings(**settings))


def test_forces_normal_force_and_angle_come_out_of_the_bridges():
    (made,) = strain().push(bridges([[3.0, 4.0, 0.5], [-2.0, 2.0, -0.5]]))
    assert made.stream == "signals.tip"
    assert strain().info.channels == CHANNELS == ("Fx", "Fy", "Ft", "Fn", "theta_rad")
    # half a count of the converter is 2, 5 and 0.15 mN
    expected = [[3.0, 4.0, 0.5, 5.0, np.arctan2(3.0, 4.0)], [-2.0, 2.0, -0.5, np.sqrt(8.0), -np.pi / 4]]
    assert made.values == pytest.approx(np.array(expected), abs=0.006)
    assert (made.seq, made.t0_s, made.rate_hz, made.arrival_s) == (0, 0.0, 1000.0, 9.0)


def test_offsets_are_subtracted_and_a_stream_with_other_channels_is_refused_in_one_line():
    (made,) = strain(offset_v=(0.0694, 0.0, 0.0)).push(bridges([[2.0, 1.0, 0.0]]))
    assert made.values[0, 0] == pytest.approx(1.0, abs=0.006)
    wrong = SampleBlock("board.flexible", 0, 0.0, np.zeros((4, 1)), rate_hz=1000.0)
    with pytest.raises(ValueError, match=r"board\.flexible: 1 channels .* three bridges"):
        strain().push(wrong)


@pytest.mark.parametrize("size", [1, 2, 7, 50])
@pytest.mark.parametrize(("bridge", "limit_n"), [(0, 10.0), (1, 10.0), (2, 1.5)])
def test_an_overload_of_any_bridge_is_reported_once_however_the_samples_are_cut(size, bridge, limit_n):
    forces_n = np.zeros((50, 3))
    forces_n[10:30, bridge] = -1.05 * limit_n
    forces_n[40:, bridge] = 1.05 * limit_n
    signal = strain()
    blocks = [bridges(forces_n[start : start + size], seq=start) for start in range(0, 50, size)]
    made = [thing for block in blocks for thing in signal.push(block)]
    overloads = [thing for thing in made if isinstance(thing, Saturated)]
    assert {one.stream for one in overloads} == {"signals.tip"}
    assert [one.t_s for one in overloads] == pytest.approx([0.012, 0.042])
    assert [one.value for one in overloads] == pytest.approx([-1.05 * limit_n, 1.05 * limit_n], rel=0.01)


def test_a_spike_the_range_that_was_tested_and_a_count_that_a_gap_restarts_are_no_overload():
    forces_n = np.zeros((20, 3))
    forces_n[5:7] = 50.0
    forces_n[10:] = [7.0, 7.0, 1.0]
    assert len(strain().push(bridges(forces_n))) == 1
    signal = strain()
    for seq in (0, 100):
        assert len(signal.push(bridges([[11.0, 0.0, 0.0]] * 2, seq=seq))) == 1

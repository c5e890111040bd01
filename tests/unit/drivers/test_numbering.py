"""Numbers, loss and times of a stream whose truth is known, whatever its device and its line do."""

from dataclasses import dataclass, field
from random import Random

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from drivers.core.clock import VirtualClock
from drivers.core.clock_model import DeviceClock, HostClock
from drivers.core.messages import Floats, StreamInfo
from drivers.core.numbering import ENDLESS, Placed, Samples, SampleStream, StreamTrack

RATE_HZ = 1000.0
COUNTER_MODULUS = 1 << 16
WRAP_S = 2**32 * 1e-6
"""Of a clock of u32 microseconds."""

SECONDS_70_DAYS = 70 * 86_400.0


@dataclass
class Device:
    """Sends frames of ten samples at 1 kHz; host time 1000 s is its first sample's."""

    uptime_s: float = 20.0
    """What its clock shows at the first sample, wraps apart."""
    drift_ppm: float = 0.0
    counter: int = 0
    """What it counts the first sample as."""
    lag_s: float = 0.0
    """Time that passed on the host while it was off."""
    modulus: int = COUNTER_MODULUS
    clock: DeviceClock = field(default_factory=lambda: DeviceClock(200.0, WRAP_S))

    def __post_init__(self) -> None:
        self.track = StreamTrack(self.clock, RATE_HZ, self.modulus)

    def true_s(self, sample: int) -> float:
        return 1000.0 + sample / RATE_HZ / (1 + self.drift_ppm * 1e-6) + self.lag_s

    def send(self, sample: int, late_s: float = 0.0, n: int = 10) -> Placed:
        shown_us = round((self.uptime_s + sample / RATE_HZ) * 1e6) % 2**32
        arrival_s = self.true_s(sample + n - 1) + late_s
        counter = (self.counter + sample) % self.modulus
        return self.track.place(shown_us * 1e-6, arrival_s, n, counter=counter)

    def reboot(self, off_s: float, uptime_s: float = 0.0, counter: int = 0) -> None:
        self.uptime_s, self.counter, self.lag_s = uptime_s, counter, self.lag_s + off_s


@settings(max_examples=60, deadline=None)
@given(st.floats(0.0, SECONDS_70_DAYS), st.floats(-100.0, 100.0), st.integers(0, COUNTER_MODULUS - 1))
def test_the_wraps_of_clock_and_counter_are_neither_loss_nor_a_step(
    uptime_s: float, drift_ppm: float, counter: int
) -> None:
    device = Device(uptime_s=uptime_s, drift_ppm=drift_ppm, counter=counter)
    for sample in range(0, 3000, 10):
        placed = device.send(sample)
        assert placed.lost is None
        assert placed.seq == counter + sample
        assert placed.t0_s == pytest.approx(device.true_s(sample), abs=2e-5 if sample > 1000 else 1e-4)


def test_a_clock_that_wraps_under_way_goes_on() -> None:
    device = Device(uptime_s=WRAP_S - 0.5)
    shown_s = [device.send(sample).device_s for sample in range(0, 1000, 10)]
    assert np.diff(shown_s) == pytest.approx(0.01, abs=1e-6)


@settings(max_examples=60, deadline=None)
@given(
    st.floats(0.0, SECONDS_70_DAYS),
    st.integers(0, COUNTER_MODULUS - 1),
    st.integers(-30_000, 30_000).filter(lambda slip: abs(slip) > 60),
    st.floats(0.0, 0.08),
)
def test_a_counter_that_slips_moves_no_time(uptime_s: float, counter: int, slip: int, late_s: float) -> None:
    device = Device(uptime_s=uptime_s, counter=counter)
    for sample in range(0, 2000, 10):
        before = device.send(sample)
    device.counter += slip
    slipped = device.send(2000, late_s)
    assert slipped.lost == 0
    assert slipped.seq > before.seq + 10
    assert device.clock.restarts == 0
    for sample in range(2010, 4000, 10):
        placed = device.send(sample)
        assert placed.lost is None
        assert placed.t0_s == pytest.approx(device.true_s(sample), abs=1e-5)
    assert slipped.t0_s == pytest.approx(device.true_s(2000), abs=1e-5)


@settings(max_examples=60, deadline=None)
@given(st.floats(10.0, SECONDS_70_DAYS), st.floats(0.0, 60.0), st.floats(0.0, 0.5), st.integers(0, 20_000))
def test_a_device_that_reboots_begins_a_segment_at_the_right_time(
    uptime_s: float, off_s: float, boot_s: float, counter: int
) -> None:
    # One that reboots as its clock would have wrapped shows what it would have shown: a restart that cannot be seen.
    phase_s = (uptime_s + 1.0 + off_s) % WRAP_S
    assume(10.0 < phase_s < WRAP_S - 10.0)
    device = Device(uptime_s=uptime_s, counter=counter)
    for sample in range(0, 1000, 10):
        before = device.send(sample)
    device.reboot(off_s + boot_s, uptime_s=boot_s - 1.0)
    first = device.send(1000)
    assert first.lost == 0
    assert first.seq > before.seq + 10
    assert device.clock.restarts == 1
    times_s = [first.t0_s, *(device.send(sample).t0_s for sample in range(1010, 3000, 10))]
    assert times_s[0] >= before.t0_s + 9e-3
    assert times_s[-1] == pytest.approx(device.true_s(2990), abs=1e-5)
    assert np.diff(times_s).min() > 9e-3


def test_of_several_streams_each_begins_a_segment_when_the_device_reboots() -> None:
    device = Device()
    other = StreamTrack(device.clock, None, 256)
    device.send(0)
    assert other.place(20.005, device.true_s(12), counter=7).lost is None
    device.reboot(3.0)
    assert device.send(0).lost == 0
    assert other.place(0.015, device.true_s(16), counter=0).lost == 0
    assert device.send(10).lost is None


def test_a_device_that_rebooted_in_a_silence_that_was_asked_for_is_dated_by_its_new_clock() -> None:
    device = Device(uptime_s=5000.0)
    device.send(0)
    device.track.begin()
    device.reboot(60.0)
    placed = device.send(10)
    assert placed.lost is None
    assert placed.t0_s == pytest.approx(device.true_s(10), abs=1e-6)


def test_a_counter_that_slips_in_a_burst_of_late_frames_is_taken_for_a_reboot() -> None:
    """Like a device that was off; times are late by the burst at most, and recover smoothly."""
    device = Device()
    for sample in range(0, 2000, 10):
        device.send(sample)
    device.counter += 500
    assert device.send(2000, late_s=0.2).lost == 0
    assert device.clock.restarts == 1
    late_s = [device.send(sample).t0_s - device.true_s(sample) for sample in range(2010, 42_010, 10)]
    assert max(late_s) < 0.2
    assert late_s[-1] == pytest.approx(0.0, abs=1e-5)
    assert np.diff(late_s).max() < 1e-5


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(st.integers(1, 200_000), st.floats(0.0, 3.0)), max_size=10))
def test_what_is_missing_is_counted_exactly_however_late_the_next_frame_is(
    gaps: list[tuple[int, float]],
) -> None:
    device = Device(counter=65_000)
    sample = 0
    device.send(sample)
    for missing, late_s in gaps:
        sample += 10 + missing
        placed = device.send(sample, late_s)
        assert (placed.seq, placed.lost) == (65_000 + sample, missing)


@pytest.mark.parametrize("modulus", [100, 256, 1 << 32, ENDLESS], ids=["digits", "u8", "u32", "endless"])
@settings(max_examples=30, deadline=None)
@given(st.integers(0, 99), st.lists(st.integers(1, 5000), max_size=5))
def test_a_counter_of_any_width_wraps_without_loss_and_counts_a_true_one(
    modulus: int, counter: int, gaps: list[int]
) -> None:
    device, sample = Device(counter=counter, modulus=modulus), 0
    for missing in (0, *gaps):
        sample += missing
        losses = [device.send(at).lost for at in range(sample, sample + 600, 10)]
        assert losses == [missing or None, *[None] * 59]
        sample += 600


def test_a_counter_without_its_modulus_is_an_error() -> None:
    with pytest.raises(ValueError, match="counter_modulus"):
        StreamTrack(DeviceClock(200.0), RATE_HZ).place(0.0, 1000.0, counter=0)


@settings(max_examples=60, deadline=None)
@given(st.lists(st.sampled_from(["send", "lose", "slip", "reboot", "begin"]), max_size=60), st.randoms())
def test_numbers_and_times_ascend_and_no_gap_looks_closed_whatever_happens(
    happens: list[str], random: Random
) -> None:
    device, sample, whole = Device(), 0, True
    before: Placed | None = None
    for what in happens:
        if what == "send":
            placed = device.send(sample, late_s=random.choice([0.0, 1e-4, 0.05]))
            if before is not None:
                assert placed.seq == before.seq + 10 if whole else placed.seq > before.seq + 10
                assert placed.t0_s > before.t0_s + 9e-3
            before, whole = placed, True
            sample += 10
            continue
        # Without a frame before it, it could not be known.
        if before is None:
            continue
        if what == "lose":
            sample += random.randrange(1, 100)
        elif what == "slip":
            device.counter += random.randrange(200, 30_000)
        elif what == "reboot":
            device.reboot(0.5 + random.random(), uptime_s=-sample / RATE_HZ, counter=-sample)
        else:
            sample += 20
            device.track.begin()
        whole = False


def test_irregular_samples_are_lost_by_their_counter_and_a_counter_that_turns_back_has_slipped() -> None:
    track = StreamTrack(DeviceClock(200.0, WRAP_S), None, COUNTER_MODULUS)
    assert track.place(0.1, 1000.1, counter=65_530, n=2, span_s=0.05).lost is None
    assert track.place(0.9, 1000.9, counter=65_540 - COUNTER_MODULUS).lost == 8
    assert track.place(1.0, 1001.0, counter=3).lost == 0


def test_a_device_without_a_counter_is_numbered_by_its_clock() -> None:
    track = StreamTrack(DeviceClock(200.0), 500.0)
    numbers = [track.place(shown_s, 1000.0 + shown_s) for shown_s in (5.0, 5.002, 5.0038, 5.010, 5.012)]
    assert [(placed.seq, placed.lost) for placed in numbers] == [
        (0, None),
        (1, None),
        (2, None),
        (5, 2),
        (6, None),
    ]
    again = track.place(0.002, 1006.0)
    assert again.lost == 0
    assert again.seq > 7


FORCE = StreamInfo("a.b", ("x",), "N", rate_hz=1000.0)


def streamed(
    stamps_ms: list[float], at_once: int = 1, wrap_s: float | None = None
) -> tuple[list[int], list[int], list[int], Floats]:
    """What is lost before samples with these stamps: in which calls and how many; numbers and times of the samples.

    The value of each is its number here."""
    stream = SampleStream(FORCE, DeviceClock(200.0, wrap_s), VirtualClock(), np.int32)
    calls: list[int] = []
    losses: list[int] = []
    blocks = []
    for k, ms in enumerate(stamps_ms):
        lost = stream.push((k,), ms * 1e-3 if wrap_s is None else ms * 1e-3 % wrap_s, ms * 1e-3)[1]
        if lost is not None:
            calls.append(k)
            losses.append(lost)
        if k % at_once == at_once - 1 or k == len(stamps_ms) - 1:
            blocks += stream.take()
    taken = np.concatenate([block.values[:, 0] for block in blocks])
    assert taken.tolist() == list(range(len(taken)))
    assert len(taken) >= len(stamps_ms) - 1
    numbers = np.concatenate([block.seq + np.arange(len(block)) for block in blocks]).tolist()
    return calls, losses, numbers, np.concatenate([block.times for block in blocks])


@pytest.mark.parametrize("wrap_s", [None, 0.7])
@pytest.mark.parametrize("at_once", [1, 3, 8])
@pytest.mark.parametrize("late_ms", [[0.7], [1.0], [3.0, 2.2, 1.4, 0.6], [40.0, 30.0, 20.0, 10.0]])
def test_without_a_counter_stamps_that_are_late_cost_nothing_and_are_dated_when_they_were_due(
    late_ms: list[float], at_once: int, wrap_s: float | None
) -> None:
    stamps_ms = [float(k) for k in range(2000)]
    for begin in range(100, 2000, 500):
        for k, late in enumerate(late_ms, begin):
            stamps_ms[k] += late
    for k in range(1, 2000):  # those that are put off by the late ones come right behind them
        stamps_ms[k] = max(stamps_ms[k], stamps_ms[k - 1] + 0.1)
    _, losses, numbers, times_s = streamed(stamps_ms, at_once, wrap_s)
    assert losses == []
    assert numbers == list(range(2000))
    assert times_s == pytest.approx(1e-3 * np.arange(2000), abs=0.6e-3)


@pytest.mark.parametrize("missing", [1, 2, 16, 45, 60, 500])
@pytest.mark.parametrize("error", [-0.03, 0.0, 0.03], ids=["slow", "as_said", "fast"])
def test_without_a_counter_what_is_missing_is_counted_once_it_lasts(missing: int, error: float) -> None:
    ticks = [k for k in range(3200) if not any(at <= k < at + missing for at in (500, 1500, 2500))]
    calls, losses, numbers, _ = streamed([k / (1.0 + error) for k in ticks])
    # by device time alone a rate that is off by 3 % makes 3 % of a gap
    exact = error == 0.0 or missing < 10
    assert losses == [pytest.approx(missing / (1.0 + error), abs=0.1 if exact else 0.7)] * 3
    # the first behind a gap may be a late one, unless it is later than any firmware stamps
    assert calls == [ticks.index(at + missing) + (missing < 50) for at in (500, 1500, 2500)]
    if error == 0.0:
        assert numbers == ticks


def test_without_a_counter_losses_among_late_stamps_are_counted_one_by_one() -> None:
    random = Random(3)
    ticks = [k for k in range(10_000) if k % 250 != 125]
    late_ms = [0.7 if random.random() < 0.002 else 0.05 * random.random() for _ in ticks]
    _, losses, numbers, _ = streamed([k + late for k, late in zip(ticks, late_ms, strict=True)])
    assert losses == [1] * 40
    assert numbers[-1] == ticks[-1]


def test_a_sample_that_is_kept_is_of_its_subscription_and_of_its_clock() -> None:
    clock = DeviceClock(200.0)
    stream, other = (SampleStream(FORCE, clock, VirtualClock(), np.int32) for _ in range(2))
    for k, ms in enumerate([0.0, 1.0, 5.0]):
        stream.push((k,), ms * 1e-3, ms * 1e-3)
    stream.begin()
    for k, ms in enumerate([20.0, 21.0, 25.0], 10):
        stream.push((k,), ms * 1e-3, ms * 1e-3)
    clock.restart()
    other.push((0,), 0.0, 0.03)
    assert stream.push((20,), 0.0, 0.03)[1] == 0, "how many are missing is not known"
    for k in range(1, 4):
        assert stream.push((20 + k,), 1e-3 * k, 0.03 + 1e-3 * k)[1] is None
    values = np.concatenate([block.values[:, 0] for block in stream.take()])
    assert values.tolist() == [0, 1, 10, 11, 20, 21, 22, 23]


@pytest.mark.parametrize("restarts_at_ms", [1.0, 6000.0])
def test_a_device_that_restarts_while_a_sample_is_kept_is_one_that_restarted(restarts_at_ms: float) -> None:
    stream = SampleStream(FORCE, DeviceClock(200.0), VirtualClock(), np.int32)
    for k in range(2000):
        stream.push((k,), 20.0 + k * 1e-3, k * 1e-3)
    stream.push((2000,), 22.003, 2.003)
    losses = [stream.push((k,), 1e-3 * (restarts_at_ms + k), 2.5 + 1e-3 * k)[1] for k in range(3)]
    assert losses == [0, None, None]
    blocks = stream.take()
    assert sum(map(len, blocks)) == 2004
    assert blocks[-1].times == pytest.approx([2.5, 2.501, 2.502])


def test_times_of_samples_that_join_one_block_go_on_by_its_rate() -> None:
    track = StreamTrack(DeviceClock(200.0), 500.0)
    times_s = [track.place(shown_s, 1000.0 + shown_s, joins=True).t0_s for shown_s in (5.0, 5.0021, 5.0039)]
    assert np.diff(times_s) == pytest.approx(0.002, abs=1e-12)


def test_on_the_hosts_own_clock_times_are_as_they_are() -> None:
    track = StreamTrack(HostClock(), 1000.0, ENDLESS)
    assert track.place(5000.0, 5000.4, counter=0) == (0, 5000.0, 5000.0, None)
    assert track.place(5000.003, 5000.5, counter=3)[:2] == (3, 5000.003)
    # Another question has another grid, and counts from zero.
    again = track.place(5000.0105, 5000.6, counter=0)
    assert again.lost == 0
    assert again.seq > 4
    assert again.t0_s == 5000.0105


@pytest.mark.parametrize("rate_hz", [10.0, None])
def test_samples_become_blocks_without_a_gap(rate_hz: float | None) -> None:
    samples = Samples(StreamInfo("a.b", ("x",), "m", rate_hz=rate_hz), np.int32)
    for seq in (4, 5, 7):
        samples.push(seq, seq * 0.1, seq * 0.1 + 0.05, (seq * 10,), seq * 1.0)
    first, second = samples.take(origin_s=2.0)
    assert (first.seq, first.device_t0_s, first.arrival_s) == (4, 4.0, pytest.approx(2.55))
    assert first.times == pytest.approx([2.4, 2.5])
    assert (first.values.tolist(), first.values.dtype) == ([[40], [50]], np.int32)
    assert (second.seq, second.values.tolist(), second.t0_s) == (7, [[70]], pytest.approx(2.7))
    assert samples.take() == []

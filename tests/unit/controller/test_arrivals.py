"""What is subscribed has to arrive, in motion and at rest; what stands still though it has noise is stuck."""

import numpy as np
import pytest

from controller.arrivals import Arrivals, stuck_after_s
from drivers.core.messages import SampleBlock, StreamInfo

LOAD = StreamInfo("board.load", ("force",), "N", 1e-3, rate_hz=1000.0, noisy=True)
PERIOD = StreamInfo("board.period", ("period",), "s", 1e-7, longest_s=0.3)
ANSWER = StreamInfo("person.load", ("x",), "N")
SLOW = StreamInfo("logger.heat", ("kelvin",), "K", rate_hz=1.0)
PLACE = StreamInfo("stage.position", ("position",), "m", rate_hz=100.0)
TIP = StreamInfo("signals.tip", ("Fx",), "N")
SIX = StreamInfo("six.wrench", ("fx", "fy", "fz", "tx", "ty", "tz"), "N", rate_hz=1000.0)
SLOW_FORCE = StreamInfo("logger.force", ("force",), "N", rate_hz=10.0, noisy=True)
INFOS = {info.name: info for info in (LOAD, PERIOD, ANSWER, SLOW, PLACE, TIP, SIX, SLOW_FORCE)}


def watching(*streams, urgent=(), stuck_s=0.2, made_of=("board.load",)):
    arrivals = Arrivals(0.1, stuck_s)
    arrivals.know_streams(INFOS, {"signals.tip": made_of})
    arrivals.depend(frozenset(urgent))
    arrivals.expect(frozenset(streams), 0.0)
    return arrivals


def block(stream, t_s, values=(0,), rate_hz=1000.0):
    raw = np.array(values, dtype=np.int32)[:, None]
    first_s = t_s - (len(raw) - 1) / rate_hz
    return SampleBlock(stream, 0, first_s, raw, rate_hz=rate_hz, unit="N", scale=INFOS[stream].scale)


def test_at_rest_a_stream_may_be_silent_four_times_as_long_as_a_motion_would_bear():
    arrivals = watching("board.load")
    assert arrivals.check(0.4, [], moving=False) is None
    arrivals.check(0.41, [block("board.load", 0.3)], moving=False)
    failed = arrivals.check(0.72, [], moving=False)
    assert failed is not None
    assert (failed.t_s, failed.device) == (0.72, "board")
    assert failed.reason.startswith("board.load is silent for 0.420 s, since 0.300 s (limits.stale_s = 0.1)")
    assert "check PROFILE --connect" in failed.reason


def test_a_motion_bears_the_silence_of_what_it_depends_on_no_longer_than_its_limit_and_that_of_others():
    arrivals = watching("board.load", urgent=["board.load"])
    assert arrivals.check(0.05, [block("board.load", 0.05)], moving=True) is None
    assert arrivals.check(0.15, [], moving=True) is None
    assert arrivals.check(0.151, [], moving=True) is not None
    arrivals = watching("board.load")
    assert arrivals.check(0.39, [], moving=True) is None
    assert arrivals.check(0.41, [], moving=True) is not None


def test_what_was_not_needed_before_a_motion_is_not_stale_when_it_begins_and_one_that_is_over_excuses_nothing():
    arrivals = watching("signals.tip", urgent=["signals.tip"])
    assert arrivals.check(90.0, [], moving=False) is None
    assert arrivals.check(90.1, [], moving=True) is None
    assert arrivals.check(90.21, [], moving=True) is not None
    arrivals = watching("board.load", urgent=["board.load"])
    arrivals.check(0.0, [], moving=True)
    arrivals.check(0.05, [block("board.load", 0.05)], moving=False)
    arrivals.check(0.06, [], moving=True)
    assert arrivals.check(0.17, [], moving=True) is not None


@pytest.mark.parametrize(("stream", "patience_s"), [("board.period", 0.6), ("logger.heat", 3.0)])
def test_a_slow_stream_is_given_twice_its_own_longest_interval(stream, patience_s):
    assert watching(stream).check(patience_s - 0.01, [], moving=False) is None
    assert watching(stream).check(patience_s + 0.01, [], moving=False) is not None


def test_what_comes_when_something_changes_is_never_silent_and_an_empty_block_or_another_stream_is_passed_over():
    assert watching("person.load").check(1e4, [], moving=False) is None
    arrivals = watching("board.load")
    empty = SampleBlock("board.load", 0, 0.1, np.empty((0, 1)), rate_hz=1000.0, unit="N")
    assert arrivals.check(0.1, [empty, block("stage.position", 0.1)], moving=False) is None
    assert arrivals.check(0.41, [], moving=False) is not None


def test_the_silence_of_a_signal_names_what_it_is_made_of_and_the_device():
    arrivals = watching("signals.tip", urgent=["signals.tip"], made_of=("board.load", "stage.position"))
    arrivals.check(0.0, [], moving=True)
    failed = arrivals.check(0.2, [], moving=True)
    named = "signals.tip (of board.load, stage.position)"
    assert (failed.device, failed.reason.partition(" is")[0]) == ("board", named)


def test_a_loop_that_was_away_polled_no_device_and_is_no_excuse_in_a_motion():
    assert watching("board.load").check(0.6, [], moving=False, late_s=0.3) is None
    arrivals = watching("board.load", urgent=["board.load"])
    arrivals.check(0.0, [], moving=True)
    assert arrivals.check(0.2, [], moving=True, late_s=0.15) is not None


def test_a_time_stamp_from_the_future_keeps_nothing_alive_and_an_older_block_makes_nothing_older():
    arrivals = watching("board.load")
    arrivals.check(0.1, [block("board.load", 30.0)], moving=False)
    assert arrivals.check(0.6, [], moving=False) is not None
    arrivals = watching("board.load")
    arrivals.check(0.3, [block("board.load", 0.3), block("board.load", 0.1)], moving=False)
    assert arrivals.check(0.65, [], moving=False) is None


def numbers(stream, t_s, *values):
    raw = np.array(values, dtype=float).reshape(len(values), -1)
    return SampleBlock(stream, 0, t_s - (len(raw) - 1) / 1000.0, raw, rate_hz=1000.0, unit="N")


NAN = float("nan")


@pytest.mark.parametrize(
    ("stream", "wrong", "said"),
    [
        ("board.load", (NAN,), "force = nan"),
        ("six.wrench", (1.0, 2.0, 3.0, 4.0, NAN, float("-inf")), "ty = nan, tz = -inf"),
        ("six.wrench", (1.0, NAN, NAN, NAN, NAN, NAN), "fy = nan, fz = nan, tx = nan, …"),
    ],
)
def test_what_is_no_number_keeps_a_device_no_more_alive_than_silence_does_and_names_the_channels(
    stream, wrong, said
):
    arrivals = watching(stream, urgent=[stream])
    good = (0.5,) * len(wrong)
    assert arrivals.check(0.05, [numbers(stream, 0.05, good, good, wrong)], moving=True) is None
    assert arrivals.check(0.14, [numbers(stream, 0.14, wrong, wrong)], moving=True) is None
    failed = arrivals.check(0.151, [numbers(stream, 0.151, wrong)], moving=True)
    assert failed is not None
    assert failed.reason.startswith(f"{stream} sends no numbers: {said} for 0.102 s, since 0.049 s")
    arrivals.check(0.16, [numbers(stream, 0.16, good)], moving=True)
    failed = arrivals.check(0.27, [], moving=True)
    assert failed is not None
    assert f"{stream} is silent" in failed.reason


def test_what_was_no_number_before_it_was_unsubscribed_is_silent_when_it_begins_anew_and_sends_nothing():
    arrivals = watching("board.load", urgent=["board.load"])
    arrivals.check(0.05, [numbers("board.load", 0.05, NAN)], moving=False)
    arrivals.expect(frozenset(), 0.1)
    arrivals.expect(frozenset({"board.load"}), 5.0)
    failed = arrivals.check(5.5, [], moving=False)
    assert failed is not None
    assert "board.load is silent for 0.500 s" in failed.reason


def test_a_signal_may_have_nothing_to_say_and_turns_with_no_number_in_them_are_not_taken_as_one():
    arrivals = watching("signals.tip", urgent=["signals.tip"])
    for t_s in (0.05, 0.14, 0.23):
        assert arrivals.check(t_s, [numbers("signals.tip", t_s, NAN)], moving=True) is None
    arrivals = watching("board.load", urgent=["board.load"])
    assert arrivals.whole_until_s(0.3, [numbers("board.load", 0.3, *[0.5] * 301)]) == np.inf
    assert arrivals.whole_until_s(0.3, [numbers("board.load", 0.3, *[0.5] * 300, NAN)]) < 0.3


def test_a_stream_that_stays_subscribed_is_as_old_as_it_was_and_one_that_left_is_forgotten():
    arrivals = watching("board.load", "board.period")
    arrivals.expect(frozenset({"board.load"}), 0.35)
    assert arrivals.check(0.41, [], moving=False) is not None
    arrivals.expect(frozenset(), 0.5)
    assert arrivals.check(9.0, [], moving=False) is None


def test_a_sensor_with_noise_that_repeats_one_value_is_stuck_since_the_last_change():
    arrivals = watching("board.load")
    assert arrivals.check(0.05, [block("board.load", 0.05, [1, 2, 7])], moving=False) is None
    for t_s in (0.15, 0.25):
        assert arrivals.check(t_s, [block("board.load", t_s, [7] * 25)], moving=False) is None
    found = arrivals.check(0.26, [block("board.load", 0.26, [7] * 10)], moving=False)
    assert found.device == "board"
    assert found.reason.startswith("board.load sticks at 0.007 N for 0.210 s, since 0.050 s (limits.stuck_s")


@pytest.mark.parametrize("at_once", [1, 7, 60])
def test_a_slow_sensor_is_stuck_after_fifty_equal_samples_however_it_is_cut(at_once):
    def found(equal):
        arrivals = watching("logger.force")
        raw = np.array([3, *[5] * equal])
        for first in range(0, len(raw), at_once):
            cut = raw[first : first + at_once, None]
            one = SampleBlock("logger.force", first, first / 10.0, cut, rate_hz=10.0, unit="N")
            if (failed := arrivals.check(one.last_s, [one], moving=False)) is not None:
                return failed
        return None

    assert found(49) is None
    failed = found(50)
    assert failed is not None
    assert failed.reason.startswith("logger.force sticks at 5 N for 4.900 s, since 0.100 s")
    assert stuck_after_s(SLOW_FORCE, 0.2) == pytest.approx(4.9)
    assert stuck_after_s(SLOW_FORCE, 6.0) == 6.0
    assert stuck_after_s(LOAD, 0.2) == 0.2
    assert stuck_after_s(PERIOD, 0.2) == pytest.approx(49 * 0.3), "at irregular times"


@pytest.mark.parametrize(
    ("values", "every_s"), [([*[7] * 60, 8, *[7] * 60], 0.125), ([*[8] * 60, *[7] * 60], 0.3)]
)
def test_one_sample_that_differs_in_between_is_enough_to_live(values, every_s):
    arrivals = watching("board.load")
    for t_s in every_s * np.arange(1, 6):
        assert arrivals.check(t_s, [block("board.load", t_s, values)], moving=False) is None


def test_a_position_may_stand_for_as_long_as_it_likes_and_so_may_all_without_a_limit():
    for stream, stuck_s in (("stage.position", 0.2), ("board.load", None)):
        arrivals = watching(stream, stuck_s=stuck_s)
        for t_s in (0.1, 0.3, 0.6, 0.9):
            assert arrivals.check(t_s, [block(stream, t_s, [5] * 10)], moving=False) is None


def test_what_stood_before_it_was_unsubscribed_is_not_stuck_when_it_begins_anew():
    arrivals = watching("board.load")
    arrivals.check(0.1, [block("board.load", 0.1, [7] * 10)], moving=False)
    arrivals.expect(frozenset(), 0.2)
    arrivals.expect(frozenset({"board.load"}), 5.0)
    assert arrivals.check(5.1, [block("board.load", 5.1, [7] * 10)], moving=False) is None


def test_one_that_stays_subscribed_stays_stuck_and_three_channels_of_it_are_shown():
    arrivals = watching("board.load")
    raw = np.array([[7, 8, 9, 10]] * 30)
    found = []
    for t_s in (0.1, 0.35):
        one = SampleBlock("board.load", 0, t_s - 0.029, raw, rate_hz=1000.0, unit="N", scale=1e-3)
        found.append(arrivals.check(t_s, [one], moving=False))
        arrivals.expect(frozenset({"board.load", "person.load"}), t_s)
    assert found[0] is None
    assert found[1].t_s == pytest.approx(0.35)
    assert found[1].reason.startswith("board.load sticks at 0.007, 0.008, 0.009 N for 0.279 s")


def test_turns_seen_as_one_are_whole_where_no_gap_is_wider_than_half_of_what_is_allowed():
    arrivals = watching("board.load", "board.period", urgent=["board.load"])
    arrivals.check(0.0, [], moving=True)
    whole = [block("board.load", 0.02, [1] * 20), block("board.load", 2.0, [2] * 1960)]
    counts = SampleBlock("board.period", 0, 0.2, np.ones((8, 1)), times_s=np.arange(1, 9) * 0.24, unit="s")
    assert arrivals.whole_until_s(2.0, [*whole, counts]) == np.inf
    assert arrivals.whole_until_s(2.06, [*whole, counts]) == pytest.approx(2.05), "the end is a gap, too"
    torn = [whole[0], block("board.load", 2.0, [2] * 1929)]
    assert arrivals.whole_until_s(2.0, [*torn, counts]) == pytest.approx(0.07)
    seldom = SampleBlock("board.period", 0, 0.2, np.ones((3, 1)), times_s=np.array([0.2, 1.7, 1.9]), unit="s")
    assert arrivals.whole_until_s(2.0, [*whole, seldom]) == pytest.approx(0.3), "within a block"


def test_what_sticks_within_a_block_is_found_however_the_stream_is_cut():
    failed = watching("board.load").check(1.0, [block("board.load", 1.0, [7] * 202)], moving=False)
    assert "for 0.201 s, since 0.799 s" in failed.reason
    values = [1, 2, *[7] * 230, 8]
    arrivals = watching("board.load")
    failed = arrivals.check(1.0, [block("board.load", 1.0, values)], moving=False)
    assert failed.reason.startswith("board.load sticks at 0.007 N for 0.229 s, since 0.770 s")
    assert failed.t_s == pytest.approx(0.999), "the last sample that repeats, not the last of the block"
    arrivals = watching("board.load")
    cuts = [block("board.load", 0.768 + 0.001 * place, [value]) for place, value in enumerate(values)]
    assert any(arrivals.check(cut.last_s, [cut], moving=False) for cut in cuts)

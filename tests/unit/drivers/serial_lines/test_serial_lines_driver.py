"""The driver on boards that print what a test says, in virtual time."""

from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from drivers.core.clock import VirtualClock
from drivers.core.errors import DeviceError, PortError, ProtocolError, SilentError
from drivers.core.messages import Failed, Lost, Refused, Sent, Tare
from drivers.core.scaled import ScaledStreams
from drivers.serial_lines.bota import BotaFormat
from drivers.serial_lines.driver import SerialLines
from drivers.serial_lines.settings import SerialLinesSettings
from simulator.mocks.base import MemoryLine
from tests.contracts.crank import Crank
from tests.refusals import check_refusal, refused

FORCE = "uno.force"

Print = Callable[[int], bytes]
"""What a board prints at its tick."""


class Board:
    """Prints at a fixed rate from the first look on, after a silence while it boots."""

    def __init__(self, prints: Print, hz: float = 100.0, boot_s: float = 0.0, banner: bytes = b"") -> None:
        self.prints, self.hz, self.boot_s, self.banner = prints, hz, boot_s, banner
        self.tick = 0

    @property
    def due_s(self) -> float:
        return self.boot_s + self.tick / self.hz

    def receive(self, data: bytes, t_s: float) -> bytes:
        assert data == b"", "nothing is sent to it"
        return self.step(t_s)

    def step(self, t_s: float) -> bytes:
        sent = b""
        while self.due_s <= t_s:
            sent += (self.banner if self.tick == 0 else b"") + self.prints(self.tick)
            self.tick += 1
        return sent

    def inject(self, kind: str, t_s: float) -> None:
        raise ValueError(kind)


def timed(tick: int) -> bytes:
    """`micros()`, which wraps after a second, a count that goes up by 1, a column that nobody named."""
    return b"%d,%d,7\r\n" % ((2**32 - 1_000_000 + 10_000 * tick) % 2**32, 100 + tick)


def driver(board: Any, **given: Any) -> SerialLines:
    settings: dict[str, Any] = {
        "port": "/dev/uno",
        "rate_hz": 100.0,
        "streams": {"force": {"columns": (1,), "unit": "N", "scale": 0.5, "offset": 100.0}},
    }
    clock = VirtualClock()
    line = MemoryLine(board, clock)
    return SerialLines("uno", SerialLinesSettings(**settings | given), clock, line.connect)


def opened(board: Any, **given: Any) -> Crank:
    return Crank(driver(board, **given))


def test_scale_offset_unit_and_rate_are_the_profiles_and_micros_may_wrap() -> None:
    crank = opened(Board(timed))
    stream = crank.info.streams[FORCE]
    assert (stream.channels, stream.unit, stream.scale, stream.rate_hz) == (("force",), "N", 0.5, 100.0)
    assert crank.info.details["columns"] == 3
    assert crank.info.details["rate_hz"] == pytest.approx(100.0)
    crank.turn(0.1)
    assert crank.blocks == [], "nobody listens"
    crank.listen(FORCE)
    crank.turn(2.0)
    assert len(crank.of(Sent)) == 1
    found = crank.values(FORCE)[:, 0]
    assert len(found) == 200
    assert np.diff(found) == pytest.approx(0.5)
    # at tick k it is k / 100 s, and half a newton for each tick
    assert crank.times(FORCE) == pytest.approx(found / 0.5 / 100.0, abs=1e-6)
    for before, after in pairwise(crank.blocks):
        assert after.seq == before.seq + len(before)
    assert not crank.of(Lost)


class Batches(Board):
    """Stamps its lines 1 ms apart, by a clock that runs so many ppm fast; 16 reach the host at once, with the last."""

    def __init__(self, drift_ppm: float) -> None:
        super().__init__(lambda tick: b"%d,%d\n" % (1000 * tick, tick), hz=1000.0 * (1.0 + drift_ppm * 1e-6))

    @property
    def due_s(self) -> float:
        return (self.tick + 15) / self.hz

    def step(self, t_s: float) -> bytes:
        sent = b""
        while self.due_s <= t_s:
            sent += b"".join(self.prints(tick) for tick in range(self.tick, self.tick + 16))
            self.tick += 16
        return sent


@pytest.mark.parametrize("drift_ppm", [-5000.0, -2000.0, 50.0, 5000.0])
def test_the_clock_of_a_ceramic_resonator_is_followed(drift_ppm: float) -> None:
    board = Batches(drift_ppm)
    crank = opened(board, rate_hz=1000.0)
    crank.turn_s = 0.016
    crank.listen(FORCE)
    crank.turn(5.0)
    ticks = crank.values(FORCE)[:, 0] / 0.5 + 100.0
    late = crank.times(FORCE)[2000:] - ticks[2000:] / board.hz
    assert np.abs(late).max() < 1e-3, "it dated the slowest 25 ms early by then"
    account = crank.device.account()
    assert account["drift_ppm"] == pytest.approx(drift_ppm, abs=20.0)
    assert "warning" not in account
    assert not crank.of(Lost)


def test_a_clock_beyond_its_bound_is_one_line() -> None:
    crank = opened(Batches(-5000.0), rate_hz=1000.0, max_drift_ppm=200.0)
    crank.turn_s = 0.016
    crank.listen(FORCE)
    crank.turn(20.0)
    assert "warning" not in crank.device.account(), "200 ppm are 4 ms in 20 s, as a busy host makes too"
    crank.turn(10.0)
    account = crank.device.account()
    assert account["drift_ppm"] == pytest.approx(-200.0, abs=0.1)
    check_refusal(str(account["warning"]), "uno: its clock runs 200 ppm", "raise max_drift_ppm")


def test_a_sensor_that_is_mounted_the_other_way_round_has_a_negative_scale() -> None:
    crank = opened(Board(timed), streams={"force": {"columns": (1,), "unit": "N", "scale": -0.5}})
    crank.listen(FORCE)
    crank.turn(0.1)
    assert crank.info.streams[FORCE].scale == 0.5
    assert (crank.values(FORCE) < -50.0).all()


def test_streams_take_their_columns_of_the_same_line() -> None:
    streams = {
        "both": {"columns": (2, 1), "unit": "m"},
        "one": {"columns": (2,), "unit": "N", "channels": ("left",)},
    }
    crank = opened(Board(timed), streams=streams)
    assert crank.info.streams["uno.both"].channels == ("both_2", "both_1")
    assert crank.info.streams["uno.one"].channels == ("left",)
    crank.listen("uno.both", "uno.one")
    crank.turn(0.1)
    assert (crank.values("uno.both")[:, 0] == 7.0).all()
    assert (crank.values("uno.one")[:, 0] == 7.0).all()
    assert crank.times("uno.both").tolist() == crank.times("uno.one").tolist()
    crank.listen("uno.one")
    crank.blocks.clear()
    crank.turn(0.1)
    assert {block.stream for block in crank.blocks} == {"uno.one"}


def test_a_board_that_resets_on_open_is_waited_for() -> None:
    crank = opened(Board(timed, boot_s=2.0, banner=b"\x00\xf0ets Jul 29 2019\r\nADXL335 v2, 100 Hz\r\n"))
    assert 2.3 <= crank.clock.now() < 2.4
    assert crank.device.account()["malformed"] == 0, "what it printed before does not count"


@pytest.mark.parametrize("cut", range(1, len(b"1234560000,7,7\r\n")))
def test_a_port_that_is_opened_in_the_middle_of_a_line_does_not_take_the_rest_for_its_first(cut: int) -> None:
    def prints(tick: int) -> bytes:
        line = b"%d,%d,7\r\n" % (1_234_560_000 + 10_000 * tick, tick % 10)
        return line if tick else line[cut:]

    assert opened(Board(prints)).info.details["rate_hz"] == pytest.approx(100.0)


def test_lines_from_before_the_reset_do_not_open_it() -> None:
    class Reset(Board):
        early = b"".join(timed(tick) for tick in (500, 501, 502)) + b"429496"

        def step(self, t_s: float) -> bytes:
            early, self.early = self.early, b""
            return early + super().step(t_s)

    crank = opened(Reset(timed, boot_s=2.0))
    assert crank.clock.now() >= 2.3


@pytest.mark.parametrize(
    ("board", "given", "kind", "named"),
    [
        (Board(lambda tick: b""), {}, SilentError, ("nothing came in 5 s", "powered", "115200 baud")),
        (
            Board(lambda tick: b"\x80\xf8\x00"),
            {},
            ProtocolError,
            ("bytes and 0 lines", "end of a line", "baud"),
        ),
        (Board(lambda tick: b"x\xf8\x80\n"), {}, ProtocolError, ("501 lines came", "is no text", "baud")),
        (
            Board(lambda tick: b"0.25,%d\n" % tick),
            {},
            ProtocolError,
            ("column 0 is 0.25", "whole", "columns"),
        ),
        (Board(lambda tick: b"5\n"), {}, ProtocolError, ("b'5' has 1 numbers, not 2 or more", "columns")),
        (Board(timed), {"separator": ";"}, ProtocolError, ("is not made of numbers", "separator (';'; 12.5")),
        (Board(timed), {"checksum": "xor"}, ProtocolError, ("no sound check", "checksum (xor)")),
        (Board(timed), {"rate_hz": 110.0}, ProtocolError, ("100 lines a second", "rate_hz is 110")),
        (Board(timed), {"time_unit_s": 1e-3}, ProtocolError, ("0.1 lines a second", "time_unit_s")),
        (Board(lambda tick: b"7,%d\n" % tick), {}, ProtocolError, ("column 0 stands still",)),
        (Board(timed, hz=0.3), {}, ProtocolError, ("break", "reply_timeout_s")),
    ],
)
def test_a_board_that_does_not_fit_is_refused_at_open(
    board: Board, given: dict[str, Any], kind: type[DeviceError], named: tuple[str, ...]
) -> None:
    with refused(kind, "uno", *named):
        driver(board, **given).open()


def test_a_port_that_is_gone_while_it_boots_is_told() -> None:
    device = driver(Board(timed, boot_s=2.0))
    connect = device._connect

    def unplugged(*arguments: Any) -> Any:
        link = connect(*arguments)
        link.fault = "the port was taken away"
        return link

    device._connect = unplugged
    with refused(PortError, "uno", "taken away", "plugged in"):
        device.open()


@pytest.mark.parametrize(
    "garbled",
    [
        b"4294967,1\xff2,7\r\n",
        b"1,2\r\n",
        b"429496700,429496700,100,7\r\n",
        b"429",
        b"\xff" * 3000,
        b",,\r\n",
    ],
)
def test_lines_that_make_no_sense_are_counted_and_lost_and_the_rest_goes_on(garbled: bytes) -> None:
    crank = opened(Board(lambda tick: garbled if tick == 80 else timed(tick)))
    crank.listen(FORCE)
    crank.turn(1.0)
    assert 1 <= sum(lost.samples for lost in crank.of(Lost)) <= 2  # a half line spoils the next one
    assert not crank.of(Failed)
    found = crank.values(FORCE)[:, 0]
    assert (np.diff(found) > 0).all()
    assert crank.times(FORCE) == pytest.approx(found / 0.5 / 100.0, abs=1e-6)


def test_a_board_that_restarts_begins_a_new_segment() -> None:
    def prints(tick: int) -> bytes:
        return b"%d,%d\n" % (10_000 * (tick if tick < 80 else tick - 80), tick)

    crank = opened(Board(prints))
    crank.listen(FORCE)
    crank.turn(2.0)
    assert [lost.samples for lost in crank.of(Lost)] == [0], "how many is unknown"
    assert np.diff(crank.times(FORCE)) == pytest.approx(0.01, abs=2e-3)


@pytest.mark.parametrize("modulus", [256, 65536, 2**32, 100])
@pytest.mark.parametrize("hz", [9.7, 100.0, 1000.0])
def test_a_counter_of_any_width_at_any_rate_counts_what_is_lost(modulus: int, hz: float) -> None:
    def prints(tick: int) -> bytes:
        us = round(tick / hz * 1e6) % 2**32
        return b"" if 700 <= tick < 703 else b"%d,%d,%d\n" % (us, tick, (tick + modulus - 20) % modulus)

    given = {"rate_hz": hz, "counter_column": 2, "counter_modulus": modulus}
    crank = opened(Board(prints, hz=hz), **given, silence_timeout_s=5.0)
    crank.turn_s = 0.5 / hz
    crank.listen(FORCE)
    crank.turn(900 / hz)
    assert [lost.samples for lost in crank.of(Lost)] == [3]


def test_a_counter_alone_dates_and_counts() -> None:
    def prints(tick: int) -> bytes:
        return b"" if tick == 90 else b"%d,%d\n" % (tick % 256, tick)

    crank = opened(Board(prints), time_column=None, counter_column=0, counter_modulus=256)
    crank.listen(FORCE)
    crank.turn(5.0)
    assert [lost.samples for lost in crank.of(Lost)] == [1]
    ticks = crank.values(FORCE)[:, 0] / 0.5 + 100
    assert crank.times(FORCE) == pytest.approx(ticks / 100.0, abs=1e-6)


def test_without_a_rate_each_sample_has_its_own_time_by_the_board() -> None:
    def prints(tick: int) -> bytes:
        return b"?\n" if tick == 90 else b"%d,%d\n" % (10_000 * tick + 700 * (tick % 3), tick)

    crank = opened(Board(prints), rate_hz=None)
    crank.turn_s = 0.05  # several lines a turn
    assert crank.info.streams[FORCE].rate_hz is None
    assert crank.info.streams[FORCE].longest_s == 0.5, "silence is a hole all the same"
    crank.listen(FORCE)
    crank.turn(2.0)
    ticks = crank.values(FORCE)[:, 0] / 0.5 + 100
    irregular_s = (10_000 * ticks + 700 * (ticks % 3)) * 1e-6
    # the line under the arrivals settles within the first samples
    assert np.diff(crank.times(FORCE))[10:] == pytest.approx(np.diff(irregular_s)[10:], abs=5e-5)
    assert [lost.samples for lost in crank.of(Lost)] == [1]


def test_without_time_or_counter_samples_are_dated_by_arrival_and_lost_where_a_line_makes_no_sense() -> None:
    crank = opened(Board(lambda tick: b"12x\n" if tick == 90 else b"%d\n" % tick), **ARRIVALS)
    assert crank.info.clock == "arrivals"
    assert "drift_ppm" not in crank.device.account()
    crank.listen(FORCE)
    crank.turn(2.0)
    ticks = crank.values(FORCE)[:, 0] / 0.5 + 100
    assert crank.times(FORCE) == pytest.approx(ticks / 100.0, abs=1e-6)
    assert [lost.samples for lost in crank.of(Lost)] == [1]


ARRIVALS = {
    "rate_hz": None,
    "time_column": None,
    "streams": {"force": {"columns": (0,), "unit": "N", "scale": 0.5, "offset": 100.0}},
}


def test_lines_that_arrive_at_once_have_times_that_rise() -> None:
    crank = opened(Board(lambda tick: b"%d\n%d\n" % (2 * tick, 2 * tick + 1)), **ARRIVALS)
    crank.listen(FORCE)
    crank.turn(1.0)
    assert (np.diff(crank.times(FORCE)) > 0.0).all()


def test_a_value_that_is_none_arrives_as_such() -> None:
    crank = opened(Board(lambda tick: b"%d,nan\n" % (10_000 * tick) if tick == 80 else timed_from_zero(tick)))
    crank.listen(FORCE)
    crank.turn(1.0)
    assert np.isnan(crank.values(FORCE)).sum() == 1
    assert not crank.of(Lost)


def timed_from_zero(tick: int) -> bytes:
    return b"%d,%d\n" % (10_000 * tick, tick)


def test_tare_takes_the_mean_of_its_latest_samples_as_zero() -> None:
    crank = opened(Board(lambda tick: b"%d,%d\n" % (10_000 * tick, 300 + tick % 2)))
    crank.device.apply(Tare("uno", FORCE))
    crank.turn(0.01)
    assert [refusal.reason for refusal in crank.of(Refused)] == ["no samples of it yet; listen to it first"]
    crank.listen(FORCE)
    crank.turn(1.0)
    assert crank.values(FORCE).mean() == pytest.approx(100.25)
    crank.device.apply(Tare("uno", FORCE))
    crank.blocks.clear()
    crank.turn(1.0)
    assert crank.values(FORCE).mean() == pytest.approx(0.0, abs=1e-9)
    assert crank.device.account()["offsets"] == {FORCE: [300.5]}
    assert crank.device.zero_setting(FORCE) == "offset = 300.5  # in [devices.uno.streams.force]"


@pytest.mark.parametrize(
    ("rate_hz", "n"), [(10.0, 10), (100.0, 10), (1000.0, 50), (10_000.0, 500), (None, 50)]
)
def test_tare_takes_what_came_in_50_ms_and_since_it_was_subscribed_to(rate_hz: float | None, n: int) -> None:
    settings = SerialLinesSettings(port="x", streams={"force": {"columns": (1,), "unit": "N"}})
    scaled = ScaledStreams("uno", settings.streams, rate_hz)
    scaled.counts(FORCE, np.arange(2000.0)[:, None])
    assert scaled.tare(FORCE)
    assert scaled.zeros[FORCE] == [1999.0 - (n - 1) / 2.0]
    scaled.begin(FORCE)
    assert not scaled.tare(FORCE)
    scaled.counts(FORCE, np.full((3, 1), 7.0))
    assert scaled.tare(FORCE)
    assert scaled.zeros[FORCE] == [7.0]


def test_tare_takes_nothing_from_before_the_subscription() -> None:
    crank = opened(Board(lambda tick: b"%d,%d\n" % (10_000 * tick, 300 + tick)))
    crank.listen(FORCE)
    crank.turn(1.0)
    crank.listen()
    crank.turn(5.0)
    crank.listen(FORCE)
    crank.turn(0.05)
    crank.device.apply(Tare("uno", FORCE))
    (zero,) = crank.device.account()["offsets"][FORCE]
    assert zero > 300 + 600, "of samples that came 6 s after the first"


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"counter_column": 3}, "counter_column and counter_modulus go together"),
        ({"counter_modulus": 3}, "counter_column and counter_modulus go together"),
        ({"time_column": None}, "rate_hz needs"),
        ({"streams": {"force": {"columns": (0,), "unit": "N"}}}, "column 0 is time"),
        ({"streams": {"force": {"columns": (-1,), "unit": "N"}}}, "column -1"),
        ({"streams": {"force": {"columns": (1,), "unit": "N", "scale": 0.0}}}, "scale is 0"),
        (
            {"streams": {"force": {"columns": (1, 2), "unit": "N", "channels": ("x",)}}},
            "channels has 1 names",
        ),
        ({"streams": {}}, "at least 1"),
    ],
)
def test_settings_that_contradict_each_other_are_refused(given: dict[str, Any], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        driver(None, **given)


def test_frames_of_a_bota_sensor_are_read_from_the_middle_of_one_on_and_what_it_cannot_tell_is_no_value() -> (
    None
):
    frames = BotaFormat()

    def sent(tick: int) -> bytes:
        beyond_its_range = 2 * (tick == 80)
        return frames.encode(map(str, [0, 0, tick, 0, 0, 0, 10_000 * tick, 25.0, beyond_its_range]))

    force = {"force": {"columns": (2,), "unit": "N"}}
    crank = opened(Board(sent, banner=sent(0)[20:]), frames="bota", time_column=6, streams=force)
    assert crank.info.model == "Bota Systems, serial"
    crank.listen(FORCE)
    crank.turn(1.0)
    found = crank.values(FORCE)[:, 0]
    (none,) = np.flatnonzero(np.isnan(found))
    assert found[none + 1] == 81.0
    assert set(np.diff(found[none + 1 :])) == {1.0}
    assert crank.device.account()["malformed"] == 1
    with refused(ProtocolError, "no sound frame", "compare baud (115200)"):
        opened(Board(lambda tick: b"\xaa\x55\r\n" * 20), frames="bota", time_column=6, streams=force)

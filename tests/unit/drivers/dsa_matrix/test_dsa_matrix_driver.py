"""The matrices' driver on emulated matrices, in virtual time."""

from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from drivers.core.errors import RefusedError
from drivers.core.messages import Failed, Listen, Lost
from drivers.dsa_matrix import codec
from drivers.dsa_matrix.packets import MatrixPacket, encode_packet
from simulator.physics.fingertip_settings import Matrix
from tests.contracts.matrix_suite import MatrixContract, steady
from tests.refusals import refused
from tests.unit.drivers.dsa_matrix.conftest import Bench
from tests.unit.drivers.far_end import spoilt

TEXELS = "dsa.taxels"
ALL = Listen("dsa", frozenset({TEXELS}))
NONE = Listen("dsa", frozenset())

SENSOR_SERIAL = 3210
"""Of the emulated controller."""

Make = Callable[..., Bench]


def order(run: bool, frame_hz: int) -> bytes:
    """To send raw frames, or none."""
    return encode_packet(codec.acquire(run, False, frame_hz))


class TestDsaMatrix(MatrixContract):
    @pytest.fixture
    def bench(self) -> Bench:
        made = Bench(steady())
        made.info = made.device.open()
        return made


def test_identity_cells_and_the_rate_that_the_line_carries_come_from_the_controller(make_bench: Make) -> None:
    bench = make_bench([Matrix(2, 3, 0.0034), Matrix(1, 4, 0.0034)], baud=57_600)
    info = bench.device.open()
    assert (info.device, info.serial, info.version, info.clock) == ("dsa", "9210", "290", "dsa milliseconds")
    texel_m = pytest.approx((0.0034, 0.0034))
    assert info.details == {
        "port": "/dev/dsa",
        "sensor_serial": SENSOR_SERIAL,
        "matrices": [
            {"rows": 2, "columns": 3, "texel_m": texel_m, "uid": "000000000000"},
            {"rows": 1, "columns": 4, "texel_m": texel_m, "uid": "000000000001"},
        ],
        "raw_limit_hz": pytest.approx(57_600 / 10 / (13 + 2 * 10)),
    }
    bench.device.apply(ALL)
    bench.turn(0.5)
    assert bench.blocks[-1].values[-1, 1:].tolist() == list(range(1, 10))


def test_frames_come_in_sequence_on_the_controllers_clock(bench: Bench) -> None:
    bench.device.apply(ALL)
    bench.turn(3.0)
    assert 148 <= bench.frames() <= 150
    for before, after in pairwise(bench.blocks):
        assert after.seq == before.seq + len(before)
        assert after.device_t0_s is not None
        assert before.device_t0_s is not None
        assert after.device_t0_s - before.device_t0_s == pytest.approx(0.02 * len(before), abs=1.1e-3)
    assert bench.blocks[0].unit == "V"
    assert bench.blocks[0].physical[0, 69] == pytest.approx(0.069)
    assert bench.take(Lost) == []


def test_the_wrap_of_the_clock_is_not_seen(make_bench: Make) -> None:
    bench = make_bench(emulated={"start_ms": 2**32 - 1000}, frame_hz=50, rle=False)
    bench.device.open()
    bench.device.apply(ALL)
    bench.turn(3.0)
    device_s = np.array([block.device_t0_s for block in bench.blocks], dtype=float)
    assert device_s.min() < 2**32 * 1e-3 < device_s.max()
    assert np.diff(device_s).min() > 0.0
    assert bench.take(Lost) == []


def test_times_are_the_controllers_and_not_those_of_arrival(bench: Bench) -> None:
    """The first cell holds the time at which it was read, to 10 ms. Late by the 13.3 ms that a frame is on the line."""
    bench.device.apply(ALL)
    bench.turn(8.0)
    host_s = np.concatenate([block.times for block in bench.blocks[100:]]) - bench.clock.from_monotonic(0.0)
    reported_s = np.concatenate([block.physical[:, 0] for block in bench.blocks[100:]]) * 10.0
    late_s = (host_s - reported_s + 20.0) % 40.0 - 20.0
    assert np.mean(late_s) == pytest.approx(0.0138, abs=0.002)
    assert np.std(late_s) < 0.005
    assert bench.device.account()["drift_ppm"] == pytest.approx(-53.0, abs=140.0), "1 ms in 8 s is 125 ppm"


def test_run_length_encoding_brings_quiet_matrices_to_100_frames_a_second(make_bench: Make) -> None:
    bench = make_bench([Matrix(14, 5, 0.0034)], threshold_counts=60, frame_hz=100, rle=True)
    bench.device.open()
    bench.device.apply(ALL)
    bench.turn(2.0)
    assert 197 <= bench.frames() <= 200
    assert bench.take(Lost) == []
    assert bench.blocks[-1].values[-1, 59:62].tolist() == [0, 60, 61]


def test_frames_that_the_controller_drops_are_reported_as_lost(make_bench: Make) -> None:
    """All cells different: runs of one, as long as raw, 75 frames/s on the line."""
    bench = make_bench(frame_hz=100, rle=True)
    bench.device.open()
    bench.device.apply(ALL)
    bench.turn(4.0)
    lost = sum(status.samples for status in bench.take(Lost))
    assert bench.frames() / 4.0 == pytest.approx(75.0, abs=1.5)
    assert bench.frames() + lost == pytest.approx(400, abs=3)
    ends = [block.seq + len(block) for block in bench.blocks]
    assert sum(block.seq - end for block, end in zip(bench.blocks[1:], ends, strict=False)) == lost


@pytest.mark.parametrize("kind", ["drop", "flip", "truncate"])
def test_a_spoilt_frame_is_one_lost_frame_or_takes_its_neighbour_along(bench: Bench, kind: str) -> None:
    bench.device.apply(ALL)
    bench.turn(0.5)
    bench.far.hush = spoilt(kind)
    bench.turn(1.0)
    lost = sum(status.samples for status in bench.take(Lost))
    assert 1 <= lost <= 2
    assert bench.frames() + lost == pytest.approx(75, abs=1)


def test_a_pause_that_was_asked_for_is_not_lost(bench: Bench) -> None:
    bench.device.apply(ALL)
    bench.turn(0.5)
    last = bench.blocks[-1]
    bench.device.apply(NONE)
    bench.turn(0.2)
    bench.blocks.clear()
    bench.turn(1.0)
    assert bench.blocks == []
    bench.device.apply(ALL)
    bench.turn(0.5)
    assert bench.blocks[0].seq > last.seq + len(last) + 50
    assert bench.take(Lost) == []
    assert bench.take(Failed) == []


def test_a_controller_that_powers_up_is_waited_for(make_bench: Make) -> None:
    bench = make_bench(emulated={"booted": False})
    info = bench.device.open()
    assert info.model == "DSACON32-M"
    assert 8.0 <= bench.clock.now() < 9.5
    assert bench.device.account()["bytes_passed_over"] == 12, "ESC [ 5 n, three times"


def test_frames_of_an_earlier_host_are_stopped_first(make_bench: Make) -> None:
    bench = make_bench(frame_hz=50, rle=False)
    bench.device.open()
    bench.device.apply(ALL)
    bench.turn(0.2)
    bench.device._link = None  # the program was killed
    bench.far.wait(1.0)
    bench.device.open()
    bench.turn(0.5)
    assert bench.blocks[-1].t0_s < 0.6
    assert bench.take(Failed) == []


def test_an_order_that_is_lost_is_sent_again(bench: Bench) -> None:
    spoilt = iter([True])
    bench.far.cut = lambda data: b"" if next(spoilt, False) else data
    bench.device.apply(ALL)
    bench.turn(1.5)
    assert bench.frames() > 40
    assert bench.take(Failed) == []


def test_an_order_without_an_answer_is_sent_twice_and_then_the_matrices_have_failed(bench: Bench) -> None:
    before, began_s = len(bench.far.written), bench.clock.now()
    bench.far.cut = lambda data: b""
    bench.device.apply(ALL)
    bench.turn(0.4)
    assert len(bench.far.written) == before + 1
    bench.turn(1.6)
    first, again = bench.far.written[before:]
    assert first == again == order(run=True, frame_hz=50)
    (failed,) = bench.take(Failed)
    assert failed.reason == "no answer to an order, sent twice in 1 s"
    assert failed.t_s - began_s == pytest.approx(1.0, abs=0.02)


def test_frames_are_asked_for_at_their_rate_and_stopped_without_one(bench: Bench) -> None:
    before = len(bench.far.written)
    bench.device.apply(ALL)
    bench.turn(0.1)
    bench.device.apply(NONE)
    bench.turn(0.1)
    bench.device.close()
    stop = order(run=False, frame_hz=0)
    assert bench.far.written[before:] == [order(run=True, frame_hz=50), stop, stop]


def test_what_is_so_already_is_not_ordered_again(bench: Bench) -> None:
    before = len(bench.far.written)
    bench.device.apply(NONE)
    assert len(bench.far.written) == before
    bench.device.apply(ALL)
    bench.device.apply(ALL)
    assert len(bench.far.written) == before + 1


def test_what_comes_while_statuses_are_asked_for_is_kept(bench: Bench) -> None:
    bench.device.apply(ALL)
    bench.turn(0.5)
    for _ in range(5):
        bench.far.wait(0.1)
        bench.device.poll()
    bench.turn(0.1)
    assert bench.blocks[-1].seq + len(bench.blocks[-1]) - bench.blocks[0].seq == bench.frames()
    assert bench.frames() == pytest.approx(54, abs=2)


def test_answers_that_cannot_be_read_are_counted_and_the_frames_beside_them_taken(bench: Bench) -> None:
    bench.device.apply(ALL)
    bench.turn(0.5)
    frames = bench.frames()
    bench.far.arrive(encode_packet(MatrixPacket(codec.Id.FRAME, b"\0")) * 2)
    of_another_shape = codec.Frame(0, False, np.zeros(69, np.uint16))
    bench.far.arrive(encode_packet(codec.encode_answer(of_another_shape)))
    bench.far.hush = spoilt("flip")
    bench.turn(0.5)
    assert bench.frames() - frames == pytest.approx(24, abs=2)
    account = bench.device.account()
    assert account["frames_wrong"] == 3
    assert account["bad_crc"] == 1
    lost = sum(status.samples for status in bench.take(Lost))
    assert account["frames_lost"] == lost > 0
    assert account["packets"] == bench.frames() + 3 + 5, "five answers: stop, three questions, start"


@pytest.mark.parametrize("kind", ["silent", "reboot"])
def test_a_controller_that_sends_nothing_more_has_failed_once(bench: Bench, kind: str) -> None:
    bench.device.apply(ALL)
    bench.turn(0.5)
    if kind == "silent":
        bench.far.hush = lambda data: b""
    else:
        bench.far.device.inject(kind, bench.far.t_s)
    bench.turn(3.0)
    (failed,) = bench.take(Failed)
    assert "no frame in 1 s" in failed.reason


def test_a_refusal_is_a_failure(bench: Bench) -> None:
    bench.far.device.inject("refuse", bench.far.t_s)
    bench.device.apply(ALL)
    bench.turn(0.3)
    assert "feature not supported" in bench.take(Failed)[0].reason


@pytest.mark.parametrize(
    ("settings", "named"),
    [
        ({"matrices": []}, ("no matrix", "plugged")),
        ({"rle": False}, ("70 cells", "100 frames", "115200 baud", "rle = true", "frame_hz to 75")),
    ],
)
def test_matrices_that_cannot_be_read_are_refused(
    make_bench: Make, settings: dict[str, Any], named: tuple[str, ...]
) -> None:
    bench = make_bench(**settings)
    with refused(RefusedError, "dsa", *named):
        bench.device.open()
    assert bench.far.closed

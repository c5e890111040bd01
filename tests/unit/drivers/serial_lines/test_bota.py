"""Frames of Bota Systems' serial sensors, held against what the maker's own library read."""

import math
import tomllib
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.core.errors import CodecError
from drivers.serial_lines.bota import BotaBuffer, BotaFormat
from drivers.serial_lines.settings import SerialLinesSettings

GOLDEN = tomllib.loads(Path("tests/data/bota_golden.toml").read_text())["frame"]
FRAMES = [bytes.fromhex(each["bytes"]) for each in GOLDEN]
FORCE = {"force": {"columns": (2,), "unit": "N"}}


@pytest.mark.parametrize("golden", GOLDEN)
def test_a_frame_is_read_as_the_makers_library_reads_it(golden) -> None:
    (body,) = BotaBuffer().feed(bytes.fromhex(golden["bytes"]))
    numbers, status = BotaFormat().decode(body), golden["read"][8]
    sound = status in (0, 1)  # 2 is beyond its range, 4 invalid
    assert numbers[6:] == golden["read"][6:]
    assert numbers[:6] == golden["read"][:6] if sound else all(map(math.isnan, numbers[:6]))


@pytest.mark.parametrize("golden", GOLDEN)
def test_numbers_become_the_frame_that_the_makers_library_read(golden) -> None:
    assert BotaFormat().encode(map(str, golden["read"])).hex() == golden["bytes"]


@given(cuts=st.lists(st.integers(1, 40), min_size=1, max_size=40), noise=st.binary(max_size=60))
def test_frames_are_found_however_they_are_split_and_whatever_comes_before(cuts, noise) -> None:
    stream, found, buffer = noise + b"".join(FRAMES * 3), [], BotaBuffer()
    while stream:
        for cut in cuts:
            found += buffer.feed(stream[:cut])
            stream = stream[cut:]
    bodies = [frame[1:-2] for frame in FRAMES * 3]
    assert found[-len(bodies) :] == bodies
    assert buffer.dropped <= len(noise)


def test_a_garbled_frame_is_counted_and_the_next_one_is_read() -> None:
    buffer = BotaBuffer()
    garbled = FRAMES[0][:9] + bytes([FRAMES[0][9] ^ 1]) + FRAMES[0][10:]
    found = buffer.feed(FRAMES[1] + garbled + FRAMES[2] + FRAMES[3])
    assert found == [frame[1:-2] for frame in FRAMES[1:]]
    assert buffer.dropped == 1


def test_a_body_of_another_length_is_none() -> None:
    with pytest.raises(CodecError, match="5 bytes"):
        BotaFormat().decode(bytes(5))


@pytest.mark.parametrize(
    ("wrong", "reason"),
    [
        ({}, "time_column = 6"),
        ({"time_column": 6, "streams": {"x": {"columns": (6,), "unit": "N"}}}, "column 6 is time"),
        ({"time_column": 6, "streams": {"x": {"columns": (9,), "unit": "N"}}}, "a frame has 0 to 8"),
    ],
)
def test_a_column_that_is_none_of_its_numbers_is_refused(wrong: dict[str, Any], reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        SerialLinesSettings(**{"port": "-", "frames": "bota", "streams": FORCE, **wrong})

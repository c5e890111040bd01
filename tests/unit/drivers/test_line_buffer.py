"""A stream of bytes is cut into lines."""

import itertools

from hypothesis import given
from hypothesis import strategies as st

from drivers.core.links import LineBuffer

LINES = [b"@01 1 04 OK IDLE -- 24188:2D", b'{"answer": 3, "done": true}', b"x"]
STREAM = b"\r\n".join([*LINES, b"\n"])


@given(st.lists(st.integers(min_value=0, max_value=len(STREAM)), max_size=6))
def test_lines_are_the_same_wherever_the_bytes_are_split(cuts: list[int]) -> None:
    buffer = LineBuffer(40)
    ends = [0, *sorted(cuts), len(STREAM)]
    assert [line for a, b in itertools.pairwise(ends) for line in buffer.feed(STREAM[a:b])] == LINES
    assert buffer.dropped == 0


def test_a_line_of_the_greatest_length_is_read_and_no_longer_one() -> None:
    buffer = LineBuffer(160)
    assert buffer.feed(b"x" * 160) == []
    assert buffer.feed(b"\r\n") == [b"x" * 160]
    assert buffer.feed(b"x" * 161) == []
    assert buffer.feed(b"\r\none\r\ntw") == [b"one"]
    assert buffer.feed(b"o\r\n") == [b"two"]
    assert buffer.dropped == 1


def test_bytes_without_an_end_of_line_do_not_pile_up_and_count_as_one_line() -> None:
    buffer = LineBuffer(160)
    for _ in range(1000):
        assert buffer.feed(b"\x02" * 100) == []
        assert len(buffer._rest) <= 160
    assert buffer.feed(b"tail\r\nnext\r\n") == [b"next"]
    assert buffer.dropped == 1

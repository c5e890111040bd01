"""Lines as sketches print them; the checks were added by hand."""

import math

import pytest

from drivers.core.errors import CodecError
from drivers.serial_lines.codec import LineFormat


@pytest.mark.parametrize(
    ("line", "form", "numbers"),
    [
        (b"1000,512,-7.25", LineFormat(), [1000.0, 512.0, -7.25]),
        (b" 1000 , 512 ", LineFormat(), [1000.0, 512.0]),
        (b"1000;5e-3", LineFormat(";"), [1000.0, 0.005]),
        (b"1000\t5\t6", LineFormat("\t"), [1000.0, 5.0, 6.0]),
        (b"1000  5 6", LineFormat(" "), [1000.0, 5.0, 6.0]),
        # '1' ^ ',' ^ '2' = 31 ^ 2C ^ 32 = 2F; 31 + 2C + 32 = 8F
        (b"1,2*2F", LineFormat(check="xor"), [1.0, 2.0]),
        (b"$1,2*2f", LineFormat(check="xor"), [1.0, 2.0]),
        (b"1,2*8F", LineFormat(check="sum"), [1.0, 2.0]),
    ],
)
def test_golden_lines(line: bytes, form: LineFormat, numbers: list[float]) -> None:
    assert form.decode(line) == numbers


@pytest.mark.parametrize("word", ["nan", "NaN", "inf", "-inf", "ovf"])
def test_what_an_arduino_prints_for_no_number_is_no_number(word: str) -> None:
    assert math.isnan(LineFormat().decode(f"1,{word}".encode())[1])


@pytest.mark.parametrize(
    ("line", "form", "what"),
    [
        (b"ADXL ready", LineFormat(), "ADXL ready.* numbers"),
        (b"1,,2", LineFormat(), "numbers"),
        (b"1,2,", LineFormat(), "numbers"),
        (b"1,2_0", LineFormat(), "numbers"),
        (b"1,1e999", LineFormat(), "numbers"),
        (b"1,infinity", LineFormat(), "numbers"),
        (b"\xfe\x00\x81", LineFormat(), "no text"),
        (b"1,0x12", LineFormat(), "numbers"),
        (b"1,2*2E", LineFormat(check="xor"), r"1,2\*2E.* check"),
        (b"1,2", LineFormat(check="xor"), "check"),
        (b"1,3*8F", LineFormat(check="sum"), "check"),
        (b"1,2*2F", LineFormat(), "numbers"),
    ],
)
def test_what_is_no_line_of_numbers_is_an_error(line: bytes, form: LineFormat, what: str) -> None:
    with pytest.raises(CodecError, match=what):
        form.decode(line)


@pytest.mark.parametrize("check", ["none", "xor", "sum"])
def test_what_is_written_is_read(check: str) -> None:
    form = LineFormat(";", check)
    assert form.decode(form.encode(["12", "-3.5"]).rstrip()) == [12.0, -3.5]

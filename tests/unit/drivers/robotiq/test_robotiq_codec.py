"""Lines of the URCap's socket against bytes written by hand from docs/reference/grippers.md."""

import pytest

from drivers.core.messages import Grip, Release
from drivers.robotiq import codec
from drivers.robotiq.codec import RobotiqOrder
from drivers.robotiq.settings import RobotiqSettings

UNITS = RobotiqSettings(port="-").units()


def test_questions_and_orders_are_the_lines_of_the_page() -> None:
    assert codec.encode_get("POS") == b"GET POS\n"
    assert codec.encode_set(ACT=1) == b"SET ACT 1\n"
    assert codec.encode_drive(RobotiqOrder(100, 255, 0)) == b"SET POS 100 SPE 255 FOR 0 GTO 1\n"


@pytest.mark.parametrize(
    ("data", "answer", "rest"),
    [
        (b"ack", ("ack", 0), b""),
        (b"POS 3", ("POS", 3), b""),
        (b"OBJ 2\n", ("OBJ", 2), b""),
        (b"POS 255ack", ("POS", 255), b"ack"),
        (b"ackSTA 3", ("ack", 0), b"STA 3"),
        (b"PO", None, b"PO"),
        (b"POS ", None, b"POS "),
        (b"?", None, b"?"),
        (b"", None, b""),
    ],
)
def test_answers_are_told_apart_though_they_have_no_end(
    data: bytes, answer: tuple[str, int] | None, rest: bytes
) -> None:
    assert codec.take_answer(data) == (answer, rest)


def test_a_grip_is_rounded_to_counts_with_force_and_speed_down() -> None:
    # 85 mm over 227 counts; 215 N and 130 mm/s over 255.
    assert UNITS.order(Grip("g", 0.0425, 0.1, 100.0)) == RobotiqOrder(116, 156, 94)
    rounded = UNITS.rounded(Grip("g", 0.0425, 0.1, 100.0))
    assert isinstance(rounded, Grip)
    assert rounded.width_m == pytest.approx(0.085 - 113 * 0.085 / 227)
    assert (rounded.speed_m_s, rounded.force_n) == pytest.approx(
        (0.02 + 156 * 0.13 / 255, 20 + 94 * 215 / 255)
    )
    assert UNITS.order(Release("g", 0.15)) == RobotiqOrder(3, 255, 0)


@pytest.mark.parametrize(("width_m", "position"), [(0.085, 3), (0.0, 230)])
def test_the_ends_are_the_model_s(width_m: float, position: int) -> None:
    assert UNITS.width_m(position) == pytest.approx(width_m)
    assert UNITS.order(Grip("g", width_m, 0.1, 20.0)).position == position


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"open_width_m": 0.01, "closed_width_m": 0.02}, "not above closed_width_m"),
        ({"counts": (230, 3)}, "the open one first"),
        ({"model": "3f"}, "2f-85"),
    ],
)
def test_settings_that_no_gripper_has_are_refused(wrong: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        RobotiqSettings(port="-", **wrong)  # type: ignore[arg-type]

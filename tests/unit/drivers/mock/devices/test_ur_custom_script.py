"""Programs of a client's own on the emulated controller: what is obeyed, and what is refused whole."""

from __future__ import annotations

import math

import numpy as np
import pytest

from drivers.mock.devices.ur_controller.controller import Runtime, Safety
from drivers.mock.devices.ur_controller.session import ScriptSession
from tests.unit.drivers.mock.devices.ur_desk import Desk, desk


def sent(*lines: str) -> Desk:
    """What becomes of a program that comes on the script port."""
    one = desk()
    one.controller.stop_program("to make room")
    one.run(10)
    body = "".join(f"\t{line}\n" for line in lines)
    ScriptSession(one.controller).feed(f"def mine():\n{body}end\n".encode())
    return one


def test_its_lines_are_obeyed_one_after_the_other() -> None:
    one = sent(
        "write_output_integer_register(0 + 0, 1)  # begun",
        "",
        'textmsg("now ", 3)',
        "movej([0.1, -1.8, -2.2, -0.71, 1.57, 0.0], a=2.0, v=1.0)",
        "sleep(0.1)",
        "set_standard_digital_out(3, True)",
        "write_output_integer_register(0 + 0, 2)",
    )
    one.run(1)
    assert one.controller.outputs["output_int_register_0"] == 1
    one.run(200)
    assert one.controller.outputs["output_int_register_0"] == 1, "it sleeps, or moves"
    one.run(300)
    assert one.controller.arm.joints_rad == pytest.approx([0.1, -1.8, -2.2, -0.71, 1.57, 0.0])
    assert one.controller.outputs["output_int_register_0"] == 2
    assert one.controller.panel.digital_bits == 1 << 3
    assert one.controller.runtime is Runtime.STOPPED
    assert "now 3" in one.log


def test_a_line_goes_to_a_pose() -> None:
    one = desk()
    x, y, z, *turn = one.pose
    one = sent(f"movel(p[{x}, {y}, {z} - 0.02, {turn[0]}, {turn[1]}, {turn[2]}])")
    one.run(500)
    assert one.pose[:3] == pytest.approx([x, y, z - 0.02], abs=1e-6)


@pytest.mark.parametrize(
    "line",
    [
        "a = 1",
        "if True:",
        "open('/etc/passwd')",
        "__init__(1)",
        "movel()",
        "movel(p[1, 2, 3])",
        "textmsg('x' * 1000000000)",
        "sleep([1] * 1000000000)",
        "sleep((lambda: 1)())",
        "sleep(" + "-" * 900 + "1)",
        "sleep(1" + " + 1" * 400 + ")",
        "(" * 400,
        "sleep(\x00)",
    ],
)
def test_a_program_with_a_line_that_is_not_emulated_is_refused_whole(line: str) -> None:
    one = sent("write_output_integer_register(5, 1)", line)
    one.run(2)
    assert one.controller.runtime is Runtime.STOPPED
    assert one.controller.outputs["output_int_register_5"] == 0
    assert "program refused" in one.log


@pytest.mark.parametrize(
    "line",
    [
        "movej([0.1, 0.2, 0.3])",
        "movej(['a', 0, 0, 0, 0, 0])",
        "movej(p[9, 0, 0, 0, 0, 0])",
        "movel([0, 0, 0, 0, 0, 0], v=0)",
        "movel([0, 0, 0, 0, 0, 0], v='fast')",
        "stopl(0)",
        "sleep(1e400)",
        "sleep('long')",
        "write_output_integer_register(48, 1)",
        "write_output_integer_register(0, 2147483648)",
        "write_output_float_register(0, 'x')",
        "set_standard_digital_out(10000000000, True)",
        "set_tcp(p[1e400, 0, 0, 0, 0, 0])",
    ],
)
def test_a_program_that_asks_for_what_cannot_be_ends_with_a_reason(line: str) -> None:
    one = sent(line)
    one.run(20)
    assert one.controller.runtime is Runtime.STOPPED
    assert "runtime exception" in one.log
    assert one.controller.arm.resting
    assert np.isfinite(one.pose).all()


def test_joints_that_are_no_numbers_are_a_protective_stop() -> None:
    one = desk()
    one.write(1, [math.nan, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 1.0])
    one.run(5)
    assert one.controller.safety is Safety.PROTECTIVE_STOP
    assert np.isfinite(one.pose).all()


def test_a_protective_stop_ends_it() -> None:
    one = sent("movej([1.0, -1.8, -2.2, -0.71, 1.57, 0.0])")
    one.run(100)
    one.controller.protective_stop("by hand")
    one.run(200)
    assert one.controller.arm.resting
    assert one.controller.runtime is Runtime.STOPPED

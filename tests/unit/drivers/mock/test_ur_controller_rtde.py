"""RTDE packages against bytes written by hand from the RTDE guide, and a session's part in them."""

import struct

import pytest

from drivers.mock.devices.ur_controller import rtde
from drivers.mock.devices.ur_controller.controller import UrController, UrControllerSettings
from drivers.mock.devices.ur_controller.rtde import Kind, PackageError
from drivers.mock.devices.ur_controller.session import RtdeSession, ScriptSession

PROTOCOL = bytes.fromhex("0005 56 0002")
PROTOCOL_ACCEPTED = bytes.fromhex("0004 56 01")
VERSION = bytes.fromhex("0003 76")
VERSION_5_11_1_108318 = bytes.fromhex("0013 76 00000005 0000000b 00000001 0001a71e")
OUTPUTS_AT_500_HZ = bytes.fromhex("0023 4f 407f400000000000") + b"timestamp,runtime_state,"
OUTPUTS_AGREED = bytes.fromhex("0011 4f 01") + b"DOUBLE,UINT32"
START, STARTED = bytes.fromhex("0003 53"), bytes.fromhex("0004 53 01")
PAUSE, PAUSED = bytes.fromhex("0003 50"), bytes.fromhex("0004 50 01")
FIRST_ROW = bytes.fromhex("0010 55 01 3f60624dd2f1a9fc 00000001")
"""Recipe 1, 0.002 s, stopped."""


@pytest.fixture
def controller() -> UrController:
    return UrController(UrControllerSettings())


@pytest.fixture
def session(controller: UrController) -> RtdeSession:
    return RtdeSession(controller, set())


def test_the_handshake_is_the_guide_s_byte_for_byte(controller: UrController, session: RtdeSession) -> None:
    assert session.feed(PROTOCOL) == PROTOCOL_ACCEPTED
    assert session.feed(VERSION) == VERSION_5_11_1_108318
    assert session.feed(OUTPUTS_AT_500_HZ) == OUTPUTS_AGREED
    assert session.feed(START) == STARTED
    controller.step()
    assert session.step() == FIRST_ROW
    assert session.feed(PAUSE) == PAUSED
    assert session.step() == b""


def test_packages_may_arrive_in_pieces(session: RtdeSession) -> None:
    answer = b"".join(session.feed(bytes([byte])) for byte in PROTOCOL + VERSION)
    assert answer == PROTOCOL_ACCEPTED + VERSION_5_11_1_108318


def test_another_protocol_version_is_not_accepted(session: RtdeSession) -> None:
    assert session.feed(bytes.fromhex("0005 56 0001")) == bytes.fromhex("0004 56 00")


def test_a_size_without_room_for_its_own_header_is_no_package(session: RtdeSession) -> None:
    with pytest.raises(PackageError):
        session.feed(bytes.fromhex("0002 56"))


def test_an_unknown_output_is_not_found_and_nothing_starts(session: RtdeSession) -> None:
    request = struct.pack(">d", 500.0) + b"timestamp,no_such_thing"
    assert session.feed(rtde.encode(Kind.OUTPUTS, request)).endswith(b"DOUBLE,NOT_FOUND")
    assert session.feed(START) == bytes.fromhex("0004 53 00")


def test_a_slower_stream_leaves_cycles_out(controller: UrController, session: RtdeSession) -> None:
    session.feed(rtde.encode(Kind.OUTPUTS, struct.pack(">d", 125.0) + b"timestamp"))
    session.feed(START)
    rows = []
    for _ in range(12):
        controller.step()
        rows.append(bool(session.step()))
    assert rows == [False, False, False, True] * 3


def test_an_input_has_one_writer_and_is_free_again_when_that_one_leaves(controller: UrController) -> None:
    taken: set[str] = set()
    first, second = RtdeSession(controller, taken), RtdeSession(controller, taken)
    request = rtde.encode(Kind.INPUTS, b"input_int_register_0,")
    assert first.feed(request).endswith(b"\x01INT32")
    assert second.feed(request).endswith(b"IN_USE")
    assert first.feed(request).endswith(b"\x02INT32")
    first.close()
    assert second.feed(request).endswith(b"\x01INT32")


def test_inputs_reach_the_registers_that_their_recipe_names(
    controller: UrController, session: RtdeSession
) -> None:
    session.feed(rtde.encode(Kind.INPUTS, b"input_int_register_24,input_double_register_0,"))
    session.feed(rtde.encode(Kind.DATA, struct.pack(">Bid", 1, -7, 0.25)))
    assert controller.inputs["input_int_register_24"] == -7
    assert controller.inputs["input_double_register_0"] == 0.25


@pytest.mark.parametrize("body", [b"", bytes([2, 0, 0, 0, 1]), bytes([1, 0, 0]), bytes([1, 0, 0, 0, 1, 9])])
def test_data_that_fit_no_recipe_are_dropped_with_a_word_in_the_log(
    controller: UrController, session: RtdeSession, body: bytes
) -> None:
    session.feed(rtde.encode(Kind.INPUTS, b"input_int_register_0,"))
    session.feed(rtde.encode(Kind.DATA, body))
    assert controller.inputs["input_int_register_0"] == 0
    assert controller.log


def test_vectors_of_every_type_take_their_size_on_the_wire() -> None:
    recipe = rtde.Recipe(3, ["a", "b", "c", "d"], ["VECTOR3D", "VECTOR6INT32", "UINT64", "BOOL"])
    package = recipe.encode([(1.0, 2.0, 3.0), (1, 2, 3, 4, 5, 6), 1 << 40, True])
    assert len(package) == 3 + 1 + 24 + 24 + 8 + 1
    assert recipe.decode(package[3:]) == {
        "a": (1.0, 2.0, 3.0),
        "b": (1, 2, 3, 4, 5, 6),
        "c": 1 << 40,
        "d": True,
    }


def program(offset: str = "0", name: str = "rtde_control") -> bytes:
    return (
        f"def {name}():\n    global reg_offset_float = # float register offset\n{offset}"
        f"    global reg_offset_int = # int register offset\n{offset}    global x = 2\nend\n"
    ).encode()


def test_a_script_that_arrives_in_pieces_starts_with_its_last_line(controller: UrController) -> None:
    script = ScriptSession(controller)
    text = program()
    script.feed(text[:40])
    script.feed(text[40:-2])
    assert controller.runtime is controller.runtime.STOPPED
    script.feed(text[-2:])
    assert controller.runtime is controller.runtime.PLAYING


def test_a_script_for_the_upper_registers_answers_there(controller: UrController) -> None:
    ScriptSession(controller).feed(program("24"))
    controller.step()
    assert controller.outputs["output_int_register_24"] == 1
    assert controller.outputs["output_int_register_0"] == 0


def test_a_program_of_another_kind_is_left_alone(controller: UrController) -> None:
    ScriptSession(controller).feed(program(name="mine"))
    assert controller.runtime is controller.runtime.STOPPED
    assert "mine" in controller.log[-1]

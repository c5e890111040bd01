"""RTDE packages against bytes written by hand from the RTDE guide, and a session's part in them."""

import struct

import pytest

from simulator.devices.ur_controller import rtde
from simulator.devices.ur_controller.controller import UrController, UrControllerSettings
from simulator.devices.ur_controller.rtde import PackageError, PackageKind
from simulator.devices.ur_controller.session import INPUTS, OUTPUTS, RtdeSession, ScriptSession
from simulator.physics.arm import elbow

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


def test_an_input_has_one_writer_and_is_free_again_when_that_one_leaves(controller: UrController) -> None:
    taken: set[str] = set()
    first, second = RtdeSession(controller, taken), RtdeSession(controller, taken)
    request = rtde.encode(PackageKind.INPUTS, b"input_int_register_0,")
    assert first.feed(request).endswith(b"\x01INT32")
    assert second.feed(request).endswith(b"IN_USE")
    assert first.feed(request).endswith(b"\x02INT32")
    first.close()
    assert second.feed(request).endswith(b"\x01INT32")


def test_inputs_reach_the_registers_that_their_recipe_names(
    controller: UrController, session: RtdeSession
) -> None:
    session.feed(rtde.encode(PackageKind.INPUTS, b"input_int_register_24,input_double_register_0,"))
    session.feed(rtde.encode(PackageKind.DATA, struct.pack(">Bid", 1, -7, 0.25)))
    assert controller.inputs["input_int_register_24"] == -7
    assert controller.inputs["input_double_register_0"] == 0.25


@pytest.mark.parametrize("body", [b"", bytes([2, 0, 0, 0, 1]), bytes([1, 0, 0]), bytes([1, 0, 0, 0, 1, 9])])
def test_data_that_fit_no_recipe_are_dropped_with_an_entry_in_the_log(
    controller: UrController, session: RtdeSession, body: bytes
) -> None:
    session.feed(rtde.encode(PackageKind.INPUTS, b"input_int_register_0,"))
    session.feed(rtde.encode(PackageKind.DATA, body))
    assert controller.inputs["input_int_register_0"] == 0
    assert controller.log


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


def outputs(names: str, rate_hz: float = 500.0) -> bytes:
    return rtde.encode(PackageKind.OUTPUTS, struct.pack(">d", rate_hz) + names.encode())


@pytest.mark.parametrize(
    ("rate_hz", "every"), [(1e-310, 500), (-1.0, 500), (0.0, 500), (10.0, 50), (499.0, 1), (1e308, 1)]
)
def test_a_rate_is_brought_to_what_there_is(
    controller: UrController, session: RtdeSession, rate_hz: float, every: int
) -> None:
    session.feed(outputs("timestamp", rate_hz))
    session.feed(START)
    sent = [bool(session.step()) for _ in range(1000)]
    assert sent == ([False] * (every - 1) + [True]) * (1000 // every)


@pytest.mark.parametrize("rate_hz", [float("nan"), float("inf")])
def test_a_rate_that_is_no_number_is_no_package(session: RtdeSession, rate_hz: float) -> None:
    with pytest.raises(PackageError, match="Hz"):
        session.feed(outputs("timestamp", rate_hz))


@pytest.mark.parametrize(
    "name", ["output_int_register_48", "output_double_register_99", "output_bit_register_63", "no_such_thing"]
)
def test_a_recipe_with_an_unknown_name_has_no_id(session: RtdeSession, name: str) -> None:
    answer = session.feed(outputs(f"timestamp,{name}"))
    assert answer[3:] == b"\x00DOUBLE,NOT_FOUND"
    assert session.feed(START) == bytes.fromhex("0004 53 00")


def test_a_recipe_that_fits_no_package_has_no_id_and_the_one_before_stays(session: RtdeSession) -> None:
    assert session.feed(outputs("timestamp"))[3] == 1
    assert session.feed(outputs(",".join(["target_q"] * 1400)))[3] == 0
    session.feed(START)
    assert len(session.step()) == 3 + 1 + 8


def test_a_client_has_as_many_recipes_as_have_an_id(controller: UrController, session: RtdeSession) -> None:
    request = rtde.encode(PackageKind.INPUTS, b"input_int_register_0,")
    assert [session.feed(request)[3] for _ in range(257)] == [*range(1, 256), 0, 0]
    session.feed(rtde.encode(PackageKind.DATA, struct.pack(">Bi", 255, 7)))
    assert controller.inputs["input_int_register_0"] == 7


OFFICIAL = (
    "timestamp,target_q,target_qd,target_qdd,target_current,target_moment,actual_q,actual_qd,actual_current,"
    "joint_control_output,actual_TCP_pose,actual_TCP_speed,actual_TCP_force,target_TCP_pose,target_TCP_speed,"
    "actual_digital_input_bits,joint_temperatures,actual_execution_time,robot_mode,joint_mode,safety_status,"
    "actual_tool_accelerometer,speed_scaling,target_speed_fraction,actual_momentum,actual_main_voltage,"
    "actual_robot_voltage,actual_robot_current,actual_joint_voltage,actual_digital_output_bits,runtime_state,"
    "joint_position_deviation_ratio"
)
"""What the manufacturer's own client records by default (its example `record`, recipe "out")."""


def test_the_manufacturer_s_own_recipe_is_found_and_sent_whole(
    controller: UrController, session: RtdeSession
) -> None:
    answer = session.feed(outputs(OFFICIAL, 125.0))
    kinds = answer[4:].decode().split(",")
    assert (answer[3], len(kinds)) == (1, 32)
    assert kinds[20:24] == ["INT32", "VECTOR3D", "DOUBLE", "DOUBLE"]
    session.feed(START)
    rows = [row for _ in range(8) if (row := session.step())]
    assert [len(row) for row in rows] == [3 + 1 + rtde.size(kinds)] * 2


def test_every_variable_of_the_guide_has_a_value_of_its_type(
    controller: UrController, session: RtdeSession
) -> None:
    for name, (kind, _) in OUTPUTS.items():
        assert session.feed(outputs(name))[3] == 1
        session.feed(START)
        assert len(session.step()) == 3 + 1 + rtde.size([kind]), name


def test_the_elbow_follows_from_the_joints(controller: UrController) -> None:
    arm = controller.arm
    controller.start_program(0)
    speeds = {f"input_double_register_{k}": v for k, v in enumerate([0.3, 0.2, 0.1, 0.0, 0.0, 0.0, 5.0, 0.0])}
    controller.write_inputs({"input_int_register_0": 9, **speeds})
    for _ in range(100):
        controller.step()
    place, velocity = elbow(arm.joints_rad, arm.joint_speeds_rad_s)
    controller.step()
    moved = (elbow(arm.joints_rad, arm.joint_speeds_rad_s)[0] - place) / 0.002
    assert moved == pytest.approx(velocity, abs=1e-3)
    assert abs(velocity).max() > 0.05


def written(session: RtdeSession, values: dict[str, int | float]) -> None:
    number = session.feed(rtde.encode(PackageKind.INPUTS, ",".join(values).encode()))[3]
    fields = [rtde.packer(INPUTS[name])(value) for name, value in values.items()]
    session.feed(rtde.encode(PackageKind.DATA, bytes([number]) + b"".join(fields)))


def test_outputs_that_a_client_sets_are_seen_in_the_stream(session: RtdeSession) -> None:
    session.feed(outputs("actual_digital_output_bits,standard_analog_output0,standard_analog_output1"))
    session.feed(START)
    written(session, {"standard_digital_output_mask": 0b101, "standard_digital_output": 0b111})
    written(session, {"configurable_digital_output_mask": 0x80, "configurable_digital_output": 0xFF})
    written(session, {"tool_digital_output_mask": 0xFF, "tool_digital_output": 0xFF})
    written(
        session,
        {
            "standard_analog_output_mask": 0b10,
            "standard_analog_output_type": 0b11,
            "standard_analog_output_0": 0.9,
            "standard_analog_output_1": 0.25,
        },
    )
    assert struct.unpack(">Qdd", session.step()[4:]) == (0x3_80_05, 0.004, 2.5)
    written(session, {"standard_digital_output_mask": 0b001, "standard_digital_output": 0})
    assert struct.unpack(">Qdd", session.step()[4:])[0] == 0x3_80_04


def test_a_script_as_long_as_none_is_refused_without_being_searched_again_and_again(
    controller: UrController,
) -> None:
    script = ScriptSession(controller)
    with pytest.raises(PackageError, match="program"):
        for _ in range(1024):
            script.feed(b"x" * 65536)
    assert controller.runtime is controller.runtime.STOPPED

"""What the emulated controller does with commands in its registers, beyond what tests/wire/test_ur_judge.py shows."""

import numpy as np
import pytest

from simulator.devices.ur_controller.controller import Runtime, Safety, UrController
from simulator.devices.ur_controller.session import DashboardSession
from tests.simulator.devices.ur_desk import desk as make
from tests.simulator.devices.ur_desk import down

MOVE_L, SPEED_L, SET_TOOL, PROTECTIVE_STOP, STOP_L = 3, 10, 29, 31, 33
JOG, JOG_STOP, UNTIL_CONTACT = 41, 42, 51


@pytest.mark.parametrize("command", [MOVE_L, STOP_L, UNTIL_CONTACT])
def test_a_second_mover_during_a_tool_speed_ends_the_program(command: int) -> None:
    desk = make()
    desk.write(SPEED_L, [0.0, 0.0, -0.02, 0.0, 0.0, 0.0, 0.5, 0.002])
    desk.run(50)
    desk.write(command, [*desk.pose, 0.05, 0.5, 0.0, 0.0, 0.0, 0.0, 0.5])
    desk.run(50)
    assert desk.controller.runtime is Runtime.STOPPED
    assert "another thread is already controlling the robot" in desk.controller.log[-1]
    assert desk.controller.arm.resting


def test_a_speed_that_was_left_in_the_registers_moves_the_arm_when_the_script_starts_again() -> None:
    desk = make()
    desk.write(SPEED_L, [0.0, 0.0, -0.02, 0.0, 0.0, 0.0, 0.5, 0.002])
    desk.run(50)
    desk.controller.stop_program("asked for")
    desk.run(50)
    assert desk.controller.arm.resting
    desk.controller.start_program(0)
    desk.run(50)
    assert not desk.controller.arm.resting


def test_a_contact_from_another_side_does_not_count() -> None:
    desk = make(plane_m=0.179)
    desk.call(MOVE_L, [*down(desk, 0.002), 0.01, 0.5])
    assert desk.controller.force[2] > 5.0
    assert desk.controller.contact_steps([0.0, 0.0, 1.0]) == 0
    assert desk.controller.contact_steps([0.0, 0.0, -1.0]) > 0


def test_jogging_in_the_tool_s_frame_goes_along_the_tool() -> None:
    desk = make()
    start, axis = desk.pose.copy(), desk.controller.arm.transform[:3, 2].copy()
    desk.call(JOG, [0.0, 0.0, 0.01, 0.0, 0.0, 0.0, 1.0, 0.5, *[0.0] * 6])
    desk.run(200)
    desk.call(JOG_STOP)
    way = desk.pose[:3] - start[:3]
    assert way / np.linalg.norm(way) == pytest.approx(axis, abs=1e-6)
    assert desk.controller.arm.resting


def test_another_tool_point_is_reported_from_then_on() -> None:
    desk = make()
    height_m = desk.pose[2]
    desk.call(SET_TOOL, [0.0, 0.0, 0.1, 0.0, 0.0, 0.0])
    assert desk.pose[2] == pytest.approx(height_m - 0.1, abs=1e-6)


def test_the_force_noise_has_its_setting_and_its_seed() -> None:
    desk, twin = make(force_noise_n=0.5, seed=7), make(force_noise_n=0.5, seed=7)
    forces = []
    for _ in range(2000):
        desk.controller.step()
        twin.controller.step()
        assert (desk.controller.force == twin.controller.force).all()
        forces.append(desk.controller.force[0])
    assert np.std(forces) == pytest.approx(0.5, rel=0.1)


@pytest.mark.parametrize(
    ("command", "name"),
    [
        (12, "servoC"),
        (45, "movePath"),
        (56, "ftRtdeInput"),
        (57, "ExternalFt"),
        (59, "setGravity"),
        (99, "unknown"),
    ],
)
def test_a_command_that_is_not_emulated_ends_the_program_with_its_name(command: int, name: str) -> None:
    desk = make()
    desk.write(command)
    desk.run(5)
    assert f"command {command} is not emulated" in desk.controller.log[-1]
    assert name in desk.controller.log[-1]


def test_a_protective_stop_keeps_programs_away_until_it_is_unlocked() -> None:
    desk = make()
    desk.write(PROTECTIVE_STOP)
    desk.run(5)
    assert desk.controller.safety.bits & 0b111 == 0b100
    desk.controller.start_program(0)
    assert desk.controller.runtime is Runtime.STOPPED
    assert ask(desk.controller, "unlock protective stop").startswith("Cannot unlock")
    desk.run(60)
    assert ask(desk.controller, "unlock protective stop") == "Protective stop releasing\n"
    desk.controller.start_program(0)
    assert desk.controller.runtime is Runtime.PLAYING


def test_an_emergency_stop_cannot_be_unlocked_from_afar() -> None:
    desk = make()
    desk.controller.emergency_stop()
    desk.run(200)
    assert not desk.controller.unlock()
    assert desk.controller.safety.bits >> 7 & 1


def test_a_move_beyond_the_tool_s_speed_limit_is_a_protective_stop() -> None:
    desk = make()
    desk.write(SPEED_L, [0.0, 2.5, 0.0, 0.0, 0.0, 0.0, 50.0, 0.002])
    desk.run(100)
    assert desk.controller.safety is Safety.PROTECTIVE_STOP


def ask(controller: UrController, line: str) -> str:
    return DashboardSession(controller).feed(line.encode() + b"\n").decode()


def test_the_dashboard_gives_the_answers_that_the_client_waits_for() -> None:
    controller = make().controller
    assert "5.11.1.108318" in ask(controller, "PolyscopeVersion")
    assert ask(controller, "get serial number").strip().isdigit()
    assert ask(controller, "is in remote control") == "true\n"
    assert ask(controller, "programState") == "PLAYING <unnamed>\n"
    assert ask(controller, "stop") == "Stopped\n"
    assert ask(controller, "running") == "Program running: false\n"
    assert ask(controller, "make coffee").startswith("could not understand")
    assert ask(controller, "popup Mind the arm") == "showing popup\n"
    assert ask(controller, "power on") + ask(controller, "brake release") == "Powering on\nBrake releasing\n"


def test_dashboard_lines_may_arrive_in_pieces_and_together() -> None:
    session = DashboardSession(make().controller)
    assert session.feed(b"robot") == b""
    assert session.feed(b"mode\nget robot model\n") == b"Robotmode: RUNNING\nUR5\n"

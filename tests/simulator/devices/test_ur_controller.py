"""What the emulated controller does with commands in its registers, beyond what tests/wire/test_ur_judge.py shows."""

import math
from collections.abc import Callable

import numpy as np
import pytest

from simulator.devices.ur_controller.controller import Safety, UrController
from simulator.devices.ur_controller.session import DashboardSession
from tests.simulator.devices.ur_desk import Desk, desk

MOVE_L, SPEED_L, SET_TOOL, WATCHDOG = 3, 10, 29, 35


@pytest.fixture
def make() -> Callable[..., Desk]:
    return desk


def test_a_second_mover_during_a_tool_speed_ends_the_program(make: Callable[..., Desk]) -> None:
    desk = make()
    desk.write(SPEED_L, [0.0, 0.0, -0.02, 0.0, 0.0, 0.0, 0.5, 0.002])
    desk.run(50)
    desk.write(MOVE_L, [*desk.pose, 0.05, 0.5])
    desk.run(50)
    assert not desk.controller.playing
    assert "another thread is already controlling the robot" in desk.controller.log[-1]
    assert desk.controller.arm.resting


def test_the_watchdog_stops_an_arm_whose_client_is_gone(make: Callable[..., Desk]) -> None:
    desk = make()
    desk.call(WATCHDOG, [10.0])
    desk.write(SPEED_L, [0.0, 0.0, -0.02, 0.0, 0.0, 0.0, 0.5, 0.002])
    desk.run(45)
    assert desk.controller.playing
    desk.run(20)
    assert not desk.controller.playing
    assert desk.controller.arm.resting
    assert "watchdog" in desk.controller.log[-1]


def test_a_client_that_kicks_the_watchdog_keeps_its_program(make: Callable[..., Desk]) -> None:
    desk = make()
    desk.call(WATCHDOG, [10.0])
    for _ in range(20):
        desk.write(0)
        desk.run(40)
    assert desk.controller.playing


def test_a_speed_that_was_left_in_the_registers_moves_the_arm_when_the_script_starts_again(
    make: Callable[..., Desk],
) -> None:
    desk = make()
    desk.write(SPEED_L, [0.0, 0.0, -0.02, 0.0, 0.0, 0.0, 0.5, 0.002])
    desk.run(50)
    desk.controller.stop_program("asked for")
    desk.run(50)
    assert desk.controller.arm.resting
    desk.controller.start_program()
    desk.run(50)
    assert not desk.controller.arm.resting


def test_another_tool_point_is_reported_from_then_on(make: Callable[..., Desk]) -> None:
    desk = make()
    height_m = desk.pose[2]
    desk.call(SET_TOOL, [0.0, 0.0, 0.1, 0.0, 0.0, 0.0])
    assert desk.pose[2] == pytest.approx(height_m - 0.1, abs=1e-6)


def test_the_force_noise_has_its_setting_and_is_the_same_each_time(make: Callable[..., Desk]) -> None:
    desk, twin = make(force_noise_n=0.5), make(force_noise_n=0.5)
    forces = []
    for _ in range(2000):
        desk.controller.step()
        twin.controller.step()
        assert (desk.controller.force == twin.controller.force).all()
        forces.append(desk.controller.force[0])
    assert np.std(forces) == pytest.approx(0.5, rel=0.1)


def test_a_speed_that_is_no_number_is_a_protective_stop(make: Callable[..., Desk]) -> None:
    desk = make()
    desk.write(SPEED_L, [math.nan, 0.0, 0.0, 0.0, 0.0, 0.0, 0.5, 0.002])
    desk.run(5)
    assert desk.controller.safety is Safety.PROTECTIVE_STOP
    assert np.isfinite(desk.pose).all()


def test_a_protective_stop_keeps_programs_away_until_it_is_unlocked(make: Callable[..., Desk]) -> None:
    desk = make()
    desk.controller.protective_stop("asked for")
    desk.run(5)
    assert desk.controller.safety.bits & 0b111 == 0b100
    desk.controller.start_program()
    assert not desk.controller.playing
    assert not desk.controller.unlock()
    desk.run(60)
    assert desk.controller.unlock()
    desk.controller.start_program()
    assert desk.controller.playing


def test_an_emergency_stop_cannot_be_unlocked_from_afar(make: Callable[..., Desk]) -> None:
    desk = make()
    desk.controller.emergency_stop()
    desk.run(200)
    assert not desk.controller.unlock()
    assert desk.controller.safety.bits >> 7 & 1


def test_a_move_beyond_the_tool_s_speed_limit_is_a_protective_stop(make: Callable[..., Desk]) -> None:
    desk = make()
    desk.write(SPEED_L, [0.0, 2.5, 0.0, 0.0, 0.0, 0.0, 50.0, 0.002])
    desk.run(100)
    assert desk.controller.safety is Safety.PROTECTIVE_STOP


def ask(controller: UrController, line: str) -> str:
    return DashboardSession(controller).feed(line.encode() + b"\n").decode()


def test_the_dashboard_gives_the_answers_that_the_client_waits_for(make: Callable[..., Desk]) -> None:
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


def test_the_dashboard_unlocks_a_protective_stop_after_its_time(make: Callable[..., Desk]) -> None:
    desk = make()
    desk.controller.protective_stop("asked for")
    assert ask(desk.controller, "unlock protective stop").startswith("Cannot unlock")
    desk.run(60)
    assert ask(desk.controller, "unlock protective stop") == "Protective stop releasing\n"
    assert desk.controller.safety is Safety.NORMAL


def test_dashboard_lines_may_arrive_in_pieces_and_together(make: Callable[..., Desk]) -> None:
    session = DashboardSession(make().controller)
    assert session.feed(b"robot") == b""
    assert session.feed(b"mode\nget robot model\n") == b"Robotmode: RUNNING\nUR5\n"

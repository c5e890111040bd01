"""The emulated stage, without a port: bytes in, bytes out, time from outside."""

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.zaber_stage.codec import MICROSTEP_M
from simulator.devices.zaber_stage import CONSTANTS, EmulatedZaberStage
from simulator.physics.stage_axis import StageAxis


def stage(*, homed: bool = True, plans: list[float] | None = None) -> EmulatedZaberStage:
    axis = StageAxis(acceleration_m_s2=0.5, max_speed_m_s=0.026)
    on_plan = plans.append if plans is not None else lambda t_s: None
    return EmulatedZaberStage(axis, on_plan, homed=homed)


def ask(device: EmulatedZaberStage, command: str, t_s: float = 0.0, axis: int = 1) -> str:
    return device.receive(f"/1 {axis} 07 {command}\n".encode(), t_s).decode()


def test_it_answers_as_documented() -> None:
    device = stage()
    assert ask(device, "") == "@01 1 07 OK IDLE -- 0\r\n"
    assert ask(device, "get pos") == "@01 1 07 OK IDLE -- 0\r\n"
    assert ask(device, "get limit.max") == "@01 1 07 OK IDLE -- 51200\r\n"
    assert device.receive(b"/get pos\n", 0.0) == b"@01 0 OK IDLE -- 0\r\n"


REJECTED = {
    (0, "BADCOMMAND"): ("set system.serial 3", "storage set key"),
    (0, "BADDATA"): ("storage get none",),
    (1, "DEVICEONLY"): ("get version", "set comm.checksum 1", "storage get key"),
    (1, "BADCOMMAND"): (
        *("fly", "move", "move abs", "move move abs 1", "move abs 100 1000 205 1", "move vel"),
        *("get nothing", "warnings shut", "driver off", "set motion.accelonly 205"),
    ),
    (1, "BADDATA"): (
        *("move abs 51201", "move abs -1", "move abs x", "move abs 100 0", "move abs 100 1000 0"),
        *("move abs " + "9" * 130, "move rel " + "9" * 130, "move vel 2147483648", "set limit.max 51201"),
    ),
}


@pytest.mark.parametrize(
    ("axis", "reason", "command"), [(*way, one) for way, commands in REJECTED.items() for one in commands]
)
def test_what_it_cannot_do_it_rejects_with_the_devices_reason(axis: int, reason: str, command: str) -> None:
    assert ask(stage(), command, axis=axis) == f"@01 {axis} 07 RJ IDLE -- {reason}\r\n"


@pytest.mark.parametrize(
    "line",
    [b"/1 1 07 get pos:00\n", b"/2 1 07 get pos\n", b"hello\n", b"\xff\xfe\x00\n", b"@01 1 OK IDLE -- 0\r\n"],
)
def test_a_wrong_checksum_another_address_or_another_protocol_is_dropped_silently(line: bytes) -> None:
    assert stage().receive(line, 0.0) == b""


@given(st.lists(st.integers(min_value=0, max_value=120), max_size=8))
def test_the_answers_are_the_same_wherever_the_bytes_are_split(cuts: list[int]) -> None:
    stream = b"/1 1 01 get pos\n/1 1 02 move abs 1000\n\r\n/1 1 03 fly\n/1 1 04 get maxspeed\n/1 1 05 stop\n"
    ends = [0, *sorted(min(cut, len(stream)) for cut in cuts), len(stream)]
    whole, pieces = stage(), stage()
    answers = b"".join(pieces.receive(stream[a:b], 0.0) for a, b in itertools.pairwise(ends))
    assert answers == whole.receive(stream, 0.0)
    assert answers.count(b"\r\n") == 5


def test_a_move_is_busy_until_the_axis_stands_and_notifies_the_plant_of_its_plan() -> None:
    plans: list[float] = []
    device = stage(plans=plans)
    assert " OK BUSY " in ask(device, "move abs 10000 16777", 1.0)
    assert plans == [1.0]
    duration_s = 10000 * MICROSTEP_M / (16777 / 1.6384 * MICROSTEP_M) + (16777 / 1.6384 * MICROSTEP_M) / 0.5
    assert " BUSY " in ask(device, "", 1.0 + 0.999 * duration_s)
    assert " IDLE " in ask(device, "", 1.0 + 1.001 * duration_s)
    assert ask(device, "get pos", 5.0).split()[-1] == "10000"


def test_a_stop_brakes_and_reports_that_the_movement_was_interrupted() -> None:
    plans: list[float] = []
    device = stage(plans=plans)
    ask(device, "move abs 51200")
    assert " BUSY NI " in ask(device, "stop", 0.5)
    assert plans == [0.0, 0.5]
    assert " IDLE NI " in ask(device, "", 1.0)


def test_without_a_reference_it_goes_home_and_nowhere_else() -> None:
    device = stage(homed=False)
    assert ask(device, "warnings").endswith("01 WR\r\n")
    assert " RJ IDLE WR BADDATA" in ask(device, "move abs 100")
    ask(device, "home")
    assert ask(device, "warnings", 1.0).endswith(" -- 00\r\n")
    assert " OK " in ask(device, "move abs 100", 1.0)


def test_homing_that_is_stopped_leaves_it_without_a_reference() -> None:
    unhomed = stage(homed=False)
    ask(unhomed, "move vel 41943")
    ask(unhomed, "home", 1.0)
    ask(unhomed, "stop", 1.1)
    assert "WR" in ask(unhomed, "warnings", 5.0)


def test_an_alert_comes_at_the_end_of_a_movement_where_alerts_are_on() -> None:
    device = stage()
    ask(device, "set comm.alert 1", axis=0)
    ask(device, "move abs 100")
    assert device.step(1e-6) == b""
    assert device.step(10.0) == b"!01 1 IDLE --\r\n"
    assert device.step(11.0) == b""


def test_a_refusal_befalls_one_movement() -> None:
    device = stage()
    device.inject("refuse", 0.0)
    assert "RJ IDLE -- STATUSBUSY" in ask(device, "move abs 100")
    assert " OK " in ask(device, "move abs 100")


@pytest.mark.parametrize(
    "command", ["abs 20000 16384 {}", "rel 20000 16384 {}", "vel 16384 {}", "max 16384 {}"]
)
def test_a_move_goes_with_the_velocity_and_the_acceleration_that_it_carries(command: str) -> None:
    axis = StageAxis(acceleration_m_s2=0.5, max_speed_m_s=0.026)
    device = EmulatedZaberStage(axis, homed=True)
    speed_m_s = 10_000 * MICROSTEP_M
    for t_s, accel in ((0.0, 16), (20.0, 33)):
        assert " OK BUSY " in ask(device, f"move {command.format(accel)}", t_s)
        ramp_s = speed_m_s / (accel / 1.6384e-4 * MICROSTEP_M)
        assert axis.velocity(t_s + 0.5 * ramp_s) == pytest.approx(0.5 * speed_m_s)
        assert axis.velocity(t_s + 1.1 * ramp_s) == pytest.approx(speed_m_s)
        ask(device, "stop", t_s + 2.0)
        ask(device, "home", t_s + 4.0)
    ask(device, "move max 16384", 40.0)
    assert axis.velocity(40.0 + 0.5 * speed_m_s / 0.5) == pytest.approx(0.5 * speed_m_s), "as before"


def test_every_setting_of_a_stage_can_be_read() -> None:
    device = stage()
    own = ("accel", "vel", "motion.busy", "system.uptime", "driver.enabled", "motion.decelonly")
    for name in (*CONSTANTS, *own):
        axis = 0 if name.startswith(("comm.", "system.", "version")) else 1
        head, _, value = ask(device, f"get {name}", axis=axis).strip().rpartition(" ")
        assert head == f"@01 {axis} 07 OK IDLE --"
        float(value)


def test_an_emergency_stop_stops_dead_and_an_echo_answers() -> None:
    device = stage()
    ask(device, "move max")
    assert ask(device, "estop", 1.0).startswith("@01 1 07 OK")
    assert ask(device, "get motion.busy", 1.0) == "@01 1 07 OK IDLE NI 0\r\n"
    assert ask(device, "tools echo hello there", 1.0) == "@01 1 07 OK IDLE NI hello there\r\n"

"""The lines that are sent to the stage, and their order, without a stage."""

import math
from collections.abc import Generator
from typing import Any

import pytest

from drivers.core.errors import CommandError
from drivers.core.messages import Excite, Home, MoveAt, MoveTo
from drivers.zaber_stage.codec import StageReply, acceleration_m_s2
from drivers.zaber_stage.mounting import Mounting, ZaberStageSettings
from drivers.zaber_stage.procedures import Procedures, RejectedError, StageWay
from tests.refusals import refused

SETTINGS = ZaberStageSettings(port="-")
STEP_M = SETTINGS.microstep_m


class Script:
    """Answers from a table of settings, and keeps the lines."""

    def __init__(self, **settings: int) -> None:
        self.held: dict[str, Any] = {
            "pos": 0,
            "accel": 800,
            "motion.decelonly": 200,
            "limit.min": 0,
            "limit.max": 51200,
            "maxspeed": 99,
        }
        self.held |= {"comm.checksum": 0, "version": "7.38"}
        self.held |= {name.replace("_", "."): value for name, value in settings.items()}
        self.flags = "00"
        self.rejects: dict[str, str] = {}
        self.obeys = True
        self.lines: list[str] = []

    def reply(self, line: str) -> StageReply:
        self.lines.append(line)
        data = "0"
        match line.split():
            case ["get", name]:
                data = str(self.held.get(name, name))
            case ["set", name, value]:
                self.held[name] = int(value) if self.obeys else self.held.get(name, 0)
            case ["warnings", *_]:
                data = self.flags
        reason = self.rejects.get(line)
        return StageReply(1, 1, 0, reason is None, False, "--", reason or data)

    def play(self, procedure: Generator[str, StageReply, object], lines: int = 1000) -> object:
        """Carry a procedure through, or through so many lines."""
        try:
            line = next(procedure)
            for _ in range(lines):
                line = procedure.send(self.reply(line))
        except StopIteration as end:
            return end.value
        return None


def opened(script: Script) -> Procedures:
    procedures = Procedures(SETTINGS, Mounting(SETTINGS))
    script.play(procedures.identify())
    script.lines.clear()
    return procedures


def identified(script: Script, **settings: float) -> Any:
    profile = SETTINGS.model_copy(update=settings)
    return script.play(Procedures(profile, Mounting(profile)).identify())


def test_what_is_held_already_is_not_written() -> None:
    script = Script(comm_checksum=1, maxspeed=82565)
    identified(script)
    assert not [line for line in script.lines if line.startswith("set")]


@pytest.mark.parametrize(
    ("counts", "seen_m"),
    [(533333, "0.2646 m"), (157480, "0.07812 m"), (20560, "0.0102 m"), (50600, "0.0251 m")],
    ids=["finer pitch", "coarser pitch", "lowered limit", "by little more than a hundredth"],
)
def test_a_stage_whose_limit_is_not_the_profiles_travel_is_refused_before_it_is_changed(
    counts: int, seen_m: str
) -> None:
    script = Script(limit_max=counts, comm_checksum=1)
    with pytest.raises(RejectedError, match=f"{counts} microsteps is {seen_m} .* travel_m = 0.0254") as error:
        identified(script)
    assert "device id deviceid" in error.value.advice
    assert "system restore" in error.value.advice
    assert not [line for line in script.lines if line.startswith("set")]


@pytest.mark.parametrize(
    ("device_id", "resolution", "model", "microstep_m"),
    [
        (50030, 64, "X-LSM-A", "4.7625e-08"),
        (50081, 64, "X-LHM-A", "1.240234375e-07"),  # 1 / 8,062,992 m: the maker's own test of its units
        (50138, 64, "X-LSQ-A", "9.921875e-08"),
        (50030, 32, "X-LSM-A", "9.525e-08"),
    ],
)
def test_of_a_known_model_a_pitch_is_refused_that_fits_its_limit_by_chance(
    device_id, resolution, model, microstep_m
):
    """Microstep and travel wrong by one factor agree with any limit: 51,200 microsteps are the profile's travel."""
    script = Script(deviceid=device_id, resolution=resolution, comm_checksum=1)
    with pytest.raises(
        RejectedError, match=f"id {device_id} is an {model}, .* are {microstep_m} m, not .* = 4.96"
    ) as e:
        identified(script)
    assert f"enter microstep_m = {microstep_m}," in e.value.advice
    assert not [line for line in script.lines if line.startswith("set")]


def test_a_known_model_may_count_more_than_its_nominal_travel() -> None:
    """An X-LSQ075B of 75 mm: its maker's limit lies 1.5 mm beyond, as that of an X-LSQ150B was seen to."""
    script = Script(deviceid=50103, resolution=64, limit_max=154204)
    assert identified(script, travel_m=0.075, travel_max_m=0.07)["pitch_by"] == "device id, X-LSQ-B"


def test_a_limit_that_this_profile_set_before_its_program_was_killed_is_known_again() -> None:
    assert identified(Script(limit_max=24995), travel_max_m=0.0124) is not None


def test_a_limit_is_never_set_farther_out_than_the_stage_has_it() -> None:
    with pytest.raises(RejectedError, match=r"0 and 0.0253018 m .* inside the profile's"):
        identified(Script(limit_max=51002))


@pytest.mark.parametrize(
    ("version", "reason"),
    [("6.28", "firmware 6.28 .* 7.25"), ("7.24", "firmware 7.24"), ("?", "'get version' with '?'")],
)
def test_a_firmware_without_a_speed_in_its_moves_is_refused_at_opening(version: str, reason: str) -> None:
    script = Script()
    script.held["version"] = version
    with pytest.raises(RejectedError, match=reason.replace("?", r"\?")):
        identified(script)


def test_a_stage_brakes_as_its_deceleration_says_and_one_without_is_refused() -> None:
    found = identified(Script(motion_decelonly=100))
    assert found["acceleration_m_s2"] == pytest.approx(acceleration_m_s2(100, STEP_M))
    with pytest.raises(RejectedError, match=r"motion\.decelonly is 0"):
        identified(Script(motion_decelonly=0))


def test_an_approach_is_sent_no_farther_than_its_limit_and_writes_no_setting() -> None:
    script = Script()
    target = opened(script).carry_out(MoveAt("stage", 0.00254, 10000 * STEP_M))
    assert script.play(target) == StageWay(target=10000, bound=4031, speed=8389, blind_travel_m=0.002)
    assert script.lines == ["warnings clear", "get pos", "move abs 4031 8389"]


def test_a_limit_that_the_device_does_not_hold_ends_the_opening() -> None:
    script = Script(comm_checksum=1)
    script.obeys = False
    with pytest.raises(RejectedError, match=r"sent limit.max = 24995 and holds 51200"):
        identified(script, travel_max_m=0.0124)


def test_what_was_changed_is_put_back_once_as_it_was_first_found() -> None:
    settings = SETTINGS.model_copy(update={"travel_max_m": 0.0124})
    script, procedures = Script(), Procedures(settings, Mounting(settings))
    before = dict(script.held)
    for _ in range(2):  # opened again after a link was lost
        script.play(procedures.identify())
    assert script.held != before
    script.play(procedures.put_back())
    assert script.held == before
    script.lines.clear()
    script.play(procedures.put_back())
    assert script.lines == []


def test_what_was_found_in_one_stage_is_not_put_into_another() -> None:
    procedures = Procedures(SETTINGS, Mounting(SETTINGS))
    Script(maxspeed=500000).play(procedures.identify())
    other = Script(system_serial=2, maxspeed=600000)
    other.play(procedures.identify())
    other.play(procedures.put_back())
    assert other.held["maxspeed"] == 600000


def test_a_stage_is_sent_on_from_where_it_is_and_no_farther_than_its_target() -> None:
    procedures = opened(Script())
    way = StageWay(target=-10000, bound=-4031, speed=8389, blind_travel_m=0.002)
    assert procedures.renewed(way, -1007) is None, "less than a quarter is used up"
    assert procedures.renewed(way, -1008) == way._replace(bound=-5039)
    last = procedures.renewed(way._replace(bound=-9900), -9000)
    assert last == way._replace(bound=-10000)
    assert procedures.renewed(last, -9500) is None
    assert procedures.towards(last) == "move abs -10000 8389"


def test_a_speed_that_the_blind_travel_does_not_bear_is_refused_with_what_it_needs() -> None:
    procedures = opened(Script(motion_decelonly=round(0.5 / acceleration_m_s2(1, STEP_M))))
    fast = MoveAt("stage", 0.025, 0.012, blind_travel_m=0.0018)
    with pytest.raises(RejectedError, match=r"needs 0.0019 m .* limits.blind_travel_m is 0.0018"):
        Script().play(procedures.carry_out(fast))
    # A way that is shorter needs none of it.
    Script().play(procedures.carry_out(MoveAt("stage", 0.025, 0.0018, blind_travel_m=0.0018)))


def test_a_move_before_homing_says_to_home_first() -> None:
    script = Script()
    procedures = opened(script)
    script.flags = "01 WR"
    with pytest.raises(RejectedError, match="send Home first"):
        script.play(procedures.carry_out(MoveTo("stage", 0.01, 0.01)))
    script.play(procedures.carry_out(Home("stage")))
    assert script.lines[-2:] == ["home", "warnings"]


@pytest.mark.parametrize(
    ("data", "meant"),
    [("DRIVERDISABLED", "its motor driver is off"), ("ODD", "it gives no reason")],
)
def test_a_rejection_names_the_line_and_what_the_reason_means(data: str, meant: str) -> None:
    script = Script()
    procedures = opened(script)
    script.rejects["home"] = data
    with pytest.raises(RejectedError, match=f"^it rejects 'home' with {data}: {meant}"):
        script.play(procedures.carry_out(Home("stage")))


def test_a_setting_that_is_no_number_is_reported() -> None:
    script = Script()
    procedures = opened(script)
    script.held["pos"] = "NA"
    with pytest.raises(RejectedError, match=r"^it answers 'get pos' with 'NA'$"):
        script.play(procedures.carry_out(MoveTo("stage", 0.01, 0.01)))


def test_a_stage_only_moves_at_its_limit_stays_and_beyond_it_does_not_turn_back() -> None:
    with refused(CommandError, "stage: a stage only moves", "another device"):
        SETTINGS.valid("stage", Excite("stage", True))
    for speed_m_s in (0.01, -0.01):
        here = MoveAt("stage", speed_m_s, 10000 * STEP_M)
        assert Mounting(SETTINGS).refusal(here, 10000, 0.5) == ""
        beyond = 10000 + round(math.copysign(1, speed_m_s))
        assert "beyond the limit already" in Mounting(SETTINGS).refusal(here, beyond, 0.5)


@pytest.mark.parametrize(("acceleration_m_s2", "refused"), [(0.5, True), (2.0, False)])
def test_a_stage_that_brakes_harder_needs_less_blind_travel(acceleration_m_s2: float, refused: bool) -> None:
    """v^2 / 2a and 50 ms at v: 1.9 mm at 0.5 m/s^2, 1.4 mm at 2."""
    fast = MoveAt("stage", 0.025, 0.012, blind_travel_m=0.0018)
    assert bool(Mounting(SETTINGS).refusal(fast, 0, acceleration_m_s2)) is refused

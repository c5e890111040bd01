"""The mock stage and the real driver on the emulated stage: the same refusals, limits, clamps and statuses.

Both run in virtual time. A real motion begins some exchanges later than a simulated one, a few turns.
"""

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from drivers.core.clock import VirtualClock
from drivers.core.messages import Command, Home, Listen, MoveAt, MoveTo, Reached, Refused, Sent, Status, Stop
from drivers.zaber_stage.codec import MICROSTEP_M
from drivers.zaber_stage.driver import ZaberStage
from drivers.zaber_stage.mounting import ZaberStageSettings
from simulator.devices.zaber_stage import EmulatedZaberStage
from simulator.mocks.base import MemoryLine
from simulator.mocks.zaber_stage import MockZaberStage, MockZaberStageSettings
from simulator.physics.stage_axis import STAGE_M_S, STAGE_M_S2, StageAxis
from tests.contracts.crank import Crank

LAG_M = 0.001
"""How far a stage goes at its fastest in the turns by which a real motion begins later."""


class StageBench(Crank):
    """A stage called `stage`, and where it really is."""

    def __init__(self, device: Any, axis: StageAxis) -> None:
        super().__init__(device)
        self.axis = axis

    @property
    def position_m(self) -> float:
        return self.axis.position(self.clock.now())

    @property
    def speed_m_s(self) -> float:
        return self.axis.velocity(self.clock.now())


def simulated(**limits: float) -> StageBench:
    bench = SimpleNamespace(mount=lambda axis: None, on_plan=lambda t_s: None)
    stage = MockZaberStage("stage", MockZaberStageSettings(**limits), VirtualClock(), bench)  # type: ignore[arg-type]
    return StageBench(stage, stage.axis)


def emulated(**limits: float) -> StageBench:
    clock = VirtualClock()
    axis = StageAxis(acceleration_m_s2=STAGE_M_S2, max_speed_m_s=STAGE_M_S)
    line = MemoryLine(EmulatedZaberStage(axis), clock)
    settings = ZaberStageSettings(port="-", **limits)  # type: ignore[arg-type]
    return StageBench(ZaberStage("stage", settings, clock, line.connect), axis)


MADE = {"simulated": simulated, "emulated": emulated}


@pytest.fixture(params=MADE)
def bench(request: pytest.FixtureRequest) -> StageBench:
    return MADE[request.param]()


@pytest.fixture
def homed(bench: StageBench) -> StageBench:
    assert isinstance(bench.answers(Home("stage"), 1.0)[-1], Reached)
    return bench


def test_the_simulated_stage_says_for_how_long_it_may_be_left_alone_until_it_has_arrived() -> None:
    bench = simulated()
    stage = bench.device
    assert isinstance(stage, MockZaberStage)
    assert stage.alone_s == math.inf
    bench.answers(Home("stage"), 1.0)
    bench.answers(MoveTo("stage", 0.005, 0.01), 0.1)
    ends_s = bench.clock.now() + stage.alone_s
    bench.turn(1.0)
    assert [status.t_s for status in bench.statuses if isinstance(status, Reached)] == [pytest.approx(ends_s)]
    assert stage.alone_s == math.inf


@pytest.mark.parametrize("command", [MoveTo("stage", 0.005, 0.01, id=3), MoveAt("stage", 0.01, 0.005, id=3)])
def test_no_motion_before_home(bench: StageBench, command: Command) -> None:
    statuses = bench.answers(command, 1.0)
    assert [type(status) for status in statuses] == [Refused]
    assert statuses[0].command_id == 3
    assert "it does not know where it is; send Home first" in statuses[0].reason
    assert bench.position_m == 0.0


def test_home_once_is_enough(homed: StageBench) -> None:
    homed.clock.restart()
    homed.axis.place(0.0, 0.0)
    getattr(homed.device, "restart", lambda: None)()
    statuses = homed.answers(MoveTo("stage", 0.001, 0.01, id=3), 1.0)
    assert [type(status) for status in statuses] == [Sent, Reached]


@pytest.mark.parametrize(
    ("command", "clamped"),
    [
        (MoveTo("stage", 0.02, 5.0), MoveTo("stage", 0.02, 0.025)),
        (MoveAt("stage", 5.0, 0.02), MoveAt("stage", 0.025, 0.02)),
    ],
)
def test_too_great_a_speed_is_clamped_and_that_is_reported(
    homed: StageBench, command: Command, clamped: Command
) -> None:
    (sent,) = homed.answers(command, 0.4)
    assert sent == Sent(sent.t_s, "stage", clamped)
    assert homed.speed_m_s == pytest.approx(0.025, rel=1e-3)


def test_an_approach_from_beyond_its_limit_is_refused(homed: StageBench) -> None:
    homed.answers(MoveTo("stage", 0.008, 0.02), 2.0)
    for command in (MoveAt("stage", 0.01, 0.007), MoveAt("stage", -0.01, 0.009)):
        (status,) = homed.answers(command, 0.5)
        assert isinstance(status, Refused)
        assert status.reason == "it is beyond the limit already, at 0.008000 m"
    assert homed.position_m == pytest.approx(0.008, abs=MICROSTEP_M)


def test_a_speed_that_the_blind_travel_does_not_bear_is_refused(homed: StageBench) -> None:
    (status,) = homed.answers(MoveAt("stage", 0.02, 0.01, blind_travel_m=0.001), 0.5)
    assert isinstance(status, Refused)
    assert "limits.blind_travel_m is 0.001" in status.reason
    assert homed.position_m == 0.0


@pytest.mark.parametrize("command", [MoveTo("stage", 0.012, 0.012), MoveAt("stage", 0.012, 0.012)])
def test_a_stage_that_is_looked_at_moves_as_evenly_as_in_one_piece(
    homed: StageBench, command: Command
) -> None:
    homed.answers(command, 0.2)
    while homed.position_m < 0.0115:
        assert homed.speed_m_s == pytest.approx(0.012, rel=1e-3)
        homed.turn(0.02)
    homed.turn(1.0)
    assert isinstance(homed.statuses[-1], Reached)


@pytest.mark.parametrize("blind_m", [0.0012, 0.002, 0.005])
@pytest.mark.parametrize("towards", [1, -1])
def test_an_unsupervised_stage_halts_within_its_blind_travel_and_goes_on_when_seen(
    homed: StageBench, blind_m: float, towards: int
) -> None:
    from_m, to_m = (0.0, 0.02) if towards > 0 else (0.02, 0.0)
    homed.answers(MoveTo("stage", from_m, 0.02), 3.0)
    homed.answers(MoveAt("stage", towards * 0.012, to_m, blind_travel_m=blind_m), 0.3)
    seen_m = homed.position_m
    homed.clock.wait_until(homed.clock.now() + 5.0)
    homed.device.read()
    halted_m = homed.position_m
    assert 0.5 * blind_m < towards * (halted_m - seen_m) <= blind_m + MICROSTEP_M
    homed.turn(3.0)
    assert [type(status) for status in homed.statuses] == [Sent, Reached]
    assert homed.position_m == pytest.approx(to_m, abs=MICROSTEP_M)


PLACES_M = (0.0, 0.004, 0.008, 0.012)

COMMANDS = st.one_of(
    st.just(Home("stage")),
    st.just(Stop("stage")),
    st.just(Listen("stage", frozenset({"stage.position"}))),
    st.builds(
        lambda to, v: MoveTo("stage", to, v), st.sampled_from(PLACES_M), st.sampled_from((0.005, 0.02, 1.0))
    ),
    st.builds(
        lambda v, to: MoveAt("stage", v, to),
        st.sampled_from((0.005, 0.02, -0.005, -0.02, 1.0)),
        st.sampled_from(PLACES_M),
    ),
)


def compared(statuses: list[Status]) -> list[tuple[Any, ...]]:
    """What is compared: kinds, numbers, commands as clamped, reasons without the place that they name."""
    return [
        (
            type(status),
            status.command_id,
            getattr(status, "command", None),
            getattr(status, "reason", "").partition(", at ")[0],
        )
        for status in statuses
    ]


@settings(max_examples=40, deadline=None, phases=(Phase.explicit, Phase.generate, Phase.shrink))
@given(st.lists(st.tuples(COMMANDS, st.sampled_from((0.1, 3.0))), max_size=5))
def test_both_answer_any_commands_the_same_way(steps: list[tuple[Command, float]]) -> None:
    one, other = simulated(), emulated()
    for number, (command, seconds) in enumerate([(Home("stage"), 1.0), *steps], start=1):
        statuses = [bench.answers(replace(command, id=number), seconds) for bench in (one, other)]
        assert compared(statuses[0]) == compared(statuses[1])
        assert one.position_m == pytest.approx(other.position_m, abs=LAG_M)
        ends = [[s.position_m for s in side if isinstance(s, Reached)] for side in statuses]
        assert ends[0] == pytest.approx(ends[1], abs=MICROSTEP_M)

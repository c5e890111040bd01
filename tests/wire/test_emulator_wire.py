"""The emulator's time: all of its devices live through the same, however long it was held up."""

import select
import socket
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import closing
from itertools import pairwise
from typing import Any

import pytest

from config.assemble import start_emulator
from config.profile import load_profile
from drivers.core.clock import WallClock
from drivers.core.messages import Failed, Listen
from drivers.core.settings import Settings
from drivers.sensor_board.driver import SensorBoard, SensorBoardSettings
from simulator.devices.faults import FaultSchedule
from simulator.wiring.bench_clock import AHEAD_S, BenchClock, ClockPage
from simulator.wiring.emulator import PASS_S, STEP_S, Emulator

HELD_UP_S = 0.2

DEADLINE_S = 100.0
"""Nothing hangs here; a busy machine only takes its time."""


class NoSettings(Settings):
    """A plant without any."""


class Holding(Settings):
    """Whether a device holds the emulator up."""

    holds_up: bool


class NoPlant:
    """Stands still."""

    def __init__(self, settings: NoSettings) -> None: ...

    def warm_up(self) -> None: ...

    def account(self) -> Mapping[str, Any]:
        return {}

    def scene(self, t_s: float) -> Mapping[str, float]:
        return {}


class Witness:
    """Notes what time it is; holds the emulator up once."""

    def __init__(self, settings: Holding, bench: NoPlant) -> None:
        self.endpoint = {"port": "nowhere"}
        self.times_s: list[float] = []
        self._holds_up = settings.holds_up
        self.breaks_at = 0
        self.unplugged = 0

    def open(self, faults: FaultSchedule, clock: WallClock) -> None: ...

    def waited(self) -> Sequence[Any]:
        return ()

    def due_s(self) -> float:
        return float("inf")

    def exchange(self, ready: Collection[Any], t_s: float, trial_s: float) -> None:
        self.times_s.append(t_s)
        if self._holds_up and len(self.times_s) == 5:
            time.sleep(HELD_UP_S)
        if len(self.times_s) == self.breaks_at:
            raise KeyError("a defect")

    def unread(self) -> bool:
        return False

    def unplug(self) -> None:
        self.unplugged += 1


def emulator(realtime: bool = False) -> tuple[Emulator, Callable[[], list[list[float]]]]:
    def part(name: str, settings_class: str, **settings: bool) -> dict[str, Any]:
        return {
            "made": f"{__name__}:{name}",
            "settings_class": f"{__name__}:{settings_class}",
            "settings": settings,
        }

    ends = {"first": True, "second": False}
    made = Emulator(
        {
            "plant": part("NoPlant", "NoSettings"),
            "devices": {name: part("Witness", "Holding", holds_up=up) for name, up in ends.items()},
            "realtime": realtime,
        }
    )
    return made, lambda: [end.times_s for end in made._ends.values()]  # type: ignore[attr-defined]


def test_time_stands_still_while_the_emulator_is_held_up() -> None:
    made, lives = emulator()
    made.serve(lambda: len(lives()[0]) >= 8)
    first, second = lives()
    assert first == second
    assert max(after - before for before, after in pairwise(first)) <= STEP_S + AHEAD_S + 1e-9


def test_in_real_time_what_was_missed_is_lived_through_in_small_steps_by_all_devices_together() -> None:
    made, lives = emulator(realtime=True)
    deadline_s = time.monotonic() + DEADLINE_S

    def caught_up() -> bool:
        first, _ = lives()
        return (len(first) > 5 and first[-1] - first[4] > HELD_UP_S) or time.monotonic() > deadline_s

    made.serve(caught_up)
    first, second = lives()
    assert first == second
    steps_s = [after - before for before, after in pairwise(first)]
    assert max(steps_s) <= PASS_S + 1e-9
    assert sum(steps_s[4:]) > HELD_UP_S, "nothing is left out"


def test_a_fault_of_a_device_that_is_not_there_is_refused_by_name() -> None:
    made, lives = emulator()
    where = made.endpoints["control"]
    with socket.create_connection((where["host"], where["port"]), timeout=DEADLINE_S) as client:
        client.sendall(b'{"fault": {"device": "stage", "kind": "stall", "at_s": 0}}\n')
        deadline_s = time.monotonic() + DEADLINE_S

        def answered() -> bool:
            return bool(select.select([client], [], [], 0.0)[0]) or time.monotonic() > deadline_s

        made.serve(answered)
        assert b"there is no stage here; there are first, second" in client.recv(4096)
    assert lives()[0], "and the bench went on"


def test_a_defect_costs_its_own_device_and_the_others_go_on(capsys: pytest.CaptureFixture[str]) -> None:
    made, lives = emulator()
    broken, _ = made._ends.values()
    broken.breaks_at = 3  # type: ignore[attr-defined]
    unplugged: list[int] = []

    def seen() -> bool:
        unplugged.append(broken.unplugged)  # type: ignore[attr-defined]
        return len(lives()[1]) >= 10

    made.serve(seen)
    assert len(lives()[0]) == 3
    assert unplugged[-1] == 1, "its host sees its link end at once"
    assert "KeyError: 'a defect'" in capsys.readouterr().err


def test_a_board_that_still_sends_goes_on_when_the_next_trial_begins() -> None:
    """As where its host was away: what it sends of the time before the trial is of that time."""
    profile = load_profile("emulated/first_contact")
    settings = profile.plant.settings.model_dump(mode="json")
    with closing(start_emulator(profile)) as emulator:
        clock = BenchClock(ClockPage(emulator.endpoints["clock"]))
        ends = SensorBoardSettings(**emulator.endpoints["devices"]["board"], watchdog_s=5.0)
        board = SensorBoard("board", ends, clock)
        with closing(board):
            board.open()
            board.apply(Listen("board", frozenset({"board.load_cell"})))
            for trial in range(1, 6):
                emulator.begin_trial(trial, 1, {}, settings)
                due_s = clock.monotonic_s() + 0.1
                while clock.monotonic_s() < due_s:
                    clock.rest(0.005)
                    assert [one for one in board.poll() if isinstance(one, Failed)] == [], trial
                assert sum(map(len, board.read())) > 50

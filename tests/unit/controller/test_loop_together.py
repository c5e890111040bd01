"""Turns that the loop takes together: a bench goes the same way as turn by turn, in few looks."""

import math
from types import SimpleNamespace
from typing import ClassVar

import numpy as np
import pytest

from behaviors.events import Contact
from behaviors.machine import Behavior, StatePlan, on
from controller.guard import Guard, GuardSettings
from controller.loop import Aborted, Loop, LoopSettings, UnfitStreamError
from controller.rig import Rig
from drivers.core.clock import VirtualClock
from drivers.core.messages import (
    DeviceInfo,
    Lost,
    MoveTo,
    Reached,
    SampleBlock,
    Saturated,
    Stalled,
    Standstill,
    Stop,
    StreamInfo,
)
from simulator.look_ahead import LONGEST_S, LookAhead

RATE_HZ = 200.0
STREAMS = {
    name: StreamInfo(name, ("force",), "N", rate_hz=1000.0, longest_s=0.05)
    for name in ("board.force", "board.load")
}
CONTACT = 800.0


class Device:
    """Reports what is due; what is asked of it is kept where time is not taken back."""

    def __init__(self, name, clock):
        self.name, self.clock, self.reports = name, clock, []
        self.held = ()

    def apply(self, command):
        pass

    def read(self):
        return ()

    def poll(self):
        ripe = [status for status in self.reports if status.t_s <= self.clock.now()]
        self.reports = [status for status in self.reports if status not in ripe]
        return ripe


class Stage(Device):
    """Moves until it has arrived; stalls where it is not polled for `blind_s` and that is not announced."""

    blind_s, watched_until_s, seen_s = 0.02, -math.inf, 0.0

    def apply(self, command):
        kind, after_s = (Reached, 1.0) if isinstance(command, MoveTo) else (Standstill, 0.02)
        self.reports = [kind(self.clock.now() + after_s, "stage", 0.0, command_id=command.id)]

    def poll(self):
        now_s, moves = self.clock.now(), bool(self.reports)
        meant = now_s <= self.watched_until_s + 1e-9 <= now_s + 2e-9
        blind = moves and now_s - self.seen_s > self.blind_s + 1e-9 and not meant
        self.seen_s = now_s
        return [Stalled(now_s, "stage", "left alone"), *super().poll()] if blind else super().poll()


class PredictingStage(Stage):
    """One that reports when it will have arrived."""

    @property
    def alone_s(self):
        return min((status.t_s for status in self.reports), default=math.inf) - self.clock.now()


class Board(Device):
    """1 kHz on each stream that is subscribed to: the number of the sample as force, `load_n` over time as load."""

    looks: ClassVar[list] = []  # of the class: not put back

    def __init__(self, name, clock):
        super().__init__(name, clock)
        self.listening, self.sent, self.ends_s, self.breaks_s = frozenset(), 0, math.inf, math.inf
        self.load_n = None

    def apply(self, command):
        self.listening = command.streams

    def read(self):
        now_s = self.clock.now()
        self.looks.append(round(now_s, 6))
        if now_s >= self.breaks_s:
            raise OSError("the board is broken")
        begin, self.sent = self.sent, round(min(now_s, self.ends_s) * 1000)
        times_s = np.arange(begin, self.sent) / 1000
        load = np.zeros(len(times_s)) if self.load_n is None else np.interp(times_s, *self.load_n)
        made = {"board.force": np.arange(begin, self.sent) * 1.0, "board.load": load}
        return [
            SampleBlock(name, begin, begin / 1000, made[name].reshape(-1, 1), 1000.0, unit="N")
            for name in sorted(self.listening)
            if len(times_s)
        ]


class LevelDetector:
    """Reports contact at the first sample above a level, and what it held against it."""

    name, inputs, readings = "contact", ("board.force",), None

    def __init__(self):
        self.above = CONTACT

    def reset(self):
        self.readings = None

    def push(self, block):
        self.readings = np.column_stack([block.times, block.values[:, 0], np.full(len(block), self.above)])
        found = np.flatnonzero(block.values[:, 0] >= self.above)
        return [Contact(block.times[index], self.name, 1.0, 0.5) for index in found[:1]]


class Sum:
    """A signal: all the force so far, which is beyond its range from a time on."""

    name, inputs, info = "sum", ("board.force",), StreamInfo("signals.sum", ("force",), "N")

    def __init__(self):
        self.total, self.beyond_s, self.breaks_s = 0.0, math.inf, math.inf

    def reset(self):
        self.total = 0.0

    def push(self, block):
        if block.last_s >= self.breaks_s:
            raise ValueError("it cannot use this")
        sums = self.total + np.cumsum(block.values, axis=0)
        self.total = float(sums[-1, 0])
        late = block.times[block.times >= self.beyond_s - 1e-9]
        beyond = [Saturated(late[0], "board", self.info.name, 9.0)] if len(late) else []
        return [SampleBlock(self.info.name, block.seq, block.t0_s, sums, 1000.0, unit="N"), *beyond]


class Approach(Behavior):
    """Rests, approaches until contact, stops."""

    table = (
        on("deadline", "REST", "APPROACH"),
        on("contact", "APPROACH", "STOPPING"),
        on("reached", "APPROACH", "STOPPING"),
        on("standstill", "STOPPING", "DONE"),
        on("resumed", "APPROACH", "REST"),
    )

    def __init__(self, rest_s=0.4, *, prompt=True):
        plans = {
            "REST": StatePlan(rest_s, measures=frozenset({"board.force", "signals.sum"}), prompt=prompt),
            "APPROACH": StatePlan(5.0, detectors=frozenset({"contact"}), measures=frozenset({"signals.sum"})),
            "STOPPING": StatePlan(1.0),
        }
        super().__init__(plans, "stage")

    def enter_APPROACH(self):
        self.command(MoveTo("stage", 0.005, 0.01))

    def enter_STOPPING(self):
        self.command(Stop("stage"))

    def enter_DONE(self):
        self.conclude("contact")


class Bench:
    """A stage and a board, the recorder and the operator."""

    failure = None

    def __init__(self):
        self.clock = VirtualClock()
        self.stage, self.board = PredictingStage("stage", self.clock), Board("board", self.clock)
        self.behavior, self.detector, self.sum = Approach(), LevelDetector(), Sum()
        self.rate = LoopSettings(rate_hz=RATE_HZ, idle_rate_hz=50.0)
        self.requests, self.shown, self.kept, self.skipped = [], [], [], []
        self.read, self.decided = [], []
        self.recorded = {}
        Board.looks = []

    def record(self, blocks):
        for block in blocks:
            self.recorded.setdefault(block.stream, []).extend(block.values[:, 0].tolist())

    def readings(self, detector, readings, decided_s):
        self.read += [(detector, *reading) for reading in readings.tolist()]
        self.decided += decided_s

    def skip(self, stream, t0_s, t1_s):
        self.skipped.append((stream, t0_s, t1_s))

    def event(self, event, *, state, next_state, commands):
        self.kept.append((event, state, next_state, commands))

    def poll(self):
        for at_s, request in self.requests[:1]:
            if self.clock.now() >= at_s - 1e-9:
                del self.requests[0]
                return request
        return None

    def suspend(self):
        raise AssertionError("there was no request for that")

    def state(self, name, t_s):
        self.shown.append((name, t_s))

    def run(self, *, together=True):
        devices = {"stage": self.stage, "board": self.board, "lamp": Device("lamp", self.clock)}
        ahead = LookAhead(self.clock, SimpleNamespace(age=1), list(devices.values())) if together else None
        rig = Rig("mock", devices, self.clock, ahead=ahead)
        infos = {
            "stage": DeviceInfo("stage", "a mover", mover=True),
            "board": DeviceInfo("board", "a sensor", streams=STREAMS),
            "lamp": DeviceInfo("lamp", "a lamp"),
        }
        limits = GuardSettings(travel_m=0.01, position_stream=None, force_stream="board.load", force_n=50.0)
        self.loop = Loop(rig, infos, Guard(limits), self, self, self.rate)
        try:
            self.loop.run(self.behavior, {"contact": self.detector}, [self.sum])
        except (OSError, UnfitStreamError, Aborted) as error:
            self.kept.append(repr(error))
        return self


def arrives(bench):
    bench.detector.above = math.inf


def arrives_unpredicted(bench):
    bench.stage, bench.detector.above = Stage("stage", bench.clock), math.inf


def breaks(bench):
    bench.board.breaks_s = 0.551


def breaks_at_rest(bench):
    bench.board.breaks_s = 0.2


def falls_silent(bench):
    bench.board.ends_s = 0.5


def falls_silent_at_rest(bench):
    bench.behavior, bench.board.ends_s = Approach(1.0), 0.1


def presses(bench):
    bench.board.load_n = ((0.6, 0.601), (0.0, 60.0))


def loses_samples(bench):
    bench.board.reports = [Lost(0.503, "board", "board.force", 3)]


def loses_samples_twice(bench):
    bench.board.reports = [Lost(at_s, "board", "board.force", 3) for at_s in (0.563, 0.503)]


def leaves_its_range(bench):
    bench.sum.beyond_s = 0.477


def cannot_be_used(bench):
    bench.sum.breaks_s = 0.3


def bears_less_and_less(bench):
    bench.board.load_n = ((0.0, 0.1, 0.5), (60.0, 60.0, 20.0))
    bench.behavior = Approach(0.7)


def bears_more(bench):
    bench.board.load_n = ((0.0, 0.1, 0.2, 0.3), (60.0, 60.0, 80.0, 20.0))


def rests_long(bench):
    bench.behavior, bench.detector.above = Approach(5.0), 5300.0


def idles(bench):
    bench.behavior, bench.detector.above = Approach(1.0, prompt=False), 1300.0
    bench.stage.blind_s = 1.0


def must_be_looked_at(bench):
    bench.stage.blind_s = 1 / RATE_HZ


def cannot_be_copied(bench):
    bench.board.held = (n for n in ())


@pytest.mark.parametrize(
    ("case", "looks"),
    [
        (arrives, 16),
        (arrives_unpredicted, 18),
        (breaks, 28),
        (breaks_at_rest, 21),
        (falls_silent, 27),
        (falls_silent_at_rest, 68),
        (presses, 18),
        (loses_samples, 23),
        (loses_samples_twice, 28),
        (leaves_its_range, 12),
        (cannot_be_used, 19),
        (bears_less_and_less, 18),
        (bears_more, 15),
        (rests_long, 19),
        (idles, 18),
        (must_be_looked_at, 170),
        (cannot_be_copied, 170),
    ],
    ids=lambda case: getattr(case, "__name__", None),
)
def test_a_bench_goes_the_same_way_as_turn_by_turn_in_so_many_looks(case, looks):
    apart, together = Bench(), Bench()
    for bench, at_once in ((apart, False), (together, True)):
        Board.looks = []
        case(bench)
        bench.run(together=at_once)
    for what in ("kept", "shown", "skipped", "recorded", "read", "decided"):
        assert getattr(together, what) == getattr(apart, what), what
    assert together.loop.account == apart.loop.account
    assert len(Board.looks) == looks, "what was tried and taken back included"


def test_looks_grow_while_nothing_happens_and_end_before_what_did():
    Bench().run()
    rest, approach = [0.005, 0.395, 0.4], [0.405, 0.445, 0.765, 1.395, 0.795, 0.8]
    stops = [0.84, 0.805, 0.81, 0.82, 0.825, 0.83, 0.835, 0.84, 0.845, 0.85]
    assert Board.looks == rest + approach + stops


def test_no_look_is_longer_than_benches_remember_however_quiet_it_is():
    bench = Bench()
    bench.behavior = Approach(9.0)
    bench.run()
    assert max(np.diff(Board.looks)) == pytest.approx(LONGEST_S, abs=1.0 / RATE_HZ)


def test_the_operator_is_polled_after_each_look_and_a_pause_is_gone_through_turn_by_turn():
    bench = Bench()
    bench.requests = [(0.5, "pause"), (0.77, "resume")]
    bench.run()
    assert bench.shown[2:5] == [("PAUSED", 0.765), ("APPROACH", 0.785), ("REST", 0.785)]
    paused = [t_s for t_s in Board.looks if 0.765 <= t_s <= 0.795]
    assert paused == [0.765, 0.77, 0.775, 0.78, 0.785, 0.79]

"""Turns that the loop takes together: a bench goes the same way as turn by turn, in few looks."""

import math
from collections.abc import Sequence
from copy import copy
from dataclasses import replace
from types import SimpleNamespace
from typing import ClassVar

import numpy as np
import pytest

from behaviors.events import Contact
from behaviors.machine import Behavior, Row, StatePlan, on
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
    Sent,
    Stalled,
    Standstill,
    Stop,
    StreamInfo,
)
from simulator.look_ahead import LONGEST_S, LookAhead

RATE_HZ = 200.0
NAMES = ("board.force", "board.load")
STREAMS = {name: StreamInfo(name, ("force",), "N", rate_hz=1000.0, longest_s=0.05) for name in NAMES}
CONTACT = 800.0


class Device:
    """Reports what is due, some of it late; what is asked of it is kept where time is not taken back."""

    late_s = 0.0

    def __init__(self, name, clock):
        self.name, self.clock, self.reports = name, clock, []
        self.held = ()

    def apply(self, command):
        pass

    def read(self):
        return ()

    def poll(self):
        ripe = [status for status in self.reports if status.t_s + self.late_s <= self.clock.now()]
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
        made = {name: values.reshape(-1, 1) for name, values in made.items() if len(times_s)}
        heard = [name for name in sorted(self.listening) if name in made]
        return [SampleBlock(name, begin, begin / 1000, made[name], 1000.0, unit="N") for name in heard]


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

    table: ClassVar[Sequence[Row]] = (
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
        self.lamp = Device("lamp", self.clock)
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
        self.kept.append((event, state, next_state, list(commands)))

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

    def run(self, *, together=True, **detectors):
        devices = {"stage": self.stage, "board": self.board, "lamp": self.lamp}
        ahead = LookAhead(self.clock, SimpleNamespace(age=1), list(devices.values())) if together else None
        rig = Rig("mock", devices, self.clock, ahead=ahead and ahead.skip)
        infos = {
            "stage": DeviceInfo("stage", "a mover", mover=True),
            "board": DeviceInfo("board", "a sensor", streams=STREAMS),
            "lamp": DeviceInfo("lamp", "a lamp"),
        }
        limits = GuardSettings(travel_m=0.01, position_stream=None, force_stream="board.load", force_n=50.0)
        self.loop = Loop(rig, infos, Guard(limits), self, self, self.rate)
        try:
            self.loop.run(self.behavior, {"contact": self.detector, **detectors}, [self.sum])
        except (OSError, UnfitStreamError, Aborted) as error:
            self.kept.append(repr(error))
        return self


def unpredicted(bench):
    bench.stage, bench.detector.above = Stage("stage", bench.clock), math.inf


def rests(rest_s, **named):
    return lambda bench: setattr(bench, "behavior", Approach(rest_s, **named))


def put(**changes):
    """Of a part of the bench: `board={"ends_s": 0.5}`."""

    def case(bench):
        for part, values in changes.items():
            for name, value in values.items():
                setattr(getattr(bench, part), name, copy(value))

    return case


def presses(*points):
    """A load through these points: (s, N)."""
    return put(board={"load_n": tuple(zip(*points, strict=True))})


LESS = ((0.0, 60.0), (0.1, 60.0), (0.5, 20.0))
MORE = ((0.0, 60.0), (0.1, 60.0), (0.2, 80.0), (0.3, 20.0))
BLIND = {"blind_s": 1.0}


def lost(*times_s):
    return put(board={"reports": [Lost(at_s, "board", "board.force", 3) for at_s in times_s]})


def sent(device, late_s=0.0):
    return put(**{device: {"reports": [Sent(0.503, device, Stop("lamp"))], "late_s": late_s}})


@pytest.mark.parametrize(
    ("cases", "looks"),
    [
        pytest.param([put(detector={"above": math.inf})], 12, id="arrives"),
        pytest.param([unpredicted], 14, id="arrives unpredicted"),
        pytest.param([put(board={"breaks_s": 0.551})], 33, id="breaks"),
        pytest.param([put(board={"breaks_s": 0.2})], 12, id="breaks at rest"),
        pytest.param([put(board={"ends_s": 0.5})], 24, id="falls silent"),
        pytest.param([rests(1.0), put(board={"ends_s": 0.1})], 67, id="falls silent at rest"),
        pytest.param([presses((0.6, 0.0), (0.601, 60.0))], 31, id="presses"),
        pytest.param([lost(0.503)], 18, id="loses samples"),
        pytest.param([lost(0.563, 0.503)], 21, id="loses samples twice"),
        pytest.param([sent("board", 0.02), sent("lamp")], 18, id="hears two devices, the first of them late"),
        pytest.param([put(sum={"beyond_s": 0.477})], 9, id="leaves its range"),
        pytest.param([put(sum={"breaks_s": 0.3})], 18, id="cannot be used"),
        pytest.param([rests(0.7), presses(*LESS)], 14, id="is in contact from the start, less and less"),
        pytest.param([presses(*MORE)], 15, id="is in contact from the start, and more"),
        pytest.param([rests(5.0), put(detector={"above": 5300.0})], 16, id="rests long"),
        pytest.param([rests(1.0, prompt=False), put(detector={"above": 1300.0}, stage=BLIND)], 15, id="idle"),
        pytest.param([put(stage={"blind_s": 1 / RATE_HZ})], 170, id="must be looked at"),
        pytest.param([lambda bench: setattr(bench.board, "held", (n for n in ()))], 170, id="not copied"),
    ],
)
def test_a_bench_goes_the_same_way_as_turn_by_turn_in_so_many_looks(cases, looks):
    apart, together = Bench(), Bench()
    for bench, at_once in ((apart, False), (together, True)):
        Board.looks = []
        for case in cases:
            case(bench)
        bench.run(together=at_once)
    for what in ("kept", "shown", "skipped", "recorded", "read", "decided"):
        assert getattr(together, what) == getattr(apart, what), what
    assert together.loop.account == apart.loop.account
    assert len(Board.looks) == looks, "what was tried and taken back included"


class Beats(LevelDetector):
    """Reports a contact every 60 ms, each so long after it."""

    def __init__(self, name, first_s, late_s=0.0):
        self.name, self.times_s = name, first_s + 0.06 * np.arange(100)
        self.late_s = late_s

    def push(self, block):
        told_s = self.times_s + self.late_s
        come = (told_s > block.t0_s - 5e-4) & (told_s < block.last_s + 5e-4)
        return [Contact(t_s, self.name, 1.0, 0.5) for t_s in self.times_s[come].tolist()]


class Patient(Approach):
    """Stops at the fifth contact, counting in a condition."""

    seen = 0

    def fifth(self):
        self.seen += 1
        return self.seen == 5

    table = (*Approach.table[:1], on("contact", "APPROACH", "STOPPING", fifth), *Approach.table[2:])

    def __init__(self, names):
        super().__init__()
        self.plans["APPROACH"] = replace(self.plans["APPROACH"], detectors=frozenset(names))


class Silent(Patient):
    """Commands nothing then."""

    def enter_STOPPING(self):
        pass


TWO = [("contact", 0.42), ("other", 0.41, 0.02)]


@pytest.mark.parametrize(
    ("kind", "beats", "looks"), [(Patient, TWO[:1], 15), (Silent, TWO[:1], 25), (Patient, TWO, 35)]
)
def test_events_that_nothing_follows_from_are_passed_over_in_the_order_in_which_turns_see_them(
    kind, beats, looks
):
    went = []
    for together in (False, True):
        bench, detectors = Bench(), {args[0]: Beats(*args) for args in beats}
        bench.behavior = patient = kind(detectors)
        bench.run(together=together, **detectors)
        went.append((bench.kept, bench.shown, bench.recorded, bench.loop.account, patient.seen))
    assert went[0] == went[1] and went[0][4] == 5
    assert len(Board.looks) <= looks


def test_looks_grow_while_nothing_happens_and_end_before_what_did():
    Bench().run()
    rest, approach = [0.395, 0.4], [0.56, 1.395, 0.795, 0.8]
    stops = [0.96, 0.805, 0.82, 0.825, 0.83, 0.835, 0.84, 0.845, 0.85]
    assert Board.looks == rest + approach + stops


def test_no_look_is_longer_than_benches_remember_however_quiet_it_is():
    bench = Bench()
    bench.behavior = Approach(9.0)
    bench.run()
    assert max(np.diff(Board.looks)) == pytest.approx(LONGEST_S, abs=1.0 / RATE_HZ)


def test_the_operator_is_polled_after_each_look_and_a_pause_is_gone_through_turn_by_turn():
    bench = Bench()
    bench.requests = [(0.5, "pause"), (0.57, "resume")]
    bench.run()
    assert bench.shown[2:5] == [("PAUSED", 0.56), ("APPROACH", 0.585), ("REST", 0.585)]
    paused = [t_s for t_s in Board.looks if 0.56 <= t_s <= 0.585]
    assert paused == [0.56, 0.565, 0.57, 0.575, 0.58, 0.585]

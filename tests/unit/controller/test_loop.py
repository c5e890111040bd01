"""The loop on small devices in virtual time: what it does in a turn, in which order, and how it ends."""

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Any, ClassVar

import numpy as np
import pytest

from behaviors.events import BaselineRefused, Contact, GuardStopped, Paused, Resumed, Retreated, Tick
from behaviors.machine import Behavior, Row, StatePlan, on
from controller import loop as loop_module
from controller.guard import Guard, GuardRefusal, GuardSettings
from controller.loop import Aborted, Loop, LoopSettings, UnfitStreamError
from controller.rig import Rig
from drivers.core.clock import VirtualClock
from drivers.core.errors import DeviceError
from drivers.core.messages import (
    DeviceInfo,
    Excite,
    Failed,
    Listen,
    Lost,
    MoveAt,
    MoveTo,
    Reached,
    Refused,
    SampleBlock,
    Saturated,
    Sent,
    Stalled,
    Standstill,
    Stop,
    StreamInfo,
    Tare,
)
from tests.refusals import refused

RATE_HZ = 200.0
TURN_S = 1.0 / RATE_HZ


class Device:
    """Logs the commands it gets, in the bench's one log; reports what the test wants reported."""

    def __init__(self, name, bench):
        self.name, self.bench = name, bench
        self.listening = frozenset()
        self.statuses = []
        self.reading = self.polling = None  # an error instead of an answer

    def apply(self, command):
        self.bench.log.append((self.bench.clock.now(), command))
        if isinstance(command, Listen):
            self.listening = command.streams

    def report(self, kind, *details, at_s=0.0, **named):
        self.statuses.append(kind(at_s, self.name, *details, **named))

    def read(self):
        if self.reading is not None:
            raise self.reading
        return ()

    def poll(self):
        if self.polling is not None:
            raise self.polling
        now_s = self.bench.clock.now()
        ripe = [status for status in self.statuses if status.t_s <= now_s]
        self.statuses = [status for status in self.statuses if status.t_s > now_s]
        return ripe


class Mover(Device):
    """Reaches what it is sent to after `travel_s`, at a speed `back_s`, stands `brake_s` after a stop; None: never."""

    def __init__(self, name, bench, travel_s=0.1, brake_s=0.02):
        super().__init__(name, bench)
        self.travel_s, self.brake_s = travel_s, brake_s
        self.back_s = self.broken = None

    def apply(self, command):
        if self.broken is not None and isinstance(command, Stop):
            raise self.broken
        super().apply(command)
        delays = {Stop: self.brake_s, MoveTo: self.travel_s, MoveAt: self.back_s}
        kind, delay_s = Standstill if isinstance(command, Stop) else Reached, delays.get(type(command))
        if delay_s is not None:
            self.report(kind, 0.0, at_s=self.bench.clock.now() + delay_s, command_id=command.id)


class Sensor(Device):
    """Sends one sample at 1 kHz for each millisecond since it was last read, on each stream that is listened to."""

    def __init__(self, name, bench):
        super().__init__(name, bench)
        self._sent, self.mute = 0, ""

    def read(self):
        super().read()
        end = round(self.bench.clock.now() * 1000)
        seq, self._sent = self._sent, end
        numbers = np.arange(seq, end, dtype=np.float64).reshape(-1, 1)
        values = np.minimum(numbers, 2.0 * self.bench.top - numbers) * self.bench.slope
        names = sorted(self.listening - {self.mute}) if end > seq else []
        return [SampleBlock(name, seq, seq / 1000, values, 1000.0, unit="N") for name in names]


class LevelDetector:
    """A detector that reports contact once it has received a sample above a level."""

    name = "contact"

    def __init__(self, stream="board.force", above=1e9):
        self.inputs = (stream,)
        self.above, self.resets, self.received, self.error = above, [], [], None

    def reset(self):
        self.resets.append(len(self.received))

    def push(self, block):
        if self.error is not None:
            raise self.error
        self.received.append(block)
        found = np.flatnonzero(block.values[:, 0] > self.above)
        return [Contact(block.times[index], self.name, 1.0, 0.5) for index in found[:1]]


class Doubled:
    """A signal: twice the force."""

    name, inputs = "double", ("board.force",)
    info = StreamInfo("signals.double", ("force",), "N")

    def __init__(self):
        self.error, self.beyond = None, False

    def push(self, block):
        if self.error is not None:
            raise self.error
        made = SampleBlock(self.info.name, block.seq, block.t0_s, 2.0 * block.values, 1000.0, unit="N")
        return [made, *([Saturated(block.t0_s, "board", self.info.name, 9.0)] if self.beyond else [])]

    def reset(self):
        pass


class Approach(Behavior):
    """Rests, approaches until contact, stops, is done."""

    table: ClassVar[Sequence[Row]] = (
        on("deadline", "REST", "APPROACH"),
        on("contact", "APPROACH", "STOPPING"),
        on("reached", "APPROACH", "DONE"),
        on("standstill", "STOPPING", "DONE"),
        on("resumed", "APPROACH", "REST"),
    )

    def __init__(self, rest_s=0.1, listening=frozenset({"contact"}), resting=frozenset(), **named):
        plans = {
            "REST": StatePlan(rest_s, measures=resting, **named),
            "APPROACH": StatePlan(1.0, detectors=listening),
            "STOPPING": StatePlan(1.0),
        }
        super().__init__(plans, "stage")

    def enter_APPROACH(self):
        self.command(MoveTo("stage", 0.005, 0.01))

    def enter_STOPPING(self):
        self.command(Excite("board", False))
        self.command(Stop("stage"))

    def enter_DONE(self):
        self.conclude("contact")


FAILING = ("guard_stopped", "failed", "stalled")
ENDS = [(GuardStopped, "guard"), (Failed, "fault"), (Stalled, "fault")]


class Deaf(Approach):
    """Ignores what ends a trial."""

    def handle(self, event):
        return () if isinstance(event, GuardStopped | Failed | Stalled) else super().handle(event)


class Stubborn(Approach):
    """Presses on, whatever happens."""

    table = (
        *Approach.table,
        *(on(name, ["APPROACH", "STOPPING"], "APPROACH") for name in (*FAILING, "standstill")),
    )


class Cautious(Approach):
    """Goes back where the trial cannot go on, and calls that a contact."""

    table = (
        *Approach.table,
        *(on(name, "APPROACH", "LEAVING") for name in FAILING),
        on("reached", "LEAVING", "DONE"),
    )

    def __init__(self):
        plans = {"REST": StatePlan(0.1), "STOPPING": StatePlan(1.0), "LEAVING": StatePlan(60.0)}
        listening = StatePlan(1.0, detectors=frozenset({"contact"}))
        Behavior.__init__(self, plans | {"APPROACH": listening}, "stage")

    def enter_LEAVING(self):
        self.command(MoveTo("stage", 0.0, 0.01))


class Restless(Cautious):
    """Begins its way back anew where something fails on it."""

    table = (*Cautious.table, on("failed", "LEAVING", "LEAVING"))


class ScriptedGuard(Guard):
    """Stops with the test's reason at the first turn not before a time, and keeps what it was shown."""

    def __init__(self, **limits):
        watched = {"position_stream": None, "force_stream": "board.load", "force_n": 50.0}
        super().__init__(GuardSettings(travel_m=0.01, **watched, **limits))
        self.stop_s, self.seen, self.lates, self.real = None, [], [], False
        self.arrivals.check = self._noting(self.arrivals.check)  # type: ignore[method-assign]

    def _noting(self, check):
        def noted(t_s, blocks, moving, late_s=0.0):
            self.lates.append(late_s)
            return check(t_s, blocks, moving, late_s)

        return noted

    def check(self, t_s, blocks, moving, late_s=0.0, saturated=()):
        blocks = list(blocks)
        self.seen.append((t_s, {block.stream for block in blocks}, moving, late_s, list(saturated)))
        if self.real:
            return super().check(t_s, blocks, moving, late_s, saturated)
        if self.stop_s is not None and t_s >= self.stop_s:
            self.stop_s = None
            return "the test stops it"
        return None


class Bench:
    """A stage, a second mover and a board; the recorder and the operator at their sides."""

    def __init__(self, behavior=None, **limits):
        self.clock, self.log = VirtualClock(), []
        self.slope, self.top = 0.001, math.inf
        self.stage, self.other, self.board = Mover("stage", self), Mover("other", self), Sensor("board", self)
        self.behavior = behavior or Approach()
        self.detector, self.guard = LevelDetector(), ScriptedGuard(**limits)
        self.signals = ()
        self.requests, self.third, self.shown, self.suspended = [], "", [], []
        self.recorded, self.kept, self.skipped, self.read, self.entered = [], [], [], [], []
        self.failure = None
        self.settings = LoopSettings(rate_hz=RATE_HZ, idle_rate_hz=50.0)

    # what the loop sees of the recorder and the operator

    def record(self, blocks):
        self.recorded += blocks

    def readings(self, detector, readings, decided_s):
        self.read.append((detector, readings.tolist(), decided_s))

    def skip(self, stream, t0_s, t1_s):
        if t1_s > t0_s:
            self.skipped.append((stream, t0_s, t1_s))

    def event(self, event, *, state, next_state, commands):
        self.kept.append((type(event).__name__, state, next_state, list(commands)))

    def poll(self):
        for request, at_s in self.requests:
            if self.clock.now() >= at_s:
                self.requests.remove((request, at_s))
                return request
        return None

    def suspend(self):
        self.suspended.append((round(self.clock.now(), 6), sorted(self.loop._trial.moving)))
        self.clock.wait_until(self.clock.now() + 60.0)

    def state(self, name, t_s):
        self.shown.append((name, round(t_s, 6)))

    def run(self):
        devices = {"stage": self.stage, "other": self.other, "board": self.board}
        names, about = ("board.force", "board.load"), {"rate_hz": 1000.0, "longest_s": 0.05}
        streams = {name: StreamInfo(name, ("force",), "N", **about) for name in names}
        infos = {
            "stage": DeviceInfo("stage", "a mover", mover=True),
            "other": DeviceInfo("other", "a mover", mover=True),
            "board": DeviceInfo("board", "a sensor", streams=streams),
        }
        rig = Rig("mock", devices, self.clock, entered=lambda *visit: self.entered.append(visit))
        self.loop = Loop(rig, infos, self.guard, self, self, self.settings)
        self.loop.run(self.behavior, {"contact": self.detector}, self.signals)
        return self.loop

    def sent(self, *kinds, since_s=0.0):
        found = [(t_s, command) for t_s, command in self.log if isinstance(command, kinds)]
        return [(round(t_s, 6), command) for t_s, command in found if t_s >= since_s]

    @property
    def stops(self):
        return self.sent(Stop)

    def turns(self, since_s=0.0, until_s=math.inf):
        return np.array([t_s for t_s, *_ in self.guard.seen if since_s <= t_s < until_s])

    def when(self, device, kind, deed):
        """Does something as soon as a device gets a command of a kind."""
        apply = device.apply

        def applied(command):
            if isinstance(command, kind):
                deed()
            apply(command)

        device.apply = applied

    def on_the_wall_clock(self):
        self.clock = Late(math.inf, 0.0, virtual=False)


@pytest.fixture
def bench():
    return Bench()


# --- the end --------------------------------------------------------------------------------------


def test_an_undisturbed_trial_runs_to_its_end_and_every_mover_is_stopped_then(bench):
    bench.run()
    assert bench.behavior.outcome == "contact"
    assert bench.stops == [(0.2, Stop("stage")), (0.2, Stop("other"))]
    assert bench.loop.account.not_at_rest == []
    assert bench.shown == [("REST", 0.0), ("APPROACH", 0.1), ("DONE", 0.2)]
    assert [(name, round(t_s, 6)) for name, t_s in bench.entered] == bench.shown
    assert np.diff(bench.turns(0.1)) == pytest.approx(TURN_S), "what moves is looked at at every turn"
    ticks = [kept for kept in bench.kept if kept[0] == "Tick"]
    assert ticks == [("Tick", "REST", "APPROACH", [MoveTo("stage", 0.005, 0.01)])], "that one alone led on"


def test_closing_waits_until_the_last_mover_stands_and_looks_for_that_at_every_turn(bench):
    bench.other.brake_s = 101 * TURN_S
    bench.run()
    assert bench.kept[-1][0] == "Standstill"
    assert bench.clock.now() == pytest.approx(0.2 + bench.other.brake_s, abs=0.5 * TURN_S)
    assert bench.loop.account.not_at_rest == []


def test_a_device_that_cannot_be_left_alone_hides_nothing_of_what_was_skipped(bench):
    apply = bench.board.apply

    def apply_but_the_last(command):
        if isinstance(command, Listen) and not command.streams:
            raise OSError("gone")
        apply(command)

    bench.board.apply = apply_but_the_last
    bench.requests = [("abort", 0.15)]
    with pytest.raises(Aborted):
        bench.run()
    assert ("board.force", 0.0, 0.1) in bench.skipped


def test_what_comes_before_it_was_requested_is_kept(bench):
    bench.board.listening = frozenset({"board.force"})
    bench.run()
    assert bench.recorded[0].seq == 0


def test_a_mover_that_is_not_seen_standing_is_named_after_two_seconds(bench):
    bench.stage.brake_s = None
    bench.run()
    assert bench.loop.account.not_at_rest == ["stage"]
    assert bench.clock.now() == pytest.approx(0.2 + loop_module.STANDSTILL_TIMEOUT_S, abs=2 * TURN_S)


def test_a_stop_that_a_mover_does_not_hear_is_sent_again_under_its_number(bench):
    hears = bench.stage.apply

    def apply_once_the_line_is_back(command):
        if isinstance(command, Stop) and bench.clock.now() < 0.5:
            bench.log.append((bench.clock.now(), command))
        else:
            hears(command)

    bench.stage.apply = apply_once_the_line_is_back
    bench.run()
    stops = [(t_s, command.id) for t_s, command in bench.stops if command.device == "stage" and t_s >= 0.2]
    assert [t_s for t_s, _ in stops] == pytest.approx([0.2, 0.4, 0.6], abs=2 * TURN_S)
    assert len({number for _, number in stops}) == 1
    assert bench.loop.account.not_at_rest == []
    assert len([command for _, command in bench.stops if command.device == "other"]) == 1


def test_a_mover_that_fails_while_it_stops_is_named_and_not_waited_for(bench):
    bench.other.brake_s = None
    bench.other.report(Failed, "the link is gone", at_s=0.25)
    bench.run()
    assert bench.loop.account.not_at_rest == ["other"]
    assert bench.clock.now() < 0.3


def test_a_mover_that_takes_no_stop_keeps_no_other_from_it(bench):
    bench.stage.broken = RuntimeError("its driver is broken")
    bench.run()
    assert bench.stops[-1] == (0.2, Stop("other"))
    assert bench.loop.account.not_at_rest == ["stage"]


@pytest.mark.parametrize("way", ["board reading", "board polling", "stage reading"])
def test_a_device_that_breaks_while_the_bench_is_stopped_hides_no_standstill(bench, way):
    device, what = way.split()
    bench.when(bench.stage, Stop, lambda: setattr(getattr(bench, device), what, RuntimeError("broken")))
    bench.run()
    assert bench.loop.account.not_at_rest == []


@pytest.mark.parametrize(
    ("break_", "error"),
    [
        (lambda bench: setattr(bench.board, "reading", RuntimeError("broken")), RuntimeError("broken")),
        (lambda bench: setattr(bench.detector, "error", ValueError("no")), UnfitStreamError("contact: no")),
        (lambda bench: setattr(bench.signals[0], "error", ValueError("no")), UnfitStreamError("no")),
    ],
    ids=["device", "detector", "signal"],
)
def test_an_error_of_a_part_stops_every_mover_and_comes_out_with_the_parts_name(bench, break_, error):
    bench.signals, bench.detector.inputs = (Doubled(),), ("board.force", "signals.double")
    break_(bench)
    with pytest.raises(type(error), match=str(error)):
        bench.run()
    assert [command for _, command in bench.stops] == [Stop("stage"), Stop("other")]


@pytest.mark.parametrize("given", [None, [3], [Contact(math.nan, "contact", 1.0, 0.5)]])
def test_what_a_detector_returns_that_is_no_event_with_a_time_ends_the_trial(bench, given):
    bench.detector.push = lambda block: given
    with refused(UnfitStreamError, "contact", "push returns", "list of events"):
        bench.run()
    assert [command for _, command in bench.stops] == [Stop("stage"), Stop("other")]


@pytest.mark.parametrize("part", ["detector", "signal"])
def test_who_writes_to_what_others_get_as_well_ends_the_trial_and_the_recording_stays_as_it_was(bench, part):
    bench.signals, bench.detector.inputs = (Doubled(),), ("board.force", "signals.double")
    changed: Any = bench.detector if part == "detector" else bench.signals[0]
    push = changed.push
    changed.push = lambda block: [block.values.sort(), *push(block)]
    bench.slope = -0.001
    with pytest.raises(UnfitStreamError, match="read-only"):
        bench.run()
    force_n = np.concatenate([block.values for block in bench.recorded if block.stream == "board.force"])
    assert len(force_n) and (np.diff(force_n[:, 0]) < 0.0).all()


def test_what_is_not_recorded_any_more_ends_the_trial_with_the_bench_still(bench):
    bench.behavior = Approach(rest_s=0.5)
    bench.when(bench.stage, MoveTo, lambda: setattr(bench, "failure", OSError("the disk is full")))
    with pytest.raises(OSError, match="the disk is full"):
        bench.run()
    assert bench.stops == [(0.505, Stop("stage")), (0.505, Stop("other"))]


def test_losses_are_added_up_and_kept_while_the_bench_is_stopped_too(bench):
    for at_s in (0.01, 0.02, 0.21):
        bench.board.report(Lost, "board.force", 7, at_s=at_s)
    bench.run()
    assert ("Lost", "DONE", "DONE", []) in bench.kept
    assert bench.loop.account.lost == {"board.force": 21}


# --- the guard ------------------------------------------------------------------------------------


def end(bench, kind, at_s):
    """Let something end the trial."""
    if kind is GuardStopped:
        bench.guard.stop_s = at_s
    else:
        bench.board.report(kind, "it broke", at_s=at_s)


@pytest.mark.parametrize(("kind", "outcome"), ENDS)
@pytest.mark.parametrize("behavior", [Approach, Deaf, Stubborn, Cautious])
def test_what_ends_a_trial_stops_every_mover_whatever_the_behavior_makes_of_it(behavior, kind, outcome):
    bench = Bench(behavior())
    end(bench, kind, 0.15)
    account = bench.run().account
    assert bench.stops[:2] == [(0.15, Stop("stage")), (0.15, Stop("other"))]
    assert account.outcome == outcome
    assert ("the test stops it" if kind is GuardStopped else "board") in account.reason
    assert ("refused MoveTo(stage)" in account.reason) == (behavior is Stubborn)
    assert [name for name, *_ in bench.kept].count(kind.__name__) == 1
    moves = bench.sent(MoveTo, since_s=0.15)
    assert [move.position_m for _, move in moves] == ([0.0] if behavior is Cautious else [])
    assert bool(len(bench.turns(0.15 + 1e-9))) == (behavior is Cautious), "no other has a way out"


def test_a_way_out_makes_no_success_of_a_trial():
    bench = Bench(Cautious())
    bench.guard.stop_s = 0.15
    loop = bench.run()
    assert bench.behavior.outcome == "contact"
    assert loop.account.outcome == "guard"
    assert dict(loop.visits)["DONE"] == pytest.approx(0.25)


def test_a_way_out_has_ten_seconds():
    bench = Bench(Cautious())
    bench.guard.stop_s, bench.stage.travel_s = 0.15, None
    bench.run()
    assert bench.guard.seen[-1][0] == pytest.approx(10.15)


@pytest.mark.parametrize("behavior", [Cautious, Restless])
def test_what_ends_a_trial_on_its_way_out_leaves_it_no_more_time(behavior):
    bench = Bench(behavior())
    bench.guard.stop_s, bench.stage.travel_s = 0.15, None
    bench.board.report(Failed, "the link is gone", at_s=0.2)
    account = bench.run().account
    assert bench.guard.seen[-1][0] == pytest.approx(0.2)
    assert (account.outcome, account.reason) == ("guard", "the test stops it")


def test_what_ends_a_trial_in_a_pause_leaves_it_no_way_out():
    bench = Bench(Cautious())
    bench.requests = [("pause", 0.15)]
    bench.on_the_wall_clock()
    bench.guard.stop_s = 0.3
    assert bench.run().account.outcome == "guard"
    assert bench.guard.seen[-1][0] == pytest.approx(0.3)


def test_a_stream_that_is_missing_stops_every_mover_in_that_turn():
    bench = Bench(Cautious())
    bench.guard.real, bench.stage.travel_s = True, 0.5
    bench.board.mute = "board.force"
    loop = bench.run()
    since_s = next(round(event.t_s, 6) for event in loop.events if isinstance(event, Failed))
    assert bench.stops[:2] == [(since_s, Stop("stage")), (since_s, Stop("other"))]
    assert dict(loop.visits)["LEAVING"] == pytest.approx(since_s), "the behavior itself stopped nothing"


def test_the_guards_stop_is_kept_before_all_else_of_its_turn_with_its_reason(bench):
    bench.guard.stop_s = 0.15
    bench.board.report(Lost, "board.force", 1, at_s=0.149)
    bench.run()
    names = [name for name, *_ in bench.kept]
    assert names.index("GuardStopped") < names.index("Lost")
    assert bench.behavior.reason == "the test stops it"


def test_after_the_guards_stop_a_contact_of_its_turn_and_the_answer_to_the_motion_end_nothing(bench):
    bench.behavior = Deaf()
    bench.guard.stop_s, bench.detector.above = 0.15, 0.1465
    bench.run()
    assert "Contact" in [name for name, *_ in bench.kept]
    assert bench.behavior.state == "APPROACH", "it got neither"


def test_the_guards_streams_are_listened_to_at_standstill_wherever_anything_is_and_it_is_shown_all(bench):
    bench.behavior = Approach(resting=frozenset({"board.force"}))
    bench.board.report(Saturated, "board.force", 4.0, at_s=0.15)
    bench.run()
    assert bench.sent(Listen)[0] == (0.0, Listen("board", frozenset({"board.force", "board.load"})))
    resting = [(streams, moving) for t_s, streams, moving, *_ in bench.guard.seen if t_s < 0.1]
    assert resting and all(each == ({"board.force", "board.load"}, False) for each in resting)
    assert {moving for t_s, _, moving, _, _ in bench.guard.seen if 0.1 < t_s < 0.2} == {True}
    (beyond,) = [beyond for t_s, *_, beyond in bench.guard.seen if t_s == pytest.approx(0.15)]
    assert [status.stream for status in beyond] == ["board.force"]
    assert all(late_s == pytest.approx(0.0, abs=1e-9) for *_, late_s, _ in bench.guard.seen)


def test_a_signal_that_leaves_its_range_is_shown_to_the_guard(bench):
    double = Doubled()
    double.beyond = True
    bench.signals, bench.detector = (double,), LevelDetector("signals.double")
    bench.run()
    assert any(beyond for *_, beyond in bench.guard.seen)
    assert any("signals.double" in streams for _, streams, *_ in bench.guard.seen)


def test_a_motion_that_a_detector_ends_stops_where_the_detectors_stream_falls_silent(bench):
    bench.guard.real, bench.stage.travel_s = True, 0.5
    bench.board.mute = "board.force"
    bench.board.report(Lost, "board.load", 1, at_s=0.208)
    bench.run()
    assert bench.behavior.reason.startswith("board failed: board.force is silent for 0.1")
    assert bench.loop.account.missing.startswith("board.force is silent for 0.1")
    last = [kind for kind, *_ in bench.kept if kind in ("Failed", "Lost")]
    assert last == ["Failed", "Lost"], "what is missing comes before all else of its turn"


def test_a_motion_that_ends_by_a_signal_stops_where_what_it_is_made_of_falls_silent(bench):
    bench.guard.real, bench.stage.travel_s = True, 0.5
    bench.signals, bench.detector = (Doubled(),), LevelDetector("signals.double")
    bench.board.mute = "board.force"
    bench.run()
    assert bench.behavior.reason.startswith("board failed: signals.double (of board.force) is silent for 0.1")


def test_a_command_beyond_a_limit_or_for_no_device_is_refused_recorded_with_its_state_and_not_sent(bench):
    far = MoveTo("stage", 0.02, 0.01)
    bench.behavior.enter_APPROACH = lambda: bench.behavior.command(far)
    with pytest.raises(GuardRefusal):
        bench.run()
    assert ("Tick", "REST", "APPROACH", [far]) in bench.kept
    assert bench.sent(MoveTo) == []
    assert len(bench.stops) == 2
    bench = Bench()
    bench.behavior.enter_APPROACH = lambda: bench.behavior.command(Stop("nowhere"))
    with pytest.raises(GuardRefusal, match="no such device; the bench has stage, other, board"):
        bench.run()


def test_a_stream_that_the_guard_is_to_watch_and_nothing_sends_is_refused_before_anything_moves(bench):
    watched = {"force_stream": "board.load", "force_n": 1.0, "position_stream": "x.y"}
    bench.guard = Guard(GuardSettings(travel_m=0.01, **watched))
    with pytest.raises(GuardRefusal, match=r"x\.y"):
        bench.run()
    assert bench.sent(MoveTo) == []


# --- what is listened to --------------------------------------------------------------------------


def test_devices_are_asked_for_what_changes_and_what_is_listened_to_is_recorded(bench):
    bench.run()
    listens = bench.sent(Listen)
    assert listens[0] == (0.1, Listen("board", frozenset({"board.force", "board.load"}))), "not at rest"
    assert {command.device for _, command in listens} == {"board"}
    assert all(before != after for (_, before), (_, after) in pairwise(listens))
    assert ("board.force", 0.0, 0.1) in bench.skipped
    assert {block.stream for block in bench.recorded} == {"board.force", "board.load"}
    assert sum(len(block) for block in bench.recorded if block.stream == "board.force") == 100


def test_a_force_that_no_state_measures_stops_the_trial_at_standstill():
    bench = Bench(Approach(rest_s=1.0, resting=frozenset({"board.force"})))
    bench.guard.real, bench.slope = True, 1.0  # a newton a millisecond
    bench.run()
    assert "beyond limits.force_n" in bench.behavior.reason
    assert bench.sent(MoveTo) == []


def test_a_contact_is_kept_with_both_states_and_its_stop_goes_out_first_then_subscriptions(bench):
    bench.detector.above = 0.15
    loop = bench.run()
    assert ("Contact", "APPROACH", "STOPPING", [Excite("board", False), Stop("stage")]) in bench.kept
    assert [name for name, _ in loop.visits] == ["REST", "APPROACH", "STOPPING", "DONE"]
    assert (dict(loop.visits)["REST"], dict(loop.visits)["STOPPING"]) == (0.0, pytest.approx(0.151))
    t_s = dict(bench.shown)["STOPPING"]
    after = [type(command) for sent_s, command in bench.log if sent_s >= t_s][:3]
    assert after == [Stop, Listen, Excite], "the behavior gave them in another order"


def test_a_stream_that_was_never_listened_to_is_skipped_from_end_to_end(bench):
    bench.behavior = Approach(listening=frozenset())
    bench.run()
    assert ("board.force", 0.0, pytest.approx(bench.clock.now())) in bench.skipped


def test_what_is_not_listened_to_any_more_is_skipped_from_then_on(bench):
    bench.detector.above = 0.15
    bench.stage.brake_s = 0.3
    bench.run()
    t0_s, t1_s = next(span for name, *span in bench.skipped if name == "board.force" and span[0] > 0.1)
    assert t0_s == pytest.approx(dict(bench.shown)["STOPPING"], abs=TURN_S)
    assert t1_s > t0_s + 0.25


def test_a_detector_is_reset_when_it_is_armed_and_not_in_the_states_that_follow(bench):
    bench.detector.above = 0.15
    bench.behavior.plans["STOPPING"] = StatePlan(1.0, detectors=frozenset({"contact"}))
    bench.run()
    assert bench.detector.resets == [0]


def test_a_detector_receives_its_own_streams_alone_and_only_while_it_is_armed(bench):
    bench.behavior = Approach(resting=frozenset({"board.force"}))
    bench.detector.above = 0.15
    bench.run()
    assert {block.stream for block in bench.detector.received} == {"board.force"}
    assert bench.detector.received[0].t0_s >= 0.1
    assert bench.detector.received[-1].t0_s <= 0.16


def test_a_stream_that_nothing_sends_is_refused_before_anything_moves(bench):
    bench.detector = LevelDetector("board.forse")
    with pytest.raises(UnfitStreamError, match=r"did you mean board\.force"):
        bench.run()
    assert bench.sent(MoveTo) == []


def test_a_signal_is_recorded_in_the_place_of_what_it_is_made_of_to_the_last_block(bench):
    """The last samples come while the bench is being stopped, by an abort in the middle."""
    bench.signals, bench.detector = (Doubled(),), LevelDetector("signals.double")
    bench.requests, bench.other.brake_s = [("abort", 0.15)], 0.1
    with pytest.raises(Aborted):
        bench.run()
    assert {block.stream for block in bench.recorded} == {"signals.double", "board.load"}
    for stream in ("signals.double", "board.load"):
        assert bench.recorded[-1].last_s == pytest.approx(0.25, abs=2 * TURN_S)
        samples = sum(len(block) for block in bench.recorded if block.stream == stream)
        assert samples == pytest.approx(150, abs=10)


def test_streams_that_a_trial_has_watched_for_their_range_are_listened_to_in_motion(bench):
    bench.behavior.range_streams = frozenset({"board.force"})
    bench.behavior.plans["APPROACH"] = StatePlan(1.0)
    bench.run()
    assert bench.sent(Listen)[0][1] == Listen("board", frozenset({"board.force", "board.load"}))


# --- time -----------------------------------------------------------------------------------------


def test_a_rest_without_a_subscriber_is_one_turn_and_on_the_wall_clock_turns_at_the_idle_rate(bench):
    bench.behavior = Approach(rest_s=90.0)
    bench.run()
    assert bench.turns()[0] == pytest.approx(90.0)
    bench = Bench(Approach(rest_s=1.0))
    bench.on_the_wall_clock()
    bench.run()
    assert np.diff(bench.turns(until_s=0.99)) == pytest.approx(1.0 / 50.0)


PROMPTS = [(True, 50.0, 200.0), (False, 50.0, 50.0), (False, 200.0, 200.0)]


@pytest.mark.parametrize(("prompt", "idle_hz", "rate_hz"), PROMPTS)
def test_a_state_that_listens_turns_slowly_only_where_its_decisions_may_wait(prompt, idle_hz, rate_hz):
    bench = Bench(Approach(rest_s=1.0, resting=frozenset({"board.force"}), prompt=prompt))
    bench.settings = LoopSettings(rate_hz=RATE_HZ, idle_rate_hz=idle_hz)
    bench.run()
    assert np.diff(bench.turns(until_s=0.99)) == pytest.approx(1.0 / rate_hz)


def test_a_rest_without_a_deadline_is_turned_through_until_something_happens(bench):
    bench.behavior = Approach(rest_s=float("inf"))
    bench.stage.report(Failed, "the test stops it", at_s=0.5)
    bench.run()
    assert bench.behavior.outcome == "fault"
    assert np.diff(bench.turns()) == pytest.approx(TURN_S)
    assert bench.turns()[-1] == pytest.approx(0.5)


class Late(VirtualClock):
    """A host that is held up once, at a given time."""

    def __init__(self, at_s, by_s, virtual=True):
        super().__init__()
        self.at_s, self.by_s, self.virtual = at_s, by_s, virtual

    def wait_until(self, t_s):
        super().wait_until(t_s + self.by_s if t_s >= self.at_s and self.by_s else t_s)
        if t_s >= self.at_s:
            self.by_s = 0.0


def test_a_late_turn_is_reported_to_the_guard_and_counted_and_missed_ones_are_not_made_up_for(bench):
    bench.clock = Late(0.15, 0.03)
    bench.run()
    assert [round(late_s, 6) for *_, late_s, _ in bench.guard.seen if late_s > 1e-6] == [0.03]
    assert [round(late_s, 6) for late_s in bench.guard.lates if late_s > 1e-6] == [0.03]
    assert (bench.loop.account.overruns, bench.loop.account.worst_late_s) == (1, pytest.approx(0.03))
    assert np.diff(bench.turns(0.11)).min() == pytest.approx(TURN_S)
    assert bench.loop.account.turns == len(bench.guard.seen)


class OftenLate(Late):
    """A host that is held up at every turn in a span."""

    def wait_until(self, t_s):
        VirtualClock.wait_until(self, t_s + self.by_s if self.at_s <= t_s < self.at_s + 0.02 else t_s)


def test_after_a_late_turn_the_slow_ones_are_where_they_would_have_been():
    bench = Bench(Approach(rest_s=1.0, resting=frozenset({"board.force"}), prompt=False))
    bench.clock = Late(0.5, 0.013)
    bench.run()
    slow = bench.turns(0.521, 0.99) * 50.0
    assert slow == pytest.approx(np.round(slow))


def test_every_turn_that_is_late_by_more_than_a_period_is_counted_and_none_by_less(bench):
    bench.clock = OftenLate(0.15, 1.5 * TURN_S)
    bench.run()
    late = [late_s for *_, late_s, _ in bench.guard.seen if late_s > 1e-6]
    assert bench.loop.account.overruns == len(late) == 2
    assert bench.loop.account.worst_late_s == pytest.approx(1.5 * TURN_S)
    punctual = Bench()
    punctual.clock = Late(0.15, 0.9 * TURN_S)
    account = punctual.run().account
    assert (account.overruns, account.worst_late_s) == (0, 0.0)


# --- events ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("what", "at_s", "order"),
    [
        ((Lost, "board.force", 1), 0.1505, ["Lost", "Contact"]),
        ((Lost, "board.force", 1), 0.153, ["Contact", "Lost"]),
        ((Failed, "it broke"), 0.153, ["Failed", "Contact"]),
    ],
)
def test_events_of_a_turn_come_in_the_order_of_their_times_and_first_what_ends_the_trial(
    bench, what, at_s, order
):
    bench.detector.above = 0.1505  # the sample at 0.151 s
    bench.board.report(*what, at_s=at_s)
    bench.run()
    assert [name for name, *_ in bench.kept if name in order] == order


def watched(behavior):
    """The events that the behavior gets from now on, and when it wakes at that moment."""
    handled, handle = [], behavior.handle

    def check(event):
        handled.append((event, behavior.wake_s))
        return handle(event)

    behavior.handle = check
    return handled


def test_a_behavior_gets_ticks_from_when_it_wakes_on(bench):
    bench.stage.travel_s = 5.0
    handled = watched(bench.behavior)
    bench.run()
    ticks = [(event.t_s, wake_s) for event, wake_s in handled if isinstance(event, Tick)]
    assert ticks == [(pytest.approx(0.1), 0.1), (pytest.approx(1.1), pytest.approx(1.1))]


def test_commands_of_a_state_that_stays_are_sent(bench):
    handle = bench.behavior.handle
    answer = [Excite("board", True)]
    bench.behavior.handle = lambda event: answer if isinstance(event, Lost) else handle(event)
    bench.board.report(Lost, "board.force", 1, at_s=0.15)
    bench.run()
    assert bench.sent(Excite) == [(0.15, Excite("board", True))]


def test_an_answer_without_a_number_is_handled_where_nothing_was_commanded_and_ends_no_motion_that_has_one(
    bench,
):
    handled = watched(bench.behavior)
    for t_s in (0.05, 0.15):
        bench.stage.report(Reached, 0.0, at_s=t_s)
    bench.run()
    times_s = [event.t_s for event, _ in handled if isinstance(event, Reached)]
    assert times_s == pytest.approx([0.05, 0.2])
    assert bench.shown[-1] == ("DONE", 0.2)


def test_all_that_devices_send_in_a_turn_is_taken(bench):
    extra = [SampleBlock("stage.extra", 0, 0.0, np.zeros((1, 1)), 1000.0, unit="m")]
    bench.stage.read = lambda: extra
    bench.run()
    assert any({"stage.extra", "board.force"} <= streams for _, streams, *_ in bench.guard.seen)


def test_what_a_detector_finds_in_one_block_outlives_the_next_of_its_turn(bench):
    bench.detector.inputs, push = ("board.force", "board.load"), bench.detector.push
    bench.detector.push = lambda block: push(block) if block.stream == "board.force" else []
    bench.detector.above = 0.15
    bench.run()
    assert ("Contact", "APPROACH", "STOPPING") in [kept[:3] for kept in bench.kept]


def test_what_a_detector_holds_against_its_threshold_is_recorded_by_its_name(bench):
    bench.detector.readings, bench.detector.above = np.array([[0.12, 0.3, 0.5]]), 0.15
    bench.run()
    assert {(name, *map(tuple, read)) for name, read, _ in bench.read} == {("contact", (0.12, 0.3, 0.5))}
    assert [decided_s for _, _, decided_s in bench.read if decided_s] == [
        [event.t_s for event in bench.loop.events if isinstance(event, Contact)]
    ]
    bench.read.clear()
    bench.detector.readings = "none"
    bench.clock, bench.behavior = VirtualClock(), Approach()
    bench.run()
    assert bench.read == []


def test_what_comes_after_the_end_is_kept_moves_nothing_and_names_no_mover(bench):
    bench.board.report(Failed, "the link is gone", at_s=0.205)
    account = bench.run().account
    assert (account.outcome, account.not_at_rest, bench.behavior.outcome) == ("", [], "contact")
    assert ("Failed", "DONE", "DONE", []) in bench.kept


def test_a_mover_counts_as_moving_while_it_moves_or_is_commanded_to_stop_and_not_for_another_command(bench):
    bench.behavior.enter_APPROACH = lambda: bench.behavior.command(Tare("stage", "stage.force"))
    bench.behavior.enter_STOPPING = lambda: bench.behavior.command(Stop("stage"))
    bench.detector.above = 0.15
    bench.run()
    moving = [(round(t_s, 6), moves) for t_s, _, moves, *_ in bench.guard.seen]
    (begin_s, _), (end_s, _), *_ = bench.sent(Stop)
    expected_s = np.arange(begin_s + TURN_S, end_s, TURN_S)
    assert [t_s for t_s, moves in moving if moves] == pytest.approx(expected_s)


# --- answers ---------------------------------------------------------------------------------------


class Hasty(Behavior):
    """Sends a second motion before the first is answered."""

    table = (on("deadline", "FIRST", "SECOND"), on("reached", "SECOND", "DONE"))

    def __init__(self):
        super().__init__({"FIRST": StatePlan(0.05), "SECOND": StatePlan(1.0)}, "stage")

    def enter_FIRST(self):
        self.command(MoveTo("stage", 0.001, 0.01))

    def enter_SECOND(self):
        self.command(MoveTo("stage", 0.002, 0.01))

    def enter_DONE(self):
        self.conclude("contact")


@pytest.fixture
def hasty():
    return Bench(Hasty())


def test_every_command_has_a_number_of_its_own_and_the_answer_to_an_older_one_ends_nothing(hasty):
    loop = hasty.run()
    assert [command.id for _, command in hasty.log] == list(range(1, len(hasty.log) + 1))
    first, second = [event for event in loop.events if isinstance(event, Reached)]
    assert (first.t_s, second.t_s) == pytest.approx((0.10, 0.15)), "both are kept in the record"
    assert dict(loop.visits)["DONE"] == second.t_s
    assert hasty.behavior.outcome == "contact"


def test_a_number_belongs_to_what_was_sent_and_not_to_what_it_asks_for():
    numbered = MoveTo("stage", 0.001, 0.01, id=7)
    assert numbered == MoveTo("stage", 0.001, 0.01)
    assert Refused(0.0, "stage", numbered, "it is busy").command_id == 7


def test_a_mover_counts_as_moving_until_its_newest_command_is_answered(hasty):
    hasty.stage.travel_s = 0.4
    # Ten turns until the second command, then 200 a second until its answer: an idle loop would take 50 a second.
    assert hasty.run().account.turns >= 200 * 0.45


def test_a_stall_ends_the_trial_whatever_it_is_about(hasty):
    hasty.stage.report(Stalled, "it hit something", at_s=0.07, command_id=1)
    hasty.run()
    assert hasty.behavior.outcome == "fault"
    assert "it hit something" in hasty.behavior.reason


def test_closing_waits_for_the_standstill_that_it_asked_for(hasty):
    hasty.stage.brake_s = 0.1
    hasty.stage.report(Standstill, 0.0, at_s=0.21, command_id=1)
    loop = hasty.run()
    (*_, (_, stop)) = hasty.sent(Stop)
    answers = {event.device: event.command_id for event in loop.events if isinstance(event, Standstill)}
    assert answers["stage"] == next(command.id for _, command in hasty.stops if command.device == "stage") > 1
    assert stop.device == "other" and loop.account.not_at_rest == []


# --- the operator ---------------------------------------------------------------------------------


@pytest.fixture
def restless(bench, monkeypatch):
    """What would be waited for in real time; in the third rest comes what `bench.third` requests."""
    rests = []

    def rested(seconds):
        rests.append(seconds)
        if len(rests) == 3 and bench.third:
            bench.requests = [(bench.third, 0.0)]

    monkeypatch.setattr(loop_module, "rest", rested)
    return rests


@pytest.fixture
def passing(bench, monkeypatch):
    """Rests of the loop pass in the bench's time."""
    wait = lambda seconds: bench.clock.wait_until(bench.clock.now() + seconds)  # noqa: E731
    monkeypatch.setattr(loop_module, "rest", wait)


def test_a_pause_stops_every_mover_the_guard_watches_on_and_the_behavior_gets_only_what_ends_it(
    bench, passing
):
    bench.requests = [("pause", 0.15), ("resume", 0.6)]
    bench.other.brake_s, bench.detector.above = 0.2, 0.152
    bench.run()
    assert bench.stops[:2] == [(0.15, Stop("stage")), (0.15, Stop("other"))]
    assert bench.shown[2] == ("PAUSED", 0.15)
    watched = [streams for t_s, streams, *_ in bench.guard.seen if 0.155 < t_s < 0.35]
    assert len(watched) >= 30
    assert all("board.load" in streams for streams in watched)
    kept = [(name, state, after) for name, state, after, _ in bench.kept]
    assert ("Contact", "APPROACH", "APPROACH") in kept
    assert ("Resumed", "APPROACH", "REST") in kept
    assert bench.behavior.outcome == "contact"


def test_the_guards_streams_are_listened_to_in_a_pause_of_a_deaf_rest(bench, passing):
    bench.on_the_wall_clock()
    bench.behavior = Approach(rest_s=0.5)
    bench.requests = [("pause", 0.1), ("resume", 0.3)]
    bench.run()
    assert bench.sent(Listen)[0] == (0.1, Listen("board", frozenset({"board.load"})))
    assert all("board.load" in streams for t_s, streams, *_ in bench.guard.seen if 0.2 < t_s < 0.3)


@pytest.mark.parametrize(("kind", "outcome"), ENDS)
def test_a_pause_ends_with_the_trial_where_the_bench_fails(bench, kind, outcome):
    bench.requests = [("pause", 0.15)]
    bench.stage.brake_s = 0.2
    end(bench, kind, 0.2)
    bench.run()
    assert bench.behavior.outcome == outcome


def test_a_paused_trial_goes_on_once_every_mover_stands_and_its_time_is_counted(bench):
    bench.requests = [("pause", 0.15), ("resume", 0.17)]
    bench.stage.brake_s = 0.1
    bench.run()
    resumed = next(event for event in bench.loop.events if isinstance(event, Resumed))
    assert resumed.t_s == pytest.approx(0.25)
    assert bench.loop.account.paused_s == pytest.approx(0.10)
    assert [event.t_s for event in bench.loop.events if isinstance(event, Paused)] == [pytest.approx(0.15)]
    assert [kept[1:3] for kept in bench.kept if kept[0] == "Paused"] == [("APPROACH", "APPROACH")]
    assert ("APPROACH", pytest.approx(0.25)) in bench.shown


def test_a_mover_that_does_not_answer_the_stop_of_a_pause_ends_the_trial(bench):
    bench.requests = [("pause", 0.15), ("resume", 0.2)]
    bench.stage.brake_s = 60.0
    bench.run()
    (failed,) = (event for event in bench.loop.events if isinstance(event, Failed))
    assert failed.t_s == pytest.approx(0.15 + loop_module.STANDSTILL_TIMEOUT_S, abs=0.011)
    assert "not seen standing still within 2 s of the pause" in failed.reason
    assert bench.behavior.outcome == "fault"


def test_two_pauses_are_added_up_and_one_within_a_pause_changes_nothing(bench):
    bench.requests = [("pause", 0.15), ("pause", 0.155), ("resume", 0.16), ("pause", 0.3), ("resume", 0.3)]
    bench.run()
    assert bench.loop.account.paused_s == pytest.approx(2 * 0.02)
    times_s = [event.t_s for event in bench.loop.events if isinstance(event, Paused)]
    assert times_s == pytest.approx([0.15, 0.3])
    assert bench.behavior.outcome == "contact"


@pytest.mark.parametrize("request_", ["pause", "suspend"])
def test_a_pause_that_comes_while_movers_brake_for_the_one_before_is_kept(bench, restless, request_):
    bench.requests = [("pause", 0.15), ("resume", 0.16), (request_, 0.17)]
    bench.stage.brake_s, bench.third = 0.1, "abort"
    with pytest.raises(Aborted):
        bench.run()
    assert [event for event in bench.loop.events if isinstance(event, Resumed)] == []
    assert len(bench.sent(MoveTo)) == 1, "nothing began anew"
    assert bool(bench.suspended) == (request_ == "suspend")


def test_no_deadline_passes_in_a_pause(bench):
    """REST is to last 0.1 s and is paused for three times as long; afterwards the behavior may enter it anew."""
    bench.requests = [("pause", 0.05), ("resume", 0.4)]
    bench.on_the_wall_clock()
    bench.run()
    assert bench.sent(MoveTo)[0][0] >= 0.4


def test_virtual_time_stands_still_while_a_paused_bench_waits_for_a_request(bench, restless):
    bench.requests, bench.third = [("pause", 0.15)], "resume"
    bench.run()
    assert restless == [loop_module.KEY_INTERVAL_S] * 3
    assert bench.loop.account.paused_s == pytest.approx(0.02), "until it stood"


def test_a_suspension_stops_every_mover_and_waits_until_the_last_one_stands(bench, restless):
    bench.requests = [("suspend", 0.15), ("resume", 50.0)]
    bench.other.brake_s = 0.2
    bench.run()
    assert bench.stops[:2] == [(0.15, Stop("stage")), (0.15, Stop("other"))]
    assert bench.shown[2] == ("PAUSED", 0.15)
    assert bench.suspended == [(0.35, [])]
    resumed = next(event for event in bench.loop.events if isinstance(event, Resumed))
    assert resumed.t_s >= 0.35, "it is paused yet when it goes on"
    assert bench.behavior.outcome == "contact"
    assert set(restless) == {loop_module.KEY_INTERVAL_S}


def test_a_suspension_is_no_turn_that_was_late(bench, restless):
    bench.on_the_wall_clock()
    bench.requests = [("suspend", 0.15), ("resume", 60.5)]
    bench.run()
    assert len(bench.suspended) == 1
    assert bench.loop.account.overruns == 0
    assert bench.loop.account.paused_s > 60.0


def test_no_stream_was_silent_while_the_program_was_suspended(bench, restless):
    bench.on_the_wall_clock()
    bench.behavior = Approach(resting=frozenset({"board.force"}))
    bench.requests = [("suspend", 0.05), ("resume", 60.3)]
    read = bench.board.read
    bench.board.read = lambda: (
        [] if 60.0 < bench.clock.now() < 60.2 else read()
    )  # it begins again after a while
    bench.run()
    assert bench.behavior.outcome == "contact"


def test_a_signal_that_falls_silent_after_a_suspension_ends_the_trial(bench, restless):
    bench.on_the_wall_clock()
    bench.signals, bench.behavior = (Doubled(),), Approach(rest_s=90.0, resting=frozenset({"signals.double"}))
    bench.requests = [("suspend", 0.05), ("resume", 60.1)]
    read = bench.board.read
    bench.board.read = lambda: read() if bench.clock.now() < 60.2 else []
    bench.run()
    assert bench.behavior.reason.startswith("board failed: board.force is silent for 0.4")
    assert bench.clock.now() < 61.0


def test_a_paused_bench_can_be_suspended_as_often_as_one_likes(bench, restless):
    bench.requests = [("pause", 0.15), ("suspend", 0.2), ("suspend", 10.0), ("resume", 100.0)]
    bench.on_the_wall_clock()
    bench.run()
    assert [moving for _, moving in bench.suspended] == [[], []]
    assert len([event for event in bench.loop.events if isinstance(event, Paused)]) == 1
    assert bench.behavior.outcome == "contact"


def test_a_suspension_from_before_the_trial_comes_before_anything_moves(bench, restless):
    bench.requests = [("suspend", 0.0), ("resume", 60.0)]
    bench.run()
    assert bench.suspended == [(0.0, [])]
    assert bench.sent(MoveTo)[0][0] > 60.0
    assert bench.shown[0] == ("PAUSED", 0.0)


def test_an_abort_stops_every_mover_records_what_has_come_and_then_listens_to_nothing(bench):
    bench.requests = [("abort", 0.15)]
    bench.board.report(Sent, Excite("board", False), at_s=0.15)
    with pytest.raises(Aborted):
        bench.run()
    assert bench.sent(Listen)[-1][1] == Listen("board", frozenset())
    assert bench.sent(Listen)[-1][0] >= 0.17
    assert bench.stops == [(0.15, Stop("stage")), (0.15, Stop("other"))]
    assert bench.loop.account.not_at_rest == []
    sent = [event for event in bench.loop.events if isinstance(event, Sent)]
    assert sent == [Sent(0.15, "board", Excite("board", False))]


def test_an_abort_from_before_the_trial_keeps_everything_from_moving(bench):
    bench.requests = [("abort", 0.0)]
    with pytest.raises(Aborted):
        bench.run()
    assert bench.sent(MoveTo) == []
    assert bench.shown == []


@pytest.mark.parametrize(("request_", "outcome"), [("resume", "contact"), ("abort", "aborted")])
def test_a_pause_from_before_the_trial_is_kept_until_a_request_comes(bench, restless, request_, outcome):
    bench.requests, bench.third = [("pause", 0.0)], request_
    if request_ == "abort":
        with pytest.raises(Aborted):
            bench.run()
    else:
        bench.run()
        assert bench.shown[:2] == [("PAUSED", 0.0), ("REST", 0.0)]
    assert restless == [loop_module.KEY_INTERVAL_S] * 3
    assert bench.behavior.outcome == outcome


@pytest.mark.parametrize("kind", [Failed, Stalled])
def test_a_pause_from_before_the_trial_takes_what_devices_send_and_ends_where_one_fails(
    bench, restless, kind
):
    bench.requests = [("pause", 0.0)]
    bench.board.report(Lost, "board.force", 3)
    bench.board.report(kind, "unplugged")
    with refused(DeviceError, "board: unplugged while waiting for the operator", "resume"):
        bench.run()
    assert bench.sent(MoveTo) == []
    assert len(restless) == 1


def test_a_baseline_that_is_refused_says_of_which_streams(bench):
    bench.detector.inputs = ("board.force", "board.load")
    bench.detector.push = lambda block: [BaselineRefused(block.t0_s, "contact", 1.0, 0.5, "no variance")]
    bench.run()
    assert bench.behavior.reason == "contact baseline refused: board.force, board.load: no variance"


# --- beyond the second tier of force, and what was forecast


def crushing(*, falls=True):
    """The force grows by 0.3 N a millisecond, through 50 N and, while the movers brake, through 55 N; on the way back
    it falls by as much."""
    bench = Bench(retreat_n=55.0, retreat_m=0.001)
    bench.guard.real, bench.slope = True, 0.3
    stage: Any = bench.stage
    apply = stage.apply

    def turned(command):
        if isinstance(command, MoveAt) and falls:
            bench.top = 1000.0 * bench.clock.now()
        apply(command)

    stage.apply = turned
    return bench


@pytest.mark.parametrize(("back_s", "for_s"), [(None, 0.1), (0.03, 0.03)])  # at most 1 mm at 10 mm/s
def test_what_pressed_too_hard_is_sent_back_after_its_stop_and_stopped_again(back_s, for_s):
    bench = crushing()
    bench.stage.back_s = back_s
    bench.run()
    (sent_s, back), *more = bench.sent(MoveAt)
    assert not more
    assert back.velocity_m_s == -0.01
    stops_s = [t_s for t_s, command in bench.stops if command.device == "stage"]
    assert stops_s[0] < sent_s < stops_s[-1]
    assert stops_s[-1] == pytest.approx(sent_s + for_s, abs=2 * TURN_S)
    assert bench.clock.now() == pytest.approx(stops_s[-1] + bench.stage.brake_s, abs=2 * TURN_S)
    assert ("Retreated", "FAILED", "FAILED", [back]) in bench.kept
    (retreated,) = (event for event in bench.loop.events if isinstance(event, Retreated))
    assert (retreated.t_s, retreated.device) == (pytest.approx(sent_s), "stage")
    reason = bench.loop.account.reason
    assert "beyond limits.force_n" in reason
    assert reason.endswith("; it pressed beyond limits.retreat_n: stage was sent back")


def test_a_way_back_on_which_it_presses_more_ends():
    bench = crushing(falls=False)
    bench.run()
    ((sent_s, _),) = bench.sent(MoveAt)
    stops_s = [t_s for t_s, command in bench.stops if command.device == "stage"]
    assert stops_s[-1] <= sent_s + 0.05, "5 N more, and the median"
    assert ": stage was sent back, until board.load is at " in bench.loop.account.reason


def test_one_that_cannot_be_sent_back_is_named(bench):
    bench = crushing()
    apply = bench.stage.apply

    def refusing(command):
        if isinstance(command, MoveAt):
            raise OSError("gone")
        return apply(command)

    bench.stage.apply = refusing
    bench.run()
    reason = bench.loop.account.reason
    assert "beyond limits.force_n" in reason
    assert reason.endswith("beyond limits.retreat_n, and stage could not be sent back: gone")
    assert bench.stops[-1][1] == Stop("other")


def test_a_forecast_and_what_happened_are_kept_beside_each_other(bench):
    bench = Bench(stiffness_n_m=1e3)
    bench.detector.above = 0.15
    bench.guard.real = True
    bench.run()
    names = [name for name, *_ in bench.kept]
    assert names.index("Forecast") < names.index("Approached")
    assert ("Forecast", "APPROACH", "APPROACH", []) in bench.kept
    found = {type(event).__name__: event for event in bench.loop.events}
    assert found["Forecast"].t_s == pytest.approx(0.1)
    assert found["Approached"].pressed_n == pytest.approx(0.15, abs=0.02)

"""Both behaviors of the sonic fingers, with pauses and touches at any time: what is commanded must be safe.

The bench here answers every command as a real one would, stops half-way when it is paused, and keeps its detectors as
the loop does: armed in the states that name them, begun anew when they were not armed before, not handled in a
pause.
"""

import math
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from behaviors.aura import Aura, AuraFactors, AuraSettings
from behaviors.centering import Centering, CenteringSettings
from behaviors.events import Contact, ContactHeld, ContactLost, PreTouch, Resumed, Tick
from behaviors.grasp import GraspSettings
from behaviors.search import SearchFactors
from drivers.core.messages import (
    Grip,
    Gripped,
    Home,
    MoveAt,
    MovePose,
    MoveTo,
    Reached,
    Release,
    Standstill,
    Stop,
    Twist,
)
from drivers.ur_arm.settings import UrArmSettings

END = (0.0565, 0.0, 0.0)
FOUND_BY = {"RUNNING_UP": "right_ours", "SEEKING_FORWARD": "left_ours", "SEEKING_BACKWARD": "right_ours"}
OTHER = {"left_ours": "right_ours", "right_ours": "left_ours"}

TOUCHES = ("APPROACHING", "CONFIRMING")


def aura():
    paths = {"x": {"start_m": (0.025, 0.0, 0.0), "end_m": END}}
    settings = AuraSettings(paths=paths, touch=True, end_gap_m=0.0, cycles=2)
    return Aura(settings, AuraFactors(), frozenset({"contact_ours", "contact_paper", "pretouch_ours"}))


def centering():
    names = frozenset({"left_ours", "right_ours", "left_contact", "right_contact"})
    return Centering(CenteringSettings(run_up=True, half_turn=True), SearchFactors(), names)


class Bench:
    """Arm, jaws and detectors; every command is held against what is safe where the tool stands.

    Args:
        behavior: Of one trial.
        stoppers: Detectors that may stop a motion towards the object.
        felt: Whether they feel the object where it is to be touched.
    """

    def __init__(self, behavior, stoppers, felt):
        self.behavior, self.stoppers, self.felt = behavior, stoppers, felt
        self.t_s = 0.0
        self.place_m, self.target_m = (0.0, 0.0, 0.0), None
        self.jaws = "unknown"
        self.armed, self.touched, self.held = frozenset(), set(), set()
        self.waiting = None
        self.turned_rad = 0.0
        self.visited = []
        self._obey(behavior.begin(0.0))

    def happen(self, event):
        self._obey(self.behavior.handle(event))

    def _obey(self, commands):
        state = self.behavior.state
        self.visited.append(state)
        armed = self.behavior.plan.detectors
        begun = armed - self.armed
        self.armed, self.touched, self.held = armed, self.touched - begun, self.held - begun
        self.touched &= armed
        self.held &= armed
        for command in commands:
            self._hold_against_what_is_safe(command)
            self._carry_out(command)

    def _hold_against_what_is_safe(self, command):
        where = f"{command} in {self.visited[-1]}, after {self.visited[-4:]}"
        if isinstance(command, Home):
            assert command.device == "gripper", where
            assert self.place_m[2] >= 0.1, f"{where}: something is between the jaws"
        if isinstance(command, MovePose | MoveAt | MoveTo):
            assert self.jaws != "closed", f"{where}: it would take along what it holds"
        if isinstance(command, MovePose) and command.offset[2] < self.place_m[2]:
            assert self.jaws == "open", f"{where}: down with jaws that are not open"
        if self._towards_the_object(command):
            assert self.stoppers <= self.armed, f"{where}: no detector would feel it"
            # centering goes on when a touch is not held yet: that it is held will be reported, and stops it
            silent = self.held if self.visited[-1].startswith("SEEKING") else self.touched
            assert not silent & self.stoppers, f"{where}: {silent} have nothing left to report"

    def _towards_the_object(self, command):
        to_the_end = isinstance(command, MovePose) and command.offset[:3] == pytest.approx(END)
        return to_the_end or isinstance(command, MoveAt)

    def _carry_out(self, command):
        match command:
            case Home():
                self.jaws, self.waiting = "closed at nothing", Reached(0.0, "gripper", 0.0)
            case Release():
                self.waiting = Reached(0.0, "gripper", 0.06)
            case Grip():
                self.waiting = Gripped(0.0, "gripper", True, 0.02, 10.0)
            case MovePose():
                self.turned_rad = 0.0
                self.target_m, self.waiting = command.offset[:3], Reached(0.0, "arm", command.offset[0])
            case MoveTo():
                self.target_m = (command.position_m, 0.0, 0.0)
                self.waiting = Reached(0.0, "arm", command.position_m)
            case MoveAt():
                self.target_m, self.waiting = (command.limit_m, 0.0, 0.0), None
            case Twist():
                self.turned_rad += command.twist[5] * command.duration_s
                assert abs(self.turned_rad) < math.pi, "the wrist would wind up its cables"
                self.waiting = Reached(0.0, "arm", self.place_m[0])
            case Stop(device="arm"):
                self._stand()
                self.waiting = Standstill(0.0, "arm", self.place_m[0])

    def _stand(self):
        if self.target_m is not None:
            self.place_m = tuple((a + b) / 2 for a, b in zip(self.place_m, self.target_m, strict=True))
        self.target_m = None

    # what can happen

    def go_on(self):
        """What the state waits for comes."""
        name, waiting = self.behavior.state, self.waiting
        if self.felt and name in TOUCHES:
            for detector in sorted(self.stoppers - self.touched):
                self.report(detector)
        elif name == "RETRACTING":
            for detector in sorted(self.stoppers & self.touched):
                self.report(detector)
                self.report(detector)
        if self.behavior.state != name:
            return
        if name in FOUND_BY:
            self.t_s += 0.4
            finger = FOUND_BY[name] if abs(self.turned_rad) < 1.5 else OTHER[FOUND_BY[name]]
            self.happen(PreTouch(self.t_s, finger, 1.0, 0.5, 0.005))
        elif waiting is None:
            self.t_s = max(self.t_s, self.behavior.wake_s)
            self.happen(Tick(self.t_s))
        else:
            self.t_s += 0.1
            self.waiting = None
            if isinstance(waiting, Gripped):
                self.jaws = "closed"
            elif waiting.device == "gripper" and waiting.position_m > 0.0:
                self.jaws = "open"
            elif self.target_m is not None and isinstance(waiting, Reached):
                self.place_m, self.target_m = self.target_m, None
            self.happen(replace(waiting, t_s=self.t_s))

    def pause(self, touched):
        """Everything stops half-way; touches that begin or end meanwhile are not handled."""
        self.t_s += 3.0
        self._stand()
        if isinstance(self.waiting, Gripped):
            self.jaws = "closed"
        elif self.waiting is not None and self.waiting.device == "gripper":
            self.jaws = "unknown"
        self.waiting = None
        for detector in sorted(touched & self.armed):
            if detector in self.touched:
                self.touched.discard(detector)
                self.held.discard(detector)
            else:
                self.touched.add(detector)
                self.held.add(detector)
        self.happen(Resumed(self.t_s))

    def report(self, detector):
        """A detector reports the next event that it can."""
        if detector not in self.armed:
            return
        self.t_s += 0.2
        if detector not in self.touched:
            kind: type[Contact | ContactHeld | ContactLost] = Contact
            self.touched.add(detector)
        elif detector not in self.held:
            kind = ContactHeld
            self.held.add(detector)
        else:
            kind = ContactLost
            self.touched.discard(detector)
            self.held.discard(detector)
        self.happen(kind(self.t_s, detector, 9.0, 5.0))


def bench_of(name, felt):
    if name == "aura":
        return Bench(aura(), {"contact_ours"}, felt)
    return Bench(centering(), {"left_contact", "right_contact"}, felt)


EXPERIMENTS = ["aura", "centering"]
FINGERS = ("left_contact", "right_contact")
CONTACTS = st.sampled_from([*FINGERS, "contact_ours", "contact_paper"])
HAPPENINGS = st.one_of(
    st.just(("go_on",)),
    st.tuples(st.just("pause"), st.frozensets(CONTACTS)),
    st.tuples(st.just("report"), CONTACTS),
)


def to_the_end(bench):
    for _ in range(80):
        if bench.behavior.done:
            return
        bench.go_on()


@pytest.mark.parametrize("name", EXPERIMENTS)
@pytest.mark.parametrize("felt", [False, True])
def test_the_undisturbed_trial_passes_through_all_but_the_way_out_after_a_touch(name, felt):
    bench = bench_of(name, felt)
    to_the_end(bench)
    assert bench.behavior.state == "DONE"
    left_out = {("aura", False): {"STOPPING"}, ("centering", False): {"HOLDING"}}.get((name, felt), set())
    states = set(bench.behavior.states)
    assert set(bench.visited) == states - {"FAILED", "BACKING_OFF"} - left_out


@pytest.mark.parametrize("name", EXPERIMENTS)
@pytest.mark.parametrize("felt", [False, True])
@pytest.mark.parametrize("touched", [frozenset(), frozenset({"contact_ours", *FINGERS})])
def test_a_pause_in_any_state_is_gone_on_from_safely(name, felt, touched):
    undisturbed = bench_of(name, felt)
    steps = 0
    while not undisturbed.behavior.done:
        undisturbed.go_on()
        steps += 1
    for step in range(steps):
        bench = bench_of(name, felt)
        for _ in range(step):
            bench.go_on()
        state = bench.behavior.state
        bench.pause(touched)
        assert bench.waiting is not None, f"nothing was commanded after a pause in {state}"
        to_the_end(bench)
        assert bench.behavior.state == "DONE", state


@settings(max_examples=400, deadline=None)
@given(name=st.sampled_from(EXPERIMENTS), felt=st.booleans(), happenings=st.lists(HAPPENINGS, max_size=60))
def test_pauses_and_touches_in_any_order_command_nothing_unsafe(name, felt, happenings):
    bench = bench_of(name, felt)
    for happening in happenings:
        if bench.behavior.done:
            break
        getattr(bench, happening[0])(*happening[1:])
    to_the_end(bench)
    assert bench.behavior.state == "DONE"
    assert bench.place_m[2] == pytest.approx(0.1)
    assert bench.jaws == "open"


PATHS = {"x": {"start_m": (0.0, 0.0, 0.0), "end_m": (0.05, 0.0, 0.0)}}


@pytest.mark.parametrize(
    ("chosen", "follows"),
    [
        (AuraSettings(paths=PATHS), False),
        (GraspSettings(), False),
        (GraspSettings(center=False), True),
        (CenteringSettings(), True),
    ],
)
def test_what_goes_to_places_of_the_base_frame_refuses_another_approach_axis(chosen, follows):
    def found(*axis):
        arm = UrArmSettings(host="127.0.0.2", start_pose=(0.4, 0.0, 0.3, 0.0, 3.1, 0.0), approach_axis=axis)
        return [*chosen.mismatches(("behavior",), {("devices", "arm"): arm})]

    assert found(1.0, 0.0, 0.0) == []
    assert [each.key for each in found(0.0, 1.0, 0.0)] == ([] if follows else ["approach_axis"])

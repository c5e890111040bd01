"""A bench by hand, on the mock bench in virtual time: the guard and the limits are those of a run."""

from dataclasses import replace

import numpy as np
import pytest

from config.assemble import limits_of, make_signals
from config.profile import load_profile
from config.verbs import by_hand as verbs
from controller import by_hand
from drivers.core.messages import Home, MoveAt, Reached, Stop
from simulator.devices.faults import Fault
from tests.refusals import check_refusal


class Hand:
    """A person who interrupts when the test says so."""

    def __init__(self):
        self.request = None

    def poll(self):
        return self.request

    def suspend(self):
        raise AssertionError("nobody asked for it")


@pytest.fixture
def session():
    """Opens a bench by hand, for one of its movers; closes all at the end."""
    opened = []

    def opener(name="mock/transient", mover="stage", faults=(), **sets):
        profile = load_profile(name, {key.replace("__", "."): value for key, value in sets.items()})
        profile = replace(profile, faults=tuple(Fault(**fault) for fault in faults))
        devices = by_hand.needed(limits_of(profile), make_signals(profile), mover)
        one = verbs.session_on(profile, devices, Hand())
        opened.append(one)
        return one.__enter__()

    yield opener
    for one in opened:
        one.__exit__()


def driven(mover, velocity_m_s=0.002, limit_m=0.01):
    """Home, then along the axis until it is stopped or there."""
    commands = [MoveAt(mover, velocity_m_s, limit_m), Home(mover)]

    def steer(event):
        begins = len(commands) == 2 or isinstance(event, Reached)
        if begins and not commands:
            return None
        return [commands.pop()] if begins else ()

    return steer


@pytest.mark.parametrize(
    ("name", "mover", "opened"),
    [
        ("mock/transient", "stage", {"stage", "board"}),
        ("mock/slip", "arm", {"arm"}),
        ("mock/grasp", "gripper", {"arm", "gripper"}),
        ("mock/pointer", "arm", {"arm", "board"}),
    ],
)
def test_a_mover_needs_itself_and_what_its_limits_are_watched_by(session, name, mover, opened):
    one = session(name, mover)
    assert one.infos.keys() == opened
    assert by_hand.home(one, mover, 60.0).outcome == "done"


def test_it_moves_as_far_as_it_was_sent_and_stands(session):
    one = session()
    result = one.run(driven("stage"), "stage", deadline_s=60.0)
    assert (result.outcome, result.reason) == ("done", "")
    assert one.latest.values("stage.position")[-1, 0] == pytest.approx(0.01, abs=1e-5)
    assert not one.rig.devices["stage"].axis.moving(one.rig.clock.now())


def test_the_last_second_of_a_stream_is_kept_and_no_more(session):
    one = session()
    one.run(driven("stage"), "stage", streams=["board.load_cell"], deadline_s=60.0)
    times_s = one.latest.times("board.load_cell")
    assert len(times_s) == len(one.latest.values("board.load_cell"))
    assert times_s[-1] - times_s[0] == pytest.approx(by_hand.WINDOW_S, abs=0.05)
    assert np.diff(times_s) == pytest.approx(1e-3)


@pytest.mark.parametrize(
    ("how", "outcome", "named"),
    [
        ({"limits__force_n": "0.002"}, "guard", ("board.load_cell", "limits.force_n")),
        (
            {"limits__speed_m_s": "0.001"},
            "guard",
            ("limits.speed_m_s",),
        ),
        ({"limits__travel_m": "0.008"}, "guard", ("0.01", "travel_m")),
        (
            {"faults": [{"device": "board", "kind": "silent", "at_s": 1.0}]},
            "fault",
            ("board", "silent", "cable"),
        ),
        ({"faults": [{"device": "stage", "kind": "stall", "at_s": 3.0}]}, "fault", ("stage", "stalled")),
    ],
)
def test_what_stops_a_trial_stops_a_hand(session, how, outcome, named):
    one = session(**how)
    result = one.run(driven("stage"), "stage", deadline_s=60.0)
    assert result.outcome == outcome
    check_refusal(result.reason, *named)
    assert not one.rig.devices["stage"].axis.moving(one.rig.clock.now())
    assert one.rig.devices["stage"].axis.position(one.rig.clock.now()) < 0.01


def test_an_interruption_stops_what_moves(session):
    one = session()
    sent, commands = [], [Home("stage")]
    stage = one.rig.devices["stage"]
    apply = stage.apply
    stage.apply = lambda command: (sent.append(command), apply(command))[1]

    def steer(event):
        one.operator.request = "abort" if event.t_s > 0.1 else None
        return [commands.pop()] if commands else ()

    assert one.run(steer, "stage").outcome == "interrupted"
    assert Stop("stage") in sent
    assert not stage.axis.moving(one.rig.clock.now())


def test_a_mover_that_was_not_seen_standing_is_named(session):
    one = session(faults=[{"device": "stage", "kind": "unplug", "at_s": 0.5}])
    result = one.run(driven("stage"), "stage", deadline_s=60.0)
    assert result.outcome == "fault"
    check_refusal(result.reason, "stage", "the link is gone", "NOT seen standing still")


def test_a_tare_takes_the_level_away(session):
    one = session("mock/slip", "arm")
    one.rig.devices["arm"]._zero -= 0.5
    result, (before, after) = by_hand.tare(one, "arm.force")
    assert result.outcome == "done"
    assert before == pytest.approx(0.0, abs=0.2)
    assert after == pytest.approx(0.0, abs=0.2)


def test_the_verbs_say_what_they_did(verb):
    assert verb("home", "mock/transient") == (
        0,
        "stage: going home\nstage: stands at home, at 0.000 mm\n",
        "",
    )
    code, out, err = verb("tare", "mock/transient")
    assert (code, err) == (0, "")
    assert out.startswith("board.load_cell: ")
    assert "N is zero now" in out


@pytest.mark.parametrize(
    ("arguments", "code", "named"),
    [
        (["home", "mock/transient", "stag"], 2, ("stag", "stage")),
        (["home", "mock/transient", "board"], 2, ("board", "move")),
        (["home", "mock/weights"], 2, ("mock/weights", "nothing that moves")),
        (["home", "papers/slip"], 2, ("papers/slip", "parts", "mock/weights")),
        (["tare", "mock/transient", "stage"], 2, ("stage", "N")),
    ],
)
def test_what_cannot_be_done_is_one_line(verb, arguments, code, named):
    ended, _, err = verb(*arguments)
    assert ended == code
    check_refusal(err.strip(), *named)

"""The loop and the answers of slow devices, in virtual time."""

from types import SimpleNamespace

import pytest

from behaviors.machine import Behavior, StatePlan, on
from controller.guard import Guard, GuardSettings
from controller.loop import Loop, LoopSettings
from controller.rig import Rig
from drivers.core.clock import VirtualClock
from drivers.core.messages import DeviceInfo, MoveTo, Reached, Refused, Stalled, Standstill, Stop


class Mover:
    """Answers each command `delay_s` later, by its id; `reports` are statuses of its own, by their time."""

    name = "stage"

    def __init__(self, clock, delay_s=0.1, reports=()):
        self.clock, self.delay_s, self.reports, self.commands, self.due = (
            clock,
            delay_s,
            list(reports),
            [],
            [],
        )

    def apply(self, command):
        self.commands.append(command)
        kind = Standstill if isinstance(command, Stop) else Reached
        answer = kind(self.clock.now() + self.delay_s, "stage", 0.0, command_id=command.id)
        self.due.append(answer)

    def read(self):
        return ()

    def poll(self):
        now_s = self.clock.now()
        ripe = [status for status in (*self.due, *self.reports) if status.t_s <= now_s]
        self.due = [status for status in self.due if status not in ripe]
        self.reports = [status for status in self.reports if status not in ripe]
        return ripe


class Hasty(Behavior):
    """Sends a second motion before the first is answered."""

    table = (
        on("deadline", "FIRST", "SECOND"),
        on("reached", "SECOND", "DONE"),
    )

    def __init__(self):
        super().__init__({"FIRST": StatePlan(0.05), "SECOND": StatePlan(1.0)}, "stage")

    def enter_FIRST(self):
        self.command(MoveTo("stage", 0.001, 0.01))

    def enter_SECOND(self):
        self.command(MoveTo("stage", 0.002, 0.01))

    def enter_DONE(self):
        self.conclude("contact")


@pytest.fixture
def run():
    def run(delay_s=0.1, reports=()):
        clock = VirtualClock()
        mover = Mover(clock, delay_s, reports)
        stub = SimpleNamespace(
            record=lambda blocks: None,
            failure=None,
            skip=lambda *span: None,
            event=lambda event, **rest: None,
            poll=lambda: None,
            state=lambda name, t_s: None,
        )
        guard = Guard(GuardSettings(travel_m=0.01, position_stream=None, force_stream=None))
        infos = {"stage": DeviceInfo("stage", "a mover", mover=True)}
        loop = Loop(Rig("mock", {"stage": mover}, clock), infos, guard, stub, stub, LoopSettings())
        behavior = Hasty()
        loop.run(behavior, {})
        return loop, mover, behavior

    return run


def test_every_command_has_a_number_of_its_own(run):
    _, mover, _ = run()
    assert [command.id for command in mover.commands] == [1, 2, 3]


def test_the_answer_to_an_older_command_ends_nothing(run):
    loop, _, behavior = run()
    first, second = [event for event in loop.events if isinstance(event, Reached)]
    assert (first.t_s, second.t_s) == pytest.approx((0.10, 0.15)), "both are kept in the record"
    assert dict(loop.visits)["DONE"] == second.t_s
    assert behavior.outcome == "contact"


def test_a_mover_counts_as_moving_until_its_newest_command_is_answered(run):
    loop, _, _ = run(delay_s=0.4)
    # Ten turns until the second command, then 200 a second until its answer: an idle loop would take 50 a second.
    assert loop.account.turns >= 200 * 0.45


def test_a_stall_ends_the_trial_whatever_it_is_about(run):
    _, _, behavior = run(reports=[Stalled(0.07, "stage", "it hit something", command_id=1)])
    assert behavior.outcome == "fault"
    assert "it hit something" in behavior.reason


def test_closing_waits_for_the_standstill_that_it_asked_for(run):
    loop, mover, _ = run(reports=[Standstill(0.16, "stage", 0.0, command_id=1)])
    assert isinstance(mover.commands[-1], Stop)
    assert loop.events[-1].command_id == 3
    assert loop.account.not_at_rest == []


def test_what_was_sent_or_refused_bears_the_number_of_its_command():
    refused = Refused(0.0, "stage", MoveTo("stage", 0.001, 0.01, id=7), "it is busy")
    assert refused.command_id == 7


def test_a_number_does_not_change_what_a_command_asks_for():
    assert MoveTo("stage", 0.001, 0.01, id=7) == MoveTo("stage", 0.001, 0.01)

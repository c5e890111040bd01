"""The base of every behavior: a `transitions` machine that takes events and returns commands."""

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from copy import copy
from dataclasses import dataclass
from functools import cache, partial
from typing import Any, ClassVar, NamedTuple

from transitions import Machine

from behaviors.events import Event, GuardStopped, Tick
from drivers.core.messages import Command, Stop

UNDECIDED = "aborted"
"""The outcome of a trial that no transition concluded."""


@dataclass(frozen=True, slots=True)
class StatePlan:
    """What a state needs from the bench, and for how long.

    Attributes:
        detectors: Names of the detectors that are armed in it. What no state arms is not computed.
        measures: Streams (`device.stream`) that the trial wants recorded in it, input of a detector or not.
        deadline_s: Longest stay; then the trigger `deadline` fires.
        prompt: Whether a decision in it may not wait; where nothing moves and nothing is urgent, the loop may turn
            more slowly.
        commands: What is commanded as it is entered; what depends on the trial's course, `enter_<STATE>` commands.
    """

    deadline_s: float
    detectors: frozenset[str] = frozenset()
    measures: frozenset[str] = frozenset()
    prompt: bool = True
    commands: Sequence[Command] = ()


Condition = Callable[[Any], bool]
"""Asked with the behavior whether a row applies."""

Action = Callable[[Any], object]
"""Called with the behavior before a row's transition."""


class Row(NamedTuple):
    """A row of a behavior's table, as `on` makes it."""

    trigger: str
    sources: Sequence[str]
    dest: str | None
    conditions: Sequence[Condition]
    actions: Sequence[Action]
    label: str


def on(
    trigger: str,
    source: str | Sequence[str],
    dest: str | None,
    *when: Condition,
    do: Action | Sequence[Action] = (),
    label: str = "",
) -> Row:
    """A row: on this event, from one state or any of several, go there.

    A method of the behavior is looked up in its class, so that a subclass may replace it.

    Args:
        trigger: Name of the event: `Contact` is "contact".
        dest: Where to; None stays in the state, which is not entered again.
        when: What must all be True; the first row of several that applies is taken.
        do: What is called before.
        label: What the conditions mean, for the diagram.

    Raises:
        TypeError: a condition or an action cannot be called.
    """
    sources = (source,) if isinstance(source, str) else tuple(source)
    actions = tuple(do) if isinstance(do, tuple | list) else (do,)
    for given in (*when, *actions):
        if not callable(given):
            raise TypeError(f"on({trigger!r}, {source!r}): {given!r} is no function; name it without quotes")
    return Row(trigger, sources, dest, when, actions, label)


class Behavior:
    """One trial of one experiment: events in, commands out; it touches no driver.

    A subclass has a transition table, below the methods that it names. What is commanded as a state is entered stands
    in its plan; where it depends on the trial's course, a method `enter_<STATE>` commands it. States are names; those
    that it has are those of its table, and `FAILED`: it begins in the first row's, and the trial is over in those from
    which no row leads. A trigger is the event's class name in lower case with underscores (`Contact` → `contact`). What
    ends a trial that cannot go on leads to `FAILED` where the table has no row for it (`ending_rows`); any other event
    that the present state has no transition for is ignored. Methods call `self.command(...)`, never a trigger. What a
    trial changes are its behavior's own attributes: in virtual time they are copied, and put back after a look ahead.

    What a profile names is made of the experiment's `settings`, the trial's `factors` and the names of all `detectors`.

    Args:
        plans: What each state needs; the final ones need nothing.
        mover: Device that `from_mover` asks for.
        acting: Detectors whose events the trial acts on: where one of these refuses its baseline, it ends. None: all
            that a state arms. Any other listens, and is missing from the trial's row.

    Attributes:
        notes: What the behavior concluded on the way, by name, for the experiment's measure.
    """

    table: ClassVar[Sequence[Row]]
    rows: ClassVar[Sequence[Row]]
    """The table's, then those that end a trial which cannot go on."""
    states: ClassVar[Sequence[str]]
    """In the order of the table, the final ones last."""
    final: ClassVar[frozenset[str]]
    range_streams: frozenset[str] = frozenset()
    """Streams that must stay in their range in every motion of this trial, beside `limits.range_streams`: for the
    sensor that a trial's factor puts on the mover. Its states name them where they measure them."""

    def __init_subclass__(cls) -> None:
        if "table" in cls.__dict__:
            cls.rows = (*cls.table, *ending_rows(cls.table))
            left = dict.fromkeys(state for row in cls.rows for state in row.sources)
            ends = dict.fromkeys(row.dest for row in cls.rows if row.dest and row.dest not in left)
            cls.states, cls.final = (*left, *ends), frozenset(ends)

    def __init__(
        self, plans: Mapping[str, StatePlan], mover: str = "", acting: frozenset[str] | None = None
    ) -> None:
        wrong = set(plans) ^ (set(self.states) - self.final)
        assert not wrong, f"states without a deadline, or none of the table's: {wrong}"
        self.plans = dict(plans)
        self.check_plans()
        self._mover = mover
        armed = (plan.detectors for plan in plans.values())
        self.acts_on = frozenset().union(*armed) if acting is None else acting
        self.state = self.states[0]
        self.outcome = UNDECIDED
        self.reason = ""
        self.notes: dict[str, list[float]] = {}
        self._entered_s = 0.0
        self._came: dict[str, None] = {}
        self._commands: list[Command] = []
        self._event: Event = Tick(0.0)

    def check_plans(self) -> None:
        """See that each state's deadline can come; whoever makes a behavior asks once more when it is made.

        Raises:
            ValueError: one cannot, with the state's name.
        """
        for state, plan in self.plans.items():
            if not plan.deadline_s >= 0.0:
                raise ValueError(
                    f"{type(self).__name__}: the deadline_s of {state} is {plan.deadline_s}; give seconds, 0 or more"
                )

    @property
    def event(self) -> Event:
        """The event being handled: for conditions and callbacks."""
        return self._event

    @property
    def done(self) -> bool:
        """Whether the trial has ended."""
        return self.state in self.final

    @property
    def plan(self) -> StatePlan:
        """What the present state needs."""
        return self.plans.get(self.state, StatePlan(math.inf))

    @property
    def foreseen(self) -> Mapping[str, Sequence[StatePlan]]:
        """The plans that each state may have in this trial; several, or others later on, for kinds that change them."""
        return {state: (plan,) for state, plan in self.plans.items()}

    @property
    def deciding(self) -> Sequence[str]:
        """Detectors whose events end the present state, the foremost first; where it arms none of those that the trial
        acts on, all of these. What a person is shown first."""
        return sorted(self.acts_on & self.plan.detectors) or sorted(self.acts_on)

    @property
    def wake_s(self) -> float:
        """Bench time of the next tick: before it nothing happens by itself."""
        return min(self._deadline_s, self.due_s)

    @property
    def due_s(self) -> float:
        """Bench time at which the present state does something by itself before its deadline: for kinds that do."""
        return math.inf

    @property
    def _deadline_s(self) -> float:
        return self._entered_s + self.plan.deadline_s

    def begin(self, t_s: float) -> Sequence[Command]:
        """Enter the initial state at bench time `t_s`."""
        self._event = Tick(t_s)
        self._entered()
        return self._taken()

    def handle(self, event: Event) -> Sequence[Command]:
        """Handle one event; returns the commands that follow from it, in order. Ticks come from `wake_s` on."""
        self._event = event
        if isinstance(event, Tick):
            # The turn at the deadline is the first one not before it, whatever the last bit of the sum.
            if event.t_s >= self._deadline_s - 1e-9:
                self._fire("deadline")
        else:
            trigger, source = trigger_of(event), _source(event)
            self._came[trigger.replace("_", " ") + (f" of {source}" if source else "")] = None
            self._fire(trigger)
        return self._taken()

    def rehearse(self, state: str) -> Sequence[Command]:
        """What a state commands when it is entered, as far as that needs nothing that the trial has yet to see; this
        behavior stays where it is."""
        twin = copy(self)
        twin.state, twin._event, twin._commands = state, Tick(0.0), []
        with suppress(Exception):  # of a place or an event that is not known yet
            twin._entered()
        return twin._taken()

    def command(self, command: Command) -> None:
        """Queue a command; for callbacks.

        Raises:
            TypeError: it is none.
        """
        if not isinstance(command, Command):
            raise TypeError(
                f"{type(self).__name__} commanded {command!r} in {self.state}; a command is one of "
                f"drivers.core.messages"
            )
        self._commands.append(command)

    def conclude(self, outcome: str, reason: str = "") -> None:
        """Set the outcome of the trial; the first one stands, unless something fails later."""
        if self.outcome == UNDECIDED:
            self.outcome, self.reason = outcome, reason

    def came_from(self, source: str) -> bool:
        """Whether the event is of this device or detector."""
        return _source(self.event) == source

    def decisive(self) -> bool:
        """Whether the event is of a detector that the trial acts on."""
        return _source(self.event) in self.acts_on

    def conclude_fault(self) -> None:
        """Before a transition that ends the trial: the guard stopped it, or a device or detector could not go on."""
        self.outcome, self.reason = verdict_of(self.event)

    def conclude_late(self) -> None:
        """Before a transition on a deadline: the awaited event did not come, and nothing is wrong with the bench."""
        self.outcome = "aborted"
        came = ", ".join(self._came) or "nothing"
        self.reason = (
            f"{self.state} took longer than {self.plan.deadline_s:.6g} s:"
            f" it waited for {self._awaited()}; {came} came"
        )

    @property
    def answering(self) -> str:
        """The device whose answer the present state waits for, or ""."""
        return self._mover

    def _awaited(self) -> str:
        """The events that would have ended the present state in time, and their sources."""
        triggers = [row.trigger for row in self.rows if self.state in row.sources]
        events = dict.fromkeys(each.replace("_", " ") for each in triggers if each not in _NOT_AWAITED)
        awaited = sorted(self.plan.detectors) + [self.answering] * bool(self.answering)
        return " or ".join(events) + (f" of {', '.join(awaited)}" if awaited else "")

    def conclude_stuck(self) -> None:
        """Before a transition on the deadline of a motion: a device did not do its part."""
        self.conclude_late()
        self.outcome = "fault"

    def enter_FAILED(self) -> None:
        """Nothing moves after an error."""
        if self._mover:
            self.command(Stop(self._mover))

    def _fire(self, trigger: str) -> None:
        triggers = _machine(type(self)).events  # type: ignore[arg-type]  # mypy takes no class for hashable
        if trigger in triggers:
            triggers[trigger].trigger(self, self)

    def _entered(self) -> None:
        self._entered_s = self._event.t_s
        self._came.clear()
        for command in self.plan.commands:
            self.command(command)
        enter = getattr(self, f"enter_{self.state}", None)
        if enter is not None:
            enter()

    def _taken(self) -> Sequence[Command]:
        taken, self._commands = self._commands, []
        return taken


def from_mover(behavior: Behavior) -> bool:
    """Whether the status is the mover's."""
    return behavior.came_from(behavior._mover)


def sent_by(setting: str) -> Condition:
    """Whether the event is of the device or detector that a setting names: `sent_by("operator")`."""
    return lambda behavior: bool(behavior.came_from(getattr(behavior.settings, setting)))


def concluding(outcome: str, reason: str = "") -> Action:
    """Concludes the trial so, before a row's transition; see `Behavior.conclude`."""
    return partial(Behavior.conclude, outcome=outcome, reason=reason)


@cache
def _machine(kind: type[Behavior]) -> Machine:
    """The machine of a kind of behavior: one for all its trials, for making it takes a tenth of a short one."""

    def its_own(methods: Sequence[Callable[[Any], Any]]) -> list[Callable[[Any], Any]]:
        return [getattr(kind, getattr(method, "__name__", ""), method) for method in methods]

    rows = [
        {"trigger": row.trigger, "source": list(row.sources), "dest": row.dest}
        | {"conditions": its_own(row.conditions), "before": its_own(row.actions)}
        | ({} if row.dest is None else {"after": Behavior._entered})
        for row in kind.rows
    ]
    return Machine(
        model=None,
        states=list(kind.states),
        transitions=rows,
        initial=kind.states[0],
        auto_transitions=False,
        ignore_invalid_triggers=True,
    )


def ending_rows(table: Sequence[Row]) -> Sequence[Row]:
    """From each state of a table to `FAILED`: what ends a trial that cannot go on, unless a row of the table does.

    A failed device, a refused baseline of an acting detector or a guard stop fails the trial. So does a deadline
    in a state that has no unconditional row for it: a device did not do its part.
    """
    alive = list(dict.fromkeys(state for row in table for state in row.sources))
    resting = {
        state for row in table if row.trigger == "deadline" and not row.conditions for state in row.sources
    }
    waiting = [state for state in alive if state not in resting]
    fault = Behavior.conclude_fault
    return (
        *(on(trigger, alive, "FAILED", do=fault) for trigger in _BROKEN),
        on("baseline_refused", alive, "FAILED", Behavior.decisive, do=fault, label="decisive"),
        on("guard_stopped", alive, "FAILED", do=fault),
        *([on("deadline", waiting, "FAILED", do=Behavior.conclude_stuck)] if waiting else []),
    )


def verdict_of(event: Event) -> tuple[str, str]:
    """Outcome and reason of a trial that an event ended: "guard" of the guard's stop, "fault" of all else."""
    reason = getattr(event, "reason", "")
    if isinstance(event, GuardStopped):
        return "guard", reason
    return "fault", f"{_source(event)} {trigger_of(event).replace('_', ' ')}: {reason}"


_BROKEN = ("refused", "stalled", "failed")
_NOT_AWAITED = frozenset(("deadline", "resumed", "guard_stopped", "baseline_refused", *_BROKEN))


def _source(event: Event) -> str:
    """The device or detector that an event is of, or ""."""
    return str(getattr(event, "device", getattr(event, "detector", "")))


def trigger_of(event: Event) -> str:
    """Name of the trigger that an event pulls: its class in snake case."""
    return _snake(type(event).__name__)


@cache
def _snake(name: str) -> str:
    return "".join(f"_{c.lower()}" if c.isupper() else c for c in name).lstrip("_")

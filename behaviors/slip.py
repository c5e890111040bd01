"""B8: touch, roll, slip, stop, and what a force sensor makes of it (Fernandez et al., sections 4.3 and 5)."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from copy import copy
from dataclasses import replace
from functools import partial
from itertools import pairwise
from typing import Annotated, Literal, Self

from pydantic import Field, Strict, model_validator

from behaviors.approach import TipTrial, TipTrialSettings, approaching
from behaviors.machine import Action, Row, StatePlan, from_mover, on
from drivers.core.messages import Command, Home, MoveAt, Standstill, Stop, Tare, Twist
from drivers.core.settings import DetectorName, Settings, StreamName

SensorName = Literal["fingertip", "flexible_finger", "barrett_finger", "wrist", "dsa"]


class StepSettings(Settings):
    """One thing that the pressed tip does."""

    do: Literal["hold", "load", "roll", "slip"]
    """Hold still, drag without slipping, roll on the table, or slide along it."""

    duration_s: float = Field(gt=0.0, le=60.0)
    """How long."""

    turn_rad: float = Field(default=0.0, ge=-3.0, le=3.0)
    """Angle to roll by, for `roll`."""

    speed_m_s: float = Field(default=0.0, ge=-0.25, le=0.25)
    """Speed along the table, either way, for `load` and `slip`."""

    @model_validator(mode="after")
    def _complete(self) -> Self:
        turns, goes = self.do == "roll", self.do in ("load", "slip")
        if turns != (self.turn_rad != 0.0) or goes != (self.speed_m_s != 0.0):
            raise ValueError("a roll needs turn_rad, a load and a slip speed_m_s: each its own, and not 0")
        return self


class SensorRunSettings(Settings):
    """What one sensor is put through, and its detectors."""

    stream: StreamName
    """What it sends."""

    channel: int | None = Field(default=None, ge=0, le=4095)
    """Channel in which slip is looked for; None takes the one that decides in each block."""

    forces_stream: StreamName | None = None
    """Its calibrated forces, where there are such; recorded, and watched for overload in every motion."""

    touch: DetectorName
    """Detector that sees the table: it ends the descent."""

    paper: DetectorName | None
    """The paper's slip detector on this sensor; a trial does without one that is "none"."""

    ours: DetectorName | None
    """Ours; likewise."""

    listen: Literal["rest", "motion"] = "rest"
    """From when the slip detectors are armed: from rest in the air, or from the first step in which the pressed tip
    moves. A detector that learns the noise learns it there."""

    tilt_rad: float = Field(default=0.0, ge=-1.5, le=1.5)
    """Angle of the tip at touch, about base y."""

    press_m: float = Field(gt=0.0, le=0.01)
    """How far to press on after the touch."""

    steps: Annotated[tuple[StepSettings, ...], Strict(False), Field(min_length=1)]
    """What follows, in order; never the same twice in a row."""

    @model_validator(mode="after")
    def _in_turn(self) -> Self:
        if any(step.do == after.do for step, after in pairwise(self.steps)):
            raise ValueError("steps: two of a kind follow each other; make one of them, or hold in between")
        return self


class RollSlipSettings(TipTrialSettings):
    """How a trial is run."""

    position_stream: StreamName = "arm.position"
    """Where it is on the approach axis (m)."""

    force_stream: StreamName = "arm.force"
    """What acts on its tool (N)."""

    measures: Annotated[tuple[StreamName, ...], Strict(False)] = ()
    """Streams that are recorded in every trial, beside those of its sensor."""

    sensors: dict[SensorName, SensorRunSettings] = Field(min_length=1)
    """What is done with which sensor."""

    radius_m: float = Field(default=0.012, gt=0.0, le=0.2)
    """Radius of the tip's cylinder, about whose axis the arm turns the tool: rolling moves it by radius x angle."""

    stop_on_slip: bool = False
    """Whether the arm stops at once when the `reflex` detector reports slip; the paper's never does."""

    reflex: Literal["paper", "ours"] = "ours"
    """Whose detector that is."""

    zero_s: float = Field(default=0.2, gt=0.0, le=10.0)
    """Time for the arm's force sensor to be zeroed in (assumption)."""

    rest_s: float = Field(default=0.93, gt=0.0, le=600.0)
    """Wait before the descent; with a 3 mm gap at 2 mm/s the contact is at the paper's 2.43 s (Fig. 8)."""

    tilt_rad_s: float = Field(default=0.2, gt=0.0, le=3.0)
    """Speed of tilting the tip in the air."""

    stopped_s: float = Field(default=0.5, gt=0.0, le=60.0)
    """How long is recorded after a stop on slip."""

    missed_after_s: float = Field(default=0.75, gt=0.0, le=60.0)
    """A slip that is not detected by then is missed: the shortest that the paper shows lasts so long (Fig. 15)."""


class RollSlipFactors(Settings):
    """What a trial varies."""

    sensor: SensorName
    """Which sensor the tip carries. On a real bench it is changed by hand, between runs: no run asks for it."""


_STATES = {"hold": "HOLDING", "load": "LOADING", "roll": "ROLLING", "slip": "SLIPPING"}
"""In which state the arm does a step."""

_PRESSED = ("PRESSING", *_STATES.values())


def _steps(next_is: Callable[..., bool], take_step: Action) -> Iterator[Row]:
    """Rows from each state of the pressed tip to whatever step comes next, and from the last one up."""
    for state in _PRESSED:
        when = () if state == "HOLDING" else (from_mover,)
        trigger = "reached" if when else "deadline"
        for do, following in _STATES.items():
            if following != state:
                comes = partial(next_is, do=do)
                label = f"next: {following.lower()}"
                yield on(trigger, state, following, *when, comes, do=take_step, label=label)
        if state != "PRESSING":
            yield on(trigger, state, "LIFTING", *when)


class RollSlip(TipTrial):
    """Touch, press, then roll, slide and hold by the sensor's steps; lift and go home.

    Args:
        detectors: Names of all detectors there are; only the trial's sensor's are armed.
    """

    settings: RollSlipSettings

    def __init__(
        self, settings: RollSlipSettings, factors: RollSlipFactors, detectors: frozenset[str]
    ) -> None:
        self.settings = settings
        self.factors = factors
        self.run = settings.sensors[factors.sensor]
        self._slips = [name for name in (self.run.ours, self.run.paper) if name in detectors]
        reflex = self.run.ours if settings.reflex == "ours" else self.run.paper
        if settings.stop_on_slip and reflex not in detectors:
            raise ValueError(
                f"stop_on_slip = true waits for reflex = {settings.reflex}, which {factors.sensor} has not; "
                "name the other, or write stop_on_slip = false"
            )
        self._reflex = "" if reflex is None else reflex
        if self.run.forces_stream is not None:
            self.range_streams = frozenset({self.run.forces_stream})
        self._begin_steps()
        acting = {self.run.touch, *([self._reflex] if settings.stop_on_slip else [])}
        super().__init__(self._planned(), settings.mover, frozenset(acting))

    def _begin_steps(self) -> None:
        self._step = -1
        self._turned_rad = 0.0
        self._anew = False

    def _planned(self) -> Mapping[str, StatePlan]:
        settings, run = self.settings, self.run
        motion = settings.motion_timeout_s
        measured = frozenset(
            stream
            for stream in (
                run.stream,
                run.forces_stream,
                settings.position_stream,
                settings.pose_stream,
                settings.force_stream,
                *settings.measures,
            )
            if stream is not None
        )
        listening = StatePlan(motion, self._armed(-1), measured)
        quiet = replace(listening, prompt=False)
        return {
            "HOMING": StatePlan(settings.home_timeout_s),
            # nothing touches: what the arm feels now is zero
            "ZEROING": StatePlan(settings.zero_s, commands=[Tare(settings.mover, settings.force_stream)]),
            "TILTING": StatePlan(2.0 * math.pi / settings.tilt_rad_s + motion),
            "RESTING": replace(quiet, deadline_s=settings.rest_s),
            "DESCENDING": self.descent(run.touch, listening),
            "STOPPING": listening,
            "PRESSING": listening,
            "HOLDING": quiet,
            "LOADING": listening,
            "ROLLING": listening,
            "SLIPPING": listening,
            "HALTING": replace(listening, detectors=frozenset((run.touch, *self._slips))),
            "STOPPED": replace(quiet, deadline_s=settings.stopped_s),
            "LEVELLING": StatePlan(2.0 * math.pi / settings.tilt_rad_s + motion),
            **self.ending(),
        }

    def _armed(self, step: int) -> frozenset[str]:
        """The detectors armed in a step, -1 before the first one: those of slip from the first that is no hold."""
        run = self.run
        begun = run.listen == "rest" or any(each.do != "hold" for each in run.steps[: step + 1])
        return frozenset((run.touch, *self._slips) if begun else (run.touch,))

    def _step_plan(self, number: int) -> StatePlan:
        """What the state of a step needs: it ends with it."""
        step = self.run.steps[number]
        more_s = 0.0 if step.do == "hold" else self.settings.motion_timeout_s
        return replace(
            self.plans[_STATES[step.do]], deadline_s=step.duration_s + more_s, detectors=self._armed(number)
        )

    @property
    def foreseen(self) -> Mapping[str, Sequence[StatePlan]]:
        """See `Behavior.foreseen`: a state of steps has the plan of each of them."""
        found: dict[str, Sequence[StatePlan]] = {**super().foreseen, **dict.fromkeys(_STATES.values(), ())}
        for number, step in enumerate(self.run.steps):
            found[_STATES[step.do]] = (*found[_STATES[step.do]], self._step_plan(number))
        return found

    def rehearse(self, state: str) -> Sequence[Command]:
        """See `Behavior.rehearse`: a state of steps commands each of them."""
        if state not in _STATES.values():
            return super().rehearse(state)
        rehearsed: list[Command] = []
        for number, step in enumerate(self.run.steps):
            if _STATES[step.do] == state:
                twin = copy(self)
                twin._step = number
                rehearsed += super(RollSlip, twin).rehearse(state)
        return rehearsed

    @property
    def deciding(self) -> Sequence[str]:
        """Until contact the touch's; then the one that stops the arm on slip, or would."""
        before = self.state in ("HOMING", "ZEROING", "TILTING", "RESTING", "DESCENDING", "STOPPING")
        if before or not self._slips:
            return (self.run.touch,)
        return (self._reflex if self._reflex in self._slips else self._slips[0],)

    def turned(self) -> bool:
        """Whether the tip is at an angle, as far as is known."""
        return abs(self._turned_rad) > 1e-3

    def anew(self) -> bool:
        """Whether the trial begins again once the tip is off the table."""
        return self._anew

    def must_stop(self) -> bool:
        """Whether this slip stops the arm."""
        return self.settings.stop_on_slip and self.came_from(self._reflex)

    def _next_is(self, do: str) -> bool:
        """Whether such a step comes next."""
        following = self._step + 1
        return following < len(self.run.steps) and self.run.steps[following].do == do

    def take_step(self) -> None:
        """The next step is the present one; its state ends with it."""
        self._step += 1
        self.plans[_STATES[self.run.steps[self._step].do]] = self._step_plan(self._step)

    def cut_step(self) -> None:
        """A roll that is stopped has turned the tip by a part of its angle."""
        step = self.run.steps[self._step]
        done = (self.event.t_s - self._entered_s) / step.duration_s
        self._turned_rad -= step.turn_rad * (1.0 - min(1.0, max(0.0, done)))

    def begin_anew(self) -> None:
        """Paused in the descent: a contact is ignored while paused, so the tip may stand on the table."""
        self._anew = True

    def conclude_interrupted(self) -> None:
        """Paused in contact: what was pressed and rolled cannot be taken up again."""
        if self.state == "ROLLING":
            self._turned_rad = 0.0  # broken off somewhere: `Home` turns back what there is, and no more
        self.outcome = "aborted"
        self.reason = f"paused in {self.state}; run this trial again"

    def enter_HOMING(self) -> None:
        """Begin at the start pose."""
        self._begin_steps()
        self.command(Home(self.settings.mover))

    def enter_TILTING(self) -> None:
        """Turn the tip in the air."""
        self._turn(self.run.tilt_rad)

    def enter_LEVELLING(self) -> None:
        """Turn back: `Home` turns as slowly as it goes."""
        self._turn(-self._turned_rad)

    def _turn(self, turn_rad: float) -> None:
        self.turn(turn_rad, self.settings.tilt_rad_s)
        self._turned_rad += turn_rad

    def enter_PRESSING(self) -> None:
        """From where the arm stood still after the touch, as far as the sensor is pressed in its trial."""
        assert isinstance(self.event, Standstill)
        limit_m = self.event.position_m + self.run.press_m
        self.command(MoveAt(self.settings.mover, self.settings.descend_m_s, limit_m))

    def enter_ROLLING(self) -> None:
        """Turn, and go along by as much as the tip unrolls."""
        step = self.run.steps[self._step]
        turn_rad_s = step.turn_rad / step.duration_s
        self._turned_rad += step.turn_rad
        along_m_s = self.settings.radius_m * turn_rad_s
        self.command(Twist(self.settings.mover, (along_m_s, 0.0, 0.0, 0.0, turn_rad_s, 0.0), step.duration_s))

    def enter_LOADING(self) -> None:
        """Along the table, so little that the tip only bends."""
        self.enter_SLIPPING()

    def enter_SLIPPING(self) -> None:
        """Along the table, without turning."""
        step = self.run.steps[self._step]
        self.command(Twist(self.settings.mover, (step.speed_m_s, 0.0, 0.0, 0.0, 0.0, 0.0), step.duration_s))

    def enter_HALTING(self) -> None:
        """Slip: stop at once."""
        self.command(Stop(self.settings.mover))

    table = (
        on("reached", "HOMING", "ZEROING", from_mover),
        on("deadline", "ZEROING", "TILTING", lambda it: it.run.tilt_rad != 0.0, label="tilted touch"),
        on("deadline", "ZEROING", "RESTING"),
        on("reached", "TILTING", "RESTING", from_mover),
        on("deadline", "RESTING", "DESCENDING"),
        *approaching("DESCENDING", stopped="PRESSING", missed="LIFTING"),
        *_steps(_next_is, take_step),
        on(
            "slip_started",
            ["LOADING", "ROLLING", "SLIPPING"],
            "HALTING",
            must_stop,
            do=cut_step,
            label="stop_on_slip",
        ),
        on("standstill", "HALTING", "STOPPED", from_mover),
        on("deadline", "STOPPED", "LIFTING"),
        on("reached", "LIFTING", "HOMING", from_mover, anew, label="after a pause in the descent"),
        on("reached", "LIFTING", "LEVELLING", from_mover, turned, label="tip at an angle"),
        on("reached", "LIFTING", "RETURNING", from_mover),
        on("reached", "LEVELLING", "RETURNING", from_mover),
        on("reached", "RETURNING", "DONE", from_mover),
        on("resumed", ["HOMING", "ZEROING", "TILTING", "RESTING"], "HOMING"),
        on("resumed", "DESCENDING", "LIFTING", do=begin_anew),
        on("resumed", ["STOPPING", *_PRESSED, "HALTING", "STOPPED"], "LIFTING", do=conclude_interrupted),
        on("resumed", ["LIFTING", "LEVELLING", "RETURNING"], "LIFTING"),
    )

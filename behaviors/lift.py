"""Lift what the jaws hold, hold it with little more than the least force, set it down again: a part of a trial."""

import math
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from typing import Annotated, Any, Literal

from pydantic import Field, Strict

from behaviors.events import Event, LoadChanged
from behaviors.grip import Gripping, GripSettings
from behaviors.machine import Row, StatePlan, from_mover, on
from behaviors.sonic import Place
from drivers.core.messages import Command, Grip, Gripped, Stop, Twist
from drivers.core.settings import DetectorName, Mismatch, Settings, StreamName

_AIR = ("LIFTING", "SHAKING", "HOLDING")
_UP = ("LOADING", *_AIR)

LATELY_S = 0.06
"""A slip is told so long after it began at the most, and its load counts; so long the jaws need to press harder.
Assumption: twice what is usual."""

UNLOADS = 0.75
"""A finger that carries less than this share of what it carried lately is unloaded: no slip does that (assumption:
friction of what slides is less by a tenth at the most)."""

SUDDEN = 1.12
"""A load that has grown or fallen by this factor lately has jumped: what is held swings, and knocks (assumption: a
start of the arm at 0.5 m/s^2 and its swing give 1.1)."""

ACTED_S = 0.25
"""For so long after the jaws have acted on a slip, or press less hard, what is told is of that. Assumption: a slip is
told to be over 0.15 s after it is."""

KNOCK_MARGIN = 1.02
"""Margin over a load that swings: its peak lasts for some 20 ms, and a grip with the whole margin over it crushes."""

LOOSEN, LOOSEN_S = 0.94, 0.03
"""The jaws press less hard by such a share at a time, and so often: at once, they would swing below."""


class LiftSettings(GripSettings):
    """How an object is lifted and held."""

    pose_stream: StreamName = "arm.pose"
    """Where the tool is (m and rad, base frame)."""

    load_m: float = Field(default=0.004, ge=0.0, le=0.1)
    """Length of the first part of the lift, in which the pads take up the weight. Assumption: they give 2.3 mm under 1
    kg on the simulated bench."""

    load_speed_m_s: float = Field(default=0.002, gt=0.0, le=0.25)
    """Its speed: so slow that what slips then has not gone far, and that taking up the weight is no knock."""

    lift_m: float = Field(default=0.02, gt=0.0, le=0.5)
    """How far up."""

    lift_speed_m_s: float = Field(default=0.01, gt=0.0, le=0.25)
    """Speed of lifting and setting down."""

    shake_m_s: float = Field(default=0.0, ge=0.0, le=1.0)
    """Speed that the shake in the air is reversed to, up and down; 0 is no shake. Where the arm takes half a period for
    that, its way is of parabolas, 4 % off a sine's."""

    shake_hz: float = Field(default=2.5, gt=0.0, le=10.0)
    """How often."""

    shake_s: float = Field(default=2.0, gt=0.0, le=60.0)
    """How long; whole periods end at rest."""

    force_stream: StreamName = "arm.force"
    """What the arm carries (N, third channel upwards)."""

    weight_n: float | None = Field(default=None, gt=0.0, le=1000.0)
    """What the object weighs, where somebody weighed it: on a real bench a lift is known by it to have succeeded."""

    slip: Annotated[tuple[DetectorName, ...], Strict(False)] = ()
    """Detectors of slip between finger and object, upon which the jaws press harder."""

    load: Annotated[tuple[DetectorName, ...], Strict(False)] = ()
    """Detectors of the load that a finger carries; where there is one, the grip follows the load by the friction that
    slips have shown."""

    rule: Literal["friction", "step"] = "friction"
    """How much harder upon a slip. `friction`: as load and least friction seen ask for, times `margin`; in the air at
    once `boost` times as hard, then back to that. `step`: `tighten_n` more, again and again while it slips."""

    plateau_s: float = Field(default=0.3, ge=0.0, le=10.0)
    """A load that has not grown for so long while the arm rises slowly is of what slips, all of it, or hangs; while the
    friction is unknown, and at the limit, it counts as a slip. No slip that is told while the weight is taken up counts
    before: a part of a pad slips then. 0 for never: a slip that is told counts. Where all but the last part of a pad
    has slipped, a load still grows by a step of the detector's within that. Chosen in benchmarks/grasp."""

    margin: float = Field(default=1.18, ge=1.0, le=10.0)
    """What the grip is set to, over what load and friction ask for. Chosen in benchmarks/grasp."""

    moving_margin: float = Field(default=1.3, ge=1.0, le=10.0)
    """The same of the load at rest while the arm lifts and shakes it: what swings is heavier at times. Likewise."""

    jaws_n: float = Field(default=0.0, ge=0.0, le=100.0)
    """Dry friction of the gripper's drive: so much less than is commanded the jaws press when they were made to press
    harder, so much more when less hard. Half of the difference that a scale between them shows."""

    boost: float = Field(default=1.65, ge=1.0, le=10.0)
    """The same upon a slip in the air, or a load that jumps: what slides has to be braked as well. Likewise."""

    least_friction: float = Field(default=0.1, ge=0.0, le=10.0)
    """Objects have more: a slip that is told while a finger carries less than this share of the grip is a knock."""

    limit: float = Field(default=0.97, gt=0.0, le=1.0)
    """A finger that carries this share of what friction bears slips, or is about to: then, in the air, `boost` at once.
    Likewise."""

    credible: float = Field(default=0.7, ge=0.0, le=1.0)
    """A slip that is told while a finger carries less than this share of it is a knock, and so is any for `knock_s`
    after the arm begins or ends a motion, while it shakes, and after the jaws have pressed harder at once: then `limit`
    alone counts. Likewise."""

    knock_s: float = Field(default=0.4, ge=0.0, le=10.0)
    """See `credible`. Assumption: until what is held has ceased to swing in the pads."""

    relax_s: float = Field(default=0.3, gt=0.0, le=60.0)
    """How long after the jaws pressed harder they may press less hard. Likewise."""

    tighten_n: float = Field(default=2.0, gt=0.0, le=100.0)
    """The step of `step`. Assumption: a fifth of a grip of 10 N."""

    tighten_s: float = Field(default=0.05, gt=0.0, le=10.0)
    """How long a slip may go on before the jaws press harder still."""

    tighten_speed_m_s: float = Field(default=0.1, gt=0.0, le=1.0)
    """Speed that the jaws are asked for then: what stands in their way keeps them from it, and a gripper's speed loop
    raises its force the sooner the more it is off."""

    tightest_n: float = Field(default=14.0, gt=0.0, le=500.0)
    """How hard at the most; the guard's `grip_n` holds besides."""

    def mismatches(
        self, path: tuple[str, ...], profile: Mapping[tuple[str, ...], Settings]
    ) -> Iterator[Mismatch]:
        """What a slip asks for in the air must not be refused there."""
        yield from super().mismatches(path, profile)
        least_n, most_n = self.grip_force_n, self.forces_n(profile)[1]
        if not least_n <= self.tightest_n <= most_n:
            mistake = (
                f" = {self.tightest_n}: upon a slip {self.gripper} presses with grip_force_n = {least_n} or more, and"
                f" {most_n:.3g} N at the most; write one of those"
            )
            yield Mismatch(path, "tightest_n", mistake)
        limits: Any = profile.get(("limits",))
        if limits is not None:
            most_m_s = limits.movers.get(self.gripper, limits).speed_m_s
            for key, most, name in (
                ("tighten_speed_m_s", most_m_s, "speed_m_s"),
                ("tightest_n", limits.grip_n, "grip_n"),
            ):
                if (asked := getattr(self, key)) > most:
                    mistake = f" = {asked}: more than [limits] {name} = {most}; lower it to that"
                    yield Mismatch(path, key, mistake)


def lifting_plans(
    settings: LiftSettings, contacts: frozenset[str], measures: frozenset[str]
) -> Mapping[str, StatePlan]:
    """What these states need: the detectors of slip and of load, and what is measured; where none tells the load, those
    of contact tell what is held."""
    feeling = frozenset(settings.slip) | frozenset(settings.load)
    seen = frozenset({settings.width_stream, settings.pose_stream, settings.force_stream})
    if not settings.load:
        feeling, seen = feeling | contacts, seen | measures

    def held(duration_s: float) -> StatePlan:
        return StatePlan(duration_s, feeling, seen)

    way_s = settings.lift_m / settings.lift_speed_m_s + settings.load_m / settings.load_speed_m_s
    return {
        "LOADING": held(way_s + settings.motion_timeout_s),
        "LIFTING": held(way_s + settings.motion_timeout_s),
        "SHAKING": held(settings.shake_s),
        "HOLDING": held(settings.hold_s),
        "LOWERING": StatePlan(way_s + settings.motion_timeout_s, frozenset(), seen),
    }


class Lifting(Gripping):
    """What `LIFTING` asks and commands."""

    settings: LiftSettings
    _force_n = 0.0
    _load_n = _lifted_n = _most_n = 0.0
    _friction = math.inf
    """The least share of the grip that a finger carried when it slipped."""
    _slipping: frozenset[str] = frozenset()
    _tighten_due_s = math.inf
    _plateau_due_s = math.inf
    _relax_due_s = math.inf
    _calm_s = _still_s = _boosted_s = _acted_s = _grew_s = -math.inf
    _shake_due_s = math.inf
    _shake_up = False

    @property
    def due_s(self) -> float:
        """When the jaws press harder unless the slip is over by then, or less hard; when the shake is reversed."""
        tighten_s = self._tighten_due_s if self._slipping and self.state in _UP else math.inf
        relax_s = max(self._relax_due_s, self._calm_s) if self.state in _UP else math.inf
        shake_s = self._shake_due_s if self.state == "SHAKING" else math.inf
        plateau_s = self._plateau_due_s if self.state == "LOADING" else math.inf
        return min(tighten_s, relax_s, shake_s, plateau_s)

    def handle(self, event: Event) -> Sequence[Command]:
        """Handle one event, and what is due by then."""
        commands = [*super().handle(event)]
        if event.t_s < self.due_s - 1e-9:
            return commands
        now_s = event.t_s + 1e-9
        if self.state == "SHAKING" and now_s >= self._shake_due_s:
            commands += self._shaken(event.t_s)
        if self.state == "LOADING" and now_s >= self._plateau_due_s:
            self._plateau_due_s = math.inf
            share = self._load_n / self._force_n
            if share >= self.settings.least_friction and self._uses(share, self.settings.limit):
                self._note_friction(event.t_s, share)
                commands += self._answered(self._wanted_n, event.t_s)
        if self._slipping and now_s >= self._tighten_due_s:
            commands += self._tightened(event.t_s)
        if self.state in _UP and now_s >= max(self._relax_due_s, self._calm_s):
            commands += self._loosened(event.t_s)
        return commands

    def _loosened(self, t_s: float) -> Sequence[Command]:
        """Press less hard, a step."""
        wanted_n, step_n = self._wanted_n, LOOSEN * self._force_n
        self._relax_due_s = t_s + LOOSEN_S if wanted_n < step_n else math.inf
        return self._pressed(max(wanted_n, step_n), t_s) if wanted_n < self._force_n else []

    @property
    def deciding(self) -> Sequence[str]:
        """In the air, what detects slip first."""
        up = self.state in _UP
        return sorted(super().deciding, key=lambda name: up != (name in self.settings.slip))

    def dropped(self) -> bool:
        """Whether the jaws report that they hold nothing."""
        return isinstance(self.event, Gripped) and not self.event.object

    def shaking(self) -> bool:
        """Whether there is a shake."""
        return self.settings.shake_m_s > 0.0

    @property
    def _wanted_n(self) -> float:
        """What load and friction ask for; the present grip while one of them is unknown."""
        if not self.settings.load or math.isinf(self._friction):
            return self._force_n
        margin = self.settings.margin if self.event.t_s >= self._calm_s else KNOCK_MARGIN
        rest_n = 0.0
        if self.state in ("LIFTING", "SHAKING") or self.event.t_s < self._still_s:
            rest_n = self.settings.moving_margin * self._lifted_n
        return max(margin * self._load_n, rest_n) / self._friction

    @property
    def _share(self) -> float:
        """The largest share of the grip that a finger carried lately, now included."""
        present = self._load_n / self._force_n
        return max((n for t_s, _, n in self._loads if t_s >= self.event.t_s - LATELY_S), default=present)

    def _uses(self, share: float, limit: float) -> bool:
        """Whether a finger that carries this share of the grip carries at least `limit` of what the least friction seen
        bears; so it does while that is unknown."""
        return not self.settings.load or math.isinf(self._friction) or share >= limit * self._friction

    def credible(self) -> bool:
        """Whether a finger carries so much that it may slip."""
        if not self.settings.load:
            return True
        grows = math.isinf(self._friction) or self.event.t_s < self._grew_s + self.settings.plateau_s
        if self.state == "LOADING" and self.settings.plateau_s > 0.0 and grows:
            return False  # one patch may slip before all does
        lately_n = max((n for t_s, n, _ in self._loads if t_s >= self.event.t_s - LATELY_S), default=0.0)
        if self._load_n < UNLOADS * lately_n or self._share < self.settings.least_friction:
            return False
        return self._uses(self._share, self.settings.credible)

    def _jumps(self) -> bool:
        """Whether the load has changed suddenly."""
        since_s = self.event.t_s - LATELY_S
        lately_n = [n for t_s, n, _ in self._loads if t_s >= since_s]
        lately_n += [n for t_s, n, _ in self._loads if t_s < since_s][-1:]
        return max(lately_n) > SUDDEN * max(min(lately_n), 1e-9)

    def _beyond(self) -> bool:
        """Whether a finger carries what friction just bears, or suddenly so much more that it soon will."""
        if self.state not in _AIR or self.event.t_s < self._still_s or math.isinf(self._friction):
            return False
        jumps = self._jumps() and self._load_n > SUDDEN * self._lifted_n
        return jumps or self._uses(self._load_n / self._force_n, self.settings.limit)

    def expect_knock(self, lasting_s: float = 0.0) -> None:
        """What is held is about to be shaken, not to slip."""
        self._calm_s = max(self._calm_s, self.event.t_s + lasting_s + self.settings.knock_s)

    def move_it(self, lasting_s: float = 0.0) -> None:
        """The arm is about to shake what is held."""
        self.expect_knock(lasting_s)
        self._still_s = self._calm_s

    def note_slip(self) -> None:
        """Something seems to slip."""
        if not self._slipping:
            self._tighten_due_s = self.event.t_s
        self._slipping |= {self._detector}

    def _note_friction(self, t_s: float, share: float) -> None:
        """The share of the grip that a finger carried shows the friction."""
        if self.settings.load and share > 0.0:
            self._friction = min(self._friction, share)
            self.notes.setdefault("friction", []).append(self._friction)
        self.notes.setdefault("told_s", []).append(t_s)
        self._acted_s = t_s

    def note_held(self) -> None:
        """The slip that a detector reported is over."""
        self._slipping -= {self._detector}

    def note_load(self) -> None:
        """Follow the load: at once where it grows, after `relax_s` where it falls."""
        assert isinstance(self.event, LoadChanged)
        grows = self._load_n < self.event.value and self.event.value > self._most_n
        self._load_n = self.event.value
        if grows:
            self._most_n, self._grew_s = self._load_n, self.event.t_s
            self._plateau_due_s = self.event.t_s + (self.settings.plateau_s or math.inf)
        self._loads.append((self.event.t_s, self._load_n, self._load_n / self._force_n))
        beyond = self._beyond()
        # what slides makes the load jump too: then, and after the jaws have acted, a jump is no knock
        acted = bool(self._slipping) or self.event.t_s < self._acted_s + ACTED_S
        if self.state in _AIR and not acted and self._jumps():
            self.expect_knock()
        wanted_n = max(self._wanted_n, self._braced_n(self.event.t_s) if beyond else 0.0)
        if self.settings.rule == "friction" and wanted_n > self._force_n:
            for command in self._pressed(wanted_n, self.event.t_s):
                self.command(command)
        elif self._relax_due_s == math.inf:
            self._relax_due_s = self.event.t_s + self.settings.relax_s

    @property
    def _detector(self) -> str:
        return str(getattr(self.event, "detector", ""))

    def _tightened(self, t_s: float) -> Sequence[Command]:
        """Press harder upon a slip, unless it may be a knock: then look again."""
        settings = self.settings
        quiet_s = max(self._calm_s, self._acted_s + ACTED_S) if settings.load else t_s
        self._tighten_due_s = max(t_s + settings.tighten_s, quiet_s)
        if t_s < quiet_s - 1e-9 or not self.credible():
            return []
        self._note_friction(t_s, self._share)
        if settings.rule == "step":
            return self._answered(self._force_n + settings.tighten_n, t_s)
        return self._answered(max(self._braced_n(t_s), self._wanted_n), t_s)

    def _answered(self, force_n: float, t_s: float) -> Sequence[Command]:
        """As `_pressed`, upon a slip: counted where the jaws are made to press harder."""
        before_n = self._force_n
        commands = self._pressed(force_n, t_s)
        if self._force_n > before_n:
            self.notes.setdefault("slip_s", []).append(t_s)
        return commands

    def _braced_n(self, t_s: float) -> float:
        """How hard at once: on the table a little harder, in the air enough to brake, not again where it just was."""
        settings = self.settings
        if self.state == "LOADING":
            return settings.margin * self._force_n
        if t_s < self._boosted_s + LATELY_S:
            return self._force_n
        self._boosted_s = t_s
        self.expect_knock()
        known = bool(settings.load) and math.isfinite(self._friction)
        return settings.boost * (self._lifted_n / self._friction if known else self._force_n)

    def _pressed(self, force_n: float, t_s: float) -> Sequence[Command]:
        """Press as hard as this, within what is allowed, to the same opening."""
        settings = self.settings
        least_n, most_n, jaws_n = settings.grip_force_n, settings.tightest_n, settings.jaws_n
        force_n = min(max(force_n, least_n - jaws_n), most_n - jaws_n)
        if force_n == self._force_n:
            return []
        if harder := force_n > self._force_n:
            self._relax_due_s = t_s + settings.relax_s
        else:
            self._acted_s = t_s
        self._force_n = force_n
        asked_n = max(force_n + (jaws_n if harder else -jaws_n), least_n)
        return [Grip(settings.gripper, settings.grip_width_m, settings.tighten_speed_m_s, asked_n)]

    def _shaken(self, t_s: float) -> Sequence[Command]:
        """Reverse the shake: first after a quarter of a period, then after halves."""
        settings = self.settings
        half_s, self._shake_up = 0.5 / settings.shake_hz, not self._shake_up
        first = t_s <= self._entered_s
        self._shake_due_s = t_s + (0.5 * half_s if first else half_s)
        speed_m_s = settings.shake_m_s if self._shake_up else -settings.shake_m_s
        return [Twist(settings.mover, (0.0, 0.0, speed_m_s, 0.0, 0.0, 0.0), 2.0 * half_s)]

    def conclude_dropped(self) -> None:
        """The jaws lost what they held."""
        self.conclude("dropped", f"the object was lost in {self.state}")

    def conclude_held(self) -> None:
        """Held for as long as was asked for, if the fingers still carry or feel it."""
        carry = self._load_n > 0.5 * self._lifted_n
        if carry if self.settings.load else self.both_touch():
            self.conclude("held")
        else:
            self.conclude_dropped()

    def enter_LOADING(self) -> None:
        """Up from where it was found, slowly, until the pads carry the weight."""
        self._force_n = self.settings.grip_force_n - self.settings.jaws_n
        self._load_n, self._most_n, self._friction = 0.0, 0.0, math.inf
        self._plateau_due_s = math.inf
        self._loads: deque[tuple[float, float, float]] = deque(maxlen=64)  # when, N, over the grip
        self._boosted_s = -math.inf
        self._slipping, self._tighten_due_s, self._relax_due_s = frozenset(), math.inf, math.inf
        self._calm_s = self._still_s = self._acted_s = self._grew_s = -math.inf
        self._lifted_n = 0.0
        self._rise(self.settings.load_m, self.settings.load_speed_m_s)

    def enter_LIFTING(self) -> None:
        """Straight up."""
        self._lifted_n = self._load_n
        self.move_it()
        for command in self._pressed(max(self._force_n, self._wanted_n), self.event.t_s):
            self.command(command)
        self._rise(self.settings.lift_m, self.settings.lift_speed_m_s)

    def enter_SHAKING(self) -> None:
        """Up and down."""
        self.move_it(self.settings.shake_s)
        self._shake_due_s, self._shake_up = self.event.t_s, False

    def enter_HOLDING(self) -> None:
        """Stand still."""
        self.move_it()
        self._relax_due_s = self.event.t_s + self.settings.relax_s
        if self.shaking():
            self.command(Stop(self.settings.mover))

    def enter_LOWERING(self) -> None:
        """Down to where it stood."""
        self._go(self._found_m, self.settings.lift_speed_m_s)

    def _rise(self, height_m: float, speed_m_s: float) -> None:
        x_m, y_m, z_m = self._found_m
        self._go((x_m, y_m, z_m + height_m), speed_m_s)

    @property
    def _found_m(self) -> Place:
        """Where the object was gripped."""
        return self._place_m


LIFTING: Sequence[Row] = (
    on("reached", "LOADING", "LIFTING", from_mover),
    on("reached", "LIFTING", "SHAKING", from_mover, Lifting.shaking, label="a shake"),
    on("reached", "LIFTING", "HOLDING", from_mover),
    on("slip_started", _UP, None, do=Lifting.note_slip, label="press harder"),
    on("slip_ended", _UP, None, do=Lifting.note_held),
    on("load_changed", _UP, None, do=Lifting.note_load, label="follow the load"),
    on("gripped", _UP, "LOWERING", Lifting.dropped, do=Lifting.conclude_dropped, label="nothing held"),
    on("deadline", "SHAKING", "HOLDING"),
    on("deadline", "HOLDING", "LOWERING", do=Lifting.conclude_held),
    on("reached", "LOWERING", "RELEASING", from_mover),
    on("resumed", (*_UP, "LOWERING"), "LOWERING", do=Lifting.conclude_broken_off),
)
"""Rows from the first contact felt at the object to its release, at the place where it was found."""

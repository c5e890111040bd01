"""Close on an object until both fingers feel it, release: a part of a trial (Rupavatharam et al., IV.A.2)."""

import math
from collections.abc import Iterator, Mapping, Sequence

from pydantic import Field

from behaviors.machine import Row, StatePlan, concluding, on
from behaviors.sonic import CONTACTS, SonicBehavior, SonicSettings
from drivers.core.messages import Grip, Gripped, Release
from drivers.core.settings import Mismatch, Settings, StreamName

WIDER_M = 0.001
"""By how much jaws may hold wider than the object can be. Assumption: what their width and the mover's position are
uncertain by together."""


class GripSettings(SonicSettings):
    """How an object between the fingers is gripped."""

    width_stream: StreamName = "gripper.width"
    """How far open the jaws are (m)."""

    grip_width_m: float = Field(default=0.0, ge=0.0, le=0.2)
    """Opening to close to; what is between the jaws keeps them from it."""

    grip_speed_m_s: float = Field(default=0.02, gt=0.0, le=1.0)
    """How fast the jaws close."""

    grip_force_n: float = Field(default=10.0, gt=0.0, le=500.0)
    """How hard they press."""

    confirm_s: float = Field(default=1.0, gt=0.0, le=60.0)
    """Longest wait, after the grip, for both fingers to feel the contact."""

    hold_s: float = Field(default=1.0, ge=0.0, le=600.0)
    """How long the object is held."""

    def forces_n(self, profile: Mapping[tuple[str, ...], Settings]) -> tuple[float, float]:
        """Least and greatest force of the gripper, N, as far as it says."""
        found: tuple[float, float] = getattr(
            profile.get(("devices", self.gripper)), "forces_n", (0.0, math.inf)
        )
        return found

    def mismatches(
        self, path: tuple[str, ...], profile: Mapping[tuple[str, ...], Settings]
    ) -> Iterator[Mismatch]:
        """What the gripper would refuse in the trial is refused before it."""
        yield from super().mismatches(path, profile)
        least_n, most_n = self.forces_n(profile)
        if not least_n <= self.grip_force_n <= most_n:
            range_n = f"{least_n:.3g} to {most_n:.3g} N"
            mistake = f" = {self.grip_force_n}: {self.gripper} presses with {range_n}; write one of those"
            yield Mismatch(path, "grip_force_n", mistake)


def gripping_plans(
    settings: GripSettings, contacts: frozenset[str], measures: frozenset[str]
) -> Mapping[str, StatePlan]:
    """What these states need: the contact detectors, which learn in the rest, and what is measured."""
    closed = measures | {settings.width_stream}
    plan = StatePlan(settings.motion_timeout_s, contacts, closed)
    return {
        "RESTING": StatePlan(settings.baseline_s, contacts, closed, prompt=False),
        "CLOSING": plan,
        "CONFIRMING": StatePlan(settings.confirm_s, contacts, closed),
        "HOLDING": StatePlan(settings.hold_s, contacts, closed, prompt=False),
        "RELEASING": StatePlan(settings.motion_timeout_s, frozenset(), closed),
    }


class Gripping(SonicBehavior):
    """What `gripping` asks and commands."""

    settings: GripSettings

    @property
    def widest_m(self) -> float:
        """Widest that the object can be, as far as is known."""
        return math.inf

    def too_wide(self) -> bool:
        """Whether what holds the jaws cannot be the object."""
        return self.on_object() and self.event.width_m > self.widest_m + WIDER_M  # type: ignore[union-attr]

    def on_object(self) -> bool:
        """Whether the jaws hold something."""
        return isinstance(self.event, Gripped) and self.event.object

    def both_touch(self) -> bool:
        """Whether both fingers feel contact."""
        return self._touching >= CONTACTS

    def conclude_jammed(self) -> None:
        """Something else than the object holds the jaws."""
        assert isinstance(self.event, Gripped)
        self.outcome = "fault"
        self.reason = (
            f"{self.settings.gripper}: something holds the jaws at {self.event.width_m * 1e3:.1f} mm, but the object is"
            f" at most {self.widest_m * 1e3:.1f} mm wide; look at the jaws"
        )

    def conclude_unfelt(self) -> None:
        """The jaws hold something that the fingers do not feel."""
        self.conclude("not_gripped", f"no contact felt within {self.settings.confirm_s:.6g} s of the grip")

    def conclude_broken_off(self) -> None:
        """A pause interrupted the grip."""
        self.conclude("not_gripped", "a pause broke the grip off")

    def enter_CLOSING(self) -> None:
        """Close on the object."""
        settings = self.settings
        self.command(
            Grip(settings.gripper, settings.grip_width_m, settings.grip_speed_m_s, settings.grip_force_n)
        )

    def enter_RELEASING(self) -> None:
        """Release."""
        self.command(Release(self.settings.gripper, self.settings.open_speed_m_s))


def gripping(felt: str) -> Sequence[Row]:
    """Rows from the rest at the object: close, go on to `felt` once both fingers feel it; else release and leave. Jaws
    that are held wider than the object can be have it not: something is wrong with them."""
    here, both = Gripping, "both fingers touch"
    empty = concluding("not_gripped", "the jaws closed on nothing")
    return (
        on("deadline", "RESTING", "CLOSING"),
        on("gripped", "CLOSING", "FAILED", here.too_wide, do=here.conclude_jammed, label="too wide"),
        on("gripped", "CLOSING", felt, here.on_object, here.both_touch, label=both),
        on("gripped", "CLOSING", "CONFIRMING", here.on_object, label="object"),
        on("gripped", "CLOSING", "RELEASING", do=empty, label="nothing there"),
        on("contact", "CONFIRMING", felt, here.both_touch, label=both),
        on("deadline", "CONFIRMING", "RELEASING", do=here.conclude_unfelt),
        on("reached", "RELEASING", "LEAVING", here.from_gripper),
        on("resumed", "RESTING", "ENTERING"),
        on("resumed", ["CLOSING", "CONFIRMING"], "RELEASING", do=here.conclude_broken_off),
        on("resumed", "RELEASING", "RELEASING"),
    )

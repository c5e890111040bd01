"""What each mover of a bench may do, and which of its commands that lets through. Pure."""

import math
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Annotated, Self

from pydantic import Field, Strict, model_validator

from drivers.core.messages import BLIND_TRAVEL_M, Command, MoveAt, MovePose, MoveTo, SampleBlock, Twist
from drivers.core.settings import LIMIT, DeviceName, Mismatch, Settings, StreamName

Channel = Annotated[int, Field(ge=0, le=63)]
"""Number of a stream's channel, from 0."""

Place = Annotated[tuple[float, float, float], Strict(False)]
"""x, y, z in m; a list in a profile."""


class GuardRefusal(Exception):  # noqa: N818 - it is a refusal, not a fault of the program
    """The guard will not let a command through."""


class MoverLimits(Settings):
    """Limits of one mover."""

    travel_m: Annotated[float, LIMIT] = Field(gt=0.0, le=2.0)
    """Farthest position on the approach axis, from its zero."""

    travel_min_m: float = Field(default=-0.0005, ge=-2.0, le=0.0)
    """Nearest position on the approach axis. Assumption: half a millimetre behind zero for overshoot."""

    blind_travel_m: float = Field(default=BLIND_TRAVEL_M, gt=0.0, le=2.0)
    """How far it may go unsupervised: its device enforces that, where the program dies or is stopped. A controller
    with a watchdog enforces it by that (`drivers.core.messages.BLIND_TRAVEL_M`)."""

    position_stream: StreamName | None = None
    """Where its position comes from (m); None where travel is held by commands and device alone."""

    workspace_min_m: Place | None = None
    """Corner of the box that the tool's point must stay in, base frame; None without such a box."""

    workspace_max_m: Place | None = None
    """The opposite corner."""

    pose_stream: StreamName | None = None
    """Where the tool's pose comes from (x, y, z in m first); needed for the box."""

    reach_m: float = Field(default=0.0, ge=0.0, le=2.0)
    """Farthest that a free motion (`Twist`, `MovePose`) may lead from where it begins, or from the start pose. Refused
    unless this is given, even if they only turn."""

    reach_rad: float = Field(default=0.0, ge=0.0, le=math.tau)
    """Farthest that a free motion may turn the tool, likewise. Turns are refused unless this is given."""

    speed_m_s: float = Field(default=0.05, gt=0.0, le=1.0)
    """Fastest motion that may be asked for; a device's own `home_speed_m_s` is held against it in the profile."""

    follow_m: float | None = Field(default=1e-3, gt=0.0, le=1.0)
    """How far the measured position (`position_stream`) may be from the commanded one, beside what is commanded for
    `controller.redundancy.FOLLOW_S`: a mover that starts late, brakes, or reports late. "none" does not compare."""

    turn_rad_s: float = Field(default=1.0, gt=0.0, le=10.0)
    """Fastest turn of the tool that may be asked for. Assumption: a UR's own reduced mode is of this order."""

    @model_validator(mode="after")
    def _whole_box(self) -> Self:
        given = [self.workspace_min_m is None, self.workspace_max_m is None, self.pose_stream is None]
        if any(given) and not all(given):
            raise ValueError(
                "workspace_min_m, workspace_max_m and pose_stream belong together: give all or none"
            )
        return self


class Agreement(Settings):
    """Two streams of one quantity: what moves is stopped where they disagree."""

    streams: Annotated[tuple[StreamName, StreamName], Strict(False)]
    """The two, a load cell and an arm's force for example."""

    channels: Annotated[tuple[Channel, Channel], Strict(False)] = (0, 0)
    """Which channel of each."""

    factor: float = 1.0
    """What the second is multiplied by: -1 where it counts the other way."""

    most: float = Field(gt=0.0)
    """Largest difference of what both have changed by since the trial began, or a tare, in the first stream's unit."""

    for_s: float = Field(default=0.05, gt=0.0, le=10.0)
    """How long they must disagree: longer than one is later than the other (assumption)."""


class GuardSettings(MoverLimits):
    """Limits of the bench. The devices' own limits are set as well: this is never the last layer.

    A mover's own limits are here those of the mover whose position or pose is watched, or else of the first mover.
    Further movers have theirs in `movers`.
    """

    position_stream: StreamName | None = "stage.position"
    """Where the mover's position comes from (m); None where travel is held by commands and device alone."""

    movers: Mapping[DeviceName, MoverLimits] = Field(default_factory=dict)
    """Limits of further movers, by device: `[limits.movers.NAME]`."""

    force_n: Annotated[float | None, LIMIT] = Field(default=None, gt=0.0, le=1000.0)
    """Largest force, of either sign, after the median filter; None on a bench without a force stream."""

    force_stream: StreamName | None = "board.load_cell"
    """Where the force comes from (N); None on a bench without one."""

    force_channels: Annotated[tuple[Channel, ...], Strict(False), Field(min_length=1)] = (0,)
    """Which of its channels; of several the size of the force that they make together."""

    force_median_s: float = Field(default=0.010, gt=0.0, le=1.0)
    """Length of the running median that the force is seen through: a single spike stops nothing."""

    retreat_n: Annotated[float | None, LIMIT] = Field(default=None, gt=0.0, le=1000.0)
    """Force beyond which a stop is not enough: what moved last also goes back by `retreat_m` once it stands still, jaws
    open. None only stops."""

    retreat_m: float = Field(default=0.002, gt=0.0, le=0.1)
    """How far it goes back then. Assumption: farther than anything here gives way before it breaks."""

    stiffness_n_m: float | None = Field(default=None, gt=0.0, le=1e8)
    """Stiffness of the hardest thing that an approach may meet, mover and sensor included: from it each approach's peak
    force is forecast. A simulated bench that knows its own needs none."""

    braking_m_s2: float = Field(default=0.5, gt=0.0, le=100.0)
    """At which the mover brakes, for the forecast. Assumption: an arm's own default."""

    detector_delay_s: float | None = Field(default=None, ge=0.0, le=10.0)
    """How long after the touch the detector that ends an approach decides: where it is known, an approach is refused in
    which force_n would be passed all the same."""

    peak_n: Annotated[float | None, LIMIT] = Field(default=None, gt=0.0, le=1e4)
    """Largest peak force that may be forecast for an approach which the guard alone ends; faster ones are refused."""

    agree: Mapping[str, Agreement] = Field(default_factory=dict)
    """Redundant sensors: `[limits.agree.NAME]`."""

    range_streams: Annotated[tuple[StreamName, ...], Strict(False)] = ()
    """Streams that must stay within their valid range, a fingertip's forces for example: subscribed and
    watched in every motion. Leaving the range (`Saturated`) stops it, as does silence."""

    grip_n: float = Field(default=80.0, gt=0.0, le=500.0)
    """Hardest grip that may be asked for. Source: the SSG-48's own range ends at 80 N."""

    stale_s: float = Field(default=0.1, gt=0.0, le=10.0)
    """Longest silence of a stream that a motion depends on (the guard's own, and those of the armed detectors) while
    something moves. At rest every subscribed stream may be silent four times as long; then the trial ends."""

    stuck_s: float | None = Field(default=0.2, gt=0.0, le=60.0)
    """Longest time for which a sensor with noise may repeat one raw value, of a slow one for 50 samples at least; then
    the trial ends. "none" does not judge. Assumption: 200 samples in a row at 1 kHz, one chance in 1e12 where the noise
    is a third of a count."""

    late_s: float = Field(default=0.1, gt=0.0, le=10.0)
    """A turn of the loop later than this, while something moves, stops it."""

    @model_validator(mode="after")
    def _tiers(self) -> Self:
        for key in ("retreat_n", "peak_n"):
            value = getattr(self, key)
            if value is not None and self.force_n is not None and value <= self.force_n:
                raise ValueError(
                    f'{key} = {value:g} is not above force_n = {self.force_n:g}; raise it, or write "none"'
                )
        return self

    def without(self, keys: Collection[str]) -> Self:
        """The same without such limits as are among some keys: none where a setting may be that, else infinite."""
        absent = {
            key: math.inf if type(self).model_fields[key].is_required() else None
            for key in self.keys_of("limit")
            if key in keys
        }
        return self.model_copy(update=absent)

    def mismatches(
        self, path: tuple[str, ...], profile: Mapping[tuple[str, ...], Settings]
    ) -> Iterator[Mismatch]:
        """`Home` must not be faster than other motions may be: it is the device's own speed."""
        for place, settings in profile.items():
            most_m_s = self.movers.get(place[-1], self).speed_m_s
            for key in settings.keys_of("home_speed"):
                if (home_m_s := getattr(settings, key)) > most_m_s:
                    mistake = f" = {home_m_s}: faster than [limits] speed_m_s = {most_m_s}; lower it to that"
                    yield Mismatch(place, key, mistake)


def shown_limits(limits: GuardSettings) -> Iterable[tuple[str, str, Sequence[int], float, str]]:
    """What the guard holds against a limit that there is: name, stream, channels whose size counts, limit, unit."""
    if limits.force_stream is not None and limits.force_n is not None:
        yield "force", limits.force_stream, limits.force_channels, limits.force_n, "N"
    for each in (limits, *limits.movers.values()):
        if each.position_stream is not None and math.isfinite(each.travel_m):
            yield "travel", each.position_stream, (0,), each.travel_m, "m"


class Bounds:
    """Holds one mover's commands and places against its limits.

    Args:
        where: Where they stand in a profile: "limits", or "limits.movers.NAME".
    """

    def __init__(self, limits: MoverLimits, where: str) -> None:
        self.limits = limits
        self.where = where

    def admit(self, what: str, command: Command) -> Command:
        """A motion along the axis or a free one, as it may go to the device; other commands pass as they are.

        Raises:
            GuardRefusal: too fast, too far, or beyond the travel.
        """
        limits = self.limits
        match command:
            case MoveAt():
                self.admit_speed(what, abs(command.velocity_m_s))
                self._admit_target(what, command.limit_m)
                return replace(command, blind_travel_m=limits.blind_travel_m)
            case MoveTo():
                self.admit_speed(what, command.speed_m_s)
                self._admit_target(what, command.position_m)
                return replace(command, blind_travel_m=limits.blind_travel_m)
            case Twist():
                self._admit_twist(what, command)
            case MovePose():
                # What turns on the way, back to the start pose's orientation perhaps, takes the same number for rad/s.
                self.admit_speed(what, command.speed_m_s)
                self._admit_turn(what, command.speed_m_s)
                self._admit_reach(what, math.hypot(*command.offset[:3]), math.hypot(*command.offset[3:]))
        return command

    def admit_speed(self, what: str, speed_m_s: float) -> None:
        """See that a speed is one, and not too great.

        Raises:
            GuardRefusal: it is not.
        """
        limit_m_s = self.limits.speed_m_s
        if speed_m_s <= 0.0:
            raise GuardRefusal(f"{what}: {speed_m_s:.6g} m/s is no speed; it must be above 0")
        if speed_m_s > limit_m_s:
            raise GuardRefusal(
                f"{what}: {speed_m_s:.6g} m/s is beyond {self.where}.speed_m_s = {limit_m_s:.6g}"
            )

    def position(self, block: SampleBlock) -> str | None:
        """Why the positions of a block exceed the limits."""
        least_m, most_m = self.limits.travel_min_m, self.limits.travel_m
        position_m = first_outside((block.values * block.scale).ravel().tolist(), least_m, most_m)
        if position_m is None:
            return None
        return (
            f"{block.stream} is at {position_m:.6f} m, outside {self.where}.travel_min_m .. travel_m"
            f" = {least_m:g} .. {most_m:g}"
        )

    def pose(self, block: SampleBlock) -> str | None:
        """Likewise for poses."""
        least_m, most_m = self.limits.workspace_min_m, self.limits.workspace_max_m
        assert least_m is not None
        assert most_m is not None
        places_m = block.physical[:, :3]
        inside = ((places_m >= least_m) & (places_m <= most_m)).all(axis=1)
        if inside.all():
            return None
        x_m, y_m, z_m = places_m[~inside][0].tolist()
        return (
            f"{block.stream} is at ({x_m:.4f}, {y_m:.4f}, {z_m:.4f}) m, outside {self.where}.workspace_min_m"
            " .. workspace_max_m"
        )

    def _admit_twist(self, what: str, command: Twist) -> None:
        speed_m_s, turn_rad_s = math.hypot(*command.twist[:3]), math.hypot(*command.twist[3:])
        if command.duration_s <= 0.0:
            raise GuardRefusal(f"{what}: {command.duration_s:.6g} s is no duration; it must be above 0")
        if speed_m_s > 0.0:
            self.admit_speed(what, speed_m_s)
        self._admit_turn(what, turn_rad_s)
        self._admit_reach(what, speed_m_s * command.duration_s, turn_rad_s * command.duration_s)

    def _admit_turn(self, what: str, turn_rad_s: float) -> None:
        limit_rad_s = self.limits.turn_rad_s
        if turn_rad_s > limit_rad_s:
            limit = f"{self.where}.turn_rad_s = {limit_rad_s:.6g}"
            raise GuardRefusal(f"{what}: {turn_rad_s:.6g} rad/s is beyond {limit}")

    def _admit_reach(self, what: str, distance_m: float, angle_rad: float) -> None:
        limit_m, limit_rad = self.limits.reach_m, self.limits.reach_rad
        if limit_m == 0.0:
            raise GuardRefusal(f"{what}: no free motion may be made without {self.where}.reach_m; give it")
        if distance_m > limit_m:
            limit = f"{self.where}.reach_m = {limit_m:.6g}"
            raise GuardRefusal(f"{what}: leads {distance_m:.6g} m away, beyond {limit}")
        if angle_rad > limit_rad:
            limit = f"{self.where}.reach_rad = {limit_rad:.6g}"
            raise GuardRefusal(f"{what}: turns by {angle_rad:.6g} rad, beyond {limit}")

    def _admit_target(self, what: str, target_m: float) -> None:
        least_m, most_m = self.limits.travel_min_m, self.limits.travel_m
        if not least_m <= target_m <= most_m:
            raise GuardRefusal(
                f"{what}: {target_m:.6g} m is outside {self.where}.travel_min_m .. travel_m"
                f" = {least_m:.6g} .. {most_m:.6g}"
            )


def first_outside(values: Iterable[float], least: float, most: float) -> float | None:
    """The first value that is not inside, NaN included; for a turn's few samples this is faster than numpy."""
    for value in values:
        if not least <= value <= most:
            return value
    return None

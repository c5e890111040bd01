"""The last gate before the devices: it refuses what is unsafe, and stops every mover by itself."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import fields
from typing import Annotated, Self

import numpy as np
from pydantic import Field, Strict, model_validator

from drivers.messages import (
    MOTION,
    Command,
    Grip,
    Home,
    MoveAt,
    MovePose,
    MoveTo,
    Release,
    SampleBlock,
    Saturated,
    StreamInfo,
    Twist,
)
from drivers.settings import Settings

Place = Annotated[tuple[float, float, float], Strict(False)]
"""x, y, z in m; a list in a profile."""


class GuardSettings(Settings):
    """Limits of the bench. The devices' own limits are set as well: this is never the last layer."""

    force_n: float | None = Field(default=None, gt=0.0, le=1000.0)
    """Largest force, of either sign, after the median filter; None on a bench without a force stream."""

    force_stream: str | None = "board.load_cell"
    """Where the force comes from (N); None on a bench without one."""

    force_channels: Annotated[
        tuple[Annotated[int, Field(ge=0, le=63)], ...], Strict(False), Field(min_length=1)
    ] = (0,)
    """Which of its channels; of several the size of the force that they make together."""

    force_median_s: float = Field(default=0.010, gt=0.0, le=1.0)
    """Length of the running median that the force is seen through: a single spike stops nothing."""

    travel_m: float = Field(gt=0.0, le=2.0)
    """Farthest position on the approach axis, from its zero."""

    travel_min_m: float = Field(default=-0.0005, ge=-2.0, le=0.0)
    """Nearest position on the approach axis. Assumption: half a millimetre behind zero for overshoot."""

    position_stream: str | None = "stage.position"
    """Where the mover's position comes from (m); None where travel is held by commands and device alone."""

    workspace_min_m: Place | None = None
    """Corner of the box that the tool's point must stay in, base frame; None without such a box."""

    workspace_max_m: Place | None = None
    """The opposite corner."""

    pose_stream: str | None = None
    """Where the tool's pose comes from (x, y, z in m first); needed for the box."""

    range_streams: Annotated[tuple[str, ...], Strict(False)] = ()
    """Streams that must stay within the range in which they tell the truth, a fingertip's forces for example: heard and
    watched in every motion. What they say of their range (`Saturated`) stops it, as does their silence."""

    reach_m: float = Field(default=0.0, ge=0.0, le=2.0)
    """Farthest that a free motion (`Twist`, `MovePose`) may lead from where it begins, or from the start pose. None may
    be made unless this is given, one that only turns included."""

    reach_rad: float = Field(default=0.0, ge=0.0, le=math.tau)
    """Farthest that a free motion may turn the tool, likewise. None may turn it unless this is given."""

    speed_m_s: float = Field(default=0.05, gt=0.0, le=1.0)
    """Fastest motion that may be asked for; a device's own `home_speed_m_s` is held against it in the profile."""

    turn_rad_s: float = Field(default=1.0, gt=0.0, le=10.0)
    """Fastest turn of the tool that may be asked for. Assumption: a UR's own reduced mode is of this order."""

    grip_n: float = Field(default=80.0, gt=0.0, le=500.0)
    """Hardest grip that may be asked for. Source: the SSG-48's own range ends at 80 N."""

    stale_s: float = Field(default=0.1, gt=0.0, le=10.0)
    """A watched stream silent for longer than this, while something moves, stops it."""

    late_s: float = Field(default=0.1, gt=0.0, le=10.0)
    """A turn of the loop later than this, while something moves, stops it."""

    @model_validator(mode="after")
    def _whole_box(self) -> Self:
        given = [self.workspace_min_m is None, self.workspace_max_m is None, self.pose_stream is None]
        if any(given) and not all(given):
            raise ValueError(
                "workspace_min_m, workspace_max_m and pose_stream belong together: give all or none"
            )
        return self


class GuardRefusal(Exception):  # noqa: N818 - it is a refusal, not a fault of the program
    """The guard will not let a command through."""


class Guard:
    """Watches force, travel, stale streams and a late loop; knows nothing of the experiment.

    Args:
        settings: The limits.
    """

    def __init__(self, settings: GuardSettings) -> None:
        self.settings = settings
        looks: list[tuple[str | None, bool, Callable[[SampleBlock], Sequence[str]]]] = [
            (settings.force_stream, settings.force_n is not None, self._force),
            (settings.position_stream, True, self._position),
            (settings.pose_stream, settings.workspace_min_m is not None, self._pose),
        ]
        self._looks: dict[str, list[Callable[[SampleBlock], Sequence[str]]]] = {}
        for stream, wanted, look in looks:
            if stream is not None and wanted:
                self._looks.setdefault(stream, []).append(look)
        self.inputs: frozenset[str]
        """Streams that must be alive while anything moves."""
        self.reset()

    def reset(self, range_streams: frozenset[str] = frozenset()) -> None:
        """Begin a trial: empty the filter, forget how old each stream is.

        Args:
            range_streams: Streams that this trial has watched like `limits.range_streams`.
        """
        self.inputs = frozenset((*self._looks, *self.settings.range_streams, *range_streams))
        self._tail_n: list[float] = []
        self._seen_s: dict[str, float] = {}
        self.arm(frozenset())

    def arm(self, decisive: frozenset[str]) -> None:
        """Watch other streams from now on, beside the guard's own.

        Args:
            decisive: Streams that the armed detectors hear: a motion that ends by them needs them alive.
        """
        self._watched = sorted(self.inputs | decisive)
        self._aligned = False

    def fit(self, streams: Mapping[str, StreamInfo]) -> None:
        """See that what is to be watched is there, before anything moves.

        Args:
            streams: All that can be heard, by name.

        Raises:
            GuardRefusal: a stream that nobody sends, or one with too few channels.
        """
        settings = self.settings
        needed = [
            ("force_stream", settings.force_stream, max(settings.force_channels) + 1),
            ("position_stream", settings.position_stream, 1),
            ("pose_stream", settings.pose_stream, 3),
            *(("range_streams", name, 1) for name in settings.range_streams),
        ]
        for key, name, channels in needed:
            if name is None or name not in self.inputs:
                continue
            if name not in streams:
                known = ", ".join(sorted(streams))
                raise GuardRefusal(f"limits.{key} = {name}: the bench has no such stream; it has {known}")
            if len(streams[name].channels) < channels:
                raise GuardRefusal(
                    f"limits.{key} = {name}: channel {channels - 1} is to be watched, but it has"
                    f" {len(streams[name].channels)}; count from 0"
                )

    def admit(self, command: Command) -> Command:
        """Let a command through, or say why not.

        Raises:
            GuardRefusal: not finite, too fast, beyond the travel, or a motion that no limit is known for.
        """
        what = f"{type(command).__name__}({command.device})"
        for field in fields(command):
            value = getattr(command, field.name)
            for number in value if isinstance(value, tuple) else (value,):
                if isinstance(number, float) and not math.isfinite(number):
                    raise GuardRefusal(f"{what}: {field.name} is {number}")
        if isinstance(command, MoveAt):
            self._admit_speed(what, abs(command.velocity_m_s))
            self._admit_target(what, command.limit_m)
        elif isinstance(command, MoveTo):
            self._admit_speed(what, command.speed_m_s)
            self._admit_target(what, command.position_m)
        elif isinstance(command, Twist):
            self._admit_twist(what, command)
        elif isinstance(command, MovePose):
            # What turns on the way, back to the start pose's orientation perhaps, takes the same number for rad/s.
            self._admit_speed(what, command.speed_m_s)
            self._admit_turn(what, command.speed_m_s)
            self._admit_reach(what, math.hypot(*command.offset[:3]), math.hypot(*command.offset[3:]))
        elif isinstance(command, Grip | Release):
            self._admit_speed(what, command.speed_m_s)
            limit_n = self.settings.grip_n
            if isinstance(command, Grip) and not 0.0 < command.force_n <= limit_n:
                raise GuardRefusal(
                    f"{what}: {command.force_n:.6g} N is outside 0 .. limits.grip_n = {limit_n:.6g}"
                )
        elif isinstance(command, MOTION) and not isinstance(command, Home):
            raise GuardRefusal(f"{what}: no limit is known for this motion")
        return command

    def _admit_twist(self, what: str, command: Twist) -> None:
        speed_m_s, turn_rad_s = math.hypot(*command.twist[:3]), math.hypot(*command.twist[3:])
        if command.duration_s <= 0.0:
            raise GuardRefusal(f"{what}: {command.duration_s:.6g} s is no duration; it must be above 0")
        if speed_m_s > 0.0:
            self._admit_speed(what, speed_m_s)
        self._admit_turn(what, turn_rad_s)
        self._admit_reach(what, speed_m_s * command.duration_s, turn_rad_s * command.duration_s)

    def _admit_speed(self, what: str, speed_m_s: float) -> None:
        limit_m_s = self.settings.speed_m_s
        if speed_m_s <= 0.0:
            raise GuardRefusal(f"{what}: {speed_m_s:.6g} m/s is no speed; it must be above 0")
        if speed_m_s > limit_m_s:
            raise GuardRefusal(f"{what}: {speed_m_s:.6g} m/s is beyond limits.speed_m_s = {limit_m_s:.6g}")

    def _admit_turn(self, what: str, turn_rad_s: float) -> None:
        limit_rad_s = self.settings.turn_rad_s
        if turn_rad_s > limit_rad_s:
            raise GuardRefusal(
                f"{what}: {turn_rad_s:.6g} rad/s is beyond limits.turn_rad_s = {limit_rad_s:.6g}"
            )

    def _admit_reach(self, what: str, distance_m: float, angle_rad: float) -> None:
        limit_m, limit_rad = self.settings.reach_m, self.settings.reach_rad
        if limit_m == 0.0:
            raise GuardRefusal(f"{what}: no free motion may be made without limits.reach_m; give it")
        if distance_m > limit_m:
            raise GuardRefusal(
                f"{what}: leads {distance_m:.6g} m away, beyond limits.reach_m = {limit_m:.6g}"
            )
        if angle_rad > limit_rad:
            raise GuardRefusal(
                f"{what}: turns by {angle_rad:.6g} rad, beyond limits.reach_rad = {limit_rad:.6g}"
            )

    def _admit_target(self, what: str, target_m: float) -> None:
        least_m, most_m = self.settings.travel_min_m, self.settings.travel_m
        if not least_m <= target_m <= most_m:
            raise GuardRefusal(
                f"{what}: {target_m:.6g} m is outside limits.travel_min_m .. travel_m = {least_m:.6g} .. {most_m:.6g}"
            )

    def watch(
        self,
        t_s: float,
        blocks: Iterable[SampleBlock],
        moving: bool,
        late_s: float = 0.0,
        saturated: Sequence[Saturated] = (),
    ) -> str | None:
        """See one turn of the loop.

        Force and travel count whether anything moves or not, wherever the loop listens to them: while anything
        moves, in a pause, and in every state that listens to anything. A silent stream and a late loop count while
        something moves.

        Args:
            t_s: Bench time of the turn.
            blocks: What arrived in it.
            moving: Whether any mover may be moving.
            late_s: How much later than planned the turn began.
            saturated: Streams that left the range in which they tell the truth.

        Returns:
            Why every mover must stop now, or None.
        """
        settings = self.settings
        reasons = [
            f"{status.stream} is beyond its range, at {status.value:.4g}: it no longer tells the truth"
            for status in saturated
        ]
        if not moving:
            self._seen_s, self._aligned = {}, False
        elif not self._aligned:
            # A stream that was not watched before the motion began is not stale, it is about to start.
            self._seen_s = {stream: self._seen_s.get(stream, t_s) for stream in self._watched}
            self._aligned = True
        seen_s = self._seen_s
        for block in blocks:
            stream = block.stream
            if not len(block):
                continue
            if stream in seen_s:
                # A time stamp from the future keeps nothing alive.
                seen_s[stream] = max(seen_s[stream], min(block.last_s, t_s))
            for look in self._looks.get(stream, ()):
                reasons += look(block)
        for stream, last_s in seen_s.items():
            silence_s = t_s - last_s
            if silence_s > settings.stale_s:
                reasons.append(
                    f"{stream} is silent for {silence_s:.3f} s (limits.stale_s = {settings.stale_s:g})"
                )
        if moving and late_s > settings.late_s:
            reasons.append(f"the loop is {late_s:.3f} s late (limits.late_s = {settings.late_s:g})")
        return reasons[0] if reasons else None

    def _force(self, block: SampleBlock) -> Sequence[str]:
        """Running median over whole windows; a sample that is not finite is a reason by itself."""
        settings, channels = self.settings, self.settings.force_channels
        if len(channels) == 1:
            parts_n = block.values[:, channels[0]] * block.scale
        else:
            parts_n = np.linalg.norm(block.values[:, channels] * block.scale, axis=1)
        limit_n = settings.force_n
        assert limit_n is not None
        keep = max(1, round(settings.force_median_s * (block.rate_hz or 0.0))) - 1
        joined_n = self._tail_n + parts_n.tolist()
        self._tail_n = joined_n[max(0, len(joined_n) - keep) :] if keep else []
        # A median cannot exceed the largest, so this is all that a quiet turn costs.
        if _first_outside(joined_n, -limit_n, limit_n) is None:
            return ()
        joined = np.array(joined_n)
        if not np.isfinite(joined).all():
            self._tail_n = []
            return (f"{block.stream} reads {joined[~np.isfinite(joined)][0]}",)
        if len(joined) <= keep:
            return ()
        windows = np.lib.stride_tricks.sliding_window_view(joined, keep + 1)
        worst_n = float(np.abs(np.median(windows, axis=1)).max())
        if worst_n <= limit_n:
            return ()
        return (
            f"{block.stream} is at {worst_n:.3f} N ({self.settings.force_median_s * 1e3:g} ms median),"
            f" beyond limits.force_n = {limit_n:g}",
        )

    def _position(self, block: SampleBlock) -> Sequence[str]:
        settings = self.settings
        positions_m = (block.values * block.scale).ravel().tolist()
        position_m = _first_outside(positions_m, settings.travel_min_m, settings.travel_m)
        if position_m is None:
            return ()
        return (
            f"{block.stream} is at {position_m:.6f} m, outside limits.travel_min_m .. travel_m"
            f" = {settings.travel_min_m:g} .. {settings.travel_m:g}",
        )

    def _pose(self, block: SampleBlock) -> Sequence[str]:
        least_m, most_m = self.settings.workspace_min_m, self.settings.workspace_max_m
        if least_m is None or most_m is None:
            return ()
        places_m = block.physical[:, :3]
        inside = ((places_m >= least_m) & (places_m <= most_m)).all(axis=1)
        if inside.all():
            return ()
        x_m, y_m, z_m = places_m[~inside][0].tolist()
        return (
            f"{block.stream} is at ({x_m:.4f}, {y_m:.4f}, {z_m:.4f}) m, outside limits.workspace_min_m"
            " .. workspace_max_m",
        )


def _first_outside(values: Iterable[float], least: float, most: float) -> float | None:
    """The first value that is not inside, NaN included; a turn's few samples are sooner seen here than by numpy."""
    for value in values:
        if not least <= value <= most:
            return value
    return None

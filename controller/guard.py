"""The last gate before the devices: it refuses what is unsafe, and stops every mover by itself."""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence

import numpy as np

from behaviors.events import Approached, Forecast
from controller.arrivals import Arrivals
from controller.forecast import forecast, refusal
from controller.limits import Bounds, GuardRefusal, GuardSettings, first_outside
from controller.numbers import normalised
from controller.redundancy import Agreeing, Followed
from drivers.core.messages import (
    MOTION,
    Command,
    Grip,
    Home,
    Lead,
    MoveAt,
    MovePose,
    MoveTo,
    Reached,
    Release,
    SampleBlock,
    Saturated,
    SetTendon,
    Standstill,
    Status,
    Stop,
    StreamInfo,
    Tare,
    Twist,
)

RELIEF = 0.1
"""How much more than at its start a trial that begins in contact may press, as a share of the force limit. Assumption:
above a force sensor's noise."""

RETREAT_M_S = 0.01
"""Fastest that a mover goes back, where a stop was not enough. Assumption: as fast as a person would retract it."""

BRAKING_S = 0.3
"""How long what presses may still grow after a stop, before it may only fall. Assumption: as long as an arm at
0.25 m/s brakes with 1 m/s2, and a little more."""

UNITS = {"force_stream": "N", "position_stream": "m", "pose_stream": "m"}
"""What the streams that a limit is held against are in."""

Look = Callable[[SampleBlock], str | None]
"""Sees a block; gives why every mover must stop now."""


class Guard:
    """Watches force, travel, streams that do not arrive and a late loop; knows nothing of the experiment.

    A trial may begin in contact, where an earlier run died. A force beyond the limit from the first samples on must
    not grow; the limit follows it down, and meanwhile only `Home` and motions back along the axis are admitted: there
    is a way out, and none farther in.

    A stop holds: after `latch`, until the next trial, no motion is admitted but one that takes load away.

    Args:
        turn_s: Of the loop that asks it, for the forecast.

    Attributes:
        inputs: Streams that must be alive while anything moves.
    """

    def __init__(self, settings: GuardSettings, turn_s: float = 0.005) -> None:
        self.settings = settings
        self._turn_s = turn_s
        self._first = Bounds(settings, "limits")
        self._others = {
            name: Bounds(limits, f"limits.movers.{name}") for name, limits in settings.movers.items()
        }
        streams = (settings.position_stream, settings.pose_stream)
        owners = [stream.partition(".")[0] for stream in streams if stream is not None]
        self._carrier = owners[0] if owners else ""
        looks: list[tuple[str | None, Look]] = []
        if settings.force_n is not None:
            looks.append((settings.force_stream, self._force))
        self._followed: dict[str, Followed] = {}
        self._agreeing = [Agreeing(each, f"limits.agree.{name}") for name, each in settings.agree.items()]
        for bounds in (self._first, *self._others.values()):
            stream, follow_m = bounds.limits.position_stream, bounds.limits.follow_m
            looks += [(stream, bounds.position), (bounds.limits.pose_stream, bounds.pose)]
            if stream is not None:
                followed = Followed(follow_m, bounds.where)
                self._followed[stream.partition(".")[0]] = followed
                looks.append((stream, followed.see))
        looks += [(stream, each.see) for each in self._agreeing for stream in each.streams]
        self._looks: dict[str, list[Look]] = {}
        for stream, look in looks:
            if stream is not None:
                self._looks.setdefault(stream, []).append(look)
        self.arrivals = Arrivals(settings.stale_s, settings.stuck_s)
        self.reset()

    def reset(self, range_streams: frozenset[str] = frozenset()) -> None:
        """Begin a trial: empty the filter, forget how old each stream is.

        Args:
            range_streams: Streams that this trial has watched like `limits.range_streams`.
        """
        self.inputs = frozenset((*self._looks, *self.settings.range_streams, *range_streams))
        self._tail_n: list[float] = []
        # What pressed beyond the limit ever since the trial began; infinite before the first sample, then 0.
        self._start_contact_n = math.inf
        self._stopped_s: float | None = None
        # each mover's last motion, the newest last, and whether it led back along its axis
        self._last: dict[str, tuple[Command, bool]] = {}
        self._crushes = False
        self._approach, self._pressed_n, self._braked_m = ("", 0.0), 0.0, math.nan
        for followed in self._followed.values():
            followed.begin()
        for agreeing in self._agreeing:
            agreeing.forget()
        self.arrivals.begin()
        self.arm(frozenset())

    def arm(self, decisive: frozenset[str]) -> None:
        """Watch other streams from now on, beside the guard's own.

        Args:
            decisive: Input streams of the armed detectors: a motion that ends by them needs them alive.
        """
        self.arrivals.depend(self.inputs | decisive)

    def check_streams(
        self, streams: Mapping[str, StreamInfo], sources: Mapping[str, Sequence[str]] | None = None
    ) -> None:
        """See that what is to be watched is there, before anything moves.

        Args:
            streams: All that can be subscribed to, by name.
            sources: Of which other streams each signal is made.

        Raises:
            GuardRefusal: a stream that nothing sends, or one with too few channels.
        """
        self.arrivals.know_streams(streams, sources or {})
        settings = self.settings
        needed = [("limits.force_stream", settings.force_stream, max(settings.force_channels) + 1)]
        for bounds in (self._first, *self._others.values()):
            needed += [
                (f"{bounds.where}.position_stream", bounds.limits.position_stream, 1),
                (f"{bounds.where}.pose_stream", bounds.limits.pose_stream, 3),
            ]
        needed += [("limits.range_streams", name, 1) for name in settings.range_streams]
        for key, agreement in settings.agree.items():
            sides = zip(agreement.streams, agreement.channels, strict=True)
            needed += [(f"limits.agree.{key}.streams", name, channel + 1) for name, channel in sides]
        for key, name, channels in needed:
            if name is None or name not in self.inputs:
                continue
            if name not in streams:
                known = ", ".join(sorted(streams))
                raise GuardRefusal(f"{key} = {name}: the bench has no such stream; it has {known}")
            if len(streams[name].channels) < channels:
                raise GuardRefusal(
                    f"{key} = {name}: channel {channels - 1} is to be watched, but it has"
                    f" {len(streams[name].channels)}; count from 0"
                )
            unit, found = UNITS.get(key.rpartition(".")[2]), streams[name].unit or "no unit"
            if unit not in (None, found):
                reason = f"{key} = {name}: it is in {found}, its limit is in {unit}"
                raise GuardRefusal(f"{reason}; name a stream in {unit}, or scale this one")

    def admit(self, command: Command) -> Command:
        """Admit a command, with the bound that its mover's device shall hold, or refuse it with the reason.

        Returns:
            The command, its numbers as floats.

        Raises:
            GuardRefusal: no finite number, too fast, beyond the travel, a motion that no limit is known for, or one
                that may add load after the trial was stopped.
        """
        command = normalised(command)
        what = f"{type(command).__name__}({command.device})"
        if self._stopped_s is not None and not self._takes_load_away(command):
            raise GuardRefusal(
                f"{what}: the trial was stopped; until its end only Stop, Home, Release and motion back along the axis"
                " are admitted"
            )
        if isinstance(command, MoveAt | MoveTo | Twist | MovePose):
            self._admit_direction(what, command)
            admitted = self._bounds_of(what, command.device).admit(what, command)
            if (speed_m_s := _approaching_m_s(command)) and (
                reason := refusal(self.settings, speed_m_s, self._turn_s)
            ):
                raise GuardRefusal(f"{what}: {reason}")
            self._remember(command)
            return admitted
        if isinstance(command, Grip | Release):
            self._others.get(command.device, self._first).admit_speed(what, command.speed_m_s)
            limit_n = self.settings.grip_n
            if isinstance(command, Grip) and not 0.0 < command.force_n <= limit_n:
                raise GuardRefusal(
                    f"{what}: {command.force_n:.6g} N is outside 0 .. limits.grip_n = {limit_n:.6g}"
                )
            self._remember(command)
        elif isinstance(command, Home | Lead):
            self._remember(command)
        elif isinstance(command, MOTION):
            raise GuardRefusal(f"{what}: no limit is known for this motion")
        return command

    def sent(self, command: Command) -> None:
        """A command went to its device as it is here: what that measures must follow."""
        followed = self._followed.get(command.device)
        if followed is not None:
            followed.sent(command)
        if isinstance(command, Stop) and command.device == self._approach[0]:
            self._braked_m = math.nan if followed is None else followed.place_m
        for agreeing in self._agreeing:
            if isinstance(command, Tare) and command.stream in agreeing.streams:
                agreeing.forget()

    def foreseen(self, t_s: float, command: Command) -> Forecast | None:
        """What an approach that begins with an admitted command will do; None of any other command, of one that goes on
        as fast, or where that is not known."""
        speed_m_s = _approaching_m_s(command)
        found = forecast(self.settings, speed_m_s, self._turn_s) if speed_m_s else None
        if found is None or self._approach == (command.device, speed_m_s):
            return None
        self._approach, self._pressed_n, self._braked_m = (command.device, speed_m_s), 0.0, math.nan
        return Forecast(t_s, command.device, speed_m_s, *found)

    def answered(self, status: Status) -> Approached | None:
        """A mover's newest command is answered; what an approach did, where one is over by it."""
        if status.device in self._followed:
            self._followed[status.device].rest()
        if not isinstance(status, Reached | Standstill) or status.device != self._approach[0]:
            return None
        self._approach = ("", 0.0)
        travel_m = abs(status.position_m - self._braked_m)
        return Approached(status.t_s, status.device, travel_m, self._pressed_n)

    def way_out(self) -> tuple[Command, float] | None:
        """What is to be sent after a stop that was not enough, and for how long, s: the way back of what moved last,
        once. None where the stop was enough, or no way back is known."""
        last, went_back = next(reversed(self._last.values()), (None, False))
        crushes, self._crushes = self._crushes, False
        if not crushes or went_back or not isinstance(last, Grip | MoveAt | MoveTo):
            return None
        self._start_contact_n = math.inf  # on the way back what presses falls from here
        if isinstance(last, Grip):
            return Release(last.device, last.speed_m_s), self.settings.retreat_m / last.speed_m_s
        bounds = self._others.get(last.device, self._first).limits
        speed_m_s = min(RETREAT_M_S, bounds.speed_m_s)
        # Not beyond where approaches begin, unless it is there already: a device may have no travel behind that.
        behind = self._place_m(last.device) <= 0.0
        end_m = bounds.travel_min_m if behind else 0.0
        back = MoveAt(last.device, -speed_m_s, end_m, blind_travel_m=bounds.blind_travel_m)
        return back, self.settings.retreat_m / speed_m_s

    @property
    def looks_on_s(self) -> float:
        """How long what presses must be seen after a stop, before it is known whether that was enough, s."""
        watched = self.settings.retreat_n is not None and self._stopped_s is not None
        return 2.0 * self.settings.force_median_s if watched else 0.0

    def see_braking(self, blocks: Iterable[SampleBlock]) -> str | None:
        """What comes while everything brakes: it may press ever more, until a stop is not enough; on the way back it
        may only fall. Returns why not, where it does not."""
        forces = [block for block in blocks if block.stream == self.settings.force_stream and len(block)]
        reasons = [self._force(block) for block in forces] if self.settings.force_n is not None else []
        return next(filter(None, reasons), None)

    def _remember(self, command: Command) -> None:
        """A mover's last motion, by which its way out is known."""
        if self._stopped_s is None:
            self._last.pop(command.device, None)
            self._last[command.device] = command, self._goes_back(command)

    def latch(self, t_s: float) -> None:
        """The trial was stopped at `t_s`, for whatever reason: until `reset` only what takes load away is admitted.

        What presses may grow while the movers brake, and then only fall; where they are is no reason to stop again.
        """
        if self._stopped_s is None:
            self._stopped_s, self._start_contact_n = t_s, math.inf

    def _takes_load_away(self, command: Command) -> bool:
        """Whether a command adds no load, where a trial was stopped. What stopped a motion back along the axis may
        stand behind it: then there is no way but home."""
        if isinstance(command, MoveAt | MoveTo):
            _, went_back = self._last.get(command.device, (None, False))
            return self._goes_back(command) and not went_back
        if isinstance(command, SetTendon):
            return command.position_m <= 0.0
        return isinstance(command, Home | Release) or not isinstance(command, MOTION)

    def _admit_direction(self, what: str, command: Command) -> None:
        """Where the trial began in contact, and still is: out of it alone."""
        if self.in_contact_from_start and not self._goes_back(command):
            raise GuardRefusal(
                f"{what}: the trial began in contact, at {self._start_contact_n:.3g} N still, beyond limits.force_n ="
                f" {self.settings.force_n:g}; send Home first, or back along the axis"
            )

    def _goes_back(self, command: Command) -> bool:
        """Whether it leads back along its mover's axis, from where that was seen last; where it was not seen, only a
        way to the axis' zero, or behind it, counts as one. What homes, goes back."""
        if isinstance(command, MoveAt):
            return command.velocity_m_s < 0.0
        if isinstance(command, MoveTo):
            place_m = self._place_m(command.device)
            return command.position_m <= (0.0 if math.isnan(place_m) else place_m)
        return isinstance(command, Home)

    def _place_m(self, device: str) -> float:
        """Where a mover was seen last in this trial; NaN where it was not, or where nothing follows it."""
        return self._followed[device].place_m if device in self._followed else math.nan

    def _bounds_of(self, what: str, device: str) -> Bounds:
        """A mover's own limits; another mover's do not apply to it."""
        if device in self._others:
            return self._others[device]
        self._carrier = self._carrier or device
        if device != self._carrier:
            raise GuardRefusal(
                f"{what}: [limits] are those of {self._carrier}; give {device} its own in [limits.movers.{device}]"
            )
        return self._first

    def check(
        self,
        t_s: float,
        blocks: Iterable[SampleBlock],
        moving: bool,
        late_s: float = 0.0,
        saturated: Sequence[Saturated] = (),
    ) -> str | None:
        """See one turn of the loop.

        Force and travel count whether anything moves or not, wherever the loop subscribes to them: while anything
        moves, in a pause, and in every state with a subscription. A late loop counts while something moves.

        Args:
            late_s: How much later than planned the turn began.
            saturated: Streams that left their valid range.

        Returns:
            Why every mover must stop now, or None.
        """
        settings = self.settings
        reasons = [
            f"{status.stream} is beyond its range, at {status.value:.4g}: it is no longer valid"
            for status in saturated
        ]
        braking = self._stopped_s is not None and t_s <= self._stopped_s + BRAKING_S
        for block in blocks:
            for look in self._looks.get(block.stream, ()) if len(block) else ():
                # After a stop force alone counts: where the movers are is no reason to stop again.
                if self._stopped_s is None or look == self._force:
                    reason = look(block)
                    reasons += [] if reason is None or braking else [reason]
        if braking:
            self._start_contact_n = math.inf
        if moving and late_s > settings.late_s:
            reasons.append(f"the loop is {late_s:.3f} s late (limits.late_s = {settings.late_s:g})")
        return reasons[0] if reasons else None

    @property
    def in_contact_from_start(self) -> bool:
        """Whether the trial began in contact and is still there: the limit follows it down, turn by turn."""
        return 0.0 < self._start_contact_n < math.inf

    def _force(self, block: SampleBlock) -> str | None:
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
        # A median cannot exceed the largest, so this is all that a quiet turn costs where nothing approaches.
        quiet = first_outside(joined_n, -limit_n, limit_n) is None
        if quiet and joined_n:
            self._start_contact_n = 0.0
        if quiet and not self._approach[0]:
            return None
        joined = np.array(joined_n)
        if not np.isfinite(joined).all():
            self._tail_n = []
            return f"{block.stream} reads {joined[~np.isfinite(joined)][0]}"
        if len(joined) <= keep:
            return None
        windows = np.lib.stride_tricks.sliding_window_view(joined, keep + 1)
        signed_n = np.median(windows, axis=1)
        medians_n = np.abs(signed_n)
        self._pressed_n = max(self._pressed_n, float(medians_n.max()))
        if quiet:
            return None
        # Each window is held against the least before it: a rise is seen however the samples are cut.
        least_n = np.minimum.accumulate(np.append(self._start_contact_n, medians_n))
        allowed_n = np.where(least_n > limit_n, least_n + RELIEF * limit_n, limit_n)
        if settings.retreat_n is not None and (self._start_contact_n == 0.0 or self._stopped_s is not None):
            self._crushes |= bool(medians_n.max() > settings.retreat_n)
        if (medians_n <= allowed_n[:-1]).all():
            self._start_contact_n = float(least_n[-1]) if least_n[-1] > limit_n else 0.0
            return None
        first_n = signed_n[(medians_n > allowed_n[:-1]).argmax()]  # the same however the samples are cut
        return (
            f"{block.stream} is at {first_n:.3f} N ({settings.force_median_s * 1e3:g} ms median),"
            f" beyond limits.force_n = {limit_n:g}"
        )


def _approaching_m_s(command: Command) -> float:
    """Speed of a motion beyond its mover's zero, along its axis; 0 of any other command."""
    if isinstance(command, MoveAt):
        return max(0.0, command.velocity_m_s)
    return command.speed_m_s if isinstance(command, MoveTo) and command.position_m > 0.0 else 0.0


__all__ = ["Guard", "GuardRefusal", "GuardSettings"]

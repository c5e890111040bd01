"""The linear stage of the mock bench: commands move a simulated axis in the process."""

import math
from collections.abc import Sequence

import numpy as np
from pydantic import Field

from drivers.core.clock import last_tick
from drivers.core.messages import (
    Command,
    DeviceInfo,
    Failed,
    Home,
    Listen,
    MoveAt,
    MoveTo,
    Reached,
    SampleBlock,
    Stalled,
    Standstill,
    Status,
    Stop,
    StreamInfo,
)
from drivers.zaber_stage.codec import LONGEST_S
from drivers.zaber_stage.mounting import NOT_HOMED, Mounting, StageLimits
from simulator.devices.faults import Fault
from simulator.mocks.base import MockDriver
from simulator.physics.stage_axis import STAGE_HOME_M_S, STAGE_M_S, STAGE_M_S2, StageAxis


class MockZaberStageSettings(StageLimits):
    """The mock stage: the real one's limits, without its link."""

    position_hz: float = Field(default=100.0, gt=0.0, le=1000.0)
    """How often the position is reported while it is subscribed; the real driver polls about as often."""

    acceleration_m_s2: float = Field(default=STAGE_M_S2, gt=0.0, le=100.0)
    """Of every motion."""


class MockZaberStage(MockDriver):
    """An axis that carries the bench's probe, with the real driver's limits and refusals; can be made to fail.

    It is homed where it was once, in whichever trial. A motion that is not read (`read`, `poll`) halts at the end
    of its command's `blind_travel_m` and goes on at the next reading, as the real stage does.
    """

    _settings: MockZaberStageSettings

    def _wire(self) -> None:
        settings = self._settings
        self._mounting = Mounting(settings)
        self.axis = StageAxis(
            acceleration_m_s2=settings.acceleration_m_s2, max_speed_m_s=max(STAGE_M_S, settings.max_speed_m_s)
        )
        self._bench.mount(self.axis)
        self._info = StreamInfo(
            f"{self.name}.position", ("position",), "m", settings.microstep_m, longest_s=LONGEST_S
        )
        self._homed = False

    def restart(self) -> None:
        """Begin a trial: bench time is zero again."""
        self._listening = False
        self._next_sample = 0
        self._seq = 0
        self._answer: type[Reached | Standstill] | None = None
        self._command: Command | None = None  # the last one that moves or stops
        self._seen_s = self.watched_until_s = 0.0
        self._commanded_s = 0.0
        super().restart()

    def open(self) -> DeviceInfo:
        """Nothing to connect to."""
        return DeviceInfo(
            self.name,
            model="simulated stage",
            streams={self._info.name: self._info},
            mover=True,
            clock="bench",
            details={"travel_m": (self._settings.travel_min_m, self._settings.travel_max_m)},
        )

    def close(self) -> None:
        """Nothing to release; the axis stops."""
        self.axis.stop(self._clock.now())

    def apply(self, command: Command) -> Command:
        """Change the axis's plan from now on. Too great a speed is clamped.

        Raises:
            CommandError: not for a stage, not finite or out of range.
        """
        command = self._settings.valid(self.name, command)
        now_s = self._clock.now()
        self._look(now_s)
        if isinstance(command, Listen):
            wanted = self._info.name in command.streams
            if wanted and not self._listening:
                self._next_sample = last_tick(now_s, self._settings.position_hz) + 1
            self._listening = wanted
            return command
        if self._faults.active(now_s, "unplug"):
            # The cable is out: the axis goes on to where its own controller lets it, and reports nothing.
            self._report(Failed(now_s, self.name, "the link is gone"))
            return command
        if self._faults.active(now_s, "silent"):
            return command
        reason = self._refusal(command, now_s)
        if reason:
            self._leave_alone(now_s)
            self._refuse(command, reason)
            return command
        self._move(command, now_s)
        self._sent(command)
        return command

    def _refusal(self, command: Command, now_s: float) -> str:
        if not isinstance(command, MoveAt | MoveTo):
            return ""
        if self._faults.active(now_s, "refuse"):
            return "the stage refuses (injected fault)"
        if not self._homed:
            return NOT_HOMED
        here = round(self.axis.position(now_s) / self._settings.microstep_m)
        return self._mounting.refusal(command, here, self._settings.acceleration_m_s2)

    def _move(self, command: Command, now_s: float) -> None:
        self._commanded_s, self._command = now_s, command
        self._seen_s = now_s
        self._answer = Standstill if isinstance(command, Stop) else Reached
        mounting = self._mounting
        match command:
            case MoveAt() | MoveTo():
                self._go(command, now_s, mounting.position_m(mounting.target(command)))
            case Home():
                self.axis.move_to(now_s, mounting.position_m(mounting.counts(0)), STAGE_HOME_M_S)
                self._bench.on_plan(now_s)
            case Stop():
                self.axis.stop(now_s)
                self._bench.on_plan(now_s)

    def _look(self, now_s: float) -> None:
        """Read where it is; a motion that was not read in time has halted on the way, and goes on now.

        The real stage is sent on while it moves, and shows none of it where that comes in time.
        """
        axis, command, seen_s = self.axis, self._command, self._seen_s
        gone = self._gone(now_s)
        if not gone:
            self._seen_s = now_s
        if (
            not isinstance(command, MoveAt | MoveTo)
            or not axis.moving(seen_s)
            or now_s <= self.watched_until_s
        ):
            return
        target_m, from_m = axis.target_m, axis.position(seen_s)
        braking_m = axis.velocity(now_s) ** 2 / (2.0 * axis.acceleration_m_s2)
        if abs(axis.position(now_s) - from_m) + braking_m > command.blind_travel_m:
            self._bound(command, seen_s)
            if not gone:
                self._go(command, now_s, target_m)

    @property
    def alone_s(self) -> float:
        """How long it may go unread: then it reports that a motion has ended."""
        return math.inf if self._answer is None else self.axis.arrival_s - self._clock.now()

    @property
    def blind_s(self) -> float:
        """How long it may be left alone: then it halts on its way."""
        command = self._command
        if not isinstance(command, MoveAt | MoveTo):
            return math.inf
        speed_m_s = abs(command.velocity_m_s) if isinstance(command, MoveAt) else command.speed_m_s
        braking_m = speed_m_s**2 / (2.0 * self.axis.acceleration_m_s2)
        return (command.blind_travel_m - braking_m) / speed_m_s

    def _leave_alone(self, now_s: float) -> None:
        """The motion under way is no longer read: it ends where the device was sent, unreported."""
        if isinstance(self._command, MoveAt | MoveTo) and self.axis.moving(now_s):
            self._bound(self._command, now_s)
        self._command = self._answer = None

    def _bound(self, command: MoveAt | MoveTo, seen_s: float) -> None:
        """Halt a motion as far beyond where it was seen last as its command lets it go blindly."""
        way_m = self.axis.target_m - self.axis.position(seen_s)
        if abs(way_m) > command.blind_travel_m:
            end_m = self.axis.position(seen_s) + math.copysign(command.blind_travel_m, way_m)
            self._go(command, seen_s, end_m)

    def _go(self, command: MoveAt | MoveTo, t_s: float, end_m: float) -> None:
        speed_m_s = abs(command.velocity_m_s) if isinstance(command, MoveAt) else command.speed_m_s
        if (fault := self._faults.on(t_s, "overrun")) is not None:
            end_m += math.copysign(fault.much, end_m - self.axis.position(t_s))
        self.axis.move_to(t_s, end_m, speed_m_s)
        self._bench.on_plan(t_s)

    @property
    def _command_id(self) -> int:
        return 0 if self._command is None else self._command.id

    def read(self) -> Sequence[SampleBlock]:
        """Positions reported since the last call."""
        now_s = self._clock.now()
        self._look(now_s)
        rate_hz = self._settings.position_hz
        last = last_tick(now_s, rate_hz)
        if not self._listening or last < self._next_sample or self._faults.active(now_s, "silent"):
            return ()
        times_s = np.arange(self._next_sample, last + 1) / rate_hz
        self._next_sample = last + 1
        t0_s, microstep_m = float(times_s[0]), self._settings.microstep_m
        counts = np.array(
            [[round(self.axis.position(t_s) / microstep_m)] for t_s in times_s.tolist()], np.int64
        )
        block = self._info.block(self._seq, t0_s, counts, times_s=times_s, device_t0_s=t0_s, arrival_s=now_s)
        self._seq += len(counts)
        return (block,)

    def poll(self) -> Sequence[Status]:
        """What became of the commands."""
        now_s = self._clock.now()
        self._look(now_s)
        fault = self._faults.begun(now_s, "stall")
        if fault is not None:
            self._stall(fault, now_s)
        return super().poll()

    def _turn(self) -> None:
        """Report where a motion has ended."""
        now_s, axis = self._clock.now(), self.axis
        if self._answer is not None and not axis.moving(now_s) and not self._gone(now_s):
            self._homed = self._homed or isinstance(self._command, Home)
            at_s = max(axis.arrival_s, self._commanded_s)
            self._report(self._answer(at_s, self.name, axis.target_m, command_id=self._command_id))
            self._answer = None

    def _stall(self, fault: Fault, now_s: float) -> None:
        self.axis.stall(now_s)
        self._bench.on_plan(now_s)
        self._answer = None
        reason = f"stalled ({fault.kind} injected at {fault.at_s:g} s)"
        self._report(Stalled(now_s, self.name, reason, command_id=self._command_id))

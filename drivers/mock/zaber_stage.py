"""The linear stage of the mock bench: commands move a simulated axis in the process."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from pydantic import Field

from drivers.clock import Clock, last_tick
from drivers.errors import CommandError
from drivers.messages import (
    Applied,
    Command,
    DeviceInfo,
    Failed,
    Home,
    Listen,
    MoveAt,
    MoveTo,
    Reached,
    Refused,
    SampleBlock,
    Sent,
    Stalled,
    Standstill,
    Status,
    Stop,
    StreamInfo,
)
from drivers.mock.faults import Fault, FaultSchedule
from drivers.mock.finger_bench import FingerBench
from drivers.mock.plants.stage_axis import STAGE_M_S, STAGE_M_S2, StageAxis
from drivers.settings import Settings
from drivers.zaber_stage.codec import MICROSTEP_M


class MockZaberStageSettings(Settings):
    """The mock stage."""

    position_hz: float = Field(default=100.0, gt=0.0, le=1000.0)
    """How often the position is reported while it is listened to; the real driver polls about as often."""

    travel_m: float = Field(default=0.0254, gt=0.0, le=1.0)
    """The device's own travel limit. Source: a stage of one inch, as the paper's micrometer positions need."""

    acceleration_m_s2: float = Field(default=STAGE_M_S2, gt=0.0, le=100.0)
    """Of every motion."""

    max_speed_m_s: float = Field(default=STAGE_M_S, gt=0.0, le=1.0)
    """No command makes it faster."""


class MockZaberStage:
    """An axis that carries the bench's probe; obeys its own travel limit, can be told to fail.

    Args:
        name: In the profile.
        settings: Of the stage.
        clock: Bench time.
        bench: Where the probe is that the axis carries.
        faults: What goes wrong, and when.

    Attributes:
        axis: Its motion.
    """

    def __init__(
        self,
        name: str,
        settings: MockZaberStageSettings,
        clock: Clock,
        bench: FingerBench,
        faults: FaultSchedule | None = None,
    ) -> None:
        self.name = name
        self._settings = settings
        self._clock = clock
        self.axis = StageAxis(
            acceleration_m_s2=settings.acceleration_m_s2, max_speed_m_s=settings.max_speed_m_s
        )
        self._bench = bench
        bench.mount(self.axis)
        self._faults = faults or FaultSchedule()
        self._stream = f"{name}.position"
        self.restart()

    def restart(self) -> None:
        """Begin a trial: bench time is zero again."""
        self._listening = False
        self._next_sample = 0
        self._seq = 0
        self._answer: type[Reached | Standstill] | None = None
        self._commanded = 0
        self._commanded_s = 0.0
        self._statuses: list[Status] = []
        self._faults.restart()

    def open(self) -> DeviceInfo:
        """Nothing to connect to."""
        stream = StreamInfo(self._stream, ("position",), "m", MICROSTEP_M)
        return DeviceInfo(
            self.name,
            model="simulated stage",
            streams={self._stream: stream},
            mover=True,
            clock="bench",
            details={"travel_m": self._settings.travel_m},
        )

    def close(self) -> None:
        """Nothing to let go of; the axis stops."""
        self.axis.stop(self._clock.now())

    def apply(self, command: Command) -> Applied:
        """Change the axis's plan from now on.

        Raises:
            CommandError: not for a stage, or beyond its travel.
        """
        now_s = self._clock.now()
        if isinstance(command, Listen):
            if command.streams and not self._listening:
                self._next_sample = last_tick(now_s, self._settings.position_hz) + 1
            self._listening = bool(command.streams)
            return Applied(command, now_s)
        if self._faults.active(now_s, "unplug"):
            # The cable is out: the axis goes on to where its own controller lets it, and says nothing.
            self._statuses.append(Failed(now_s, self.name, "the link is gone"))
            return Applied(command, now_s)
        if self._faults.active(now_s, "silent"):
            return Applied(command, now_s)
        self._move(command, now_s)
        self._statuses.append(Sent(now_s, self.name, command))
        return Applied(command, now_s)

    def _move(self, command: Command, now_s: float) -> None:
        self._commanded_s, self._commanded = now_s, command.id
        axis = self.axis
        if isinstance(command, MoveAt | MoveTo):
            target_m = command.limit_m if isinstance(command, MoveAt) else command.position_m
            speed_m_s = abs(command.velocity_m_s) if isinstance(command, MoveAt) else command.speed_m_s
            if not (math.isfinite(target_m) and 0.0 <= target_m <= self._settings.travel_m):
                raise CommandError(
                    self.name,
                    f"moving to {target_m:g} m",
                    f"the stage reaches from 0 to {self._settings.travel_m:g} m",
                    "choose a target inside its travel",
                )
            if not (math.isfinite(speed_m_s) and speed_m_s > 0.0):
                raise CommandError(
                    self.name,
                    f"moving at {speed_m_s:g} m/s",
                    "that is no speed",
                    "give a finite one above zero",
                )
            if self._faults.active(now_s, "refuse"):
                self._statuses.append(
                    Refused(now_s, self.name, command, "the stage refuses (injected fault)")
                )
                return
        if isinstance(command, MoveAt):
            axis.move_at(now_s, command.velocity_m_s, command.limit_m)
            self._answer = Reached
        elif isinstance(command, MoveTo):
            axis.move_to(now_s, command.position_m, command.speed_m_s)
            self._answer = Reached
        elif isinstance(command, Stop):
            axis.stop(now_s)
            self._answer = Standstill
        elif isinstance(command, Home):
            self._answer = Reached  # the simulated stage has never lost its reference
        else:
            raise CommandError(
                self.name, f"applying {command}", "a stage only moves", "send it to another device"
            )
        self._bench.on_plan(now_s)

    def read(self) -> Sequence[SampleBlock]:
        """Positions reported since the last call."""
        now_s = self._clock.now()
        rate_hz = self._settings.position_hz
        last = last_tick(now_s, rate_hz)
        if not self._listening or last < self._next_sample or self._faults.active(now_s, "silent"):
            return ()
        times_s = np.arange(self._next_sample, last + 1) / rate_hz
        self._next_sample = last + 1
        counts = [round(self.axis.position(t_s) / MICROSTEP_M) for t_s in times_s.tolist()]
        block = SampleBlock(
            self._stream,
            self._seq,
            float(times_s[0]),
            np.array(counts, dtype=np.int64)[:, None],
            times_s=times_s,
            unit="m",
            scale=MICROSTEP_M,
            device_t0_s=float(times_s[0]),
            arrival_s=now_s,
        )
        self._seq += len(counts)
        return (block,)

    def account(self) -> Mapping[str, object]:
        """No link, nothing to tell."""
        return {}

    def poll(self) -> Sequence[Status]:
        """What became of the commands."""
        now_s = self._clock.now()
        fault = self._faults.begun(now_s, "stall")
        if fault is not None:
            self._stall(fault, now_s)
        failed = self._faults.failure(now_s, self.name)
        if failed is not None:
            self._statuses.append(failed)
        axis = self.axis
        deaf = self._faults.active(now_s, "silent") or self._faults.active(now_s, "unplug")
        if self._answer is not None and not axis.moving(now_s) and not deaf:
            at_s = max(axis.arrival_s, self._commanded_s)
            self._statuses.append(self._answer(at_s, self.name, axis.target_m, command_id=self._commanded))
            self._answer = None
        taken, self._statuses = self._statuses, []
        return taken

    def _stall(self, fault: Fault, now_s: float) -> None:
        self.axis.stall(now_s)
        self._bench.on_plan(now_s)
        self._answer = None
        self._statuses.append(
            Stalled(
                now_s,
                self.name,
                f"stalled ({fault.kind} injected at {fault.at_s:g} s)",
                command_id=self._commanded,
            )
        )

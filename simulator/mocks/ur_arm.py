"""The arm of the mock bench: its tool carries the probe along the approach axis, in the process."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from drivers.arm.axis import Axis, turned_by
from drivers.arm.commands import valid
from drivers.arm.guidance import CYCLE_S, leash_end, line_speed, travel_end
from drivers.arm.motion import STILL_S
from drivers.arm.stream import infos
from drivers.core.clock import last_tick
from drivers.core.messages import (
    Command,
    DeviceInfo,
    Home,
    Lead,
    Listen,
    MoveAt,
    MovePose,
    MoveTo,
    Reached,
    SampleBlock,
    Stalled,
    Standstill,
    Status,
    Stop,
    Tare,
    Twist,
)
from drivers.ur_arm.settings import UrArmSettings
from drivers.ur_arm.tool import stated
from simulator.mocks.base import MockDriver
from simulator.physics.noise import gaussian_at
from simulator.physics.tool_motion import ToolMotion, repeats

STREAM_WRENCH = 32
"""Number of the wrench's noise among the bench's counter-based streams; the plant has those below."""

HALT_M_S2 = 5.0
"""Deceleration of an arm that stops by itself (assumption, as the emulated controller's)."""


class MockUrArmSettings(UrArmSettings):
    """The real arm's settings, so that a profile changes its port alone; those of the link mean nothing here."""

    force_noise_n: float = Field(0.5, ge=0.0, le=20.0)
    """Standard deviation of each force channel (assumption; the data sheet's precision is 3.5 N)."""
    torque_noise_n_m: float = Field(0.02, ge=0.0, le=2.0)
    """Standard deviation of each torque channel (assumption; the data sheet's precision is 0.2 N m)."""


class MockUrArm(MockDriver):
    """An arm that moves its tool within the real driver's limits and with its messages.

    It follows trapezoids in closed form, which cost the plant nothing; kinematics are the emulated controller's. A
    newer motion takes over from the present velocity; a straight move brakes first, where it does not go on along the
    axis. A stall is a protective stop: motions are refused until `Home`.

    Attributes:
        axis: Motion of the tool, along the approach axis and beside it.
    """

    _settings: MockUrArmSettings

    def _wire(self) -> None:
        settings = self._settings
        self._towards = Axis(settings)
        self.axis = ToolMotion(
            self._towards.direction,
            acceleration_m_s2=settings.acceleration_m_s2,
            max_speed_m_s=settings.max_speed_m_s,
        )
        self._bench.mount(self.axis)
        self._infos = infos(self.name, settings.rate_hz)
        force = f"{self.name}.force"
        self._infos[force] = replace(self._infos[force], noisy=settings.force_noise_n > 0.0)

    def restart(self) -> None:
        """Begin a trial: bench time is zero again."""
        self._subscribed: frozenset[str] = frozenset()
        self._bench.feel(False)
        self._next_tick = 0
        self._seq = 0
        self._zero = np.zeros(6)
        self._halted = ""
        self._answer: type[Reached | Standstill] | None = None
        self._commanded = 0
        self._fence = ""
        self._seen_s = self._heard_s = self.watched_until_s = 0.0
        self._tripped = False
        super().restart()

    def open(self) -> DeviceInfo:
        """Nothing to connect to."""
        settings = self._settings
        return DeviceInfo(
            self.name,
            model="simulated arm",
            streams=self._infos,
            mover=True,
            clock="bench",
            details={
                **stated(settings).details(settings),
                "travel_m": (settings.travel_min_m, settings.travel_max_m),
                "max_speed_m_s": settings.max_speed_m_s,
            },
        )

    def close(self) -> None:
        """Nothing to release; the arm stops."""
        now_s = self._clock.now()
        if self.axis.moving(now_s):
            self._brake(now_s, self._settings.stop_m_s2)

    # --- commands --------------------------------------------------------------------------------------

    def apply(self, command: Command) -> Command:
        """Change the arm's motion from now on. Too great a speed is clamped.

        Raises:
            CommandError: not for this arm, not finite or out of range.
        """
        command = valid(self.name, self._settings, self._infos, command)
        now_s = self._clock.now()
        self._look(now_s)
        if isinstance(command, Listen):
            self._listen(command.streams & self._infos.keys(), now_s)
        elif not self._gone(now_s):
            reason = self._refusal(command, now_s)
            if reason:
                self._refuse(command, reason)
            else:
                self._obey(command, now_s)
                self._sent(command)
        return command

    def _refusal(self, command: Command, now_s: float) -> str:
        if isinstance(command, Tare):
            return "the arm is not standing still" if self.axis.moving(now_s) else ""
        if isinstance(command, Lead):
            return "nobody leads a simulated arm by hand"
        if isinstance(command, Home):
            away_m = float(np.linalg.norm(self._offset(now_s)[:3]))
            leash_m = self._settings.leash_m
            far = f"the tool is {away_m:.3f} m from start_pose, its leash is {leash_m:g} m"
            return far if away_m > leash_m else ""
        if isinstance(command, MoveAt | MoveTo | MovePose | Twist):
            if self._faults.active(now_s, "refuse"):
                return "the arm refuses (injected fault)"
            return self._halted and f"{self._halted}; look at the arm, then send it Home"
        return ""

    def _obey(self, command: Command, now_s: float) -> None:
        self._fence = ""
        over = self._faults.on(now_s, "overrun") if isinstance(command, MoveAt | MoveTo) else None
        over_m = over.much if over is not None else 0.0
        match command:
            case MoveAt():
                end_m = command.limit_m + math.copysign(over_m, command.velocity_m_s)
                self.axis.move_at(now_s, command.velocity_m_s, end_m)
            case MoveTo():
                end_m = command.position_m + math.copysign(
                    over_m, command.position_m - self.axis.position(now_s)
                )
                self.axis.move_to(now_s, end_m, command.speed_m_s)
            case MovePose():
                way_m = float(np.linalg.norm(np.array(command.offset[:3]) - self._offset(now_s)[:3]))
                speed = line_speed(self._settings, way_m, command.speed_m_s)
                self.axis.move_pose(now_s, command.offset, speed)
            case Twist():
                self.axis.twist(now_s, command.twist, command.duration_s)
                self._fence = self._fenced(now_s)
            case Home():
                self._halted = ""
                self.axis.move_to(now_s, 0.0, self._settings.home_speed_m_s)
            case Stop():
                self.axis.stop(now_s, self._settings.stop_m_s2)
            case Tare():
                self._bench.advance(now_s)
                self._zero = self._bench.wrench(np.array([now_s]), self._towards.direction)[0]
                return
        self._answer = Standstill if isinstance(command, Stop) else Reached
        self._commanded = command.id
        self._bench.on_plan(now_s)

    def _fenced(self, now_s: float) -> str:
        """Stop a free motion where it would run over a bound, as the real arm's process does; which bound, or ""."""
        settings, cycles = self._settings, np.arange(1, 1 + (self.axis.arrival_s - now_s) // CYCLE_S)
        times_s = now_s + CYCLE_S * cycles
        here_m, away_m = self.axis.position(now_s), float(np.linalg.norm(self._offset(now_s)[:3]))
        rests = self.axis.rests(times_s, settings.stop_m_s2)
        away = np.linalg.norm(rests[:, :4], axis=1) > max(settings.leash_m, away_m)
        lowest_m, highest_m = min(settings.travel_min_m, here_m), max(settings.travel_max_m, here_m)
        out = away | (rests[:, 0] < lowest_m) | (rests[:, 0] > highest_m)
        if not out.any():
            return ""
        first = int(np.argmax(out))
        # One cycle before, it could still brake in time.
        self.axis.stop(float(times_s[first]) - CYCLE_S, settings.stop_m_s2)
        return leash_end(settings) if away[first] else travel_end(self.axis.target_m)

    def _offset(self, t_s: float) -> NDArray[np.float64]:
        """Displacement from the start pose, shape (6,)."""
        found: NDArray[np.float64] = self.axis.offsets(np.array([t_s]))[0]
        return found

    def _look(self, now_s: float) -> None:
        """Stop what has moved without being looked at for `loop_timeout_s`, as the real arm's process does; or
        without a sign of life for a period of its watchdog, as the real controller does."""
        if self._faults.active(now_s, "silent"):
            if now_s - self._heard_s > 1.0 / self._settings.watchdog_hz and self.axis.moving(now_s):
                self._tripped, self._halted = True, "its watchdog stopped the arm"
                self._brake(now_s, HALT_M_S2)
        else:
            self._heard_s = now_s
            if self._tripped:
                self._tripped = False
                reason = f"{self._halted}; look at the arm, then send it Home"
                self._report(Stalled(now_s, self.name, reason, command_id=self._commanded))
        blind_s, self._seen_s = self._seen_s + self._settings.loop_timeout_s, now_s
        if now_s > max(blind_s, self.watched_until_s) and self.axis.moving(blind_s):
            self._brake(blind_s, self._settings.stop_m_s2)
            reason = "the program has not looked at it in time; what held its loop up?"
            self._report(Stalled(blind_s, self.name, reason, command_id=self._commanded))

    def _brake(self, now_s: float, deceleration_m_s2: float) -> None:
        self.axis.stop(now_s, deceleration_m_s2)
        self._bench.on_plan(now_s)
        self._answer = None

    def _listen(self, streams: frozenset[str], now_s: float) -> None:
        self._bench.advance(now_s)
        self._bench.feel(f"{self.name}.force" in streams)
        if streams and not self._subscribed:
            self._next_tick = last_tick(now_s, self._settings.rate_hz) + 1
        self._subscribed = streams

    # --- samples ---------------------------------------------------------------------------------------

    def read(self) -> Sequence[SampleBlock]:
        """Rows since the last call, of the subscribed streams."""
        now_s = self._clock.now()
        self._look(now_s)
        last = last_tick(now_s, self._settings.rate_hz)
        if not self._subscribed or last < self._next_tick:
            return ()
        ticks = np.arange(self._next_tick, last + 1)
        times_s = ticks / self._settings.rate_hz
        self._bench.advance(now_s)
        blocks = [self._block(stream, ticks, times_s, now_s) for stream in sorted(self._subscribed)]
        self._next_tick = last + 1
        self._seq += len(ticks)
        return self._passed(blocks, now_s)

    def _block(
        self, stream: str, ticks: NDArray[np.int64], times_s: NDArray[np.float64], now_s: float
    ) -> SampleBlock:
        short = stream.rpartition(".")[2]
        values = self._wrench(ticks, times_s) if short == "force" else self._places(short, times_s)
        t0_s = float(times_s[0])
        return self._infos[stream].block(self._seq, t0_s, values, device_t0_s=t0_s, arrival_s=now_s)

    def _places(self, short: str, times_s: NDArray[np.float64]) -> NDArray[np.float64]:
        if short == "position":
            return self.axis.coordinates(times_s)[:, :1]
        start = self._settings.start_pose
        poses = np.empty((len(times_s), 6))
        poses[:, :3] = np.array(start[:3]) + self.axis.offsets(times_s)[:, :3]
        poses[:, 3:] = start[3:]
        turns = self.axis.turns(times_s)
        if turns.any():
            firsts, run = repeats(turns)
            there = np.array(list(turned_by(turns[firsts].tolist(), start[3:])))
            there[~turns[firsts].any(axis=1)] = start[3:]
            poses[:, 3:] = there[run]
        return poses

    def _wrench(self, ticks: NDArray[np.int64], times_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """What acts on the tool, shape (n, 6): what the bench does to it, and the sensor's own noise.

        A load cell's noise is in it too: a thousandth of the arm's.
        """
        settings = self._settings
        sigma = np.array([settings.force_noise_n] * 3 + [settings.torque_noise_n_m] * 3)
        numbers = (6 * ticks[:, None] + np.arange(6)).ravel()
        values = sigma * gaussian_at(self._bench.key, STREAM_WRENCH, numbers).reshape(-1, 6)
        values += self._bench.wrench(times_s, self._towards.direction) - self._zero
        return np.asarray(values)

    # --- what became of it -----------------------------------------------------------------------------

    def poll(self) -> Sequence[Status]:
        """What became of the commands."""
        now_s = self._clock.now()
        self._look(now_s)
        stall = self._faults.begun(now_s, "stall")
        if stall is not None:
            self._halted = f"the arm is in a protective stop (stall injected at {stall.at_s:g} s)"
            self._brake(now_s, HALT_M_S2)
            reason = f"{self._halted}; look at the arm, then send it Home"
            self._report(Stalled(now_s, self.name, reason, command_id=self._commanded))
        return super().poll()

    @property
    def alone_s(self) -> float:
        """How long it may go unread: then it reports that a motion has ended."""
        return math.inf if self._answer is None else self.axis.arrival_s + STILL_S - self._clock.now()

    @property
    def blind_s(self) -> float:
        """How long it may be left alone: then it stops on its way."""
        return math.inf if self._answer is None else self._settings.loop_timeout_s

    def _cut_off(self, now_s: float) -> None:
        """The controller's watchdog trips: no client leads the arm any more."""
        self._brake(now_s, HALT_M_S2)

    def _turn(self) -> None:
        """Report where a motion has ended."""
        now_s, still_s = self._clock.now(), self.axis.arrival_s + STILL_S
        if self._answer is not None and now_s >= still_s and not self._gone(now_s):
            if self._fence:
                self._report(Stalled(still_s, self.name, self._fence, command_id=self._commanded))
            else:
                self._report(self._answer(still_s, self.name, self.axis.target_m, command_id=self._commanded))
            self._answer, self._fence = None, ""

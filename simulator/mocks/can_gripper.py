"""The gripper of the mock bench: the drive's motion, in the process."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from drivers.can_gripper.codec import DriveOrder
from drivers.can_gripper.units import (
    FORCE_N_PER_MA,
    LONGEST_S,
    POSITION_COUNTS,
    CanGripperLimits,
    GripperUnits,
    speed_ticks_s,
)
from drivers.core.messages import (
    Command,
    DeviceInfo,
    Grip,
    Home,
    Listen,
    Release,
    SampleBlock,
    Status,
    Stop,
    StreamInfo,
)
from drivers.gripper.outcome import GripperOutcome
from drivers.gripper.state import GripFinding, GripperState
from simulator.mocks.base import MockDriver
from simulator.physics.bench import part

WATCHDOG_S = 1.0
"""How long it takes to be told nothing before it goes to sleep: the real driver's own default."""


class MockCanGripperSettings(CanGripperLimits):
    """The mock gripper: the real one's limits, without its link; its brackets are the plant's."""

    poll_hz: float = Field(default=100.0, ge=1.0, le=500.0)
    """How often its state is polled, as in the real driver."""


class MockCanGripper(MockDriver):
    """Moves the bench's jaws through the counts of the real gripper; can be made to fail."""

    _settings: MockCanGripperSettings

    def _wire(self) -> None:
        name, jaws = self.name, part(self._bench, "jaws", self.name)
        self._units = GripperUnits(jaws.closed_width_m)
        self._infos = {
            f"{name}.width": StreamInfo(f"{name}.width", ("width",), "m", longest_s=LONGEST_S),
            f"{name}.force": StreamInfo(
                f"{name}.force", ("force",), "N", FORCE_N_PER_MA, longest_s=LONGEST_S, tared=False
            ),
        }

    def restart(self) -> None:
        """Begin a trial: bench time is zero again."""
        self._outcome = GripperOutcome(self.name, self._units, self._settings.object_hold_s)
        self._order = DriveOrder(0, 0, 0)
        self._subscribed: frozenset[str] = frozenset()
        self._bench.jaws.poll_at(self._settings.poll_hz)
        self._samples: list[tuple[int, GripperState]] = []
        self._heard_s, self._asleep = 0.0, False
        super().restart()

    def open(self) -> DeviceInfo:
        """Nothing to connect to."""
        return DeviceInfo(
            self.name,
            model="simulated gripper",
            streams=self._infos,
            mover=True,
            clock="bench",
            details={
                "closed_width_m": self._units.closed_width_m,
                "open_width_m": self._units.open_width_m,
                "calibrated": self._bench.jaws.calibrated,
            },
        )

    def close(self) -> None:
        """Nothing to release; the jaws hold where they are."""
        self._bench.jaws.advance(self._clock.now())
        if not self._outcome.resting:
            self._hold()

    def apply(self, command: Command) -> Command:
        """Give the drive its order, now.

        Raises:
            CommandError: not for a gripper, not finite or out of range.
        """
        settings, now_s = self._settings, self._clock.now()
        command = self._units.checked(self.name, command, settings.max_speed_m_s, settings.max_force_n)
        if isinstance(command, Listen):
            self._run(now_s)
            self._subscribed = command.streams & frozenset(self._infos)
            return command
        if self._faults.active(now_s, "silent"):
            return command
        self._run(now_s)
        refusal = self._refusal(command, now_s)
        if refusal is not None:
            self._refuse(command, refusal)
            return command
        drives = self._do(command)
        self._outcome.begin(command, now_s, drives=drives)
        self._sent(command)
        return command

    def read(self) -> Sequence[SampleBlock]:
        """States reported since the last call."""
        now_s = self._clock.now()
        self._run(now_s)
        samples, self._samples = self._samples, []
        if not samples:
            return ()
        if self._garbled(now_s):
            for stream in sorted(self._subscribed):
                self._lost(now_s, stream, len(samples))
            return ()
        times_s = np.array([number for number, _ in samples]) / self._settings.poll_hz
        widths_m = [self._units.width_m(state.position) for _, state in samples]
        closing_ma = [-state.current_ma for _, state in samples]
        columns = {f"{self.name}.width": np.array(widths_m), f"{self.name}.force": np.array(closing_ma)}
        t0_s = float(times_s[0])
        return [
            self._infos[stream].block(
                samples[0][0], t0_s, columns[stream][:, None], times_s=times_s, arrival_s=now_s
            )
            for stream in sorted(self._subscribed)
        ]

    def poll(self) -> Sequence[Status]:
        """What became of the commands."""
        now_s = self._clock.now()
        self._run(now_s)
        if self._faults.begun(now_s, "stall"):
            self._bench.jaws.jam()
        return super().poll()

    def _cut_off(self, now_s: float) -> None:
        """Its own watchdog trips: it is no longer fed."""
        self._bench.jaws.sleep()

    def _refusal(self, command: Command, now_s: float) -> str | None:
        if self._faults.active(now_s, "refuse"):
            return "the gripper refuses (injected fault)"
        if isinstance(command, Grip | Release) and self._asleep:
            return "it has a fault; send Home, which clears it"
        if isinstance(command, Grip | Release) and not self._bench.jaws.calibrated:
            return "it does not know its ends; send Home first, with empty jaws"
        return None

    def _do(self, command: Command) -> bool:
        """Do it; whether it drives the jaws."""
        match command:
            case Grip():
                self._go(self._units.grip(command))
            case Release():
                self._go(self._units.release(command, self._settings.release_force_n))
            case Stop() if not self._outcome.resting:
                self._hold()
                return bool(self._bench.jaws.calibrated)
            case Home() if not self._bench.jaws.calibrated or self._asleep:
                self._asleep = False
                self._bench.jaws.calibrate()
            case _:
                return False
        return True

    def _fall_asleep(self) -> None:
        """A fault of the drive's own, until the next calibration."""
        self._asleep = True
        self._bench.jaws.sleep()

    def _hold(self) -> None:
        if self._bench.jaws.calibrated:
            self._go(replace(self._order, position=self._state().position))
        else:
            self._bench.jaws.sleep()

    def _go(self, order: DriveOrder) -> None:
        self._order = order
        self._bench.jaws.go(order.position / POSITION_COUNTS, speed_ticks_s(order.speed), order.current_ma)

    def _run(self, now_s: float) -> None:
        """Let time pass, and take the states that were due by now, each as of its time."""
        self._bench.jaws.advance(now_s)
        if self._faults.begun(now_s, "overheat") is not None:
            self._fall_asleep()
        if not self._faults.active(now_s, "silent"):
            self._heard_s = now_s
        elif now_s - self._heard_s > WATCHDOG_S and not self._asleep:
            self._fall_asleep()
        if not self._bench.jaws.states:
            return
        number, states = self._bench.jaws.take()
        if self._gone(now_s):
            for stream in self._subscribed:
                self._unheard_of(stream, len(states))
            return
        self._heard(now_s)
        for count, state in _runs(states):
            numbers = range(number, number + count)
            for each in numbers:
                if self._outcome.settled(state):
                    break
                self._statuses += self._outcome.push(each / self._settings.poll_hz, state, self._asleep)
            if self._subscribed:
                self._samples += [(each, state) for each in numbers]
            number += count

    def _state(self) -> GripperState:
        jaws = self._bench.jaws
        return _state(
            round(jaws.closed_share * POSITION_COUNTS), jaws.current_ma, jaws.finding, jaws.calibrated
        )


def _runs(states: NDArray[np.float64]) -> Iterator[tuple[int, GripperState]]:
    """States of the drive, shape (m, 6), as the real one reports them, and how often each comes in a row."""
    ticks, current_ma, finding, opened, closed, calibrated = states.T
    span = np.where(opened == closed, np.inf, opened - closed)
    counts = np.rint(np.clip((opened - ticks) / span, 0.0, 1.0) * POSITION_COUNTS)
    rows = np.column_stack((counts, current_ma, finding, calibrated))
    begins = np.flatnonzero(np.append(True, (rows[1:] != rows[:-1]).any(axis=1)))
    for count, row in zip(np.diff(begins, append=len(rows)).tolist(), rows[begins].tolist(), strict=True):
        yield count, _state(int(row[0]), row[1], GripFinding(int(row[2])), bool(row[3]))


def _state(position: int, current_ma: float, finding: GripFinding, calibrated: bool) -> GripperState:
    return GripperState(
        position=position,
        current_ma=round(current_ma),
        finding=finding,
        activated=True,
        going=True,
        over_temperature=False,
        watchdog=False,
        estop=False,
        calibrated=calibrated,
    )

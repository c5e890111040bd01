"""The link to a Franka controller through franky: rows, and what is checked before anything moves.

franky's own thread makes libfranka's cycles; its calls are safe from any thread (tried: 60 motions begun and
ended beside 5,000 readings).
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, ClassVar

from drivers.arm.axis import quaternion, rotation_vector, way
from drivers.arm.guidance import MISSED_M, MISSED_RAD
from drivers.arm.link import CALLS_S, ArmRow, LinkError, Opened
from drivers.arm.settings import Pose
from drivers.core.clock import Clock, rest
from drivers.core.errors import PortError, RefusedError, SilentError
from drivers.franka_arm.settings import CYCLES_HZ, FrankaArmSettings

KEEP_MS = 100
"""How long a tool speed lasts without a newer one: the arm then brakes, although its thread still runs."""

LOOK_S = 0.05
"""Time between two looks at the controller while it recovers (assumption)."""

UP = "is the cable in, the controller up, and the FCI activated in Desk?"

FAULTS = {
    "Reflex": "a reflex has stopped it",
    "UserStopped": "the user stop is pressed",
    "Guiding": "it is guided by hand",
    "AutomaticErrorRecovery": "it recovers from an error",
    "Other": "it is locked",
}
"""Why the arm will not move, by libfranka's `RobotMode`; Idle and Move are none."""


class FrankaLink:
    """Implements `drivers.arm.link.ArmLink` and `drivers.arm.link.Client`: franky is safe from both threads."""

    package: ClassVar[str] = "franky-control"
    extra: ClassVar[str] = "franka"

    def __init__(self, settings: FrankaArmSettings, clock: Clock) -> None:
        self._settings = settings
        self._clock = clock
        self._cycles = round(CYCLES_HZ / settings.rate_hz)
        self._last_ms = -1
        self._fault = ""
        self._zero: Pose = (0.0,) * 6
        self._force: Pose = (0.0,) * 6
        self._pose: Pose = (0.0,) * 6
        self._robot: Any = None

    @property
    def client(self) -> FrankaLink:
        """See `ArmLink.client`."""
        return self

    # --- listening -------------------------------------------------------------------------------------

    def open(self, again: bool) -> Opened:
        """See `ArmLink.open`; what a process that died had begun has ended with it."""
        import franky

        self._franky = franky
        realtime = (
            franky.RealtimeConfig.Enforce if self._settings.enforce_realtime else franky.RealtimeConfig.Ignore
        )
        host = self._settings.host
        try:
            self._robot = franky.Robot(host, realtime_config=realtime)
            self._robot.set_collision_behavior(
                self._settings.contact_torque_n_m, self._settings.contact_force_n
            )
        except franky.NetworkException as error:
            raise LinkError(PortError, f"nothing answers at {host} ({error})", UP) from error
        except Exception as error:
            raise LinkError(RefusedError, f"the client reports: {error}", UP) from error
        row = self.read()
        while row is None:
            row = self.read()
        if row.fault:
            raise LinkError(RefusedError, row.fault, "look at the arm, and release it in Desk")
        state = self._robot.state
        details = {
            "tcp_offset": [float(part) for part in _pose(state.F_T_EE)],
            "payload_kg": float(state.m_total),
            "contact_force_n": self._settings.contact_force_n,
        }
        return Opened("Franka", host, "FCI", row, details)

    def read(self) -> ArmRow | None:
        """See `ArmLink.read`; while no motion is under way it waits for the next cycle, a millisecond."""
        try:
            state = self._robot.state
        except self._franky.NetworkException as error:
            raise LinkError(SilentError, f"the client reports: {error}", UP) from error
        cycle_ms = state.time.to_msec()
        if cycle_ms // self._cycles == self._last_ms // self._cycles:
            return None
        self._last_ms = cycle_ms
        arrival_s = self._clock.monotonic_s()
        # `O_dP_EE_c` is what was commanded: the tool's own speed follows from the joints' measured ones.
        twist = self._robot.model.zero_jacobian(self._franky.Frame.EndEffector, state) @ state.dq
        self._fault = self._why_not(state)
        self._force, self._pose = _six(state.O_F_ext_hat_K), _pose(state.O_T_EE)
        force = _six(part - zero for part, zero in zip(self._force, self._zero, strict=True))
        return ArmRow(
            arrival_s, 1e-3 * cycle_ms, self._pose, _six(twist), force, self._fault, not self._fault
        )

    def check(self) -> None:
        """See `ArmLink.check`: a link that is gone raises in `read`."""

    def _why_not(self, state: Any) -> str:
        reason = FAULTS.get(state.robot_mode.name, "")
        errors = str(state.last_motion_errors if reason else "")
        return f"{reason} ({errors.strip('[]')})" if errors.strip("[]") else reason

    # --- control ---------------------------------------------------------------------------------------

    def speed(self, twist: Pose, acceleration_m_s2: float) -> bool:
        """See `Client.speed`."""
        target = self._franky.Twist(list(twist[:3]), list(twist[3:]))
        duration = self._franky.Duration(KEEP_MS)
        factor = self._dynamics(1.0, acceleration_m_s2)
        return self._begin(self._franky.CartesianVelocityMotion(target, duration, factor))

    def end_speed(self) -> bool:
        """See `Client.end_speed`; the robot takes some 50 ms to confirm it (franka-sim)."""
        if self.busy() and not self._begin(self._franky.CartesianVelocityStopMotion()):
            return False
        self._ended()  # what is left of it, the next move waits for
        return True

    def move(self, pose: Pose, speed_m_s: float, acceleration_m_s2: float) -> bool:
        """See `Client.move`; a robot that still ends tool speeds takes none."""
        if not self._ended():
            return False
        w, *vector = quaternion(pose[3:])
        target = self._franky.Affine(list(pose[:3]), [*vector, w])
        limit, turn_limit = self._robot.translation_velocity_limit, self._robot.rotation_velocity_limit
        length_m, angle_rad = way(self._pose, pose)
        shares = [speed_m_s / turn_limit.get()] if angle_rad > MISSED_RAD else []  # the same number in rad/s
        if length_m > MISSED_M or not shares:
            shares.append(speed_m_s / limit.get())
        factor = self._dynamics(min(shares), acceleration_m_s2)
        return self._begin(self._franky.CartesianMotion(target, self._franky.ReferenceType.Absolute, factor))

    def end_move(self, deceleration_m_s2: float) -> bool:
        """See `Client.end_move`."""
        if not self._robot.is_in_control:
            return True
        return self._begin(self._franky.CartesianStopMotion(self._dynamics(1.0, deceleration_m_s2)))

    def busy(self) -> bool:
        """See `Client.busy`."""
        return bool(self._robot.is_in_control)

    def lead(self, on: bool) -> bool:
        """See `Client.lead`: a Franka arm is led with the buttons on its hand, by no program."""
        return False

    def feed_watchdog(self) -> bool:
        """See `Client.feed_watchdog`: libfranka's cycles are the watchdog."""
        return not self._fault

    def tare(self) -> bool:
        """See `Client.tare`: the robot's estimate has no zero to set, so the present one is subtracted from now on."""
        self._zero = self._force
        return True

    def halt(self) -> None:
        """See `Client.halt`."""
        self._robot.stop()

    def recover(self) -> str:
        """See `Client.recover`."""
        self._clock.leave()  # it may take long
        deadline_s = self._clock.monotonic_s() + self._settings.recover_s
        while self._fault:
            if self._clock.monotonic_s() > deadline_s:
                return self._fault
            try:
                self._robot.recover_from_errors()
            except Exception as error:
                return f"the client reports: {error}"
            rest(LOOK_S)
        return ""

    def leave(self) -> None:
        """See `Client.leave`."""
        self._robot.stop()

    def _begin(self, motion: Any) -> bool:
        """Whether the robot takes it; where an earlier motion failed, the row says why."""
        try:
            self._robot.move(motion, asynchronous=True)
        except Exception:  # franky's exceptions have no common base
            return False
        return True

    def _ended(self) -> bool:
        """Whether what is under way comes to its end within a few cycles."""
        try:
            return bool(self._robot.join_motion(CALLS_S))
        except Exception:
            return False

    def _dynamics(self, speed: float, acceleration_m_s2: float) -> Any:
        """franky's factors of the robot's own limits: `speed` is one, of translation and turn together."""
        acceleration = acceleration_m_s2 / self._robot.translation_acceleration_limit.get()
        return self._franky.RelativeDynamicsFactor(min(1.0, speed), min(1.0, acceleration), 1.0)


def _pose(frame: Any) -> Pose:
    """m and rotation vector of a frame of franky's, whose quaternion is x, y, z, w."""
    x, y, z, w = (float(part) for part in frame.quaternion)
    a, b, c = (float(part) for part in frame.translation)
    return (a, b, c, *rotation_vector((w, x, y, z)))


def _six(parts: Iterable[float]) -> Pose:
    x, y, z, rx, ry, rz = (float(part) for part in parts)
    return (x, y, z, rx, ry, rz)

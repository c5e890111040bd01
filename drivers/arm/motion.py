"""What the arm does with a command, cycle by cycle. Client and clock are passed in.

One thing moves the arm at a time. A `MoveAt` and a `Twist` are tool speeds, sent in every cycle; a `MoveTo`, a
`MovePose` and `Home` are moves that the controller plans. Whatever comes next waits until the last has come to rest,
because a second mover ends the controller's program.
"""

import math
from collections.abc import Callable
from enum import Enum, auto

from drivers.arm.axis import Axis, way
from drivers.arm.guidance import (
    CYCLE_S,
    MISSED_M,
    MISSED_RAD,
    FreeMotion,
    approach_twist,
    bound_ahead,
    line_speed,
)
from drivers.arm.link import Client, Seen
from drivers.arm.settings import ArmSettings, Pose
from drivers.core.messages import (
    Command,
    Home,
    Lead,
    MoveAt,
    MovePose,
    MoveTo,
    Reached,
    Refused,
    Sent,
    Stalled,
    Standstill,
    Status,
    Stop,
    Tare,
    Twist,
)

STILL_S = 0.02
"""How long nothing may have moved before the arm stands still: ten cycles of the controller (assumption)."""

START_S = 0.05
"""How long a move may take to begin (assumption: several times what its command takes)."""

GRACE_S = 2.0
"""Time that a motion may take beyond distance and speed before it has failed (assumption)."""

HALT_S = 0.5
"""How long an arm may go on after its program was ended from outside, before that is done again (assumption: ten
times what braking from 0.25 m/s takes)."""

REFUSED_S = 0.1
"""How long commands may be refused for no visible reason (assumption: a refusal shows in the next row)."""

REST: Pose = (0.0,) * 6

NOT_TAKEN = "the controller does not take it"


class MotionState(Enum):
    """What the arm does."""

    STANDING = auto()
    SPEEDING = auto()
    BRAKING = auto()
    TRAVELLING = auto()
    LED = auto()
    STOPPING = auto()
    HALTED = auto()


class MotionControl:
    """Carries commands out.

    Args:
        now: The host's monotonic time in seconds.
        report: Takes each status, with its time in host monotonic seconds.
        seen: What is known of the arm at the start.
    """

    def __init__(
        self,
        name: str,
        settings: ArmSettings,
        client: Client,
        now: Callable[[], float],
        report: Callable[[Status], None],
        seen: Seen,
    ) -> None:
        self.state = MotionState.STANDING
        self._name = name
        self._settings = settings
        self._axis = Axis(settings)
        self._client = client
        self._now = now
        self._report = report
        self._seen = seen
        self._goal: Command | None = None
        self._commanded = 0  # id of the command that is carried out, a stop too
        self._next: Command | None = None
        self._ending: Callable[[], Status] | None = None
        self._free: FreeMotion | None = None
        self._sent_twist: Pose = REST  # the last tool speed that the controller was sent
        self._halted = ""
        self._target = seen.row.pose
        self._since_s = self._deadline_s = now()
        self._accepted_s = now()
        self._looked_s = now()

    def heartbeat(self) -> None:
        """The program has looked at the arm. Where it does not for `loop_timeout_s`, nothing that moves goes on."""
        self._looked_s = self._now()

    def order(self, command: Command) -> None:
        """Begin with a command, or have it wait until what moves has come to rest."""
        self.heartbeat()
        if isinstance(command, Stop):
            self._stop(command)
        elif isinstance(command, Tare):
            self._tare(command)
        elif self.state is MotionState.HALTED and not self._recovered(command):
            return
        elif self.state is MotionState.STANDING or (
            self.state is MotionState.SPEEDING and isinstance(command, MoveAt | Twist)
        ):
            self._begin(command)
        else:
            self._next = command
            if self.state is MotionState.SPEEDING:
                self._brake(None)
            elif self.state is MotionState.TRAVELLING:
                self._stop_travel(None)
            elif self.state is MotionState.LED:
                self._stop_leading(None)

    def refuse_overtaken(self, command: Command) -> None:
        """Refuse a command that a stop has overtaken."""
        self._refuse(command, "a stop came before it was begun")

    def step(self, seen: Seen) -> None:
        """One cycle: look at the arm, keep it going."""
        self._seen = seen
        reason = seen.row.fault
        if reason and self.state is not MotionState.HALTED:
            self._halt(reason)
        self._check_heartbeat()
        {
            MotionState.STANDING: self._stand,
            MotionState.LED: self._stand,
            MotionState.SPEEDING: self._keep_speed,
            MotionState.BRAKING: self._keep_braking,
            MotionState.TRAVELLING: self._keep_travelling,
            MotionState.STOPPING: self._keep_stopping,
            MotionState.HALTED: self._stay_halted,
        }[self.state]()

    @property
    def _position_m(self) -> float:
        return self._axis.position_m(self._seen.row.pose)

    # --- beginning -------------------------------------------------------------------------------------

    def _begin(self, command: Command) -> None:
        self._goal, self._since_s, self._ending = command, self._now(), None
        self._commanded = command.id
        match command:
            case MoveAt():
                self._start_speed(command)
            case Twist():
                acceleration, begin_s = self._settings.acceleration_m_s2, self._now()
                self._free = FreeMotion(
                    self._sent_twist, command.twist, begin_s, command.duration_s, acceleration
                )
                self._start_speed(command)
            case MoveTo():
                self._travel(command, self._axis.pose(command.position_m), command.speed_m_s)
            case MovePose():
                target = self._axis.displaced(command.offset)
                length_m, _ = way(self._seen.row.pose, target)
                self._travel(command, target, line_speed(self._settings, length_m, command.speed_m_s))
            case Lead():
                if self._client.lead(True):
                    self.state = MotionState.LED
                    self._report(Sent(self._now(), self._name, command))
                else:
                    self._refuse(command, self._seen.row.fault or "a program cannot let it be led by hand")
            case Home():
                away_m = self._axis.away_m(self._seen.row.pose)
                if away_m > self._settings.leash_m:
                    reason = f"the tool is {away_m:.3f} m from start_pose, its leash is {self._settings.leash_m:g} m"
                    self._refuse(command, reason)
                else:
                    self._travel(command, self._settings.start_pose, self._settings.home_speed_m_s)

    def _start_speed(self, command: MoveAt | Twist) -> None:
        self.state = MotionState.SPEEDING
        taken = self._keep_speed()
        if taken or self.state is MotionState.BRAKING:  # braking: it is over already
            self._report(Sent(self._now(), self._name, command))
        else:
            self._refuse(command, self._seen.row.fault or NOT_TAKEN)
            if self.state is not MotionState.HALTED:
                self._brake(None)

    def _travel(self, command: Command, pose: Pose, speed_m_s: float) -> None:
        self._target = pose
        acceleration = self._settings.acceleration_m_s2
        if not self._client.move(pose, speed_m_s, acceleration):
            self._refuse(command, self._seen.row.fault or NOT_TAKEN)
            return
        self.state = MotionState.TRAVELLING
        self._report(Sent(self._now(), self._name, command))
        # The controller chooses the speed of a turn: a radian may take as long as a metre.
        length = sum(way(self._seen.row.pose, pose))
        self._deadline_s = self._now() + length / speed_m_s + 2.0 * speed_m_s / acceleration + GRACE_S

    def _tare(self, command: Tare) -> None:
        if self.state is not MotionState.STANDING:
            self._refuse(command, self._halted or "the arm is not standing still")
        elif self._client.tare():
            self._report(Sent(self._now(), self._name, command))
        else:
            self._refuse(command, NOT_TAKEN)

    def _recovered(self, command: Command) -> bool:
        if not isinstance(command, Home):
            self._refuse(command, f"{self._halted}; look at the arm, then send it Home")
            return False
        reason = self._client.recover()
        if reason:
            self._refuse(command, reason)
            return False
        self.state, self._halted, self._accepted_s = MotionState.STANDING, "", self._now()
        self._sent_twist = REST
        return True

    # --- ending ----------------------------------------------------------------------------------------

    def _stop(self, command: Stop) -> None:
        self._next, self._commanded = None, command.id
        match self.state:
            case MotionState.SPEEDING | MotionState.BRAKING:
                self._brake(self._standstill)
            case MotionState.TRAVELLING:
                self._stop_travel(self._standstill)
            case MotionState.LED:
                self._stop_leading(self._standstill)
            case MotionState.STANDING | MotionState.STOPPING:
                self._settle(self._standstill)
            case MotionState.HALTED:
                self._ending, self._since_s = self._standstill, self._now()
                return
        self._report(Sent(self._now(), self._name, command))

    def _brake(self, ending: Callable[[], Status] | None) -> None:
        """Take the speed away; the speeds end when the tool stands."""
        if self.state is not MotionState.BRAKING:
            self._since_s = self._now()
            speed_m_s = math.hypot(*self._seen.row.twist[:3])
            self._deadline_s = self._since_s + speed_m_s / self._settings.stop_m_s2 + GRACE_S
        self.state, self._ending, self._sent_twist = MotionState.BRAKING, ending, REST
        self._note(self._client.speed(REST, self._settings.stop_m_s2))

    def _stop_travel(self, ending: Callable[[], Status] | None) -> None:
        self._note(self._client.end_move(self._settings.stop_m_s2))
        self._settle(ending)

    def _stop_leading(self, ending: Callable[[], Status] | None) -> None:
        self._note(self._client.lead(False))
        self._settle(ending)

    def _settle(self, ending: Callable[[], Status] | None) -> None:
        self.state, self._ending = MotionState.STOPPING, ending
        self._since_s = self._now()
        self._deadline_s = self._since_s + GRACE_S

    def _rest(self) -> None:
        """The arm stands: report the outcome of the motion, and begin the next."""
        self.state, self._goal, self._sent_twist = MotionState.STANDING, None, REST
        ending, self._ending = self._ending, None
        if ending is not None:
            self._report(ending())
        command, self._next = self._next, None
        if command is not None:
            self._begin(command)

    def _halt(self, reason: str) -> None:
        if self._next is not None:
            self._refuse(self._next, reason)
        if self._ending != self._standstill:
            self._ending = None
        self.state, self._halted, self._next, self._goal = MotionState.HALTED, reason, None, None
        self._sent_twist = REST
        self._since_s = self._now()
        self._deadline_s = self._since_s + HALT_S
        self._report(
            Stalled(
                self._now(),
                self._name,
                f"{reason}; look at the arm, then send it Home",
                command_id=self._commanded,
            )
        )

    # --- in every cycle --------------------------------------------------------------------------------

    def _stand(self) -> None:
        self._note(self._client.feed_watchdog())

    def _keep_speed(self) -> bool:
        twist = self._guided(self._goal)
        if twist is None:
            return False
        taken = self._client.speed(twist, self._settings.acceleration_m_s2)
        if taken:
            self._sent_twist = twist
        self._note(taken)
        return taken

    def _keep_braking(self) -> None:
        if self._stands():
            self._note(self._client.end_speed())
            self._rest()
        elif self._now() > self._deadline_s:
            self._client.halt()
        else:
            self._note(self._client.speed(REST, self._settings.stop_m_s2))

    def _keep_travelling(self) -> None:
        self._note(self._client.feed_watchdog())
        if self._now() > self._deadline_s:
            self._stop_travel(lambda: self._stalled("it takes too long to get there"))
        elif self._now() - self._since_s > START_S and self._stands() and not self._client.busy():
            missed_m, missed_rad = way(self._seen.row.pose, self._target)
            reason = f"it stands {missed_m * 1e3:.1f} mm and {missed_rad:.3f} rad from where it was sent"
            reached = missed_m <= MISSED_M and missed_rad <= MISSED_RAD
            self._ending = self._reached if reached else lambda: self._stalled(reason)
            self._rest()

    def _keep_stopping(self) -> None:
        self._note(self._client.feed_watchdog())
        if self._stands() and not self._client.busy():
            self._rest()
        elif self._now() > self._deadline_s:
            self._client.halt()

    def _stay_halted(self) -> None:
        if self._ending is not None and self._stands():
            self._report(self._ending())
            self._ending = None
        # A program that has ended brakes by itself; motion at the pendant after that is the person's own.
        moving = math.isinf(self._seen.still_since_s)
        if moving and self._seen.row.running and self._now() > self._deadline_s:
            self._deadline_s = self._now() + HALT_S
            self._client.halt()

    def _check_heartbeat(self) -> None:
        """Stop what moves where the program no longer looks: neither guard nor detectors do then."""
        blind_s = self._now() - self._looked_s
        if blind_s <= self._settings.loop_timeout_s:
            return
        reason = f"the program has not looked at it for {blind_s:.2f} s; what held its loop up?"
        if self._next is not None:
            self._refuse(self._next, reason)
            self._next = None
        if self.state is MotionState.SPEEDING:
            self._brake(lambda: self._stalled(reason))
        elif self.state is MotionState.TRAVELLING:
            self._stop_travel(lambda: self._stalled(reason))
        elif self.state is MotionState.LED:
            self._stop_leading(lambda: self._stalled(reason))

    # --- guidance --------------------------------------------------------------------------------------

    def _guided(self, goal: Command | None) -> Pose | None:
        """The twist of this cycle; None where the motion is over, and the tool brakes."""
        if isinstance(goal, MoveAt):
            twist = approach_twist(self._axis, goal, self._seen.row, self._now())
            if twist is None:
                self._brake(self._reached)
            return twist
        assert self._free is not None
        # What is sent now is reached by the next cycle.
        twist = self._free.twist(self._now() + CYCLE_S)
        if twist is None:
            self._brake(self._reached)
            return None
        if bound := bound_ahead(self._axis, self._seen.row, self._now()):
            self._brake(lambda: self._stalled(bound))
            return None
        return twist

    # --- reporting -------------------------------------------------------------------------------------

    def _stands(self) -> bool:
        return self._now() - max(self._seen.still_since_s, self._since_s) >= STILL_S

    def _note(self, taken: bool) -> None:
        """Note whether the controller takes commands; a reason shows in the rows, as a rule at once."""
        if taken:
            self._accepted_s = self._now()
        elif self._now() - self._accepted_s > REFUSED_S and self.state is not MotionState.HALTED:
            self._halt("the controller takes no commands")
            # Its watchdog may still be fed by commands that it does not obey.
            self._client.halt()

    def _refuse(self, command: Command, reason: str) -> None:
        self._report(Refused(self._now(), self._name, command, reason))

    def _reached(self) -> Status:
        return Reached(self._now(), self._name, self._position_m, command_id=self._commanded)

    def _standstill(self) -> Status:
        return Standstill(self._now(), self._name, self._position_m, command_id=self._commanded)

    def _stalled(self, reason: str) -> Status:
        return Stalled(self._now(), self._name, reason, command_id=self._commanded)

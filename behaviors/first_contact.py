"""The first touch on a new bench: slowly, a person's word before each motion."""

from typing import Self

from pydantic import Field, model_validator

from behaviors.approach import Approaching, approaching, see_that_it_leads_on
from behaviors.machine import StatePlan, from_mover, on, sent_by
from drivers.core.messages import Ask, Command, Home, MoveTo
from drivers.core.settings import DetectorName, DeviceName, Settings, StreamName


class FirstContactSettings(Settings):
    """How the first touch is made."""

    mover: DeviceName = "stage"
    """Device that approaches."""

    operator: DeviceName = "operator"
    """The person at the bench."""

    detector: DetectorName = "contact"
    """Detector whose contact ends the approach."""

    load_cell_stream: StreamName = "board.load_cell"
    """Force (N)."""

    load_cell_channel: int = Field(default=0, ge=0, le=63)
    """Which of its channels a push makes positive: of an arm's own force 2 (fz), where it comes from above."""

    position_stream: StreamName = "stage.position"
    """Where the mover is (m)."""

    start_m: float = Field(default=0.0, ge=-1.0, le=1.0)
    """Where the approach starts, on the mover's axis."""

    approach_limit_m: float = Field(default=0.005, ge=-1.0, le=1.0)
    """Where an approach without contact ends."""

    speed_m_s: float = Field(default=0.001, gt=0.0, le=0.001)
    """Of every motion but the way home, which has the device's own."""

    nudge_m: float = Field(default=0.0005, gt=0.0, le=0.001)
    """First way towards the object, after which the person says whether it led there: a reversed axis shows in it."""

    baseline_timeout_s: float = Field(default=10.0, gt=0.0, le=600.0)
    """Longest wait for the detector's baseline."""

    motion_timeout_s: float = Field(default=60.0, gt=0.0, le=600.0)
    """Longest motion."""

    answer_timeout_s: float = Field(default=600.0, gt=0.0, le=3600.0)
    """Longest wait for the person. Assumption: ten minutes to look at a bench."""

    @model_validator(mode="after")
    def _leads_on(self) -> Self:
        see_that_it_leads_on(self.start_m, self.approach_limit_m)
        if self.start_m + self.nudge_m >= self.approach_limit_m:
            raise ValueError(
                f"nudge_m = {self.nudge_m:g} leads from start_m = {self.start_m:g} to approach_limit_m ="
                f" {self.approach_limit_m:g} or beyond: make it shorter"
            )
        return self


class FirstContactFactors(Settings):
    """What a trial varies: nothing."""

    touch: int = Field(default=1, ge=1)
    """Which touch it is."""


class FirstContact(Approaching):
    """Ask, go home; ask, go to the start; ask, go a little nearer; ask, approach until contact; ask, go back."""

    def __init__(
        self, settings: FirstContactSettings, factors: FirstContactFactors, detectors: frozenset[str]
    ) -> None:
        self.settings = settings
        measured = frozenset((settings.load_cell_stream, settings.position_stream))
        acting = frozenset({settings.detector})
        mover, speed_m_s = settings.mover, settings.speed_m_s
        way_m = settings.approach_limit_m - settings.start_m
        nudged_m = settings.start_m + settings.nudge_m
        start_mm, nudge_mm = 1e3 * settings.start_m, 1e3 * settings.nudge_m
        self._requests = {
            "READY_FOR_HOME": f"{mover} goes home at its own speed",
            "READY_FOR_START": f"{mover} goes to {start_mm:g} mm at {1e3 * speed_m_s:g} mm/s",
            "READY_FOR_NUDGE": f"{mover} goes {nudge_mm:g} mm towards the object; nothing touches yet",
            "READY_FOR_TOUCH": (
                f"has {mover} come nearer? (if not, decline: the stage, or the arm's approach_axis, is the wrong way"
                f" round) It approaches until contact, at most to {1e3 * settings.approach_limit_m:g} mm"
            ),
            "READY_TO_LEAVE": f"{mover} goes back",
        }

        def asking(request: str) -> StatePlan:
            question = Ask(settings.operator, f"{request}; emergency stop in reach?")
            return StatePlan(settings.answer_timeout_s, frozenset(), measured, False, [question])

        def motion(*commands: Command) -> StatePlan:
            return StatePlan(settings.motion_timeout_s, measures=measured, commands=commands)

        super().__init__(
            {
                **{state: asking(request) for state, request in self._requests.items()},
                "HOMING": motion(Home(mover)),
                "STARTING": motion(MoveTo(mover, settings.start_m, speed_m_s)),
                "NUDGING": motion(MoveTo(mover, nudged_m, speed_m_s)),
                "STOPPING": motion(),
                "RETRACTING": motion(MoveTo(mover, settings.start_m, speed_m_s)),
                "BASELINE": StatePlan(settings.baseline_timeout_s, acting, measured, prompt=False),
                "APPROACH": self.approach(
                    settings.detector,
                    speed_m_s,
                    settings.approach_limit_m,
                    way_m,
                    StatePlan(settings.motion_timeout_s, acting, measured),
                ),
            },
            settings.mover,
            acting,
        )  # fmt: skip

    def conclude_unanswered(self) -> None:
        """Nobody is there."""
        reason = f"{self.settings.operator} did not answer within {self.settings.answer_timeout_s:g} s"
        self.outcome, self.reason = "aborted", reason

    def conclude_declined(self) -> None:
        """The person does not want what was asked for."""
        self.outcome = "aborted"
        self.reason = f"{self.settings.operator} declined: {self._requests[self.state]}"

    enter_APPROACH = Approaching.go_until_contact

    answered = sent_by("operator")
    ASKING = ("READY_FOR_HOME", "READY_FOR_START", "READY_FOR_NUDGE", "READY_FOR_TOUCH", "READY_TO_LEAVE")
    BEFORE_CONTACT = (
        "READY_FOR_START",
        "STARTING",
        "READY_FOR_NUDGE",
        "NUDGING",
        "READY_FOR_TOUCH",
        "BASELINE",
        "APPROACH",
    )
    table = (
        on("answered", "READY_FOR_HOME", "HOMING", answered),
        on("reached", "HOMING", "READY_FOR_START", from_mover),
        on("answered", "READY_FOR_START", "STARTING", answered),
        on("reached", "STARTING", "READY_FOR_NUDGE", from_mover),
        on("answered", "READY_FOR_NUDGE", "NUDGING", answered),
        on("reached", "NUDGING", "READY_FOR_TOUCH", from_mover),
        on("answered", "READY_FOR_TOUCH", "BASELINE", answered),
        on("baseline_ready", "BASELINE", "APPROACH", Approaching.decisive),
        *approaching("APPROACH", stopped="READY_TO_LEAVE", missed="READY_TO_LEAVE"),
        on("answered", "READY_TO_LEAVE", "RETRACTING", answered),
        on("reached", "RETRACTING", "DONE", from_mover),
        on("refused", ASKING, "FAILED", answered, do=conclude_declined),
        on("deadline", ASKING, "FAILED", do=conclude_unanswered),
        on("resumed", ["READY_FOR_HOME", "HOMING"], "READY_FOR_HOME"),
        on("resumed", BEFORE_CONTACT, "READY_FOR_START"),
        on("resumed", ["STOPPING", "READY_TO_LEAVE", "RETRACTING"], "READY_TO_LEAVE"),
    )  # fmt: skip

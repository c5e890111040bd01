"""B6: known weights hung on a bridge, loading and unloading (Fernandez et al., 4.2, Fig. 5 and 6)."""

from collections.abc import Sequence
from itertools import pairwise
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from behaviors.machine import Behavior, StatePlan, on, sent_by
from drivers.core.messages import Ask, Loaded, LoadWeight
from drivers.core.settings import DeviceName, Settings, StreamName

Bridge = Literal["x", "y", "t"]
Force = Annotated[float, Field(gt=0.0, le=1000.0)]


def equal_steps(top_n: float, steps: int) -> tuple[float, ...]:
    """Weights at equal distances up to the largest, N."""
    return tuple(round(top_n * step / steps, 6) for step in range(1, steps + 1))


class WeightsSettings(Settings):
    """How one bridge is calibrated."""

    operator: DeviceName = "operator"
    """Device that hangs the weights: a person."""

    bridges_stream: StreamName = "board.fingertip"
    """The three bridges (V)."""

    load_stream: StreamName = "operator.load"
    """What hangs on them, as the person confirms it (N)."""

    weights_x_n: tuple[Force, ...] = equal_steps(7.0, 14)
    """Weights for Fx, N. Tested up to 7 N (4.2); the steps are an assumption: half of the range is among them, where a
    loop of hysteresis is widest, as a rule."""

    weights_y_n: tuple[Force, ...] = equal_steps(7.0, 14)
    """Weights for Fy, N, likewise."""

    weights_t_n: tuple[Force, ...] = equal_steps(1.0, 10)
    """Weights for Ft, N, likewise; up to 1 N (4.2)."""

    order: Literal["up_down", "listed"] = "up_down"
    """up_down: each cycle goes up through all weights and down again, as in 4.2; listed: as the lists have it, in any
    order, and back to nothing."""

    cycles: int = Field(default=5, ge=1, le=100)
    """How often. The paper says "several experiments"; the number is an assumption."""

    preloads: int = Field(default=3, ge=0, le=10)
    """How often the largest weight hangs before the first cycle, so that the loop has closed. Source: ISO 376 asks for
    three; the paper says nothing."""

    weight_uncertainty: float = Field(default=0.001, ge=0.0, le=0.1)
    """Relative standard uncertainty of the weights, common to all of them, local gravity included. Assumption: a
    laboratory's slotted weights."""

    swing_s: float = Field(default=1.0, ge=0.0, le=60.0)
    """Wait after hanging. Assumption: longer than a weight on a short thread swings."""

    record_s: float = Field(default=0.5, gt=0.0, le=60.0)
    """How long each load is recorded. Assumption: 500 samples make the mean's noise 5 % of one sample's."""

    answer_timeout_s: float = Field(default=300.0, gt=0.0, le=3600.0)
    """Longest wait for the person. Assumption: five minutes for a weight."""

    @model_validator(mode="after")
    def _ascending(self) -> Self:
        for bridge in ("x", "y", "t"):
            weights_n = self.weights_n(bridge)
            if len(weights_n) < 2:
                raise ValueError(f"weights_{bridge}_n: a line needs two weights")
            if self.order == "up_down" and any(low >= high for low, high in pairwise(weights_n)):
                raise ValueError(f'weights_{bridge}_n must ascend, or order be "listed"')
        return self

    def weights_n(self, bridge: str) -> tuple[float, ...]:
        """The weights of a bridge."""
        weights_n: tuple[float, ...] = getattr(self, f"weights_{bridge}_n")
        return weights_n

    def loads_n(self, bridge: str) -> Sequence[float]:
        """Every load that is recorded of a bridge, in order: nothing, the preloads, then the cycles."""
        weights_n = self.weights_n(bridge)
        down = weights_n[-2::-1] if self.order == "up_down" else ()
        return [0.0, *(max(weights_n), 0.0) * self.preloads, *(*weights_n, *down, 0.0) * self.cycles]


class WeightsFactors(Settings):
    """What a trial varies."""

    bridge: Bridge
    """Which bridge is calibrated."""


class Weights(Behavior):
    """Load after load: ask for it, let it hang still, record."""

    def __init__(self, settings: WeightsSettings, factors: WeightsFactors, detectors: frozenset[str]) -> None:
        asked = frozenset({settings.load_stream})
        self.settings = settings
        self.factors = factors
        self._loads_n = settings.loads_n(factors.bridge)
        self._recorded = 0
        # the bridge must hang so that a weight pulls on it alone (Fig. 5)
        request = f"set the fingertip up for weights on bridge F{factors.bridge}, with nothing on it"
        set_up = Ask(settings.operator, request)
        super().__init__(
            {
                "SETTING_UP": StatePlan(settings.answer_timeout_s, frozenset(), asked, False, [set_up]),
                "HANGING": StatePlan(settings.answer_timeout_s, frozenset(), asked, prompt=False),
                "SWINGING": StatePlan(settings.swing_s),
                "RECORDING": StatePlan(
                    settings.record_s, frozenset(), frozenset({settings.bridges_stream}), prompt=False
                ),
            }
        )

    @property
    def load_n(self) -> float:
        """The load whose turn it is; nothing at the end."""
        return self._loads_n[self._recorded] if not self.finished() else 0.0

    def as_asked(self) -> bool:
        """Whether the load is the one that was asked for."""
        event = self.event
        return isinstance(event, Loaded) and (event.device, event.bridge, event.force_n) == (
            self.settings.operator,
            self.factors.bridge,
            self.load_n,
        )

    def finished(self) -> bool:
        """Whether every load has been recorded."""
        return self._recorded >= len(self._loads_n)

    def count_recorded(self) -> None:
        """One load more is on record."""
        self._recorded += 1
        if self.finished():
            self.conclude("calibrated")

    def conclude_unanswered(self) -> None:
        """The person did not answer."""
        self.outcome = "aborted"
        self.reason = (
            f"{self.settings.operator} did not answer within {self.plan.deadline_s:g} s"
            f" when asked for {self.load_n:g} N on bridge {self.factors.bridge}"
        )

    def enter_HANGING(self) -> None:
        """The next load."""
        self.command(LoadWeight(self.settings.operator, self.factors.bridge, self.load_n))

    table = (
        on("answered", "SETTING_UP", "HANGING", sent_by("operator")),
        on("loaded", "HANGING", "DONE", as_asked, finished, label="all taken off at the end"),
        on("loaded", "HANGING", "SWINGING", as_asked),
        on("deadline", "SWINGING", "RECORDING"),
        on("deadline", "RECORDING", "HANGING", do=count_recorded),
        on("resumed", "SETTING_UP", "SETTING_UP"),
        on("resumed", ["HANGING", "SWINGING", "RECORDING"], "HANGING"),
        on("deadline", ["SETTING_UP", "HANGING"], "FAILED", do=conclude_unanswered),
    )

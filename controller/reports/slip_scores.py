"""What slip detectors detected, missed and called too early, pooled over trials of one kind."""

import math
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from controller.recording.reader import Run
from controller.reports.counts import METHODS, Row, Trials, median_within, wilson
from controller.reports.papers import table
from controller.reports.run_account import setting_of
from controller.scales import NOTHING

SENSORS = {row["sensor"]: row for row in table("fernandez_table_1")}
"""Table 1 and sections 4.3, 5.1 to 5.4: ratings of noise and slip detection, the frequency that stands out in slip, the
statistic's block, threshold (in the sensor's unit squared times Hz) and product, and unit and rate of the signal."""


def drawn_in(sensor: str, unit: str) -> tuple[str, float]:
    """The paper's unit for a signal in `unit`, and the factor to it; its own where the two measure other things."""
    return ("mV", 1e3) if (unit, SENSORS[sensor]["signal"]) == ("V", "mV") else (unit, 1.0)


PLANT: Mapping[str, tuple[float | str, str]] = {
    "radius_m": (0.012, "a tip of radius {:g} m"),
    "bumps_hz": (0.0, "bumps, {:g} a second"),
    "loads_hz": (0.0, "load steps, {:g} a second"),
    "rolling_scale": (1.0, "rolling × {:g}"),
    "noise_scale": (1.0, "noise × {:g}"),
    "mode_scale": (1.0, "frequency × {:g}"),
    "damping_scale": (1.0, "damping × {:g}"),
    "friction": ("none", "friction {:g}"),
    "matrix_hz": ("none", "a matrix at {:g} Hz"),
    "nuisances.noise_factor": (1.0, "noise that changes by {:g}"),
    "nuisances.hum": (0.0, "hum of {:g} noise"),
    "nuisances.converter": (0.0, "converter steps of {:g} noise"),
    "nuisances.tails": (1.0, "tails {:g}"),
    "nuisances.tremor_n": (0.0, "tremor of {:g} N"),
    "nuisances.smoothness": (1.0, "friction smoother by {:g}"),
    "nuisances.bounces": (0, "{:g} bounces"),
    "nuisances.table_m_s": (0.0, "a table at {:g} m/s"),
}
"""Settings of the slip bench that change what a sensor feels, each with the value of Table 1 and a text for another.
Where the table lies (`surface_m`) changes when, not what; the shape of a nuisance nothing without its strength."""

PLAIN = "none"
"""Nothing shakes the tip beside slip and rolling."""


class Condition(NamedTuple):
    """Which trials are pooled.

    Attributes:
        nuisance: Text of what differs from Table 1, or `PLAIN`.
        reflex: The detector that stops the arm, `paper` or `ours`; "" for none.
    """

    nuisance: str
    reflex: str


TABLE_1 = Condition(PLAIN, "")
"""What the paper's own table was made under."""


def condition_of(run: Run, row: Row) -> Condition:
    """Under what a trial was run: the profile's plant, with the trial's own factors laid over it."""

    def setting(section: str, key: str) -> Any:
        own = row.get(f"{section}.{key}")
        return setting_of(run, section, *key.split(".")) if own is None else own

    changes = []
    for key, (usual, text) in PLANT.items():
        value = setting("plant", key)
        if isinstance(value, int | float) and value != usual:
            changes.append(text.format(value))
    changes += [
        f"{name} = {value}"
        for name, value in row.items()
        if name.startswith(("detectors.", "behavior.")) and name not in _REFLEX and value is not None
    ]
    reflex = str(setting("behavior", "reflex")) if setting("behavior", "stop_on_slip") is True else ""
    return Condition("; ".join(changes) or PLAIN, reflex)


_REFLEX = ("behavior.stop_on_slip", "behavior.reflex")


@dataclass(frozen=True)
class SensorScore:
    """One detector on one sensor under one condition, over all its trials.

    Attributes:
        method: `paper` or `ours`.
    """

    sensor: str
    condition: Condition
    method: str
    rows: Trials

    def __getitem__(self, what: str) -> int:
        """How many over all trials, by the end of the column's name: slips `missed`, or `early` (called before they
        began), `false_alarms`, or `touch_alarms` (in descent and pressing)."""
        return self.rows.total(f"{self.method}_{what}")

    @property
    def paper(self) -> Row:
        """What the paper prints of the sensor."""
        return SENSORS[self.sensor]

    @property
    def name(self) -> str:
        """`B3 BarrettHand finger torque`."""
        return f"{self.paper['id']} {self.paper['name']}"

    @property
    def slips(self) -> int:
        """How many there were; those neither detected, missed nor early were cut short."""
        return self.rows.total("slips")

    @cached_property
    def delays_s(self) -> Sequence[float]:
        """Of the slips that were detected: a row holds the median of its trial's one or two, which stands for each."""
        delay_s, detected = f"{self.method}_delay_s", f"{self.method}_detected"
        return [float(row[delay_s] or 0.0) for row in self.rows for _ in range(Trials([row]).total(detected))]

    @property
    def median_s(self) -> float | None:
        """Of the delays."""
        return statistics.median(self.delays_s) if self.delays_s else None

    @property
    def scored(self) -> int:
        """Slips that were detected or missed: the base of the missed share and of the delays."""
        return len(self.delays_s) + self["missed"]

    @property
    def cut_short(self) -> int:
        """Slips that the arm's stop ended before they could be detected."""
        return self.slips - self.scored - self["early"]

    @property
    def quiet_s(self) -> float:
        """Time in which it could have had a false alarm."""
        return sum(self.rows.values(f"{self.method}_quiet_s"))

    @property
    def touches(self) -> int:
        """Touches at which it was armed."""
        known = self.rows.known("touch_s", "listen_s")
        return sum(row["listen_s"] <= row["touch_s"] for row in known)

    @property
    def least_delay_s(self) -> float:
        """How long it takes at least, by its own settings; NaN where it is not known."""
        return max(self.rows.values(f"{self.method}_least_delay_s"), default=math.nan)

    @property
    def too_slow(self) -> bool:
        """Whether it could not have detected any slip in time."""
        return bool(self.least_delay_s > VERDICTS["missed_after_s"])

    @cached_property
    def verdict(self) -> str:
        """Good, regular, bad, not decided or not judged; a dash where there was no slip."""
        if not self.slips:
            return NOTHING
        if self.condition.reflex not in ("", self.method):
            # a slip that the other detector's stop cut short might have been missed by this one
            return NOT_JUDGED
        return verdict_of([*self.delays_s, *[math.inf] * self["missed"]])

    @property
    def decided(self) -> bool:
        """Whether it is good, regular or bad."""
        return self.verdict in GRADES


def measured_rows(run: Run) -> Trials:
    """Trials that ran to their end in contact: one that an error or a pause cut off shows nothing about detectors."""
    return Trials.of([run]).where(outcome="contact").known("slips")


def read_scores(runs: Sequence[Run]) -> list[SensorScore]:
    """Every sensor, condition and detector of which there are trials."""
    groups: dict[tuple[str, Condition], Trials] = {}
    for run in runs:
        for row in measured_rows(run):
            groups.setdefault((str(row.get("sensor")), condition_of(run, row)), Trials()).append(row)
    return [
        SensorScore(sensor, condition, method, rows)
        for sensor in SENSORS
        for (name, condition), rows in sorted(groups.items(), key=lambda each: each[0])
        if name == sensor
        for method in METHODS
        if rows.known(f"{method}_false_alarms")
    ]


VERDICTS: Mapping[str, Any] = {
    # a slip that is not reported by then counts as missed: the shortest that the paper shows lasts 0.75 s (Fig. 15)
    "missed_after_s": 0.75,
    # thresholds are set for one false alarm in an hour: a working day of eight hours interrupts the user eight times
    "false_alarm_interval_s": 3600.0,
    # the detector can be relied on; `missed`: one slip in twenty, the limit that a grip controller with a second line
    # of defence can bear; `median_s`: the paper promises one block of 64 ms, and a slip that starts in mid-block needs
    # up to two
    "good": {"missed": 0.05, "median_s": 0.128},
    # works, not every time ("still works properly"); `missed`: more often than one in five, it could not be said to;
    # `median_s`: human grip reflexes take 60 to 100 ms; four blocks are beyond them but within the shortest slip
    "regular": {"missed": 0.20, "median_s": 0.256},
    # bad: everything else
}

GRADES = ("bad", "regular", "good")

NOT_JUDGED = "not judged"

NOT_DECIDED = "not decided"


def verdict_of(delays_s: ArrayLike) -> str:
    """good, regular or bad where both ends of the 95 % intervals of the missed share and of the median say so, else
    `NOT_DECIDED`.

    Args:
        delays_s: Of the slips that were detected or missed, infinite where missed, shape (n,). A slip that was called
            before it began is neither: a failure of its own, reported beside the verdict.
    """
    delays = np.sort(np.asarray(delays_s, dtype=np.float64))
    if not len(delays):
        return NOT_DECIDED
    missed = wilson(int(np.isinf(delays).sum()), len(delays))
    best, worst = (verdict(*ends) for ends in zip(missed, median_within(delays), strict=True))
    return best if best == worst else NOT_DECIDED


def verdict(missed: float, median_s: float) -> str:
    """good, regular or bad.

    Args:
        missed: Share of slips that were not reported within `missed_after_s`; NaN where there was none.
        median_s: Median delay, infinite where half or more are missed; NaN where there was no slip.
    """
    for grade in ("good", "regular"):
        limit = VERDICTS[grade]
        if missed <= limit["missed"] and median_s <= limit["median_s"]:
            return grade
    return "bad"

"""The paper's contact at every window and threshold, which it does not print, on the trials of `mock/touch`."""

import math
from collections.abc import Mapping, Sequence
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.pretouch import CONTACT_TNR, LATE_S, LEVEL, SET_OUT_S, rate
from config.script import run_trials
from controller.detectors.level import LevelPaperDetector, LevelPaperSettings
from controller.measures.trial import not_before
from controller.recording.reader import Run
from simulator.physics.aura_settings import SIDE_SETTINGS, SIDES
from simulator.physics.gripper_part import AuraBenchSettings

Bools = NDArray[np.bool_]
Floats = NDArray[np.float64]

WINDOWS_S = (0.1, 0.2, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0)
FULL_S = 0.5
"""A window has to be full this long before the touch: a detector that is silent until then knows when it comes."""

PARTS = ("all of it", "in motion")
"""What of a trial the detector receives: all, as shipped, or the approach alone, from `SET_OUT_S` after its start."""

SHIPPED = (5.0, "all of it", 6.5)
"""Of `mock/touch`; the window is full ten milliseconds before the touch."""

THRESHOLDS = np.sort(np.append(np.geomspace(2.0, 40.0, 61), SHIPPED[2]))

FACTORS = (1.0, 2.0, 3.0, 4.0, 5.0, 8.0, 12.0, 20.0)
"""By which the change of level at contact is multiplied, on every side: 20 is 0.8 of full scale on the normal one."""

EACH = 20
"""Trials of each side, as the profile has them."""

DEAF = "top"
"""The side with which the paper detects no contact (IV.A.3)."""


class TouchTrial(NamedTuple):
    """One approach: the in-phase channel from the rest before it to the end of the way back, shape (n,), and its times;
    when the arm set out and stood, when the finger touched (NaN where it did not), where a contact is true, what it
    adds to the level, and what the program itself measured."""

    level: Floats
    times_s: Floats
    moving_s: tuple[float, float]
    touched_s: float
    touching: Bools
    contact: Floats
    row: Mapping[str, Any]


def trials() -> list[TouchTrial]:
    """`mock/touch`, as it is shipped."""
    rows = [{"side": side, "speed_m_s": 0.01} for side in SIDES for _ in range(EACH)]
    with TemporaryDirectory() as folder:
        _, run = run_trials("mock/touch", rows, out=Path(folder), say=lambda _: None)
        return [_trial(run, row) for row in run.trials if row["approaches"]]


def _trial(run: Run, row: Mapping[str, Any]) -> TouchTrial:
    entered = {
        str(event["next"]): float(event["t_s"])
        for event in run.events
        if event["trial"] == row["trial"] and event["next"] != event["state"]
    }
    level = (
        run.trial(int(row["trial"])).stream("signals.right").between(entered["BASELINE"], entered["LEAVING"])
    )
    touched_s, released_s = (
        math.nan if row[f"truth_{what}_s"] is None else row[f"truth_{what}_s"]
        for what in ("contact", "release")
    )
    touching = [not_before(t_s, touched_s) and t_s <= released_s for t_s in level.times_s.tolist()]
    pose = run.trial(int(row["trial"])).stream("arm.pose")
    reach_m = np.interp(level.times_s, pose.times_s, pose.values[:, 0])
    pressed_m = np.maximum(0.0, reach_m - np.interp(touched_s, level.times_s, reach_m)) * touching
    plant, side = AuraBenchSettings(), SIDE_SETTINGS[row["side"]]
    share = -np.expm1(
        -plant.press_n_m * pressed_m / plant.force_n
    )  # of the plant's equation (1), on the pipe
    contact = LEVEL * side.coupling_fs * math.cos(side.coupling_rad) * share
    return TouchTrial(
        level.values[:, 0],
        level.times_s,
        (entered["APPROACHING"], entered["HOLDING"]),
        touched_s,
        np.array(touching),
        np.nan_to_num(contact),
        row,
    )


def scored(trial: TouchTrial, window_s: float, part: str) -> tuple[Bools, Bools]:
    """At each threshold, as a run is scored: whether the touch was detected, and whether a contact was reported that
    is none; each of shape (thresholds,)."""
    since_s, until_s = -math.inf, math.inf
    if part != "all of it":
        since_s, until_s = trial.moving_s[0] + SET_OUT_S, trial.moving_s[1] + LATE_S
    given = (trial.times_s >= since_s) & (trial.times_s <= until_s)
    times_s, touching = trial.times_s[given], trial.touching[given]
    detector = LevelPaperDetector("paper", LevelPaperSettings(window_s=window_s))
    rate_hz = 1.0 / float(np.median(np.diff(times_s)))
    statistic = np.nan_to_num(detector.statistic(trial.level[given, None], rate_hz))
    early = ~touching & (times_s >= trial.moving_s[0]) & (times_s < trial.touched_s)
    in_time = touching & (times_s <= trial.touched_s + LATE_S)
    return _begun(statistic, in_time) & ~_begun(statistic, early), _begun(statistic, ~touching)


def _begun(statistic: Floats, within: Bools) -> Bools:
    """At each threshold, whether the statistic rises above it at one of some samples."""
    before = np.concatenate(([-math.inf], statistic[:-1]))
    rising = within & (statistic > before)
    n = len(THRESHOLDS)
    first, beyond = (
        np.bincount(np.searchsorted(THRESHOLDS, values[rising]), minlength=n + 1)
        for values in (before, statistic)
    )
    found: Bools = np.cumsum(first - beyond)[:n] > 0
    return found


def study(found: Sequence[TouchTrial], factor: float) -> dict[str, Any]:
    """The best setting of one half of the trials, and how it, the shipped one and ours do on the other half; contact
    changes the level by a factor more (ours as it is)."""
    found = [trial._replace(level=trial.level + (factor - 1.0) * trial.contact) for trial in found]
    known = [trial for trial in found if math.isfinite(trial.touched_s)]
    full_s = {
        PARTS[0]: min(trial.touched_s - trial.times_s[0] for trial in known) - FULL_S,
        PARTS[1]: min(trial.touched_s - trial.moving_s[0] for trial in known) - SET_OUT_S - FULL_S,
    }
    windows = [(window_s, part) for window_s, part in product(WINDOWS_S, PARTS) if window_s <= full_s[part]]
    answers = np.array([[scored(trial, *window) for trial in found] for window in (*windows, SHIPPED[:2])])
    felt, false = np.moveaxis(answers, 2, 0)  # each of shape (windows, trials, thresholds)
    touch = np.array([math.isfinite(trial.touched_s) for trial in found])
    sides = np.array([trial.row["side"] for trial in found])
    choosing = np.arange(len(found)) % 2 == 0
    at = (len(windows), int(np.searchsorted(THRESHOLDS, SHIPPED[2])))
    row: dict[str, Any] = {"factor": factor, "settings": len(windows) * len(THRESHOLDS)}
    for name, own in (("all sides", np.ones(len(found), dtype=bool)), (f"all but the {DEAF}", sides != DEAF)):
        place = _best(felt[:-1], false[:-1], own & choosing, touch)
        judged = own & ~choosing
        row[name] = {
            "window_s": windows[place[0]][0],
            "part": windows[place[0]][1],
            "threshold": float(THRESHOLDS[place[1]]),
            "best": _rates(felt[place[0], :, place[1]], false[place[0], :, place[1]], judged, touch),
            "shipped": _rates(felt[at[0], :, at[1]], false[at[0], :, at[1]], judged, touch),
            "ours": _rates(
                np.array([trial.row["felt_ours"] > 0 for trial in found]),
                np.array([trial.row["false_ours"] > 0 for trial in found]),
                judged,
                touch,
            ),
        }
    return row


def _best(felt: Bools, false: Bools, chosen: Bools, touch: Bools) -> tuple[int, int]:
    """Window and threshold that detect most touches at the paper's true-negative rate; of equal thresholds the
    middle."""
    quiet = 1.0 - false[:, chosen].mean(axis=1) >= CONTACT_TNR
    score = np.where(quiet, felt[:, chosen & touch].mean(axis=1), -1.0)
    window = int(np.argmax(score.max(axis=1)))
    equal = np.flatnonzero(score[window] == score[window].max())
    return window, int(equal[len(equal) // 2])


def _rates(felt: Bools, false: Bools, judged: Bools, touch: Bools) -> dict[str, Any]:
    return {"tpr": rate(felt[judged & touch].tolist()), "tnr": rate((~false[judged]).tolist())}


def studies(quick: bool) -> list[dict[str, Any]]:
    """As it is, and at each factor."""
    found = trials()
    return [study(found, factor) for factor in (FACTORS[:1] if quick else FACTORS)]

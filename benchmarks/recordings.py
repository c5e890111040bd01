"""Public recordings with truth, and the slip detectors on them.

`make recordings`, or `python -m benchmarks.recordings [NAME=GIT_DIR ...]`, fetches them by git into build/recordings.
They are never committed: most of the repositories state no licence. A local copy may be given instead, as in
`biotac=/data/BioTac_slide_20_50`. Studies run without them and report the missing rows.
"""

import math
import re
import subprocess
import sys
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from io import BytesIO, StringIO
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.slip import (
    LEARN_S,
    MISSED_S,
    OURS,
    THRESHOLDS,
    Rival,
    called,
    first_above,
    refusals,
    share_of,
)
from controller.detectors.calibration import span_maxima
from drivers.core.messages import Floats

FOLDER = Path("build/recordings")

MATERIALS = (9, 10, 12, 14, 15, 16)
"""Materials over which the finger loses contact before the recording ends."""

PULSES = 22
"""Pressure samples in each row of 10 ms."""

BIOTAC_HZ = 2200.0
TRIBOMETER_HZ = 10_000.0


def biotac(show: Callable[[str], bytes]) -> dict[str, Floats]:
    """Odd-numbered drags over six materials: rows of 10 ms, 22 pressure samples and 19 electrodes each.

    R. Gao et al., Supervised Autoencoder Joint Learning on Heterogeneous Tactile Sensory Data, IROS 2020.
    """
    found = {}
    for material in MATERIALS:
        for number in range(1, 51, 2):
            text = show(f"raw_data/mat{material}/mat{material}_{number}_bio.csv").decode()
            rows = np.loadtxt(StringIO(text.replace(",\n", "\n")), delimiter=",", skiprows=1)
            found[f"{material}_{number}"] = rows[:, 4 : 4 + PULSES + 19]
    return found


def tribometer(show: Callable[[str], bytes]) -> dict[str, Floats]:
    """A finger on a tribometer: lateral force, normal force, vibration, and two more columns.

    R. Grigorii et al., Data-Driven Playback of Natural Tactile Texture, IEEE Trans. Haptics 2021.
    """
    from scipy.io import loadmat

    stored = BytesIO(show("matlab/DAQ/data/data_temp.mat"))
    return {"run": loadmat(stored)["dataQ"]}  # type: ignore[arg-type] # an open file is as good


def blows(show: Callable[[str], bytes]) -> dict[str, Floats]:
    """Single blows to a tribometer's lateral force sensor, its impulse calibration: three runs of 20 s. Nothing slides.

    Recorded at 100 kHz; here at 10 kHz, behind a causal filter.

    R. Grigorii et al., Comparison of Wideband Vibrotactile and Friction Modulation Surface Gratings, IEEE Trans.
    Haptics 2021.
    """
    from scipy.io import loadmat
    from scipy.signal import decimate

    found = {}
    for name in ("data", "data2", "data3"):
        stored = BytesIO(show(f"Matlab/calibration lateral/{name}.mat"))
        run = loadmat(stored)["out"][:, 0]  # type: ignore[arg-type] # an open file is as good
        found[name] = decimate(run - run[0], 10, ftype="fir", zero_phase=False)
    return found


def beam(show: Callable[[str], bytes]) -> dict[str, Floats]:
    """A beam whose roller support is moved in steps: accelerometer and roller position, V, at 5 kHz; four runs of 14 s.

    A. Vereen et al., Dataset-8 DROPBEAR Acceleration vs Roller Displacement, 2023 (CC BY-SA 4.0).
    """
    found = {}
    for name in ("test0", "test1", "test2", "test3"):
        text = show(f"data/Slow Postional Displacement/trial data/10steps/{name}.txt").decode()
        found[name] = np.loadtxt(StringIO(text), skiprows=8, usecols=(1, 2))
    return found


ARM_HZ = 1250.0

MOST_POINTS = 1000
"""A path of a figure with more points is a curve, not an axis."""


def arm(show: Callable[[str], bytes]) -> dict[str, Floats]:
    """An arm that presses against a force sensor: impact, six seconds of contact, retreat; nothing slides. Eight runs,
    the force in its figures' unit, taken from vector figures (the longest path is the sensor's), at 1,250 Hz.

    S. Gadringer, H. Gattringer, A. Mueller, Assessment of force control for surface finishing, Mechanical Sciences 2022
    (GPL v3).
    """
    found = {}
    for kind, name in (
        ("ACF", "ACF_control_F_100N_t_ramp_{}_v_{}_1"),
        ("UR", "UR_control_F_100N_damping_0_gain_scaling_{}_v_{}_1"),
    ):
        for setting in ("0.0s-F_zero_0N", "0.1s-F_zero_10N") if kind == "ACF" else ("0.5", "1"):
            for speed in ("0.10", "0.25"):
                about = name.format(setting, speed)
                figure = show(
                    "Test_scenarios/3_Direct_sensor_contact/2_Measurements-UR10e_ACF/TcpUR_FzATI/"
                    f"{kind}/m_6.86_direct_sensor_contact_{about}_forceATI-TcpUR_FzATI.pdf"
                )
                found[f"{kind} {setting} {speed}"] = _curve(figure)
    return found


def _curve(figure: bytes) -> Floats:
    """Heights of the first curve of a PDF figure, shape (n,).

    Raises:
        ValueError: it has none.
    """
    for stream in re.finditer(rb"stream\r?\n(.*?)endstream", figure, re.DOTALL):
        try:
            drawn = zlib.decompress(stream[1])
        except zlib.error:
            continue
        for path in re.split(rb" m\s", drawn):
            heights = re.findall(rb"^\S+ (\S+) l\s*$", path, re.MULTILINE)
            if len(heights) > MOST_POINTS:
                return np.array(heights, dtype=np.float64)
    raise ValueError("the figure has no curve")


SOURCES: Mapping[str, tuple[str, str, Callable[[Callable[[str], bytes]], dict[str, Floats]]]] = {
    "biotac": ("dexrob/BioTac_slide_20_50", "c19638b", biotac),
    "tribometer": (
        "romangrigorii/data-driven-playback-of-natural-tactile-texture",
        "58cd7fcdec94f82f504bb17b2e547ee64c70bde9",
        tribometer,
    ),
    "blows": (
        "romangrigorii/comparison-of-wideband-viborotactile-and-friction-modulation-surface-gratings",
        "e19fed0d9dae8c0034e8eb1b8b3374c9d34ce561",
        blows,
    ),
    "beam": (
        "High-Rate-SHM-Working-Group/Dataset-8-DROPBEAR-Acceleration-vs-Roller-Displacement",
        "28955a7",
        beam,
    ),
    "arm": ("JKU-Linz-Institute-of-Robotics/ur10e_force_control_comparison", "3b9b1b2", arm),
}
"""Repository on GitHub, commit, and what reads the arrays to keep by a function that returns a file's bytes."""


def load(name: str) -> dict[str, Floats] | None:
    """The fetched arrays; None if not fetched."""
    path = FOLDER / f"{name}.npz"
    if not path.exists():
        return None
    with np.load(path) as kept:
        return {key: kept[key] for key in kept.files}


def fetch(name: str, git_dir: str | None) -> Path:
    """Fetch a source, or read it from a local repository.

    Raises:
        subprocess.CalledProcessError: git could not.
    """
    repository, commit, read = SOURCES[name]
    FOLDER.mkdir(parents=True, exist_ok=True)
    if git_dir is None:
        git_dir = str(FOLDER / f"{name}.git")
        if not Path(git_dir).exists():
            clone = ["git", "clone", "--bare", "--filter=blob:none"]
            subprocess.run([*clone, f"https://github.com/{repository}", git_dir], check=True)

    def show(path: str) -> bytes:
        command = ["git", "--git-dir", git_dir, "show", f"{commit}:{path}"]
        return subprocess.run(command, check=True, stdout=subprocess.PIPE).stdout

    target = FOLDER / f"{name}.npz"
    np.savez_compressed(target, **read(show))  # type: ignore[arg-type] # names are no options
    return target


class Drag(NamedTuple):
    """A BioTac drag of material and number: pressure, rectified, shape (n,), and the sample at which the finger has
    lost contact by its electrodes: slip before, quiet after."""

    name: str
    pressure: Floats
    lost: int


SURE = 0.1
"""Contact is over where the electrodes' sum is within a tenth of its value from 1 to 3 s, and within twice its noise in
the last second."""

QUIET_S = 1.6
"""Least quiet after it."""

MARGIN_S = 0.15
"""Margin of the quiet that is left out: the electrodes are slower than the pressure."""


def drags(half: str) -> list[Drag]:
    """Drags for "choosing" (numbers 1, 5, 9 ...) or for "judging" (3, 7, 11 ...) that have quiet enough."""
    found = []
    for name, rows in (load("biotac") or {}).items():
        if (int(name.split("_")[1]) % 4 == 1) != (half == "choosing"):
            continue
        electrodes = rows[:, PULSES:]
        away = np.abs(electrodes - np.median(electrodes[-100:], axis=0)).sum(axis=1)
        level = max(SURE * float(np.median(away[100:300])), 2.0 * float(np.quantile(away[-100:], 0.95)))
        lost = (int(np.flatnonzero(away > level)[-1]) + 1) * PULSES
        pressure = rows[:, :PULSES].ravel()
        if len(pressure) - lost - MARGIN_S * BIOTAC_HZ >= QUIET_S * BIOTAC_HZ:
            found.append(Drag(name, pressure, lost))
    return found


# --- detectors on them -------------------------------------------------------------------------


class Splice(NamedTuple):
    """A drag's own quiet, and then its slip, from a sample within the quiet's own range on, so that the cut makes no
    step; and the drag played backwards, so that a slip that dies away becomes one that grows, from where its electrodes
    show contact. Shapes (n,)."""

    values: Floats
    onset: int
    reversed: Floats
    reversed_onset: int


def splice(drag: Drag) -> Splice:
    """A recording's own quiet before its slip."""
    quiet = drag.pressure[drag.lost + round(MARGIN_S * BIOTAC_HZ) :]
    slip = drag.pressure[round(BIOTAC_HZ) : drag.lost - round(0.5 * BIOTAC_HZ)]
    slip = slip[int(np.argmax(slip <= np.quantile(quiet, 0.9))) :][: round(BIOTAC_HZ)]
    backwards = drag.pressure[::-1].copy()
    return Splice(np.concatenate([quiet, slip]), len(quiet), backwards, len(drag.pressure) - drag.lost)


def _maxima(statistic: Floats, rate_hz: float) -> Floats:
    """Second by second; a rest of more than half a second is one."""
    size = round(rate_hz)
    rest = len(statistic) % size
    padded = np.concatenate([statistic, np.full(size - rest if rest > size // 2 else 0, np.nan)])
    return span_maxima(padded, rate_hz)


def on_drags(judge: Rival) -> dict[str, Any]:
    """The threshold from the choosing half's quiet, one false alarm a minute; delays on the judging half."""
    quiet = [s.values[: s.onset] for s in map(splice, drags("choosing"))]
    maxima = np.sort(np.concatenate([_maxima(judge(each, BIOTAC_HZ), BIOTAC_HZ) for each in quiet]))[::-1]
    decided_s = sum(len(each) / BIOTAC_HZ - LEARN_S for each in quiet)
    threshold = float(maxima[max(1, round(decided_s / 60.0))])
    delays, early, alarms, judged_s = [], 0, 0, 0.0
    for each in map(splice, drags("judging")):
        found = judge(each.values, BIOTAC_HZ)
        alarms += int(np.sum(_maxima(found[: each.onset], BIOTAC_HZ) > threshold))
        judged_s += each.onset / BIOTAC_HZ - LEARN_S
        delay_s = first_above(found[each.onset :], threshold) / BIOTAC_HZ
        delays.append(delay_s if delay_s <= MISSED_S else math.inf)
        first = first_above(judge(each.reversed, BIOTAC_HZ), threshold)
        early += (first - each.reversed_onset) / BIOTAC_HZ < -MARGIN_S
    counts = {"judged_min": judged_s / 60.0, "alarms": alarms, "early": int(early)}
    return {"threshold": threshold, **counts, "delays_s": delays}


RESTS_S, TOUCH_S, LOADED_S, MOVES_S, LETS_GO_S, STANDS_S = (1.0, 2.2), 3.207, (3.95, 4.48), 4.528, 4.573, 7.01
LIFTS_S = 7.3
"""On the tribometer: quiet in the air, before the servo hums; contact; quiet and loaded; the stage moves; the lateral
force drops; the stage stands; shortly before the finger is lifted."""


def on_tribometer(name: str, judge: Rival) -> Iterator[dict[str, Any]]:
    """Results of a detector for the finger on a tribometer: at the largest value of its rest, and ours at thresholds
    from elsewhere as well."""
    recorded = load("tribometer")
    for column, channel in ((0, "lateral force"), (2, "vibration")) if recorded else ():
        assert recorded is not None
        values = recorded["run"][:, column]
        statistic = judge(values, TRIBOMETER_HZ)
        rest = float(np.nanmax(_between(statistic, *RESTS_S)))
        for threshold in (rest, *(THRESHOLDS if name == OURS else ())):
            slipping = called(name, values, statistic, TRIBOMETER_HZ, threshold)
            moving = _between(slipping, MOVES_S, LIFTS_S)
            turns = np.flatnonzero(np.diff(slipping)) + 1
            shown = [f"{'on' if slipping[i] else 'off'} {i / TRIBOMETER_HZ:.3f}" for i in turns.tolist()]
            about = {"detector": name, "channel": channel, "threshold": threshold}
            yield {
                **about,
                "before_touch_s": float(_between(slipping, RESTS_S[1], TOUCH_S).sum() / TRIBOMETER_HZ),
                "loaded_s": float(_between(slipping, *LOADED_S).sum() / TRIBOMETER_HZ),
                "reported_s": MOVES_S + first_above(moving.astype(float), 0.5) / TRIBOMETER_HZ,
                "share_of_slip": float(_between(slipping, LETS_GO_S, STANDS_S).mean()),
                "off_s": MOVES_S + float(np.max(np.flatnonzero(moving), initial=-1) + 1) / TRIBOMETER_HZ,
                "reported": shown if name == OURS else None,
            }


def _between(values: NDArray[Any], begin_s: float, end_s: float) -> NDArray[Any]:
    """A stretch of the tribometer's run."""
    return values[round(begin_s * TRIBOMETER_HZ) : round(end_s * TRIBOMETER_HZ)]


BLOW_V, APART_S, AFTER_S = 0.15, 0.3, 0.5
"""A blow to the force sensor is beyond this, some 50 times its noise; the next is as far away at least; events in
the time after it are attributed to the blow."""


def struck(values: Floats) -> list[int]:
    """Samples at which blows are first beyond `BLOW_V`."""
    places = np.flatnonzero(np.abs(values - np.median(values)) > BLOW_V)
    found: list[int] = places[np.diff(places, prepend=-(10**9)) > APART_S * TRIBOMETER_HZ].tolist()
    return found


def on_blows(judge: Rival, thresholds: Sequence[float]) -> Iterator[dict[str, Any]]:
    """How often single blows to a force sensor are called slip, and for how long: at thresholds as given, or without
    any at the largest value in the quiet between the blows."""
    pieces, quiet = [], []
    for values in (load("blows") or {}).values():
        statistic = judge(values, TRIBOMETER_HZ)
        resting = np.ones(len(values), dtype=bool)
        for begin in struck(values):
            after = slice(begin, begin + round(AFTER_S * TRIBOMETER_HZ))
            pieces.append(np.nan_to_num(statistic[after]))
            resting[begin - round(0.05 * TRIBOMETER_HZ) : after.stop] = False
        quiet.append(float(np.nanmax(statistic[resting])))
    for threshold in (thresholds or [max(quiet)]) if pieces else []:
        yield {
            "threshold": threshold,
            "blows": len(pieces),
            "called": sum(bool((piece > threshold).any()) for piece in pieces),
            "lasting_s": float(np.median([np.sum(piece > threshold) for piece in pieces])) / TRIBOMETER_HZ,
        }


def at_reset(name: str, judge: Rival, threshold: float) -> Iterator[dict[str, Any]]:
    """Drags of the judging half that slip while a detector starts, and go on: how many it then detects. Ours as well
    with the quiet level of their own end stored."""
    chosen = drags("judging")
    slipping = [drag.pressure[round(BIOTAC_HZ) : round(2.5 * BIOTAC_HZ)] for drag in chosen]
    detected = sum(math.isfinite(first_above(judge(each, BIOTAC_HZ), threshold)) for each in slipping)
    yield {"detector": name, "stored": False, **share_of(detected, len(chosen))}
    if name == OURS:
        quiet = [drag.pressure[drag.lost + round(MARGIN_S * BIOTAC_HZ) :] for drag in chosen]
        yield {"detector": name, **refusals(quiet, slipping, BIOTAC_HZ)}


def main(arguments: list[str]) -> None:
    """Fetch all sources."""
    local = dict(argument.split("=", 1) for argument in arguments)
    for name in SOURCES:
        print(f"{name}: {fetch(name, local.get(name))}")


if __name__ == "__main__":
    main(sys.argv[1:])

"""Public recordings with truth: `make recordings`, or `python -m benchmarks.recordings [NAME=GIT_DIR ...]`.

They are fetched by git into build/recordings and never committed: none of the repositories states a licence. A local
copy of a repository may be given instead, as in `biotac=/data/BioTac_slide_20_50`. Studies run
without them and report the missing rows.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from io import BytesIO, StringIO
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

FOLDER = Path("build/recordings")

MATERIALS = (9, 10, 12, 14, 15, 16)
"""Materials over which the finger loses contact before the recording ends."""

PULSES = 22
"""Pressure samples in each row of 10 ms."""

BIOTAC_HZ = 2200.0
TRIBOMETER_HZ = 10_000.0


class RecordingSource(NamedTuple):
    """Where recordings are from.

    Attributes:
        repository: On GitHub.
        commit: The commit.
        read: From a function that returns a file's bytes to the arrays to keep.
    """

    repository: str
    commit: str
    read: Callable[[Callable[[str], bytes]], dict[str, Floats]]


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


SOURCES = {
    "biotac": RecordingSource("dexrob/BioTac_slide_20_50", "c19638b", biotac),
    "tribometer": RecordingSource(
        "romangrigorii/data-driven-playback-of-natural-tactile-texture",
        "58cd7fcdec94f82f504bb17b2e547ee64c70bde9",
        tribometer,
    ),
    "blows": RecordingSource(
        "romangrigorii/comparison-of-wideband-viborotactile-and-friction-modulation-surface-gratings",
        "e19fed0d9dae8c0034e8eb1b8b3374c9d34ce561",
        blows,
    ),
}


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
    source = SOURCES[name]
    FOLDER.mkdir(parents=True, exist_ok=True)
    if git_dir is None:
        git_dir = str(FOLDER / f"{name}.git")
        if not Path(git_dir).exists():
            url = f"https://github.com/{source.repository}"
            subprocess.run(["git", "clone", "--bare", "--filter=blob:none", url, git_dir], check=True)

    def show(path: str) -> bytes:
        command = ["git", "--git-dir", git_dir, "show", f"{source.commit}:{path}"]
        return subprocess.run(command, check=True, stdout=subprocess.PIPE).stdout

    target = FOLDER / f"{name}.npz"
    np.savez_compressed(target, **source.read(show))  # type: ignore[arg-type] # names are no options
    return target


class Drag(NamedTuple):
    """A BioTac drag, cut by its electrodes.

    Attributes:
        name: Material and number.
        pressure: As recorded, rectified, shape (n,).
        lost: Sample at which the finger has lost contact: slip before, quiet after.
    """

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


def main(arguments: list[str]) -> None:
    """Fetch all sources."""
    local = dict(argument.split("=", 1) for argument in arguments)
    for name in SOURCES:
        print(f"{name}: {fetch(name, local.get(name))}")


if __name__ == "__main__":
    main(sys.argv[1:])

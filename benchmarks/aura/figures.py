"""Two figures of what the plant puts out: five sides that touch, and what speed and object do."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.aura.scenes import Passage, begun
from drivers.mock.physics.aura import ENVELOPE_HZ, RIGHT
from drivers.mock.physics.aura_objects import OBJECTS, SIDES

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FOLDER = Path(__file__).resolve().parents[1] / "figures"

I_COLOUR, Q_COLOUR = "#c1121f", "#457b9d"
"""In phase, in quadrature."""

SURFACE_M = 0.055
START_S = 0.5

Floats = NDArray[np.float64]


class Touch(Passage):
    """Half a millimetre into what is 55 mm ahead, two seconds there, and back as fast.

    Args:
        speed_m_s: How fast.
        depth_m: How deep.
    """

    def __init__(self, speed_m_s: float, depth_m: float = 0.0005) -> None:
        super().__init__(START_S, speed_m_s, SURFACE_M + depth_m)
        self.turn_s = self.end_s + 2.0
        self.home_s = self.turn_s + self.end_s - self.start_s

    def offsets(self, times_s: Floats) -> Floats:
        """Displacement from the start pose, shape (n, 6)."""
        found = super().offsets(times_s)
        found[:, 0] -= np.interp(times_s, [self.turn_s, self.home_s], [0.0, self._way_m])
        return found


def heard(passage: Passage, until_s: float, **about: Any) -> tuple[Floats, NDArray[np.complex128], Floats]:
    """Times, the right finger's envelope and its distance until some instant."""
    bench = begun(passage, **about)
    signal, gaps_m = [], []
    last = round(until_s * ENVELOPE_HZ)
    for first in range(1, last + 1, ENVELOPE_HZ):
        times_s = np.arange(first, min(first + ENVELOPE_HZ, last + 1)) / ENVELOPE_HZ
        bench.advance(float(times_s[-1]))
        signal.append(bench.baseband(times_s)[:, RIGHT])
        gaps_m.append(bench.distances(times_s)[:, RIGHT])
    return np.arange(1, last + 1) / ENVELOPE_HZ, np.concatenate(signal), np.concatenate(gaps_m)


def change(z: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """What has changed since the rest before the motion."""
    rest = complex(z[: round(0.9 * START_S * ENVELOPE_HZ)].mean())
    return z - rest


def draw() -> list[Path]:
    """Both figures, as SVG and PNG."""
    import matplotlib as mpl

    mpl.use("Agg")
    mpl.rcParams["svg.hashsalt"] = "touchbench"
    FOLDER.mkdir(exist_ok=True)
    return [*_sides(), *_speeds()]


def _save(figure: Figure, name: str) -> list[Path]:
    paths = [FOLDER / f"{name}.{kind}" for kind in ("svg", "png")]
    figure.savefig(paths[0], metadata={"Date": None})
    figure.savefig(paths[1], dpi=130)
    return paths


def _sides() -> list[Path]:
    """Each side comes to the pipe, touches it and goes back: as the paper's Fig. 6 and 7."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(len(SIDES), 2, figsize=(11, 9.5), layout="constrained", sharex="col")
    touch = Touch(0.01)
    for (whole, far), side in zip(axes, SIDES, strict=True):
        times_s, raw, gap_m = heard(touch, touch.home_s + 0.5, side=side)
        z = change(raw)
        for panel, part in ((whole, slice(0, None, 5)), (far, slice(0, round(4.8 * ENVELOPE_HZ), 3))):
            panel.plot(times_s[part], 1e3 * z.real[part], color=I_COLOUR, lw=0.7, label="I")
            panel.plot(times_s[part], 1e3 * z.imag[part], color=Q_COLOUR, lw=0.7, label="Q")
            panel.spines[["top", "right"]].set_visible(False)
        touching = times_s[gap_m <= 0.0]
        whole.axvspan(touching[0], touching[-1], color="#f4a261", alpha=0.25, lw=0)
        whole.set_ylabel(f"{side}\nchange, 1e-3 FS")
        far.set_ylim(-1.2, 1.2)
    axes[0, 0].set_title("to the pipe, contact (shaded), and back", loc="left")
    axes[0, 1].set_title("the way from 55 to 12 mm, enlarged", loc="left")
    axes[0, 0].legend(frameon=False, loc="upper left")
    for panel in axes[-1]:
        panel.set_xlabel("time, s")
    figure.suptitle("Simulated: the five sides of a finger at 10 mm/s, half drive")
    return _save(figure, "aura_sides")


def _speeds() -> list[Path]:
    """The same undulations at two speeds over distance, and how strong they are before each object."""
    import matplotlib.pyplot as plt

    figure, (speeds, objects) = plt.subplots(1, 2, figsize=(11, 4.2), layout="constrained")
    for shift, (speed_m_s, colour) in enumerate(((0.01, I_COLOUR), (0.03, Q_COLOUR))):
        passage = Passage(START_S, speed_m_s, 0.051)
        _, z, gap_m = heard(passage, passage.end_s)
        label = f"{speed_m_s:g} m/s"
        lower = 4.0 * shift
        speeds.plot(1e3 * gap_m, 1e3 * change(z).real - lower, color=colour, lw=0.8, label=label)
    speeds.set_xlabel("distance of the right finger from the pipe, mm")
    speeds.set_ylabel("change of I, 1e-3 FS (the second 4 lower)")
    speeds.invert_xaxis()
    quiet = {"noise_fs_rthz": 0.0, "motion_fs": 0.0, "drift_fs": 0.0, "gain_scatter_db": 0.0}
    passage = Passage(START_S, 0.01, 0.054)
    nothing = heard(passage, passage.end_s, object="none", **quiet)[1]
    for number, name in enumerate(OBJECTS):
        _, z, gap_m = heard(passage, passage.end_s, object=name, **quiet)
        way = gap_m < SURFACE_M
        style = "--" if OBJECTS[name].absorption > 0.5 else "-"
        size = 1e3 * np.abs(z - nothing)[way]
        objects.semilogy(1e3 * gap_m[way], size, style, color=f"C{number}", lw=1.0, label=name)
    objects.set_xlabel("distance, mm")
    objects.set_ylabel("what is reflected, 1e-3 FS, without noise")
    objects.invert_xaxis()
    objects.set_ylim(0.1, 100.0)
    for panel in (speeds, objects):
        panel.legend(frameon=False, fontsize=8, ncols=2)
        panel.spines[["top", "right"]].set_visible(False)
    figure.suptitle("Simulated: undulations depend on distance alone; soft objects (dashed) send back less")
    return _save(figure, "aura_speeds")

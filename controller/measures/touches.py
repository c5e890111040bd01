"""The touches of a pointer trial: the angle measured by the fingertip, and the arm's."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from controller.recording.series import TrialRecording

RECORDED = "RECORDING"
ZERO = "ZEROING"
"""The states of the behavior in which a touch, and the start pose, are recorded."""

FULL_TURN = 2.0 * math.pi


class Touch(NamedTuple):
    """One touch.

    Attributes:
        true_rad: Angle by which the arm has turned the tip about base y since the start pose.
        measured_rad: atan2(Fx, Fy) of the mean forces.
        spread_rad: Standard deviation of the angle from sample to sample.
        force_n: hypot(Fx, Fy) of the mean forces.
        going: "up" or "down": whether the angles ascend.
    """

    true_rad: float
    measured_rad: float
    spread_rad: float
    force_n: float
    going: str

    @property
    def error_rad(self) -> float:
        """Measured less true angle, between half a turn either way."""
        return math.remainder(self.measured_rad - self.true_rad, FULL_TURN)


class Errors(NamedTuple):
    """Errors of the angle over some touches, rad; NaN where there are too few.

    Attributes:
        bias: Mean.
        sd: Standard deviation about it.
        rms: Root mean square.
        largest: Largest of either sign.
        hysteresis: Largest difference between the same angle going up and going down.
    """

    bias: float
    sd: float
    rms: float
    largest: float
    hysteresis: float


def spans_of(visits: Iterable[tuple[str, float]], state: str) -> list[tuple[float, float]]:
    """From when to when a state lasted, each time; from the states in order of entry, with the bench time."""
    listed = [*visits, ("", math.inf)]
    return [(t_s, listed[i + 1][1]) for i, (name, t_s) in enumerate(listed[:-1]) if name == state]


def touches_of(
    recording: TrialRecording,
    visits: Sequence[tuple[str, float]],
    *,
    forces_stream: str,
    pose_stream: str,
    angles: int,
    broken_s: Collection[float] = (),
) -> list[Touch]:
    """The touches of a trial, in order.

    Args:
        visits: Every state in order of entry, with the bench time.
        forces_stream: Fx and Fy first, N.
        pose_stream: Of the arm: x, y, z in m, then the rotation vector in rad.
        angles: How many angles there are: as many touches go up, the others down.
        broken_s: Ends of pauses: a touch whose record ends there was interrupted, and is repeated.
    """
    forces, poses = recording.stream(forces_stream), recording.stream(pose_stream)
    still = [poses.between(*span).values for span in spans_of(visits, ZERO)[-1:]]
    if not still or not len(still[0]):
        return []
    start = _mean_vector(still[0][:, 3:])
    spans = [span for span in spans_of(visits, RECORDED) if span[1] not in broken_s]
    touches: list[Touch] = []
    for span in spans:
        own, places = forces.between(*span).values, poses.between(*span).values
        if len(own) < 2 or not len(places):
            continue
        fx_n, fy_n = own[:, 0], own[:, 1]
        measured_rad = math.atan2(float(fx_n.mean()), float(fy_n.mean()))
        each_rad = np.arctan2(fx_n, fy_n) - measured_rad
        touches.append(
            Touch(
                true_rad=turned_rad(start, _mean_vector(places[:, 3:])),
                measured_rad=measured_rad,
                spread_rad=float(np.std((each_rad + math.pi) % FULL_TURN - math.pi)),
                force_n=math.hypot(float(fx_n.mean()), float(fy_n.mean())),
                going="up" if len(touches) < angles else "down",
            )
        )
    return touches


def turned_rad(start: NDArray[np.float64], now: NDArray[np.float64]) -> float:
    """Angle about base y between two rotation vectors, shape (3,), rad."""
    from scipy.spatial.transform import Rotation

    turn = Rotation.from_rotvec(now) * Rotation.from_rotvec(start).inv()
    return float(turn.as_rotvec()[1])


def errors_of(touches: Sequence[Touch]) -> Errors:
    """Errors over some touches."""
    if not touches:
        return Errors(*[math.nan] * 5)
    errors = np.array([touch.error_rad for touch in touches])
    # the two touches of an angle stand at mirrored places of the sweep
    up = [touch.error_rad for touch in touches if touch.going == "up"]
    down = [touch.error_rad for touch in touches if touch.going == "down"][::-1]
    loop = [abs(there - back) for there, back in zip(up, down, strict=True)] if len(up) == len(down) else []
    return Errors(
        bias=float(errors.mean()),
        sd=float(errors.std(ddof=1)) if len(errors) > 1 else math.nan,
        rms=float(np.sqrt(np.mean(errors**2))),
        largest=float(np.abs(errors).max()),
        hysteresis=max(loop, default=math.nan),
    )


def _mean_vector(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Mean rotation vector, shape (3,); near half a turn either sign means the same, so all take the first one's."""
    signs = np.where(vectors @ vectors[0] < 0.0, -1.0, 1.0)
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    flipped = np.where(signs[:, None] < 0.0, vectors - vectors / length * FULL_TURN, vectors)
    return np.asarray(flipped.mean(axis=0))

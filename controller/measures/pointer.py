"""B7: the angle of the contact against the true angle (Fernandez et al., Fig. 2 and 11)."""

import math
from collections.abc import Collection, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from behaviors.events import Resumed
from behaviors.pointer import PointerSettings
from controller.measures.trial import Measured, TrialEvidence, spans_of
from controller.recording.series import TrialRecording
from drivers.core.messages import Floats

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
        mean_n = [float(own[:, channel].mean()) for channel in (0, 1)]
        measured_rad = math.atan2(*mean_n)
        each_rad = np.arctan2(own[:, 0], own[:, 1]) - measured_rad
        touches.append(
            Touch(
                true_rad=turned_rad(start, _mean_vector(places[:, 3:])),
                measured_rad=measured_rad,
                spread_rad=float(np.std((each_rad + math.pi) % FULL_TURN - math.pi)),
                force_n=math.hypot(*mean_n),
                going="up" if len(touches) < angles else "down",
            )
        )
    return touches


def turned_rad(start: Floats, now: Floats) -> float:
    """Angle about base y between two rotation vectors, shape (3,), rad."""
    from scipy.spatial.transform import Rotation

    turn = Rotation.from_rotvec(now) * Rotation.from_rotvec(start).inv()
    return float(turn.as_rotvec()[1])


def errors_of(touches: Sequence[Touch]) -> Mapping[str, float]:
    """Errors of the angle over some touches, rad, by the middle of their columns' names; NaN for too few touches."""
    if not touches:
        return dict.fromkeys(("bias", "sd", "rms", "max", "hysteresis"), math.nan)
    errors = np.array([touch.error_rad for touch in touches])
    # the two touches of an angle stand at mirrored places of the sweep
    up = [touch.error_rad for touch in touches if touch.going == "up"]
    down = [touch.error_rad for touch in touches if touch.going == "down"][::-1]
    loop = [abs(there - back) for there, back in zip(up, down, strict=True)] if len(up) == len(down) else []
    return {
        "bias": float(errors.mean()),
        "sd": float(errors.std(ddof=1)) if len(errors) > 1 else math.nan,
        "rms": float(np.sqrt(np.mean(errors**2))),
        "max": float(np.abs(errors).max()),
        "hysteresis": max(loop, default=math.nan),
    }


def _mean_vector(vectors: Floats) -> Floats:
    """Mean rotation vector, shape (3,); near half a turn either sign means the same, so all take the first one's."""
    signs = np.where(vectors @ vectors[0] < 0.0, -1.0, 1.0)
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    flipped = np.where(signs[:, None] < 0.0, vectors - vectors / length * FULL_TURN, vectors)
    return np.asarray(flipped.mean(axis=0))


HIGHLIGHTS = ("theta_rms_rad", "theta_max_rad", "force_n")
"""Columns shown during a run."""

COLUMNS = {
    "touches": "touches recorded",
    "force_n": "their mean normal force",
    "theta_bias_rad": "mean error of the angle over all of them",
    "theta_sd_rad": "its standard deviation",
    "theta_rms_rad": "its root mean square",
    "theta_max_rad": "the largest of either sign",
    "theta_hysteresis_rad": "largest difference between an angle going up and going down",
    "theta_spread_rad": "mean standard deviation of the angle from sample to sample",
}


def measure(evidence: TrialEvidence, settings: PointerSettings, outcome: str) -> Measured:
    """Compare the fingertip's angle with the arm's, touch by touch."""
    row: dict[str, Any] = dict.fromkeys(COLUMNS)
    for state in (ZERO, RECORDED):
        for begin_s, end_s in spans_of(evidence.visits, state):
            evidence.covered(settings.pose_stream, begin_s, end_s)
            if state == RECORDED:
                evidence.covered(settings.forces_stream, begin_s, end_s)
    touches = touches_of(
        evidence.recording,
        evidence.visits,
        forces_stream=settings.forces_stream,
        pose_stream=settings.pose_stream,
        angles=len(settings.angles_rad),
        broken_s=frozenset(event.t_s for event in evidence.events if isinstance(event, Resumed)),
    )
    row["touches"] = len(touches)
    if touches:
        errors = errors_of(touches).items()
        row |= {f"theta_{name}_rad": None if math.isnan(x) else x for name, x in errors}
        row["force_n"] = float(np.mean([touch.force_n for touch in touches]))
        row["theta_spread_rad"] = float(np.mean([touch.spread_rad for touch in touches]))
    return outcome, row

"""A UR5e's kinematics: where its joints put its tool, and which joints put it there. Pure: no clock, no I/O.

Source of the dimensions: Universal Robots, "DH parameters for calculations of kinematics and dynamics", UR5e
row. The closed inverse is the one of Hawkins, "Analytic inverse kinematics for the universal robots" (2013).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from drivers.mock.plants.rigid import IDENTITY, Array, difference, inverse

JOINTS = 6

D1_M, A2_M, A3_M, D4_M, D5_M, D6_M = 0.1625, -0.425, -0.3922, 0.1333, 0.0997, 0.0996
"""Denavit-Hartenberg lengths (source above)."""

_DH = (
    (0.0, D1_M, math.pi / 2),
    (A2_M, 0.0, 0.0),
    (A3_M, 0.0, 0.0),
    (0.0, D4_M, math.pi / 2),
    (0.0, D5_M, -math.pi / 2),
    (0.0, D6_M, 0.0),
)
"""(a in m, d in m, alpha in rad) of each joint (source above)."""

_LINKS = tuple((a, d, math.cos(alpha), math.sin(alpha)) for a, d, alpha in _DH)

JOINT_LIMIT_RAD = 2.0 * math.pi
"""Each joint turns by this much either way (UR5e data sheet: +-360 degrees)."""

JOINT_SPEED_RAD_S = math.pi
"""Fastest joint speed (UR5e data sheet: 180 degrees/s)."""

_TRACKING_M = 1e-7
"""Tool error at which `track` is content, metres and radians: a thousandth of the arm's 30 um repeatability
(UR5e data sheet) is smaller than anything that a bench can see."""

_TRACKING_STEPS = 6
"""Newton steps of `track`; two are enough for a step of 2 ms at 1 m/s (measured)."""

_REACH_SLACK = 1e-7
"""How far rounding may carry a cosine beyond 1 before a pose is called out of reach: an angle whose cosine is near
1 is known to the root of a double's precision alone, 1e-8, and the next angles inherit it."""


_STRAIGHT = 1e-7
"""Sine of the fifth joint below which the sixth angle is rounding alone (see `_REACH_SLACK`)."""


class UnreachableError(ValueError):
    """No joint angles put the tool there."""


def _link(joint: int, angle_rad: float) -> Array:
    """The transform from one link's frame to the next."""
    a, d, cos_alpha, sin_alpha = _LINKS[joint]
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    return np.array(
        [
            [c, -s * cos_alpha, s * sin_alpha, a * c],
            [s, c * cos_alpha, -c * sin_alpha, a * s],
            [0.0, sin_alpha, cos_alpha, d],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )


def _frames(joints_rad: Sequence[float] | Array) -> Iterator[Array]:
    """The transform of each link's frame in the base, joint by joint."""
    transform = IDENTITY
    for joint in range(JOINTS):
        transform = transform @ _link(joint, joints_rad[joint])
        yield transform


def forward(joints_rad: Sequence[float] | Array, tool: Array = IDENTITY) -> Array:
    """The tool's transform in the base, shape (4, 4).

    Args:
        joints_rad: Shape (6,).
        tool: Transform of the tool's point (TCP) in the flange's frame.
    """
    *_, flange = _frames(joints_rad)
    return np.asarray(flange @ tool)


def jacobian(joints_rad: Sequence[float] | Array, tool: Array = IDENTITY) -> tuple[Array, Array]:
    """The tool's transform and its geometric Jacobian.

    Returns:
        Shape (4, 4), and (6, 6): the twist (m/s, rad/s, base frame) is the Jacobian times the joint speeds.
    """
    frames = list(_frames(joints_rad))
    end = frames[-1] @ tool
    columns = []
    for before in (IDENTITY, *frames[:-1]):
        axis, arm = before[:3, 2], end[:3, 3] - before[:3, 3]
        columns.append(
            (
                axis[1] * arm[2] - axis[2] * arm[1],
                axis[2] * arm[0] - axis[0] * arm[2],
                axis[0] * arm[1] - axis[1] * arm[0],
                *axis,
            )
        )
    return end, np.array(columns).T


def track(joints_rad: Array, target: Array, tool: Array = IDENTITY) -> Array:
    """The joints, shape (6,), that put the tool at a target near where it is (Newton's method).

    Raises:
        UnreachableError: singular, or out of reach.
    """
    joints = np.array(joints_rad, dtype=np.float64)
    for _ in range(_TRACKING_STEPS):
        reached, slopes = jacobian(joints, tool)
        error = difference(reached, target)
        if float(np.abs(error).max()) < _TRACKING_M:
            return joints
        try:
            joints = joints + np.linalg.solve(slopes, error)
        except np.linalg.LinAlgError as singular:
            raise UnreachableError("the arm is at a singularity") from singular
    raise UnreachableError("the arm cannot follow: a singularity or the end of its reach")


def _arc_cosine(value: float) -> float | None:
    return None if abs(value) > 1.0 + _REACH_SLACK else math.acos(max(-1.0, min(1.0, value)))


def _elbows(first: float, fifth: float, sixth: float, flange: Array) -> Iterator[Array]:
    """Both elbows for given base and wrist angles: joints 2, 3 and 4 are a planar arm."""
    planar = inverse(_link(0, first)) @ flange @ inverse(_link(4, fifth) @ _link(5, sixth))
    # Frame 3's origin lies d4 back along frame 4's y axis, in the plane of links 2 and 3.
    x, y = (planar[:2, 3] - D4_M * planar[:2, 1]).tolist()
    elbow = _arc_cosine((x * x + y * y - A2_M**2 - A3_M**2) / (2.0 * A2_M * A3_M))
    if elbow is None:
        return
    for third in (elbow, -elbow):
        second = math.atan2(y, x) - math.atan2(A3_M * math.sin(third), A2_M + A3_M * math.cos(third))
        whole = math.atan2(planar[1, 0], planar[0, 0])
        yield np.array([first, second, third, whole - second - third, fifth, sixth])


def solutions(target: Array, tool: Array = IDENTITY, sixth_rad: float = 0.0) -> Iterator[Array]:
    """The sets of joint angles, up to eight of shape (6,), that put the tool at `target`, turns aside.

    With the wrist straight the sixth joint is free within the arm's reach, and is `sixth_rad`.
    """
    flange = target @ inverse(tool)
    wrist_x, wrist_y = (flange[:2, 3] - D6_M * flange[:2, 2]).tolist()
    shoulder = _arc_cosine(D4_M / max(math.hypot(wrist_x, wrist_y), _REACH_SLACK))
    if shoulder is None:
        return
    for side in (shoulder, -shoulder):
        first = math.atan2(wrist_y, wrist_x) + math.pi / 2 + side
        c1, s1 = math.cos(first), math.sin(first)
        tilt = _arc_cosine((flange[0, 3] * s1 - flange[1, 3] * c1 - D4_M) / D6_M)
        if tilt is None:
            continue
        for fifth in (tilt, -tilt):
            sine = math.sin(fifth)
            sign = math.copysign(1.0, sine)
            across = sign * (flange[1, 1] * c1 - flange[0, 1] * s1)
            along = sign * (flange[0, 0] * s1 - flange[1, 0] * c1)
            sixth = sixth_rad if abs(sine) < _STRAIGHT else math.atan2(across, along)
            yield from _elbows(first, fifth, sixth, flange)


def solve(target: Array, near_rad: Sequence[float] | Array, tool: Array = IDENTITY) -> Array:
    """The joints, shape (6,), nearest to `near_rad` that put the tool at `target`.

    Raises:
        UnreachableError: out of reach, or beyond the joints' limits.
    """
    near = np.asarray(near_rad, dtype=np.float64)
    turned = (near + _wrapped(joints - near) for joints in solutions(target, tool, float(near[5])))
    within = [joints for joints in turned if float(np.abs(joints).max()) <= JOINT_LIMIT_RAD]
    if not within:
        raise UnreachableError("no joint angles put the tool there")
    return min(within, key=lambda joints: float(np.abs(joints - near).sum()))


def _wrapped(angles_rad: Array) -> Array:
    return (angles_rad + math.pi) % (2.0 * math.pi) - math.pi

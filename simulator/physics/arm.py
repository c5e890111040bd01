"""A UR5e's kinematics: where its joints put its tool, and which joints put it there. Pure: no clock, no I/O.

Source of the dimensions: Universal Robots, "DH parameters for calculations of kinematics and dynamics", UR5e
row. The closed inverse is the one of Hawkins, "Analytic inverse kinematics for the universal robots" (2013).
"""

import math
from collections.abc import Iterator, Sequence

import numpy as np

from drivers.core.compiled import compiled
from simulator.physics.rigid import IDENTITY, Array, difference, inverse

JOINTS = 6

D1_M, A2_M, A3_M, D4_M, D5_M, D6_M = 0.1625, -0.425, -0.3922, 0.1333, 0.0997, 0.0996
"""Denavit-Hartenberg lengths (source above)."""

DH = (
    (0.0, D1_M, math.pi / 2),
    (A2_M, 0.0, 0.0),
    (A3_M, 0.0, 0.0),
    (0.0, D4_M, math.pi / 2),
    (0.0, D5_M, -math.pi / 2),
    (0.0, D6_M, 0.0),
)
"""(a in m, d in m, alpha in rad) of each joint (source above)."""

_LINKS = np.array([(a, d, math.cos(alpha), math.sin(alpha)) for a, d, alpha in DH])

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


_STRAIGHT = 3e-7
"""Sine of the fifth joint below which the sixth angle is rounding alone: a cosine near 1 that is off by 25
last bits, as they come, is a sine of 1e-7."""


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


@compiled("f8[:,:,:](f8[:], f8[:,:])")
def _frames(joints_rad: Array, tool: Array) -> Array:
    """Base, each link's frame in it, joint by joint, and last the tool's, shape (8, 4, 4)."""
    frames = np.zeros((JOINTS + 2, 4, 4))
    for i in range(JOINTS + 2):
        frames[i, 3, 3] = 1.0
    frames[0, 0, 0] = frames[0, 1, 1] = frames[0, 2, 2] = 1.0
    link = np.zeros((4, 4))
    for joint in range(JOINTS + 1):
        if joint < JOINTS:
            a, d, cos_alpha, sin_alpha = _LINKS[joint]
            c, s = math.cos(joints_rad[joint]), math.sin(joints_rad[joint])
            link[0, 0], link[0, 1], link[0, 2], link[0, 3] = c, -s * cos_alpha, s * sin_alpha, a * c
            link[1, 0], link[1, 1], link[1, 2], link[1, 3] = s, c * cos_alpha, -c * sin_alpha, a * s
            link[2, 1], link[2, 2], link[2, 3] = sin_alpha, cos_alpha, d
        else:
            for i in range(3):
                for j in range(4):
                    link[i, j] = tool[i, j]
        for i in range(3):
            frames[joint + 1, i, 3] = frames[joint, i, 3]
            for j in range(4):
                for k in range(3):
                    frames[joint + 1, i, j] += frames[joint, i, k] * link[k, j]
    return frames


def forward(joints_rad: Sequence[float] | Array, tool: Array = IDENTITY) -> Array:
    """The tool's transform in the base, shape (4, 4).

    Args:
        joints_rad: Shape (6,).
        tool: Transform of the tool's point (TCP) in the flange's frame.
    """
    end: Array = _frames(np.asarray(joints_rad, dtype=np.float64), tool)[-1]
    return end


def elbow(joints_rad: Array, speeds_rad_s: Array) -> tuple[Array, Array]:
    """Where the elbow is and how it moves, base frame, shape (3,) each: m and m/s."""
    frames: Array = _frames(joints_rad, IDENTITY)
    place = frames[2, :3, 3]
    velocity = sum(
        speeds_rad_s[joint] * np.cross(frames[joint, :3, 2], place - frames[joint, :3, 3]) for joint in (0, 1)
    )
    return place, np.asarray(velocity)


@compiled("f8[:,:](f8[:,:,:])")
def _slopes(frames: Array) -> Array:
    slopes = np.empty((6, JOINTS))
    for joint in range(JOINTS):
        ax, ay, az = frames[joint, 0, 2], frames[joint, 1, 2], frames[joint, 2, 2]
        x = frames[JOINTS + 1, 0, 3] - frames[joint, 0, 3]
        y = frames[JOINTS + 1, 1, 3] - frames[joint, 1, 3]
        z = frames[JOINTS + 1, 2, 3] - frames[joint, 2, 3]
        slopes[0, joint], slopes[1, joint], slopes[2, joint] = (
            ay * z - az * y,
            az * x - ax * z,
            ax * y - ay * x,
        )
        slopes[3, joint], slopes[4, joint], slopes[5, joint] = ax, ay, az
    return slopes


@compiled("b1(f8[:,:], f8[:])")
def _solved(slopes: Array, error: Array) -> bool:
    """Gauss's elimination with pivots, in place: `error` becomes the solution; False where there is none."""
    n = error.size
    for k in range(n):
        best = k
        for i in range(k + 1, n):
            if abs(slopes[i, k]) > abs(slopes[best, k]):
                best = i
        if slopes[best, k] == 0.0:
            return False
        if best != k:
            for j in range(n):
                slopes[k, j], slopes[best, j] = slopes[best, j], slopes[k, j]
            error[k], error[best] = error[best], error[k]
        for i in range(k + 1, n):
            factor = slopes[i, k] / slopes[k, k]
            for j in range(k, n):
                slopes[i, j] -= factor * slopes[k, j]
            error[i] -= factor * error[k]
    for k in range(n - 1, -1, -1):
        for j in range(k + 1, n):
            error[k] -= slopes[k, j] * error[j]
        error[k] /= slopes[k, k]
    return True


FOLLOWS, SINGULAR, LOST = range(3)
"""How a search for joints can end."""


@compiled("i8(f8[:], f8[:,:], f8[:,:])")
def _follow(joints_rad: Array, target: Array, tool: Array) -> int:
    """Newton's method in place: joints that put the tool at a target near where it is."""
    for _ in range(_TRACKING_STEPS):
        frames = _frames(joints_rad, tool)
        error = difference(frames[JOINTS + 1], target)
        there = True
        for part in error:
            there = there and abs(part) < _TRACKING_M  # NaN is not
        if there:
            return FOLLOWS
        if not _solved(_slopes(frames), error):
            return SINGULAR
        for joint in range(JOINTS):
            joints_rad[joint] += error[joint]
    return LOST


def track(joints_rad: Array, target: Array, tool: Array = IDENTITY) -> Array:
    """The joints, shape (6,), that put the tool at a target near where it is (Newton's method).

    Raises:
        UnreachableError: singular, or out of reach.
    """
    joints = np.array(joints_rad, dtype=np.float64)
    end = _follow(joints, target, tool)
    if end == SINGULAR:
        raise UnreachableError("the arm is at a singularity")
    if end == LOST:
        raise UnreachableError("the arm cannot follow: a singularity or the end of its reach")
    return joints


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

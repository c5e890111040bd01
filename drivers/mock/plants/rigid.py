"""Rigid transforms: poses as the arm's controller writes them ⇄ homogeneous matrices.

A pose is (x, y, z, rx, ry, rz): metres, and a rotation vector whose length is the angle in radians.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

IDENTITY: Array = np.eye(4)

_SMALL_RAD = 1e-8
"""Below this angle sin(x)/x is 1 to the last bit of a double (its series: 1 - x^2/6)."""


def rotation(rotation_vector: Sequence[float] | Array) -> Array:
    """The rotation matrix, shape (3, 3), of a rotation vector in radians (Rodrigues' formula)."""
    x, y, z = (float(value) for value in rotation_vector)
    angle = math.sqrt(x * x + y * y + z * z)
    if angle < _SMALL_RAD:
        return np.array([[1.0, -z, y], [z, 1.0, -x], [-y, x, 1.0]])
    sine, versine = math.sin(angle), 1.0 - math.cos(angle)
    x, y, z = x / angle, y / angle, z / angle
    return np.array(
        [
            [1.0 - versine * (y * y + z * z), versine * x * y - sine * z, versine * x * z + sine * y],
            [versine * x * y + sine * z, 1.0 - versine * (x * x + z * z), versine * y * z - sine * x],
            [versine * x * z - sine * y, versine * y * z + sine * x, 1.0 - versine * (x * x + y * y)],
        ]
    )


def rotation_vector(matrix: Array) -> Array:
    """The rotation vector, shape (3,), radians, at most pi long, of a rotation matrix (3, 3).

    By way of the quaternion's largest component (Shepperd's method): exact to rounding at every angle.
    """
    (a, b, c), (d, e, f), (g, h, i) = matrix[:3, :3].tolist()
    squares = (1.0 + a + e + i, 1.0 + a - e - i, 1.0 - a + e - i, 1.0 - a - e + i)
    largest = squares.index(max(squares))
    w, x, y, z = (
        (squares[0], h - f, c - g, d - b),
        (h - f, squares[1], d + b, c + g),
        (c - g, d + b, squares[2], h + f),
        (d - b, c + g, h + f, squares[3]),
    )[largest]
    length = math.sqrt(x * x + y * y + z * z)
    # The tuple is the quaternion up to a common factor, and a factor does not change the angle.
    angle = 2.0 * math.atan2(length, abs(w))
    factor = 0.0 if length == 0.0 else math.copysign(angle / length, w)
    return np.array([factor * x, factor * y, factor * z])


def matrix(pose: Sequence[float] | Array) -> Array:
    """The homogeneous matrix, shape (4, 4), of a pose."""
    result = np.eye(4)
    result[:3, :3] = rotation(pose[3:6])
    result[:3, 3] = pose[:3]
    return result


def pose(transform: Array) -> Array:
    """The pose, shape (6,), of a homogeneous matrix."""
    return np.concatenate((transform[:3, 3], rotation_vector(transform)))


def inverse(transform: Array) -> Array:
    """The inverse of a homogeneous matrix."""
    result = np.eye(4)
    result[:3, :3] = transform[:3, :3].T
    result[:3, 3] = -transform[:3, :3].T @ transform[:3, 3]
    return result


def difference(start: Array, end: Array) -> Array:
    """From one transform to another, shape (6,): translation in metres, rotation vector; base frame."""
    return np.concatenate(
        (end[:3, 3] - start[:3, 3], rotation_vector(end[:3, :3] @ start[:3, :3].T)),
    )


def displaced(start: Array, step: Array) -> Array:
    """A transform moved by a step (6,) of translation and rotation vector, both in the base frame."""
    result = start.copy()
    result[:3, 3] += step[:3]
    result[:3, :3] = rotation(step[3:]) @ start[:3, :3]
    return result

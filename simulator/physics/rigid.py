"""Rigid transforms: poses as the arm's controller writes them ⇄ homogeneous matrices.

Compiled, since a controller's cycle needs dozens of them.

A pose is (x, y, z, rx, ry, rz): metres, and a rotation vector whose length is the angle in radians.
"""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from drivers.core.compiled import compiled

Array = NDArray[np.float64]

IDENTITY: Array = np.eye(4)

_SMALL_RAD = 1e-8
"""Below this angle sin(x)/x is 1 to the last bit of a double (its series: 1 - x^2/6)."""


def rotation(rotation_vector: Sequence[float] | Array) -> Array:
    """The rotation matrix, shape (3, 3), of a rotation vector in radians."""
    x, y, z = (float(value) for value in rotation_vector)
    matrix: Array = turned(x, y, z)
    return matrix


@compiled("f8[:,:](f8, f8, f8)")
def turned(x: float, y: float, z: float) -> Array:
    """The same of its three parts (Rodrigues' formula)."""
    angle = math.sqrt(x * x + y * y + z * z)
    out = np.empty((3, 3))
    if angle < _SMALL_RAD:
        out[0, 0] = out[1, 1] = out[2, 2] = 1.0
        out[0, 1], out[0, 2], out[1, 0], out[1, 2], out[2, 0], out[2, 1] = -z, y, z, -x, -y, x
        return out
    s, v = math.sin(angle), 1.0 - math.cos(angle)
    x, y, z = x / angle, y / angle, z / angle
    out[0, 0], out[0, 1], out[0, 2] = 1.0 - v * (y * y + z * z), v * x * y - s * z, v * x * z + s * y
    out[1, 0], out[1, 1], out[1, 2] = v * x * y + s * z, 1.0 - v * (x * x + z * z), v * y * z - s * x
    out[2, 0], out[2, 1], out[2, 2] = v * x * z - s * y, v * y * z + s * x, 1.0 - v * (x * x + y * y)
    return out


@compiled("f8[:](f8[:,:])")
def rotation_vector(matrix: Array) -> Array:
    """The rotation vector, shape (3,), radians, at most pi long, of the rotation in a matrix (3, 3) or (4, 4).

    By way of the quaternion's largest component (Shepperd's method): exact to rounding at every angle.
    """
    a, e, i = matrix[0, 0], matrix[1, 1], matrix[2, 2]
    x, y, z = matrix[2, 1] - matrix[1, 2], matrix[0, 2] - matrix[2, 0], matrix[1, 0] - matrix[0, 1]
    xy, xz, yz = matrix[1, 0] + matrix[0, 1], matrix[0, 2] + matrix[2, 0], matrix[2, 1] + matrix[1, 2]
    w = 1.0 + a + e + i
    by_x, by_y, by_z = 1.0 + a - e - i, 1.0 - a + e - i, 1.0 - a - e + i
    largest = max(w, by_x, by_y, by_z)
    if w < largest:
        if by_x == largest:
            w, x, y, z = x, by_x, xy, xz
        elif by_y == largest:
            w, x, y, z = y, xy, by_y, yz
        else:
            w, x, y, z = z, xz, yz, by_z
    length = math.sqrt(x * x + y * y + z * z)
    # This is the quaternion up to a common factor, and a factor does not change the angle.
    angle = 2.0 * math.atan2(length, abs(w))
    factor = 0.0 if length == 0.0 else math.copysign(angle / length, w)
    out = np.empty(3)
    out[0], out[1], out[2] = factor * x, factor * y, factor * z
    return out


@compiled("f8[:,:,::1](f8[:,::1])")
def rotations(rotation_vectors: Array) -> Array:
    """`rotation` of each of some vectors, shape (n, 3); shape (n, 3, 3)."""
    out = np.empty((rotation_vectors.shape[0], 3, 3))
    for i in range(rotation_vectors.shape[0]):
        out[i] = turned(rotation_vectors[i, 0], rotation_vectors[i, 1], rotation_vectors[i, 2])
    return out


@compiled("f8[:,::1](f8[:,:,::1])")
def rotation_vectors(matrices: Array) -> Array:
    """`rotation_vector` of each of some matrices, shape (n, 3, 3); shape (n, 3)."""
    out = np.empty((matrices.shape[0], 3))
    for i in range(matrices.shape[0]):
        out[i] = rotation_vector(matrices[i])
    return out


def matrix(pose: Sequence[float] | Array) -> Array:
    """The homogeneous matrix, shape (4, 4), of a pose."""
    result = np.eye(4)
    result[:3, :3] = rotation(pose[3:6])
    result[:3, 3] = pose[:3]
    return result


@compiled("f8[:](f8[:,:])")
def pose(transform: Array) -> Array:
    """The pose, shape (6,), of a homogeneous matrix."""
    result = np.empty(6)
    turn = rotation_vector(transform)
    for i in range(3):
        result[i], result[3 + i] = transform[i, 3], turn[i]
    return result


def inverse(transform: Array) -> Array:
    """The inverse of a homogeneous matrix."""
    result = np.eye(4)
    result[:3, :3] = transform[:3, :3].T
    result[:3, 3] = -transform[:3, :3].T @ transform[:3, 3]
    return result


@compiled("f8[:](f8[:,:], f8[:,:])")
def difference(start: Array, end: Array) -> Array:
    """From one transform to another, shape (6,): translation in metres, rotation vector; base frame."""
    turn = np.zeros((3, 3))
    for i in range(3):
        for j in range(3):
            for k in range(3):
                turn[i, j] += end[i, k] * start[j, k]
    step = rotation_vector(turn)
    result = np.empty(6)
    for i in range(3):
        result[i], result[3 + i] = end[i, 3] - start[i, 3], step[i]
    return result


@compiled("f8[:,:](f8[:,:], f8[:])")
def displaced(start: Array, step: Array) -> Array:
    """A transform moved by a step (6,) of translation and rotation vector, both in the base frame."""
    turn = turned(step[3], step[4], step[5])
    result = np.zeros((4, 4))
    result[3, 3] = 1.0
    for i in range(3):
        result[i, 3] = start[i, 3] + step[i]
        for j in range(3):
            result[i, j] = turn[i, 0] * start[0, j] + turn[i, 1] * start[1, j] + turn[i, 2] * start[2, j]
    return result

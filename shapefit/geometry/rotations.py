"""Rotations: nearest, completed from two rows, random, about an axis; their angle."""

from __future__ import annotations

import numpy as np

from shapefit.arrays import Floats

OPPOSITE_BELOW = 1e-9
"""1 + cosine of directions between which there is no shortest rotation."""


def nearest_rotation(A: Floats) -> Floats:
    """Return the proper rotations nearest to matrices A (..., 3, 3) in ||R - A||_F."""
    U, _, Vt = np.linalg.svd(A)
    flip = np.ones(A.shape[:-1])
    flip[..., 2] = np.sign(np.linalg.det(U @ Vt))
    nearest: Floats = (U * flip[..., None, :]) @ Vt
    return nearest


def complete_rotation(rows: Floats) -> Floats:
    """Return the rotation (..., 3, 3) whose first two rows are nearest to `rows`.

    rows (..., 2, 3); the third row is the cross product of the others. The two rows are
    the polar factor of the input, so a positive multiple of two rows of a rotation
    comes back as that rotation (paper, section Reconstruction).
    """
    top = nearest_rows(rows)
    third = np.cross(top[..., 0, :], top[..., 1, :])
    return np.concatenate([top, third[..., None, :]], axis=-2)


def nearest_rows(rows: Floats) -> Floats:
    """Return the orthonormal rows (..., 2, 3) nearest to `rows` (..., 2, 3)."""
    U, _, Vt = np.linalg.svd(rows, full_matrices=False)
    nearest: Floats = U @ Vt
    return nearest


def random_rotations(n: int, rng: np.random.Generator) -> Floats:
    """Return random rotations (n, 3, 3), uniform over all rotations."""
    q = rng.standard_normal((4, n))
    w, x, y, z = q / np.linalg.norm(q, axis=0)
    entries = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(entries), -1, 0)


def rotation_about(axis: Floats, angles: Floats) -> Floats:
    """Return the rotations (..., 3, 3) about an axis (3,) by angles (...) in radians.

    R = I + sin(a) [u]_x + (1 - cos(a)) [u]_x^2 (Rodrigues); the axis may have any
    length.
    """
    x, y, z = np.asarray(axis, dtype=float) / np.linalg.norm(axis)
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    a = np.asarray(angles, dtype=float)[..., None, None]
    R: Floats = np.eye(3) + np.sin(a) * K + (1 - np.cos(a)) * (K @ K)
    return R


def rotation_about_axis(axis: int, angles: Floats) -> Floats:
    """Return the rotations (..., 3, 3) by angles (...) in radians about axis 0 to 2."""
    return rotation_about(np.eye(3)[axis], angles)


def exponential(turns: Floats) -> Floats:
    """Return the rotations (..., 3, 3) of rotation vectors (..., 3), in radians.

    R = exp([omega]_x) of the rotation vectors omega.
    """
    angle = np.linalg.norm(turns, axis=-1)[..., None, None]
    K = _cross_matrix(turns)
    # np.sinc(x) = sin(pi x) / (pi x), finite at 0
    first = np.sinc(angle / np.pi)
    half_second = np.sinc(angle / (2 * np.pi))
    R: Floats = np.eye(3) + first * K + 0.5 * half_second**2 * K @ K
    return R


def _cross_matrix(vectors: Floats) -> Floats:
    """Return the matrices (..., 3, 3) with [v]_x a = v x a, of vectors (..., 3)."""
    return np.cross(vectors[..., None, :], np.eye(3)).swapaxes(-1, -2)


def shortest_rotations(start: Floats, ends: Floats) -> Floats:
    """Return the smallest rotations (f, 3, 3) of a unit vector (3,) to others (f, 3).

    R = I + K + K^2 / (1 + cos), K = [start x end]_x. Between opposite vectors it is
    half a turn about some axis across them.
    """
    cosine = ends @ start
    K = _cross_matrix(np.cross(start, ends))
    divisor = np.maximum(1 + cosine, OPPOSITE_BELOW)[:, None, None]
    R = np.eye(3) + K + K @ K / divisor
    across = np.eye(3)[np.abs(start).argmin()]
    axis = across - (across @ start) * start
    half_turn = 2 * np.outer(axis, axis) / (axis @ axis) - np.eye(3)
    R[1 + cosine < OPPOSITE_BELOW] = half_turn
    return R


def rotation_angle(first: Floats, second: Floats) -> Floats:
    """Return the angle (...) in degrees between rotations (..., 3, 3).

    That of first^T second; nan where an entry is nan. Uses ||R1 - R2||_F = 2 sqrt(2)
    sin(angle / 2), which keeps its accuracy at small angles.
    """
    distance = np.linalg.norm(first - second, axis=(-2, -1))
    sine_of_half = np.clip(distance / np.sqrt(8), 0, 1)
    angle: Floats = np.degrees(2 * np.arcsin(sine_of_half))
    return angle

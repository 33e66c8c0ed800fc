"""Projected Matching Pursuit: greedy bases of either sign around the mean shape."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from shapefit import core
from shapefit.arrays import Floats
from shapefit.convex.problem import Problem
from shapefit.convex.solver import Status, read_statuses
from shapefit.geometry.rotations import complete_rotation
from shapefit.lifting.estimate import Estimate, fit_translation
from shapefit.lifting.methods import Settings
from shapefit.lifting.reconstruction import combine

# The published rules are in pixels: 500 px^2 for the squared reprojection error of all landmarks,
# 1 px^2 for its change in a round. A normalised unit is the standard deviation of the landmarks.
# A standing person is about 5 of them from ankle to head, 350 px in the images the rules were
# made for: 70 px a unit.
PIXELS = 70.0
GOAL = 500.0 / PIXELS**2
CHANGE = 1.0 / PIXELS**2
MOST_ATOMS, MOST_ROUNDS = 15, 30


@dataclass(frozen=True)
class Pursuit:
    """W ~ M S + T 1^T with S = c_0 mean + sum_i c_i B_i for n images.

    coefficients c (n, k) of either sign; mean_coefficient c_0 (n,); camera M (n, 2, 3), nan where
    there is none; error (n,), ||Omega o (W - M S - T 1^T)||_F^2; rounds (n,) of all inner loops;
    status: CONVERGED where the error reached the goal, ITERATION_LIMIT where the atoms ran out.
    """

    coefficients: Floats
    mean_coefficient: Floats
    camera: Floats
    error: Floats
    rounds: NDArray[np.int64]
    status: tuple[Status, ...]


def pursue(
    problem: Problem,
    mean_shape: Floats,
    edges: NDArray[np.int64] | None,
    *,
    goal: float = GOAL,
    change: float = CHANGE,
    most_atoms: int = MOST_ATOMS,
    most_rounds: int = MOST_ROUNDS,
    threads: int = 0,
) -> Pursuit:
    """Lower ||Omega o (W - M S - T 1^T)||_F^2 greedily, keeping the size of the skeleton.

    S = c_0 mean + sum_i c_i B_i with mean_shape (3, p); edges (e, 2) are the limbs, whose squared
    lengths keep the sum they have in the mean shape. It begins with the camera M of the mean
    shape, any 2x3 matrix. While the error is above `goal`, the atom whose projection has the
    largest |inner product| with the residual joins, and a loop of at most `most_rounds` rounds
    minimises over c (globally, on the limb constraint), then over M, until a round changes the
    error by less than `change`. No step raises the error. At most `most_atoms` join; those whose
    limbs are a mixture of the chosen ones' are passed over. lambda is ignored. Raises ValueError
    without limbs of a length, and for another loss than the squared one.

    Source: Ramakrishna, Kanade and Sheikh 2012, with the mean as one more basis shape. The
    constraint then settles how size is shared between S and M, and costs nothing where a loop
    comes to rest; with c_0 = 1 it would leave a single atom no more than two coefficients.
    """
    problem.require_squared("matching pursuit")
    n, k, _, p = len(problem.landmarks), *problem.atoms.shape
    if mean_shape.shape != (3, p):
        raise ValueError(f"mean_shape {mean_shape.shape} must be (3, {p})")
    shapes = np.ascontiguousarray(np.concatenate([mean_shape[None], problem.atoms]))
    limbs = find_limbs(shapes, edges)
    length = float(np.linalg.norm(limbs[0]))
    coefficients, camera = np.zeros((n, 1 + k)), np.full((n, 2, 3), np.nan)
    error, rounds, codes = np.full(n, np.nan), np.zeros(n, np.int64), np.zeros(n, np.int64)

    core.pursue(
        landmarks=problem.landmarks,
        weights=problem.weights,
        shapes=shapes,
        limbs=limbs,
        length=length,
        goal=goal,
        change=change,
        most_atoms=most_atoms,
        most_rounds=most_rounds,
        coefficients=coefficients,
        cameras=camera,
        errors=error,
        rounds=rounds,
        status=codes,
        threads=threads,
    )
    status = read_statuses(codes)
    return Pursuit(coefficients[:, 1:], coefficients[:, 0], camera, error, rounds, status)


def find_limbs(shapes: Floats, edges: NDArray[np.int64] | None) -> Floats:
    """Limb vectors (n, 3 e) of shapes (n, 3, p), one per edge (e, 2).

    Raises ValueError where there is none, or all are 0 in the first shape.
    """
    if edges is None or len(edges) == 0:
        raise ValueError("matching pursuit needs edges, the limbs whose lengths it keeps")
    limbs = shapes[:, :, edges[:, 0]] - shapes[:, :, edges[:, 1]]
    if not np.linalg.norm(limbs[0]) > 0:
        raise ValueError("every edge of the mean shape has length 0")
    return np.ascontiguousarray(limbs.reshape(len(shapes), -1))


def matching_pursuit(
    problem: Problem, mean_shape: Floats, edges: NDArray[np.int64] | None, *, threads: int = 0
) -> Estimate:
    """Pursue, and see the shape with the rotation nearest to the camera.

    M = U diag(s) V^T gives the two rows U V^T of the rotation and the scale (s_1 + s_2) / 2, which
    the coefficients take up. The objective is the squared error with M itself; the residual
    belongs to the rotated shape, as with every method.
    """
    found = pursue(problem, mean_shape, edges, threads=threads)
    known = np.isfinite(found.camera).all(axis=(1, 2), keepdims=True)
    M = np.where(known, found.camera, 0.0)
    rotation = complete_rotation(M)
    scale = np.linalg.svd(M, compute_uv=False).mean(axis=1)
    c = scale[:, None] * found.coefficients
    S = combine(c, problem.atoms) + (scale * found.mean_coefficient)[:, None, None] * mean_shape
    shapes = rotation @ S
    placed = fit_translation(problem, shapes)
    return Estimate(
        shapes=shapes,
        translation=placed.translation,
        rotation=np.where(known, rotation, np.nan),
        objective=found.error,
        residual=placed.residual,
        iterations=found.rounds,
        status=found.status,
        coefficients=c,
        active_atoms=np.count_nonzero(c, axis=1),
    )


def lift_by_pursuit(problem: Problem, settings: Settings) -> Estimate:
    """Pursue the landmarks with PCA bases (Ramakrishna, Kanade, Sheikh, ECCV 2012)."""
    edges = settings.needs.get("edges")
    return matching_pursuit(problem, settings.mean_shape, edges, threads=settings.threads)

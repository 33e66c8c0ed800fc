"""Exact recovery: plant transforms, solve the noiseless program, see whether they come back."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shapefit.arrays import Floats
from shapefit.convex.newton import solve_newton
from shapefit.convex.problem import Loss, build_problem
from shapefit.convex.solution import Status
from shapefit.geometry.rotations import random_rotations


@dataclass(frozen=True)
class Instance:
    """W = sum_i M_i B_i without noise: landmarks W (2, p), atoms B (k, 3, p), M (k, 2, 3)."""

    landmarks: Floats
    atoms: Floats
    transforms: Floats


@dataclass(frozen=True)
class Attempt:
    """What the program made of one instance.

    error is ||M_found - M||_F / ||M||_F, nan where the solver failed; relative_gap, residual,
    iterations and status are the solver's (Solution).
    """

    error: float
    relative_gap: float
    residual: float
    iterations: int
    status: Status


def plant(k: int, p: int, z: int, rng: np.random.Generator) -> Instance:
    """Return a random instance with k atoms, p landmarks and z atoms in use.

    Entries of B_i are N(0, 1), rotations uniform, z coefficients at random places U(0, 1) and the
    others 0; M_i = c_i times the first two rows of R_i (paper, section Simulation).
    """
    B = rng.standard_normal((k, 3, p))
    R = random_rotations(k, rng)
    c = np.zeros(k)
    c[rng.choice(k, z, replace=False)] = rng.uniform(size=z)
    M = c[:, None, None] * R[:, :2]
    return Instance(np.einsum("iab,ibp->ap", M, B), B, M)


def recover(
    instance: Instance, *, free_translation: bool, tolerance: float, max_iterations: int
) -> Attempt:
    """Solve min sum_i ||M_i||_2 s.t. W = sum_i M_i B_i + T 1^T (paper, eq. finalnoiseless).

    T is free, which is the same as centring the rows of W and of all B_i, or 0. One thread.
    """
    W, B = instance.landmarks, instance.atoms
    if not free_translation:
        W, B = _with_fixed_origin(W, B)
    problem = build_problem(W, B, lam=1.0, loss=Loss.EXACT)
    found = solve_newton(problem, tolerance=tolerance, max_iterations=max_iterations, threads=1)
    M = instance.transforms
    return Attempt(
        error=float(np.linalg.norm(found.transforms[0] - M) / np.linalg.norm(M)),
        relative_gap=float(found.relative_gap[0]),
        residual=float(found.residual[0]),
        iterations=int(found.iterations[0]),
        status=found.status[0],
    )


def _with_fixed_origin(W: Floats, B: Floats) -> tuple[Floats, Floats]:
    """Add a landmark at the origin of every atom that is seen at the origin: W (2, p), B (k, 3, p).

    The solver always frees the translation. The constraint of this landmark is 0 = 0 + T; the
    others are then those of the program without a translation, and no landmark is lost to T.
    """
    k, _, _ = B.shape
    return np.hstack([W, np.zeros((2, 1))]), np.concatenate([B, np.zeros((k, 3, 1))], axis=2)

"""The method `convex`: from the transforms of the convex program to shapes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from shapefit import core
from shapefit.arrays import Floats
from shapefit.convex.problem import Problem
from shapefit.convex.solver import find_outliers
from shapefit.convex.transforms import Transforms
from shapefit.lifting.estimate import AtomEstimate, ConvexProof, Solve

MIN_ACTIVE_SHARE = 1e-6
"""Coefficient of an atom that is active, as a share of the largest one."""


def lift_convex(problem: Problem, *, solve: Solve, threads: int = 0) -> AtomEstimate:
    """Lift by the convex program: solve it, and turn its transforms into shapes.

    Source: paper, section Reconstruction.
    """
    solution = solve(problem)
    reconstruction = reconstruct(solution.transforms, problem.atoms, threads=threads)
    return AtomEstimate(
        shapes=reconstruction.shapes,
        translation=solution.translation,
        rotation=reconstruction.rotation,
        objective=solution.objective,
        residual=solution.residual,
        iterations=solution.iterations,
        status=solution.status,
        coefficients=reconstruction.coefficients,
        active_atoms=reconstruction.active_atoms,
        transforms=solution.transforms,
        relative_gap=solution.relative_gap,
        tight=reconstruction.tight,
        outliers=find_outliers(problem, solution),
        convex_proof=ConvexProof.of(solution),
    )


class Reconstruction(NamedTuple):
    """The shapes of n images that transforms make of atoms, and their parts.

    S = sum_i c_i R_i B_i. shapes (n, 3, p); coefficients c (n, k); rotation (n, 3, 3),
    the rotation nearest to sum_i c_i R_i, nan where all coefficients are 0;
    active_atoms (n,); tight (n,): are all active transforms orthogonal, so that the
    optimum solves the per-atom nonconvex model too?
    """

    shapes: Floats
    coefficients: Floats
    rotation: Floats
    active_atoms: NDArray[np.int64]
    tight: NDArray[np.bool_]


def is_active(coefficients: Floats) -> NDArray[np.bool_]:
    """Whether coefficients (n, k) are not negligible beside the largest of an image."""
    size = np.abs(coefficients)
    largest = size.max(axis=1, keepdims=True)
    active: NDArray[np.bool_] = size > MIN_ACTIVE_SHARE * largest
    return active


def reconstruct(M: Transforms, atoms: Floats, *, threads: int = 0) -> Reconstruction:
    """Return the shapes that the transforms M_i of n images make of the atoms.

    S = sum_i c_i R_i B_i (paper, eq. new3dmodel), atoms B (k, 3, p). R_i completes M_i
    / c_i by the cross product of its rows; `threads` = 0 means all cores. The method is
    written down in shapefit/core/pose/transforms.cpp.
    """
    n = len(M.count)
    shapes = np.zeros((n, 3, atoms.shape[2]))
    rotation = np.full((n, 3, 3), np.nan)
    sizes = np.empty(len(M.atom))
    active = np.empty(n, np.int64)
    tight = np.empty(n, bool)
    core.reconstruct(
        **M.arrays,
        atoms=atoms,
        threads=threads,
        sizes=sizes,
        shapes=shapes,
        rotation=rotation,
        active=active,
        tight=tight,
    )
    return Reconstruction(shapes, M.scatter(sizes), rotation, active, tight)


def combine(
    coefficients: Floats, atoms: Floats, rotation: Floats | None = None
) -> Floats:
    """Return the mixtures R sum_i c_i B_i (n, 3, p) of atoms, turned if R is given.

    c (n, k), atoms B (k, 3, p), R (n, 3, 3).
    """
    # atom by atom: the rounding of an image then depends on no other one
    shapes = np.zeros((len(coefficients), *atoms.shape[1:]))
    for c, atom in zip(coefficients.T, atoms, strict=True):
        used = np.flatnonzero(c)
        shapes[used] += c[used, None, None] * atom
    return shapes if rotation is None else rotation @ shapes

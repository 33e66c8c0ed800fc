"""Lift a batch of landmarks: normalise, solve the convex program, reconstruct, scale back."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from shapefit.convex.problem import Loss, Problem, build_problem
from shapefit.convex.solution import Solution, Status
from shapefit.geometry.normalisation import normalise
from shapefit.lifting.degeneracy import find_degenerate
from shapefit.lifting.noise_level import lambda_for_noise
from shapefit.lifting.reconstruction import Reconstruction, reconstruct

Floats = NDArray[np.float64]
Solve = Callable[[Problem], Solution]


@dataclass(frozen=True)
class Program:
    """Which convex program is solved.

    `lam` None takes lambda from `noise`, the standard deviation of a landmark's coordinate in the
    unit of the landmarks. With a robust loss a landmark is an outlier where a coordinate of its
    weighted residual exceeds `beta` (normalised), which is also the weight of the sparse errors.
    """

    lam: float | None
    loss: Loss = Loss.SQUARED
    beta: float = 0.1
    noise: float = 0.0

    @property
    def is_robust(self) -> bool:
        """Return whether the loss tells outliers."""
        return self.loss in (Loss.ABSOLUTE, Loss.SPARSE_ERROR)


@dataclass(frozen=True)
class Lifting:
    """Shapes in the camera frame and the units of the landmarks, and all that they rest on.

    landmarks = scale sum_i M_i B_i + translation. shapes (n, 3, p), with mean depth 0;
    landmarks_fitted (n, 2, p); translation (n, 2), scale (n,); reconstruction and solution in
    normalised units; outliers (n, p) for robust losses; failures: image -> reason, for images
    without a shape (nan).
    """

    shapes: Floats
    landmarks_fitted: Floats
    translation: Floats
    scale: Floats
    reconstruction: Reconstruction
    problem: Problem
    solution: Solution
    outliers: NDArray[np.bool_] | None
    failures: Mapping[int, str]


def lift(
    landmarks: Floats, weights: Floats, atoms: Floats, program: Program, solve: Solve
) -> Lifting:
    """Lift n images; landmarks (n, 2, p), weights (n, p) with 0 = hidden, atoms (k, 3, p)."""
    failures = find_degenerate(landmarks, weights)
    fine = np.ones(len(landmarks), dtype=bool)
    fine[list(failures)] = False

    visible = weights > 0
    norm = normalise(landmarks, visible)
    problem = build_problem(
        np.where(fine[:, None, None], norm.points, 0.0),
        atoms,
        choose_lambda(program, atoms, np.where(fine, norm.scale, 1.0), visible.mean(axis=1)),
        weights=np.where(fine[:, None], weights, 0.0),
        loss=program.loss,
        beta=program.beta,
    )
    solution = solve(problem)
    for image, status in enumerate(solution.status):
        if status is Status.NUMERICAL_FAILURE:
            failures[image] = "numerical failure in the solver"
            fine[image] = False

    found = reconstruct(solution.transforms, atoms)
    scale = np.where(fine, norm.scale, np.nan)
    translation = scale[:, None] * solution.translation + norm.centroid
    shapes = scale[:, None, None] * found.shapes
    shapes[:, :2] += translation[:, :, None]
    return Lifting(
        shapes=shapes,
        landmarks_fitted=shapes[:, :2],
        translation=translation,
        scale=scale,
        reconstruction=found,
        problem=problem,
        solution=solution,
        outliers=find_outliers(program, weights, solution) if program.is_robust else None,
        failures=failures,
    )


def choose_lambda(program: Program, atoms: Floats, scale: Floats, visible_share: Floats) -> Floats:
    """Lambda of each image: as given, from the noise, or 1 where it has no say."""
    if program.loss is Loss.EXACT:
        return np.ones_like(scale)
    if program.lam is None:
        return lambda_for_noise(atoms, program.noise, scale, visible_share)
    return np.full_like(scale, program.lam)


def find_outliers(program: Program, weights: Floats, solution: Solution) -> NDArray[np.bool_]:
    """Landmarks (n, p) with a weighted residual beyond beta in a coordinate.

    For the sparse-error loss these are the ones with an error E that is not 0.
    """
    errors = np.abs(solution.errors)
    if program.loss is Loss.ABSOLUTE:
        return np.any(errors * weights[:, None, :] > program.beta, axis=1)
    return np.any(errors > 0, axis=1)

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
from shapefit.lifting.reconstruction import Reconstruction, reconstruct

Floats = NDArray[np.float64]
Solve = Callable[[Problem], Solution]


@dataclass(frozen=True)
class Program:
    """Which convex program: lambda, loss, and beta of the sparse-error loss."""

    lam: float
    loss: Loss = Loss.SQUARED
    beta: float = 0.1


@dataclass(frozen=True)
class Lifting:
    """Shapes in the camera frame and the units of the landmarks, and all that they rest on.

    landmarks = scale sum_i M_i B_i + translation. shapes (n, 3, p), with mean depth 0;
    landmarks_fitted (n, 2, p); translation (n, 2), scale (n,); reconstruction and solution in
    normalised units; failures: image -> reason, for images without a shape (nan).
    """

    shapes: Floats
    landmarks_fitted: Floats
    translation: Floats
    scale: Floats
    reconstruction: Reconstruction
    solution: Solution
    failures: Mapping[int, str]


def lift(
    landmarks: Floats, weights: Floats, atoms: Floats, program: Program, solve: Solve
) -> Lifting:
    """Lift n images; landmarks (n, 2, p), weights (n, p) with 0 = hidden, atoms (k, 3, p)."""
    failures = find_degenerate(landmarks, weights)
    fine = np.ones(len(landmarks), dtype=bool)
    fine[list(failures)] = False

    norm = normalise(landmarks, weights > 0)
    W = np.where(fine[:, None, None], norm.points, 0.0)
    solution = solve(
        build_problem(
            W,
            atoms,
            program.lam,
            weights=np.where(fine[:, None], weights, 0.0),
            loss=program.loss,
            beta=program.beta,
        )
    )
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
        solution=solution,
        failures=failures,
    )

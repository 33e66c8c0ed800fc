"""Outliers by the residuals that a robust loss leaves."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from shapefit.convex.problem import Loss, Problem
from shapefit.convex.solution import Solution
from shapefit.lifting.degeneracy import find_degenerate


def find_outliers(problem: Problem, solution: Solution) -> NDArray[np.bool_] | None:
    """Landmarks (n, p) with a weighted residual beyond beta in a coordinate; None if not robust.

    For the sparse-error loss these are the ones with an error E that is not 0.
    """
    if problem.loss is Loss.ABSOLUTE:
        return np.any(np.abs(solution.errors) * problem.weights[:, None, :] > problem.beta, axis=1)
    if problem.loss is Loss.SPARSE_ERROR:
        return np.any(solution.errors != 0, axis=1)
    return None


def believable(problem: Problem, outliers: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Outliers (n, p), but none in an image where the others could not be lifted without them."""
    left = np.where(outliers, 0.0, problem.weights)
    beyond = np.zeros(len(left), dtype=bool)
    beyond[list(find_degenerate(problem.landmarks, left))] = True
    return outliers & ~beyond[:, None]

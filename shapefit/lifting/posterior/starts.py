"""Rotations from which the posterior is sought."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from shapefit.convex.problem import Problem
from shapefit.convex.solution import Solution
from shapefit.lifting.methods import Settings
from shapefit.lifting.shared_rotation.pose import find_pose, spread_views
from shapefit.lifting.shared_rotation.synchronisation import synchronise

Floats = NDArray[np.float64]

VIEWS = 6


def find_starts(problem: Problem, solution: Solution, settings: Settings) -> Floats:
    """Rotations (n, 1, 3, 3): the one that the transforms of the convex program agree on.

    Where they are all 0, the best pose of the mean shape. Rotations of the best pose, of the
    views of `alternate` and the mirrored depth gained nothing on subject 86.
    """
    rotation = synchronise(solution.transforms, threads=settings.threads).rotation
    empty = np.flatnonzero(~solution.transforms.any(axis=(1, 2, 3)))
    if len(empty):
        part = problem.take(empty)
        views = spread_views(VIEWS)
        rotation[empty] = find_pose(
            part, settings.mean_shape, views, threads=settings.threads
        ).rotation
    return rotation[:, None]

"""Rotations from which the posterior is sought."""

from __future__ import annotations

import numpy as np

from shapefit.arrays import Floats
from shapefit.convex.problem import Problem
from shapefit.convex.solution import Solution
from shapefit.lifting.methods import Settings
from shapefit.lifting.reconstruction import reconstruct
from shapefit.lifting.shared_rotation.pose import (
    find_moments,
    find_pose,
    spread_views,
    turn_in_plane,
)

VIEWS = 6


def find_starts(problem: Problem, solution: Solution, settings: Settings) -> Floats:
    """Rotations (n, 1 + views, 3, 3): the consensus of the convex program's rotations.

    Where they are all 0, the best pose of the mean shape. Then the views of the options, each
    turned in the plane onto the landmarks.
    """
    M = solution.transforms
    rotation = reconstruct(M, problem.atoms, threads=settings.threads).rotation
    empty = np.flatnonzero(M.count == 0)
    if len(empty):
        part = problem.take(empty)
        views = spread_views(VIEWS)
        rotation[empty] = find_pose(
            part, settings.mean_shape, views, threads=settings.threads
        ).rotation
    if settings.options.views == 0:
        return rotation[:, None]
    _, by_shape = find_moments(problem, settings.mean_shape)
    turned = turn_in_plane(spread_views(settings.options.views), by_shape)
    return np.concatenate([rotation[:, None], turned], axis=1)

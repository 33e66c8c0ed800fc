"""The method `global`: the certified optimum of the model with one rotation.

It is certified by branch and bound: the result states the gap to a bound on all
rotations.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from shapefit import core
from shapefit.arrays import Floats, Integers
from shapefit.convex.problem import Problem
from shapefit.convex.solver import Status, read_statuses
from shapefit.lifting.estimate import Estimate
from shapefit.lifting.methods import Settings
from shapefit.lifting.shared_rotation import (
    alternate_from_mean,
    describe_shapes,
    refine_convex,
)

MAX_SEARCH_CELLS = 200_000
"""After which the search of an image gives up."""

MAX_SEARCH_SECONDS = 10.0
"""After which the search of an image gives up."""


def find_global(problem: Problem, settings: Settings) -> Estimate:
    """Search all rotations, from the results of convex+refine and alternate on.

    So it is never above either of them. The iterations are cells; the gap is that to
    the bound.
    """
    local = replace(settings, signed=False)
    ends = [refine_convex(problem, local), alternate_from_mean(problem, local)]
    optimum = find_optimum(
        problem,
        np.stack([end.rotation for end in ends], axis=1),
        tolerance=settings.tolerance,
        threads=settings.threads,
    )
    estimate = describe_shapes(
        problem,
        optimum.coefficients,
        optimum.rotation,
        iterations=optimum.cells,
        status=optimum.status,
    )
    return replace(estimate, relative_gap=optimum.relative_gap)


class GlobalOptimum(NamedTuple):
    """min_R v(R) for n images, and how well it is known.

    coefficients c (n, k); rotation R (n, 3, 3), nan where c = 0; objective U (n,)
    there, and bound L (n,) <= v(R) for every rotation R; relative_gap (U - L) / U (n,),
    0 where U = 0; cells (n,) of the search; status, a Status per image: OPTIMAL where U
    - L <= tolerance U, up to rounding.
    """

    coefficients: Floats
    rotation: Floats
    objective: Floats
    bound: Floats
    relative_gap: Floats
    cells: Integers
    status: tuple[Status, ...]


def find_optimum(
    problem: Problem,
    starts: Floats | None = None,
    *,
    tolerance: float = 1e-2,
    max_cells: int = MAX_SEARCH_CELLS,
    max_seconds: float = MAX_SEARCH_SECONDS,
    threads: int = 0,
) -> GlobalOptimum:
    """min 1/2 ||Omega o (W - Rbar sum_i c_i B_i - T 1^T)||_F^2 + lambda ||c||_1.

    (Paper, eq. originalnoisy, with weights and translation.) Over all R, with Rbar
    Rbar^T = I, and c >= 0. The optimum found is never above v at one of starts (n, s,
    3, 3); a start that is nan counts for nothing. Fewer than two visible landmarks are
    DEGENERATE. Bound and search: docs/global.md. Raises ValueError for a loss other
    than the squared one.
    """
    problem.require_squared("the search")
    n = len(problem.landmarks)
    if starts is None:
        starts = np.zeros((n, 0, 3, 3))
    coefficients = np.zeros((n, len(problem.atoms)))
    rotation = np.full((n, 3, 3), np.nan)
    objective, bound = np.full((2, n), np.nan)
    cells, vertices, codes = np.zeros((3, n), np.int64)
    core.find_optimum(
        **problem.arrays,
        starts=np.ascontiguousarray(starts, float),
        tolerance=tolerance,
        most_cells=max_cells,
        most_seconds=max_seconds,
        coefficients=coefficients,
        rotation=rotation,
        objective=objective,
        bound=bound,
        cells=cells,
        vertices=vertices,
        status=codes,
        threads=threads,
    )
    rotation[~coefficients.any(axis=1)] = np.nan
    gap = np.zeros(n)
    np.divide(objective - bound, objective, out=gap, where=objective > 0)
    return GlobalOptimum(
        coefficients=coefficients,
        rotation=rotation,
        objective=objective,
        bound=bound,
        relative_gap=gap,
        cells=cells,
        status=read_statuses(codes),
    )

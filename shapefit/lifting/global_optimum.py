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
from shapefit.convex.solver import Status, decode_statuses
from shapefit.lifting.estimate import AtomEstimate, Solve
from shapefit.lifting.methods import STARTS
from shapefit.lifting.shared_rotation import (
    alternate_from_mean,
    describe_shapes,
    refine_convex,
)

MAX_SEARCH_CELLS = 200_000
"""Tests of cells after which the search of an image gives up."""

MAX_KEPT_NUMBERS = 2**27
"""It gives up earlier where k and p are large: what it keeps of a rotation are
8 k + 2 p numbers, of which a thread keeps at most so many, 1 GiB. There is no limit of
time: results must not depend on what else the machine does.
"""


def find_global(
    problem: Problem,
    *,
    solve: Solve,
    mean_shape: Floats,
    starts: int = STARTS,
    tolerance: float = 1e-2,
    threads: int = 0,
) -> AtomEstimate:
    """Return the best shapes over all shared rotations, with a certified gap.

    The search starts from the results of convex+refine and alternate, so its objective
    is never above either of theirs. The iterations are cells; the gap is that to the
    bound.
    """
    refined = refine_convex(
        problem, solve=solve, mean_shape=mean_shape, threads=threads
    )
    alternated = alternate_from_mean(
        problem, mean_shape=mean_shape, starts=starts, threads=threads
    )
    optimum = find_optimum(
        problem,
        np.stack([refined.rotation, alternated.rotation], axis=1),
        tolerance=tolerance,
        threads=threads,
    )
    estimate = describe_shapes(
        problem,
        optimum.coefficients,
        optimum.rotation,
        iterations=optimum.cells,
        status=optimum.status,
    )
    k, _, p = problem.atoms.shape
    limit = f"the search ended after {limit_cells(k, p):,} cells (docs/global.md)"
    return replace(estimate, relative_gap=optimum.relative_gap, limit=limit)


class GlobalOptimum(NamedTuple):
    """The least objective over all rotations for n images, and how well it is known.

    That is min_R v(R). coefficients c (n, k); rotation R (n, 3, 3), nan where c = 0;
    objective U (n,) there, and bound L (n,) <= v(R) for every rotation R; relative_gap
    (U - L) / U (n,), 0 where U = 0; cells (n,) of the search; status, a Status per
    image: OPTIMAL where U - L <= tolerance U, up to rounding.
    """

    coefficients: Floats
    rotation: Floats
    objective: Floats
    bound: Floats
    relative_gap: Floats
    cells: Integers
    status: tuple[Status, ...]


class DroppedCells(NamedTuple):
    """The first cells that the search of n images drops, by which the bound is checked.

    number (n,); corners (n, d, 4, 4), unit quaternions (w, x, y, z); cuts (n, d): no
    rotation of the cell has an objective below.
    """

    number: Integers
    corners: Floats
    cuts: Floats

    @classmethod
    def allocate(cls, n: int, d: int) -> DroppedCells:
        """Make arrays of zeros, into which a search writes d cells of n images."""
        return cls(np.zeros(n, np.int64), np.zeros((n, d, 4, 4)), np.zeros((n, d)))


def limit_cells(k: int, p: int) -> int:
    """Return the number of cells after which a search of k atoms, p landmarks gives up.

    Fewer where these are many, for memory.
    """
    return min(MAX_SEARCH_CELLS, MAX_KEPT_NUMBERS // (8 * k + 2 * p))


def find_optimum(
    problem: Problem,
    starts: Floats | None = None,
    *,
    tolerance: float = 1e-2,
    max_cells: int | None = None,
    threads: int = 0,
    dropped: DroppedCells | None = None,
) -> GlobalOptimum:
    """Find the certified optimum over one rotation and coefficients, for each image.

    min 1/2 ||Omega o (W - Rbar sum_i c_i B_i - T 1^T)||_F^2 + lambda ||c||_1 (paper,
    eq. originalnoisy, with weights and translation) over all R, with Rbar Rbar^T = I,
    and c >= 0. The optimum found is never above v at one of starts (n, s, 3, 3); a
    start that is nan counts for nothing. Fewer than two visible landmarks are
    DEGENERATE. A search that has not ended after max_cells tests of cells, by default
    `limit_cells`, goes on with looser gaps for as many again, and is an
    ITERATION_LIMIT. The cells that it drops are written to `dropped`. Bound and search:
    docs/global.md. Raises ValueError for a loss other than the squared one.
    """
    problem.require_squared("the search")
    n, _, p = problem.landmarks.shape
    k = len(problem.atoms)
    if starts is None:
        starts = np.zeros((n, 0, 3, 3))
    if max_cells is None:
        max_cells = limit_cells(k, p)
    if dropped is None:
        dropped = DroppedCells.allocate(n, 0)
    coefficients = np.zeros((n, k))
    rotation = np.full((n, 3, 3), np.nan)
    objective, bound = np.full((2, n), np.nan)
    cells, vertices, codes = np.zeros((3, n), np.int64)
    core.find_optimum(
        **problem.arrays,
        starts=np.ascontiguousarray(starts, float),
        tolerance=tolerance,
        max_cells=max_cells,
        coefficients=coefficients,
        rotation=rotation,
        objective=objective,
        bound=bound,
        cells=cells,
        vertices=vertices,
        status=codes,
        dropped=dropped.number,
        corners=dropped.corners,
        cuts=dropped.cuts,
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
        status=decode_statuses(codes),
    )

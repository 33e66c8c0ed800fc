"""The tree of a search with the multipliers of its vertices: a bound that anybody can check."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from shapefit import core
from shapefit.arrays import Floats
from shapefit.convex.problem import Problem

Indices = NDArray[np.int64]


@dataclass(frozen=True)
class Tree:
    """Cells of one image that together hold all rotations, and what bounds v in each of them.

    splits (c,): for each cell, depth first from the 300 of the 600-cell, the edge 0..5 whose
    middle cuts it in two, or -1; vertices: unit quaternions (v, 4), the 60 of the 600-cell first,
    then the middles in the order in which they come up; multipliers s Y (v, 2, p), orthogonal to
    omega. docs/global.md says what follows.
    """

    splits: Indices
    vertices: Floats
    multipliers: Floats


def record_tree(
    problem: Problem, image: int, bound: float, *, most_cells: int = 200_000
) -> Tree | None:
    """Return a tree that proves v >= bound for one image; None where there is none so small."""
    problem.require_squared("the search")
    one = problem.take(np.array([image]))
    p = one.landmarks.shape[2]

    def record(cells: int, vertices: int) -> tuple[Tree, tuple[int, int, bool]]:
        tree = Tree(np.zeros(cells, np.int64), np.zeros((vertices, 4)), np.zeros((vertices, 2, p)))
        size = core.record_tree(
            **one.arrays,
            cut=bound,
            most_cells=most_cells,
            vertices=tree.vertices,
            multipliers=tree.multipliers,
            splits=tree.splits,
        )
        return tree, size

    _, (cells, vertices, complete) = record(0, 0)
    return record(cells, vertices)[0] if complete else None

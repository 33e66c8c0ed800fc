"""The method `global`: the certified optimum of the model with one rotation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from shapefit.arrays import Floats
from shapefit.convex.problem import Problem
from shapefit.convex.solution import Status
from shapefit.lifting.estimate import Estimate
from shapefit.lifting.global_optimum.optimum import GlobalOptimum, Limits, find_optimum
from shapefit.lifting.global_optimum.tree import Tree, record_tree
from shapefit.lifting.methods import AlternationOptions, SearchOptions, Settings
from shapefit.lifting.shared_rotation.methods import (
    alternate_from_mean,
    describe,
    refine_convex,
)


def find_global(problem: Problem, settings: Settings) -> Estimate:
    """Search all rotations, from the results of convex+refine and alternate on.

    So it is never above either of them. The iterations are cells; the gap is that to the bound.
    """
    options: SearchOptions = settings.options
    limits = Limits(options.max_cells, options.max_seconds)
    found = find_optimum(
        problem,
        find_starts(problem, settings),
        tolerance=settings.tolerance,
        limits=limits,
        threads=settings.threads,
    )
    estimate = describe(problem, found.coefficients, found.rotation, found.cells, found.status)
    estimate = replace(estimate, relative_gap=found.relative_gap)
    if options.proof_every:
        trees = record_trees(problem, found, options)
        estimate = replace(estimate, trees=trees)
    return estimate


def find_starts(problem: Problem, settings: Settings) -> Floats:
    """Rotations (n, 2, 3, 3) at which convex+refine and alternate end."""
    local = replace(settings, options=AlternationOptions())
    ends = [refine_convex(problem, local), alternate_from_mean(problem, local)]
    return np.stack([end.rotation for end in ends], axis=1)


def record_trees(
    problem: Problem, found: GlobalOptimum, options: SearchOptions
) -> tuple[Tree | None, ...]:
    """The tree of every so many images, those of which something is proved."""
    trees: list[Tree | None] = [None] * len(problem.lam)
    for image in range(0, len(trees), options.proof_every):
        if found.status[image] in (Status.OPTIMAL, Status.ITERATION_LIMIT):
            trees[image] = record_tree(
                problem,
                image,
                found.bound[image],
                most_cells=options.max_cells,
            )
    return tuple(trees)

"""A regularisation path: the program at falling lambdas, each solved from the one before it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from shapefit.convex.problem import Problem
from shapefit.convex.solution import Solution
from shapefit.convex.spectral_norm import spectral_norm
from shapefit.lifting.reconstruction import is_active

Floats = NDArray[np.float64]


class WarmSolve(Protocol):
    """A solver of the convex program that can start from a solution of the same images."""

    def __call__(self, problem: Problem, *, start: Solution | None = None) -> Solution:
        """Solve the problem."""


@dataclass(frozen=True)
class Path:
    """What becomes of n images along L lambdas, all (n, L).

    objective and relative_gap as certified; residual as in Solution; active_atoms as in
    Reconstruction.
    """

    lam: Floats
    objective: Floats
    relative_gap: Floats
    residual: Floats
    active_atoms: NDArray[np.int64]


def follow_path(problem: Problem, lambdas: Sequence[float], solve: WarmSolve) -> Path:
    """Solve `problem` at each of the lambdas, which fall, in place of its own."""
    n = len(problem.landmarks)
    solution = None
    solutions, active = [], []
    for lam in lambdas:
        solution = solve(replace(problem, lam=np.full(n, lam)), start=solution)
        solutions.append(replace(solution, transforms=np.empty(0), dual=np.empty(0)))
        active.append(is_active(spectral_norm(solution.transforms)).sum(axis=1))
    return Path(
        lam=np.tile(np.asarray(lambdas, dtype=float), (n, 1)),
        objective=np.stack([s.objective for s in solutions], axis=1),
        relative_gap=np.stack([s.relative_gap for s in solutions], axis=1),
        residual=np.stack([s.residual for s in solutions], axis=1),
        active_atoms=np.stack(active, axis=1),
    )

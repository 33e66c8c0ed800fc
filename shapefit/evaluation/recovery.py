"""Exact recovery: plant transforms, solve the noiseless program, see how often they come back."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from shapefit.arrays import Floats
from shapefit.convex.newton import solve_newton
from shapefit.convex.problem import Loss, build_problem
from shapefit.convex.solution import Status
from shapefit.evaluation.report import as_json, markdown_table, table_text
from shapefit.geometry.rotations import random_rotations


@dataclass(frozen=True)
class Instance:
    """W = sum_i M_i B_i without noise: landmarks W (2, p), atoms B (k, 3, p), M (k, 2, 3)."""

    landmarks: Floats
    atoms: Floats
    transforms: Floats


@dataclass(frozen=True)
class Attempt:
    """What the program made of one instance.

    error is ||M_found - M||_F / ||M||_F, nan where the solver failed; relative_gap, residual,
    iterations and status are the solver's (Solution).
    """

    error: float
    relative_gap: float
    residual: float
    iterations: int
    status: Status


def plant(k: int, p: int, z: int, rng: np.random.Generator) -> Instance:
    """Return a random instance with k atoms, p landmarks and z atoms in use.

    Entries of B_i are N(0, 1), rotations uniform, z coefficients at random places U(0, 1) and the
    others 0; M_i = c_i times the first two rows of R_i (paper, section Simulation).
    """
    B = rng.standard_normal((k, 3, p))
    R = random_rotations(k, rng)
    c = np.zeros(k)
    c[rng.choice(k, z, replace=False)] = rng.uniform(size=z)
    M = c[:, None, None] * R[:, :2]
    return Instance(np.einsum("iab,ibp->ap", M, B), B, M)


def recover(
    instance: Instance, *, free_translation: bool, tolerance: float, max_iterations: int
) -> Attempt:
    """Solve min sum_i ||M_i||_2 s.t. W = sum_i M_i B_i + T 1^T (paper, eq. finalnoiseless).

    T is free, which is the same as centring the rows of W and of all B_i, or 0. One thread.
    """
    W, B = instance.landmarks, instance.atoms
    if not free_translation:
        W, B = _with_fixed_origin(W, B)
    problem = build_problem(W, B, lam=1.0, loss=Loss.EXACT)
    found = solve_newton(problem, tolerance=tolerance, max_iterations=max_iterations, threads=1)
    M = instance.transforms
    return Attempt(
        error=float(np.linalg.norm(found.transforms.dense()[0] - M) / np.linalg.norm(M)),
        relative_gap=float(found.relative_gap[0]),
        residual=float(found.residual[0]),
        iterations=int(found.iterations[0]),
        status=found.status[0],
    )


def _with_fixed_origin(W: Floats, B: Floats) -> tuple[Floats, Floats]:
    """Add a landmark at the origin of every atom that is seen at the origin: W (2, p), B (k, 3, p).

    The solver always frees the translation. The constraint of this landmark is 0 = 0 + T; the
    others are then those of the program without a translation, and no landmark is lost to T.
    """
    k, _, _ = B.shape
    return np.hstack([W, np.zeros((2, 1))]), np.concatenate([B, np.zeros((k, 3, 1))], axis=2)


Place = tuple[int, int]
"""p and z of a cell."""


@dataclass(frozen=True)
class Cell:
    """Attempts on instances with p landmarks and z atoms in use.

    An attempt is a success where its error is below `success_below`, whatever its status.
    """

    p: int
    z: int
    attempts: tuple[Attempt, ...]
    success_below: float

    @property
    def success(self) -> float:
        """Share of successes."""
        return sum(map(self._is_success, self.attempts)) / len(self.attempts)

    @property
    def unsolved(self) -> tuple[int, ...]:
        """Indices of the attempts that are no success only because the solver did not finish."""
        return tuple(
            index
            for index, attempt in enumerate(self.attempts)
            if attempt.status is not Status.OPTIMAL and not self._is_success(attempt)
        )

    def _is_success(self, attempt: Attempt) -> bool:
        return attempt.error < self.success_below


@dataclass(frozen=True)
class RecoveryGrid:
    """All cells, row by row with the same number of attempts.

    `program` says in one sentence what was solved, `provenance` how (ready for JSON).
    """

    cells: tuple[Cell, ...]
    program: str
    provenance: Mapping[str, Any] = field(default_factory=dict)

    @cached_property
    def shares(self) -> dict[Place, float]:
        """Return the share of successes of every cell."""
        return {(cell.p, cell.z): cell.success for cell in self.cells}


def write_csv(path: Path, grid: RecoveryGrid) -> None:
    """Write recovery.csv, one row per cell; `success` is a share."""
    rows = ((c.p, c.z, len(c.attempts), c.success) for c in grid.cells)
    text = table_text(("p", "z", "trials", "success"), rows)
    path.write_text(text, encoding="utf-8")


def grid_json(grid: RecoveryGrid) -> str:
    """All numbers as JSON; null stands for a number that does not exist."""
    cells = [_cell(cell) for cell in grid.cells]
    return as_json({"program": grid.program, "cells": cells, **grid.provenance})


def _cell(cell: Cell) -> dict[str, Any]:
    iterations = [a.iterations for a in cell.attempts]
    errors, gaps, residuals = (
        [value for value in values if math.isfinite(value)]
        for values in (
            [a.error for a in cell.attempts],
            [abs(a.relative_gap) for a in cell.attempts],
            [a.residual for a in cell.attempts],
        )
    )
    return {
        "p": cell.p,
        "z": cell.z,
        "trials": len(cell.attempts),
        "success": cell.success,
        "unsolved": cell.unsolved,
        "median_error": float(np.median(errors)) if errors else None,
        "largest_relative_gap": max(gaps, default=None),
        "largest_residual": max(residuals, default=None),
        "median_iterations": float(np.median(iterations)),
        "largest_iterations": max(iterations),
    }


def markdown(grid: RecoveryGrid) -> str:
    """The shares as a table, landmarks down and atoms in use across."""
    trials, below = len(grid.cells[0].attempts), grid.cells[0].success_below
    parts = [
        "# Exact recovery",
        f"{grid.program} Share of {trials} random instances per cell whose "
        f"transforms are recovered with a relative error below {below:g}. Rows: p landmarks; "
        "columns: z atoms in use.",
        shares_table(grid.shares),
    ]
    unsolved = [f"p={c.p} z={c.z}: {len(c.unsolved)}" for c in grid.cells if c.unsolved]
    if unsolved:
        parts += ["## Not solved", "\n".join(f"- {line}" for line in unsolved)]
    return "\n\n".join(parts) + "\n"


def shares_table(shares: Mapping[Place, float], style: str = ".2f") -> str:
    """Return numbers of cells as a table; a cell without one is a dash."""
    down = sorted({p for p, _ in shares})
    across = sorted({z for _, z in shares})
    rows: Sequence[Sequence[str]] = [
        [str(p), *(format(shares[p, z], style) if (p, z) in shares else "–" for z in across)]
        for p in down
    ]
    return markdown_table(["p \\ z", *map(str, across)], rows)

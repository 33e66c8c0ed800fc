"""How often planted transforms come back, cell by cell: the numbers as CSV, JSON and Markdown."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from shapefit.convex.solution import Status
from shapefit.evaluation.experiments.recovery import Attempt
from shapefit.evaluation.tables.csv_table import write_table
from shapefit.evaluation.tables.markdown import markdown_table

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
    write_table(path, ("p", "z", "trials", "success"), rows)


def grid_json(grid: RecoveryGrid) -> str:
    """All numbers as JSON; null stands for a number that does not exist."""
    document = {
        "program": grid.program,
        "cells": [_cell(cell) for cell in grid.cells],
        **grid.provenance,
    }
    return json.dumps(document, indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def _cell(cell: Cell) -> dict[str, Any]:
    iterations = [a.iterations for a in cell.attempts]
    return {
        "p": cell.p,
        "z": cell.z,
        "trials": len(cell.attempts),
        "success": cell.success,
        "unsolved": cell.unsolved,
        "median_error": _median(a.error for a in cell.attempts),
        "largest_relative_gap": _largest(abs(a.relative_gap) for a in cell.attempts),
        "largest_residual": _largest(a.residual for a in cell.attempts),
        "median_iterations": float(np.median(iterations)),
        "largest_iterations": max(iterations),
    }


def _known(values: Iterable[float]) -> list[float]:
    return [value for value in values if math.isfinite(value)]


def _median(values: Iterable[float]) -> float | None:
    known = _known(values)
    return float(np.median(known)) if known else None


def _largest(values: Iterable[float]) -> float | None:
    return max(_known(values), default=None)


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

"""All readings of an image: the minima of the single-rotation model near its optimum."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shapefit import core
from shapefit.arrays import Floats
from shapefit.convex.problem import Problem
from shapefit.lifting.global_optimum.optimum import Limits
from shapefit.lifting.reconstruction import combine

APART = np.deg2rad(20.0)
"""Least angle between two modes."""

MOST = 32
"""Modes of one image that are listed."""


@dataclass(frozen=True)
class Modes:
    """The m modes of one image, best first.

    rotation R (m, 3, 3); objective (m,); shapes R sum_i c_i B_i (m, 3, p), in normalised units
    with the translation left out; complete: it is proved that there is no further one; valleys:
    how many rotations beside the modes their valleys reach, see docs/global.md.
    """

    rotation: Floats
    objective: Floats
    shapes: Floats
    complete: bool
    valleys: int

    def __len__(self) -> int:
        return len(self.objective)


def find_modes(
    problem: Problem,
    best: Floats,
    within: float,
    *,
    signed: bool = False,
    limits: Limits | None = None,
    threads: int = 0,
) -> tuple[Modes, ...]:
    """List the local minima of v(R) with v <= (1 + within) min v, pairwise more than APART apart.

    best (n, 3, 3) are the global optima; images where it is nan have no mode. Raises ValueError
    for a loss other than the squared one.
    """
    problem.require_squared("the search")
    limits = limits or Limits()
    known = np.asarray(np.isfinite(best).all(axis=(1, 2)))
    part = problem.take(known)
    n, k = len(part.lam), len(problem.atoms)
    rotation, objective = np.zeros((n, MOST, 3, 3)), np.zeros((n, MOST))
    count, valleys, cells, codes = (np.zeros(n, np.int64) for _ in range(4))
    core.find_modes(
        **part.arrays,
        is_signed=signed,
        best=np.ascontiguousarray(best[known]),
        within=within,
        apart=float(APART),
        most_cells=limits.cells,
        most_seconds=limits.seconds,
        rotation=rotation,
        objective=objective,
        count=count,
        valleys=valleys,
        cells=cells,
        status=codes,
        threads=threads,
    )
    listed = np.arange(MOST) < count[:, None]
    R, value = rotation[listed], objective[listed]
    c = np.zeros((len(R), k))
    core.find_coefficients(
        **part.take(np.repeat(np.arange(n), count)).arrays,
        is_signed=signed,
        rotation=R,
        coefficients=c,
        objective=value,
        threads=threads,
    )
    shapes = combine(c, problem.atoms, R)
    none = Modes(np.zeros((0, 3, 3)), np.zeros(0), shapes[:0], complete=False, valleys=0)
    found = [none] * len(known)
    ends = np.cumsum(count)
    for row, image in enumerate(np.flatnonzero(known).tolist()):
        mine = slice(ends[row] - count[row], ends[row])
        complete = bool(codes[row] == 0)
        found[image] = Modes(R[mine], value[mine], shapes[mine], complete, int(valleys[row]))
    return tuple(found)

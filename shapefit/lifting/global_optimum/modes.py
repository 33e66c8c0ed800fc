"""All readings of an image: the minima of the single-rotation model near its optimum."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from shapefit import core
from shapefit.convex.problem import Problem
from shapefit.lifting.global_optimum.optimum import Limits, as_arguments, check_loss
from shapefit.lifting.reconstruction import combine

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]
Flags = NDArray[np.bool_]

APART = np.deg2rad(20.0)
"""Least angle between two modes."""

MOST = 32
"""Modes of one image that are listed."""


@dataclass(frozen=True)
class Modes:
    """Modes of n images, one image after the other, each image's best one first.

    count (n,) of them, m in all; image (m,) that each belongs to; rotation R (m, 3, 3),
    coefficients c (m, k), objective (m,), shapes R sum_i c_i B_i (m, 3, p), in normalised units
    with mean 0; valleys (n,), see docs/global.md; complete (n,): it is proved that there is no
    further mode.
    """

    count: Indices
    rotation: Floats
    coefficients: Floats
    objective: Floats
    shapes: Floats
    valleys: Indices
    complete: Flags

    @property
    def image(self) -> Indices:
        """Image (m,) that each mode belongs to."""
        return np.repeat(np.arange(len(self.count)), self.count)


def find_modes(
    problem: Problem,
    best: Floats,
    within: float,
    *,
    signed: bool = False,
    limits: Limits | None = None,
    threads: int = 0,
) -> Modes:
    """List the local minima of v(R) with v <= (1 + within) min v, pairwise more than APART apart.

    best (n, 3, 3) are the global optima; images where it is nan have no mode. Raises ValueError
    for a loss other than the squared one.
    """
    check_loss(problem)
    limits = limits or Limits()
    n, k = len(problem.landmarks), len(problem.atoms)
    count, valleys, cells, codes = (np.zeros(n, np.int64) for _ in range(4))
    known = np.isfinite(best).all(axis=(1, 2))
    part = problem.take(known)
    rotation, objective = np.zeros((len(part.lam), MOST, 3, 3)), np.zeros((len(part.lam), MOST))
    found = [np.zeros(len(part.lam), np.int64) for _ in range(4)]
    core.find_modes(
        **as_arguments(part, signed=signed),
        best=np.ascontiguousarray(best[known]),
        within=within,
        apart=float(APART),
        most_cells=limits.cells,
        most_seconds=limits.seconds,
        rotation=rotation,
        objective=objective,
        count=found[0],
        valleys=found[1],
        cells=found[2],
        status=found[3],
        threads=threads,
    )
    for whole, values in zip((count, valleys, cells, codes), found, strict=True):
        whole[known] = values
    listed = np.arange(MOST) < found[0][:, None]
    image = np.repeat(np.flatnonzero(known), found[0])
    R = rotation[listed]
    c, value = np.zeros((len(R), k)), objective[listed]
    core.find_coefficients(
        **as_arguments(problem.take(image), signed=signed),
        rotation=R,
        coefficients=c,
        objective=value,
        threads=threads,
    )
    shapes = R @ combine(c, problem.atoms)
    return Modes(count, R, c, value, shapes, valleys, known & (codes == 0))

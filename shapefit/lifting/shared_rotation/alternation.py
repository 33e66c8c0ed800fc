"""Alternating minimisation of the model with one rotation shared by all atoms."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from shapefit import core
from shapefit.arrays import Floats
from shapefit.convex.problem import Problem
from shapefit.convex.solution import Status, read_statuses
from shapefit.lifting.methods import AlternationOptions


@dataclass(frozen=True)
class Alternation:
    """Local minima for n images: S = R sum_i c_i B_i.

    coefficients c (n, k); rotation R (n, 3, 3), nan where c = 0, for it is unknown then; rounds
    (n,), over all starts of an image; status, a Status per image.
    """

    coefficients: Floats
    rotation: Floats
    rounds: NDArray[np.int64]
    status: tuple[Status, ...]


def alternate(
    problem: Problem,
    starts: Floats,
    *,
    signed: bool = AlternationOptions.signed,
    tolerance: float = AlternationOptions.tolerance,
    max_rounds: int = AlternationOptions.max_rounds,
    threads: int = 0,
) -> Alternation:
    """min 1/2 ||Omega o (W - Rbar sum_i c_i B_i - T 1^T)||_F^2 + lambda ||c||_1, Rbar Rbar^T = I.

    (Paper, eq. originalnoisy, with weights and translation.) Each round minimises over c >= 0
    (any c where `signed`), exactly, and over T with it; then takes Rbar to a local minimum by
    trust region steps. Neither raises the objective. It stops when a round lowers it by at most
    `tolerance` of itself. starts (n, s, 3, 3) are the rotations to begin at: the best result of
    an image counts. Fewer than two visible landmarks are DEGENERATE.
    """
    problem.require_squared("alternation")
    n, k = len(problem.landmarks), len(problem.atoms)
    if starts.shape[1] == 0:
        raise ValueError("alternation needs starts")
    coefficients, rotation = np.zeros((n, k)), np.full((n, 3, 3), np.nan)
    rounds, codes = np.zeros(n, np.int64), np.zeros(n, np.int64)
    core.alternate(
        **problem.arrays,
        starts=np.ascontiguousarray(starts, dtype=np.float64),
        is_signed=signed,
        tolerance=tolerance,
        most_rounds=max_rounds,
        coefficients=coefficients,
        rotation=rotation,
        rounds=rounds,
        status=codes,
        threads=threads,
    )
    rotation[~coefficients.any(axis=1)] = np.nan
    status = read_statuses(codes)
    return Alternation(coefficients, rotation, rounds, status)

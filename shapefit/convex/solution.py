"""What a solver returns: one status, one certificate and one set of transforms per image."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats
from shapefit.convex.transforms import Transforms


class Status(Enum):
    """How the work on one image ended; the value is the word in files and reports.

    CONVERGED is the end of a method without a certificate: a local optimum, or transforms that
    have stopped changing.
    """

    OPTIMAL = "optimal"
    CONVERGED = "converged"
    ITERATION_LIMIT = "iteration limit"
    DEGENERATE = "degenerate input"
    NUMERICAL_FAILURE = "numerical failure"


def read_statuses(codes: NDArray[np.int64]) -> tuple[Status, ...]:
    """Return the statuses of the codes (n,) that kernels write: their order above."""
    return tuple(map(tuple(Status).__getitem__, codes.tolist()))


@dataclass(frozen=True)
class Solution:
    """Optimum of the convex program for n images.

    transforms M; translation T (n, 2); dual Y (n, 2, p), feasible up to scaling;
    errors E (n, 2, p), the sparse errors of a robust loss in the units of the landmarks, else
    zero; objective and relative_gap (n,), computed from scratch at the end; residual (n,),
    ||Omega o (W - sum M_i B_i - T 1^T)||_F / ||Omega o (W - mean)||_F; iterations (n,);
    status, a Status per image.
    """

    transforms: Transforms
    translation: Floats
    dual: Floats
    errors: Floats
    objective: Floats
    relative_gap: Floats
    residual: Floats
    iterations: NDArray[np.int64]
    status: tuple[Status, ...]

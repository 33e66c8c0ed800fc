"""The nearest transforms that share one rotation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shapefit import core
from shapefit.arrays import Floats


@dataclass(frozen=True)
class Synchronised:
    """M_i ~ c_i Rbar for n images: rotation (n, 3, 3), nan where all M_i are 0; c (n, k) >= 0."""

    rotation: Floats
    coefficients: Floats


def synchronise(M: Floats, *, threads: int = 0) -> Synchronised:
    """argmin sum_i ||M_i - c_i Rbar||_F^2 over c >= 0 and Rbar Rbar^T = I_2; M (n, k, 2, 3).

    The projection on the deformable Stiefel manifold. For a given Rbar c_i = max(0, <M_i, Rbar>)
    / 2, which leaves the maximum of sum_i max(0, <M_i, Rbar>)^2: a monotone iteration climbs from
    the polar factors of sum_i M_i and of the largest M_i, and the best of them counts. That
    need not be the global maximum, but is where the M_i share a rotation already.
    """
    M = np.ascontiguousarray(M, dtype=np.float64)
    rotation = np.full((len(M), 3, 3), np.nan)
    core.synchronise(transforms=M, rotation=rotation, threads=threads)
    inner = np.einsum("nkab,nab->nk", M, rotation[:, :2])
    known = np.isfinite(rotation).all(axis=(1, 2))
    return Synchronised(rotation, np.where(known[:, None], np.maximum(inner, 0.0) / 2, 0.0))

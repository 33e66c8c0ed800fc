"""The nearest transforms that share one rotation."""

from __future__ import annotations

import numpy as np

from shapefit import core
from shapefit.arrays import Floats
from shapefit.convex.transforms import Transforms


def synchronise(M: Transforms, *, threads: int = 0) -> Floats:
    """argmin_Rbar min_{c >= 0} sum_i ||M_i - c_i Rbar||_F^2 over Rbar Rbar^T = I_2, for n images.

    The rotations (n, 3, 3), nan where all M_i are 0: the projection on the deformable Stiefel
    manifold. For a given Rbar c_i = max(0, <M_i, Rbar>) / 2, which leaves the maximum of
    sum_i max(0, <M_i, Rbar>)^2: a monotone iteration climbs from the polar factors of sum_i M_i
    and of the largest M_i, and the best of them counts. That need not be the global maximum, but
    is where the M_i share a rotation already.
    """
    rotation = np.full((len(M.count), 3, 3), np.nan)
    core.synchronise(**M.arrays, rotation=rotation, threads=threads)
    return rotation

"""The pose of one known shape in each image: rotation and scale, the best of several starts."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from shapefit.convex.kernel import kernel
from shapefit.lifting.rotation_kernels import rotation_step

Floats = NDArray[np.float64]


@kernel
def pose_stretch(P: Floats, D: Floats, starts: Floats, rotations: Floats, sizes: Floats) -> None:
    """argmin 1/2 ||w - s Rbar S||_F^2 for P = S S^T (n, 3, 3) and D = w S^T (n, 2, 3).

    starts (n, v, 3, 3); rotations (n, 3, 3) and sizes s (n,) are written.
    """
    R = np.empty((3, 3))
    for image in range(P.shape[0]):
        least = np.inf
        for start in range(starts.shape[1]):
            R[:] = starts[image, start]
            value, s = rotation_step(P[image], D[image], True, R)
            if value < least:
                least = value
                sizes[image] = s
                rotations[image] = R

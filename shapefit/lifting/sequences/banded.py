"""Normal equations of a sequence: frames one after the other, each tied to the two before it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve_banded, cholesky_banded

Floats = NDArray[np.float64]

DIFFERENCE = (1.0, -2.0, 1.0)


def accelerations(y: Floats) -> Floats:
    """y_(t-1) - 2 y_t + y_(t+1): (t, d) -> (t - 2, d), none of fewer than three frames."""
    return y[2:] - 2 * y[1:-1] + y[:-2]


def spread_back(a: Floats, frames: int) -> Floats:
    """D^T a for the second difference D: (t - 2, d) -> (t, d)."""
    back = np.zeros((frames, a.shape[1]))
    if frames < 3:
        return back
    back[2:] += a
    back[1:-1] -= 2 * a
    back[:-2] += a
    return back


class Factor:
    """Cholesky factor of D^T diag(stiffness) D + blockdiag(blocks), (t d, t d).

    blocks (t, d, d), of which the lower triangle counts; stiffness (d,). Raises LinAlgError where
    the matrix is not positive definite.
    """

    def __init__(self, blocks: Floats, stiffness: Floats) -> None:
        frames, d, _ = blocks.shape
        bands = np.zeros((3 * d, frames, d))
        for below in range(d):
            bands[below, :, : d - below] = np.diagonal(blocks, -below, 1, 2)
        ends = DIFFERENCE if frames > 2 else ()
        for a, left in enumerate(ends):
            for b, right in enumerate(DIFFERENCE[: a + 1]):
                bands[(a - b) * d, b : b + frames - 2] += stiffness * (left * right)
        self._shape = (frames, d)
        self._factor = cholesky_banded(
            bands.reshape(3 * d, frames * d), lower=True, overwrite_ab=True, check_finite=False
        )

    @property
    def log_det(self) -> float:
        """Log determinant of the matrix."""
        return float(2 * np.log(self._factor[0]).sum())

    def solve(self, right: Floats) -> Floats:
        """Solve for right-hand sides (t, d, r)."""
        flat = right.reshape(self._shape[0] * self._shape[1], -1)
        found = cho_solve_banded((self._factor, True), flat, check_finite=False)
        solved: Floats = found.reshape(right.shape)
        return solved

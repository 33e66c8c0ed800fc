"""The error to expect of a shape as people measure it: after the best similarity onto the truth."""

from __future__ import annotations

import numpy as np

from shapefit.arrays import Flags, Floats

EXPECTED_ERROR = "expected_error"
"""Dataset (n,) in the unit of the shapes."""

CALIBRATED = 0.77
"""Error that was measured beside that which is expected: error bars are made to hold 90%, not to
have the mean of the errors. On film of six bodies (72 cells and bodies): single images 0.78, whole
sequences 0.75."""


def expected_error(shapes: Floats, covariance: Floats) -> Floats:
    """Calibrated E mean_j ||d_j|| of errors d ~ N(0, P C P), P without a similarity's directions.

    Translations, rotations and the scale move a shape S in seven directions e_a, omega x S and S of
    its 3p coordinates, which an alignment takes off; P projects onto what is left. Of a Gaussian
    with the covariance A, to second order,

        E ||d|| = sqrt(tr A) (1 - tr(A^2) / (4 tr(A)^2)).

    shapes (n, 3, p); covariance C (n, 3p, 3p), all x first, then y, then z; returns (n,), nan where
    either is not finite.
    """
    n, _, p = shapes.shape
    known: Flags = np.asarray(
        np.isfinite(shapes).all(axis=(1, 2)) & np.isfinite(covariance).all(axis=(1, 2))
    )
    S = np.where(known[:, None, None], shapes, np.eye(3, p))
    C = np.where(known[:, None, None], covariance, 0.0)
    x, y, z = (S - S.mean(axis=2, keepdims=True)).transpose(1, 0, 2)
    zero, one = np.zeros_like(x), np.ones_like(x)
    directions = np.array(
        [
            [one, zero, zero],
            [zero, one, zero],
            [zero, zero, one],
            [zero, -z, y],
            [z, zero, -x],
            [-y, x, zero],
            [x, y, z],
        ]
    )
    Q, _ = np.linalg.qr(directions.transpose(2, 1, 3, 0).reshape(n, 3 * p, 7))
    CQ = C @ Q
    middle = Q.swapaxes(1, 2) @ CQ
    q, cq = (M.reshape(n, 3, p, 7).transpose(0, 2, 1, 3) for M in (Q, CQ))
    A = C.reshape(n, 3, p, 3, p)[:, :, range(p), :, range(p)].transpose(1, 0, 2, 3)
    across = q @ cq.swapaxes(2, 3)
    A = A - across - across.swapaxes(2, 3) + q @ middle[:, None] @ q.swapaxes(2, 3)
    trace = np.maximum(np.trace(A, axis1=2, axis2=3), 0.0)
    some = trace > 0
    share = np.divide(A, trace[..., None, None], out=np.zeros_like(A), where=some[..., None, None])
    length = np.sqrt(trace) * (1 - (share**2).sum(axis=(2, 3)) / 4)
    return np.where(known, CALIBRATED * length.mean(axis=1), np.nan)

"""Kernels that eliminate the translation: p weighted landmarks -> q = p_visible - 1 coordinates.

The optimal T makes the weighted residual orthogonal to omega, so nothing is lost by turning the
space of landmarks until omega is the last axis (a Householder reflection h) and dropping that
axis; for the quadratic losses this is the same as centring with weights omega^2.
"""

from __future__ import annotations

import numpy as np

from shapefit.convex.kernel import kernel


@kernel
def find_visible(omega, visible, h):
    """Indices of positive weights, and the reflection I - h h^T that maps omega to the last axis.

    visible (p,) and h (p,) are written; returns the number of visible landmarks.
    """
    seen = 0
    square = 0.0
    for j in range(omega.shape[0]):
        if omega[j] > 0.0:
            visible[seen] = j
            h[seen] = omega[j]
            square += omega[j] * omega[j]
            seen += 1
    if seen == 0:
        return 0
    length = np.sqrt(square)
    for j in range(seen):
        h[j] /= length
    h[seen - 1] += 1.0
    scale = 1.0 / np.sqrt(h[seen - 1])  # |u + e|^2 = 2 (1 + u_last), so h h^T = 2 v v^T / v^T v
    for j in range(seen):
        h[j] *= scale
    return seen


@kernel
def reduce_rows(X, omega, visible, h, seen, out):
    """out = the first seen - 1 columns of (X Omega)(I - h h^T); X (r, p), out (r, seen - 1)."""
    for r in range(X.shape[0]):
        along = 0.0
        for j in range(seen):
            along += X[r, visible[j]] * omega[visible[j]] * h[j]
        for j in range(seen - 1):
            out[r, j] = X[r, visible[j]] * omega[visible[j]] - along * h[j]


@kernel
def expand_rows(y, visible, h, seen, out):
    """out = [y 0](I - h h^T) at the visible landmarks, 0 elsewhere: the dual of reduce_rows.

    y (r, seen - 1), out (r, p); every row of out is orthogonal to omega.
    """
    for r in range(y.shape[0]):
        along = 0.0
        for j in range(seen - 1):
            along += y[r, j] * h[j]
        for j in range(out.shape[1]):
            out[r, j] = 0.0
        for j in range(seen - 1):
            out[r, visible[j]] = y[r, j] - along * h[j]
        out[r, visible[seen - 1]] = -along * h[seen - 1]

"""Kernels for the Newton system (c I + F^T F + E) x = b with F of few or of many rows.

E is the curvature of the error terms: sum_am curvature_am f f^T, where f = e_m - h_m h is row m of
the reflection I - h h^T without its last column, placed in the half of axis a.
"""

from __future__ import annotations

import numpy as np

from shapefit.convex.kernel import kernel


@kernel
def _gram(F, rows, n, shift, H):
    """H = shift I + F^T F, upper triangle; F (rows, n), four rows a pass."""
    for i in range(n):
        Hi = H[i]
        for j in range(i, n):
            Hi[j] = 0.0
        Hi[i] = shift
    f = 0
    while f + 4 <= rows:
        f0, f1, f2, f3 = F[f], F[f + 1], F[f + 2], F[f + 3]
        for i in range(n):
            a0, a1, a2, a3 = f0[i], f1[i], f2[i], f3[i]
            Hi = H[i]
            for j in range(i, n):
                Hi[j] += a0 * f0[j] + a1 * f1[j] + a2 * f2[j] + a3 * f3[j]
        f += 4
    while f < rows:
        f0 = F[f]
        for i in range(n):
            a0 = f0[i]
            Hi = H[i]
            for j in range(i, n):
                Hi[j] += a0 * f0[j]
        f += 1


@kernel
def _outer_gram(F, rows, n, shift, H):
    """H = shift I + F F^T, upper triangle."""
    for i in range(rows):
        Fi, Hi = F[i], H[i]
        for j in range(i, rows):
            Fj = F[j]
            total = 0.0
            for column in range(n):
                total += Fi[column] * Fj[column]
            Hi[j] = total
        Hi[i] += shift


@kernel
def _solve_factored(H, n, x):
    """x <- H^-1 x by Cholesky, H (n, n) positive definite, upper triangle, overwritten.

    Right-looking and by rows, so that the inner loops run over contiguous memory. Pivots that
    rounding has made tiny or negative are lifted: the step stays a descent direction.
    """
    for j in range(n):
        Hj = H[j]
        pivot = 1.0 / np.sqrt(max(Hj[j], 1e-300))
        for column in range(j, n):
            Hj[column] *= pivot
        for i in range(j + 1, n):
            factor = Hj[i]
            Hi = H[i]
            least = 1e-14 * Hi[i]
            for column in range(i, n):
                Hi[column] -= factor * Hj[column]
            Hi[i] = max(Hi[i], least)
    for i in range(n):
        Hi = H[i]
        value = x[i] / Hi[i]
        x[i] = value
        for column in range(i + 1, n):
            x[column] -= value * Hi[column]
    for i in range(n - 1, -1, -1):
        Hi = H[i]
        value = x[i]
        for column in range(i + 1, n):
            value -= Hi[column] * x[column]
        x[i] = value / Hi[i]


@kernel
def _append_errors(F, rows, curvature, h):
    """Append sqrt(curvature_am) f where that is not zero; returns the new number of rows."""
    q = F.shape[1] // 2
    for a in range(2):
        for m in range(curvature.shape[1]):
            if curvature[a, m] > 0.0:
                root = np.sqrt(curvature[a, m])
                Fr = F[rows]
                for j in range(2 * q):
                    Fr[j] = 0.0
                for j in range(q):
                    Fr[a * q + j] = -root * h[m] * h[j]
                if m < q:
                    Fr[a * q + m] += root
                rows += 1
    return rows


@kernel
def _add_errors(curvature, h, H):
    """H += sum_am curvature_am f f^T, upper triangle: a diagonal and a term of rank two an axis."""
    q = H.shape[0] // 2
    for a in range(2):
        c, along = curvature[a], 0.0
        for m in range(q + 1):
            along += c[m] * h[m] * h[m]
        for i in range(q):
            Hi = H[a * q + i]
            Hi[a * q + i] += c[i]
            for j in range(i, q):
                Hi[a * q + j] += h[i] * h[j] * (along - c[i] - c[j])


@kernel
def newton_direction(F, rows, curvature, h, shift, by_rows, gradient, H, small, d):
    """d = -(shift I + F^T F + E)^-1 gradient; F (rows, n), gradient and d (n,).

    E is made of curvature (2, n / 2 + 1) >= 0 and h; curvature (2, 0) leaves it out. Where F has
    fewer rows than columns, with one more for each positive curvature, and `by_rows` says that the
    shift is not tiny beside F^T F, the inverse is taken in the space of rows (Woodbury). F has
    room for those rows; H (>= n, >= n) and small (>= n,) are workspace.
    """
    n = gradient.shape[0]
    errors = 0
    for a in range(2):
        for m in range(curvature.shape[1]):
            if curvature[a, m] > 0.0:
                errors += 1
    if by_rows and rows + errors < n:
        rows = _append_errors(F, rows, curvature, h)
        _outer_gram(F, rows, n, shift, H)
        for f in range(rows):
            total = 0.0
            Ff = F[f]
            for j in range(n):
                total += Ff[j] * gradient[j]
            small[f] = total
        _solve_factored(H, rows, small)
        for j in range(n):
            d[j] = -gradient[j] / shift
        for f in range(rows):
            factor = small[f] / shift
            Ff = F[f]
            for j in range(n):
                d[j] += factor * Ff[j]
        return
    _gram(F, rows, n, shift, H)
    if errors > 0:
        _add_errors(curvature, h, H)
    for j in range(n):
        d[j] = -gradient[j]
    _solve_factored(H, n, d)

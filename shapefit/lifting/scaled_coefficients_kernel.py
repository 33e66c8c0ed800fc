"""A strictly convex quadratic program in coefficients whose scale is fixed, by active sets."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from shapefit.convex.kernel import kernel

Floats = NDArray[np.float64]

SLACK = 1e-10  # by which a multiplier may have the wrong sign, beside the largest |h|


@kernel
def scaled_coefficients(Q: Floats, h: Floats, a: Floats, x: Floats) -> None:
    """Overwrite x with argmin 1/2 x^T Q x - h^T x over x >= 0, a^T x = 1.

    Q (k, k) positive definite, its upper triangle given; h (k,); a (k,) >= 0; x (k,) feasible. A
    primal active-set method: minimise over the used coefficients, drop the first that would change
    its sign, and use again the one whose multiplier is most wrong.
    """
    k = len(x)
    used, y, z = np.empty(k, np.int64), np.empty(k), np.empty(k)
    L = np.empty((k, k))
    largest = 0.0
    m = 0
    for i in range(k):
        largest = max(largest, abs(h[i]))
        if x[i] > 0.0:
            used[m] = i
            m += 1
    for _ in range(10 * k + 100):
        multiplier = _minimise_over(Q, h, a, used, m, L, y, z)
        length, blocking = 1.0, -1
        for e in range(m):
            if y[e] < 0.0:
                share = x[used[e]] / (x[used[e]] - y[e])
                if share < length:
                    length, blocking = share, e
        for e in range(m):
            x[used[e]] += length * (y[e] - x[used[e]])
        if blocking >= 0:
            x[used[blocking]] = 0.0
            m -= 1
            for e in range(blocking, m):
                used[e] = used[e + 1]
            continue
        best, wrong = -1, SLACK * largest
        for i in range(k):
            if x[i] == 0.0:
                slope = h[i] - multiplier * a[i]
                for e in range(m):
                    j = used[e]
                    slope -= (Q[i, j] if i < j else Q[j, i]) * x[j]
                if slope > wrong:
                    best, wrong = i, slope
        if best < 0:
            break
        used[m] = best
        m += 1


@kernel
def _minimise_over(
    Q: Floats, h: Floats, a: Floats, used: NDArray[np.int64], m: int, L: Floats, y: Floats,
    z: Floats,
) -> float:  # fmt: skip
    """Write argmin over the m used coefficients with a^T y = 1 to y, any sign; the multiplier."""
    for e in range(m):
        i = used[e]
        y[e], z[e] = h[i], a[i]
        for f in range(e + 1):
            j = used[f]
            value = Q[i, j] if i < j else Q[j, i]
            for b in range(f):
                value -= L[e, b] * L[f, b]
            L[e, f] = value / L[f, f] if f < e else np.sqrt(max(value, 1e-300))
        for f in range(e):
            y[e] -= L[e, f] * y[f]
            z[e] -= L[e, f] * z[f]
        y[e] /= L[e, e]
        z[e] /= L[e, e]
    for e in range(m - 1, -1, -1):
        for f in range(e + 1, m):
            y[e] -= L[f, e] * y[f]
            z[e] -= L[f, e] * z[f]
        y[e] /= L[e, e]
        z[e] /= L[e, e]
    total, unit = -1.0, 0.0
    for e in range(m):
        total += a[used[e]] * y[e]
        unit += a[used[e]] * z[e]
    multiplier = total / unit
    for e in range(m):
        y[e] -= multiplier * z[e]
    return multiplier

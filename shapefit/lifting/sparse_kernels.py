"""The coefficient step: the lasso over the projected atoms Rbar B_i, solved exactly.

An active set in the manner of Lawson and Hanson 1974, with signs as in Lee et al. 2007: minimise
over the used atoms, dropping each whose coefficient reaches 0, then use the atom of largest
correlation too. Atoms that depend on each other are exchanged until the rest are independent, so
at most 2 q are used.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from shapefit.convex.kernel import kernel

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]

SLACK = 1e-9  # by which the correlation of an unused atom may exceed lambda, as a share of it
DEPENDENT = 1e-11  # share of an atom's squared norm outside the span of the atoms before it


@kernel
def sparse_coefficients(
    w: Floats, atoms: Floats, planes: Floats, R: Floats, lam: float, signed: bool, c: Floats
) -> float:
    """argmin_c 1/2 ||w - sum_i c_i Rbar B_i||_F^2 + lam ||c||_1; returns the minimum.

    w (2, q), atoms (k, 3, q), planes (3, q, k) the same with the atoms innermost, R (3, 3),
    lam > 0, c (k,) the coefficients to begin at, overwritten; c >= 0 unless `signed`. At the end
    used atoms have correlation sign(c_i) lam with the residual, others at most lam (1 + SLACK).
    """
    k, _, q = atoms.shape
    room = min(k, 2 * q + 1)
    used, x, sign, b = np.empty(room, np.int64), np.empty(room), np.empty(room), np.empty(room)
    V, L, goal = np.empty((room, 2 * q)), np.empty((room, room)), np.empty(room)
    target, residual, correlation = w.copy().reshape(-1), np.empty(2 * q), np.empty(k)
    m = 0
    for i in range(k):
        if c[i] != 0.0:
            used[m], x[m], sign[m] = i, c[i], np.sign(c[i])
            b[m] = _project_atom(atoms[i], R, target, V[m])
            m += 1
    factored, fresh = 0, False
    for _ in range(10 * k + 100):
        settled = False
        while m > 0:
            row = _factorise(V, L, factored, m)
            factored = m
            if row < m:
                dropped, length = _exchange(L, row, sign, x, goal)
            else:
                dropped, length = _improve(L, m, b, lam, sign, x, goal)
            if dropped < 0:
                break
            # The newest atom leaves at once: its correlation exceeds lambda by rounding only.
            settled = fresh and dropped == m - 1 and length == 0.0
            _remove(dropped, m, used, x, sign, b, V)
            m -= 1
            factored = dropped
            if settled:
                break
        best, largest = _correlate(target, V, x, used, m, planes, R, signed, residual, correlation)
        if settled or m == room or largest <= lam * (1.0 + SLACK):
            break
        used[m], x[m], sign[m] = best, 0.0, np.sign(correlation[best])
        b[m] = _project_atom(atoms[best], R, target, V[m])
        m += 1
        fresh = True
    c[:] = 0.0
    objective = 0.0
    for e in range(m):
        c[used[e]] = x[e]
        objective += lam * abs(x[e])
    for j in range(2 * q):
        objective += 0.5 * residual[j] ** 2
    return objective


@kernel
def _project_atom(B: Floats, R: Floats, target: Floats, out: Floats) -> float:
    """Write Rbar B to out (2 q,), row after row; returns <Rbar B, target>. B (3, q)."""
    q = B.shape[1]
    inner = 0.0
    for a in range(2):
        for j in range(q):
            value = R[a, 0] * B[0, j] + R[a, 1] * B[1, j] + R[a, 2] * B[2, j]
            out[a * q + j] = value
            inner += value * target[a * q + j]
    return inner


@kernel
def _factorise(V: Floats, L: Floats, first: int, m: int) -> int:
    """L L^T = V V^T from row `first` on; returns the first row that depends on those before it.

    That row is written but for its pivot. Returns m where no row depends on others.
    """
    for e in range(first, m):
        square = 0.0
        for j in range(V.shape[1]):
            square += V[e, j] * V[e, j]
        rest = square
        for f in range(e):
            value = 0.0
            for j in range(V.shape[1]):
                value += V[e, j] * V[f, j]
            for g in range(f):
                value -= L[e, g] * L[f, g]
            L[e, f] = value / L[f, f]
            rest -= L[e, f] ** 2
        if rest <= DEPENDENT * square:
            return e
        L[e, e] = np.sqrt(rest)
    return m


@kernel
def _improve(
    L: Floats, m: int, b: Floats, lam: float, sign: Floats, x: Floats, goal: Floats
) -> tuple[int, float]:
    """Go from x towards the minimum for these signs, up to the first that would change.

    Returns which coefficient reached 0, or -1, and the share of the way that was gone.
    """
    for e in range(m):
        goal[e] = b[e] - lam * sign[e]
        for f in range(e):
            goal[e] -= L[e, f] * goal[f]
        goal[e] /= L[e, e]
    _solve_transposed(L, m, goal)
    dropped, length = -1, 1.0
    for e in range(m):
        if goal[e] * sign[e] < 0.0:
            share = x[e] / (x[e] - goal[e])
            if share < length:
                dropped, length = e, share
    for e in range(m):
        x[e] += length * (goal[e] - x[e])
    return dropped, length


@kernel
def _exchange(L: Floats, last: int, sign: Floats, x: Floats, d: Floats) -> tuple[int, float]:
    """Go along sum_e d_e V_e = 0, which does not raise ||x||_1, until a coefficient reaches 0.

    Row `last` depends on the rows before it. Returns which coefficient it was, and the length.
    """
    for e in range(last):
        d[e] = -L[last, e]
    _solve_transposed(L, last, d)
    d[last] = 1.0
    slope = 0.0
    for e in range(last + 1):
        slope += sign[e] * d[e]
    if slope > 0.0:
        for e in range(last + 1):
            d[e] = -d[e]
    dropped, length = last, np.inf
    for e in range(last + 1):
        if sign[e] * d[e] < 0.0 and -x[e] / d[e] < length:
            dropped, length = e, -x[e] / d[e]
    for e in range(last + 1):
        x[e] += length * d[e]
    return dropped, length


@kernel
def _remove(at: int, m: int, used: Indices, x: Floats, sign: Floats, b: Floats, V: Floats) -> None:
    """Close the gap that entry `at` leaves in the lists of m used atoms."""
    for e in range(at, m - 1):
        used[e], x[e], sign[e], b[e] = used[e + 1], x[e + 1], sign[e + 1], b[e + 1]
        V[e] = V[e + 1]


@kernel
def _solve_transposed(L: Floats, m: int, x: Floats) -> None:
    """Solve L^T x = x in place."""
    for e in range(m - 1, -1, -1):
        for f in range(e + 1, m):
            x[e] -= L[f, e] * x[f]
        x[e] /= L[e, e]


@kernel
def _correlate(
    target: Floats, V: Floats, x: Floats, used: Indices, m: int, planes: Floats, R: Floats,
    signed: bool, residual: Floats, correlation: Floats,
) -> tuple[int, float]:  # fmt: skip
    """Write the residual (2 q,) and its <Rbar B_i, residual> (k,); returns index and largest.

    The largest by magnitude where `signed`; used atoms do not count, their correlation is set 0.
    """
    q, k = planes.shape[1], planes.shape[2]
    residual[:] = target
    for e in range(m):
        for j in range(2 * q):
            residual[j] -= x[e] * V[e, j]
    correlation[:] = 0.0
    for j in range(q):
        u, v = residual[j], residual[q + j]
        y0 = R[0, 0] * u + R[1, 0] * v
        y1 = R[0, 1] * u + R[1, 1] * v
        y2 = R[0, 2] * u + R[1, 2] * v
        p0, p1, p2 = planes[0, j], planes[1, j], planes[2, j]
        for i in range(k):
            correlation[i] += y0 * p0[i] + y1 * p1[i] + y2 * p2[i]
    for e in range(m):
        correlation[used[e]] = 0.0
    best, largest = 0, -np.inf
    for i in range(k):
        value = abs(correlation[i]) if signed else correlation[i]
        if value > largest:
            best, largest = i, value
    return best, largest

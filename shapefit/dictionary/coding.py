"""Non-negative sparse coding: shapes as cheap non-negative mixtures of fixed atoms.

min_c 1/2 ||S - sum_i c_i B_i||_F^2 + beta sum_i c_i  over c >= 0, for each shape S by itself
(paper, eq. dl with the atoms fixed).
"""

from __future__ import annotations

import warnings
from math import prod

import numpy as np
from numpy.typing import NDArray

from shapefit.convex.kernel import kernel

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]

MAX_STEPS = 10_000
DEPENDENT = 1e-12  # share of an atom's squared norm outside the span of the atoms before it


def sparse_code(
    shapes: Floats,
    atoms: Floats,
    beta: float,
    start: Floats | None = None,
    tolerance: float = 1e-10,
) -> Floats:
    """argmin_C sum_j 1/2 ||S_j - sum_i C_ji B_i||_F^2 + beta sum_i C_ji  over C >= 0.

    shapes (n, 3, p), atoms (k, 3, p), start (n, k) >= 0 the coefficients to begin at (default
    0); returns C (n, k). Never worse than the start. Each shape stops when no change of a single
    coefficient would still move it by more than `tolerance` of its norm.

    An active set method (Lawson and Hanson 1974, with the l1 term): minimise over the
    coefficients in use, dropping those that reach 0, then take the one coordinate descent step
    that moves the shape most. Atoms in use that depend on each other are exchanged until the
    rest are independent, so at most 3p coefficients are positive. `duality_gaps` certifies the
    result. Warns (RuntimeWarning) where a shape had not stopped after MAX_STEPS steps.
    """
    X, B = _flat(shapes), _flat(atoms)
    C = np.zeros((len(X), len(B))) if start is None else np.array(start, dtype=np.float64)
    if C.shape != (len(X), len(B)) or (C < 0).any():
        raise ValueError(f"start must be {(len(X), len(B))} and >= 0, is {C.shape}")
    smallest_move = tolerance * np.linalg.norm(X, axis=1)
    unsettled = _code_shapes(B @ B.T, beta - X @ B.T, smallest_move, C)
    if unsettled:
        warnings.warn(
            f"{unsettled} of {len(C)} shapes were not coded to the tolerance",
            RuntimeWarning,
            stacklevel=2,
        )
    return C


def objectives(shapes: Floats, atoms: Floats, beta: float, coefficients: Floats) -> Floats:
    """1/2 ||S_j - sum_i C_ji B_i||_F^2 + beta sum_i C_ji for each shape; (n,)."""
    residual = _flat(shapes) - coefficients @ _flat(atoms)
    return 0.5 * (residual**2).sum(axis=1) + beta * coefficients.sum(axis=1)


def duality_gaps(shapes: Floats, atoms: Floats, beta: float, coefficients: Floats) -> Floats:
    """objective - D(t R) >= objective - optimum for each shape; (n,), for beta > 0.

    The dual is max D(Y) = <Y, S> - 1/2 ||Y||^2 subject to <B_i, Y> <= beta. Y = t R with the
    residual R and the best t >= 0 that is feasible. Source: as for the lasso, e.g. Massias et al.
    2018 (celer); a negative <B_i, Y> is free because c >= 0.
    """
    X, B = _flat(shapes), _flat(atoms)
    R = X - coefficients @ B
    correlation = (R * X).sum(axis=1)
    energy = (R**2).sum(axis=1)
    highest = (R @ B.T).max(axis=1)
    free = np.divide(correlation, energy, out=np.zeros_like(energy), where=energy > 0)
    feasible = np.divide(beta, highest, out=np.full_like(energy, np.inf), where=highest > 0)
    t = np.clip(free, 0.0, feasible)
    dual = t * correlation - 0.5 * t**2 * energy
    return 0.5 * energy + beta * coefficients.sum(axis=1) - dual


def _flat(shapes: Floats) -> Floats:
    return np.ascontiguousarray(shapes, dtype=np.float64).reshape(
        len(shapes), prod(shapes.shape[1:])
    )


@kernel
def _code_shapes(G: Floats, slopes: Floats, smallest_move: Floats, C: Floats) -> int:
    """Code every shape in place; returns how many reached MAX_STEPS.

    G = B B^T (k, k); slopes = beta - S B^T (n, k), the gradient at c = 0; C (n, k).
    """
    n, k = C.shape
    used = np.empty(k, np.int64)
    L = np.empty((k, k))
    step = np.empty(k)
    unsettled = 0
    for j in range(n):
        c = C[j]
        g = slopes[j].copy()  # gradient at c, kept up to date
        for i in range(k):
            if c[i] > 0.0:
                g += c[i] * G[i]
        moved = True
        steps = 0
        while moved and steps < MAX_STEPS:
            while _minimise_over_used(G, g, c, used, L, step):
                pass
            moved = _best_coordinate_step(G, g, c, smallest_move[j])
            steps += 1
        unsettled += moved
    return unsettled


@kernel
def _best_coordinate_step(G: Floats, g: Floats, c: Floats, smallest_move: float) -> bool:
    """Take the coordinate descent step that moves the shape most; False if all are too small."""
    best = -1
    longest = smallest_move
    for i in range(len(c)):
        if G[i, i] > 0.0:
            move = abs(max(-g[i] / G[i, i], -c[i])) * np.sqrt(G[i, i])
            if move > longest:
                longest = move
                best = i
    if best < 0:
        return False
    step = max(-g[best] / G[best, best], -c[best])
    c[best] += step
    g += step * G[best]
    return True


@kernel
def _minimise_over_used(
    G: Floats, g: Floats, c: Floats, used: Indices, L: Floats, step: Floats
) -> bool:
    """Go towards the minimum over the positive coefficients, up to the first that reaches 0.

    Returns whether one did: it is 0 now, and the minimum over the others is still to be found.
    used, L and step are room to work in.
    """
    m, dependent = _factorise_used(G, c, used, L)
    if dependent:
        _exchange_direction(g, used, L, m, step)
        length = np.inf
    else:
        _newton_step(g, used, L, m, step)
        length = 1.0
    first = -1
    for q in range(m):
        if c[used[q]] + length * step[q] < 0.0:
            length = -c[used[q]] / step[q]
            first = used[q]
    for q in range(m):
        i = used[q]
        c[i] = max(c[i] + length * step[q], 0.0)
        g += length * step[q] * G[i]
    if first < 0:
        return False
    c[first] = 0.0
    return True


@kernel
def _newton_step(g: Floats, used: Indices, L: Floats, m: int, step: Floats) -> None:
    """Solve L L^T step = -g over the atoms in use."""
    for q in range(m):
        step[q] = -g[used[q]]
        for r in range(q):
            step[q] -= L[q, r] * step[r]
        step[q] /= L[q, q]
    _solve_transposed(L, step, m)


@kernel
def _exchange_direction(g: Floats, used: Indices, L: Floats, m: int, step: Floats) -> None:
    """Find a change of coefficients that leaves the mixture and does not raise the objective.

    The last of the m atoms depends on those before it: sum_q step_q B_q = 0 with step < 0 for
    itself. Some step is negative in the direction chosen, so some coefficient reaches 0.
    """
    last = m - 1
    step[:last] = L[last, :last]
    _solve_transposed(L, step, last)
    step[last] = -1.0
    slope = 0.0
    for q in range(m):
        slope += step[q] * g[used[q]]
    if slope > 0.0 and step[:m].max() > 0.0:
        step[:m] *= -1.0


@kernel
def _solve_transposed(L: Floats, x: Floats, m: int) -> None:
    """Solve L[:m, :m]^T x = x in place."""
    for q in range(m - 1, -1, -1):
        for r in range(q + 1, m):
            x[q] -= L[r, q] * x[r]
        x[q] /= L[q, q]


@kernel
def _factorise_used(G: Floats, c: Floats, used: Indices, L: Floats) -> tuple[int, bool]:
    """L L^T = G over the atoms with c > 0, listed in used; returns how many they are.

    Ends at the first atom that depends on those before it, the last in used then, and says so.
    """
    m = 0
    for i in range(len(c)):
        if c[i] > 0.0:
            rest = G[i, i]
            for q in range(m):
                L[m, q] = G[i, used[q]]
                for r in range(q):
                    L[m, q] -= L[m, r] * L[q, r]
                L[m, q] /= L[q, q]
                rest -= L[m, q] ** 2
            used[m] = i
            m += 1
            if rest <= DEPENDENT * G[i, i]:
                return m, True
            L[m - 1, m - 1] = np.sqrt(rest)
    return m, False

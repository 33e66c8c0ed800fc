"""Projected Matching Pursuit on one image after another.

The chosen shapes are kept orthonormal in the inner product of their limb vectors (those of the
mean first), so that the sum of squared limb lengths of sum_i y_i Q_i is ||y||^2. All that the
inner loop needs of the reduced landmarks w (2, q) and shapes Q_i (3, q) are the small products
Q_i Q_j^T and w Q_i^T.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from shapefit.convex.kernel import kernel
from shapefit.convex.reduction_kernels import find_visible, reduce_rows
from shapefit.lifting.sphere_kernel import minimise_on_sphere

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]

CONVERGED, LIMIT, DEGENERATE, FAILED = 0, 1, 2, 3
INDEPENDENT = 1e-8  # share of an atom's squared limb lengths that the chosen ones lack
FLAT = 1e-12  # eigenvalue of S S^T beside the largest, below which the shape has no extent


@kernel
def pursue_stretch(
    W: Floats, Omega: Floats, shapes: Floats, limbs: Floats, length: float,
    goal: float, change: float, most_atoms: int, most_rounds: int,
    C: Floats, cameras: Floats, errors: Floats, rounds: Indices, status: Indices,
) -> None:  # fmt: skip
    """Pursue images W (n, 2, p) with weights Omega (n, p) over shapes (1 + k, 3, p), mean first.

    limbs (1 + k, l) are the limb vectors of the shapes; `length` is the root of the sum of
    squares that the chosen mixture keeps. Everything after `most_rounds` is written: C (n, 1 + k),
    cameras M (n, 2, 3), errors ||w - M S||^2 (n,), rounds of all inner loops and status (n,).
    """
    n, p = W.shape[0], W.shape[2]
    visible, h = np.zeros(p, np.int64), np.zeros(p)
    seen, w, reduced = 0, np.empty((2, 0)), np.empty((shapes.shape[0], 3, 0))
    for image in range(n):
        if image == 0 or np.any(Omega[image] != Omega[image - 1]):
            seen = find_visible(Omega[image], visible, h)
            q = max(seen - 1, 0)
            w, reduced = np.empty((2, q)), np.empty((shapes.shape[0], 3, q))
            for i in range(shapes.shape[0]):
                reduce_rows(shapes[i], Omega[image], visible, h, seen, reduced[i])
        if seen < 2:
            status[image] = DEGENERATE
            continue
        reduce_rows(W[image], Omega[image], visible, h, seen, w)
        if not inner(w, w) + inner(reduced[0], reduced[0]) < np.inf:
            status[image] = FAILED
            continue
        errors[image], rounds[image] = pursue_image(
            w, reduced, limbs, length, goal, change, most_atoms, most_rounds,
            C[image], cameras[image],
        )  # fmt: skip
        status[image] = CONVERGED if errors[image] <= goal else LIMIT


@kernel
def pursue_image(
    w: Floats, shapes: Floats, limbs: Floats, length: float,
    goal: float, change: float, most_atoms: int, most_rounds: int, c: Floats, M: Floats,
) -> tuple[float, int]:  # fmt: skip
    """Add atoms until ||w - M S||^2 <= goal; returns it and the number of inner rounds.

    w (2, q), shapes (1 + k, 3, q), limbs (1 + k, l). c (1 + k,) and M (2, 3) are written.
    """
    most = most_atoms + 1
    free = np.ones(shapes.shape[0], np.bool_)
    Q, U = np.empty((most, 3, shapes.shape[2])), np.empty((most, limbs.shape[1]))
    T = np.zeros((most, shapes.shape[0]))  # Q_i = sum_j T_ij shapes_j
    N, Z = np.empty((most, most, 3, 3)), np.empty((most, 2, 3))
    y = np.zeros(most)
    energy = inner(w, w)
    choose_shape(0, 0, w, shapes, limbs, free, Q, U, T, N, Z)
    y[0] = length
    error = aim_camera(1, y, N, Z, energy, M)
    chosen, rounds = 1, 0
    while error > goal and chosen < most:
        if not choose_atom(chosen, w, M, y, shapes, limbs, free, Q, U, T, N, Z):
            break
        chosen += 1
        for _ in range(most_rounds):
            before = error
            mix_shapes(chosen, M, N, Z, length, y)
            error = aim_camera(chosen, y, N, Z, energy, M)
            rounds += 1
            if abs(before - error) < change:
                break
    c[:] = y @ T
    return error, rounds


@kernel
def choose_atom(
    m: int, w: Floats, M: Floats, y: Floats, shapes: Floats, limbs: Floats, free: NDArray[np.bool_],
    Q: Floats, U: Floats, T: Floats, N: Floats, Z: Floats,
) -> bool:  # fmt: skip
    """Choose as the m-th the free atom with the largest |<w - M S, M B_i>|; False if none is.

    Atoms whose limbs depend on those of the chosen ones are passed over.
    """
    q = w.shape[1]
    S, back = np.zeros((3, q)), np.zeros((3, q))  # the shape, and M^T (w - M S)
    for i in range(m):
        add(y[i], Q[i], S)
    for j in range(q):
        for a in range(2):
            residual = w[a, j]
            for b in range(3):
                residual -= M[a, b] * S[b, j]
            for b in range(3):
                back[b, j] += M[a, b] * residual
    correlation = np.full(shapes.shape[0], -1.0)
    for i in range(shapes.shape[0]):
        if free[i]:
            correlation[i] = abs(inner(back, shapes[i]))
    while True:
        best = int(np.argmax(correlation))
        if correlation[best] < 0.0:
            return False
        if choose_shape(best, m, w, shapes, limbs, free, Q, U, T, N, Z):
            return True
        correlation[best] = -1.0


@kernel
def choose_shape(
    new: int, m: int, w: Floats, shapes: Floats, limbs: Floats, free: NDArray[np.bool_],
    Q: Floats, U: Floats, T: Floats, N: Floats, Z: Floats,
) -> bool:  # fmt: skip
    """Append shape `new` to the m chosen ones, orthonormal to them in its limb vectors.

    It is free no longer. Q, the limb vectors U (m, l) of Q, T, N_ij = Q_i Q_j^T and Z_i = w Q_i^T
    grow by one, unless its limbs depend on those of the others: then it returns False.
    """
    free[new] = False
    U[m] = limbs[new]
    Q[m] = shapes[new]
    T[m] = 0.0
    T[m, new] = 1.0
    for _ in range(2):  # twice is enough for orthogonality to rounding
        for i in range(m):
            along = np.dot(U[i], U[m])
            U[m] -= along * U[i]
            T[m] -= along * T[i]
            add(-along, Q[i], Q[m])
    rest = np.dot(U[m], U[m])
    if not rest > INDEPENDENT * np.dot(limbs[new], limbs[new]):
        return False
    scale = 1.0 / np.sqrt(rest)
    U[m] *= scale
    T[m] *= scale
    Q[m] *= scale
    multiply(w, Q[m], Z[m])
    for i in range(m + 1):
        multiply(Q[m], Q[i], N[m, i])
        multiply(Q[i], Q[m], N[i, m])
    return True


@kernel
def mix_shapes(m: int, M: Floats, N: Floats, Z: Floats, length: float, y: Floats) -> None:
    """y = argmin ||w - sum_i y_i M Q_i||^2 over ||y|| = length, of the m chosen shapes.

    y is where it was before, and 0 beyond the first m.
    """
    P = np.zeros((3, 3))
    for a in range(3):
        for b in range(3):
            P[a, b] = M[0, a] * M[0, b] + M[1, a] * M[1, b]
    G, g = np.empty((m, m)), np.empty(m)
    for i in range(m):
        g[i] = inner(M, Z[i])
        for j in range(i + 1):
            G[i, j] = inner(P, N[i, j])
            G[j, i] = G[i, j]
    minimise_on_sphere(G, g, length, y[:m])


@kernel
def aim_camera(m: int, y: Floats, N: Floats, Z: Floats, energy: float, M: Floats) -> float:
    """M = argmin ||w - M S||^2 for S = sum_i y_i Q_i, of least norm; returns the minimum.

    y holds m coefficients; energy = ||w||^2.
    """
    SS, D = np.zeros((3, 3)), np.zeros((2, 3))  # S S^T and w S^T
    for i in range(m):
        add(y[i], Z[i], D)
        for j in range(m):
            add(y[i] * y[j], N[i, j], SS)
    extent, axes = np.linalg.eigh(SS)
    M[:] = 0.0
    explained = 0.0
    for e in range(3):
        if extent[e] > FLAT * extent[2]:
            for a in range(2):
                along = D[a, 0] * axes[0, e] + D[a, 1] * axes[1, e] + D[a, 2] * axes[2, e]
                explained += along * along / extent[e]
                for b in range(3):
                    M[a, b] += along / extent[e] * axes[b, e]
    return max(energy - explained, 0.0)


@kernel
def inner(A: Floats, B: Floats) -> float:
    """<A, B>."""
    total = 0.0
    for a in range(A.shape[0]):
        for b in range(A.shape[1]):
            total += A[a, b] * B[a, b]
    return total


@kernel
def add(factor: float, A: Floats, total: Floats) -> None:
    """Total += factor A."""
    for a in range(A.shape[0]):
        for b in range(A.shape[1]):
            total[a, b] += factor * A[a, b]


@kernel
def multiply(A: Floats, B: Floats, out: Floats) -> None:
    """Out = A B^T."""
    for a in range(A.shape[0]):
        for b in range(B.shape[0]):
            total = 0.0
            for j in range(A.shape[1]):
                total += A[a, j] * B[b, j]
            out[a, b] = total

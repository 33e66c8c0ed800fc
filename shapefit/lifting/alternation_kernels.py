"""Alternation on one image after another, from one start or several."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from shapefit.convex.kernel import kernel
from shapefit.convex.reduction_kernels import find_visible, reduce_rows
from shapefit.lifting.rotation_kernels import rotation_step
from shapefit.lifting.sparse_kernels import sparse_coefficients

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]

CONVERGED, LIMIT, DEGENERATE, FAILED = 0, 1, 2, 3


@kernel
def alternate_stretch(
    W: Floats, Omega: Floats, B: Floats, lam: Floats, starts: Floats, signed: bool,
    tolerance: float, most: int, C: Floats, rotations: Floats, rounds: Indices, status: Indices,
) -> None:  # fmt: skip
    """Alternate on images (n, 2, p) from starts (n, s, 3, 3), keeping the best of each image.

    Everything after `most`, the largest number of rounds, is written; rounds (n,) adds up those
    of all starts.
    """
    n, k, p = W.shape[0], B.shape[0], B.shape[2]
    visible, h = np.zeros(p, np.int64), np.zeros(p)
    R, c, trace = np.empty((3, 3)), np.empty(k), np.empty(2 * most)
    seen, w = 0, np.empty((2, 0))
    atoms, planes = np.empty((k, 3, 0)), np.empty((3, 0, k))
    for image in range(n):
        if image == 0 or np.any(Omega[image] != Omega[image - 1]):
            seen = find_visible(Omega[image], visible, h)
            q = max(seen - 1, 0)
            w, atoms = np.empty((2, q)), np.empty((k, 3, q))
            for i in range(k):
                reduce_rows(B[i], Omega[image], visible, h, seen, atoms[i])
            planes = np.ascontiguousarray(atoms.transpose(1, 2, 0))
        if seen < 2:
            status[image] = DEGENERATE
            continue
        reduce_rows(W[image], Omega[image], visible, h, seen, w)
        least = np.inf
        status[image] = FAILED
        for start in range(starts.shape[1]):
            R[:] = starts[image, start]
            steps, converged = alternate_image(
                w, atoms, planes, lam[image], signed, tolerance, R, c, trace
            )
            rounds[image] += steps // 2
            if trace[steps - 1] < least:
                least = trace[steps - 1]
                C[image] = c
                rotations[image] = R
                status[image] = CONVERGED if converged else LIMIT


@kernel
def alternate_image(
    w: Floats, atoms: Floats, planes: Floats, lam: float, signed: bool, tolerance: float,
    R: Floats, c: Floats, trace: Floats,
) -> tuple[int, bool]:  # fmt: skip
    """Alternate from R (3, 3) until a round lowers the objective by a share <= tolerance.

    w (2, q), atoms (k, 3, q), planes (3, q, k) the same with the atoms innermost. A round is a
    step of the coefficients and one of the rotation. R and c (k,) are overwritten, c is not read;
    trace (2 rounds,) receives the objective after each step. Returns the number of steps taken
    and whether it converged.
    """
    P, D, shape = np.empty((3, 3)), np.empty((2, 3)), np.empty(atoms.shape[1:])
    energy = 0.0
    for j in range(w.shape[1]):
        energy += 0.5 * (w[0, j] ** 2 + w[1, j] ** 2)
    c[:] = 0.0
    for step in range(0, trace.shape[0], 2):
        trace[step] = sparse_coefficients(w, atoms, planes, R, lam, signed, c)
        penalty = _mix_atoms(atoms, c, shape)
        trace[step + 1] = trace[step]
        if penalty > 0.0:
            _find_moments(w, shape, P, D)
            fall, _ = rotation_step(P, D, False, R)
            trace[step + 1] = energy + fall + lam * penalty
        if step > 0 and trace[step - 1] - trace[step + 1] <= tolerance * trace[step - 1]:
            return step + 2, True
    return trace.shape[0], False


@kernel
def _mix_atoms(atoms: Floats, c: Floats, shape: Floats) -> float:
    """Shape = sum_i c_i B_i; returns ||c||_1."""
    penalty = 0.0
    shape[:] = 0.0
    for i in range(c.shape[0]):
        if c[i] != 0.0:
            penalty += abs(c[i])
            for b in range(3):
                for j in range(shape.shape[1]):
                    shape[b, j] += c[i] * atoms[i, b, j]
    return penalty


@kernel
def _find_moments(w: Floats, shape: Floats, P: Floats, D: Floats) -> None:
    """P = S S^T and D = w S^T."""
    for a in range(3):
        for b in range(a, 3):
            total = 0.0
            for j in range(shape.shape[1]):
                total += shape[a, j] * shape[b, j]
            P[a, b] = total
            P[b, a] = total
        for b in range(2):
            total = 0.0
            for j in range(shape.shape[1]):
                total += w[b, j] * shape[a, j]
            D[b, a] = total

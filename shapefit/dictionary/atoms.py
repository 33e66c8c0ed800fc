"""The atom update: the best atoms within a ball for fixed coefficients."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def update_atoms(
    shapes: Floats, coefficients: Floats, atoms: Floats, bound: float, sweeps: int = 5
) -> Floats:
    """Lower 1/2 sum_j ||S_j - sum_i C_ji B_i||_F^2 over atoms with ||B_i||_F <= bound.

    shapes (n, 3, p), coefficients (n, k), atoms (k, 3, p) within the bound, the place to start;
    returns the new atoms. Block coordinate descent: with the other atoms fixed, the best B_i is
    the projection of its unconstrained minimum on the ball, so no step raises the objective.
    Atoms that no shape uses stay as they are. Source: Mairal et al. 2010, algorithm 2.
    """
    A = coefficients.T @ coefficients
    D = coefficients.T @ shapes.reshape(len(shapes), -1)
    B = atoms.reshape(len(atoms), -1).copy()
    used = np.flatnonzero(A.diagonal() > 0)
    for _ in range(sweeps):
        for i in used:
            free = B[i] + (D[i] - A[i] @ B) / A[i, i]
            B[i] = free * (bound / max(float(np.linalg.norm(free)), bound))
    return B.reshape(atoms.shape)

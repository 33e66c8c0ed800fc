"""The atom update: the best atoms within a ball for fixed coefficients."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from shapefit import core

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
    B = np.array(atoms, dtype=np.float64, order="C")
    core.update_atoms(
        shapes=np.ascontiguousarray(shapes, dtype=np.float64).reshape(len(shapes), B[0].size),
        coefficients=np.ascontiguousarray(coefficients, dtype=np.float64),
        atoms=B.reshape(len(B), -1),
        bound=bound,
        sweeps=sweeps,
    )
    return B

"""Non-negative sparse coding: shapes as cheap non-negative mixtures of fixed atoms.

min_c 1/2 ||S - sum_i c_i B_i||_F^2 + beta sum_i c_i  over c >= 0,

for each shape S by itself (paper, eq. dl with the atoms fixed).
"""

from __future__ import annotations

import warnings
from math import prod

import numpy as np

from shapefit import core
from shapefit.arrays import Floats


def sparse_code(
    shapes: Floats,
    atoms: Floats,
    beta: float,
    start: Floats | None = None,
    tolerance: float = 1e-10,
    *,
    threads: int = 0,
) -> Floats:
    """Return the coefficients (n, k) >= 0 of shapes as sparse mixtures of atoms.

    argmin_C sum_j 1/2 ||S_j - sum_i C_ji B_i||_F^2 + beta sum_i C_ji  over C >= 0.
    shapes (n, 3, p), atoms (k, 3, p), start (n, k) >= 0 the coefficients to begin at
    (default 0). Never worse than the start. Each shape stops when no change of a single
    coefficient would still move it by more than `tolerance` of its norm.

    An active set method (Lawson and Hanson 1974, with the l1 term), see
    core/base/active_set.hpp. Warns (RuntimeWarning) where a shape does not stop. Raises
    ValueError for a start of another shape or below 0.
    """
    X = flatten_shapes(shapes)
    B = flatten_shapes(atoms)
    if start is None:
        C = np.zeros((len(X), len(B)))
    else:
        C = np.array(start, dtype=np.float64)
    if C.shape != (len(X), len(B)) or (C < 0).any():
        raise ValueError(f"start must be {(len(X), len(B))} and >= 0, is {C.shape}")
    smallest_move = tolerance * np.linalg.norm(X, axis=1)
    unsettled = np.zeros(len(X), dtype=bool)
    core.code(
        gram=B @ B.T,
        linear_terms=X @ B.T - beta,
        smallest_moves=smallest_move,
        coefficients=C,
        unsettled=unsettled,
        threads=threads,
    )
    if unsettled.any():
        warnings.warn(
            f"{unsettled.sum()} of {len(C)} shapes were not coded to the tolerance",
            RuntimeWarning,
            stacklevel=2,
        )
    return C


def objectives(
    shapes: Floats, atoms: Floats, beta: float, coefficients: Floats
) -> Floats:
    """Return the objective (n,) of the sparse code (n, k) of each shape.

    1/2 ||S_j - sum_i C_ji B_i||_F^2 + beta sum_i C_ji.
    """
    left = flatten_shapes(shapes) - coefficients @ flatten_shapes(atoms)
    squares = np.einsum("nd,nd->n", left, left)
    values: Floats = 0.5 * squares + beta * coefficients.sum(axis=1)
    return values


def flatten_shapes(shapes: Floats) -> Floats:
    """Flatten shapes (n, 3, p) to rows (n, 3p): a view where memory allows it."""
    in_order = np.ascontiguousarray(shapes, dtype=np.float64)
    return in_order.reshape(len(shapes), prod(shapes.shape[1:]))

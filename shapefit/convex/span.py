"""Large shapes: the squared loss sees landmarks only through the span of the atoms.

With an orthonormal basis U (q, r) of the rows of all weighted, centred atoms, w = w U
U^T + v and

    1/2 ||w - sum_i M_i B_i||^2 = 1/2 ||w U - sum_i M_i B_i U||^2 + 1/2 ||v||^2,

so that images are solved with r + 1 landmarks in place of p, once per set of weights,
and exactly: the dual is Y = Y' U^T + v, and certificates are those of the landmarks as
they are given.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from shapefit import core
from shapefit.arrays import Floats
from shapefit.convex.problem import Loss, Problem

LARGE = 200
"""Landmarks from which on the span of the atoms is sought."""

WORTH = 0.75
"""Coordinates of the span, as a share of the landmarks, up to which it is worth its
price.
"""

SHARED = 4
"""Images that share their weights, in the mean, from which on the span pays for itself.
"""

NEGLIGIBLE = 1e-12
"""Singular value of the atoms beside the largest below which a direction is rounding.
"""


class Reduced(NamedTuple):
    """Images `rows` (m,) as a problem of r + 1 landmarks; basis U Z (p, r + 1) of
    weighted ones.

    Without a basis the problem has all p landmarks.
    """

    rows: NDArray[np.intp]
    problem: Problem
    basis: Floats | None

    def expand(self, dual: Floats, given: Problem) -> Floats:
        """Return the dual (m, 2, p) of the images as given, for that (m, 2, r + 1) of
        these.
        """
        if self.basis is None:
            return dual
        w = weighted(given.landmarks[self.rows], given.weights[self.rows])
        expanded: Floats = w + (dual - w @ self.basis) @ self.basis.T
        return expanded


def is_worth_reducing(problem: Problem) -> bool:
    """Whether the span of the atoms is exact and pays."""
    n, _, p = problem.landmarks.shape
    small_rank = 3 * len(problem.atoms) + 1 <= WORTH * p
    return problem.loss is Loss.SQUARED and p >= LARGE and small_rank and n > 0


def reduce_images(problem: Problem) -> Iterator[Reduced]:
    """Yield the images in parts of equal weights.

    How a block of images is divided does not depend on the others, so that no result
    depends on how images are batched; blocks of one set of weights stay together, for
    threads to share.
    """
    together: list[NDArray[np.intp]] = []
    basis_of = lru_cache(maxsize=8)(
        lambda key: find_basis(problem.atoms, np.frombuffer(key))
    )

    def reduced(rows: NDArray[np.intp]) -> Reduced:
        weights = problem.weights[rows]
        basis = basis_of(weights[0].tobytes())
        w = weighted(problem.landmarks[rows], weights)
        B = weighted(
            problem.atoms, np.broadcast_to(weights[0], problem.atoms.shape[::2])
        )
        ones = np.ones((len(rows), basis.shape[1]))
        return Reduced(
            rows, Problem(w @ basis, ones, B @ basis, problem.lam[rows]), basis
        )

    for start in range(0, len(problem.lam), core.IMAGES_PER_BLOCK):
        rows = np.arange(start, min(start + core.IMAGES_PER_BLOCK, len(problem.lam)))
        masks, of = np.unique(problem.weights[rows], axis=0, return_inverse=True)
        same = together and (problem.weights[together[-1][0]] == masks).all()
        if together and (len(masks) > 1 or not same):
            yield reduced(np.concatenate(together))
            together = []
        if len(masks) == 1:
            together.append(rows)
        elif len(masks) * SHARED > len(rows):
            yield Reduced(rows, problem.take(rows), None)
        else:
            yield from (
                reduced(rows[of.ravel() == number]) for number in range(len(masks))
            )
    if together:
        yield reduced(np.concatenate(together))


def find_basis(atoms: Floats, mask: Floats) -> Floats:
    """Return U Z (p, r + 1) of the atoms (k, 3, p) for the weights (p,).

    The rows of Z^T (r + 1, r) are orthonormal and orthogonal to 1: centring takes
    nothing off.
    """
    B = weighted(atoms, np.broadcast_to(mask, (len(atoms), len(mask))))
    size, U = np.linalg.svd(B.reshape(-1, len(mask)), full_matrices=False)[1:]
    U = U[size > NEGLIGIBLE * size[0]]
    r = len(U)
    h = np.full(r + 1, 1 / np.sqrt(r + 1))
    h[-1] += 1
    Z = np.eye(r + 1)[:r] - np.outer(h[:r], h) / h[-1]
    return np.asarray(U.T @ Z, np.float64)


def weighted(points: Floats, weights: Floats) -> Floats:
    """Points (m, d, p) less their mean by the weights (m, p) squared, times the
    weights.
    """
    largest = np.maximum(weights.max(axis=1, keepdims=True), np.finfo(float).tiny)
    squares = (weights / largest)[:, None] ** 2
    points = np.where(
        squares > 0, points, 0.0
    )  # what hidden landmarks hold is irrelevant
    total = np.maximum(squares.sum(axis=-1, keepdims=True), np.finfo(float).tiny)
    mean = (squares * points).sum(axis=-1, keepdims=True) / total
    scaled: Floats = weights[:, None] * (points - mean)
    return scaled

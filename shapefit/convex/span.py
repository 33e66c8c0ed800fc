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
from itertools import takewhile
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

INDEPENDENT = 1e-10
"""Squared distance of a row from the span of those before it, beside the largest
squared length, above which no rounding has made it.
"""

MIXTURES = (64, 128, 256, 512, 1024, 2048)
"""Random mixtures of the rows whose span is tried."""


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


def find_span(problem: Problem) -> Floats | None:
    """Return an orthonormal basis (p, r) of the rows of all atoms; None where the
    problem is not to be reduced to it.
    """
    p = problem.landmarks.shape[2]
    if problem.loss is not Loss.SQUARED or p < LARGE or not len(problem.lam):
        return None
    return find_row_space(problem.atoms.reshape(-1, p), int(WORTH * p) - 1)


def find_row_space(rows: Floats, most: int) -> Floats | None:
    """Return an orthonormal basis (p, r) of the span of rows (m, p); None where its
    dimension is above `most`.

    Of many rows of a low rank, random mixtures span the same (Halko, Martinsson and
    Tropp, SIAM Review 2011), which the rows themselves then prove.
    """
    rows = rows / (np.abs(rows).max() or 1.0)
    if are_independent(rows[: most + 1]):
        return np.linalg.qr(rows.T).Q if len(rows) <= most else None
    rng = np.random.default_rng(0)
    largest = min(most, len(rows))
    for mixtures in (*takewhile(largest.__gt__, MIXTURES), largest):
        mixed = rng.normal(size=(mixtures, len(rows))) @ rows
        basis = np.linalg.qr(mixed.T).Q
        along = rows @ basis
        left = np.linalg.norm(rows - along @ basis.T)
        if left <= NEGLIGIBLE * np.linalg.norm(rows):
            size, turned = np.linalg.svd(along, full_matrices=False)[1:]
            found: Floats = basis @ turned[size > NEGLIGIBLE * size[0]].T
            return found
    return None


def are_independent(rows: Floats) -> bool:
    """Whether the rows (m, p) are independent beyond doubt."""
    products = rows @ rows.T
    try:
        pivots = np.linalg.cholesky(products).diagonal() ** 2
    except np.linalg.LinAlgError:
        return False
    return bool(pivots.min() > INDEPENDENT * products.diagonal().max())


def reduce_images(problem: Problem, span: Floats) -> Iterator[Reduced]:
    """Yield the images in parts of equal weights, for a basis (p, r) of the rows of all
    atoms.

    How a block of images is divided does not depend on the others, so that no result
    depends on how images are batched; blocks of one set of weights stay together, for
    threads to share.
    """
    together: list[NDArray[np.intp]] = []
    basis_of = lru_cache(maxsize=8)(lambda key: find_basis(span, np.frombuffer(key)))

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
        masks, of = distinct_rows(problem.weights[rows])
        same = together and (problem.weights[together[-1][0]] == masks).all()
        if together and (len(masks) > 1 or not same):
            yield reduced(np.concatenate(together))
            together = []
        if len(masks) == 1:
            together.append(rows)
        elif len(masks) * SHARED > len(rows):
            yield Reduced(rows, problem.take(rows), None)
        else:
            yield from (reduced(rows[of == number]) for number in range(len(masks)))
    if together:
        yield reduced(np.concatenate(together))


def distinct_rows(x: Floats) -> tuple[Floats, NDArray[np.intp]]:
    """Return the rows of x (n, p) that differ, and which of them each is."""
    if (x == x[0]).all():  # np.unique takes longer than all else
        return x[:1], np.zeros(len(x), np.intp)
    rows, of = np.unique(x, axis=0, return_inverse=True)
    return rows, of.ravel()


def find_basis(span: Floats, weights: Floats) -> Floats:
    """Return U Z (p, r + 1) for the weights (p,): U (p, r) spans the rows of all atoms,
    weighted and centred, where `span` (p, r) spans the atoms as they are.

    Weighted, their rows are in the span of U and the weights, to which centring makes
    them orthogonal. The rows of Z^T (r + 1, r) are orthonormal and orthogonal to 1:
    centring takes nothing off.
    """
    largest = weights.max() or 1.0
    scaled = weights[:, None] / largest
    U = np.linalg.qr(np.hstack([scaled, scaled * span])).Q[:, 1:]
    r = U.shape[1]
    h = np.full(r + 1, 1 / np.sqrt(r + 1))
    h[-1] += 1
    Z = np.eye(r + 1)[:r] - np.outer(h[:r], h) / h[-1]
    return np.asarray(U @ Z, np.float64)


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

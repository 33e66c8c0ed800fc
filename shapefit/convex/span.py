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
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats
from shapefit.convex.problem import Loss, Problem

MIN_LANDMARKS_OF_A_SPAN = 200
"""Landmarks from which on the span of the atoms is sought."""

MAX_SPAN_SHARE = 0.75
"""Coordinates of the span, as a share of the landmarks, up to which it pays."""

MIN_IMAGES_OF_WEIGHTS = 4
"""Images that share their weights, in the mean, from which on the span pays."""

NEGLIGIBLE_DISTANCE = 1e-12
"""Distance of rows from a span, beside their size, which is rounding."""

MIN_SQUARED_DISTANCE = 1e-10
"""Squared distance of a row from the span of those before it, beside the largest
squared length, above which no rounding has made it.
"""

RANDOM_MIXTURES = (64, 128, 256, 512, 1024, 2048)
"""How many random mixtures of the rows are tried, one number after the other."""


class Reduced(NamedTuple):
    """Some images as a problem of r + 1 landmarks, equivalent to their own.

    rows (m,): which of all images. The basis U Z (p, r + 1) reduces weighted landmarks;
    without one the problem has all p landmarks.
    """

    rows: NDArray[np.intp]
    problem: Problem
    basis: Floats | None

    def expand(self, dual: Floats, original: Problem) -> Floats:
        """Return the dual (m, 2, p) of the original from the reduced one (m, 2, r + 1).

        original: the problem of all images.
        """
        if self.basis is None:
            return dual
        w = centre_and_weight(
            original.landmarks[self.rows], original.weights[self.rows]
        )
        expanded: Floats = w + (dual - w @ self.basis) @ self.basis.T
        return expanded


def find_span(problem: Problem) -> Floats | None:
    """Return an orthonormal basis (p, r) of the span of all atoms; None if of no use.

    It saves no time for few landmarks or many atoms, and any loss but the squared one
    cannot be reduced.
    """
    p = problem.landmarks.shape[2]
    if problem.loss is not Loss.SQUARED:
        return None
    if p < MIN_LANDMARKS_OF_A_SPAN or not len(problem.lam):
        return None
    return find_row_space(problem.atoms.reshape(-1, p), int(MAX_SPAN_SHARE * p) - 1)


def find_row_space(rows: Floats, max_dimension: int) -> Floats | None:
    """Return an orthonormal basis (p, r) of the span of rows (m, p); None if too large.

    That is where r would be above `max_dimension`. Of many rows of a low rank,
    random mixtures span the same (Halko, Martinsson and Tropp, SIAM Review 2011), which
    the rows themselves then prove.
    """
    rows = rows / (max(rows.max(), -rows.min()) or 1.0)
    rng = np.random.default_rng(0)
    most = min(max_dimension, len(rows))
    numbers = [number for number in RANDOM_MIXTURES if number < most]
    for mixtures in (*numbers, most):
        # more rows than mixtures, or all of them: mixing would gain nothing
        if are_independent(rows[: mixtures + 1]):
            continue
        mixing = rng.normal(size=(mixtures, len(rows)))
        basis = orthonormalise(mixing @ rows)
        left = (rows @ basis) @ basis.T
        left -= rows
        if np.linalg.norm(left) <= NEGLIGIBLE_DISTANCE * np.linalg.norm(rows):
            return basis
    if len(rows) <= max_dimension:
        return np.linalg.qr(rows.T).Q
    return None


def orthonormalise(rows: Floats) -> Floats:
    """Return an orthonormal basis (p, r) of the span of rows (m, p), in their order.

    A row whose distance from the span of those before it is rounding adds nothing.
    """
    Q, R = np.linalg.qr(rows.T)
    distance = np.abs(R.diagonal())
    basis: Floats = Q[:, distance > NEGLIGIBLE_DISTANCE * distance.max()]
    return basis


def are_independent(rows: Floats) -> bool:
    """Whether the rows (m, p) are linearly independent up to rounding."""
    products = rows @ rows.T
    try:
        pivots = np.linalg.cholesky(products).diagonal() ** 2
    except np.linalg.LinAlgError:
        return False
    return bool(pivots.min() > MIN_SQUARED_DISTANCE * products.diagonal().max())


def reduce_images(problem: Problem, span: Floats) -> Iterator[Reduced]:
    """Yield the problem in parts of images, reduced to the span (p, r) of the atoms.

    A part has equal weights. One of many different weights is not reduced, its basis
    None. How a block of images is divided does not depend on the others, so that no
    result depends on how images are batched; blocks of one set of weights stay
    together, for threads to share.
    """
    together: list[NDArray[np.intp]] = []
    basis_of = lru_cache(maxsize=8)(lambda key: find_basis(span, np.frombuffer(key)))

    def reduce_part(rows: NDArray[np.intp]) -> Reduced:
        """Return the reduced problem of the images `rows`, whose weights are equal."""
        weights = problem.weights[rows]
        basis = basis_of(weights[0].tobytes())
        w = centre_and_weight(problem.landmarks[rows], weights)
        ones = np.ones((len(rows), basis.shape[1]))
        atoms = reduce_atoms(problem.atoms, weights[0], basis)
        group = None if problem.group is None else problem.group[rows]
        reduced = Problem(w @ basis, ones, atoms, problem.lam[rows], group=group)
        return Reduced(rows, reduced, basis)

    begins = np.flatnonzero(problem.begins).tolist()
    for start, stop in pairwise([*begins, len(problem.lam)]):
        rows = np.arange(start, stop)
        masks, mask_of = distinct_rows(problem.weights[rows])
        if together:
            has_same_weights = problem.weights[together[-1][0]] == masks
            if len(masks) > 1 or not has_same_weights.all():
                yield reduce_part(np.concatenate(together))
                together = []
        if len(masks) == 1:
            together.append(rows)
        elif len(masks) * MIN_IMAGES_OF_WEIGHTS > len(rows):
            yield Reduced(rows, problem.take(rows), None)
        else:
            for mask in range(len(masks)):
                yield reduce_part(rows[mask_of == mask])
    if together:
        yield reduce_part(np.concatenate(together))


def distinct_rows(x: Floats) -> tuple[Floats, NDArray[np.intp]]:
    """Return the distinct rows of x (n, p), and for each row (n,) its index in them."""
    if (x == x[0]).all():  # np.unique takes longer than all else
        return x[:1], np.zeros(len(x), np.intp)
    rows, row_of = np.unique(x, axis=0, return_inverse=True)
    return rows, row_of.ravel()


def find_basis(span: Floats, weights: Floats) -> Floats:
    """Return the basis U Z (p, r + 1) that reduces landmarks of the given weights (p,).

    U (p, r) spans the rows of all atoms, weighted and centred, where `span` (p, r)
    spans the atoms as they are. Weighted, their rows are in the span of U and the
    weights, to which centring makes them orthogonal. The rows of Z^T (r + 1, r) are
    orthonormal and orthogonal to 1: centring takes nothing off.
    """
    largest = weights.max() or 1.0
    scaled = weights[:, None] / largest
    spanning = np.hstack([scaled, scaled * span])
    U = np.linalg.qr(spanning).Q[:, 1:]
    r = U.shape[1]
    # all but the last row of the Householder reflection that turns 1 into an axis
    h = np.full(r + 1, 1 / np.sqrt(r + 1))
    h[-1] += 1
    Z = np.eye(r + 1)[:r] - np.outer(h[:r], h) / h[-1]
    return np.asarray(U @ Z, np.float64)


def reduce_atoms(atoms: Floats, weights: Floats, basis: Floats) -> Floats:
    """Return the weighted, centred atoms (k, 3, r + 1) in a basis (p, r + 1).

    atoms (k, 3, p), weights (p,). The weights go to the basis, which is smaller.
    """
    k, _, p = atoms.shape
    squares = (weights / (weights.max() or 1.0)) ** 2
    mean = atoms @ squares / (squares.sum() or 1.0)
    centred = (atoms - mean[..., None]).reshape(-1, p)
    reduced: Floats = centred @ (weights[:, None] * basis)
    return reduced.reshape(k, 3, -1)


def centre_and_weight(points: Floats, weights: Floats) -> Floats:
    """Centre points (m, d, p), and multiply them by their weights omega (m, p).

    omega o (points - mean), the mean being weighted by omega^2.
    """
    tiny = np.finfo(float).tiny
    largest = np.maximum(weights.max(axis=1, keepdims=True), tiny)
    squares = (weights / largest)[:, None] ** 2
    # what hidden landmarks hold is irrelevant
    points = np.where(squares > 0, points, 0.0)
    total = np.maximum(squares.sum(axis=-1, keepdims=True), tiny)
    mean = (squares * points).sum(axis=-1, keepdims=True) / total
    scaled: Floats = weights[:, None] * (points - mean)
    return scaled

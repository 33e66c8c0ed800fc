"""Projected Matching Pursuit: greedy bases of either sign around the mean shape."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats, Indices, Integers
from shapefit.convex.problem import Problem
from shapefit.convex.solver import Status
from shapefit.convex.span import centre_and_weight
from shapefit.geometry.rotations import complete_rotation, nearest_rows
from shapefit.lifting.estimate import AtomEstimate, fit_translation
from shapefit.lifting.reconstruction import combine

# The published rules are in pixels: 500 px^2 for the squared reprojection error of all
# landmarks, 1 px^2 for its change in a round. A normalised unit is the standard
# deviation of the landmarks. A standing person is about 5 of them from ankle to head,
# 350 px in the images the rules were made for: 70 px a unit.
PIXELS_PER_UNIT = 70.0

GOAL_ERROR = 500.0 / PIXELS_PER_UNIT**2
"""Squared error of an image at which no atom joins any more."""

MIN_ERROR_CHANGE = 1.0 / PIXELS_PER_UNIT**2
"""Change of the squared error with which rounds go on."""

MAX_PURSUED_ATOMS = 15
"""Atoms that join, beside the mean."""

MAX_PURSUIT_ROUNDS = 30
"""Rounds after each atom."""

IMAGES_PURSUED_AT_ONCE = 1024
"""Most of a round is the calls, not their arithmetic."""

MIN_INDEPENDENT_SHARE = 1e-8
"""Of the squared lengths of a shape's limbs, outside those of the chosen shapes."""

MIN_EXTENT_SHARE = 1e-12
"""Of an eigenvalue of S S^T beside the largest, below which a shape has no extent."""

LITTLE_ROUNDING = 64 * np.finfo(np.float64).eps
"""Relative error of sums and products."""

MAX_ROOT_STEPS = 100
"""Of Newton's method for the multiplier; it takes about ten."""


def lift_by_pursuit(
    problem: Problem, *, mean_shape: Floats, edges: Integers
) -> AtomEstimate:
    """Lift by projected matching pursuit: the mean shape and a few PCA bases.

    Source: Ramakrishna, Kanade, Sheikh, ECCV 2012. edges (e, 2) are the limbs whose
    lengths are kept. The coefficients take up the mean of the two scales of the camera.
    The objective is the squared error with both scales; the residual belongs to the
    rotated shape, as with every method.
    """
    pursuit = pursue(problem, mean_shape, edges)
    solved = np.asarray(np.isfinite(pursuit.scale).all(axis=1))
    rotation = np.where(solved[:, None, None], pursuit.rotation, np.eye(3))
    scale = np.where(solved, pursuit.scale.mean(axis=1), 0.0)[:, None]
    c = scale * pursuit.coefficients
    mean_part = (scale * pursuit.mean_coefficient[:, None])[..., None] * mean_shape
    shapes = rotation @ (combine(c, problem.atoms) + mean_part)
    placement = fit_translation(problem, shapes)
    return AtomEstimate(
        shapes=shapes,
        translation=placement.translation,
        rotation=pursuit.rotation,
        objective=pursuit.error,
        residual=placement.residual,
        iterations=pursuit.rounds,
        status=pursuit.status,
        coefficients=c,
        active_atoms=np.count_nonzero(c, axis=1),
    )


class Pursuit(NamedTuple):
    """What matching pursuit finds of n images: shapes S before cameras M.

    W ~ M S + T 1^T with S = c_0 mean + sum_i c_i B_i and M = diag(s) Rbar. coefficients
    c (n, k) of either sign; mean_coefficient c_0 (n,); rotation R (n, 3, 3) and scale s
    (n, 2) of x and y, nan where there is no camera; error (n,), ||Omega o (W - M S - T
    1^T)||_F^2; rounds (n,); status: CONVERGED where the error reached the goal,
    ITERATION_LIMIT where the atoms ran out.
    """

    coefficients: Floats
    mean_coefficient: Floats
    rotation: Floats
    scale: Floats
    error: Floats
    rounds: NDArray[np.int64]
    status: tuple[Status, ...]


def pursue(
    problem: Problem,
    mean_shape: Floats,
    edges: NDArray[np.int64],
    *,
    goal: float = GOAL_ERROR,
    change: float = MIN_ERROR_CHANGE,
    max_atoms: int = MAX_PURSUED_ATOMS,
    max_rounds: int = MAX_PURSUIT_ROUNDS,
) -> Pursuit:
    """Fit the mean shape and a few atoms to landmarks greedily, at a fixed limb size.

    Lowers ||Omega o (W - M S - T 1^T)||_F^2 for S = c_0 mean + sum_i c_i B_i with
    mean_shape (3, p); edges (e, 2) are the limbs, whose squared lengths keep the sum
    they have in the mean shape. It begins with the camera M of the mean shape, two rows
    of a rotation with a scale each. While the error is above `goal`, the atom whose
    projection has the largest |inner product| with the residual joins, of those whose
    limbs are no mixture of the chosen ones'; then rounds minimise over c (globally, on
    the limb constraint) and over M, until one changes the error by less than `change`.
    lambda is ignored. Raises ValueError for a loss other than the squared one.

    Source: Ramakrishna, Kanade and Sheikh 2012, with the mean as one more basis shape:
    with c_0 = 1 the constraint would leave a single atom no more than two coefficients.
    """
    problem.require_squared("matching pursuit")
    n = len(problem.landmarks)
    k = len(problem.atoms)
    shapes = np.concatenate([mean_shape[None], problem.atoms])
    limbs = shapes[:, :, edges[:, 0]] - shapes[:, :, edges[:, 1]]
    limbs = limbs.reshape(1 + k, -1)
    coefficients = np.zeros((n, 1 + k))
    rotation = np.full((n, 3, 3), np.nan)
    scale = np.full((n, 2), np.nan)
    error = np.full(n, np.nan)
    rounds = np.zeros(n, np.int64)
    status = np.full(n, Status.DEGENERATE, dtype=object)
    for rows, mask in divide_by_weights(problem.weights):
        if (mask > 0).sum() < 2:
            continue
        w = centre_and_weight(problem.landmarks[rows], problem.weights[rows])
        with np.errstate(over="ignore"):
            is_finite = np.isfinite((w**2).sum(axis=(1, 2)))
        status[rows[~is_finite]] = Status.NUMERICAL_FAILURE
        rows = rows[is_finite]
        if not len(rows):
            continue
        B = centre_and_weight(shapes, np.broadcast_to(mask, (1 + k, len(mask))))
        search = Search(w[is_finite], B, limbs)
        search.run(goal, change, max_atoms, max_rounds)
        coefficients[rows] = search.coefficients
        rotation[rows] = complete_rotation(search.R)
        scale[rows] = search.scale
        error[rows] = search.error
        rounds[rows] = search.rounds
        is_solved = search.error <= goal
        status[rows[is_solved]] = Status.CONVERGED
        status[rows[~is_solved]] = Status.ITERATION_LIMIT
    return Pursuit(
        coefficients=coefficients[:, 1:],
        mean_coefficient=coefficients[:, 0],
        rotation=rotation,
        scale=scale,
        error=error,
        rounds=rounds,
        status=tuple(status),
    )


def divide_by_weights(weights: Floats) -> Iterator[tuple[Indices, Floats]]:
    """Yield groups of images with the same weights: their rows, and the weights (p,).

    Of weights (n, p), `IMAGES_PURSUED_AT_ONCE` images at most in a group.
    """
    for start in range(0, len(weights), IMAGES_PURSUED_AT_ONCE):
        part = weights[start : start + IMAGES_PURSUED_AT_ONCE]
        masks, mask_of = np.unique(part, axis=0, return_inverse=True)
        for number, mask in enumerate(masks):
            yield start + np.flatnonzero(mask_of.ravel() == number), mask


class Search:
    """The greedy search of `pursue`, for n images of the same weights.

    min ||w - M sum_i y_i Q_i||^2 over M and ||y|| = length. The m chosen shapes of an
    image, the mean first, are mixed into Q_i = sum_j (L^-1)_ij B_j with L L^T the Gram
    matrix of their limbs, so that the sum of squared limb lengths of sum_i y_i Q_i is
    ||y||^2. A round needs Z_i = w Q_i^T (n, m, 2, 3) and N_ij = Q_i Q_j^T (n, m, m, 3,
    3) alone.
    """

    def __init__(self, w: Floats, B: Floats, limbs: Floats) -> None:
        """Begin to fit w (n, 2, p) by the mean, the first of shapes B (s, 3, p).

        limbs (s, l); w and B are centred and multiplied by the weights.
        """
        n = len(w)
        self.w = w
        self.B = B
        self.limb_gram = limbs @ limbs.T
        self.length = float(np.linalg.norm(limbs[0]))
        self.energy = (w**2).sum(axis=(1, 2))
        self.coefficients = np.zeros((n, len(B)))
        self.coefficients[:, 0] = 1.0
        self.rounds = np.zeros(n, np.int64)
        self.R = np.zeros((n, 2, 3))
        self.scale = np.zeros((n, 2))
        self.error = np.empty(n)
        mean_alone = B[np.zeros((n, 1), np.intp)]
        Z, N = self.moments(w, mean_alone)
        self.fit_camera(np.arange(n), np.ones((n, 1)), Z, N)

    def run(self, goal: float, change: float, max_atoms: int, max_rounds: int) -> None:
        """Add atoms one by one, refitting each time, until errors are at the goal.

        goal, change and limits as in `pursue`.
        """
        going = np.arange(len(self.w))
        chosen = np.zeros((len(going), 1), np.intp)
        for _ in range(max_atoms):
            is_unsolved = self.error[going] > goal
            going, chosen = self.add_atom(going[is_unsolved], chosen[is_unsolved])
            if not len(going):
                return
            self.fit_alternately(going, chosen, change, max_rounds)

    def fit_alternately(
        self, going: Indices, chosen: Indices, change: float, max_rounds: int
    ) -> None:
        """Fit coefficients and cameras in turn, in place, until errors converge.

        going (r,): indices of the images; chosen (r, m): those of the shapes that each
        mixes; change and max_rounds as in `pursue`.
        """
        L = np.linalg.cholesky(self.limb_gram[chosen[:, :, None], chosen[:, None]])
        flat = self.B[chosen].reshape(*chosen.shape, -1)
        Q = np.linalg.solve(L, flat).reshape(*chosen.shape, *self.B.shape[1:])
        Z, N = self.moments(self.w[going], Q)
        start = np.take_along_axis(self.coefficients[going], chosen, axis=1)
        y = np.einsum("nij,ni->nj", L, start)
        rows = np.arange(len(going))
        for _ in range(max_rounds):
            images = going[rows]
            before = self.error[images]
            M = self.cameras(images)
            y[rows] = self.mix(M, y[rows], Z[rows], N[rows])
            self.fit_camera(images, y[rows], Z[rows], N[rows])
            self.rounds[images] += 1
            stands_still = np.abs(before - self.error[images]) < change
            rows = rows[~stands_still]
            if not len(rows):
                break
        mixed = np.linalg.solve(L.swapaxes(1, 2), y[..., None])[..., 0]
        self.coefficients[going[:, None], chosen] = mixed

    def add_atom(self, rows: Indices, chosen: Indices) -> tuple[Indices, Indices]:
        """Choose one more atom for each image: that most like its residual.

        That of the largest |<w - M S, M B_i>|, of those whose limbs are no mixture of
        the chosen ones'. Returns the indices of the images that have one, and of the
        shapes chosen for them, the new one last.
        """
        S = np.einsum("ns,sap->nap", self.coefficients[rows], self.B)
        M = self.cameras(rows)
        back = M.swapaxes(1, 2) @ (self.w[rows] - M @ S)
        score = np.abs(np.einsum("nap,sap->ns", back, self.B, optimize=True))
        G = self.limb_gram
        L = np.linalg.cholesky(G[chosen[:, :, None], chosen[:, None]])
        size = G.diagonal()
        outside = size - (np.linalg.solve(L, G[chosen]) ** 2).sum(axis=1)
        is_independent = outside > MIN_INDEPENDENT_SHARE * size
        score = np.where(is_independent, score, -1.0)
        atom = score.argmax(axis=1)
        has_one = score.max(axis=1, initial=-1.0) >= 0
        return rows[has_one], np.column_stack([chosen, atom])[has_one]

    def cameras(self, rows: Indices) -> Floats:
        """Return the cameras M = diag(scale) R (r, 2, 3) of the images `rows`."""
        M: Floats = self.scale[rows, :, None] * self.R[rows]
        return M

    @staticmethod
    def moments(w: Floats, Q: Floats) -> tuple[Floats, Floats]:
        """Return Z_i = w Q_i^T and N_ij = Q_i Q_j^T of shapes Q (n, m, 3, p)."""
        Z: Floats = w[:, None] @ Q.swapaxes(2, 3)
        N: Floats = Q[:, :, None] @ Q[:, None].swapaxes(3, 4)
        return Z, N

    def fit_camera(self, rows: Indices, y: Floats, Z: Floats, N: Floats) -> None:
        """Fit rotations and scales of images `rows` to sum_i y_i Q_i of moments Z, N.

        In place. With S that sum R is nearest to argmin_M ||w - M S||^2. The rotation
        stays where it fits better than that, so that no error rises. Z and N as
        `moments` returns them.
        """
        D = np.einsum("nm,nmab->nab", y, Z)
        yy = (y[:, :, None] * y[:, None]).reshape(len(y), 1, -1)
        P = (yy @ N.reshape(len(y), -1, 9)).reshape(-1, 3, 3)
        nearest = nearest_rows(least_squares(D, P))
        scale, gain = fit_scales(nearest, D, P)
        old_scale, old_gain = fit_scales(self.R[rows], D, P)
        is_better = gain > old_gain
        self.R[rows] = np.where(is_better[:, None, None], nearest, self.R[rows])
        self.scale[rows] = np.where(is_better[:, None], scale, old_scale)
        left = self.energy[rows] - np.maximum(gain, old_gain)
        self.error[rows] = np.maximum(left, 0.0)

    def mix(self, M: Floats, y: Floats, Z: Floats, N: Floats) -> Floats:
        """Return the best coefficients y (n, m) for cameras M (n, 2, 3), moments Z, N.

        argmin ||w - sum_i y_i M Q_i||^2 over ||y|| = length; of two the one nearer to
        the given y. Z and N as `moments` returns them.
        """
        n, m = y.shape
        P = (M.swapaxes(1, 2) @ M).reshape(n, 9, 1)
        G = (N.reshape(n, m * m, 9) @ P).reshape(n, m, m)
        g = np.einsum("nab,nmab->nm", M, Z)
        return minimise_on_sphere(G, g, self.length, y)


def least_squares(D: Floats, P: Floats) -> Floats:
    """Solve w = M S for M (n, 2, 3) by least squares, from D = w S^T and P = S S^T.

    The solution of least norm. D (n, 2, 3), P (n, 3, 3).
    """
    extent, axes = np.linalg.eigh(P)
    has_extent = extent > MIN_EXTENT_SHARE * extent[:, -1:]
    inverse = np.zeros_like(extent)
    np.divide(1.0, extent, out=inverse, where=has_extent)
    M: Floats = (D @ axes * inverse[:, None]) @ axes.swapaxes(1, 2)
    return M


def fit_scales(R: Floats, D: Floats, P: Floats) -> tuple[Floats, Floats]:
    """Solve w = diag(s) R S for scales s (n, 2) >= 0, from D = w S^T and P = S S^T.

    By least squares. Returns s, and the gains (n,): how far ||w - diag(s) R S||^2 is
    below ||w||^2. R (n, 2, 3), rows of rotations or 0; D (n, 2, 3), P (n, 3, 3).
    """
    overlap = np.maximum((D * R).sum(axis=2), 0.0)
    extent = (R @ P * R).sum(axis=2)
    whole = P.trace(axis1=1, axis2=2)[:, None]
    scale = np.zeros_like(overlap)
    np.divide(overlap, extent, out=scale, where=extent > MIN_EXTENT_SHARE * whole)
    return scale, (scale * overlap).sum(axis=1)


def minimise_on_sphere(G: Floats, g: Floats, radius: float, before: Floats) -> Floats:
    """Return the y (n, m) with ||y|| = radius that minimises y^T G y - 2 g^T y.

    Of two the one nearer to `before`. G (n, m, m) symmetric, g and before (n, m). It
    solves (G + multiplier I) y = g, that matrix positive semidefinite, at the largest
    root of

        sum_i (t_i / (mu_i + multiplier))^2 = radius^2,

    where G = V diag(mu) V^T and t = V^T g. 1 / ||y|| is a concave function of the
    multiplier right of the last pole: Newton's method from the left of the root never
    overshoots. Where g has no part along the least eigenvalue the pole may be none, and
    the root may lie left of it: then the multiplier is the pole and the eigenvector
    fills up y (the hard case). Source: Gander 1981; More and Sorensen 1983.
    """
    mu, V = np.linalg.eigh(G)
    above = mu - mu[:, :1]
    t = np.einsum("nij,ni->nj", V, g)
    # the size of G + multiplier I
    size = (np.linalg.norm(t, axis=1) / radius + above[:, -1])[:, None]
    is_least = above <= LITTLE_ROUNDING * size
    above = np.where(is_least, 0.0, above)
    is_nothing = np.abs(t) <= LITTLE_ROUNDING * size * radius
    t = np.where(is_least & is_nothing, 0.0, t)
    # the multiplier less the pole, -mu_0
    shift = np.maximum((np.abs(t) / radius - above).max(axis=1), 0.0)
    for _ in range(MAX_ROOT_STEPS):
        away = above + shift[:, None]
        z = np.divide(t, away, out=np.zeros_like(t), where=t != 0)
        reached = (z**2).sum(axis=1)
        excess = np.sqrt(reached) / radius - 1
        going = excess > LITTLE_ROUNDING
        if not going.any():
            break
        slopes = np.divide(z**2, away, out=np.zeros_like(t), where=t != 0)
        slope = slopes.sum(axis=1)
        shift[going] += (excess * reached)[going] / slope[going]
    is_hard = shift == 0
    missing = np.maximum(radius**2 - reached[is_hard], 0.0)
    part = np.einsum("nj,nj->n", V[:, :, 0], before)
    z[is_hard, 0] = np.copysign(np.sqrt(missing), part[is_hard])
    scale = radius / np.linalg.norm(z, axis=1)
    minimum: Floats = np.einsum("nij,nj->ni", V, scale[:, None] * z)
    return minimum

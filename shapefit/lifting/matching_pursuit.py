"""Projected Matching Pursuit: greedy bases of either sign around the mean shape."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from shapefit import core
from shapefit.arrays import Floats
from shapefit.convex.problem import Problem
from shapefit.convex.solver import Status
from shapefit.convex.span import weighted
from shapefit.geometry.rotations import complete_rotation
from shapefit.lifting.estimate import Estimate, fit_translation
from shapefit.lifting.methods import Settings
from shapefit.lifting.reconstruction import combine

# The published rules are in pixels: 500 px^2 for the squared reprojection error of all landmarks,
# 1 px^2 for its change in a round. A normalised unit is the standard deviation of the landmarks.
# A standing person is about 5 of them from ankle to head, 350 px in the images the rules were
# made for: 70 px a unit.
PIXELS = 70.0
GOAL = 500.0 / PIXELS**2
CHANGE = 1.0 / PIXELS**2
MOST_ATOMS, MOST_ROUNDS = 15, 30


@dataclass(frozen=True)
class Pursuit:
    """W ~ M S + T 1^T with S = c_0 mean + sum_i c_i B_i for n images.

    coefficients c (n, k) of either sign; mean_coefficient c_0 (n,); camera M (n, 2, 3), nan where
    there is none; error (n,), ||Omega o (W - M S - T 1^T)||_F^2; rounds (n,) of all inner loops;
    status: CONVERGED where the error reached the goal, ITERATION_LIMIT where the atoms ran out.
    """

    coefficients: Floats
    mean_coefficient: Floats
    camera: Floats
    error: Floats
    rounds: NDArray[np.int64]
    status: tuple[Status, ...]


def pursue(
    problem: Problem,
    mean_shape: Floats,
    edges: NDArray[np.int64] | None,
    *,
    goal: float = GOAL,
    change: float = CHANGE,
    most_atoms: int = MOST_ATOMS,
    most_rounds: int = MOST_ROUNDS,
) -> Pursuit:
    """Lower ||Omega o (W - M S - T 1^T)||_F^2 greedily, keeping the size of the skeleton.

    S = c_0 mean + sum_i c_i B_i with mean_shape (3, p); edges (e, 2) are the limbs, whose squared
    lengths keep the sum they have in the mean shape. It begins with the camera M of the mean
    shape, any 2x3 matrix. While the error is above `goal`, the atom whose projection has the
    largest |inner product| with the residual joins, and a loop of at most `most_rounds` rounds
    minimises over c (globally, on the limb constraint), then over M, until a round changes the
    error by less than `change`. No step raises the error. At most `most_atoms` join; those whose
    limbs are a mixture of the chosen ones' are passed over. lambda is ignored. Raises ValueError
    without limbs of a length, and for another loss than the squared one.

    Source: Ramakrishna, Kanade and Sheikh 2012, with the mean as one more basis shape. The
    constraint then settles how size is shared between S and M, and costs nothing where a loop
    comes to rest; with c_0 = 1 it would leave a single atom no more than two coefficients.
    """
    problem.require_squared("matching pursuit")
    n, k = len(problem.landmarks), len(problem.atoms)
    shapes = np.concatenate([mean_shape[None], problem.atoms])
    limbs = find_limbs(shapes, edges)
    coefficients, camera = np.zeros((n, 1 + k)), np.full((n, 2, 3), np.nan)
    error, rounds = np.full(n, np.nan), np.zeros(n, np.int64)
    status = np.full(n, Status.DEGENERATE, dtype=object)
    with np.errstate(over="ignore"):
        finite = np.isfinite((shapes**2).sum())
    # stretches of images, so that no result depends on how images are batched
    for start in range(0, n, core.STRETCH):
        omega = problem.weights[start : start + core.STRETCH]
        masks, of = np.unique(omega, axis=0, return_inverse=True)
        for number, mask in enumerate(masks):
            rows = start + np.flatnonzero(of.ravel() == number)
            if (mask > 0).sum() < 2:
                continue
            w = weighted(problem.landmarks[rows], problem.weights[rows])
            with np.errstate(over="ignore"):
                fine = np.isfinite((w**2).sum(axis=(1, 2))) & finite
            status[rows[~fine]] = Status.NUMERICAL_FAILURE
            rows = rows[fine]
            if not len(rows):
                continue
            weighted_shapes = weighted(shapes, np.broadcast_to(mask, (len(shapes), len(mask))))
            chase = Chase(w[fine], weighted_shapes, limbs)
            chase.run(goal, change, most_atoms, most_rounds)
            coefficients[rows] = np.einsum("nm,nms->ns", chase.y, chase.T)
            camera[rows], error[rows], rounds[rows] = chase.M, chase.error, chase.rounds
            solved = (chase.error <= goal).tolist()
            status[rows] = [Status.CONVERGED if one else Status.ITERATION_LIMIT for one in solved]
    return Pursuit(coefficients[:, 1:], coefficients[:, 0], camera, error, rounds, tuple(status))


INDEPENDENT = 1e-8
"""Share of squared limb lengths outside those of the chosen, below which a shape is dependent."""

FLAT = 1e-12
"""Eigenvalue of S S^T beside the largest, below which a shape has no extent."""


class Chase:
    """min ||w - M sum_i y_i Q_i||^2 over M and ||y|| = length, for n images of the same weights.

    The chosen shapes are mixed into Q_i = sum_j T_ij B_j whose limb vectors U_i are orthonormal
    (those of the mean first), so that the sum of squared limb lengths of sum_i y_i Q_i is ||y||^2.
    All that a round needs are Z_i = w Q_i^T (n, m, 2, 3) and N_ij = Q_i Q_j^T (n, m, m, 3, 3).
    """

    def __init__(self, w: Floats, B: Floats, limbs: Floats) -> None:
        """Begin with the mean, the first of the shapes B (s, 3, p) with limbs (s, l)."""
        n, s = len(w), len(B)
        self.w, self.B, self.limbs = w, B, limbs
        self.length = float(np.linalg.norm(limbs[0]))
        self.energy = (w**2).sum(axis=(1, 2))
        self.free, self.rounds = np.ones((n, s), dtype=bool), np.zeros(n, np.int64)
        self.T, self.y = np.zeros((n, 0, s)), np.zeros((n, 0))
        self.U = np.zeros((n, 0, limbs.shape[1]))
        self.M, self.error = np.empty((n, 2, 3)), np.empty(n)
        self.append(np.zeros(n, np.intp), np.arange(n))
        self.y[:] = self.length
        self.aim(np.arange(n))

    def run(self, goal: float, change: float, most_atoms: int, most_rounds: int) -> None:
        """Add atoms, and go round with those chosen, until the errors are at most the goal."""
        going = np.flatnonzero(self.error > goal)
        for _ in range(most_atoms):
            going = self.choose(going[self.error[going] > goal])
            rows = going
            for _ in range(most_rounds):
                if not len(rows):
                    break
                before = self.error[rows]
                self.mix(rows)
                self.aim(rows)
                self.rounds[rows] += 1
                rows = rows[~(np.abs(before - self.error[rows]) < change)]

    def choose(self, rows: NDArray[np.intp]) -> NDArray[np.intp]:
        """Add the free atom of the largest |<w - M S, M B_i>| whose limbs are no mixture.

        Returns the images that have one.
        """
        S = np.einsum("nm,nmap->nap", self.y[rows], self.Q[rows])
        back = self.M[rows].swapaxes(1, 2) @ (self.w[rows] - self.M[rows] @ S)
        score = np.abs(np.einsum("nap,sap->ns", back, self.B, optimize=True))
        size, chosen = (self.limbs**2).sum(axis=1), np.full(len(rows), -1)
        some = np.arange(len(rows))
        while len(some):
            best = np.where(self.free[rows[some]], score[some], -1.0)
            some = some[best.max(axis=1) >= 0]
            atom = best[best.max(axis=1) >= 0].argmax(axis=1)
            self.free[rows[some], atom] = False
            rest = self.outside(self.limbs[atom], rows[some])[0]
            fine = (rest**2).sum(axis=1) > INDEPENDENT * size[atom]
            chosen[some[fine]] = atom[fine]
            some = some[~fine]
        added = chosen >= 0
        if added.any():
            self.append(chosen[added], rows[added])
        return rows[added]

    def outside(self, limbs: Floats, rows: NDArray[np.intp]) -> tuple[Floats, Floats]:
        """Return limbs (m, l) less their part along U, and that part; twice, for rounding."""
        U, total = self.U[rows], np.zeros((len(rows), self.U.shape[1]))
        for _ in range(2):
            along = np.einsum("nml,nl->nm", U, limbs)
            limbs = limbs - np.einsum("nm,nml->nl", along, U)
            total += along
        return limbs, total

    def append(self, atoms: NDArray[np.intp], rows: NDArray[np.intp]) -> None:
        """Append one shape to each of the images; the others get zeros."""
        n = len(self.y)
        self.free[rows, atoms] = False
        limbs, along = self.outside(self.limbs[atoms], rows)
        unit, size = np.eye(len(self.B))[atoms], np.linalg.norm(limbs, axis=1)[:, None]
        T, U = np.zeros((n, 1, len(self.B))), np.zeros((n, 1, limbs.shape[1]))
        T[rows, 0] = (unit - np.einsum("nm,nms->ns", along, self.T[rows])) / size
        U[rows, 0] = limbs / size
        self.T, self.U = np.concatenate([self.T, T], axis=1), np.concatenate([self.U, U], axis=1)
        self.y = np.concatenate([self.y, np.zeros((n, 1))], axis=1)
        self.Q = Q = np.tensordot(self.T, self.B, axes=1)
        self.Z = self.w[:, None] @ Q.swapaxes(2, 3)
        self.N = Q[:, :, None] @ Q[:, None].swapaxes(3, 4)

    def aim(self, rows: NDArray[np.intp]) -> None:
        """M = argmin ||w - M S||^2 for S = sum_i y_i Q_i, of least norm; and the minimum."""
        y = self.y[rows]
        D = np.einsum("nm,nmab->nab", y, self.Z[rows])
        yy = (y[:, :, None] * y[:, None]).reshape(len(rows), 1, -1)
        SS = (yy @ self.N[rows].reshape(len(rows), -1, 9)).reshape(-1, 3, 3)
        extent, axes = np.linalg.eigh(SS)
        along = D @ axes
        there = extent > FLAT * extent[:, -1:]
        share = np.divide(1.0, extent, out=np.zeros_like(extent), where=there)[:, None]
        self.M[rows] = (along * share) @ axes.swapaxes(1, 2)
        self.error[rows] = np.maximum(self.energy[rows] - (along**2 * share).sum(axis=(1, 2)), 0.0)

    def mix(self, rows: NDArray[np.intp]) -> None:
        """y = argmin ||w - sum_i y_i M Q_i||^2 over ||y|| = length, from where y is."""
        M = self.M[rows]
        P = M.swapaxes(1, 2) @ M
        used = (self.T[rows] != 0).any(axis=2)
        m = self.y.shape[1]
        G = (self.N[rows].reshape(-1, m * m, 9) @ P.reshape(-1, 9, 1)).reshape(-1, m, m)
        g = np.einsum("nab,nmab->nm", M, self.Z[rows])
        # shapes that an image lacks cost too much to be used
        i = np.arange(m)
        G[:, i, i] += np.where(used, 0.0, UNUSED * (1 + np.abs(G).sum(axis=(1, 2)))[:, None])
        self.y[rows] = minimise_on_sphere(G, g, self.length, self.y[rows])[0]


UNUSED = 1e3
"""Curvature of what is not chosen, beside that of all that is."""

ROUNDING = 64 * np.finfo(np.float64).eps
MOST_STEPS = 100


def minimise_on_sphere(
    G: Floats, g: Floats, radius: float, before: Floats
) -> tuple[Floats, Floats]:
    """argmin y^T G y - 2 g^T y over ||y|| = radius, of two the one nearer to `before`; multipliers.

    G (n, m, m) symmetric, g and before (n, m). (G + multiplier I) y = g, that matrix positive
    semidefinite: at the largest root of

        sum_i (t_i / (mu_i + multiplier))^2 = radius^2,      G = V diag(mu) V^T, t = V^T g.

    1 / ||y|| is a concave function of the multiplier right of the last pole: Newton's method from
    the left of the root never overshoots. Where g has no part along the least eigenvalue the pole
    may be none, and the root may lie left of it: then the multiplier is the pole and the
    eigenvector fills up y (the hard case). Source: Gander 1981; More and Sorensen 1983.
    """
    mu, V = np.linalg.eigh(G)
    above = mu - mu[:, :1]
    t = np.einsum("nij,ni->nj", V, g)
    size = (np.linalg.norm(t, axis=1) / radius + above[:, -1])[:, None]  # of G + multiplier I
    least = above <= ROUNDING * size
    above = np.where(least, 0.0, above)
    t = np.where(least & (np.abs(t) <= ROUNDING * size * radius), 0.0, t)
    shift = np.maximum((np.abs(t) / radius - above).max(axis=1), 0.0)
    for _ in range(MOST_STEPS):
        away = above + shift[:, None]
        z = np.divide(t, away, out=np.zeros_like(t), where=t != 0)
        reached = (z**2).sum(axis=1)
        excess = np.sqrt(reached) / radius - 1
        going = excess > ROUNDING
        if not going.any():
            break
        slope = np.divide(z**2, away, out=np.zeros_like(t), where=t != 0).sum(axis=1)
        shift[going] += (excess * reached)[going] / slope[going]
    hard = shift == 0
    part = np.einsum("nj,nj->n", V[:, :, 0], before)
    z[hard, 0] = np.copysign(np.sqrt(np.maximum(radius**2 - reached[hard], 0.0)), part[hard])
    scale = radius / np.linalg.norm(z, axis=1)
    return np.einsum("nij,nj->ni", V, scale[:, None] * z), shift - mu[:, 0]


def find_limbs(shapes: Floats, edges: NDArray[np.int64] | None) -> Floats:
    """Limb vectors (n, 3 e) of shapes (n, 3, p), one per edge (e, 2).

    Raises ValueError where there is none, or all are 0 in the first shape.
    """
    if edges is None or len(edges) == 0:
        raise ValueError("matching pursuit needs edges, the limbs whose lengths it keeps")
    limbs = shapes[:, :, edges[:, 0]] - shapes[:, :, edges[:, 1]]
    if not np.linalg.norm(limbs[0]) > 0:
        raise ValueError("every edge of the mean shape has length 0")
    return np.ascontiguousarray(limbs.reshape(len(shapes), -1))


def lift_by_pursuit(problem: Problem, settings: Settings) -> Estimate:
    """Pursue the landmarks with PCA bases (Ramakrishna, Kanade, Sheikh, ECCV 2012).

    The shape has the rotation nearest to the camera: M = U diag(s) V^T gives the two rows U V^T of
    the rotation and the scale (s_1 + s_2) / 2, which the coefficients take up. The objective is the
    squared error with M itself; the residual belongs to the rotated shape, as with every method.
    """
    mean_shape = settings.mean_shape
    found = pursue(problem, mean_shape, settings.needs.get("edges"))
    known = np.isfinite(found.camera).all(axis=(1, 2), keepdims=True)
    M = np.where(known, found.camera, 0.0)
    rotation = complete_rotation(M)
    scale = np.linalg.svd(M, compute_uv=False).mean(axis=1)
    c = scale[:, None] * found.coefficients
    S = combine(c, problem.atoms) + (scale * found.mean_coefficient)[:, None, None] * mean_shape
    shapes = rotation @ S
    placed = fit_translation(problem, shapes)
    return Estimate(
        shapes=shapes,
        translation=placed.translation,
        rotation=np.where(known, rotation, np.nan),
        objective=found.error,
        residual=placed.residual,
        iterations=found.rounds,
        status=found.status,
        coefficients=c,
        active_atoms=np.count_nonzero(c, axis=1),
    )

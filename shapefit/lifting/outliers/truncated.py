"""Truncated least squares around the convex program, by graduated non-convexity.

min over shapes of sum_j min(r_j^2, threshold^2): the surrogates of the truncated square grow from
nearly convex to the square itself, and each is minimised by weighted least squares with weights in
closed form. Source: Yang, Antonante, Tzoumas and Carlone, Graduated non-convexity for robust
spatial perception, RA-L 2020, section IV.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from shapefit.arrays import Flags, Floats
from shapefit.convex.problem import Problem
from shapefit.convex.solution import Solution
from shapefit.core.stretches import run_stretches
from shapefit.geometry.normalisation import spread
from shapefit.lifting.degeneracy import BEYOND_CHANCE
from shapefit.lifting.reconstruction import reconstruct

Solve = Callable[[Problem], Solution]

# Of mu from round to round, as in the paper. 10 takes a quarter of the time, and on the cars of the
# sample data loses the pose in 15% of the images with half of the landmarks wrong; 1.4 in 5%.
GROWTH = 1.4
BINARY = 1e-3  # weights are binary where none is farther from both 0 and 1


def find_untruncated(
    landmarks: Floats,
    weights: Floats,
    atoms: Floats,
    solve: Solve,
    *,
    lam: float,
    threshold: float,
    max_rounds: int,
    threads: int = 0,
) -> Flags:
    """Landmarks (n, p) whose residual is not truncated in the end, the inliers.

    landmarks (n, 2, p) in any unit, whatever where hidden; weights (n, p), 0 = hidden; atoms
    (k, 3, p). Each round solves the squared program with Omega sqrt(share), share in 0..1, on
    landmarks normalised by their shares, at lambda times the mean share, so that the weight of the
    data beside the shape stays. Residuals count in units of the size of the shape found. An image
    ends when its shares are binary and stay, or after `max_rounds`; it has no inliers where fewer
    than BEYOND_CHANCE landmarks keep a share, or no shape is found. Images that are left start
    from one another's solutions, so each stretch of images is searched by itself: where the next
    one begins, and how many there are, does not matter. `threads` = 0 is one per core.
    """
    inliers = np.zeros(weights.shape, dtype=bool)

    def work(part: slice) -> None:
        inliers[part] = _search_stretch(
            landmarks[part], weights[part], atoms, solve, lam, threshold, max_rounds
        )

    run_stretches(len(landmarks), work, threads)
    return inliers


def _search_stretch(
    landmarks: Floats,
    weights: Floats,
    atoms: Floats,
    solve: Solve,
    lam: float,
    threshold: float,
    max_rounds: int,
) -> Flags:
    """Search the images of one stretch."""
    visible = weights > 0
    share = visible.astype(np.float64)
    mu = np.full(len(landmarks), np.nan)
    share[visible.sum(axis=1) < BEYOND_CHANCE] = 0.0
    live = np.flatnonzero(share.any(axis=1))
    for _ in range(max_rounds):
        if not len(live):
            break
        before = share[live]
        problem = weigh(landmarks[live], weights[live], before, atoms, lam)
        square = residual_squares(problem, solve(problem)) / threshold**2
        square = np.where(visible[live], square, 0.0)
        mu[live] = np.where(np.isnan(mu[live]), first_mu(square), GROWTH * mu[live])
        after = np.where(visible[live], share_of(square, mu[live]), 0.0)
        lost = (after > 0).sum(axis=1) < BEYOND_CHANCE
        after[lost] = 0.0
        share[live] = after
        binary = (np.minimum(after, 1 - after) <= BINARY).all(axis=1)
        still = ((after > 0.5) == (before > 0.5)).all(axis=1)
        live = live[~(lost | (binary & still))]
    return share > 0.5


def weigh(landmarks: Floats, weights: Floats, share: Floats, atoms: Floats, lam: float) -> Problem:
    """Return the squared program of landmarks (n, 2, p) that count by their shares (n, p) in 0..1.

    The shares also say what is normalised: their weighted mean becomes 0 and the mean over
    coordinates of their standard deviation 1, or all landmarks 0 where they coincide.
    """
    visible = weights > 0
    total = share.sum(axis=1)
    portion = (share / total[:, None])[:, None]
    W = np.where(visible[:, None], landmarks, 0.0)
    W = np.where(visible[:, None], W - (W * portion).sum(axis=2, keepdims=True), 0.0)
    scale = np.sqrt((W**2 * portion).sum(axis=2)).mean(axis=1)[:, None, None]
    W = np.divide(W, scale, out=np.zeros_like(W), where=scale > 0)
    return Problem(W, weights * np.sqrt(share), atoms, lam * total / visible.sum(axis=1))


def residual_squares(problem: Problem, solution: Solution) -> Floats:
    """Return min over s, T of ||w_j - s S_j - T||^2 / (s size of S)^2 for each landmark (n, p).

    s and T are the best for the weights of the problem: the penalty has shrunk the shapes, and
    what is judged should not be. inf where there is no shape with s > 0. Landmarks of weight 0
    are judged like the others.
    """
    S = reconstruct(solution.transforms, problem.atoms, threads=1).shapes
    portion = problem.weights**2
    portion = (portion / portion.sum(axis=1, keepdims=True))[:, None]
    W, F = problem.landmarks, S[:, :2]
    W = W - (W * portion).sum(axis=2, keepdims=True)
    F = F - (F * portion).sum(axis=2, keepdims=True)
    overlap, square = ((X * F * portion).sum(axis=(1, 2)) for X in (W, F))
    s = np.divide(overlap, square, out=np.zeros_like(overlap), where=square > 0)
    unit = (s * spread(S))[:, None]
    left = ((W - s[:, None, None] * F) ** 2).sum(axis=1)
    return np.divide(left, unit**2, out=np.full_like(left, np.inf), where=unit > 0)


def first_mu(square: Floats) -> Floats:
    """Return the mu (n,) at which the surrogate is convex over all residuals; inf if it always is.

    square (n, p): r^2 / threshold^2.
    """
    excess = 2 * square.max(axis=1) - 1
    return np.divide(1.0, excess, out=np.full_like(excess, np.inf), where=excess > 0)


def share_of(square: Floats, mu: Floats) -> Floats:
    """argmin over w in 0..1 of w q + mu (1 - w) / (mu + w), for q = r^2 / threshold^2 (n, p).

    mu (n,) > 0: 1 up to q = mu / (mu + 1), 0 from (mu + 1) / mu on, sqrt(mu (mu + 1) / q) - mu
    between; the truncated square itself, 1 up to q = 1, where mu is inf.
    """
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        m = mu[:, None]
        between = np.sqrt(m * (m + 1) / square) - m
        low, high = m / (m + 1), (m + 1) / m
    sharp = np.isinf(m)
    low, high = np.where(sharp, 1.0, low), np.where(sharp, 1.0, high)
    return np.where(square <= low, 1.0, np.where(square >= high, 0.0, between))

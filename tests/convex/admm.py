"""The paper's ADMM (section Optimization), for a batch of images at once: the readable reference.

With V = M + Y / mu the update of Z is Z = V + (W - V B)(mu I + B^T B)^-1 B^T, so Y / mu after it
is V_old - Z = -E B^T with E = (W - V B)(mu I + B^T B)^-1: the iteration needs M and the small E
(2 x q) only, never a 3k x 3k factor. In the eigenbasis of B^T B that inverse is a division, so a
change of mu costs nothing.
"""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats
from shapefit.convex.problem import Problem
from shapefit.convex.solver import Solution, Status
from shapefit.convex.transforms import Transforms, sum_and_difference
from tests.convex.certificate import certify_transforms

BATCH = 256
CHECK_EVERY = 10
# mu doubles or halves when one relative residual exceeds the other by this factor.
IMBALANCE = 10.0


def solve_admm(
    problem: Problem,
    *,
    tolerance: float = 1e-4,
    stop: Literal["gap", "change"] = "gap",
    max_iterations: int = 1000,
) -> Solution:
    """Solve every image by the paper's ADMM (eqs admm1, admm2, admm3); squared loss only.

    `stop` = "gap": until the relative duality gap is <= tolerance, looked at every CHECK_EVERY
    iterations. "change": the paper's rule, until ||M - Z|| / max(||M||, ||Z||) and
    mu ||Z - Z_old|| / ||Y|| are <= tolerance; an image that meets it with a larger gap has
    CONVERGED. An image with fewer than two visible landmarks is DEGENERATE. Raises ValueError for
    any other loss.
    """
    problem.require_squared("the ADMM")
    n, _, p = problem.landmarks.shape
    k = len(problem.atoms)
    transforms, dual = np.zeros((n, k, 2, 3)), np.zeros((n, 2, p))
    steps, stopped = np.zeros(n, np.int64), np.zeros(n, dtype=bool)
    solvable = (problem.weights > 0).sum(axis=1) >= 2
    for start in range(0, n, BATCH):
        part = start + np.flatnonzero(solvable[start : start + BATCH])
        if len(part):
            found = _solve_batch(problem.take(part), tolerance, stop, max_iterations)
            transforms[part], dual[part], steps[part], stopped[part] = found

    translation, errors = np.zeros((n, 2)), np.zeros((n, 2, p))
    objective, gap, residual = np.full(n, np.nan), np.full(n, np.nan), np.full(n, np.nan)
    proof = certify_transforms(problem.take(solvable), transforms[solvable], dual[solvable])
    objective[solvable], gap[solvable] = proof.objective, proof.relative_gap
    residual[solvable], translation[solvable] = proof.residual, proof.translation
    dual[solvable] = proof.dual

    def judge(image: int) -> Status:
        if not solvable[image]:
            return Status.DEGENERATE
        if not np.isfinite(gap[image]):
            return Status.NUMERICAL_FAILURE
        if gap[image] <= tolerance:
            return Status.OPTIMAL
        return Status.CONVERGED if stopped[image] else Status.ITERATION_LIMIT

    status = tuple(judge(image) for image in range(n))
    return Solution(
        Transforms.of(transforms),
        translation,
        dual,
        errors,
        objective,
        gap,
        residual,
        steps,
        status,
    )


def prox_spectral_norm(Q: Floats, t: Floats | float) -> Floats:
    """argmin_X 1/2 ||Q - X||_F^2 + t ||X||_2 for blocks (..., 2, 3) (paper, eq. prox-2norm).

    t > 0 broadcasts over the blocks. X = 0 where s1 + s2 <= t; both singular values become
    (s1 + s2 - t) / 2 where s1 - s2 <= t; otherwise only s1 falls, by t.
    """
    total, difference, product = sum_and_difference(Q)
    A = Q @ np.swapaxes(Q, -1, -2)
    s1, s2 = (total + difference) / 2, (total - difference) / 2
    eye = np.eye(2)

    def block(scalar: NDArray[Any]) -> NDArray[Any]:
        return scalar[..., None, None]

    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        # U V^T = A^(-1/2) Q with A^(-1/2) = ((tr A + r) I - A) / (r (s1 + s2))
        trace = (A[..., 0, 0] + A[..., 1, 1]) + product
        polar = (block(trace) * eye - A) @ Q / block(product * total)
        equal = block((total - t) / 2) * polar
        # u1 u1^T = (A - s2^2 I) / (s1^2 - s2^2)
        leading = (A - block(s2**2) * eye) / block(total * difference)
        shrunk = Q - block(t / s1) * (leading @ Q)
    # In a block of rank one up to rounding U V^T is noise; there both formulas are zero up to it.
    tight = block((difference <= t) & (product > 1e-16 * total**2))
    return np.where(block(total <= t), 0.0, np.where(tight, equal, shrunk))


class _Centred:
    """A problem with the translation eliminated: Omega o W and B Omega, orthogonal to omega.

    W (n, 2, p); B (n, 3 k, p); basis U (n, p, p) and eigenvalues (n, p) of sum_i B_i^T B_i.
    """

    def __init__(self, problem: Problem) -> None:
        omega = problem.weights
        unit = omega / np.linalg.norm(omega, axis=1, keepdims=True)
        drop = np.eye(omega.shape[1]) - unit[:, :, None] * unit[:, None, :]
        visible = omega[:, None, :] > 0
        self.W = (np.where(visible, problem.landmarks, 0.0) * omega[:, None, :]) @ drop
        same = bool((omega == omega[0]).all())  # then one B serves all
        first = slice(0, 1) if same else slice(None)
        B = (problem.atoms * omega[first, None, None, :]) @ drop[first, None]
        self.B = B.reshape(len(B), -1, omega.shape[1])
        self.eigenvalues, self.U = np.linalg.eigh(self.B.swapaxes(1, 2) @ self.B)

    def take(self, rows: NDArray[np.bool_]) -> _Centred:
        """Keep some of the images."""
        kept = object.__new__(_Centred)
        for name, values in vars(self).items():
            setattr(kept, name, values if len(values) == 1 < len(rows) else values[rows])
        return kept

    def combine(self, M: Floats) -> Floats:
        """sum_i M_i B_i; M (n, k, 2, 3) -> (n, 2, p)."""
        n, k = M.shape[:2]
        return M.transpose(0, 2, 1, 3).reshape(n, 2, 3 * k) @ self.B

    def correlate(self, E: Floats) -> Floats:
        """E B_i^T for all atoms; E (n, 2, p) -> (n, k, 2, 3)."""
        product = E @ self.B.swapaxes(1, 2)
        return product.reshape(len(E), 2, -1, 3).swapaxes(1, 2)

    def divide(self, X: Floats, mu: Floats) -> Floats:
        """X (mu I + B^T B)^-1; X (n, 2, p), mu (n,)."""
        return (X @ self.U) / (mu[:, None] + self.eigenvalues)[:, None, :] @ self.U.swapaxes(1, 2)


def _solve_batch(
    problem: Problem, tolerance: float, stop: str, most: int
) -> tuple[Floats, Floats, NDArray[np.int64], NDArray[np.bool_]]:
    """Transforms, duals, iterations, and whether the stopping rule was met, of a batch."""
    n, _, p = problem.landmarks.shape
    k = len(problem.atoms)
    M_out, Y_out = np.zeros((n, k, 2, 3)), np.zeros((n, 2, p))
    steps, met = np.full(n, most), np.zeros(n, dtype=bool)
    images = _Centred(problem)
    left = np.arange(n)
    size = np.abs(images.W).mean(axis=(1, 2))
    mu = 1.0 / np.where(size > 0, size, 1.0)
    M, Z, E = np.zeros((n, k, 2, 3)), np.zeros((n, k, 2, 3)), np.zeros((n, 2, p))
    for step in range(1, most + 1):
        Q = Z + images.correlate(E)  # Z - Y / mu
        M = prox_spectral_norm(Q, (problem.lam / mu)[:, None])
        V = M - images.correlate(E)  # M + Y / mu
        E = images.divide(images.W - images.combine(V), mu)
        Z_old, Z = Z, V + images.correlate(E)

        primal = _norm(M - Z) / np.maximum(np.maximum(_norm(M), _norm(Z)), 1e-300)
        dual = _norm(Z - Z_old) / np.maximum(_norm(images.correlate(E)), 1e-300)
        done = (primal <= tolerance) & (dual <= tolerance) & (stop == "change")
        if stop == "gap" and (step % CHECK_EVERY == 0 or step == most):
            gap = certify_transforms(problem, M, mu[:, None, None] * E).relative_gap
            done = gap <= tolerance
        if done.any() or step == most:
            ended = done if step < most else np.ones(len(left), dtype=bool)
            at = left[ended]
            M_out[at], met[at], steps[at] = M[ended], done[ended], step
            Y_out[at] = mu[ended, None, None] * E[ended]
            if ended.all():
                break
            problem, images = problem.take(~ended), images.take(~ended)
            left, mu = left[~ended], mu[~ended]
            M, Z, E, primal, dual = (x[~ended] for x in (M, Z, E, primal, dual))
        factor = np.where(
            primal > IMBALANCE * dual, 2.0, np.where(dual > IMBALANCE * primal, 0.5, 1.0)
        )
        mu = mu * factor
        E = E / factor[:, None, None]  # Y = -mu E B^T stays as it is
    return M_out, Y_out, steps, met


def _norm(X: Floats) -> Floats:
    return np.linalg.norm(X.reshape(len(X), -1), axis=1)

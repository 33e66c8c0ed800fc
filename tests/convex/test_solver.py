"""The fast solver: certified statuses, problems built from their optimum, cvxpy with
Clarabel.
"""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from shapefit.convex.problem import Loss, Problem, build_problem
from shapefit.convex.solver import Status, solve_newton
from shapefit.convex.transforms import nuclear_norm
from tests.convex.conftest import assert_certified, judge


@pytest.mark.parametrize("tolerance", [1e-2, 1e-4, 1e-6, 1e-8])
def test_every_image_is_certified(make_problem, loss, tolerance):
    problem = make_problem(40, loss=loss)
    assert_certified(problem, solve_newton(problem, tolerance=tolerance), tolerance)


def test_iteration_limit_comes_with_its_honest_gap(make_problem, loss):
    problem = make_problem(20, loss=loss)
    found = solve_newton(problem, max_iterations=2)
    assert Status.ITERATION_LIMIT in found.status
    assert (found.iterations <= 2).all()
    P, D, residual = judge(
        problem, found.transforms.dense(), found.translation, found.dual
    )
    for image, status in enumerate(found.status):
        gap = (P[image] - D[image]) / P[image]
        met = loss is not Loss.EXACT or residual[image] <= 1e-4
        honest = pytest.approx(gap if met else np.nan, rel=1e-9, abs=1e-12, nan_ok=True)
        assert found.relative_gap[image] == honest
        assert (status is Status.OPTIMAL) == (met and abs(gap) <= 1e-4)


def test_few_visible_landmarks(make_problem, loss):
    problem = make_problem(70, loss=loss)
    weights = problem.weights.copy()
    weights[3, 1:] = 0
    weights[4] = 0
    weights[66:, 1:] = 0
    found = solve_newton(replace(problem, weights=weights))
    lost = np.isin(np.arange(70), [3, 4, 66, 67, 68, 69])
    assert [status is Status.DEGENERATE for status in found.status] == lost.tolist()
    assert {found.status[i] for i in np.flatnonzero(~lost)} == {Status.OPTIMAL}
    for values in (found.objective, found.relative_gap, found.residual):
        assert (np.isnan(values) == lost).all()
    assert not found.transforms.dense()[lost].any()
    # the neighbours do not feel it
    alone = solve_newton(replace(problem, weights=weights).take(np.array([2, 5])))
    np.testing.assert_allclose(alone.objective, found.objective[[2, 5]], rtol=2e-4)


def test_overflow_is_a_numerical_failure_and_spares_the_next(make_problem, loss):
    problem = make_problem(3, loss=loss)
    landmarks = problem.landmarks.copy()
    landmarks[1] *= 1e200
    found = solve_newton(replace(problem, landmarks=landmarks))
    assert found.status == (Status.OPTIMAL, Status.NUMERICAL_FAILURE, Status.OPTIMAL)


def test_exact_program_without_a_solution_is_never_optimal(rng):
    problem = build_problem(
        rng.standard_normal((5, 2, 9)),
        rng.standard_normal((1, 3, 9)),
        1.0,
        loss=Loss.EXACT,
    )
    found = solve_newton(problem)
    assert Status.OPTIMAL not in found.status
    assert (found.residual > 0.1).all()


@pytest.mark.parametrize("second", [1.0, 1 - 1e-9, 1e-9, 0.0])
@pytest.mark.parametrize("size", [1e-60, 1.0, 1e60])
def test_the_nuclear_norm_is_the_sum_of_singular_values(rng, second, size):
    U, V = (np.linalg.qr(rng.standard_normal((m, m)))[0] for m in (2, 3))
    blocks = size * (U @ np.diag([1.0, second]) @ V[:2])
    np.testing.assert_allclose(nuclear_norm(blocks), size * (1 + second), rtol=1e-14)


LAM, BETA = 0.7, 0.4


@dataclass(frozen=True)
class Planted:
    problem: Problem
    transforms: np.ndarray
    translation: np.ndarray
    dual: np.ndarray
    objective: float


def plant(seed: int, loss: Loss, *, weighted: bool, k: int = 9, p: int = 14) -> Planted:
    """Choose a dual Y, scale atoms until those that shall be active touch the bound,
    set W.

    Y omega = 0 and Y = 0 where hidden; ||(Omega o Y) B_i^T||_* = lambda where M_i = c_i
    U V^T from the SVD of (Omega o Y) B_i^T, less elsewhere; r is in the subdifferential
    of f* at Y.
    """
    rng = np.random.default_rng(seed)
    omega = np.ones(p)
    if weighted:
        omega = rng.uniform(0.3, 1.5, p) * (np.arange(p) % 5 != 4)
    if loss is Loss.EXACT:
        omega = (omega > 0).astype(float)
    bound = {Loss.ABSOLUTE: 1.0, Loss.SPARSE_ERROR: BETA}.get(loss, np.inf)
    Y = 0.25 * min(bound, 4.0) * rng.uniform(-1, 1, (2, p)) * (omega > 0)
    outlier = np.zeros((2, p), dtype=bool)
    if np.isfinite(bound):
        outlier[:, 2] = outlier[0, 6] = True
        Y[outlier] = bound * rng.choice([-1, 1], 3)
    free = ~outlier * omega
    Y -= (Y @ omega / (free @ omega))[:, None] * free
    assert (np.abs(Y[~outlier]) < 0.95 * bound).all()
    np.testing.assert_allclose(Y @ omega, 0, atol=1e-14)

    atoms = rng.standard_normal((k, 3, p))
    nuclear = np.linalg.svd((Y * omega) @ atoms.swapaxes(1, 2), compute_uv=False).sum(
        axis=1
    )
    active = np.arange(k) < 3
    touch = np.where(active, 1.0, rng.uniform(0.2, 0.9, k))
    atoms *= (LAM * touch / nuclear)[:, None, None]
    U, _, Vt = np.linalg.svd((Y * omega) @ atoms.swapaxes(1, 2), full_matrices=False)
    c = rng.uniform(0.5, 2, k) * active
    M = c[:, None, None] * (U @ Vt)
    T = rng.standard_normal(2)

    gross = np.sign(Y) * outlier * rng.uniform(0.5, 2, (2, p))
    residual = {
        Loss.SQUARED: Y,
        Loss.EXACT: np.zeros((2, p)),
        Loss.ABSOLUTE: gross,
        Loss.SPARSE_ERROR: Y + gross,
    }[loss]
    f = {
        Loss.SQUARED: 0.5 * (Y**2).sum(),
        Loss.EXACT: 0.0,
        Loss.ABSOLUTE: np.abs(gross).sum(),
        Loss.SPARSE_ERROR: 0.5 * (Y**2).sum() + BETA * np.abs(gross).sum(),
    }[loss]
    shape = np.einsum("kab,kbp->ap", M, atoms) + T[:, None]
    W = shape + np.divide(residual, omega, out=np.zeros((2, p)), where=omega > 0)
    W[:, omega == 0] = np.nan
    problem = build_problem(W, atoms, LAM, weights=omega[None], loss=loss, beta=BETA)
    return Planted(problem, M, T, Y, f + LAM * c.sum())


@pytest.mark.parametrize("weighted", [False, True], ids=["plain", "weighted"])
@pytest.mark.parametrize("seed", range(5))
def test_planted_optimum_is_found(loss, seed, weighted):
    planted = plant(seed, loss, weighted=weighted)
    found = solve_newton(planted.problem, tolerance=1e-11)
    assert found.status == (Status.OPTIMAL,)
    assert found.objective[0] == pytest.approx(planted.objective, rel=1e-10)
    # the active atoms are in general position, so the optimum is the only one
    np.testing.assert_allclose(
        found.transforms.dense()[0], planted.transforms, atol=1e-4
    )
    np.testing.assert_allclose(found.translation[0], planted.translation, atol=1e-4)
    if loss.has_quadratic:  # D is strongly concave, so Y is unique
        np.testing.assert_allclose(found.dual[0], planted.dual, atol=1e-4)


class Clarabel:
    """The program of one image as the paper writes it, built once for a size and a
    loss.

    cvxpy comes with the packages of the slow tests.
    """

    def __init__(self, k: int, p: int, loss: Loss) -> None:
        import cvxpy as cp

        self.W, self.omega = cp.Parameter((2, p)), cp.Parameter((1, p))
        self.B, self.lam = cp.Parameter((3 * k, p)), cp.Parameter(nonneg=True)
        self.beta = cp.Parameter(nonneg=True)
        M, T, E = (
            [cp.Variable((2, 3)) for _ in range(k)],
            cp.Variable((2, 1)),
            cp.Variable((2, p)),
        )
        r = (
            self.W - cp.hstack(M) @ self.B - T @ self.omega
        )  # weights are in W and B already
        f = {
            Loss.SQUARED: cp.sum_squares(r) / 2,
            Loss.EXACT: cp.Constant(0),
            Loss.ABSOLUTE: cp.sum(cp.abs(r)),
            Loss.SPARSE_ERROR: (
                cp.sum_squares(r - E) / 2 + self.beta * cp.sum(cp.abs(E))
            ),
        }[loss]
        norms = cp.sum(cp.hstack([cp.sigma_max(block) for block in M]))
        constraints = [r == 0] if loss is Loss.EXACT else []
        self.program = cp.Problem(cp.Minimize(f + self.lam * norms), constraints)
        assert self.program.is_dpp()

    def solve(self, problem: Problem, image: int) -> float:
        omega = problem.weights[image]
        self.W.value = problem.landmarks[image] * omega
        self.omega.value = omega[None]
        self.B.value = (problem.atoms * omega).reshape(-1, len(omega))
        self.lam.value, self.beta.value = problem.lam[image], problem.beta
        self.program.solve(solver="CLARABEL")  # to 1e-8, or as near as it gets
        return float(self.program.value)


def assert_agreement(problem: Problem) -> None:
    found = solve_newton(problem, tolerance=1e-9)
    assert set(found.status) == {Status.OPTIMAL}
    judge = Clarabel(len(problem.atoms), problem.landmarks.shape[2], problem.loss)
    expected = [judge.solve(problem, image) for image in range(len(problem.landmarks))]
    size = (
        1e-9 * np.abs(problem.landmarks).max()
    )  # an absolute accuracy, where all is zero
    np.testing.assert_allclose(found.objective, expected, rtol=1e-6, atol=size)


@pytest.mark.slow
@pytest.mark.parametrize(("n", "k", "p"), [(80, 3, 5), (60, 7, 8), (40, 12, 10)])
def test_squared_loss_on_random_images(make_problem, rng, n, k, p):
    problem = make_problem(n, k, p)
    lam = 10 ** rng.uniform(-2, 0.5, n)
    assert_agreement(
        build_problem(problem.landmarks, problem.atoms, lam, weights=problem.weights)
    )


@pytest.mark.slow
@pytest.mark.parametrize("loss", [Loss.EXACT, Loss.ABSOLUTE, Loss.SPARSE_ERROR])
@pytest.mark.parametrize(("k", "p"), [(4, 6), (9, 9)])
def test_other_losses_on_random_images(make_problem, loss, k, p):
    assert_agreement(make_problem(10, k, p, loss=loss))

"""The fast solver: certified statuses, problems built from their optimum, cvxpy with
Clarabel.
"""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from shapefit.convex.problem import Loss, Problem, build_problem
from shapefit.convex.solver import Status, solve_newton
from shapefit.convex.transforms import nuclear_norm
from tests.convex.conftest import assert_certified, judge
from tests.points import resized, transpose, with_noise


@pytest.mark.parametrize("tolerance", [1e-2, 1e-4, 1e-6, 1e-8])
def test_every_image_is_certified(make_problem, loss, tolerance):
    problem = make_problem(40, loss=loss)
    solution = solve_newton(problem, tolerance=tolerance)
    assert_certified(problem, solution, tolerance)


def test_iteration_limit_comes_with_its_honest_gap(make_problem, loss):
    problem = make_problem(20, loss=loss)

    solution = solve_newton(problem, max_iterations=2)

    assert Status.ITERATION_LIMIT in solution.status
    assert (solution.iterations <= 2).all()
    M = solution.transforms.dense()
    P, D, residual = judge(problem, M, solution.translation, solution.dual)
    gap = (P - D) / P
    meets_constraint = residual <= 1e-4
    if loss is not Loss.EXACT:
        meets_constraint[:] = True
    honest = np.where(meets_constraint, gap, np.nan)
    assert_allclose(solution.relative_gap, honest, rtol=1e-9, atol=1e-12)
    is_optimal = [status is Status.OPTIMAL for status in solution.status]
    assert_array_equal(is_optimal, meets_constraint & (np.abs(gap) <= 1e-4))


LOST = np.array([3, 4, 66, 67, 68, 69])
"""Images of which fewer than two landmarks are seen."""


@pytest.fixture
def few_visible(make_problem, loss):
    """A problem of 70 images, some of them LOST."""
    problem = make_problem(70, loss=loss)
    weights = problem.weights.copy()
    weights[3, 1:] = 0
    weights[4] = 0
    weights[66:, 1:] = 0
    return replace(problem, weights=weights)


def test_images_with_too_few_visible_landmarks_are_degenerate(few_visible):
    solution = solve_newton(few_visible)

    lost = np.isin(np.arange(70), LOST)
    is_degenerate = [status is Status.DEGENERATE for status in solution.status]
    assert is_degenerate == lost.tolist()
    assert_array_equal(np.isnan(solution.objective), lost)
    assert_array_equal(np.isnan(solution.relative_gap), lost)
    assert_array_equal(np.isnan(solution.residual), lost)
    assert not solution.transforms.dense()[lost].any()
    assert not solution.translation[lost].any()
    assert not solution.dual[lost].any()
    assert not solution.errors[lost].any()


def test_images_beside_degenerate_ones_do_not_feel_them(few_visible):
    neighbours = np.array([2, 5])

    solution = solve_newton(few_visible)
    alone = solve_newton(few_visible.take(neighbours))

    seen = np.setdiff1d(np.arange(70), LOST)
    assert {solution.status[i] for i in seen} == {Status.OPTIMAL}
    assert_allclose(alone.objective, solution.objective[neighbours], rtol=2e-4)


def test_overflow_is_a_numerical_failure_and_spares_the_next(make_problem, loss):
    problem = make_problem(3, loss=loss)
    landmarks = problem.landmarks.copy()
    landmarks[1] *= 1e200

    solution = solve_newton(replace(problem, landmarks=landmarks))

    first, overflown, last = solution.status
    assert overflown is Status.NUMERICAL_FAILURE
    assert first is Status.OPTIMAL
    assert last is Status.OPTIMAL


def test_exact_program_without_a_solution_is_never_optimal(rng):
    landmarks = rng.standard_normal((5, 2, 9))
    one_atom = rng.standard_normal((1, 3, 9))
    problem = build_problem(landmarks, one_atom, 1.0, loss=Loss.EXACT)

    solution = solve_newton(problem)

    assert Status.OPTIMAL not in solution.status
    assert (solution.residual > 0.1).all()


def random_orthogonal(rng, size):
    return np.linalg.qr(rng.standard_normal((size, size)))[0]


@pytest.mark.parametrize("threads", [1, 4])
@pytest.mark.parametrize("p", [10, 210])
def test_images_start_from_others_of_their_group_alone(make_problem, rng, threads, p):
    """Each group of a problem has the bits that it has by itself."""
    counts = [1, 70, 1, 1, 130, 63]
    group = np.repeat(np.arange(len(counts)), counts)
    one = make_problem(n=1, p=p, k=3, lam=0.01, weighted=False)
    shaken = with_noise(np.repeat(one.landmarks, len(group), axis=0), 0.01, rng)
    together = replace(
        one,
        landmarks=shaken,
        weights=np.repeat(one.weights, len(group), axis=0),
        lam=np.repeat(one.lam, len(group)),
        group=group,
    )

    solution = solve_newton(together, threads=threads)

    alone = [
        solve_newton(replace(together.take(group == number), group=None))
        for number in range(len(counts))
    ]
    for name in ("objective", "dual", "iterations"):
        joined = np.concatenate([getattr(each, name) for each in alone])
        assert_array_equal(getattr(solution, name), joined)
    as_one = solve_newton(replace(together, group=None))
    assert (as_one.dual != solution.dual).any()


@pytest.mark.parametrize("second", [1.0, 1 - 1e-9, 1e-9, 0.0])
@pytest.mark.parametrize("size", [1e-60, 1.0, 1e60])
def test_the_nuclear_norm_is_the_sum_of_singular_values(rng, second, size):
    U = random_orthogonal(rng, 2)
    V = random_orthogonal(rng, 3)
    block = size * (U @ np.diag([1.0, second]) @ V[:2])
    assert_allclose(nuclear_norm(block), size * (1 + second), rtol=1e-14)


LAM = 0.7
BETA = 0.4


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
    omega = plant_weights(rng, loss, weighted=weighted, p=p)
    Y, outlier = plant_dual(rng, loss, omega)
    atoms, M, c = plant_atoms(rng, Y * omega, k)
    T = rng.standard_normal(2)
    gross = np.sign(Y) * outlier * rng.uniform(0.5, 2, (2, p))

    residual = residual_at(loss, Y, gross)
    shape = np.einsum("kab,kbp->ap", M, atoms) + T[:, None]
    unseen = np.zeros((2, p))
    W = shape + np.divide(residual, omega, out=unseen, where=omega > 0)
    W[:, omega == 0] = np.nan
    problem = build_problem(W, atoms, LAM, weights=omega[None], loss=loss, beta=BETA)
    objective = loss_at(loss, Y, gross) + LAM * c.sum()
    return Planted(problem, M, T, Y, objective)


def plant_weights(
    rng: np.random.Generator, loss: Loss, *, weighted: bool, p: int
) -> np.ndarray:
    """Draw weights, of which every fifth is 0, or choose 1 for all."""
    if not weighted:
        return np.ones(p)
    visible = np.arange(p) % 5 != 4
    omega = rng.uniform(0.3, 1.5, p) * visible
    return visible.astype(float) if loss is Loss.EXACT else omega


def plant_dual(
    rng: np.random.Generator, loss: Loss, omega: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Draw a feasible dual Y, and say where it stands at its bound: at the outliers."""
    p = len(omega)
    bound = {Loss.ABSOLUTE: 1.0, Loss.SPARSE_ERROR: BETA}.get(loss, np.inf)
    Y = 0.25 * min(bound, 4.0) * rng.uniform(-1, 1, (2, p)) * (omega > 0)
    outlier = np.zeros((2, p), dtype=bool)
    if np.isfinite(bound):
        outlier[:, 2] = True
        outlier[0, 6] = True
        Y[outlier] = bound * rng.choice([-1, 1], 3)

    free = ~outlier * omega
    Y -= (Y @ omega / (free @ omega))[:, None] * free
    assert (np.abs(Y[~outlier]) < 0.95 * bound).all()
    assert_allclose(Y @ omega, 0, atol=1e-14)
    return Y, outlier


def plant_atoms(
    rng: np.random.Generator, weighted_dual: np.ndarray, k: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Draw atoms of which the first three are active, their transforms M and norms c.

    The transforms stand where the dual of their atoms touches the bound lambda.
    """
    p = weighted_dual.shape[1]
    atoms = rng.standard_normal((k, 3, p))
    singular_values = np.linalg.svd(weighted_dual @ transpose(atoms), compute_uv=False)
    active = np.arange(k) < 3
    share_of_bound = np.where(active, 1.0, rng.uniform(0.2, 0.9, k))
    size = LAM * share_of_bound / singular_values.sum(axis=1)
    atoms = resized(atoms, size)

    U, _, Vt = np.linalg.svd(weighted_dual @ transpose(atoms), full_matrices=False)
    c = rng.uniform(0.5, 2, k) * active
    M = resized(U @ Vt, c)
    return atoms, M, c


def residual_at(loss: Loss, Y: np.ndarray, gross: np.ndarray) -> np.ndarray:
    """Return the residual whose dual is Y, with gross errors at the outliers."""
    match loss:
        case Loss.SQUARED:
            return Y
        case Loss.EXACT:
            return np.zeros_like(Y)
        case Loss.ABSOLUTE:
            return gross
        case Loss.SPARSE_ERROR:
            return Y + gross


def loss_at(loss: Loss, Y: np.ndarray, gross: np.ndarray) -> float:
    """Return f of that residual."""
    squared = 0.5 * (Y**2).sum()
    absolute = np.abs(gross).sum()
    match loss:
        case Loss.SQUARED:
            return squared
        case Loss.EXACT:
            return 0.0
        case Loss.ABSOLUTE:
            return absolute
        case Loss.SPARSE_ERROR:
            return squared + BETA * absolute


@pytest.mark.parametrize("weighted", [False, True], ids=["plain", "weighted"])
@pytest.mark.parametrize("seed", range(5))
def test_planted_optimum_is_found(loss, seed, weighted):
    planted = plant(seed, loss, weighted=weighted)

    found = solve_newton(planted.problem, tolerance=1e-11)

    assert found.status == (Status.OPTIMAL,)
    assert found.objective[0] == pytest.approx(planted.objective, rel=1e-10)
    # the active atoms are in general position, so the optimum is the only one
    transforms = found.transforms.dense()[0]
    assert_allclose(transforms, planted.transforms, atol=1e-4)
    assert_allclose(found.translation[0], planted.translation, atol=1e-4)
    if loss.has_quadratic:  # D is strongly concave, so Y is unique
        assert_allclose(found.dual[0], planted.dual, atol=1e-4)


class Clarabel:
    """The program of one image as the paper writes it, built once for a size and a
    loss.

    cvxpy comes with the packages of the slow tests.
    """

    def __init__(self, k: int, p: int, loss: Loss) -> None:
        import cvxpy as cp

        # weights are in W and B already
        self.W = cp.Parameter((2, p))
        self.omega = cp.Parameter((1, p))
        self.B = cp.Parameter((3 * k, p))
        self.lam = cp.Parameter(nonneg=True)
        self.beta = cp.Parameter(nonneg=True)
        M = [cp.Variable((2, 3)) for _ in range(k)]
        T = cp.Variable((2, 1))
        E = cp.Variable((2, p))

        r = self.W - cp.hstack(M) @ self.B - T @ self.omega
        absolute_error = cp.sum(cp.abs(E))
        f = {
            Loss.SQUARED: cp.sum_squares(r) / 2,
            Loss.EXACT: cp.Constant(0),
            Loss.ABSOLUTE: cp.sum(cp.abs(r)),
            Loss.SPARSE_ERROR: cp.sum_squares(r - E) / 2 + self.beta * absolute_error,
        }[loss]
        spectral_norms = cp.hstack([cp.sigma_max(block) for block in M])
        objective = cp.Minimize(f + self.lam * cp.sum(spectral_norms))
        constraints = [r == 0] if loss is Loss.EXACT else []
        self.program = cp.Problem(objective, constraints)
        assert self.program.is_dpp()

    def solve(self, problem: Problem, image: int) -> float:
        omega = problem.weights[image]
        self.W.value = problem.landmarks[image] * omega
        self.omega.value = omega[None]
        self.B.value = (problem.atoms * omega).reshape(-1, len(omega))
        self.lam.value = problem.lam[image]
        self.beta.value = problem.beta
        self.program.solve(solver="CLARABEL")  # to 1e-8, or as near as it gets
        return float(self.program.value)


def assert_agreement(problem: Problem) -> None:
    """The optimum of each image is that of Clarabel."""
    n, _, p = problem.landmarks.shape
    clarabel = Clarabel(len(problem.atoms), p, problem.loss)

    found = solve_newton(problem, tolerance=1e-9)

    assert set(found.status) == {Status.OPTIMAL}
    expected = [clarabel.solve(problem, image) for image in range(n)]
    largest = np.abs(problem.landmarks).max()
    where_all_is_zero = 1e-9 * largest
    assert_allclose(found.objective, expected, rtol=1e-6, atol=where_all_is_zero)


@pytest.mark.slow
@pytest.mark.parametrize(("n", "k", "p"), [(80, 3, 5), (60, 7, 8), (40, 12, 10)])
def test_squared_loss_on_random_images(make_problem, rng, n, k, p):
    drawn = make_problem(n, k, p)
    lam = 10 ** rng.uniform(-2, 0.5, n)
    problem = build_problem(drawn.landmarks, drawn.atoms, lam, weights=drawn.weights)
    assert_agreement(problem)


@pytest.mark.slow
@pytest.mark.parametrize("loss", [Loss.EXACT, Loss.ABSOLUTE, Loss.SPARSE_ERROR])
@pytest.mark.parametrize(("k", "p"), [(4, 6), (9, 9)])
def test_other_losses_on_random_images(make_problem, loss, k, p):
    problem = make_problem(10, k, p, loss=loss)
    assert_agreement(problem)

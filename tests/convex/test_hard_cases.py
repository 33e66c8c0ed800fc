"""Cases that break solvers: each must end OPTIMAL in a few hundred steps, certified by
NumPy.
"""

from collections.abc import Callable

import numpy as np
import pytest
from numpy.testing import assert_allclose

from shapefit.convex.problem import Loss, Problem, build_problem
from shapefit.convex.solver import Status, solve_newton
from shapefit.geometry.rotations import random_rotations
from tests.convex.conftest import assert_certified, lambda_max
from tests.points import centred, transform, transpose

Arrays = dict[str, np.ndarray | float]

STEPS = 300
TOLERANCE = 1e-6


def random(rng: np.random.Generator, n: int = 12, k: int = 16, p: int = 12) -> Arrays:
    return {
        "landmarks": rng.standard_normal((n, 2, p)),
        "atoms": centred(rng.standard_normal((k, 3, p))),
        "lam": 0.1,
    }


def turned_duplicates(rng: np.random.Generator) -> Arrays:
    usual = random(rng, k=4)
    turned = [R @ usual["atoms"] for R in random_rotations(5, rng)]
    return usual | {"atoms": np.concatenate(turned)}


def rank_one(rng: np.random.Generator) -> np.ndarray:
    directions = rng.standard_normal((16, 3, 1))
    places = centred(rng.standard_normal((16, 1, 12)))
    return directions * places


def line(rng: np.random.Generator) -> np.ndarray:
    directions = rng.standard_normal((12, 2, 1))
    places = rng.standard_normal((12, 1, 12))
    return directions * places


def line_and_rank_one(rng: np.random.Generator) -> Arrays:
    return {"landmarks": line(rng), "atoms": rank_one(rng), "lam": 0.1}


def equal_singular_values(rng: np.random.Generator) -> Arrays:
    """Images that are one orthonormal atom seen from somewhere: Y B^T has s1 = s2."""
    orthonormal, _ = np.linalg.qr(rng.standard_normal((12, 11, 3)))
    no_padding = (0, 0)
    atoms = np.pad(transpose(orthonormal), (no_padding, no_padding, (0, 1)))
    landmarks = random_rotations(12, rng)[:, :2] @ atoms
    return {"landmarks": landmarks, "atoms": atoms, "lam": 0.1}


def many_landmarks(rng: np.random.Generator) -> Arrays:
    usual = random(rng, n=1, k=20, p=256)
    shape = np.tensordot(rng.standard_normal(5), usual["atoms"][:5], 1)
    gross = rng.random((1, 1, 256)) < 0.3
    return usual | {"landmarks": shape[None, :2] + gross * usual["landmarks"]}


def atoms_of_all_sizes(rng: np.random.Generator) -> Arrays:
    usual = random(rng)
    sizes = 10 ** rng.uniform(-4, 4, (16, 1, 1))
    return usual | {"atoms": usual["atoms"] * sizes}


def changed(
    name: str, change: Callable[[np.ndarray], np.ndarray]
) -> Callable[..., Arrays]:
    """Return a function that draws a random case with one of its arrays changed."""

    def draw(rng: np.random.Generator) -> Arrays:
        usual = random(rng)
        return usual | {name: change(usual[name])}

    return draw


def weights_over_orders(lowest: float, highest: float) -> Callable[..., Arrays]:
    """Return a function that draws a random case with weights 10^lowest to
    10^highest.
    """

    def draw(rng: np.random.Generator) -> Arrays:
        usual = random(rng)
        return usual | {"weights": 10 ** rng.uniform(lowest, highest, (12, 12))}

    return draw


EVERY_OTHER = (np.arange(16) % 2)[:, None, None]
CASES: dict[str, Callable[[np.random.Generator], Arrays]] = {
    "nothing special": random,
    "duplicated atoms": changed("atoms", lambda atoms: np.concatenate([atoms] * 3)),
    "turned duplicates": turned_duplicates,
    "zero atoms": changed("atoms", lambda atoms: atoms * EVERY_OTHER),
    "rank one atoms": lambda rng: random(rng) | {"atoms": rank_one(rng)},
    "flat atoms": changed("atoms", lambda atoms: atoms * [[1.0], [1.0], [0.0]]),
    "landmarks on a line": lambda rng: random(rng) | {"landmarks": line(rng)},
    "line and rank one atoms": line_and_rank_one,
    "equal singular values": equal_singular_values,
    "landmarks that are zero": changed("landmarks", np.zeros_like),
    "landmarks on one point": changed("landmarks", lambda w: np.full_like(w, 0.1)),
    "two landmarks": lambda rng: random(rng, p=2),
    "three landmarks": lambda rng: random(rng, p=3),
    "one atom": lambda rng: random(rng, k=1),
    "a thousand atoms": lambda rng: random(rng, n=3, k=1000, p=15),
    "many landmarks": many_landmarks,
    "weights over six orders": weights_over_orders(-3, 3),
    "weights from a millionth": weights_over_orders(-6, 0),
    "atoms of all sizes": atoms_of_all_sizes,
    "uncentred landmarks far away": changed("landmarks", lambda w: w + 1e6),
}


def make(name: str, loss: Loss, rng: np.random.Generator) -> Problem:
    """Build the case; under the EXACT loss with landmarks that the atoms can meet."""
    case = CASES[name](rng)
    landmarks = case["landmarks"]
    atoms = case["atoms"]
    if loss is Loss.EXACT and np.ptp(landmarks) > 0:
        n = len(landmarks)
        k = len(atoms)
        transforms = rng.standard_normal((n, k, 2, 3))
        transforms *= rng.random((n, k, 1, 1)) < max(0.2, 1 / k)
        landmarks = transform(transforms, atoms)
    weights = case.get("weights")
    lam = case["lam"]
    return build_problem(landmarks, atoms, lam, weights=weights, loss=loss, beta=0.3)


@pytest.mark.parametrize("name", CASES)
def test_hard_case(name, loss, rng):
    problem = make(name, loss, rng)

    solution = solve_newton(problem, tolerance=TOLERANCE, max_iterations=STEPS)

    assert_certified(problem, solution, TOLERANCE)


SHARES_OF_LAMBDA_MAX = [1e-6, 1e-4, 1e-2, 0.5, 0.999, 1 - 1e-9, 1.0, 1 + 1e-9, 10.0]


@pytest.mark.parametrize("share", SHARES_OF_LAMBDA_MAX)
@pytest.mark.parametrize("tolerance", [1e-4, 1e-6])
def test_lambda_from_a_millionth_to_ten_times_the_largest(loss, share, tolerance, rng):
    usual = make("nothing special", Loss.SQUARED, rng)
    lam = share * lambda_max(usual)
    if loss is Loss.EXACT:
        usual = make("nothing special", Loss.EXACT, rng)
    problem = build_problem(usual.landmarks, usual.atoms, lam, loss=loss, beta=0.3)

    solution = solve_newton(problem, tolerance=tolerance)

    assert_certified(problem, solution, tolerance)


@pytest.fixture
def landmarks_with_an_outlier(rng):
    landmarks = rng.standard_normal((6, 2, 9))
    landmarks[:, :, 0] += 100
    return landmarks


NO_ATOMS = np.zeros((2, 3, 9))
"""Atoms that leave all to the translation."""


def test_without_atoms_the_absolute_loss_translates_to_the_median(
    landmarks_with_an_outlier,
):
    landmarks = landmarks_with_an_outlier
    problem = build_problem(landmarks, NO_ATOMS, 0.1, loss=Loss.ABSOLUTE)

    solution = solve_newton(problem, tolerance=1e-9)

    median = np.median(landmarks, axis=2)
    assert_allclose(solution.translation, median, atol=1e-6)


def test_without_atoms_the_sparse_error_translates_to_the_mean_of_huber(
    landmarks_with_an_outlier,
):
    landmarks = landmarks_with_an_outlier
    problem = build_problem(landmarks, NO_ATOMS, 0.1, loss=Loss.SPARSE_ERROR, beta=0.5)

    solution = solve_newton(problem, tolerance=1e-12)

    residual = landmarks - solution.translation[..., None]
    slopes = np.clip(residual, -0.5, 0.5).sum(axis=2)
    assert_allclose(slopes, 0, atol=1e-4)


def shrink_unit(usual: Arrays, size: float) -> Arrays:
    """Return the same program in another unit of the transforms."""
    return usual | {"atoms": size * usual["atoms"], "lam": size * usual["lam"]}


@pytest.mark.parametrize("size", [1e-60])
def test_tiny_atoms_are_solved(rng, loss, size):
    usual = random(rng)
    expected = solve_newton(build_problem(**usual, loss=loss))

    found = solve_newton(build_problem(**shrink_unit(usual, size), loss=loss))

    assert set(found.status) == {Status.OPTIMAL}
    assert_allclose(found.objective, expected.objective, rtol=1e-3)


@pytest.mark.parametrize("size", [1e-100, 1e-163, 1e-165, 1e-200, 1e-300])
def test_atoms_whose_squares_underflow_are_a_failure(rng, loss, size):
    tiny = shrink_unit(random(rng), size)

    found = solve_newton(build_problem(**tiny, loss=loss))

    assert set(found.status) == {Status.NUMERICAL_FAILURE}
    assert np.isnan(found.relative_gap).all()


def test_tiny_atoms_beside_a_usual_lambda_are_not_used(rng):
    usual = random(rng)
    tiny = usual | {"atoms": 1e-200 * usual["atoms"]}

    found = solve_newton(build_problem(**tiny))

    assert set(found.status) == {Status.OPTIMAL}
    assert not found.transforms.count.any()

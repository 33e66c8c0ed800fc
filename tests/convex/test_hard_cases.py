"""Cases that break solvers: each must end OPTIMAL in a few hundred steps, certified by
NumPy.
"""

from collections.abc import Callable

import numpy as np
import pytest

from shapefit.convex.problem import Loss, Problem, build_problem
from shapefit.convex.solver import Status, solve_newton
from shapefit.geometry.rotations import random_rotations
from tests.convex.conftest import assert_certified, lambda_max

Arrays = dict[str, np.ndarray | float]
STEPS = 300


def centred(atoms: np.ndarray) -> np.ndarray:
    return atoms - atoms.mean(axis=-1, keepdims=True)


def random(rng: np.random.Generator, n: int = 12, k: int = 16, p: int = 12) -> Arrays:
    return {
        "landmarks": rng.standard_normal((n, 2, p)),
        "atoms": centred(rng.standard_normal((k, 3, p))),
        "lam": 0.1,
    }


def turned_duplicates(rng: np.random.Generator) -> Arrays:
    found = random(rng, k=4)
    return found | {
        "atoms": np.concatenate([R @ found["atoms"] for R in random_rotations(5, rng)])
    }


def rank_one(rng: np.random.Generator) -> np.ndarray:
    return rng.standard_normal((16, 3, 1)) * centred(rng.standard_normal((16, 1, 12)))


def line(rng: np.random.Generator) -> np.ndarray:
    return rng.standard_normal((12, 2, 1)) * rng.standard_normal((12, 1, 12))


def equal_singular_values(rng: np.random.Generator) -> Arrays:
    """Images that are one orthonormal atom seen from somewhere: Y B^T has s1 = s2."""
    atoms = np.linalg.qr(rng.standard_normal((12, 11, 3)))[0].swapaxes(1, 2)
    atoms = np.pad(atoms, ((0, 0), (0, 0), (0, 1)))
    landmarks = random_rotations(12, rng)[:, :2] @ atoms
    return {"landmarks": landmarks, "atoms": atoms, "lam": 0.1}


def many_landmarks(rng: np.random.Generator) -> Arrays:
    found = random(rng, n=1, k=20, p=256)
    shapes = np.tensordot(rng.standard_normal(5), found["atoms"][:5], 1)
    gross = rng.random((1, 1, 256)) < 0.3
    return found | {"landmarks": shapes[None, :2] + gross * found["landmarks"]}


def atoms_of_all_sizes(rng: np.random.Generator) -> Arrays:
    found = random(rng)
    return found | {"atoms": found["atoms"] * 10 ** rng.uniform(-4, 4, (16, 1, 1))}


def changed(
    name: str, change: Callable[[np.ndarray], np.ndarray]
) -> Callable[..., Arrays]:
    """Return a function that draws a random case with one of its arrays changed."""

    def draw(rng: np.random.Generator) -> Arrays:
        found = random(rng)
        return found | {name: change(found[name])}

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
    "line and rank one atoms": lambda rng: {
        "landmarks": line(rng), "atoms": rank_one(rng), "lam": 0.1,
    },
    "equal singular values": equal_singular_values,
    "landmarks that are zero": changed("landmarks", np.zeros_like),
    "landmarks on one point": changed("landmarks", lambda w: np.full_like(w, 0.1)),
    "two landmarks": lambda rng: random(rng, p=2),
    "three landmarks": lambda rng: random(rng, p=3),
    "one atom": lambda rng: random(rng, k=1),
    "a thousand atoms": lambda rng: random(rng, n=3, k=1000, p=15),
    "many landmarks": many_landmarks,
    "weights over six orders": lambda rng: random(rng)
    | {"weights": 10 ** rng.uniform(-3, 3, (12, 12))},
    "weights from a millionth": lambda rng: random(rng)
    | {"weights": 10 ** rng.uniform(-6, 0, (12, 12))},
    "atoms of all sizes": atoms_of_all_sizes,
    "uncentred landmarks far away": changed("landmarks", lambda w: w + 1e6),
}  # fmt: skip


def make(name: str, loss: Loss, rng: np.random.Generator) -> Problem:
    """Build the case; under the EXACT loss with landmarks that the atoms can meet."""
    found = CASES[name](rng)
    landmarks, atoms = found["landmarks"], found["atoms"]
    if loss is Loss.EXACT and np.ptp(landmarks) > 0:
        mixed = rng.standard_normal((len(landmarks), len(atoms), 2, 3))
        mixed *= rng.random((len(landmarks), len(atoms), 1, 1)) < max(
            0.2, 1 / len(atoms)
        )
        landmarks = np.einsum("nkab,kbp->nap", mixed, atoms)
    return build_problem(
        landmarks,
        atoms,
        found["lam"],
        weights=found.get("weights"),
        loss=loss,
        beta=0.3,
    )


@pytest.mark.parametrize("name", CASES)
def test_hard_case(name, loss, rng):
    problem, tolerance = make(name, loss, rng), 1e-6
    solution = solve_newton(problem, tolerance=tolerance, max_iterations=STEPS)
    assert_certified(problem, solution, tolerance)


@pytest.mark.parametrize(
    "factor", [1e-6, 1e-4, 1e-2, 0.5, 0.999, 1 - 1e-9, 1.0, 1 + 1e-9, 10.0]
)
def test_lambda_from_a_millionth_to_ten_times_the_largest(loss, factor, rng):
    squared = make("nothing special", Loss.SQUARED, rng)
    lam = factor * lambda_max(squared)
    if loss is Loss.EXACT:
        squared = make("nothing special", Loss.EXACT, rng)
    problem = build_problem(squared.landmarks, squared.atoms, lam, loss=loss, beta=0.3)
    for tolerance in (1e-4, 1e-6):
        assert_certified(problem, solve_newton(problem, tolerance=tolerance), tolerance)


def test_robust_losses_place_the_translation_without_atoms(rng):
    """All atoms zero: what is left is a median, or Huber's mean, of each coordinate."""
    landmarks = rng.standard_normal((6, 2, 9))
    landmarks[:, :, 0] += 100
    atoms = np.zeros((2, 3, 9))
    median = solve_newton(
        build_problem(landmarks, atoms, 0.1, loss=Loss.ABSOLUTE), tolerance=1e-9
    )
    np.testing.assert_allclose(
        median.translation, np.median(landmarks, axis=2), atol=1e-6
    )
    problem = build_problem(landmarks, atoms, 0.1, loss=Loss.SPARSE_ERROR, beta=0.5)
    huber = solve_newton(problem, tolerance=1e-12)
    slopes = np.clip(landmarks - huber.translation[..., None], -0.5, 0.5).sum(axis=2)
    np.testing.assert_allclose(slopes, 0, atol=1e-4)


@pytest.mark.parametrize("size", [1e-60, 1e-100, 1e-163, 1e-165, 1e-200, 1e-300])
def test_tiny_atoms_are_solved_or_a_failure(rng, loss, size):
    """The same program in another unit of the transforms, until squares underflow."""
    usual = random(rng)
    atoms, lam = size * usual["atoms"], size * usual["lam"]
    found = solve_newton(build_problem(usual["landmarks"], atoms, lam, loss=loss))
    if size < 1e-72:
        assert set(found.status) == {Status.NUMERICAL_FAILURE}
        assert np.isnan(found.relative_gap).all()
        return
    expected = solve_newton(build_problem(**usual, loss=loss))
    assert set(found.status) == {Status.OPTIMAL}
    np.testing.assert_allclose(found.objective, expected.objective, rtol=1e-3)


def test_tiny_atoms_beside_a_usual_lambda_are_not_used(rng):
    usual = random(rng)
    found = solve_newton(build_problem(**usual | {"atoms": 1e-200 * usual["atoms"]}))
    assert set(found.status) == {Status.OPTIMAL}
    assert not found.transforms.count.any()

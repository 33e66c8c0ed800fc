"""Liftings of groups become one: every field, in the order of the images, with all atoms."""

from dataclasses import fields

import numpy as np
import pytest

from shapefit.convex.solver import solve_newton
from shapefit.geometry.normalisation import normalise
from shapefit.lifting.lift import Group, Program, lift, merge
from shapefit.lifting.methods import Settings, choose_method

PROGRAM = Program(lam=0.1)
ORDER = np.array([3, 0, 6, 1, 5, 2, 4])
PARTS = (slice(0, 3), slice(3, 4), slice(4, 7))


@pytest.fixture
def atoms(rng):
    return normalise(rng.standard_normal((5, 3, 8))).points


@pytest.fixture
def run(rng, atoms):
    """Return the function that lifts some of seven images, one of them degenerate."""
    landmarks = 10 * rng.standard_normal((7, 2, 8)) + 50
    weights = np.ones((7, 8))
    weights[5, 2:] = 0

    def run(images=slice(None), retained=slice(None), method="convex"):
        B = atoms[retained]
        settings = Settings(solve=solve_newton, mean_shape=normalise(B.mean(axis=0)).points)
        estimator = choose_method(method, settings)
        return lift(landmarks[images], weights[images], B, PROGRAM, estimator)

    return run


def one_by_one(run, **options):
    return [Group(run([i], **options), np.array([i]), np.arange(5)) for i in ORDER]


@pytest.mark.parametrize("method", ["convex", "convex+refine", "mean-shape"])
def test_images_lifted_one_by_one_are_those_lifted_alone(run, atoms, method):
    merged = merge(one_by_one(run, method=method), atoms)
    assert merged.failures.keys() == {5}
    for i in range(7):
        alone = run([i], method=method)
        for one, other in ((merged, alone), (merged.estimate, alone.estimate)):
            for field in fields(one):
                values = getattr(one, field.name)
                if isinstance(values, np.ndarray):
                    np.testing.assert_array_equal(values[i], getattr(other, field.name)[0])
        assert merged.estimate.status[i] is alone.estimate.status[0]
        assert merged.failures.get(i) == alone.failures.get(0)


def test_atoms_that_a_group_lacked_have_no_part(run, atoms):
    retained = np.array([0, 2, 3])
    some, rest = np.array([4, 1]), np.array([0, 2, 3, 5, 6])
    part = run(some, retained)
    merged = merge([Group(part, some, retained), Group(run(rest), rest, np.arange(5))], atoms)
    assert merged.estimate.coefficients.shape == (7, 5)
    np.testing.assert_array_equal(merged.estimate.coefficients[some][:, [1, 4]], 0)
    np.testing.assert_array_equal(merged.estimate.transforms.dense()[some][:, [1, 4]], 0)
    np.testing.assert_array_equal(
        merged.estimate.transforms.dense()[some][:, retained], part.estimate.transforms.dense()
    )
    np.testing.assert_array_equal(
        merged.estimate.coefficients[some][:, retained], part.estimate.coefficients
    )
    np.testing.assert_array_equal(merged.problem.atoms, atoms)
    np.testing.assert_array_equal(merged.problem.landmarks[some], part.problem.landmarks)

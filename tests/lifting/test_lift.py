"""Lifting by any method: normalising, degenerate images, failures, scaling back, joined
groups.
"""

from dataclasses import fields, replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from shapefit.convex.solver import Status
from shapefit.geometry.normalisation import normalise
from shapefit.lifting.degeneracy import MIN_SINGULAR_VALUE, find_degenerate
from shapefit.lifting.estimate import Estimate
from shapefit.lifting.lift import (
    MIN_LAMBDA,
    NOT_FINITE,
    Group,
    Program,
    choose_lambda,
    fail_nonfinite,
    lift,
    merge,
    noise_dual_norm,
)
from tests.lifting.estimators import make_estimator

PROGRAM = Program(lam=0.1)


class Flat:
    """A method whose shape is the landmarks themselves, at depth 0; remembers the
    problem.
    """

    def __init__(self, status=Status.OPTIMAL):
        self.status = status

    def __call__(self, problem):
        self.problem = problem
        n, _, p = problem.landmarks.shape
        shapes = np.concatenate([problem.landmarks, np.zeros((n, 1, p))], axis=1)
        shapes[:, :2] -= 0.25
        return Estimate(
            shapes=shapes,
            translation=np.full((n, 2), 0.25),
            rotation=np.broadcast_to(np.eye(3), (n, 3, 3)),
            objective=np.zeros(n),
            residual=np.zeros(n),
            iterations=np.zeros(n, np.int64),
            status=(self.status,) * n,
        )


def test_methods_see_normalised_landmarks_and_their_answer_is_scaled_back(make_scene):
    scene = make_scene(n=5)
    landmarks, flat = 37.0 * scene.landmarks + 400.0, Flat()
    found = lift(landmarks, scene.weights, scene.atoms, PROGRAM, flat)
    norm = normalise(landmarks)
    assert_allclose(flat.problem.landmarks, norm.points, atol=1e-12)
    assert_array_equal(flat.problem.lam, 0.1)
    assert_allclose(found.landmarks_fitted, landmarks, rtol=1e-12)
    assert_array_equal(found.landmarks_fitted, found.shapes[:, :2])
    assert_array_equal(found.scale, norm.scale)
    assert_allclose(found.translation, norm.centroid + 0.25 * norm.scale[:, None])
    assert found.failures == {}


def test_failing_images_are_named_and_leave_the_others_alone(make_scene):
    scene = make_scene(n=6)
    scene.weights[1] = 0.0
    scene.landmarks[2] = 3.0
    scene.landmarks[3, 1] = 2 * scene.landmarks[3, 0]
    scene.landmarks[4, :, 5:] = np.nan
    scene.weights[4, 5:] = 0.0
    flat = Flat()
    found = lift(scene.landmarks, scene.weights, scene.atoms, PROGRAM, flat)
    assert found.failures == {
        1: "all landmarks are hidden",
        2: "all visible landmarks are at one point",
        3: "all visible landmarks lie on one line",
    }
    for image in (1, 2, 3):
        assert np.isnan(found.shapes[image]).all()
        assert np.isnan(found.scale[image])
        assert_array_equal(flat.problem.weights[image], 0.0)
    shown = (
        np.isfinite(scene.landmarks) & np.isin(np.arange(6), [0, 4, 5])[:, None, None]
    )
    fitted = found.landmarks_fitted[shown]
    assert_allclose(fitted, scene.landmarks[shown], rtol=1e-12)


@pytest.mark.parametrize(
    ("status", "reason"),
    [
        (Status.NUMERICAL_FAILURE, "numerical failure in the solver"),
        (Status.DEGENERATE, "no pose of the mean shape fits the visible landmarks"),
    ],
)
def test_a_method_without_a_shape_is_a_failure(make_scene, status, reason):
    scene = make_scene(n=3)
    scene.weights[2] = 0.0
    found = lift(scene.landmarks, scene.weights, scene.atoms, PROGRAM, Flat(status))
    assert found.failures == {0: reason, 1: reason, 2: "all landmarks are hidden"}
    assert np.isnan(found.shapes).all()


def test_each_image_has_the_lambda_of_its_own_size_and_landmarks(make_scene):
    scene, flat = make_scene(n=3, p=16), Flat()
    landmarks = scene.landmarks * np.array([1.0, 9.0, 1.0])[:, None, None]
    weights = np.ones((3, 16))
    weights[2, 4:] = 0.0
    found = lift(landmarks, weights, scene.atoms, Program(lam=None, noise=0.2), flat)
    expected = 0.2 / found.scale * noise_dual_norm(scene.atoms) * np.array([1, 1, 0.5])
    assert_allclose(flat.problem.lam, expected)


@pytest.mark.parametrize("visible", [np.ones(40, bool), np.arange(40) % 4 == 0])
def test_lambda_is_the_mean_dual_norm_of_the_noise_that_is_seen(rng, visible):
    """Against noise drawn anew, on the visible landmarks, about their mean; never 0."""
    atoms = rng.standard_normal((5, 3, 40))
    atoms -= atoms.mean(axis=2, keepdims=True)
    G = rng.standard_normal((4000, 1, 2, visible.sum()))
    G -= G.mean(axis=-1, keepdims=True)
    norms = np.linalg.norm(G @ atoms[..., visible].swapaxes(1, 2), "nuc", axis=(2, 3))
    program, share = Program(lam=None, noise=2.0), np.full(3, visible.mean())
    found = choose_lambda(program, atoms, np.array([1.0, 4.0, 1e9]), share)
    expected = 2.0 * norms.max(axis=1).mean() / np.array([1.0, 4.0])
    assert_allclose(found, [*expected, MIN_LAMBDA], rtol=0.05)


@pytest.fixture
def lifting(make_scene):
    scene = make_scene(n=5)
    scene.weights[3] = 0.0
    method = make_estimator("convex")
    return lift(scene.landmarks, scene.weights, scene.atoms, Program(lam=0.1), method)


def test_what_is_finite_stays(lifting):
    assert fail_nonfinite(lifting) is lifting


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_one_coordinate_that_is_not_finite_fails_its_image(lifting, value):
    shapes = lifting.shapes.copy()
    shapes[1, 2, 4] = value
    found = fail_nonfinite(replace(lifting, shapes=shapes))
    assert found.failures == {1: NOT_FINITE, 3: "all landmarks are hidden"}
    optimal = Status.OPTIMAL
    assert found.estimate.status == (
        optimal, Status.NUMERICAL_FAILURE, optimal, Status.DEGENERATE, optimal,
    )  # fmt: skip
    for name in ("shapes", "landmarks_fitted", "translation", "scale"):
        after, before = getattr(found, name), getattr(lifting, name)
        assert np.isnan(after[1]).all()
        others = [0, 2, 3, 4]
        assert_array_equal(after[others], before[others])


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
        mean_shape = normalise(B.mean(axis=0)).points
        estimator = make_estimator(method, mean_shape=mean_shape)
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
                    assert_array_equal(values[i], getattr(other, field.name)[0])
        assert merged.estimate.status[i] is alone.estimate.status[0]
        assert merged.failures.get(i) == alone.failures.get(0)


def test_atoms_that_a_group_lacked_have_no_part(run, atoms):
    retained = np.array([0, 2, 3])
    some, rest = np.array([4, 1]), np.array([0, 2, 3, 5, 6])
    part = run(some, retained)
    merged = merge(
        [Group(part, some, retained), Group(run(rest), rest, np.arange(5))], atoms
    )
    assert merged.estimate.coefficients.shape == (7, 5)
    assert_array_equal(merged.estimate.coefficients[some][:, [1, 4]], 0)
    assert_array_equal(merged.estimate.transforms.dense()[some][:, [1, 4]], 0)
    assert_array_equal(
        merged.estimate.transforms.dense()[some][:, retained],
        part.estimate.transforms.dense(),
    )
    assert_array_equal(
        merged.estimate.coefficients[some][:, retained], part.estimate.coefficients
    )
    assert_array_equal(merged.problem.atoms, atoms)
    assert_array_equal(merged.problem.landmarks[some], part.problem.landmarks)


TRIANGLE = np.array([[0.0, 1.0, 0.0, 0.3], [0.0, 0.0, 1.0, 0.2]])


@pytest.mark.parametrize(
    ("landmarks", "weights", "reason"),
    [
        (TRIANGLE, [0, 0, 0, 0], "all landmarks are hidden"),
        (TRIANGLE, [1, 1, 0, 0], "only 2 visible landmarks, 3 are needed"),
        (TRIANGLE, [0, 0, 0, 0.1], "only 1 visible landmarks, 3 are needed"),
        (np.full((2, 4), 7.3), [1, 1, 1, 1], "all visible landmarks are at one point"),
        (np.zeros((2, 4)), [1, 1, 1, 1], "all visible landmarks are at one point"),
        (
            [[0, 1, 2, 9], [1, 3, 5, 0]],
            [1, 1, 1, 0],
            "all visible landmarks lie on one line",
        ),
    ],
)
def test_a_degenerate_image_is_found_with_its_reason(landmarks, weights, reason):
    found = find_degenerate(
        np.array([TRIANGLE, landmarks], dtype=float),
        np.array([np.ones(4), weights], dtype=float),
    )
    assert found == {1: reason}


def test_how_thin_a_line_is_counts_beside_its_length():
    x = np.linspace(-1, 1, 20)
    across = (-1.0) ** np.arange(20)
    across -= x * (x @ across) / (x @ x)
    wide, long = np.linalg.norm(across), np.linalg.norm(x)
    thin = [
        np.stack([x, share * MIN_SINGULAR_VALUE * long / wide * across])
        for share in (0.7, 1.4)
    ]
    found = find_degenerate(np.array(thin), np.ones((2, 20)))
    assert found == {0: "all visible landmarks lie on one line"}


def test_coordinates_that_cannot_be_squared_are_found():
    images = np.stack(
        [1e200 * TRIANGLE, TRIANGLE, 1e-200 * TRIANGLE, 1e-318 * TRIANGLE]
    )
    images = np.concatenate([images, [1.7e308 * (2 * TRIANGLE - 1)]])
    with np.errstate(all="raise", under="ignore"):
        found = find_degenerate(images, np.ones((5, 4)))
    assert list(found) == [0, 2, 3, 4]
    assert found[0] == "coordinates too large, up to 1e+200: use a larger unit"
    assert found[2].startswith(
        "landmarks too close together, within 7e-201: use a smaller unit"
    )
    assert "too close together" in found[3]
    assert "too large" in found[4]

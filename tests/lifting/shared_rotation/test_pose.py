"""Poses of one shape: planted ones, their starts, and methods that begin with them."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from shapefit.convex.problem import build_problem
from shapefit.geometry.rotations import random_rotations, rotation_about_axis
from shapefit.lifting.shared_rotation import alternate, even_views, find_pose
from tests.lifting.estimators import make_estimator
from tests.points import assert_rotations, centred, mix, resized


@pytest.fixture
def shape(rng):
    return rng.standard_normal((3, 10))


def misfits(problem, shape, pose):
    """Return half the sum of weighted squares (n,) that poses leave, best placed."""
    square = problem.weights[:, None] ** 2
    posed = resized(pose.rotation[:, :2] @ shape, pose.size)
    away = problem.landmarks - posed
    total = square.sum(axis=-1, keepdims=True)
    T = (away * square).sum(axis=-1, keepdims=True) / total
    return 0.5 * (square * (away - T) ** 2).sum(axis=(1, 2))


class TestPlanted:
    """200 images of one shape at random poses."""

    @pytest.fixture
    def rotation(self, rng):
        return random_rotations(200, rng)

    @pytest.fixture
    def size(self, rng):
        return rng.uniform(0.2, 4, 200)

    @pytest.fixture
    def translation(self, rng):
        return rng.standard_normal((200, 2, 1))

    @pytest.fixture
    def show(self, rotation, size, translation):
        """Return the function that makes the problem of a shape."""

        def show(shape):
            posed = resized(rotation[:, :2] @ shape, size)
            return build_problem(posed + translation, shape[None], 1.0)

        return show

    @pytest.mark.parametrize("depth", [1.0, 0.0], ids=["solid", "flat"])
    def test_their_sizes_come_back_and_nothing_is_left(self, shape, show, size, depth):
        shape[2] *= depth
        problem = show(shape)

        found = find_pose(problem, shape)

        assert_allclose(found.size, size, rtol=1e-7)
        assert_allclose(misfits(problem, shape, found), 0.0, atol=1e-12)

    def test_their_rotations_come_back(self, shape, show, rotation):
        found = find_pose(show(shape), shape)
        assert_allclose(found.rotation, rotation, atol=1e-6)

    def test_of_a_flat_shape_the_depth_may_be_reversed(self, shape, show, rotation):
        """It has a second pose of the same image."""
        shape[2] = 0.0
        reversed_depth = rotation * np.array([1.0, 1.0, -1.0])
        reversed_depth[:, 2] *= -1

        found = find_pose(show(shape), shape).rotation

        apart = np.abs(found - rotation).max(axis=(1, 2))
        apart_from_other = np.abs(found - reversed_depth).max(axis=(1, 2))
        assert_allclose(np.minimum(apart, apart_from_other), 0.0, atol=1e-6)


def test_one_start_is_the_identity_turned_in_the_plane(shape):
    in_plane = rotation_about_axis(2, np.linspace(-3, 3, 40))
    problem = build_problem(in_plane[:, :2] @ shape, shape[None], 1.0)

    found = find_pose(problem, shape, 1)

    assert_allclose(found.rotation, in_plane, atol=1e-7)
    assert_allclose(found.size, 1, rtol=1e-7)


@pytest.fixture
def turned():
    """Mixtures of atoms seen from everywhere, and the mean of the atoms, whose pose has
    a second minimum in many of these images.
    """
    rng = np.random.default_rng(2)
    mean = rng.standard_normal((3, 10))
    atoms = centred(mean + 0.5 * rng.standard_normal((4, 3, 10)))
    shapes = mix(rng.dirichlet(np.ones(4), 200), atoms)
    landmarks = (random_rotations(200, rng) @ shapes)[:, :2]
    return atoms.mean(axis=0), build_problem(landmarks, atoms, 0.05)


def test_more_starts_never_fit_worse(turned):
    mean_shape, problem = turned

    def misfits_from(starts):
        pose = find_pose(problem, mean_shape, starts)
        return misfits(problem, mean_shape, pose)

    one = misfits_from(1)
    six = misfits_from(6)
    many = misfits_from(24)

    assert (one > 2 * six).mean() > 0.1
    assert (six <= one * (1 + 1e-9)).all()
    assert (many <= one * (1 + 1e-9)).all()


class TestStartsOfMethods:
    """Methods start from as many views as they are told."""

    @pytest.fixture
    def estimate_by(self, turned):
        mean_shape, problem = turned

        def estimate_by(name, **options):
            estimate = make_estimator(name, mean_shape=mean_shape, **options)
            return estimate(problem)

        return estimate_by

    @pytest.mark.parametrize("name", ["alternate", "mean-shape"])
    def test_six_views_are_better_than_one(self, name, estimate_by):
        one = estimate_by(name, starts=1)
        six = estimate_by(name, starts=6)
        assert one.objective.mean() > 2 * six.objective.mean()

    @pytest.mark.parametrize("name", ["alternate", "mean-shape"])
    def test_there_are_six_by_default(self, name, estimate_by):
        six = estimate_by(name, starts=6)
        assert_array_equal(estimate_by(name).rotation, six.rotation)

    def test_the_mean_shape_has_its_pose(self, turned, estimate_by):
        mean_shape, problem = turned
        pose = find_pose(problem, mean_shape, 1)
        found = estimate_by("mean-shape", starts=1)
        assert_array_equal(found.rotation, pose.rotation)

    def test_alternation_goes_on_from_this_pose(self, turned, estimate_by):
        mean_shape, problem = turned
        pose = find_pose(problem, mean_shape, 1)
        expected = alternate(problem, pose.rotation[:, None])
        found = estimate_by("alternate", starts=1)
        assert_array_equal(found.rotation, expected.rotation)


class TestEvenViews:
    @pytest.mark.parametrize("count", [1, 2, 6, 24])
    def test_they_are_rotations_that_begin_with_the_identity(self, count):
        views = even_views(count)
        assert_array_equal(views[0], np.eye(3))
        assert_rotations(views, atol=1e-14)

    @pytest.mark.parametrize(
        ("count", "degrees"), [(1, 181), (2, 136), (6, 75), (24, 38)]
    )
    def test_no_direction_is_far_from_one(self, count, degrees, rng):
        axes = even_views(count)[:, 2]
        directions = random_rotations(2000, rng)[:, 0]
        cosine_of_nearest = (directions @ axes.T).max(axis=1)
        farthest = np.degrees(np.arccos(cosine_of_nearest.min()))
        assert farthest < degrees


def test_without_landmarks_there_is_no_pose(shape):
    """Of the first of two images nothing is seen."""
    weights = np.ones((2, 10))
    weights[0] = 0.0
    landmarks = np.stack([shape[:2], shape[:2]])
    problem = build_problem(landmarks, shape[None], 1.0, weights=weights)

    found = find_pose(problem, shape)

    hidden, visible = found.rotation
    assert np.isnan(hidden).all()
    assert np.isfinite(visible).all()
    assert_allclose(found.size, [0, 1], atol=1e-9)

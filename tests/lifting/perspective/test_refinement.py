"""Refinement under perspective: planted shapes, another solver, its start in depth."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from shapefit.arrays import Floats
from shapefit.convex.solver import Status
from shapefit.geometry.normalisation import normalise
from shapefit.geometry.pinhole import Camera, project_pinhole
from shapefit.geometry.rotations import (
    exponential,
    random_rotations,
    rotation_angle,
)
from shapefit.lifting.perspective import (
    RefinedViews,
    mean_coefficients,
    place_in_depth,
    refine_perspective,
)
from tests.points import flatten, mix, resized, with_noise

K = 6
"""Atoms."""

P = 16
"""Landmarks."""

N = 8
"""Images."""

FLIP = np.diag([1.0, -1.0, -1.0])
"""y down and z forward <-> y up and z to the viewer."""

RIDGE = 0.3
"""By which coefficients are pulled to the prior, unless a test says more."""


@dataclass(frozen=True)
class Scene:
    """Images of shapes with known c, R, t, close enough for strong perspective."""

    atoms: Floats
    prior: Floats
    coefficients: Floats
    rotation: Floats
    translation: Floats
    camera: Camera
    landmarks: Floats
    weights: Floats
    start: Floats

    def refine(self, **options) -> RefinedViews:
        return refine_perspective(
            self.landmarks,
            self.weights,
            self.atoms,
            self.camera,
            self.start,
            self.prior,
            **options,
        )


@pytest.fixture
def atoms(rng):
    """Variations of one mean shape, normalised, as the models of a class are."""
    mean = rng.standard_normal((3, P))
    return normalise(mean + 0.3 * rng.standard_normal((K, 3, P))).points


@pytest.fixture
def prior(atoms):
    """Coefficients of the mean shape."""
    mean_shape = normalise(atoms.mean(axis=0)).points
    return mean_coefficients(atoms, mean_shape)


@pytest.fixture
def make_scene(rng, atoms, prior):
    def make_scene(noise=0.0, *, weighted=False):
        c = with_the_size_of_the_prior(rng.dirichlet(np.ones(K), N), prior)
        R = random_rotations(N, rng)
        x = rng.uniform(-1, 1, N)
        y = rng.uniform(-1, 1, N)
        t = np.column_stack([x, y, rng.uniform(6, 12, N)])
        focal = np.tile([7.0, 7.5], (N, 1))
        camera = Camera(focal, rng.uniform(-0.5, 0.5, (N, 2)), 1.0)
        exact = project_pinhole(camera, R @ mix(c, atoms) + t[..., None])
        weights = rng.uniform(0.3, 1.5, (N, P)) if weighted else np.ones((N, P))
        return Scene(
            atoms=atoms,
            prior=prior,
            coefficients=c,
            rotation=R,
            translation=t,
            camera=camera,
            landmarks=with_noise(exact, noise, rng),
            weights=weights,
            start=random_turns(rng, 0.2) @ R,
        )

    return make_scene


def with_the_size_of_the_prior(c, prior):
    """Scale coefficients (..., k) so that <c, prior> = <prior, prior>."""
    share = c @ prior / (prior @ prior)
    return c / share[..., None]


def random_turns(rng, angle):
    """Draw rotations (N, 3, 3) by one angle about any axes."""
    axes = rng.standard_normal((N, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    return exponential(angle * axes)


@pytest.fixture
def planted(make_scene):
    return make_scene()


@pytest.fixture
def noisy(make_scene):
    return make_scene(noise=0.05, weighted=True)


def test_planted_shapes_and_poses_are_found(planted):
    found = planted.refine(ridge=1e-9, max_rounds=5000)

    assert set(found.status) == {Status.CONVERGED}
    assert rotation_angle(found.rotation, planted.rotation).max() < 0.01
    assert_allclose(found.translation, planted.translation, rtol=1e-3)
    shapes = found.rotation @ mix(found.coefficients, planted.atoms)
    expected = planted.rotation @ mix(planted.coefficients, planted.atoms)
    assert_allclose(shapes, expected, atol=1e-3)


def distances(scene, image, R, t, c):
    """Return the weighted distances (p,) of the landmarks of an image from those of a
    shape and a pose.
    """
    S = R @ np.tensordot(c, scene.atoms, axes=1) + t[:, None]
    focal = scene.camera.focal[image][:, None]
    centre = scene.camera.centre[image][:, None]
    landmarks = centre + focal * S[:2] / S[2]
    off = np.linalg.norm(landmarks - scene.landmarks[image], axis=0)
    return scene.weights[image] * off


@pytest.mark.parametrize("softness", [0.05, 2.0])
@pytest.mark.parametrize("image", range(N))
class TestObjective:
    """The Cauchy loss of distances, and a ridge about the prior."""

    @pytest.fixture
    def found(self, noisy, softness):
        return noisy.refine(softness=softness)

    def roots(self, scene, image, softness, R, t, c):
        """Return what the objective is half the sum of squares of."""
        share = distances(scene, image, R, t, c) / softness
        cauchy = softness * np.sqrt(np.log1p(share**2))
        ridge = np.sqrt(RIDGE) * (c - scene.prior)
        return np.concatenate([cauchy, ridge])

    def test_it_is_that_of_the_shape_and_pose(self, noisy, found, image, softness):
        R = found.rotation[image]
        t = found.translation[image]
        c = found.coefficients[image]
        roots = self.roots(noisy, image, softness, R, t, c)
        assert_allclose(found.objective[image], 0.5 * (roots**2).sum(), rtol=1e-9)

    def test_an_independent_solver_cannot_lower_it(self, noisy, found, image, softness):
        """Over turns from the rotation, translations, and coefficients >= 0."""

        def roots_at(x):
            turn, t, free = np.split(x, [3, 6])
            R = Rotation.from_rotvec(turn).as_matrix() @ found.rotation[image]
            c = with_the_size_of_the_prior(free, noisy.prior)
            return self.roots(noisy, image, softness, R, t, c)

        no_turn = np.zeros(3)
        start = np.concatenate(
            [no_turn, found.translation[image], found.coefficients[image]]
        )
        lower = np.concatenate([np.full(6, -np.inf), np.full(K, -1e-12)])

        other = least_squares(
            roots_at, start, bounds=(lower, np.inf), xtol=1e-12, ftol=1e-12
        )

        assert other.cost >= found.objective[image] * (1 - 1e-6)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_what_is_far_away_starts_where_it_is(rng, atoms, sign):
    """By what is seen: hidden landmarks may be anywhere, or nowhere."""
    shape = atoms[0] + [[3], [1], [2]]
    t = np.array([[50.0, -40.0, sign * 20_000.0]])
    R = random_rotations(1, rng)
    camera = Camera(np.array([[2.0, 3.0]]), np.array([[0.4, -0.3]]), sign)
    landmarks = project_pinhole(camera, R @ shape + t[..., None])
    weights = rng.uniform(0.3, 1.5, (1, P))
    weights[:, :2] = 0.0
    landmarks[..., 0] += 7.0
    landmarks[..., 1] = np.nan

    start = place_in_depth(landmarks, weights, shape, camera, R)

    assert_allclose(start, t, rtol=1e-3)


@pytest.fixture
def one_place(rng, atoms):
    """A camera, a shape with its rotation, and landmarks that are all in one place."""
    camera = Camera(np.ones((1, 2)), np.zeros((1, 2)), 1.0)
    landmarks = np.full((1, 2, P), 0.25)
    return landmarks, np.ones((1, P)), atoms[0], camera, random_rotations(1, rng)


def test_landmarks_in_one_place_start_nowhere(one_place):
    start = place_in_depth(*one_place)
    assert not np.isfinite(start).any()


def test_a_rotation_that_does_not_fit_starts_within_ten_times_the_depth(rng, atoms):
    """Turned by half a turn in the image, all lies on the other side."""
    t = np.array([[0.0, 0.0, 2000.0]])
    R = random_rotations(1, rng)
    camera = Camera(np.ones((1, 2)), np.zeros((1, 2)), 1.0)
    landmarks = project_pinhole(camera, R @ atoms[0] + t[..., None])
    opposite = np.diag([-1.0, -1.0, 1.0]) @ R

    start = place_in_depth(landmarks, np.ones((1, P)), atoms[0], camera, opposite)

    assert start[0, 2] == pytest.approx(20_000, rel=0.01)


def test_coefficients_of_the_mean_are_pulled_to_0_by_a_millionth_of_the_largest_atom(
    rng,
):
    sizes = np.array([1.0, 4.0, 0.25])
    atoms = resized(rng.standard_normal((3, 3, P)), sizes)
    A = flatten(atoms).T
    mean = A @ [1.0, 0.2, 3.0]
    largest = (A**2).sum(axis=0).max()
    pulled = A.T @ A + 1e-6 * largest * np.eye(3)
    expected = np.linalg.solve(pulled, A.T @ mean)

    found = mean_coefficients(atoms, mean.reshape(3, P))

    assert_allclose(found, expected, rtol=1e-7)


def test_y_up_is_the_same_scene_in_another_frame(noisy):
    mirror = np.array([1.0, -1.0])
    camera = noisy.camera
    upside_down = replace(
        noisy,
        camera=Camera(camera.focal, camera.centre * mirror, -1.0),
        landmarks=noisy.landmarks * mirror[:, None],
        start=FLIP @ noisy.start,
    )

    down = noisy.refine()
    up = upside_down.refine()

    assert_allclose(up.rotation, FLIP @ down.rotation, atol=1e-6)
    assert_allclose(up.translation, down.translation @ FLIP, atol=1e-6)


def test_outliers_pull_little_where_the_loss_is_soft(planted):
    landmarks = planted.landmarks.copy()
    landmarks[:, :, 0] += 2.0
    spoilt = replace(planted, landmarks=landmarks)

    def error_at(softness):
        found = spoilt.refine(softness=softness, ridge=1e-3)
        return np.median(rotation_angle(found.rotation, planted.rotation))

    assert error_at(0.02) < 0.1 * error_at(100.0)

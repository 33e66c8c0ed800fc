"""The posterior through a pinhole camera: planted shapes, the limit of a long lens, one
story.
"""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from shapefit.geometry.pinhole import Camera, project_pinhole
from shapefit.lifting.posterior.method import (
    find_rays,
    noise_of_rays,
    turn_towards_landmarks,
)
from shapefit.lifting.posterior.posterior import find_posterior
from tests.lifting.posterior.scenes import (
    FORWARD,
    RESIDUAL_VARIANCE,
    FilmedScene,
    P,
    assert_regions_hold,
)
from tests.points import centred, draw_rotations, resized, transpose, without_mean_depth

signs = pytest.mark.parametrize("sign", [1.0, -1.0])


def find(prior, landmarks, starts, slopes=None):
    n = len(landmarks)
    return find_posterior(
        landmarks,
        np.full((n, P), RESIDUAL_VARIANCE),
        np.zeros((n, P, 2, 2)),
        prior,
        starts,
        slopes=slopes,
        covariance=True,
    )


def in_unit_of_shapes(found):
    return resized(found.mean, 1 / found.scale)


def mean_error(points, truth):
    """Return the mean distance from true points, both about their centroids."""
    return np.linalg.norm(centred(points) - centred(truth), axis=1).mean()


@signs
class TestNearShapes:
    """Shapes that are only three to four times their size away."""

    DISTANCE = 6.0

    @pytest.fixture
    def prior(self, draw_mixture):
        return draw_mixture(4, p=P, size=0.12)

    @pytest.fixture
    def scene(self, prior, sign):
        return FilmedScene(prior, 400, self.DISTANCE, sign)

    @pytest.fixture
    def rays(self, scene):
        return find_rays(scene.landmarks, scene.camera)

    @pytest.fixture
    def found(self, prior, scene, rays):
        """Through the camera."""
        starts = scene.towards(scene.starts())
        return find(prior, rays.landmarks, starts, rays.slopes)

    @pytest.fixture
    def weak(self, prior, scene):
        """By weak perspective."""
        return find(prior, scene.landmarks, scene.starts())

    def test_the_camera_makes_them_better(self, found, weak, scene):
        along_the_ray = scene.towards(FORWARD)[:, 0]
        without_camera = along_the_ray @ in_unit_of_shapes(weak)

        error = mean_error(in_unit_of_shapes(found), scene.shapes)

        assert error < 0.75 * mean_error(without_camera, scene.shapes)

    def test_the_camera_makes_the_images_likelier(self, found, weak):
        assert found.log_evidence.mean() > weak.log_evidence.mean() + 2

    def test_regions_hold_what_they_say(self, found, scene, rays):
        points = scene.shapes.copy()
        points[:, :2] += scene.translation[:, :2, None]
        in_pixels = resized(points, rays.focal / self.DISTANCE)
        assert_regions_hold(found, without_mean_depth(in_pixels))


def test_a_long_lens_sees_weak_perspective(draw_mixture):
    prior = draw_mixture(4, p=P)
    scene = FilmedScene(prior, 20, 1e7, 1.0)
    starts = scene.rotation[:, None]
    middle = scene.landmarks.mean(axis=2)
    rays = find_rays(scene.landmarks, Camera(np.full((20, 2), 1e9), middle, 1.0))

    weak = find(prior, scene.landmarks, starts)
    through = find(prior, rays.landmarks, starts, rays.slopes)

    weak.mean[:, :2] -= middle[..., None]
    size = weak.scale[:, None, None]
    assert through.mean / size == pytest.approx(weak.mean / size, abs=1e-5)
    assert through.deviation / size == pytest.approx(weak.deviation / size, abs=1e-5)
    assert through.log_evidence == pytest.approx(weak.log_evidence, abs=1e-5)


@signs
class TestLiftingThroughTheCamera:
    """Its fields tell one story: with one hidden landmark."""

    N = 30
    DISTANCE = 6.0

    @pytest.fixture
    def prior(self, draw_mixture):
        return draw_mixture(4, p=P)

    @pytest.fixture
    def scene(self, prior, sign):
        return FilmedScene(prior, self.N, self.DISTANCE, sign)

    @pytest.fixture
    def lifting(self, scene, prior):
        weights = np.ones((self.N, P))
        weights[3, 2] = 0.0
        return scene.lift(prior, weights)

    @pytest.fixture
    def place(self, lifting):
        """Of each shape before the camera (n, 3)."""
        return lifting.perspective.translation

    @pytest.fixture
    def depth(self, place, sign):
        return sign * place[:, 2]

    @pytest.fixture
    def shapes(self, lifting):
        """In their own unit, about their own origin."""
        shapes = lifting.shapes.copy()
        shapes[:, :2] -= lifting.translation[..., None]
        return resized(shapes, 1 / lifting.scale)

    def test_the_scale_is_that_at_the_depth(self, lifting, depth):
        focal = np.sqrt(1000 * 1100)
        assert lifting.scale == pytest.approx(focal / depth)

    def test_the_translation_is_where_the_place_is_seen(
        self, lifting, scene, place, depth
    ):
        slope = place[:, :2] / depth[:, None]
        seen = scene.camera.centre + scene.camera.focal * slope
        assert lifting.translation == pytest.approx(seen)

    def test_landmarks_are_those_of_the_shape_at_its_place(
        self, lifting, scene, shapes, place
    ):
        seen = project_pinhole(scene.camera, shapes + place[..., None])
        assert lifting.landmarks_fitted == pytest.approx(seen)

    def test_shapes_are_centred(self, shapes):
        assert shapes.mean(axis=2) == pytest.approx(0, abs=1e-9)

    def test_deviations_are_those_of_the_covariance(self, lifting):
        estimate = lifting.estimate
        variance = np.diagonal(estimate.covariance, axis1=1, axis2=2)
        expected = variance.reshape(self.N, 3, P)
        assert estimate.deviation**2 == pytest.approx(expected)

    def test_the_objective_is_the_negative_log_evidence(self, lifting):
        estimate = lifting.estimate
        assert_array_equal(estimate.objective, -estimate.log_evidence)

    def test_it_is_near_the_truth(self, lifting, scene, depth):
        off = np.linalg.norm(lifting.landmarks_fitted - scene.landmarks, axis=1)
        relative_depth = depth / self.DISTANCE
        assert np.median(off) < 20
        assert np.median(np.abs(relative_depth - 1)) < 0.1


def test_the_noise_of_a_landmark_is_that_of_its_ray(rng):
    """Samples of noise in pixels that are not square, seen as rays."""
    focal = np.array([[900.0, 400.0]])
    camera = Camera(focal, np.array([[320.0, 240.0]]), 1.0)
    covariance = np.array([[4.0, 1.5], [1.5, 9.0]])
    samples = rng.multivariate_normal([500, 100], covariance, 100_000).T
    rays = find_rays(samples[None], camera)

    noise = noise_of_rays(covariance[None, None], rays, camera)

    expected = np.cov(rays.landmarks[0])
    assert_allclose(noise[0, 0], expected, rtol=0.03)


def test_a_focal_length_that_is_assumed_leaves_points_open_along_their_rays(rng):
    """A shape seen with another focal length, from as much farther away: its points
    move by what the noise allows for.
    """
    shape = rng.standard_normal((1, 3, 50))
    depth = 4.0
    sd = 1e-4
    centre = np.zeros((1, 2))
    camera = Camera(np.full((1, 2), depth), centre, 1.0, focal_sd=sd)
    points = shape + np.array([[0.5], [-0.3], [depth]])
    landmarks = project_pinhole(camera, points)
    longer = Camera(camera.focal * (1 + sd), centre, 1.0)
    farther = points + np.array([[0.0], [0.0], [depth * sd]])
    move = project_pinhole(longer, farther) - landmarks
    move *= points[:, 2:] / depth  # as in the middle of the shape
    share = move / shape[:, 2:]  # of the depth
    expected = np.einsum("nap,nbp->npab", share, share)

    rays = find_rays(landmarks, camera)
    noise = noise_of_rays(np.zeros((1, 50, 2, 2)), rays, camera)

    assert_allclose(noise, expected, rtol=2e-3, atol=1e-4 * expected.max())


@signs
class TestTurn:
    """Rotations are turned onto the ray to what is seen, and no further."""

    N = 5
    P = 8

    @pytest.fixture
    def camera(self, rng, sign):
        focal = rng.uniform(800, 900, (self.N, 2))
        return Camera(focal, rng.uniform(200, 300, (self.N, 2)), sign)

    @pytest.fixture
    def landmarks(self, rng, camera):
        return rng.uniform(0, 900, (self.N, 2, self.P))

    @pytest.fixture
    def visible(self, rng, landmarks):
        return rng.random((self.N, self.P)) < 0.6

    @pytest.fixture
    def turn(self, rng, landmarks, visible, camera):
        """By which three rotations of each image are turned."""
        rotations = draw_rotations(self.N, 3, rng)
        turned = turn_towards_landmarks(rotations, landmarks, visible, camera)
        return turned @ transpose(rotations)

    @pytest.fixture
    def ray(self, landmarks, visible, camera, sign):
        """To the middle of the landmarks that are seen, of length 1."""
        middle = [w[:, s].mean(axis=1) for w, s in zip(landmarks, visible, strict=True)]
        slope = (np.stack(middle) - camera.centre) / camera.focal
        ray = np.column_stack([slope, np.full(self.N, sign)])
        return ray / np.linalg.norm(ray, axis=1, keepdims=True)

    def test_the_optical_axis_comes_onto_the_ray(self, turn, ray, sign):
        axis = np.array([0.0, 0.0, sign])
        expected = np.broadcast_to(ray[:, None], (self.N, 3, 3))
        assert_allclose(turn @ axis, expected, atol=1e-12)

    def test_it_turns_by_no_more_than_the_angle_between_them(self, turn, ray, sign):
        trace = np.trace(turn[:, 0], axis1=1, axis2=2)
        cosine_of_turn = (trace - 1) / 2
        cosine_to_axis = sign * ray[:, 2]
        assert_allclose(cosine_of_turn, cosine_to_axis)

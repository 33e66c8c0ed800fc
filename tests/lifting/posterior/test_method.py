"""The posterior through a pinhole camera: planted shapes, the limit of a long lens, one
story.
"""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from shapefit.geometry.pinhole import Camera, project_pinhole
from shapefit.geometry.rotations import random_rotations
from shapefit.lifting.posterior.method import (
    find_rays,
    noise_of_rays,
    turn_towards_landmarks,
)
from shapefit.lifting.posterior.posterior import find_posterior
from tests.lifting.posterior.scenes import (
    RESIDUAL_VARIANCE,
    FilmedScene,
    P,
    assert_regions_hold,
)


def posterior(prior, landmarks, starts, slopes=None):
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


def through_camera(prior, scene):
    rays = find_rays(scene.landmarks, scene.camera)
    starts = turn_towards_landmarks(
        scene.starts(), scene.landmarks, scene.visible, scene.camera
    )
    return rays, posterior(prior, rays.landmarks, starts, rays.slopes)


def error(points, truth):
    apart = points - points.mean(axis=2, keepdims=True)
    apart -= truth - truth.mean(axis=2, keepdims=True)
    return np.linalg.norm(apart, axis=1).mean()


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_camera_makes_near_shapes_better_and_its_regions_hold(draw_mixture, sign):
    prior = draw_mixture(4, p=P, size=0.12)
    scene = FilmedScene(
        prior, 400, 6.0, sign
    )  # three to four times the size of the shapes
    rays, found = through_camera(prior, scene)
    weak = posterior(prior, scene.landmarks, scene.starts())
    along = turn_towards_landmarks(
        np.eye(3)[None, None], scene.landmarks, scene.visible, scene.camera
    )[:, 0]
    without = error(along @ (weak.mean / weak.scale[:, None, None]), scene.shapes)
    assert error(found.mean / found.scale[:, None, None], scene.shapes) < 0.75 * without
    assert found.log_evidence.mean() > weak.log_evidence.mean() + 2

    size = rays.focal / 6.0
    truth = size[:, None, None] * scene.shapes
    truth[:, :2] += size[:, None, None] * scene.translation[:, :2, None]
    truth[:, 2] -= truth[:, 2].mean(axis=1, keepdims=True)
    assert_regions_hold(found, truth)


def test_a_long_lens_sees_weak_perspective(draw_mixture):
    prior = draw_mixture(4, p=P)
    scene = FilmedScene(prior, 20, 1e7, 1.0)
    centred = Camera(np.full((20, 2), 1e9), scene.landmarks.mean(axis=2), 1.0)
    rays = find_rays(scene.landmarks, centred)
    starts = scene.rotation[:, None]
    through = posterior(prior, rays.landmarks, starts, rays.slopes)
    weak = posterior(prior, scene.landmarks, starts)
    middle = scene.landmarks.mean(axis=2)[..., None]
    weak.mean[:, :2] -= middle
    size = weak.scale[:, None, None]
    assert through.mean / size == pytest.approx(weak.mean / size, abs=1e-5)
    assert through.deviation / size == pytest.approx(weak.deviation / size, abs=1e-5)
    assert through.log_evidence == pytest.approx(weak.log_evidence, abs=1e-5)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_lifting_through_the_camera_tells_one_story(draw_mixture, sign):
    prior = draw_mixture(4, p=P)
    scene = FilmedScene(prior, 30, 6.0, sign)
    weights = np.ones((30, P))
    weights[3, 2] = 0.0
    found = scene.lift(prior, weights)
    t = found.perspective.translation
    depth = sign * t[:, 2]
    assert found.scale == pytest.approx(np.sqrt(1000 * 1100) / depth)
    assert_array_equal(found.estimate.objective, -found.estimate.log_evidence)
    at = scene.camera.centre + scene.camera.focal * t[:, :2] / depth[:, None]
    assert found.translation == pytest.approx(at)
    S = found.shapes.copy()
    S[:, :2] -= found.translation[..., None]
    S /= found.scale[:, None, None]
    assert found.landmarks_fitted == pytest.approx(
        project_pinhole(scene.camera, S + t[..., None])
    )
    assert S.mean(axis=2) == pytest.approx(0, abs=1e-9)
    variance = np.diagonal(found.estimate.covariance, axis1=1, axis2=2).reshape(
        30, 3, P
    )
    assert found.estimate.deviation**2 == pytest.approx(variance)
    assert np.median(np.abs(depth / 6 - 1)) < 0.1
    off = np.linalg.norm(found.landmarks_fitted - scene.landmarks, axis=1)
    assert np.median(off) < 20


def test_the_noise_of_a_landmark_is_that_of_its_ray(rng):
    """Samples of noise in pixels that are not square, seen as rays."""
    camera = Camera(np.array([[900.0, 400.0]]), np.array([[320.0, 240.0]]), 1.0)
    covariance = np.array([[4.0, 1.5], [1.5, 9.0]])
    w = rng.multivariate_normal([500, 100], covariance, 100_000).T[None]
    rays = find_rays(w, camera)
    found = noise_of_rays(covariance[None, None], rays, camera)
    assert_allclose(found[0, 0], np.cov(rays.landmarks[0]), rtol=0.03)


def test_a_focal_length_that_is_assumed_leaves_points_open_along_their_rays(rng):
    """A shape seen with another focal length: its points move by what the noise allows
    for.
    """
    shape, e = rng.standard_normal((1, 3, 50)), 1e-4
    centre, at = np.zeros((1, 2)), np.array([0.5, -0.3, 4.0])
    camera = Camera(np.full((1, 2), 4.0), centre, 1.0, focal_sd=e)
    points = shape + at[None, :, None]
    w = project_pinhole(camera, points)
    longer = Camera(camera.focal * (1 + e), centre, 1.0)
    further = points + np.array([[0.0], [0.0], [4.0 * e]])  # as large in the image
    moved = (
        (project_pinhole(longer, further) - w) * points[:, 2:] / 4.0
    )  # as in the middle of the shape
    found = noise_of_rays(np.zeros((1, 50, 2, 2)), find_rays(w, camera), camera)
    expected = np.einsum("nap,nbp,np->npab", moved, moved, shape[:, 2] ** -2.0)
    assert_allclose(found, expected, rtol=2e-3, atol=1e-4 * expected.max())


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_rotations_are_turned_onto_the_ray_to_what_is_seen_and_no_further(rng, sign):
    n, p = 5, 8
    camera = Camera(rng.uniform(800, 900, (n, 2)), rng.uniform(200, 300, (n, 2)), sign)
    landmarks, visible = rng.uniform(0, 900, (n, 2, p)), rng.random((n, p)) < 0.6
    rotations = random_rotations(3 * n, rng).reshape(n, 3, 3, 3)
    turn = turn_towards_landmarks(rotations, landmarks, visible, camera) @ np.swapaxes(
        rotations, 2, 3
    )
    middle = np.stack(
        [w[:, s].mean(axis=1) for w, s in zip(landmarks, visible, strict=True)]
    )
    ray = np.column_stack([(middle - camera.centre) / camera.focal, np.full(n, sign)])
    ray /= np.linalg.norm(ray, axis=1, keepdims=True)
    onto = np.broadcast_to(ray[:, None], (n, 3, 3))
    assert_allclose(turn @ [0.0, 0.0, sign], onto, atol=1e-12)
    assert_allclose((np.trace(turn[:, 0], axis1=1, axis2=2) - 1) / 2, sign * ray[:, 2])

"""A sequence before a camera becomes one of weak perspective, and is put back."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from shapefit.dictionary.mixture import Mixture
from shapefit.geometry.pinhole import project_pinhole
from shapefit.lifting.sequences import clips
from shapefit.lifting.sequences.clips import BodyMotion
from shapefit.lifting.sequences.through_camera import refine_through_camera
from shapefit.lifting.trust import expected_error
from tests.lifting.posterior.scenes import FilmedScene, P, draw_component, shares_of

N = 20


@pytest.fixture
def prior():
    mean, C = draw_component(np.random.default_rng(4), P, 0.1)
    return Mixture(np.ones(1), mean[None], C[None])


@pytest.fixture(params=[1.0, -1.0])
def scene(request, prior):
    return FilmedScene(prior, N, 6.0, request.param)


@pytest.fixture
def lifting(scene, prior):
    return scene.lift(prior, np.ones((N, P)), modes=2)


def test_what_is_not_refined_stays(scene, lifting):
    same = refine_through_camera(lifting, scene.landmarks, lambda weak, _: weak)
    for name in ("shapes", "landmarks_fitted", "translation", "scale"):
        assert_allclose(getattr(same, name), getattr(lifting, name), rtol=1e-9)
    assert_allclose(same.perspective.translation, lifting.perspective.translation)
    assert_allclose(same.estimate.deviation, lifting.estimate.deviation)


def test_modes_and_points_are_in_one_frame(scene, lifting):
    def look(weak, landmarks):
        first = weak.scale[:, None, None] * weak.estimate.modes.mean[:, 0]
        best = shares_of(weak.estimate.modes)[:, 0] > 0.999
        assert best.any()
        assert_allclose(weak.shapes[best], first[best], atol=0.02 * weak.scale.max())
        deviation = weak.scale[:, None, None] * weak.estimate.deviation
        expected = lifting.scale[:, None, None] * lifting.estimate.deviation
        assert_allclose(deviation, expected)
        return weak

    refine_through_camera(lifting, scene.landmarks, look)


def test_landmarks_of_true_depths_are_those_of_weak_perspective(scene, lifting):
    S = scene.shapes - scene.shapes.mean(axis=2, keepdims=True)
    t = scene.translation + scene.shapes.mean(axis=2)
    scale = np.sqrt(scene.camera.focal.prod(axis=1)) / np.abs(t[:, 2])
    view = replace(lifting.perspective, translation=t)
    true = replace(lifting, scale=scale, estimate=replace(lifting.estimate, shapes=S),
                   perspective=view)  # fmt: skip
    exact = project_pinhole(scene.camera, S + t[..., None])
    visible = []

    def look(weak, landmarks):
        visible.append(landmarks)
        assert_allclose(landmarks, weak.shapes[:, :2], atol=1e-9 * scale.max())
        return weak

    back = refine_through_camera(true, exact, look)
    assert len(visible) == 1
    assert_allclose(back.landmarks_fitted, exact)


def test_the_expected_error_of_the_images_is_kept_beside_that_of_the_sequence(
    scene, lifting, monkeypatch
):
    """And covariances have the variances of the bars, which grow by landmark."""
    monkeypatch.setattr(clips, "CONSTANTS", replace(clips.CONSTANTS, farthest=np.inf))
    motion = BodyMotion(np.array([[0, 1]]), np.full(P, 0.05), np.ones(1))
    lifting.estimate.deviation[7] *= (
        1e3  # an image that says nothing has the bars of a neighbour
    )
    lifting.estimate.covariance[7] *= 1e6
    images = lifting.estimate.covariance * lifting.scale[:, None, None] ** 2
    expected = expected_error(lifting.shapes, images)

    def refine(weak, landmarks):
        one = ["one"] * N
        return clips.refine_lifting(weak, landmarks, one, motion, 0.01, None, bar_scale)

    bar_scale = np.linspace(1, 2, P)
    found = refine_through_camera(lifting, scene.landmarks, refine)
    assert_allclose(found.estimate.image_error, expected)
    assert np.isfinite(found.estimate.sequence_noise).all()
    C = found.estimate.covariance
    assert_allclose(C, C.swapaxes(1, 2), atol=1e-9 * C.max())
    variance = np.diagonal(C, axis1=1, axis2=2).reshape(N, 3, P)
    assert_allclose(found.estimate.deviation**2, variance, rtol=1e-6)

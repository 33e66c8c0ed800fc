"""A sequence before a camera becomes one of weak perspective, and is put back."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from shapefit.geometry.pinhole import project_pinhole
from shapefit.lifting.sequences import clips
from shapefit.lifting.sequences.clips import BodyMotion
from shapefit.lifting.sequences.through_camera import refine_through_camera
from shapefit.lifting.trust import expected_error
from tests.gaussians import single_gaussian
from tests.lifting.posterior.scenes import FilmedScene, P, draw_component, shares_of
from tests.points import centred, resized, transpose

N = 20
"""Images."""


@pytest.fixture
def prior():
    mean, C = draw_component(np.random.default_rng(4), P, 0.1)
    return single_gaussian(mean, C)


@pytest.fixture(params=[1.0, -1.0])
def scene(request, prior):
    return FilmedScene(prior, N, 6.0, request.param)


@pytest.fixture
def lifting(scene, prior):
    return scene.lift(prior, np.ones((N, P)), modes=2)


@pytest.mark.parametrize("name", ["shapes", "landmarks_fitted", "translation", "scale"])
def test_what_is_not_refined_stays(scene, lifting, name):
    same = refine_through_camera(lifting, scene.landmarks, lambda weak, _: weak)
    assert_allclose(getattr(same, name), getattr(lifting, name), rtol=1e-9)


def test_place_and_bars_stay_where_nothing_is_refined(scene, lifting):
    same = refine_through_camera(lifting, scene.landmarks, lambda weak, _: weak)
    assert_allclose(same.perspective.translation, lifting.perspective.translation)
    assert_allclose(same.estimate.deviation, lifting.estimate.deviation)


def in_unit_of_landmarks(lifting, values):
    """Scale what an estimate says (n, 3, p)."""
    return resized(values, lifting.scale)


class Look:
    """A refinement that changes nothing, and remembers what it has got."""

    def __call__(self, weak, landmarks):
        self.weak = weak
        self.landmarks = landmarks
        return weak


class TestWeakPerspective:
    """What is refined is a sequence of weak perspective."""

    @pytest.fixture
    def weak(self, scene, lifting):
        look = Look()
        refine_through_camera(lifting, scene.landmarks, look)
        return look.weak

    def test_modes_and_points_are_in_one_frame(self, weak):
        """In images of which nearly all is said by one mode."""
        modes = weak.estimate.modes
        first = in_unit_of_landmarks(weak, modes.mean[:, 0])
        has_one = shares_of(modes)[:, 0] > 0.999
        assert has_one.any()
        error = 0.02 * weak.scale.max()
        assert_allclose(weak.shapes[has_one], first[has_one], atol=error)

    def test_bars_are_as_wide_as_they_were(self, weak, lifting):
        found = in_unit_of_landmarks(weak, weak.estimate.deviation)
        expected = in_unit_of_landmarks(lifting, lifting.estimate.deviation)
        assert_allclose(found, expected)


class TestTrueDepths:
    """A lifting with the true shapes at their true places."""

    @pytest.fixture
    def shapes(self, scene):
        return centred(scene.shapes)

    @pytest.fixture
    def places(self, scene):
        return scene.translation + scene.shapes.mean(axis=2)

    @pytest.fixture
    def exact_landmarks(self, scene, shapes, places):
        return project_pinhole(scene.camera, shapes + places[..., None])

    @pytest.fixture
    def true(self, scene, lifting, shapes, places):
        focal = np.sqrt(scene.camera.focal.prod(axis=1))
        return replace(
            lifting,
            scale=focal / np.abs(places[:, 2]),
            estimate=replace(lifting.estimate, shapes=shapes),
            perspective=replace(lifting.perspective, translation=places),
        )

    def test_landmarks_are_those_of_weak_perspective(self, true, exact_landmarks):
        look = Look()
        refine_through_camera(true, exact_landmarks, look)
        rounding = 1e-9 * true.scale.max()
        assert_allclose(look.landmarks, look.weak.shapes[:, :2], atol=rounding)

    def test_they_come_back_exactly(self, true, exact_landmarks):
        back = refine_through_camera(true, exact_landmarks, Look())
        assert_allclose(back.landmarks_fitted, exact_landmarks)


class TestMovedBodies:
    """A refinement that moves bodies sideways and bends them."""

    @pytest.fixture
    def moved(self, scene, lifting):
        rng = np.random.default_rng(5)

        def refine(weak, landmarks):
            size = weak.scale[:, None, None]
            bent = weak.shapes + 0.1 * size * rng.standard_normal(weak.shapes.shape)
            bent[:, :2] += 0.5 * size * rng.standard_normal((N, 2, 1))
            return replace(weak, shapes=bent)

        return refine_through_camera(lifting, scene.landmarks, refine)

    def test_the_translation_is_where_the_camera_sees_the_middle(self, scene, moved):
        middle = moved.perspective.translation[..., None]
        seen = project_pinhole(scene.camera, middle)[..., 0]
        assert_allclose(moved.translation, seen)

    def test_shapes_lie_about_their_translation(self, moved):
        middle = moved.shapes[:, :2].mean(axis=2)
        assert_allclose(middle, moved.translation)

    def test_fitted_landmarks_are_the_shapes_seen_from_there(self, scene, moved):
        in_sizes = centred(moved.shapes) / moved.scale[:, None, None]
        in_sizes[:, 2] = moved.shapes[:, 2] / moved.scale[:, None]
        before_camera = in_sizes + moved.perspective.translation[..., None]
        seen = project_pinhole(scene.camera, before_camera)
        assert_allclose(moved.landmarks_fitted, seen)

    def test_the_estimate_has_the_translation_too(self, moved):
        translation = moved.estimate.camera_translation
        assert_allclose(translation, moved.perspective.translation)


class TestErrors:
    """Of a sequence of which one image says nothing, and has the bars of a neighbour;
    bars grow by landmark.
    """

    SAYS_NOTHING = 7

    @pytest.fixture(autouse=True)
    def however_far(self, monkeypatch):
        constants = replace(clips.CONSTANTS, max_displacement=np.inf)
        monkeypatch.setattr(clips, "CONSTANTS", constants)

    @pytest.fixture
    def lifting(self, lifting):
        lifting.estimate.deviation[self.SAYS_NOTHING] *= 1e3
        lifting.estimate.covariance[self.SAYS_NOTHING] *= 1e6
        return lifting

    @pytest.fixture
    def error_of_images(self, lifting):
        covariance = resized(lifting.estimate.covariance, lifting.scale**2)
        return expected_error(lifting.shapes, covariance)

    @pytest.fixture
    def refined(self, scene, lifting, error_of_images):
        one_bone = np.array([[0, 1]])
        motion = BodyMotion(one_bone, np.full(P, 0.05), np.ones(1))
        bar_scale = np.linspace(1, 2, P)

        def refine(weak, landmarks):
            sequence = ["one"] * N
            return clips.refine_lifting(
                weak, landmarks, sequence, motion, 0.01, None, bar_scale
            )

        return refine_through_camera(lifting, scene.landmarks, refine).estimate

    def test_that_of_the_images_is_kept_beside_that_of_the_sequence(
        self, refined, error_of_images
    ):
        assert_allclose(refined.image_error, error_of_images)
        assert np.isfinite(refined.sequence_noise).all()

    def test_covariances_are_symmetric(self, refined):
        C = refined.covariance
        assert_allclose(C, transpose(C), atol=1e-9 * C.max())

    def test_covariances_have_the_variances_of_the_bars(self, refined):
        variance = np.diagonal(refined.covariance, axis1=1, axis2=2)
        expected = variance.reshape(N, 3, P)
        assert_allclose(refined.deviation**2, expected, rtol=1e-6)

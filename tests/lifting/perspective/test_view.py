"""Liftings refined under perspective: every method, fields that belong together, and
images that cannot be refined.
"""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from shapefit.convex.solver import Status
from shapefit.dictionary.model import Dictionary
from shapefit.geometry.normalisation import normalise
from shapefit.geometry.pinhole import Camera, project_pinhole
from shapefit.geometry.rotations import random_rotations, rotation_angle
from shapefit.lifting.lift import Program, lift
from shapefit.lifting.perspective import refine_view
from tests.lifting.estimators import make_estimator
from tests.points import mix, norms, resized, with_noise

N = 6
"""Images."""

K = 5
"""Atoms."""

P = 14
"""Landmarks."""

ALL_SEEN = np.ones((N, P))


@pytest.fixture
def dictionary(rng):
    mean = rng.standard_normal((3, P))
    atoms = normalise(mean + 0.3 * rng.standard_normal((K, 3, P))).points
    names = tuple(f"point{j}" for j in range(P))
    mean_shape = normalise(atoms.mean(axis=0)).points
    return Dictionary(atoms, names, mean_shape)


@pytest.fixture
def rotations(rng):
    return random_rotations(N, rng)


@pytest.fixture
def camera():
    focal = np.tile([900.0, 910.0], (N, 1))
    centre = np.tile([320.0, 240.0], (N, 1))
    return Camera(focal, centre, 1.0)


@pytest.fixture
def landmarks(dictionary, rotations, camera, rng):
    """Mixtures of atoms, 8 units away, in pixels."""
    c = rng.dirichlet(np.ones(K), N)
    x = rng.uniform(-1, 1, N)
    y = rng.uniform(-1, 1, N)
    t = np.column_stack([x, y, np.full(N, 8.0)])
    points = rotations @ mix(c, dictionary.atoms) + t[..., None]
    return project_pinhole(camera, points)


def lift_from_afar(landmarks, weights, dictionary, method="convex+refine"):
    estimator = make_estimator(method, mean_shape=dictionary.mean_shape)
    return lift(landmarks, weights, dictionary.atoms, Program(lam=0.3), estimator)


METHODS = ["convex", "convex+refine", "alternate", "mean-shape"]


@pytest.mark.parametrize("method", METHODS)
def test_every_method_can_be_refined(method, landmarks, dictionary, camera, rotations):
    first = lift_from_afar(landmarks, ALL_SEEN, dictionary, method)

    found = refine_view(first, landmarks, camera, dictionary)

    assert rotation_angle(found.estimate.rotation, rotations).max() < 1.0
    assert (found.estimate.residual < 0.5 * first.estimate.residual).all()


class TestFields:
    """The fields of a refined lifting belong together: with noise, weights, and some
    landmarks hidden.
    """

    @pytest.fixture
    def weights(self, rng):
        weights = rng.uniform(0.3, 1.5, (N, P))
        weights[1, :4] = 0.0
        return weights

    @pytest.fixture
    def noisy(self, landmarks, weights, rng):
        return with_noise(landmarks, 5.0, rng)

    @pytest.fixture
    def found(self, noisy, weights, dictionary, camera):
        first = lift_from_afar(noisy, weights, dictionary)
        return refine_view(first, noisy, camera, dictionary)

    @pytest.fixture
    def shapes(self, found, dictionary):
        """In the unit of the atoms, about their own origin."""
        estimate = found.estimate
        return estimate.rotation @ mix(estimate.coefficients, dictionary.atoms)

    @pytest.fixture
    def place(self, found):
        """Of the origin of each shape before the camera (n, 3, 1)."""
        return found.perspective.translation[..., None]

    def test_shapes_are_mixtures_of_atoms(self, found, shapes):
        assert_allclose(found.estimate.shapes, shapes)

    def test_shapes_are_scaled_and_placed_in_the_image(self, found, shapes):
        without_depth = np.pad(found.translation, ((0, 0), (0, 1)))
        scaled = resized(shapes, found.scale)
        assert_allclose(found.shapes, scaled + without_depth[..., None])

    def test_landmarks_are_those_before_the_camera(self, found, shapes, place, camera):
        expected = project_pinhole(camera, shapes + place)
        assert_allclose(found.landmarks_fitted, expected, rtol=1e-9)

    def test_the_scale_is_that_at_the_depth_of_the_origin(self, found, place):
        depth = place[:, 2, 0]
        assert_allclose(found.scale, np.sqrt(900 * 910) / depth)

    def test_the_translation_is_where_the_origin_is_seen(self, found, place, camera):
        origin = project_pinhole(camera, place)[..., 0]
        assert_allclose(found.translation, origin)

    def test_transforms_are_coefficients_times_rows_of_the_rotation(self, found):
        c = found.estimate.coefficients[..., None, None]
        rows = found.estimate.rotation[:, None, :2]
        assert_allclose(found.estimate.transforms.dense(), c * rows)

    def test_the_translation_of_the_estimate_is_normalised(self, found, noisy, weights):
        normalised = normalise(noisy, weights > 0)
        scaled = normalised.scale[:, None] * found.estimate.translation
        assert_allclose(scaled + normalised.centroid, found.translation)

    def test_the_residual_is_a_share_of_what_is_left_without_a_shape(
        self, found, noisy, weights
    ):
        w = weights[:, None]
        total = (w**2).sum(axis=2, keepdims=True)
        mean = (w**2 * noisy).sum(axis=2, keepdims=True) / total
        left = norms(w * (noisy - found.landmarks_fitted))
        left_without_shape = norms(w * (noisy - mean))
        assert_allclose(found.estimate.residual, left / left_without_shape)

    def test_the_camera_is_kept(self, found, camera):
        assert_array_equal(found.perspective.camera.focal, camera.focal)


class TestCameraInsideTheObject:
    """A focal length in another unit than the landmarks puts some of them behind the
    camera: the user has to mend it.
    """

    IMAGE = 3
    OTHERS = np.array([0, 1, 2, 4, 5])

    @pytest.fixture
    def first(self, landmarks, dictionary):
        return lift_from_afar(landmarks, ALL_SEEN, dictionary)

    @pytest.fixture
    def found(self, first, landmarks, camera, dictionary):
        focal = camera.focal.copy()
        focal[self.IMAGE] = 20.0
        near = Camera(focal, camera.centre, camera.sign)
        return refine_view(first, landmarks, near, dictionary)

    def test_the_image_fails_and_the_keys_are_named(self, found):
        assert [*found.failures] == [self.IMAGE]
        reason = found.failures[self.IMAGE]
        assert "start behind the camera" in reason
        assert "`camera.focal` and `camera.principal_point`" in reason

    @pytest.mark.parametrize(
        "name", ["shapes", "landmarks_fitted", "translation", "scale"]
    )
    def test_nothing_of_it_is_left_in_the_lifting(self, found, name):
        values = getattr(found, name)
        assert np.isnan(values[self.IMAGE]).all()
        assert np.isfinite(values[self.OTHERS]).all()

    @pytest.mark.parametrize(
        "name", ["shapes", "rotation", "objective", "residual", "coefficients"]
    )
    def test_nothing_of_it_is_left_in_the_estimate(self, found, name):
        values = getattr(found.estimate, name)
        assert np.isnan(values[self.IMAGE]).all()
        assert np.isfinite(values[self.OTHERS]).all()

    def test_it_has_no_place_before_the_camera(self, found):
        place = found.perspective.translation
        assert np.isnan(place[self.IMAGE]).all()
        assert np.isfinite(place[self.OTHERS]).all()

    def test_its_iterations_are_those_before(self, found, first):
        before = first.estimate.iterations[self.IMAGE]
        assert found.estimate.status[self.IMAGE] is Status.DEGENERATE
        assert found.estimate.iterations[self.IMAGE] == before

    def test_the_others_do_not_feel_it(
        self, found, first, landmarks, camera, dictionary
    ):
        clean = refine_view(first, landmarks, camera, dictionary)
        assert_array_equal(found.shapes[self.OTHERS], clean.shapes[self.OTHERS])


def test_an_image_without_a_shape_stays_without(landmarks, dictionary, camera):
    weights = ALL_SEEN.copy()
    weights[2, 2:] = 0
    first = lift_from_afar(landmarks, weights, dictionary)

    found = refine_view(first, landmarks, camera, dictionary)

    others = np.delete(found.shapes, 2, axis=0)
    assert [*found.failures] == [2]
    assert dict(found.failures) == dict(first.failures)
    assert found.estimate.status[2] is first.estimate.status[2]
    assert np.isnan(found.shapes[2]).all()
    assert np.isnan(found.perspective.translation[2]).all()
    assert np.isfinite(others).all()

"""A lifting refined under perspective: one story told by all its fields."""

import numpy as np
import pytest

from shapefit.convex.solver import Status, solve_newton
from shapefit.dictionary.model import Dictionary
from shapefit.geometry.normalisation import normalise
from shapefit.geometry.pinhole import Camera, project
from shapefit.geometry.rotations import random_rotations, rotation_angle
from shapefit.lifting.lift import Program, lift
from shapefit.lifting.methods import Settings, choose_method
from shapefit.lifting.perspective import refine_view

N, K, P = 6, 5, 14


@pytest.fixture
def dictionary(rng):
    atoms = normalise(rng.standard_normal((3, P)) + 0.3 * rng.standard_normal((K, 3, P))).points
    names = tuple(f"point{j}" for j in range(P))
    return Dictionary(atoms, names, normalise(atoms.mean(axis=0)).points)


@pytest.fixture
def rotations(rng):
    return random_rotations(N, rng)


@pytest.fixture
def camera():
    return Camera(np.tile([900.0, 910.0], (N, 1)), np.tile([320.0, 240.0], (N, 1)), 1.0)


@pytest.fixture
def landmarks(dictionary, rotations, camera, rng):
    """Mixtures of atoms, 8 units away, in pixels."""
    c = rng.dirichlet(np.ones(K), N)
    t = np.stack([rng.uniform(-1, 1, N), rng.uniform(-1, 1, N), np.full(N, 8.0)], axis=1)
    X = rotations @ np.tensordot(c, dictionary.atoms, axes=1) + t[..., None]
    return project(camera, X)


def view(landmarks, weights, dictionary, camera, method="convex+refine"):
    settings = Settings(solve=solve_newton, mean_shape=dictionary.mean_shape)
    estimator = choose_method(method, settings)
    first = lift(landmarks, weights, dictionary.atoms, Program(lam=0.3), estimator)
    return first, refine_view(first, landmarks, camera, dictionary)


@pytest.mark.parametrize("method", ["convex", "convex+refine", "alternate", "mean-shape"])
def test_every_method_can_be_refined(method, landmarks, dictionary, camera, rotations):
    first, found = view(landmarks, np.ones((N, P)), dictionary, camera, method)
    assert rotation_angle(found.estimate.rotation, rotations).max() < 1.0
    assert (found.estimate.residual < 0.5 * first.estimate.residual).all()


def test_the_fields_belong_together(landmarks, dictionary, camera, rng):
    weights = rng.uniform(0.3, 1.5, (N, P))
    weights[1, :4] = 0.0
    landmarks = landmarks + 5.0 * rng.standard_normal(landmarks.shape)
    _, found = view(landmarks, weights, dictionary, camera)
    e, visible = found.estimate, found.perspective
    S = e.rotation @ np.tensordot(e.coefficients, dictionary.atoms, axes=1)
    np.testing.assert_allclose(e.shapes, S)
    flat = np.pad(found.translation, ((0, 0), (0, 1)))
    np.testing.assert_allclose(found.shapes, found.scale[:, None, None] * S + flat[..., None])
    X = S + visible.translation[..., None]
    np.testing.assert_allclose(found.landmarks_fitted, project(camera, X), rtol=1e-9)
    np.testing.assert_allclose(found.scale, np.sqrt(900 * 910) / visible.translation[:, 2])
    np.testing.assert_allclose(
        found.translation, project(camera, visible.translation[..., None])[..., 0]
    )
    np.testing.assert_allclose(
        e.transforms.dense(), e.coefficients[..., None, None] * e.rotation[:, None, :2]
    )
    w = weights[:, None]
    centred = landmarks - (w**2 * landmarks).sum(2, keepdims=True) / (w**2).sum(2, keepdims=True)
    residual_variance = np.linalg.norm(w * (landmarks - found.landmarks_fitted), axis=(1, 2))
    np.testing.assert_allclose(
        e.residual, residual_variance / np.linalg.norm(w * centred, axis=(1, 2))
    )
    np.testing.assert_array_equal(visible.camera.focal, camera.focal)


def test_a_camera_inside_the_object_is_the_users_to_mend(landmarks, dictionary, camera):
    """A focal length in another unit than the landmarks puts some of them behind the camera."""
    focal = camera.focal.copy()
    focal[3] = 20.0
    near = Camera(focal, camera.centre, camera.sign)
    first, found = view(landmarks, np.ones((N, P)), dictionary, near)
    assert list(found.failures) == [3]
    assert "start behind the camera" in found.failures[3]
    assert "`camera.focal` or `camera.intrinsics`" in found.failures[3]
    e = found.estimate
    assert e.status[3] is Status.DEGENERATE
    for values in (
        found.shapes, found.landmarks_fitted, found.translation, found.scale, e.shapes, e.rotation,
        e.objective, e.residual, e.coefficients, found.perspective.translation,
    ):  # fmt: skip
        assert np.isnan(values[3]).all()
        assert np.isfinite(np.delete(values, 3, axis=0)).all()
    assert e.iterations[3] == first.estimate.iterations[3]
    others = np.arange(N) != 3
    _, clean = view(landmarks, np.ones((N, P)), dictionary, camera)
    np.testing.assert_array_equal(found.shapes[others], clean.shapes[others])


def test_an_image_without_a_shape_stays_without(landmarks, dictionary, camera):
    weights = np.ones((N, P))
    weights[2, 2:] = 0
    first, found = view(landmarks, weights, dictionary, camera)
    assert dict(found.failures) == dict(first.failures)
    assert list(found.failures) == [2]
    assert np.isnan(found.shapes[2]).all()
    assert np.isnan(found.perspective.translation[2]).all()
    assert np.isfinite(np.delete(found.shapes, 2, axis=0)).all()
    assert found.estimate.status[2] is first.estimate.status[2]

"""Refinement under perspective: planted shapes, stationarity, another solver, symmetries."""

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from shapefit.convex.solver import Status
from shapefit.geometry.normalisation import normalise
from shapefit.geometry.pinhole import Camera, project
from shapefit.geometry.rotations import random_rotations, rotation_about, rotation_angle
from shapefit.lifting.perspective import REASONS, mean_coefficients, refine_perspective

K, P = 6, 16
FLIP = np.diag([1.0, -1.0, -1.0])  # y down and z forward <-> y up and z to the viewer


@pytest.fixture
def atoms(rng):
    """Variations of one mean shape, normalised, as the models of a class are."""
    mean = rng.standard_normal((3, P))
    return normalise(mean + 0.3 * rng.standard_normal((K, 3, P))).points


@pytest.fixture
def prior(atoms):
    return mean_coefficients(atoms, normalise(atoms.mean(axis=0)).points)


class Planted:
    """n images of shapes with known c, R, t, close enough for strong perspective."""

    def __init__(self, rng, atoms, prior, n=8, noise=0.0, weighted=False):
        gauge = prior / (prior @ prior)
        c = rng.dirichlet(np.ones(K), n)
        self.coefficients = c / (c @ gauge)[:, None]
        self.rotation = random_rotations(n, rng)
        self.translation = np.stack(
            [rng.uniform(-1, 1, n), rng.uniform(-1, 1, n), rng.uniform(6, 12, n)], axis=1
        )
        self.shapes = self.rotation @ np.tensordot(self.coefficients, atoms, axes=1)
        focal = np.stack([np.full(n, 7.0), np.full(n, 7.5)], axis=1)
        self.camera = Camera(focal, rng.uniform(-0.5, 0.5, (n, 2)), 1.0)
        self.landmarks = project(self.camera, self.shapes + self.translation[..., None])
        self.landmarks = self.landmarks + noise * rng.standard_normal(self.landmarks.shape)
        self.weights = rng.uniform(0.3, 1.5, (n, P)) if weighted else np.ones((n, P))
        turns = [rotation_about(axis, np.array([0.2]))[0] for axis in random_axes(rng, n)]
        self.start = np.array(turns) @ self.rotation


def random_axes(rng, n):
    axes = rng.standard_normal((n, 3))
    return axes / np.linalg.norm(axes, axis=1, keepdims=True)


@pytest.fixture
def planted(rng, atoms, prior):
    return Planted(rng, atoms, prior)


@pytest.fixture
def noisy(rng, atoms, prior):
    return Planted(rng, atoms, prior, noise=0.05, weighted=True)


def refine(scene, atoms, prior, **options):
    changes = {
        key: options.pop(key)
        for key in ("landmarks", "weights", "camera", "start")
        if key in options
    }
    given = {**vars(scene), **changes}
    return refine_perspective(
        given["landmarks"], given["weights"], atoms, given["camera"], given["start"], prior,
        **options,
    )  # fmt: skip


def objective(scene, image, atoms, prior, R, t, c, ridge, softness):
    S = R @ np.tensordot(c, atoms, axes=1) + t[:, None]
    one = Camera(scene.camera.focal[image], scene.camera.centre[image], scene.camera.sign)
    flat = one.centre[:, None] + one.focal[:, None] * S[:2] / S[2]
    r = scene.weights[image] * (flat - scene.landmarks[image])
    loss = softness**2 * np.log1p((r**2).sum(axis=0) / softness**2).sum()
    return 0.5 * (loss + ridge * ((c - prior) ** 2).sum())


def test_planted_shapes_and_poses_are_found(planted, atoms, prior):
    found = refine(planted, atoms, prior, ridge=1e-9, max_rounds=5000)
    assert set(found.status) == {Status.CONVERGED}
    assert rotation_angle(found.rotation, planted.rotation).max() < 0.01
    np.testing.assert_allclose(found.translation, planted.translation, rtol=1e-3)
    shapes = found.rotation @ np.tensordot(found.coefficients, atoms, axes=1)
    np.testing.assert_allclose(shapes, planted.shapes, atol=1e-3)


@pytest.mark.parametrize("softness", [0.05, 2.0])
def test_an_independent_solver_cannot_lower_the_objective(noisy, atoms, prior, softness):
    found = refine(noisy, atoms, prior, softness=softness)
    for image in range(8):
        start = found.rotation[image]
        here = objective(
            noisy, image, atoms, prior, start, found.translation[image],
            found.coefficients[image], 0.3, softness,
        )  # fmt: skip
        np.testing.assert_allclose(found.objective[image], here, rtol=1e-9)

        def residuals(x, image=image, start=start):
            R = Rotation.from_rotvec(x[:3]).as_matrix() @ start
            c = x[6:] * (prior @ prior) / (x[6:] @ prior)
            camera = noisy.camera
            S = R @ np.tensordot(c, atoms, axes=1) + x[3:6, None]
            flat = camera.centre[image][:, None] + camera.focal[image][:, None] * S[:2] / S[2]
            r = noisy.weights[image] * np.linalg.norm(flat - noisy.landmarks[image], axis=0)
            cauchy = softness * np.sqrt(np.log1p((r / softness) ** 2))
            return np.concatenate([cauchy, np.sqrt(0.3) * (c - prior)])

        x = np.concatenate([np.zeros(3), found.translation[image], found.coefficients[image]])
        lower = np.concatenate([np.full(6, -np.inf), np.full(K, -1e-12)])
        other = least_squares(residuals, x, bounds=(lower, np.inf), xtol=1e-12, ftol=1e-12)
        assert other.cost >= here * (1 - 1e-6)


def test_y_up_is_the_same_scene_in_another_frame(noisy, atoms, prior):
    mirror = np.array([1.0, -1.0])
    camera = Camera(noisy.camera.focal, noisy.camera.centre * mirror, -1.0)
    down = refine(noisy, atoms, prior)
    up = refine(
        noisy, atoms, prior, camera=camera,
        landmarks=noisy.landmarks * mirror[:, None], start=FLIP @ noisy.start,
    )  # fmt: skip
    np.testing.assert_allclose(up.rotation, FLIP @ down.rotation, atol=1e-6)
    np.testing.assert_allclose(up.translation, down.translation @ FLIP, atol=1e-6)


def test_outliers_pull_little_where_the_loss_is_soft(planted, atoms, prior):
    landmarks = planted.landmarks.copy()
    landmarks[:, :, 0] += 2.0
    soft = refine(planted, atoms, prior, landmarks=landmarks, softness=0.02, ridge=1e-3)
    stiff = refine(planted, atoms, prior, landmarks=landmarks, softness=100.0, ridge=1e-3)
    angles = [rotation_angle(r.rotation, planted.rotation) for r in (soft, stiff)]
    assert np.median(angles[0]) < 0.1 * np.median(angles[1])


def test_a_visible_landmark_without_a_place_fails_its_image_alone(noisy, atoms, prior):
    landmarks = noisy.landmarks.copy()
    landmarks[2, 0, 5] = np.nan
    found, clean = refine(noisy, atoms, prior, landmarks=landmarks), refine(noisy, atoms, prior)
    assert found.status[2] in REASONS
    assert np.isnan(found.coefficients[2]).all()
    others = np.arange(8) != 2
    np.testing.assert_array_equal(found.coefficients[others], clean.coefficients[others])

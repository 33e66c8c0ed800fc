"""Refinement under perspective: planted shapes, another solver, fields that belong
together.
"""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from shapefit.convex.solver import Status
from shapefit.dictionary.model import Dictionary
from shapefit.geometry.normalisation import normalise
from shapefit.geometry.pinhole import Camera, project_pinhole
from shapefit.geometry.rotations import random_rotations, rotation_about, rotation_angle
from shapefit.lifting.lift import Program, lift
from shapefit.lifting.perspective import (
    mean_coefficients,
    place_in_depth,
    refine_perspective,
    refine_view,
)
from tests.lifting.estimators import make_estimator

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
            [rng.uniform(-1, 1, n), rng.uniform(-1, 1, n), rng.uniform(6, 12, n)],
            axis=1,
        )
        self.shapes = self.rotation @ np.tensordot(self.coefficients, atoms, axes=1)
        focal = np.stack([np.full(n, 7.0), np.full(n, 7.5)], axis=1)
        self.camera = Camera(focal, rng.uniform(-0.5, 0.5, (n, 2)), 1.0)
        self.landmarks = project_pinhole(
            self.camera, self.shapes + self.translation[..., None]
        )
        self.landmarks = self.landmarks + noise * rng.standard_normal(
            self.landmarks.shape
        )
        self.weights = rng.uniform(0.3, 1.5, (n, P)) if weighted else np.ones((n, P))
        turns = [
            rotation_about(axis, np.array([0.2]))[0] for axis in random_axes(rng, n)
        ]
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
        given["landmarks"],
        given["weights"],
        atoms,
        given["camera"],
        given["start"],
        prior,
        **options,
    )


def objective(scene, image, atoms, prior, R, t, c, ridge, softness):
    S = R @ np.tensordot(c, atoms, axes=1) + t[:, None]
    one = Camera(
        scene.camera.focal[image], scene.camera.centre[image], scene.camera.sign
    )
    flat = one.centre[:, None] + one.focal[:, None] * S[:2] / S[2]
    r = scene.weights[image] * (flat - scene.landmarks[image])
    loss = softness**2 * np.log1p((r**2).sum(axis=0) / softness**2).sum()
    return 0.5 * (loss + ridge * ((c - prior) ** 2).sum())


def test_planted_shapes_and_poses_are_found(planted, atoms, prior):
    found = refine(planted, atoms, prior, ridge=1e-9, max_rounds=5000)
    assert set(found.status) == {Status.CONVERGED}
    assert rotation_angle(found.rotation, planted.rotation).max() < 0.01
    assert_allclose(found.translation, planted.translation, rtol=1e-3)
    shapes = found.rotation @ np.tensordot(found.coefficients, atoms, axes=1)
    assert_allclose(shapes, planted.shapes, atol=1e-3)


@pytest.mark.parametrize("softness", [0.05, 2.0])
def test_an_independent_solver_cannot_lower_the_objective(
    noisy, atoms, prior, softness
):
    found = refine(noisy, atoms, prior, softness=softness)
    for image in range(8):
        start = found.rotation[image]
        here = objective(
            noisy,
            image,
            atoms,
            prior,
            start,
            found.translation[image],
            found.coefficients[image],
            0.3,
            softness,
        )
        assert_allclose(found.objective[image], here, rtol=1e-9)

        def residuals(x, image=image, start=start):
            R = Rotation.from_rotvec(x[:3]).as_matrix() @ start
            c = x[6:] * (prior @ prior) / (x[6:] @ prior)
            camera = noisy.camera
            S = R @ np.tensordot(c, atoms, axes=1) + x[3:6, None]
            flat = (
                camera.centre[image][:, None]
                + camera.focal[image][:, None] * S[:2] / S[2]
            )
            r = noisy.weights[image] * np.linalg.norm(
                flat - noisy.landmarks[image], axis=0
            )
            cauchy = softness * np.sqrt(np.log1p((r / softness) ** 2))
            return np.concatenate([cauchy, np.sqrt(0.3) * (c - prior)])

        x = np.concatenate(
            [np.zeros(3), found.translation[image], found.coefficients[image]]
        )
        lower = np.concatenate([np.full(6, -np.inf), np.full(K, -1e-12)])
        other = least_squares(
            residuals, x, bounds=(lower, np.inf), xtol=1e-12, ftol=1e-12
        )
        assert other.cost >= here * (1 - 1e-6)


def test_what_is_far_away_starts_where_it_is(rng, atoms):
    shape, t = atoms[0] + [[3], [1], [2]], np.array([[5.0, -4.0, 2000.0]])
    R, camera = random_rotations(1, rng), Camera(np.ones((1, 2)), np.zeros((1, 2)), 1.0)
    w = project_pinhole(camera, R @ shape + t[..., None])
    start = place_in_depth(w, np.ones((1, P)), shape, camera, R)
    assert_allclose(start, t, rtol=5e-4)


def test_coefficients_of_the_mean_are_pulled_to_0_by_a_millionth_of_the_largest_atom(
    rng,
):
    atoms = np.array([1.0, 4.0, 0.25])[:, None, None] * rng.standard_normal((3, 3, P))
    A = atoms.reshape(3, -1).T
    pulled = A.T @ A + 1e-6 * (A**2).sum(axis=0).max() * np.eye(3)
    mean = A @ [1.0, 0.2, 3.0]
    expected = np.linalg.solve(pulled, A.T @ mean)
    found = mean_coefficients(atoms, mean.reshape(3, P))
    assert_allclose(found, expected, rtol=1e-7)


def test_y_up_is_the_same_scene_in_another_frame(noisy, atoms, prior):
    mirror = np.array([1.0, -1.0])
    camera = Camera(noisy.camera.focal, noisy.camera.centre * mirror, -1.0)
    down = refine(noisy, atoms, prior)
    up = refine(
        noisy,
        atoms,
        prior,
        camera=camera,
        landmarks=noisy.landmarks * mirror[:, None],
        start=FLIP @ noisy.start,
    )
    assert_allclose(up.rotation, FLIP @ down.rotation, atol=1e-6)
    assert_allclose(up.translation, down.translation @ FLIP, atol=1e-6)


def test_outliers_pull_little_where_the_loss_is_soft(planted, atoms, prior):
    landmarks = planted.landmarks.copy()
    landmarks[:, :, 0] += 2.0
    soft = refine(planted, atoms, prior, landmarks=landmarks, softness=0.02, ridge=1e-3)
    stiff = refine(
        planted, atoms, prior, landmarks=landmarks, softness=100.0, ridge=1e-3
    )
    angles = [rotation_angle(r.rotation, planted.rotation) for r in (soft, stiff)]
    assert np.median(angles[0]) < 0.1 * np.median(angles[1])


N, ATOMS, POINTS = 6, 5, 14


@pytest.fixture
def dictionary(rng):
    atoms = normalise(
        rng.standard_normal((3, POINTS)) + 0.3 * rng.standard_normal((ATOMS, 3, POINTS))
    ).points
    names = tuple(f"point{j}" for j in range(POINTS))
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
    c = rng.dirichlet(np.ones(ATOMS), N)
    t = np.stack(
        [rng.uniform(-1, 1, N), rng.uniform(-1, 1, N), np.full(N, 8.0)], axis=1
    )
    X = rotations @ np.tensordot(c, dictionary.atoms, axes=1) + t[..., None]
    return project_pinhole(camera, X)


def view(landmarks, weights, dictionary, camera, method="convex+refine"):
    estimator = make_estimator(method, mean_shape=dictionary.mean_shape)
    first = lift(landmarks, weights, dictionary.atoms, Program(lam=0.3), estimator)
    return first, refine_view(first, landmarks, camera, dictionary)


@pytest.mark.parametrize(
    "method", ["convex", "convex+refine", "alternate", "mean-shape"]
)
def test_every_method_can_be_refined(method, landmarks, dictionary, camera, rotations):
    first, found = view(landmarks, np.ones((N, POINTS)), dictionary, camera, method)
    assert rotation_angle(found.estimate.rotation, rotations).max() < 1.0
    assert (found.estimate.residual < 0.5 * first.estimate.residual).all()


def test_the_fields_belong_together(landmarks, dictionary, camera, rng):
    weights = rng.uniform(0.3, 1.5, (N, POINTS))
    weights[1, :4] = 0.0
    landmarks = landmarks + 5.0 * rng.standard_normal(landmarks.shape)
    _, found = view(landmarks, weights, dictionary, camera)
    e, visible = found.estimate, found.perspective
    S = e.rotation @ np.tensordot(e.coefficients, dictionary.atoms, axes=1)
    assert_allclose(e.shapes, S)
    flat = np.pad(found.translation, ((0, 0), (0, 1)))
    assert_allclose(found.shapes, found.scale[:, None, None] * S + flat[..., None])
    X = S + visible.translation[..., None]
    assert_allclose(found.landmarks_fitted, project_pinhole(camera, X), rtol=1e-9)
    assert_allclose(found.scale, np.sqrt(900 * 910) / visible.translation[:, 2])
    assert_allclose(
        found.translation,
        project_pinhole(camera, visible.translation[..., None])[..., 0],
    )
    assert_allclose(
        e.transforms.dense(), e.coefficients[..., None, None] * e.rotation[:, None, :2]
    )
    norm = normalise(landmarks, weights > 0)
    at = norm.scale[:, None] * e.translation + norm.centroid
    assert_allclose(at, found.translation)
    w = weights[:, None]
    centred = landmarks - (w**2 * landmarks).sum(2, keepdims=True) / (w**2).sum(
        2, keepdims=True
    )
    residual_variance = np.linalg.norm(
        w * (landmarks - found.landmarks_fitted), axis=(1, 2)
    )
    assert_allclose(
        e.residual, residual_variance / np.linalg.norm(w * centred, axis=(1, 2))
    )
    assert_array_equal(visible.camera.focal, camera.focal)


def test_a_camera_inside_the_object_is_the_users_to_mend(landmarks, dictionary, camera):
    """A focal length in another unit than the landmarks puts some of them behind the
    camera.
    """
    focal = camera.focal.copy()
    focal[3] = 20.0
    near = Camera(focal, camera.centre, camera.sign)
    first, found = view(landmarks, np.ones((N, POINTS)), dictionary, near)
    assert list(found.failures) == [3]
    assert "start behind the camera" in found.failures[3]
    assert "`camera.focal` and `camera.principal_point`" in found.failures[3]
    e = found.estimate
    assert e.status[3] is Status.DEGENERATE
    for values in (
        found.shapes,
        found.landmarks_fitted,
        found.translation,
        found.scale,
        e.shapes,
        e.rotation,
        e.objective,
        e.residual,
        e.coefficients,
        found.perspective.translation,
    ):
        assert np.isnan(values[3]).all()
        assert np.isfinite(np.delete(values, 3, axis=0)).all()
    assert e.iterations[3] == first.estimate.iterations[3]
    others = np.arange(N) != 3
    _, clean = view(landmarks, np.ones((N, POINTS)), dictionary, camera)
    assert_array_equal(found.shapes[others], clean.shapes[others])


def test_an_image_without_a_shape_stays_without(landmarks, dictionary, camera):
    weights = np.ones((N, POINTS))
    weights[2, 2:] = 0
    first, found = view(landmarks, weights, dictionary, camera)
    assert dict(found.failures) == dict(first.failures)
    assert list(found.failures) == [2]
    assert np.isnan(found.shapes[2]).all()
    assert np.isnan(found.perspective.translation[2]).all()
    assert np.isfinite(np.delete(found.shapes, 2, axis=0)).all()
    assert found.estimate.status[2] is first.estimate.status[2]

"""Planted shapes are recovered, the objective never falls, lost depth is noticed."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from shapefit.dictionary.from_2d.judgement import ALIKE, DOUBTFUL, LEARNED, UNLIKE, evaluate_class
from shapefit.dictionary.from_2d.learning import learn, upgrade
from shapefit.dictionary.from_2d.model import Images
from shapefit.geometry.rotations import exponential, random_rotations, rotation_about_axis
from tests.dictionary.from_2d.conftest import relative_error


@pytest.mark.parametrize(("noise", "hidden", "most"), [(0.0, 0.0, 0.02), (0.02, 0.1, 0.06)])
def test_planted_shapes_are_recovered_and_the_objective_never_falls(plant, noise, hidden, most):
    made = plant(60, noise=noise, hidden=hidden)
    states = list(learn(made.images))
    assert (np.diff([state.objective for state in states]) > 0).all()
    assert relative_error(states[-1].in_camera, made.shapes) < most


def test_depth_is_judged_determined_where_views_turn_only(plant):
    made = plant(80, noise=0.01)
    *_, state = learn(made.images)
    assert evaluate_class(made.images, state).fine
    object_frame = np.swapaxes(made.views.rotation, 1, 2) @ made.shapes
    front = replace(made.images, landmarks=object_frame[:, :2])
    *_, state = learn(front)
    assert evaluate_class(front, state).verdict == ALIKE


@pytest.mark.parametrize(("turn", "learned"), [(150, False), (1500, True)])
def test_halves_disagree_where_each_pose_is_seen_from_one_side(rng, turn, learned):
    n, p = 80, 20
    time = np.linspace(0, 1, n)[:, None]
    bends = np.sin(2 * np.pi * (time * [1.0, 1.37, 2.1] + rng.random(3)))
    mean, modes = rng.standard_normal((3, p)), 0.3 * rng.standard_normal((3, 3, p))
    shapes = mean + np.einsum("nk,kip->nip", bends, modes)
    shapes -= shapes.mean(axis=2, keepdims=True)
    shapes = rotation_about_axis(1, np.radians(np.linspace(0, turn, n))) @ shapes
    images = Images(shapes[:, :2], np.ones((n, p)), np.zeros(n, np.intp))
    *_, state = learn(images)
    found = evaluate_class(images, state)
    assert (found.verdict == LEARNED) == learned
    assert relative_error(state.in_camera, shapes) < found.half_distance
    assert (found.half_distance < 0.1) == learned


P, NOISE = 14, 0.03


def shapes_of(rng, n=50, modes=3, deviation=0.15, depth=1.0):
    """Draw shapes (n, 3, p) in their own frame; depth is a factor of z."""
    X = rng.standard_normal((3, P)) + np.einsum(
        "ipq,nq->nip",
        deviation * rng.standard_normal((3, P, modes)),
        rng.standard_normal((n, modes)),
    )
    return X * [[1.0], [1.0], [depth]]


def swayed(rng, axis, degrees, **given):
    X = shapes_of(rng, **given)
    return rotation_about_axis(axis, np.radians(degrees * np.sin(np.arange(len(X))))) @ X


def seen_anywhere(rng, **given):
    X = shapes_of(rng, **given)
    return random_rotations(len(X), rng) @ X


def seen_from_before(rng, degrees, **given):
    X = shapes_of(rng, **given)
    return exponential(np.radians(degrees) * rng.standard_normal((len(X), 3))) @ X


VERDICTS = {
    "camera at rest": (shapes_of, {}, {ALIKE}),
    "same shape, same view": (shapes_of, {"deviation": 0.0}, {ALIKE}),
    "sways by 15 degrees": (partial(swayed, axis=1, degrees=15), {}, {ALIKE}),
    "camera rolls": (partial(swayed, axis=2, degrees=90), {}, {ALIKE}),
    "same shape, camera rolls": (partial(swayed, axis=2, degrees=90), {"deviation": 0.0}, {ALIKE}),
    "flat and stiff": (seen_anywhere, {"deviation": 0.0, "depth": 0.0}, {ALIKE}),
    "flat and bends": (seen_anywhere, {"depth": 0.0}, {ALIKE, DOUBTFUL}),
    "20 images of 6 modes": (seen_anywhere, {"n": 20, "modes": 6, "deviation": 0.25}, {DOUBTFUL}),
    "sways by 45 degrees": (partial(swayed, axis=1, degrees=45), {"n": 150}, {DOUBTFUL, LEARNED}),
    "any view": (seen_anywhere, {}, {LEARNED}),
    "stiff, 30 images": (seen_anywhere, {"n": 30, "deviation": 0.0}, {LEARNED}),
    "shallow": (seen_anywhere, {"depth": 0.2}, {LEARNED}),
    "from before": (partial(seen_from_before, degrees=30), {"n": 150}, {LEARNED}),
    "noise": (lambda rng: rng.standard_normal((80, 3, P)), {}, {UNLIKE}),
}
"""Planted set -> what makes it, how, and the verdicts that are right."""


@pytest.mark.parametrize("name", VERDICTS)
def test_verdicts(rng, name):
    make, given, verdicts = VERDICTS[name]
    X = make(rng, **given)
    X = X / (X - X.mean(axis=2, keepdims=True))[:, :2].std()
    landmarks = X[:, :2] + NOISE * rng.standard_normal((len(X), 2, P))
    images = Images(landmarks, np.ones((len(X), P)), np.zeros(len(X), np.intp))
    *_, state = learn(images)
    assert evaluate_class(images, state).verdict in verdicts


def spoil(images, share, rng):
    """Throw some landmarks anywhere within their image; return which, too."""
    bad = rng.random(images.weights.shape) < share
    low, high = (edge(images.landmarks, axis=2, keepdims=True) for edge in (np.min, np.max))
    anywhere = low + (high - low) * rng.random(images.landmarks.shape)
    return replace(images, landmarks=np.where(bad[:, None], anywhere, images.landmarks)), bad


def test_gross_landmarks_are_found_and_the_objective_never_falls(plant, rng):
    made = plant(100, p=24, noise=0.01)
    spoilt, bad = spoil(made.images, 0.05, rng)
    states = list(learn(spoilt))
    assert (np.diff([state.objective for state in states]) > 0).all()
    outliers = states[-1].outliers
    assert (outliers & bad).sum() > 0.9 * bad.sum()
    assert (outliers & ~bad).sum() < 0.002 * bad.size
    assert relative_error(states[-1].in_camera, made.shapes) < 0.03


def test_no_landmark_of_clean_images_is_gross_even_where_a_pose_is_rare(plant, rng):
    made = plant(100, p=24, noise=0.01)
    views, raised = made.views.rotation[:5], np.zeros((3, 24))
    raised[:, :4] = 1.2 * rng.standard_normal((3, 1))
    made.images.landmarks[:5] += (views @ raised)[:, :2]
    *_, state = learn(made.images)
    assert not state.outliers.any()


@pytest.mark.parametrize("rank", [3, 5])
def test_an_upgrade_of_exact_factors_makes_every_view_orthonormal(rng, rank):
    A = rng.standard_normal((rank, rank))
    rows = np.concatenate(
        [random_rotations(40, rng)[:, :2], rng.standard_normal((40, 2, rank - 3))], axis=2
    )
    L = rows @ np.linalg.inv(A)
    Q = upgrade(L, A[:, :3] + 0.05 * rng.standard_normal((rank, 3)))
    gram = (L @ Q) @ np.swapaxes(L @ Q, 1, 2)
    np.testing.assert_allclose(gram, np.broadcast_to(np.eye(2), gram.shape), atol=1e-6)

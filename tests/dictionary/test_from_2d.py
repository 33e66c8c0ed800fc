"""Learning from 2D: dense Gaussians as judge, planted shapes, outliers, depth that is
lost.
"""

from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from shapefit.dictionary.from_2d.judgement import (
    DOUBTFUL_DEPTH,
    LEARNED,
    NOTHING_IN_COMMON,
    VIEWS_ALIKE,
    evaluate_class,
    roll_angles,
)
from shapefit.dictionary.from_2d.learning import learn_class, upgrade
from shapefit.dictionary.from_2d.model import (
    Gaussian,
    Images,
    Views,
    posterior_mean,
    split_ppca,
    sum_covariances,
)
from shapefit.geometry.rotations import (
    exponential,
    random_rotations,
    rotation_about_axis,
)


@pytest.fixture
def plant(rng):
    """Return a function that draws n images of p landmarks, their shapes before the
    camera.
    """

    def make(n, p=12, modes=3, deviation=0.15, noise=0.0, hidden=0.0):
        mean = rng.standard_normal((3, p))
        mean -= mean.mean(axis=1, keepdims=True)
        V = deviation * rng.standard_normal((3, p, modes))
        V -= V.mean(axis=1, keepdims=True)
        R = random_rotations(n, rng)
        shapes = R @ (
            mean + np.einsum("ipq,nq->nip", V, rng.standard_normal((n, modes)))
        )
        landmarks = shapes[:, :2] + noise * rng.standard_normal((n, 2, p))
        landmarks += rng.standard_normal((n, 2, 1))
        weights = (rng.random((n, p)) >= hidden).astype(float)
        images = Images(landmarks, weights, np.zeros(n, np.intp))
        model = Gaussian(mean, V, 1e-3, 0.02**2, np.zeros(1), 0.1**2)
        return SimpleNamespace(
            images=images, shapes=shapes, model=model, views=Views(R, np.zeros(n))
        )

    return make


def relative_error(found, shapes):
    """Mean of ||X - X^|| / ||X||, the sign of depth chosen once for all."""
    return min(
        float(
            np.mean(
                np.linalg.norm(found * [[1], [1], [sign]] - shapes, axis=(1, 2))
                / np.linalg.norm(shapes, axis=(1, 2))
            )
        )
        for sign in (1.0, -1.0)
    )


WIDE = 1e8
"""Variance of a translation that might be anything."""


@pytest.fixture
def planted(plant):
    """Few images, some landmarks hidden, confidences that differ, views that are a
    little off.
    """
    made = plant(4, p=6, modes=2, noise=0.02, hidden=0.2)
    confidence = np.where(made.images.weights > 0, 0.5 + 0.5 * (np.arange(6) % 2), 0.0)
    made.images = type(made.images)(
        made.images.landmarks, confidence, made.images.sequence
    )
    turned = exponential(np.full((4, 3), 0.05)) @ made.views.rotation
    made.views = Views(turned, np.array([0.1, -0.1, 0.0, 0.05]))
    return made


def dense(made, i):
    """Return mean and covariance of the shape and of the seen landmarks, log density,
    and noise.

    All at once: joint Gaussian of the shape (3p) and the landmarks (2p), the
    translation wide.
    """
    model, p = made.model, made.images.weights.shape[1]
    A = np.exp(made.views.log_scale[i]) * np.kron(made.views.rotation[i][:2], np.eye(p))
    visible = np.tile(made.images.weights[i] > 0, 2)
    omega = np.tile(made.images.weights[i], 2)[visible]
    A, T = A[visible], np.kron(np.eye(2), np.ones((p, 1)))[visible]
    C = model.covariance
    S = A @ C @ A.T + model.noise * np.diag(omega**-2) + WIDE * T @ T.T
    r = made.images.landmarks[i].ravel()[visible] - A @ model.mean.ravel()
    gain = C @ A.T @ np.linalg.inv(S)
    log_density = -0.5 * (
        r @ np.linalg.solve(S, r) + np.linalg.slogdet(S)[1] + len(r) * np.log(2 * np.pi)
    )
    noise_gain = model.noise * np.diag(omega**-2) @ np.linalg.inv(S)
    e = noise_gain @ r
    of_noise = model.noise * np.diag(omega**-2) - noise_gain @ (
        model.noise * np.diag(omega**-2)
    )
    residual_variance = float((omega**2 * (e**2 + np.diag(of_noise))).sum())
    return (
        model.mean.ravel() + gain @ r,
        C - gain @ A @ C,
        log_density,
        residual_variance,
    )


def test_shapes_covariances_and_noise_are_those_of_the_joint_gaussian(planted):
    found = posterior_mean(planted.images, planted.views, planted.model)
    exact = [dense(planted, i) for i in range(4)]
    for i, (mean, _, _, residual_variance) in enumerate(exact):
        assert_allclose(found.shapes[i].ravel(), mean, atol=1e-5)
        assert found.residual_variance[i] == pytest.approx(residual_variance, rel=1e-4)
    total = sum(covariance for _, covariance, _, _ in exact)
    assert_allclose(
        sum_covariances(found, planted.views, planted.model), total, atol=1e-5
    )


def test_log_density_is_that_of_the_landmarks_up_to_the_wide_translation(planted):
    found = posterior_mean(planted.images, planted.views, planted.model)
    spread = planted.model.size_variance
    of_scale = -0.5 * (planted.views.log_scale**2 / spread + np.log(2 * np.pi * spread))
    exact = np.array([dense(planted, i)[2] for i in range(4)])
    flat = np.log(WIDE)  # of both coordinates: 2 / 2 log WIDE
    assert_allclose(found.log_density - of_scale, exact + flat, atol=1e-3)


def test_doubt_is_what_the_density_gains_where_one_belief_changes(planted):
    outliers = np.zeros(planted.images.weights.shape, bool)
    outliers[:, 1] = planted.images.weights[:, 1] > 0
    images = replace(planted.images, outliers=outliers)
    found = posterior_mean(images, planted.views, planted.model)
    for i, j in np.argwhere(planted.images.weights > 0):
        changed = outliers.copy()
        changed[i, j] ^= True
        then = posterior_mean(
            replace(images, outliers=changed), planted.views, planted.model
        )
        gain = then.log_density[i] - found.log_density[i]
        assert found.flip_gain[i, j] == pytest.approx(gain, rel=1e-6, abs=1e-6)
    assert np.isneginf(found.flip_gain[planted.images.weights == 0]).all()
    hidden = posterior_mean(
        planted.images.hiding(outliers), planted.views, planted.model
    )
    odds = np.log(0.02 / 0.98 * 0.05)  # one in fifty, anywhere in 20 units of area
    assert found.log_density - hidden.log_density == pytest.approx(
        odds * outliers.sum(axis=1)
    )


def test_gradient_is_that_of_the_log_density(planted):
    found = posterior_mean(planted.images, planted.views, planted.model, slopes=True)
    h = 1e-5
    for direction in range(4):
        step = np.zeros((4, 4))
        step[:, direction] = h

        def moved(sign, step=step):
            turned = exponential(sign * step[:, :3]) @ planted.views.rotation
            views = Views(turned, planted.views.log_scale + sign * step[:, 3])
            return posterior_mean(planted.images, views, planted.model).log_density

        slope = (moved(1) - moved(-1)) / (2 * h)
        assert_allclose(found.gradient[:, direction], slope, rtol=1e-4, atol=1e-4)


def test_the_rest_of_a_covariance_is_the_mean_of_the_eigenvalues_that_are_left(rng):
    p = 4
    centred = np.kron(np.eye(3), np.linalg.svd(np.ones((1, p)))[2][1:].T)  # (12, 9)
    axes = centred @ np.linalg.qr(rng.standard_normal((9, 9)))[0]
    covariance = (axes * np.arange(1.0, 10)) @ axes.T
    found = split_ppca(np.zeros((3, p)), covariance, most=4)
    assert found.rest == pytest.approx(np.mean([1, 2, 3, 4, 5]))
    V = found.modes.reshape(3 * p, 4)
    expected = (axes[:, 5:] * (np.arange(6.0, 10) - 3)) @ axes[:, 5:].T
    assert_allclose(V @ V.T, expected, atol=1e-12)


@pytest.mark.parametrize(
    ("noise", "hidden", "most"), [(0.0, 0.0, 0.02), (0.02, 0.1, 0.06)]
)
def test_planted_shapes_are_recovered_and_the_objective_never_falls(
    plant, noise, hidden, most
):
    made = plant(60, noise=noise, hidden=hidden)
    states = list(learn_class(made.images))
    assert (np.diff([state.objective for state in states]) > 0).all()
    assert relative_error(states[-1].in_camera, made.shapes) < most


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
    *_, state = learn_class(images)
    found = evaluate_class(images, state)
    assert (found.verdict == LEARNED) == learned
    assert relative_error(state.in_camera, shapes) < found.half_distance
    assert (found.half_distance < 0.1) == learned


P, NOISE = 14, 0.03


def test_the_angles_by_which_a_picture_was_rolled_are_found(rng):
    angles = rng.uniform(-1, 1, 6)
    found = roll_angles(
        rotation_about_axis(2, angles)[:, :2, :2] @ rng.normal(size=(2, 8))
    )
    assert_allclose(found - found[0], angles - angles[0], atol=1e-6)


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
    return (
        rotation_about_axis(axis, np.radians(degrees * np.sin(np.arange(len(X))))) @ X
    )


def seen_anywhere(rng, **given):
    X = shapes_of(rng, **given)
    return random_rotations(len(X), rng) @ X


def seen_from_before(rng, degrees, **given):
    X = shapes_of(rng, **given)
    return exponential(np.radians(degrees) * rng.standard_normal((len(X), 3))) @ X


VERDICTS = {
    "camera at rest": (shapes_of, {}, {VIEWS_ALIKE}),
    "same shape, same view": (shapes_of, {"deviation": 0.0}, {VIEWS_ALIKE}),
    "sways by 15 degrees": (partial(swayed, axis=1, degrees=15), {}, {VIEWS_ALIKE}),
    "camera rolls": (partial(swayed, axis=2, degrees=90), {}, {VIEWS_ALIKE}),
    "same shape, camera rolls": (
        partial(swayed, axis=2, degrees=90),
        {"deviation": 0.0},
        {VIEWS_ALIKE},
    ),
    "flat and stiff": (seen_anywhere, {"deviation": 0.0, "depth": 0.0}, {VIEWS_ALIKE}),
    "flat and bends": (seen_anywhere, {"depth": 0.0}, {VIEWS_ALIKE, DOUBTFUL_DEPTH}),
    "20 images of 6 modes": (
        seen_anywhere,
        {"n": 20, "modes": 6, "deviation": 0.25},
        {DOUBTFUL_DEPTH},
    ),
    "sways by 45 degrees": (
        partial(swayed, axis=1, degrees=45),
        {"n": 100},
        {DOUBTFUL_DEPTH, LEARNED},
    ),
    "any view": (seen_anywhere, {}, {LEARNED}),
    "stiff, 30 images": (seen_anywhere, {"n": 30, "deviation": 0.0}, {LEARNED}),
    "shallow": (seen_anywhere, {"depth": 0.2}, {LEARNED}),
    "from before": (partial(seen_from_before, degrees=30), {"n": 100}, {LEARNED}),
    "noise": (lambda rng: rng.standard_normal((80, 3, P)), {}, {NOTHING_IN_COMMON}),
}
"""Planted set -> what makes it, how, and the verdicts that are right."""


@pytest.mark.parametrize("name", VERDICTS)
def test_verdicts(rng, name):
    make, given, verdicts = VERDICTS[name]
    X = make(rng, **given)
    X = X / (X - X.mean(axis=2, keepdims=True))[:, :2].std()
    landmarks = X[:, :2] + NOISE * rng.standard_normal((len(X), 2, P))
    images = Images(landmarks, np.ones((len(X), P)), np.zeros(len(X), np.intp))
    *_, state = learn_class(images)
    assert evaluate_class(images, state).verdict in verdicts


def spoil(images, share, rng):
    """Throw some landmarks anywhere within their image; return which, too."""
    bad = rng.random(images.weights.shape) < share
    low, high = (
        edge(images.landmarks, axis=2, keepdims=True) for edge in (np.min, np.max)
    )
    anywhere = low + (high - low) * rng.random(images.landmarks.shape)
    return (
        replace(images, landmarks=np.where(bad[:, None], anywhere, images.landmarks)),
        bad,
    )


def test_gross_landmarks_are_found_and_the_objective_never_falls(plant, rng):
    made = plant(100, p=24, noise=0.01)
    spoilt, bad = spoil(made.images, 0.05, rng)
    states = list(learn_class(spoilt))
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
    *_, state = learn_class(made.images)
    assert not state.outliers.any()


@pytest.mark.parametrize("rank", [3, 5])
def test_an_upgrade_of_exact_factors_makes_every_view_orthonormal(rng, rank):
    A = rng.standard_normal((rank, rank))
    rows = np.concatenate(
        [random_rotations(40, rng)[:, :2], rng.standard_normal((40, 2, rank - 3))],
        axis=2,
    )
    L = rows @ np.linalg.inv(A)
    Q = upgrade(L, A[:, :3] + 0.05 * rng.standard_normal((rank, 3)))
    gram = (L @ Q) @ np.swapaxes(L @ Q, 1, 2)
    assert_allclose(gram, np.broadcast_to(np.eye(2), gram.shape), atol=1e-6)


def test_no_bit_depends_on_the_number_of_threads(plant, monkeypatch):
    images = plant(60, noise=0.02, hidden=0.1).images
    found = []
    for cores in (1, 3):
        monkeypatch.setattr("os.cpu_count", lambda cores=cores: cores)
        *_, state = learn_class(images)
        found.append(state)
    one, other = found
    assert one.objective == other.objective
    assert_array_equal(one.shapes, other.shapes)
    assert_array_equal(one.model.modes, other.model.modes)

"""The posterior beside a dense one: modes that are maxima, mixtures, regions,
outliers.
"""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from shapefit.dictionary.mixture import Mixture
from shapefit.geometry.rotations import random_rotations, rotation_about
from shapefit.lifting.posterior.posterior import Outliers, find_posterior
from tests.lifting.posterior import dense
from tests.lifting.posterior.scenes import (
    assert_regions_hold,
    draw_images,
    shares_of,
    solve,
)


def solve_one(scene, R, outliers=(0.0, 0.05)):
    prior = Mixture(np.ones(1), scene.mean[None], scene.covariance[None])
    return find_posterior(
        scene.landmarks[None],
        scene.residual_variance[None],
        scene.noise[None],
        prior,
        R[None, None],
        Outliers(*outliers),
        slopes=None if scene.slopes is None else scene.slopes[None],
        modes=1,
        covariance=True,
    )


@pytest.mark.parametrize("noisy", [False, True])
@pytest.mark.parametrize("hidden", [(), (2,), (0, 5)])
@pytest.mark.parametrize("chance", [0.0, 0.05])
@pytest.mark.parametrize("steep", [0.0, 0.4])
@pytest.mark.usefixtures("to_the_end")
def test_a_mode_is_that_of_the_dense_computation(
    draw_scene, noisy, hidden, chance, steep
):
    scene, R = draw_scene(3, noisy=noisy, hidden=hidden, steep=steep)
    outliers = (chance, 0.05 / 37**2)
    found = solve_one(scene, R, outliers).modes
    R, s = found.rotation[0, 0], found.scale[0, 0]
    inlier_probability = np.nan_to_num(found.inlier_probability[0, 0], nan=1.0)

    def value(R, s):
        return dense.log_likelihood(scene, R, s, outliers, inlier_probability)

    assert np.abs(dense.derivative(value, R, s)).max() < 1e-3
    H = -dense.hessian(value, R, s) + np.eye(4)  # no view is less certain than a radian
    evidence = value(R, s) + 2 * np.log(2 * np.pi) - 0.5 * np.linalg.slogdet(H)[1]
    assert found.log_evidence[0, 0] == pytest.approx(evidence, abs=1e-3)
    y, C = dense.condition(scene, R, s, inlier_probability)
    assert found.mean[0, 0].ravel() == pytest.approx(y, abs=1e-9 * s)
    J = dense.derivative(
        lambda R, s: dense.condition(scene, R, s, inlier_probability)[0], R, s
    )
    whole = C + J.T @ np.linalg.inv(H) @ J
    assert found.covariance[0, 0] == pytest.approx(whole, abs=1e-4 * s**2)


def test_the_combination_of_one_mode_is_that_mode(draw_scene):
    scene, R = draw_scene(7)
    found = solve_one(scene, R)
    assert found.mean == pytest.approx(found.modes.mean[:, 0])
    assert found.covariance == pytest.approx(found.modes.covariance[:, 0])
    variance = np.diagonal(found.covariance[0]).reshape(3, 7)
    assert found.deviation[0] ** 2 == pytest.approx(variance)


def test_the_combination_of_modes_has_the_moments_of_their_mixture(draw_mixture):
    """Modes that lie apart add to the covariances between landmarks, too."""
    prior = draw_mixture(4, k=3)
    _, w, R = draw_images(prior, 40, seed=2, residual_variance=0.003)
    others = random_rotations(160, np.random.default_rng(3)).reshape(40, 4, 3, 3)
    starts = np.concatenate([R[:, None], others], axis=1)
    found = solve(prior, w, starts, 0.003, modes=12, covariance=True)

    share = shares_of(found.modes)
    several = (share[:, 1] > 0.05) & (share[:, -1] < 1e-6)
    assert several.sum() >= 5
    mean = np.einsum("nm,nmap->nap", share, np.nan_to_num(found.modes.mean))
    apart = np.nan_to_num(found.modes.mean - mean[:, None]).reshape(40, 12, -1)
    covariance = np.einsum("nm,nmij->nij", share, found.modes.covariance)
    covariance += np.einsum("nm,nmi,nmj->nij", share, apart, apart)
    assert_allclose(found.mean[several], mean[several], atol=1e-6)
    assert_allclose(found.covariance[several], covariance[several], atol=1e-6)


def test_an_image_without_three_landmarks_has_no_posterior(draw_scene):
    scene, R = draw_scene(7, hidden=(0, 1, 2, 3, 4))
    found = solve_one(scene, R)
    assert np.isnan(found.mean).all()
    assert np.isnan(found.log_evidence).all()


def draw_views(prior: Mixture, n: int, residual_variance: float, views: int):
    """Landmarks (n, 2, p) of shapes of the mixture, and rotations (n, views, 3, 3) at
    random.
    """
    _, w, _ = draw_images(prior, n, 1, residual_variance)
    return w, random_rotations(n * views, np.random.default_rng(2)).reshape(
        n, views, 3, 3
    )


@pytest.mark.parametrize(
    ("p", "size", "residual_variance"), [(5, 0.3, 0.02), (7, 0.5, 0.02), (6, 0.8, 0.01)]
)
def test_every_mode_that_counts_is_stationary(draw_mixture, p, size, residual_variance):
    """Newton's decrement from the dense log likelihood by differences; saddles do not
    count.
    """
    prior = draw_mixture(3, k=2, p=p, size=size)
    w, starts = draw_views(prior, 20, residual_variance, 8)
    found = solve(prior, w, starts, residual_variance, modes=8)
    ones, none, judged = np.ones(p), np.zeros((p, 2, 2)), 0
    for i, m in np.argwhere(shares_of(found.modes) > 0.01):
        k = found.modes.component[i, m]
        gaussian = prior.means[k], prior.covariances[k]
        scene = dense.Observation(w[i], residual_variance * ones, none, *gaussian)

        def value(R, s, scene=scene):
            return dense.log_likelihood(scene, R, s, (0, 0.05), ones)

        at = found.modes.rotation[i, m], found.modes.scale[i, m]
        slope, H = dense.derivative(value, *at), -dense.hessian(value, *at)
        assert abs(slope @ np.linalg.solve(H, slope)) < 0.02
        judged += 1
    assert judged > 25
    assert found.stationary.all()


def test_modes_are_alike_from_all_sides_of_the_image(draw_mixture):
    """Few landmarks and a large misfit leave the view open; the axes of the image do
    not matter.
    """
    prior, residual_variance = draw_mixture(2, k=1, p=4, size=0.3), 0.3
    w, starts = draw_views(prior, 20, residual_variance, 1)
    turn = rotation_about(np.array([0.0, 0.0, 1.0]), np.array(0.7))
    plain = solve(prior, w, starts, residual_variance)
    other = solve(prior, turn[:2, :2] @ w, turn @ starts, residual_variance)
    close = np.abs(other.mean - turn @ plain.mean).max(axis=(1, 2)) < 1e-3
    assert close.sum() > 12  # others climb to another mode
    assert other.log_evidence[close] == pytest.approx(
        plain.log_evidence[close], abs=2e-3
    )
    assert other.deviation[close, 2] == pytest.approx(
        plain.deviation[close, 2], rel=5e-3
    )


@pytest.mark.parametrize("exponent", [7, 8])
def test_images_that_single_precision_loses_are_found_in_double(draw_mixture, exponent):
    """A prior that is nearly flat in some directions, and hardly any misfit."""
    tiny = 10.0**-exponent
    whole = draw_mixture(3, k=2, p=9)
    roots = np.random.default_rng(0).normal(size=(2, 27, 6))
    C = 0.01 * roots @ roots.swapaxes(1, 2) + tiny * np.eye(27)
    prior = Mixture(whole.weights, whole.means, C)
    rng = np.random.default_rng(4)
    k = rng.choice(2, size=64, p=prior.weights)
    x = prior.means[k] + (0.1 * roots[k] @ rng.normal(size=(64, 6, 1))).reshape(
        64, 3, 9
    )
    R = random_rotations(64, rng)
    y = R @ x
    found = solve(prior, y[:, :2], R[:, None], tiny)
    y[:, 2] -= y[:, 2].mean(axis=1, keepdims=True)
    assert np.isfinite(found.log_evidence).all()
    assert np.abs(found.mean - y).max() < 0.05

    def at_truth(i, component):
        gaussian = prior.means[component], C[component]
        scene = dense.Observation(
            y[i, :2], np.full(9, tiny), np.zeros((9, 2, 2)), *gaussian
        )
        log_weight = np.log(prior.weights[component])
        return log_weight + dense.log_likelihood(
            scene, R[i], 1.0, (0, 0.05), np.ones(9)
        )

    best = [max(at_truth(i, component) for component in range(2)) for i in range(64)]
    # the evidence is that of the best view within the volume of the views that are as
    # good
    assert np.abs(found.log_evidence - best).max() < 60


def test_climbs_are_compared_with_their_weights():
    """A component that fits better by far, of next to no weight, drives none of the
    others out.
    """
    mean = np.random.default_rng(0).normal(size=(3, 6))
    mean -= mean.mean(axis=1, keepdims=True)
    other = mean * np.array([1.3, 0.8, 1.0])[:, None]
    C = 1e-3 * np.eye(18)
    prior = Mixture(np.array([1.0, 1e-200]), np.stack([other, mean]), np.stack([C, C]))
    found = solve(prior, mean[None, :2], np.eye(3)[None, None], 1e-3, modes=2)
    assert found.modes.component[0].tolist() == [0, -1]
    alone = Mixture(np.ones(1), other[None], C[None])
    expected = solve(alone, mean[None, :2], np.eye(3)[None, None], 1e-3)
    assert found.log_evidence == pytest.approx(expected.log_evidence, abs=1e-6)


def test_regions_hold_what_they_say_for_shapes_of_the_model(draw_mixture):
    prior, residual_variance, n = draw_mixture(4, size=0.1), 0.005, 600
    y, w, R = draw_images(prior, n, 6, residual_variance)
    found = solve(prior, w, R[:, None], residual_variance, covariance=True)
    y[:, 2] -= y[:, 2].mean(axis=1, keepdims=True)
    assert_regions_hold(found, y)


def test_a_gross_landmark_is_disbelieved_and_the_others_stay(draw_mixture):
    prior, residual_variance, n, p = draw_mixture(5, p=13, size=0.08), 0.005, 40, 13
    y, w, R = draw_images(prior, n, 7, residual_variance)
    clean = solve(prior, w, R[:, None], residual_variance, outliers=Outliers(0.05))
    w[:, :, 4] += np.array([2.0, -1.5])
    found = solve(prior, w, R[:, None], residual_variance, outliers=Outliers(0.05))
    others = np.arange(p) != 4
    error = [
        np.median(np.abs(f.mean - y)[:, :2, others].mean(axis=(1, 2)))
        for f in (clean, found)
    ]
    assert np.median(found.inlier_probability[:, 4]) < 0.01
    assert np.median(found.inlier_probability[:, others]) > 0.99
    assert error[1] < 1.1 * error[0]


def test_the_weight_of_a_component_counts():
    mean = np.random.default_rng(0).normal(size=(3, 6))
    mean -= mean.mean(axis=1, keepdims=True)
    C = 0.01 * np.eye(18)
    prior = Mixture(np.array([0.9, 0.1]), np.stack([mean, mean]), np.stack([C, C]))
    w = mean[None, :2]
    found = solve(prior, w, np.eye(3)[None, None], 0.01, modes=2)
    assert shares_of(found.modes)[0] == pytest.approx([0.9, 0.1], rel=1e-6)
    assert found.modes.component[0].tolist() == [0, 1]


def test_a_climb_that_ends_on_a_saddle_does_not_count_beside_a_maximum():
    """A flat shape, foreshortened: seen face on it is a saddle between two tilts of
    equal worth.
    """
    rng = np.random.default_rng(0)
    mean = np.vstack([rng.normal(size=(2, 9)), np.zeros(9)])
    mean -= mean.mean(axis=1, keepdims=True)
    prior = Mixture(np.ones(1), mean[None], 1e-3 * np.eye(27)[None])
    tilt = rotation_about(np.array([0.0, 1.0, 0.0]), np.array(0.3))
    starts = np.stack([np.eye(3), tilt, tilt.T])[None]
    found = solve(prior, (tilt @ mean)[None, :2], starts, 1e-3, modes=3)
    assert shares_of(found.modes)[0] == pytest.approx([0.5, 0.5, 0], abs=1e-5)


def test_components_together_are_those_alone(draw_mixture):
    """Climbs side by side, of other images too, that leave as they arrive change
    nothing.
    """
    prior, residual_variance = draw_mixture(8, k=13, p=9, size=0.1), 0.01
    _, w, R = draw_images(prior, 12, 9, residual_variance)
    w[2:, :, 3], w[5, :, [0, 7]] = np.nan, np.nan

    def posterior(prior, which=slice(None)):
        return solve(
            prior, w[which], R[which, None], residual_variance, outliers=Outliers(0.02)
        )

    together, parts = posterior(prior), zip(prior.means, prior.covariances, strict=True)
    assert np.array_equal(
        [posterior(prior, [i]).mean[0] for i in range(12)], together.mean
    )
    alone = [posterior(Mixture(np.ones(1), mean[None], C[None])) for mean, C in parts]
    logs = np.log(prior.weights)[:, None] + np.stack(
        [one.log_evidence for one in alone]
    )
    evidence = np.logaddexp.reduce(logs)
    assert together.log_evidence == pytest.approx(evidence, abs=0.02)
    mean = np.einsum(
        "kn,knap->nap", np.exp(logs - evidence), [one.mean for one in alone]
    )
    assert np.abs(together.mean - mean).max() < 0.02

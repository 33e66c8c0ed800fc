"""What counts as a mode of the posterior: maxima alone, alike from any side, in any precision."""

import numpy as np
import pytest

from shapefit.dictionary.mixture import Mixture
from shapefit.geometry.rotations import random_rotations, rotation_about
from tests.lifting.posterior import dense
from tests.lifting.posterior.dense import draw_images, shares_of, solve


def draw_views(prior: Mixture, n: int, residual_variance: float, views: int):
    """Landmarks (n, 2, p) of shapes of the mixture, and rotations (n, views, 3, 3) at random."""
    _, w, _ = draw_images(prior, n, 1, residual_variance)
    return w, random_rotations(n * views, np.random.default_rng(2)).reshape(n, views, 3, 3)


@pytest.mark.parametrize(
    ("p", "size", "residual_variance"), [(5, 0.3, 0.02), (7, 0.5, 0.02), (6, 0.8, 0.01)]
)
def test_every_mode_that_counts_is_stationary(draw_mixture, p, size, residual_variance):
    """Newton's decrement from the dense log likelihood by differences; saddles do not count."""
    prior = draw_mixture(3, k=2, p=p, size=size)
    w, starts = draw_views(prior, 20, residual_variance, 8)
    found = solve(prior, w, starts, residual_variance, modes=8)
    ones = np.ones(p)
    judged = 0
    for i, m in np.argwhere(shares_of(found.modes) > 0.01):
        k = found.modes.component[i, m]
        scene = dense.Scene(
            w[i],
            residual_variance * ones,
            np.zeros((p, 2, 2)),
            prior.means[k],
            prior.covariances[k],
        )

        def value(R, s, scene=scene):
            return dense.log_likelihood(scene, R, s, (0, 0.05), ones)

        at = found.modes.rotation[i, m], found.modes.scale[i, m]
        slope, H = dense.derivative(value, *at), -dense.hessian(value, *at)
        assert abs(slope @ np.linalg.solve(H, slope)) < 0.02
        judged += 1
    assert judged > 25
    assert found.stationary.all()


def test_modes_are_alike_from_all_sides_of_the_image(draw_mixture):
    """Few landmarks and a large misfit leave the view open; the axes of the image do not matter."""
    prior, residual_variance = draw_mixture(2, k=1, p=4, size=0.3), 0.3
    w, starts = draw_views(prior, 20, residual_variance, 1)
    turn = rotation_about(np.array([0.0, 0.0, 1.0]), np.array(0.7))
    plain = solve(prior, w, starts, residual_variance)
    other = solve(prior, turn[:2, :2] @ w, turn @ starts, residual_variance)
    close = np.abs(other.mean - turn @ plain.mean).max(axis=(1, 2)) < 1e-3
    assert close.sum() > 12  # others climb to another mode
    assert other.log_evidence[close] == pytest.approx(plain.log_evidence[close], abs=2e-3)
    assert other.deviation[close, 2] == pytest.approx(plain.deviation[close, 2], rel=5e-3)


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
    x = prior.means[k] + (0.1 * roots[k] @ rng.normal(size=(64, 6, 1))).reshape(64, 3, 9)
    R = random_rotations(64, rng)
    y = R @ x
    found = solve(prior, y[:, :2], R[:, None], tiny)
    y[:, 2] -= y[:, 2].mean(axis=1, keepdims=True)
    assert np.isfinite(found.log_evidence).all()
    assert np.abs(found.mean - y).max() < 0.05
    best = -np.inf
    for component in range(2):
        scenes = [
            dense.Scene(
                w, np.full(9, tiny), np.zeros((9, 2, 2)), prior.means[component], C[component]
            )
            for w in y[:, :2]
        ]
        at_truth = [
            np.log(prior.weights[component])
            + dense.log_likelihood(scene, R[i], 1.0, (0, 0.05), np.ones(9))
            for i, scene in enumerate(scenes)
        ]
        best = np.maximum(best, at_truth)
    # the evidence is that of the best view within the volume of the views that are as good
    assert np.abs(found.log_evidence - best).max() < 60


def test_climbs_are_compared_with_their_weights():
    """A component that fits better by far, of next to no weight, drives none of the others out."""
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

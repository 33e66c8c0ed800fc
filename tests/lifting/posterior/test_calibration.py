"""Hidden landmarks: kappa is 1 where error bars are true, and shows by how much they
are not.
"""

from functools import partial

import numpy as np
import pytest
from numpy.testing import assert_allclose

from shapefit.convex.solver import solve_newton
from shapefit.dictionary.mixture import Mixture
from shapefit.lifting.lift import Program, lift
from shapefit.lifting.posterior.calibration import HiddenInTurn, hide_in_turn
from shapefit.lifting.posterior.method import lift_to_posterior
from shapefit.lifting.posterior.model import PosteriorModel
from tests.lifting.posterior.scenes import RESIDUAL_VARIANCE, FilmedScene, P

N = 60


@pytest.fixture(params=["weak perspective", "near a camera"])
def scene(request, draw_mixture):
    """Images of one Gaussian."""
    prior = draw_mixture(5, k=1, p=P, size=0.1)
    is_near = request.param != "weak perspective"
    scene = FilmedScene(prior, N, 6.0 if is_near else 1e3, 1.0)
    return scene, prior, scene.camera if is_near else None


def calibrated(scene, weights=None, off=None, narrower=1.0):
    scene, prior, camera = scene
    known = Mixture(prior.weights, prior.means, prior.covariances / narrower)
    model = PosteriorModel(
        prior=known, mean_shape=prior.means[0], residual_variance=RESIDUAL_VARIANCE
    )
    lifting = lift(
        scene.landmarks if off is None else scene.landmarks + off,
        np.ones((N, P)) if weights is None else weights,
        prior.means,
        Program(lam=0.3),
        partial(lift_to_posterior, model=model, solve=solve_newton),
        camera=camera,
    )
    found = lifting.estimate
    return hide_in_turn(
        lifting.problem, found.rotation, found.inlier_probability, model
    )


def test_true_bars_hold_the_hidden_landmarks(scene, monkeypatch):
    monkeypatch.setattr("shapefit.lifting.posterior.calibration.MAX_HIDDEN", N * P // 3)
    assert calibrated(scene).predictions == pytest.approx(N * P / 3, abs=P)
    monkeypatch.undo()
    found = calibrated(scene)
    assert found.predictions == N * P
    assert found.kappa == pytest.approx(1, abs=0.35)
    assert found.inside == pytest.approx(0.9, abs=0.08)
    assert np.median(found.by_landmark) == pytest.approx(1, abs=0.35)


def test_a_prior_that_is_too_narrow_shows(scene):
    kappa = calibrated(scene, narrower=9.0).kappa
    assert kappa > max(2.5, 2 * calibrated(scene).kappa)


def test_a_landmark_that_is_elsewhere_grows_alone(scene):
    off = np.zeros((N, 2, P))
    off[:, 0, 4] = 0.5 * np.std(scene[0].landmarks, axis=2).mean()
    growth = calibrated(scene, off=off).growth(1.5)
    assert (growth.argmax(), growth.min() >= 1) == (4, True)


def test_what_is_seldom_seen_has_the_growth_of_the_file(scene):
    weights = np.ones((N, P))
    weights[5:, 2] = 0.0
    weights[:, 3] = 0.0
    found = calibrated(scene, weights=weights)
    assert np.isnan(found.by_landmark[[2, 3]]).all()
    assert found.predictions == N * (P - 2) + 5


def test_growth_is_never_below_1_nor_below_that_of_the_file():
    found = HiddenInTurn(3.0, np.array([0.5, 6.0, np.nan]), 0.8, 100)
    assert_allclose(found.growth(1.5), [2.0, 4.0, 2.0])
    assert (HiddenInTurn(0.5, np.full(3, 0.5), 1.0, 100).growth(1.5) == 1).all()
    assert (HiddenInTurn(np.nan, np.full(3, np.nan), np.nan, 0).growth(1.5) == 1).all()

"""Hidden landmarks: kappa is 1 where error bars are true, and shows by how much they
are not.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import pytest
from numpy.testing import assert_allclose

from shapefit.convex.solver import solve_newton
from shapefit.dictionary.mixture import Mixture
from shapefit.geometry.pinhole import Camera
from shapefit.lifting.lift import Lifting, Program, lift
from shapefit.lifting.posterior import calibration
from shapefit.lifting.posterior.calibration import (
    MIN_PREDICTIONS,
    HiddenInTurn,
    hide_in_turn,
    predict_hidden,
)
from shapefit.lifting.posterior.method import lift_to_posterior
from shapefit.lifting.posterior.model import PosteriorModel
from tests.lifting.posterior.scenes import RESIDUAL_VARIANCE, FilmedScene, P

N = 60
"""Images."""


@dataclass(frozen=True)
class Case:
    """Images of one Gaussian, and the camera that the method knows of."""

    landmarks: np.ndarray
    prior: Mixture
    camera: Camera | None

    def turned(self) -> Case:
        """Return the images turned by a quarter: x is -y, and y is x."""
        x, y = np.moveaxis(self.landmarks, 1, 0)
        if self.camera is None:
            return replace(self, landmarks=np.stack([-y, x], axis=1))
        middle_x, middle_y = self.camera.centre.T[..., None]
        landmarks = np.stack([middle_y - y, x - middle_x], axis=1)
        camera = replace(
            self.camera,
            focal=self.camera.focal[:, ::-1],
            centre=np.zeros_like(self.camera.centre),
        )
        return replace(self, landmarks=landmarks, camera=camera)

    def model(self, prior=None) -> PosteriorModel:
        """Return the model of a prior, by default that of the images."""
        return PosteriorModel(
            prior=prior or self.prior,
            mean_shape=self.prior.means[0],
            residual_variance=RESIDUAL_VARIANCE,
        )

    def lift(self, model, weights=None, landmarks=None) -> Lifting:
        """Lift the images, or these landmarks in their place."""
        return lift(
            self.landmarks if landmarks is None else landmarks,
            np.ones((N, P)) if weights is None else weights,
            self.prior.means,
            Program(lam=0.3),
            partial(lift_to_posterior, model=model, solve=solve_newton),
            camera=self.camera,
        )

    def hide(
        self, weights=None, prior=None, landmarks=None, inliers=None
    ) -> HiddenInTurn:
        """Lift the images, and hide each landmark in turn."""
        model = self.model(prior)
        lifting = self.lift(model, weights, landmarks)
        found = lifting.estimate
        if inliers is None:
            inliers = found.inlier_probability
        return hide_in_turn(lifting.problem, found.rotation, inliers, model)


@pytest.fixture(params=["weak perspective", "near a camera"])
def case(request, draw_mixture) -> Case:
    prior = draw_mixture(5, k=1, p=P, size=0.1)
    if request.param == "weak perspective":
        scene = FilmedScene(prior, N, 1e3, 1.0)
        return Case(scene.landmarks, prior, None)
    scene = FilmedScene(prior, N, 6.0, 1.0)
    return Case(scene.landmarks, prior, scene.camera)


def test_true_bars_hold_the_hidden_landmarks(case):
    found = case.hide()
    assert found.predictions == N * P
    assert found.kappa == pytest.approx(1, abs=0.35)
    assert found.inside == pytest.approx(0.9, abs=0.08)
    assert np.median(found.by_landmark) == pytest.approx(1, abs=0.35)


def test_a_quarter_turn_of_the_images_changes_nothing(case):
    found = case.hide()
    turned = case.turned().hide()
    assert turned.kappa == pytest.approx(found.kappa, rel=1e-3)
    assert_allclose(turned.by_landmark, found.by_landmark, rtol=1e-3)


@pytest.mark.parametrize(("outliers", "has_own"), [(12, True), (13, False)])
def test_what_is_an_outlier_in_most_images_that_show_it_has_no_growth_of_its_own(
    case, outliers, has_own
):
    """Landmark 2 is seen in 24 images; it has no part in the growth of the file."""
    weights = np.ones((N, P))
    weights[24:, 2] = 0.0
    inliers = np.where(weights > 0, 0.9, np.nan)
    inliers[:outliers, 2] = 0.1

    found = case.hide(weights=weights, inliers=inliers)

    assert np.isfinite(found.by_landmark[2]) == has_own
    assert found.predictions == N * (P - 1) + 24 * has_own


@pytest.mark.parametrize(("inlier", "seen"), [(0.1, P), (0.9, 1)])
def test_without_landmarks_to_predict_nothing_is_known(case, inlier, seen):
    """Where all are outliers, and where no other landmark is seen."""
    weights = np.ones((N, P))
    weights[:, seen:] = 0.0
    inliers = np.where(weights > 0, inlier, np.nan)

    found = case.hide(weights=weights, inliers=inliers)

    assert found.predictions == 0
    assert np.isnan([found.kappa, found.inside]).all()
    assert found.by_landmark.shape == (P,)
    assert np.isnan(found.by_landmark).all()
    assert (found.growth(1.5) == 1).all()


@pytest.mark.parametrize("confidence", [0.1, 0.3])
def test_a_landmark_of_little_confidence_may_be_farther_off(case, rng, confidence):
    """By as much as its noise is more: a deviation over the confidence."""
    weights = np.ones((N, P))
    weights[:, 2] = confidence
    unit = np.std(case.landmarks, axis=2).mean() / np.std(case.prior.means[0])
    noise = unit * np.sqrt(RESIDUAL_VARIANCE) / confidence
    landmarks = case.landmarks.copy()
    landmarks[:, :, 2] += noise * rng.standard_normal((N, 2))

    found = case.hide(weights=weights, landmarks=landmarks)

    assert found.by_landmark[2] == pytest.approx(1, abs=0.5)


@pytest.mark.parametrize("share", [2, 3, 5])
def test_those_that_are_hidden_are_of_all_landmarks_and_images(
    case, monkeypatch, share
):
    monkeypatch.setattr(calibration, "MAX_HIDDEN", N * P // share)
    model = case.model()
    lifting = case.lift(model)

    square = predict_hidden(lifting.problem, lifting.estimate.rotation, model)

    is_hidden = np.isfinite(square)
    assert abs(is_hidden.sum(axis=0) - N / share).max() <= 1
    assert abs(is_hidden.sum(axis=1) - P / share).max() <= 1


def test_of_many_landmarks_some_are_hidden(case, monkeypatch):
    monkeypatch.setattr(calibration, "MAX_HIDDEN", N * P // 3)
    assert case.hide().predictions == pytest.approx(N * P / 3, abs=P)


def test_the_share_inside_is_that_of_the_bars_as_they_are_stated(case):
    """Wider ones hold more, of landmarks that are predicted alike."""
    narrow = replace(case.model(), bar_scale=0.1)
    wide = replace(case.model(), bar_scale=10.0)
    lifting = case.lift(narrow)
    rotation = lifting.estimate.rotation
    inliers = lifting.estimate.inlier_probability

    found = hide_in_turn(lifting.problem, rotation, inliers, narrow)
    in_wide = hide_in_turn(lifting.problem, rotation, inliers, wide)

    assert found.kappa == in_wide.kappa
    assert found.inside < 0.5
    assert in_wide.inside > 0.99


def test_a_prior_that_is_too_narrow_shows(case):
    true = case.prior
    narrow = Mixture(true.weights, true.means, true.covariances / 9.0)
    kappa = case.hide(prior=narrow).kappa
    assert kappa > 2.5
    assert kappa > 2 * case.hide().kappa


def test_a_landmark_that_is_elsewhere_grows_alone(case):
    spread = np.std(case.landmarks, axis=2).mean()
    landmarks = case.landmarks.copy()
    landmarks[:, 0, 4] += 0.5 * spread

    growth = case.hide(landmarks=landmarks).growth(1.5)

    assert growth.argmax() == 4
    assert growth.min() >= 1


def test_what_is_seldom_seen_has_the_growth_of_the_file(case):
    """Landmark 2 is seen in five images, landmark 3 in none."""
    weights = np.ones((N, P))
    weights[5:, 2] = 0.0
    weights[:, 3] = 0.0

    found = case.hide(weights=weights)

    assert np.isnan(found.by_landmark[[2, 3]]).all()
    assert found.predictions == N * (P - 2) + 5


@pytest.mark.parametrize(("seen", "has_own"), [(0, True), (-1, False)])
def test_a_landmark_that_is_seen_often_enough_has_a_growth_of_its_own(
    case, seen, has_own
):
    weights = np.ones((N, P))
    weights[MIN_PREDICTIONS + seen :, 2] = 0.0
    found = case.hide(weights=weights)
    assert np.isfinite(found.by_landmark[2]) == has_own


def test_growth_is_not_below_that_of_the_file():
    by_landmark = np.array([0.5, 6.0, np.nan])
    found = HiddenInTurn(3.0, by_landmark, 0.8, 100)
    assert_allclose(found.growth(1.5), [2.0, 4.0, 2.0])


@pytest.mark.parametrize(
    ("kappa", "inside", "predictions"), [(0.5, 1.0, 100), (np.nan, np.nan, 0)]
)
def test_growth_is_not_below_1(kappa, inside, predictions):
    found = HiddenInTurn(kappa, np.full(3, kappa), inside, predictions)
    assert (found.growth(1.5) == 1).all()

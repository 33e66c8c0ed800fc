"""What error bars are worth on a file: each landmark is hidden in turn and predicted.

A landmark w_j that is hidden has the predictive distribution

    w_j ~ N(P_j y_j, P_j C_j P_j^T + s^2 v I + V_j)

by the posterior N(y, C) of the other landmarks (a cross-validatory predictive check,
Marshall and Spiegelhalter 2003). Its squared Mahalanobis distance d^2 is chi^2 with 2
degrees of freedom where error bars are true, so that

    kappa = (90% quantile of d^2) / 4.605

is the factor by which their variances are too small. It is taken over all landmarks and
for each of them: the covariances of a file grow by it, see `growth`.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil

import numpy as np

from shapefit.arrays import Flags, Floats, Indices
from shapefit.convex.problem import Problem
from shapefit.lifting.posterior.method import (
    find_noise,
    find_posterior_from,
    find_rays,
    noise_of_rays,
)
from shapefit.lifting.posterior.model import PosteriorModel
from shapefit.lifting.posterior.posterior import Posterior
from shapefit.lifting.trust import MIN_INLIER_PROBABILITY

CHI2_QUANTILE = 4.605170185988092
"""90% quantile of chi^2 with 2 degrees of freedom."""

NOMINAL_SHARE = 0.9
"""Of the hidden landmarks, inside their regions."""

OUTLIER_SHARE = 0.5
"""Of the images that show a landmark, in which it is an outlier, to leave it out."""

MIN_PREDICTIONS = 20
"""Of a landmark, from which on its own kappa is taken."""

MAX_HIDDEN = 2400
"""Landmarks that are hidden in all, of 60 images each of 40: of larger shapes every
second one or fewer, others in every image.
"""


@dataclass(frozen=True, eq=False, repr=False)
class HiddenInTurn:
    """What the hidden landmarks of a sample show of the error bars of its file.

    kappa, of all landmarks together, and by_landmark (p,), nan where too few were
    hidden and where the landmark is mostly an outlier: what the detector marks is not
    what the posterior places; inside, the share of hidden landmarks inside their 90%
    regions as they are stated; predictions, how many were hidden. nan where none was.
    """

    kappa: float
    by_landmark: Floats
    inside: float
    predictions: int

    def growth(self, bar_scale: float) -> Floats:
        """Return the factors (p,) >= 1 to multiply the covariances of landmarks by.

        max(1, kappa / bar_scale), for the larger kappa of all and of the landmark; nan
        ones do not count. bar_scale, which all covariances have, stands for as large a
        kappa. Never below 1: a sample that is well predicted shows no more than that
        its poses resemble the training's.
        """
        kappa = np.fmax(self.by_landmark, self.kappa)
        factor: Floats = np.fmax(kappa / bar_scale, 1.0)
        return factor


def hide_in_turn(
    problem: Problem,
    rotation: Floats,
    inliers: Floats,
    model: PosteriorModel,
    *,
    threads: int = 0,
) -> HiddenInTurn:
    """Hide each landmark of n images in turn and compare it with its prediction.

    The others predict it. rotation (n, 3, 3), those of the posteriors of the images,
    from which the ascents start; inliers (n, p), inlier probabilities, nan where a
    landmark is not seen. A landmark that is mostly an outlier, in most images, has no
    part in the kappa of the file.
    """
    square = predict_hidden(problem, rotation, model, threads=threads)
    with np.errstate(invalid="ignore"):
        mostly_outlier = (inliers < MIN_INLIER_PROBABILITY).sum(axis=0)
    seen = np.isfinite(inliers).sum(axis=0)
    is_outlier = mostly_outlier > OUTLIER_SHARE * seen
    pooled = square[:, ~is_outlier]
    pooled = pooled[np.isfinite(pooled)]
    if not len(pooled):
        return HiddenInTurn(np.nan, np.full(square.shape[1], np.nan), np.nan, 0)
    by_landmark = np.array([_kappa_of_landmark(column) for column in square.T])
    return HiddenInTurn(
        kappa=float(np.quantile(pooled, NOMINAL_SHARE)) / CHI2_QUANTILE,
        by_landmark=np.where(is_outlier, np.nan, by_landmark),
        inside=float((pooled <= model.bar_scale * CHI2_QUANTILE).mean()),
        predictions=len(pooled),
    )


def _kappa_of_landmark(squared_mahalanobis: Floats) -> float:
    """Return the factor kappa by which the variances of one landmark are too small.

    squared_mahalanobis (n,): its squared distances d^2 (see above) where it was hidden,
    else nan. nan for fewer than `MIN_PREDICTIONS`.
    """
    known = squared_mahalanobis[np.isfinite(squared_mahalanobis)]
    if len(known) < MIN_PREDICTIONS:
        return np.nan
    return float(np.quantile(known, NOMINAL_SHARE) / CHI2_QUANTILE)


def predict_hidden(
    problem: Problem, rotation: Floats, model: PosteriorModel, *, threads: int = 0
) -> Floats:
    """Return squared Mahalanobis distances (n, p) of landmarks from their predictions.

    The others predict a landmark while it is hidden. nan where they predict nothing,
    and where a landmark is not seen or not chosen to be hidden.
    """
    has_view: Flags = np.asarray(np.isfinite(rotation).all(axis=(1, 2)))
    is_visible = (problem.weights > 0) & has_view[:, None]
    image, hidden = _choose_hidden(is_visible)
    square = np.full(is_visible.shape, np.nan)
    if not len(image):
        return square
    rows = np.arange(len(image))
    others = problem.take(image)
    others.weights[rows, hidden] = 0.0
    posterior = find_posterior_from(
        others, rotation[image][:, None], model, threads=threads
    )
    noise = find_noise(problem)
    w = problem.landmarks
    P = np.zeros((len(image), 2, 3))
    P[:, 0, 0] = 1.0
    P[:, 1, 1] = 1.0
    if problem.camera is not None:
        rays = find_rays(w, problem.camera)
        w = rays.landmarks
        P[:, :, 2] = -rays.slopes[image, :, hidden]
        noise = noise_of_rays(noise, rays, problem.camera)
    C = _covariance_of_landmark(posterior, hidden)
    omega = problem.weights[image, hidden]
    of_landmark = posterior.scale**2 * model.residual_variance / omega**2
    S = P @ C @ P.swapaxes(1, 2) + noise[image, hidden]
    S += of_landmark[:, None, None] * np.eye(2)
    mean = posterior.mean[rows, :, hidden]
    away = w[image, :, hidden] - (P @ mean[..., None])[..., 0]
    is_finite = np.isfinite(S).all(axis=(1, 2)) & np.isfinite(away).all(axis=1)
    S[~is_finite] = np.eye(2)
    whitened = np.linalg.solve(S, away[..., None])[..., 0]
    distance = np.einsum("ni,ni->n", away, whitened)
    square[image, hidden] = np.where(is_finite, distance, np.nan)
    return square


def _choose_hidden(is_visible: Flags) -> tuple[Indices, Indices]:
    """Choose visible landmarks (n, p) to hide; return the image and landmark of each.

    All of them, or about `MAX_HIDDEN`, evenly over landmarks and images.
    """
    # by landmark: neighbours have the same landmarks in sight
    landmark, image = np.nonzero(is_visible.T)
    every = max(1, ceil(len(image) / MAX_HIDDEN))
    is_chosen = (landmark + image) % every == 0
    return image[is_chosen], landmark[is_chosen]


def _covariance_of_landmark(posterior: Posterior, landmark: Indices) -> Floats:
    """Return the covariance (n, 3, 3) of one landmark (n,) of each image."""
    rows = np.arange(len(landmark))
    x, y, z = posterior.deviation[rows, :, landmark].T
    correlation = posterior.correlation[rows, :, landmark].T
    xy, xz, yz = correlation * np.array([x * y, x * z, y * z])
    C = np.array([[x * x, xy, xz], [xy, y * y, yz], [xz, yz, z * z]])
    return C.transpose(2, 0, 1)

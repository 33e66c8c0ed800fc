"""What error bars are worth on the images of a file: each landmark is hidden in turn
and predicted.

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

import numpy as np

from shapefit.arrays import Flags, Floats
from shapefit.convex.problem import Problem
from shapefit.lifting.posterior.method import (
    MOSTLY,
    find_from,
    find_noise,
    find_rays,
    noise_of_rays,
)
from shapefit.lifting.posterior.model import PosteriorModel

QUANTILE = 4.605170185988092
"""90% quantile of chi^2 with 2 degrees of freedom."""

LEVEL = 0.9
"""Nominal share of the hidden landmarks inside their regions."""

FEWEST = 20
"""Predictions of a landmark from which its own kappa is taken."""

MOST_HIDDEN = 2400
"""Landmarks that are hidden in all, of 60 images each of 40: of larger shapes every
second one or fewer, others in every image.
"""


@dataclass(frozen=True)
class Calibration:
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
        """Return factors (p,) on covariances: max(1, kappa, kappa_j) beyond
        `bar_scale`.

        bar_scale, which all covariances have, stands for as large a kappa. Never below
        1: a sample that is well predicted shows no more than that its poses resemble
        the training's.
        """
        factor: Floats = np.fmax(np.fmax(self.by_landmark, self.kappa) / bar_scale, 1.0)
        return factor


def calibrate(
    problem: Problem,
    rotation: Floats,
    inliers: Floats,
    model: PosteriorModel,
    *,
    threads: int = 0,
) -> Calibration:
    """Hide each landmark of n images in turn and compare it with what the others
    predict.

    rotation (n, 3, 3), those of the posteriors of the images, from which the ascents
    start; inliers (n, p), inlier probabilities, nan where a landmark is not seen. A
    landmark that is mostly an outlier, in most images, has no part in the kappa of the
    file.
    """
    square = predict_hidden(problem, rotation, model, threads=threads)
    with np.errstate(invalid="ignore"):
        outliers = (inliers < MOSTLY).sum(axis=0) > MOSTLY * np.isfinite(inliers).sum(
            axis=0
        )
    pooled = square[:, ~outliers]
    pooled = pooled[np.isfinite(pooled)]
    if not len(pooled):
        return Calibration(np.nan, np.full(square.shape[1], np.nan), np.nan, 0)
    by_landmark = np.array(
        [
            np.quantile(squares, LEVEL) / QUANTILE if len(squares) >= FEWEST else np.nan
            for squares in (column[np.isfinite(column)] for column in square.T)
        ]
    )
    return Calibration(
        kappa=float(np.quantile(pooled, LEVEL)) / QUANTILE,
        by_landmark=np.where(outliers, np.nan, by_landmark),
        inside=float((pooled <= model.bar_scale * QUANTILE).mean()),
        predictions=len(pooled),
    )


def predict_hidden(
    problem: Problem, rotation: Floats, model: PosteriorModel, *, threads: int = 0
) -> Floats:
    """d^2 (n, p) of seen landmarks from what the others predict, nan where that is
    nothing.
    """
    finite: Flags = np.asarray(np.isfinite(rotation).all(axis=(1, 2)))
    visible: Flags = np.asarray((problem.weights > 0) & finite[:, None])
    hidden, image = np.nonzero(visible.T)  # neighbours have the same landmarks in sight
    chosen = (hidden + image) % max(1, -(-len(image) // MOST_HIDDEN)) == 0
    hidden, image = hidden[chosen], image[chosen]
    square = np.full(visible.shape, np.nan)
    if not len(image):
        return square
    rows = np.arange(len(image))
    others = problem.take(image)
    others.weights[rows, hidden] = 0.0
    posterior = find_from(others, rotation[image][:, None], model, threads=threads)
    noise, w, slope = find_noise(problem), problem.landmarks, np.zeros((len(image), 2))
    if problem.camera is not None:
        rays = find_rays(w, problem.camera)
        w, slope = rays.landmarks, rays.slopes[image, :, hidden]
        noise = noise_of_rays(noise, rays, problem.camera)
    mean, sd, mixed = (
        values[rows, :, hidden]
        for values in (posterior.mean, posterior.deviation, posterior.correlation)
    )
    x, y, z = sd.T
    xy, xz, yz = mixed.T * np.array([x * y, x * z, y * z])
    P = np.zeros((len(image), 2, 3))
    P[:, 0, 0] = P[:, 1, 1] = 1.0
    P[:, :, 2] = -slope
    C = np.array([[x * x, xy, xz], [xy, y * y, yz], [xz, yz, z * z]]).transpose(2, 0, 1)
    omega = problem.weights[image, hidden]
    of_landmark = posterior.scale**2 * model.residual_variance / omega**2
    S = P @ C @ P.swapaxes(1, 2) + noise[image, hidden]
    S += of_landmark[:, None, None] * np.eye(2)
    away = w[image, :, hidden] - (P @ mean[..., None])[..., 0]
    finite = np.isfinite(S).all(axis=(1, 2)) & np.isfinite(away).all(axis=1)
    S[~finite] = np.eye(2)
    distance = np.einsum("ni,ni->n", away, np.linalg.solve(S, away[..., None])[..., 0])
    square[image, hidden] = np.where(finite, distance, np.nan)
    return square

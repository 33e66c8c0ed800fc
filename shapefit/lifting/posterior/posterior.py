"""The posterior over shape and view of each image, by the compiled kernel.

w_j = s (P_j R x_j + t) + e_j, x ~ sum_k pi_k N(mu_k, C_k),  e_j ~ N(0, s^2 v_j I + V_j)

P_j takes the first two rows under weak perspective; where a camera is known it follows
the ray of landmark j.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from shapefit import core
from shapefit.arrays import Floats
from shapefit.dictionary.mixture import Mixture
from shapefit.geometry.normalisation import centroid
from shapefit.lifting.posterior.usual_lengths import LimbLengths

MIN_LIKELIHOOD_GAIN = 1e-4
"""A climb ends when a step gains less log likelihood, and the next promises no more."""


class Outliers(NamedTuple):
    """How often landmarks are outliers, and how outliers are spread over the image.

    chance that a landmark is one, 0 to believe every landmark; density, the probability
    per area with which it then falls anywhere, in the unit of the landmarks.
    """

    chance: float = 0.0
    density: float = 0.05


OUTLIERS = Outliers(chance=0.02, density=0.05)
"""Of detectors: the chance of theirs on film, and any place within the body's size."""


class Modes(NamedTuple):
    """The M most likely modes of n images, a component and a view each.

    The most likely is the first. component (n, M), -1 where there are fewer; rotation R
    (n, M, 3, 3); scale s (n, M); log_evidence (n, M) of component and image together,
    the view integrated out, -inf where there are fewer; mean (n, M, 3, p) of y = s (R x
    + t) in the frame of the camera, with mean depth 0; covariance (n, M, 3p, 3p) of y,
    all x first, then y, then z, the uncertainty of the view included, arbitrary where
    there are fewer; inlier_probability (n, M, p), nan where it is hidden.
    """

    component: NDArray[np.int64]
    rotation: Floats
    scale: Floats
    log_evidence: Floats
    mean: Floats
    covariance: Floats
    inlier_probability: Floats


class Posterior(NamedTuple):
    """The mixture of the modes of n images, nan where there is none.

    mean (n, 3, p) of y, its standard deviations (n, 3, p), and the correlation (n, 3,
    p) of x with y, x with z, and y with z of each landmark; covariance (n, 3p, 3p),
    None where it was not asked for; inlier_probability (n, p); rotation (n, 3, 3) and
    scale (n,) of the most likely mode; log_evidence (n,) of the image;
    squared_mahalanobis (n,), of the landmarks from those expected, their noise over
    their inlier probability, averaged over the modes; stationary (n,), whether the most
    likely mode is a maximum; rounds (n,), the steps of all climbs; modes, those asked
    for.
    """

    mean: Floats
    deviation: Floats
    correlation: Floats
    covariance: Floats | None
    inlier_probability: Floats
    rotation: Floats
    scale: Floats
    log_evidence: Floats
    squared_mahalanobis: Floats
    stationary: NDArray[np.bool_]
    rounds: NDArray[np.int64]
    modes: Modes


def find_posterior(
    landmarks: Floats,
    residual_variance: Floats,
    noise: Floats,
    prior: Mixture,
    starts: Floats,
    outliers: Outliers | None = None,
    *,
    lengths: LimbLengths | None = None,
    slopes: Floats | None = None,
    modes: int = 0,
    covariance: bool = False,
    shapes: bool = True,
    threads: int = 0,
) -> Posterior:
    """Return means, covariances and evidence of the shapes of n images under a prior.

    landmarks w (n, 2, p), of any size; residual_variance v (n, p), that of what the
    model cannot place, in the unit of the prior's shapes, inf where a landmark is
    hidden; noise V (n, p, 2, 2), the covariance of the measurement in the unit of the
    landmarks; starts (n, S, 3, 3), rotations from the frame of the prior to that of the
    camera, nan where there are fewer. Every start is climbed under every component of
    the prior, and each maximum counts once, by its evidence. outliers: how likely a
    landmark is one, never by default. modes: how many maxima of an image, the most
    likely ones, are returned besides; covariance: whether that of all landmarks
    together is; without `shapes` neither that nor their means, deviations and
    correlations have rows, and modes and lengths must not be asked for. slopes (n, 2,
    p), of the rays on which the landmarks lie: P_j = [I | -slope_j] where a point at
    the depth z of the middle of the shape is seen at w_j; without them the rays are
    parallel. With usual lengths of limbs the mixture is that given these; its modes,
    which are stored, are those without.
    """
    outliers = outliers or Outliers()
    lengths = lengths or LimbLengths.none()
    n, _, p = landmarks.shape
    visible = np.isfinite(residual_variance)
    # the prior of the translation is wide about the middle of the landmarks
    middle = np.nan_to_num(centroid(landmarks, visible))[..., None]
    about_middle = np.where(visible[:, None], landmarks - middle, 0.0)
    if slopes is None:
        slopes = np.zeros_like(landmarks)
    else:
        slopes = np.where(visible[:, None], slopes, 0.0)
    found = _empty_posterior(n, p, modes, covariance=covariance, shapes=shapes)
    assert found.covariance is not None
    core.find_posterior(
        landmarks=_in_order(about_middle),
        slopes=_in_order(slopes),
        residual_variance=_in_order(residual_variance),
        noise=_in_order(noise),
        log_weights=np.log(prior.weights),
        means=_in_order(prior.means),
        covariances=_in_order(prior.covariances),
        starts=_in_order(starts),
        limbs=np.ascontiguousarray(lengths.limbs, np.int64),
        limb_log_length=_in_order(lengths.log_length),
        limb_precision=_in_order(lengths.precision),
        chance=outliers.chance,
        density=outliers.density,
        tolerance=MIN_LIKELIHOOD_GAIN,
        mean=found.mean,
        deviation=found.deviation,
        correlation=found.correlation,
        covariance=found.covariance,
        inlier_probability=found.inlier_probability,
        rotation=found.rotation,
        scale=found.scale,
        log_evidence=found.log_evidence,
        squared_mahalanobis=found.squared_mahalanobis,
        stationary=found.stationary,
        rounds=found.rounds,
        mode_component=found.modes.component,
        mode_rotation=found.modes.rotation,
        mode_scale=found.modes.scale,
        mode_log_evidence=found.modes.log_evidence,
        mode_mean=found.modes.mean,
        mode_covariance=found.modes.covariance,
        mode_inlier_probability=found.modes.inlier_probability,
        threads=threads,
    )
    if shapes:
        found.mean[:, :2] += middle
    found.modes.mean[:, :, :2] += middle[:, None]
    return found if covariance else found._replace(covariance=None)


def _empty_posterior(
    n: int, p: int, modes: int, *, covariance: bool, shapes: bool
) -> Posterior:
    """Return arrays that a kernel fills with the posterior of n images.

    modes: how many of each image; without `covariance` that array has no rows, without
    `shapes` neither have those of their means, deviations and correlations.
    """
    d = 3 * p
    m = n if shapes else 0
    return Posterior(
        mean=np.empty((m, 3, p)),
        deviation=np.empty((m, 3, p)),
        correlation=np.empty((m, 3, p)),
        covariance=np.empty((n if covariance else 0, d, d)),
        inlier_probability=np.empty((n, p)),
        rotation=np.empty((n, 3, 3)),
        scale=np.empty(n),
        log_evidence=np.empty(n),
        squared_mahalanobis=np.empty(n),
        stationary=np.zeros(n, bool),
        rounds=np.empty(n, np.int64),
        modes=Modes(
            component=np.zeros((n, modes), np.int64),
            rotation=np.full((n, modes, 3, 3), np.nan),
            scale=np.full((n, modes), np.nan),
            log_evidence=np.zeros((n, modes)),
            mean=np.full((n, modes, 3, p), np.nan),
            covariance=np.zeros((n, modes, d, d)),
            inlier_probability=np.full((n, modes, p), np.nan),
        ),
    )


def _in_order(x: Floats) -> Floats:
    """Return the array as kernels read it: contiguous, in float64."""
    return np.ascontiguousarray(x, np.float64)

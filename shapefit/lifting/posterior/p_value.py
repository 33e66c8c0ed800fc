"""How plausible an image is under the prior: a p-value of what was observed.

The surprise of an image is the squared Mahalanobis distance of its landmarks from those expected,
averaged over the modes. Were shape and view a linear model with one Gaussian, it would be chi^2
with 2 m - 6 degrees of freedom for m landmarks. But the scale is found from the same landmarks and
the components of a mixture compete for them, so the surprise varies less: by .37 to .56 of that
variance for people. What it is under the model is found by drawing images from the model.
"""

from __future__ import annotations

from functools import lru_cache
from math import erfc
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats
from shapefit.dictionary.mixture import Mixture
from shapefit.geometry.rotations import random_rotations
from shapefit.lifting.posterior.posterior import Gross, find_posterior

VIEWED = 6
"""Numbers of a view: rotation, scale, translation; they take up as many of the 2 m coordinates."""

FEWEST_BELIEVED, LEAST_BELIEVED = 3.0, 2 / 3
"""Landmarks that fix a view, and the share of those seen that must not be gross: with fewer the
others may be a body that is not there."""

LEAST_MEAN = 1.0
"""Of the surprise, where hardly more landmarks are believed than fix a view."""

COUNTS = (4, 6, 9, 14, 21, 32, 48)
"""Numbers of landmarks for which images are drawn, besides all of the dictionary; between them the
surprise is interpolated, above them it is that of the last."""

DRAWS, SEED = 400, 1504_01507
"""Images drawn for each of them, of all components, from any view, none of its landmarks gross."""


class Surprise(NamedTuple):
    """What the surprise is under the model, in units of 2 b - 6 for b landmarks believed.

    excess, how much larger its mean is; share of the variance 2 (2 b - 6 + excess) of chi^2.
    """

    excess: float
    share: float


class Model(NamedTuple):
    """The model of an image: a prior over shapes, the misfit of a coordinate, gross landmarks."""

    prior: Mixture
    residual_variance: float
    gross: Gross


def find_plausibility(
    squared_mahalanobis: Floats,
    seen: NDArray[np.integer],
    believed: Floats,
    model: Model,
    threads: int = 0,
) -> Floats:
    """P(a surprise of the model > surprise) of n images, given which landmarks are gross; (n,).

    surprise (n,); seen (n,), the landmarks seen; believed (n,), the expected number of those that
    are not gross. It is nan where 3 are seen or fewer, which any view fits, and where there is no
    posterior. It is 0 where more are seen, but fewer than 3 or less than 2/3 of them believed.
    """
    some = (np.asarray(seen) > VIEWED // 2) & np.isfinite(squared_mahalanobis)
    p = np.full(len(squared_mahalanobis), np.nan)
    if some.any():
        excess, share = find_surprise(np.asarray(seen)[some], model, threads)
        mean = np.maximum(2 * believed[some] - VIEWED + excess, LEAST_MEAN)
        p[some] = exceeds(np.maximum(squared_mahalanobis[some], 0.0), mean, 2 * share * mean)
        p[some & (believed < np.maximum(FEWEST_BELIEVED, LEAST_BELIEVED * seen))] = 0.0
    return p


def find_surprise(seen: NDArray[np.integer], model: Model, threads: int) -> tuple[Floats, Floats]:
    """Excess and share, see `Surprise`, for each of the numbers of landmarks seen (n,)."""
    most = min(model.prior.means.shape[2], COUNTS[-1])
    counts = np.array([*(count for count in COUNTS if count < most), most])
    at = np.clip(seen, counts[0], most)
    above = np.searchsorted(counts, at)
    wanted = np.unique(np.concatenate([above, np.where(counts[above] > at, above - 1, above)]))
    drawn = {k: draw_surprise(model, int(counts[k]), threads) for k in wanted.tolist()}
    excess, share = (
        np.interp(at, counts[wanted], [drawn[k][field] for k in wanted.tolist()])
        for field in range(2)
    )
    return excess, share


@lru_cache(maxsize=64)
def draw_surprise(model: Model, count: int, threads: int) -> Surprise:
    """Draw images of `count` landmarks from the model, and see what their surprise is."""
    rng = np.random.default_rng((SEED, count))
    prior = model.prior
    p = prior.means.shape[2]
    roots = np.linalg.cholesky(prior.covariances)
    k = rng.choice(len(prior), size=DRAWS, p=prior.weights / prior.weights.sum())
    away = np.einsum("nij,nj->ni", roots[k], rng.normal(size=(DRAWS, 3 * p)))
    R = random_rotations(DRAWS, rng)
    w = (R @ (prior.means[k] + away.reshape(DRAWS, 3, p)))[:, :2]
    w += np.sqrt(model.residual_variance) * rng.normal(size=w.shape)
    shown = rng.random((DRAWS, p)).argsort(axis=1) < count
    found = find_posterior(
        landmarks=w,
        residual_variance=np.where(shown, model.residual_variance, np.inf),
        noise=np.zeros((DRAWS, p, 2, 2)),
        prior=prior,
        starts=R[:, None],
        gross=model.gross,
        threads=threads,
    )
    # images without a posterior, and those whose landmarks happen to look gross
    known = found.squared_mahalanobis[np.isfinite(found.squared_mahalanobis)]
    believed = np.nanmean(np.where(shown, found.inlier_probability, 0.0).sum(axis=1))
    mean = float(known.mean())
    return Surprise(mean - float(2 * believed - VIEWED), float(known.var()) / (2 * mean))


def exceeds(x: Floats, mean: Floats, variance: Floats) -> Floats:
    """P(X > x) for a Gamma variable X, by Wilson and Hilferty: the root x^(1/3) is nearly normal.

    (x / mean)^(1/3) has the mean 1 - c and the variance c = variance / (3 mean)^2.
    """
    c = variance / (3 * mean) ** 2
    z = (np.cbrt(x / mean) - (1 - c)) / np.sqrt(c)
    return np.array([0.5 * erfc(each) for each in (z / np.sqrt(2)).tolist()])

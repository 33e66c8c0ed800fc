"""How well an image agrees with the prior: a p-value of the squared Mahalanobis
distance.

The distance of an image is that of its landmarks from those expected, averaged over the
modes. Were shape and view a linear model with one Gaussian, it would be chi^2 with 2 m
- 6 degrees of freedom for m landmarks. But the scale is found from the same landmarks
and the components of a mixture compete for them, so the distance varies less: by 0.37
to 0.56 of that variance for people. Its moments under the model are found by drawing
images from it, once, when a dictionary is learned.
"""

from __future__ import annotations

from dataclasses import replace
from math import erfc

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Flags, Floats, Integers
from shapefit.dictionary.mixture import Mixture, widen
from shapefit.dictionary.model import Dictionary
from shapefit.geometry.rotations import random_rotations
from shapefit.lifting.posterior.posterior import OUTLIERS, Posterior, find_posterior
from shapefit.lifting.trust import VIEWED

FEWEST_INLIERS, LEAST_INLIER_SHARE = 3.0, 2 / 3
"""Landmarks that fix a view, and the share of those seen that must be inliers: with
fewer the others may be a body that is not there.
"""

LEAST_MEAN = 1.0
"""Of the distance, where hardly more landmarks are inliers than fix a view."""

COUNTS = (4, 6, 9, 14, 21, 32, 48)
"""Numbers of landmarks for which images are drawn, besides all of the dictionary, or
the last of these; between them the moments are interpolated, beyond them they are those
of the nearest.
"""

FACTOR = 1.25
"""Ratio of all landmarks to one of these numbers up to which that is not drawn beside
them.
"""

SCALES = (1.0, 8.0)
"""Scales of the prior for which images are drawn: excess and log share are nearly
linear in the log of the scale (people at 2 and 4: share .49 and .36 for .52 and .39 by
400 draws).
"""

RESIDUAL_VARIANCE = 0.006
"""With which images are drawn: that of people. From 0.0025 to 0.03 the moments hardly
change.
"""

DRAWS, PILOT, SEED = 400, 100, 1504_01507
"""Images drawn for each of them, of all components, from any view, without outliers; of
the first few is learned how many are enough.
"""

WIDE = 900.0
"""Variance of the translation, in the unit of shapes, beside which shapes hardly have
one.
"""


def find_p_values(
    squared_mahalanobis: Floats,
    visible: NDArray[np.integer],
    inliers: Floats,
    table: Floats,
) -> Floats:
    """P(a distance under the model > squared_mahalanobis) of n images, given the
    inliers; (n,).

    squared_mahalanobis (n,); seen (n,), the landmarks seen; inliers (n,), the expected
    number of those that are inliers; table (c, 3), the moments as `moments_at` returns
    them. It is nan where 3 are seen or fewer, which any view fits, and where there is
    no posterior. It is 0 where more are seen, but fewer than 3 or less than 2/3 of them
    are inliers.
    """
    some = (np.asarray(visible) > VIEWED // 2) & np.isfinite(squared_mahalanobis)
    p = np.full(len(squared_mahalanobis), np.nan)
    if some.any():
        counts, excesses, shares = table.T
        excess, share = (
            np.interp(np.asarray(visible)[some], counts, y) for y in (excesses, shares)
        )
        mean = np.maximum(2 * inliers[some] - VIEWED + excess, LEAST_MEAN)
        p[some] = exceeds(
            np.maximum(squared_mahalanobis[some], 0.0), mean, 2 * share * mean
        )
        p[
            some & (inliers < np.maximum(FEWEST_INLIERS, LEAST_INLIER_SHARE * visible))
        ] = 0.0
    return p


def moments_at(table: Floats, scale: float) -> Floats:
    """Return the rows (c, 3) of a table (t, 4) at a scale, without it: linear in its
    log.
    """
    scales = np.unique(table[:, 0], return_counts=True)[
        0
    ]  # without, it imports numpy.ma
    rows = np.stack([table[table[:, 0] == one, 1:] for one in scales])
    rows[..., 2] = np.log(rows[..., 2])
    place = np.interp(np.log(scale), np.log(scales), np.arange(len(scales)))
    low = min(int(place), max(len(scales) - 2, 0))
    high, share = min(low + 1, len(scales) - 1), place - low
    moments: Floats = (1 - share) * rows[low] + share * rows[high]
    moments[:, 2] = np.exp(moments[:, 2])
    return moments


def with_p_value_table(dictionary: Dictionary) -> Dictionary:
    """Return the dictionary with the table of its prior, if it has one, by which fits
    judge.
    """
    if dictionary.prior is None:
        return dictionary
    return replace(dictionary, p_value_table=draw_table(dictionary.prior))


def draw_table(prior: Mixture, scales: tuple[float, ...] = SCALES) -> Floats:
    """Return the moments of the distance under the model, by scale and landmarks seen;
    (t, 4).

    Rows: scale of the prior; landmarks seen, ascending; excess, how much larger its
    mean is than 2 b - 6 for b inliers; share of the variance 2 (2 b - 6 + excess) of
    chi^2.
    """
    p = prior.means.shape[2]
    if (
        p > COUNTS[-1]
    ):  # of more, a choice: the time to find a posterior grows with their cube
        prior = prior.marginal(
            np.sort(np.random.default_rng(SEED).permutation(p)[: COUNTS[-1]])
        )
        p = COUNTS[-1]
    counts = [*(count for count in COUNTS if FACTOR * count < p), p]
    return np.array(
        [
            (scale, count, *draw_moments(widen(prior, scale), count))
            for scale in scales
            for count in counts
        ]
    )


def draw_moments(prior: Mixture, count: int) -> tuple[float, float]:
    """Draw images of `count` landmarks from the model: excess and share, see
    `draw_table`.

    The distance x is compared with y, that from what is expected at the true view and
    component, which is chi^2 with f = 2 count - 2 degrees of freedom (a control
    variate): with b the slope of x over y, and z = x - b (y - f), the mean of x is that
    of z and its variance Var z + 2 f b^2. With the correlation r, DRAWS (1 - r^4)
    images tell as much of that as DRAWS do without y.
    """
    rng = np.random.default_rng((SEED, count))
    p = prior.means.shape[2]
    roots = np.linalg.cholesky(prior.covariances)
    k = rng.choice(len(prior), size=DRAWS, p=prior.weights / prior.weights.sum())
    away = np.einsum("nij,nj->ni", roots[k], rng.normal(size=(DRAWS, 3 * p)))
    R = random_rotations(DRAWS, rng)
    w = (R @ (prior.means[k] + away.reshape(DRAWS, 3, p)))[:, :2]
    w += np.sqrt(RESIDUAL_VARIANCE) * rng.normal(size=w.shape)
    shown = rng.random((DRAWS, p)).argsort(axis=1) < count
    y, freedom = true_distances(prior, k, R, w, shown), 2.0 * count - 2

    def find(rows: slice) -> Posterior:
        return find_posterior(
            landmarks=w[rows],
            residual_variance=np.where(shown[rows], RESIDUAL_VARIANCE, np.inf),
            noise=np.zeros((len(k[rows]), p, 2, 2)),
            prior=prior,
            starts=R[rows, None],
            outliers=OUTLIERS,
        )

    parts = [find(slice(PILOT))]
    r = slope_and_correlation(parts[0].squared_mahalanobis, y[:PILOT])[1]
    parts.append(find(slice(PILOT, max(PILOT, round(DRAWS * (1 - r**4))))))
    x = np.concatenate([part.squared_mahalanobis for part in parts])
    inliers = np.concatenate([part.inlier_probability for part in parts])
    b, _ = slope_and_correlation(x, y[: len(x)])
    z = x - b * (y[: len(x)] - freedom)
    mean = float(np.nanmean(z))
    number = np.where(shown[: len(x)], inliers, 0.0).sum(axis=1)
    excess = mean - float(2 * np.nanmean(number) - VIEWED)
    return excess, float(np.nanvar(z) + 2 * freedom * b**2) / (2 * mean)


def slope_and_correlation(x: Floats, y: Floats) -> tuple[float, float]:
    """Return the slope of x (n,) over y (n,) and their correlation; nan in x: no
    posterior.
    """
    finite = np.isfinite(x)
    C = np.cov(x[finite], y[finite])
    return float(C[0, 1] / C[1, 1]), float(C[0, 1] / np.sqrt(C[0, 0] * C[1, 1]))


def true_distances(
    prior: Mixture, k: Integers, R: Floats, w: Floats, shown: Flags
) -> Floats:
    """Squared Mahalanobis distances (n,) of shown landmarks at the true components and
    views.
    """
    rows, index = np.arange(len(k))[:, None], np.nonzero(shown)[1].reshape(len(k), -1)
    P, m = R[:, None, None, :2], index.shape[1]
    C = prior.by_landmark[k[:, None, None], index[:, :, None], :, index[:, None], :]
    S = (P @ C @ P.swapaxes(3, 4) + WIDE * np.eye(2)).transpose(0, 1, 3, 2, 4)
    S = S.reshape(len(k), 2 * m, 2 * m) + RESIDUAL_VARIANCE * np.eye(2 * m)
    r = (w - (R @ prior.means[k])[:, :2])[rows, :, index].reshape(len(k), 2 * m, 1)
    squares: Floats = (r * np.linalg.solve(S, r)).sum(axis=(1, 2))
    return squares


def exceeds(x: Floats, mean: Floats, variance: Floats) -> Floats:
    """P(X > x) for a Gamma variable X, by Wilson and Hilferty: the root x^(1/3) is
    nearly normal.

    (x / mean)^(1/3) has the mean 1 - c and the variance c = variance / (3 mean)^2.
    """
    c = variance / (3 * mean) ** 2
    z = (np.cbrt(x / mean) - (1 - c)) / np.sqrt(c)
    return np.array([0.5 * erfc(value) for value in (z / np.sqrt(2)).tolist()])

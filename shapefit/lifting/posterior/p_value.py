"""How well an image agrees with the prior: a p-value of a squared distance.

The distance of an image, that of Mahalanobis, is that of its landmarks from those
expected, averaged over the modes. Were shape and view a linear model with one Gaussian,
it would be chi^2 with 2 m - 6 degrees of freedom for m landmarks. But the scale is
found from the same landmarks and the components of a mixture compete for them, so the
distance varies less: by 0.37 to 0.56 of that variance for people. Its moments under the
model are found by drawing images from it, once, when a dictionary is learned.
"""

from __future__ import annotations

from dataclasses import replace
from math import erfc
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Flags, Floats, Integers
from shapefit.dictionary.mixture import Mixture, widen
from shapefit.dictionary.model import Dictionary
from shapefit.geometry.rotations import random_rotations
from shapefit.lifting.posterior.posterior import OUTLIERS, Posterior, find_posterior
from shapefit.lifting.trust import VIEW_NUMBERS
from shapefit.threads import on_threads

MIN_INLIERS = 3.0
"""Landmarks that fix a view."""

MIN_INLIER_SHARE = 2 / 3
"""Of the landmarks seen: with fewer the others may be a body that is not there."""

MIN_MEAN_DISTANCE = 1.0
"""Mean of the distance, where hardly more landmarks are inliers than fix a view."""

DRAWN_LANDMARKS = (4, 6, 9, 14, 21, 32, 48)
"""Numbers of landmarks for which images are drawn, besides all of the dictionary, or
the last of these; between them the moments are interpolated, beyond them they are those
of the nearest.
"""

MIN_COUNT_RATIO = 1.25
"""Ratio of all landmarks to one of these numbers beyond which that is drawn, too."""

DRAWN_SCALES = (1.0, 8.0)
"""Scales of the prior for which images are drawn: excess and log share are nearly
linear in the log of the scale (people at 2 and 4: share .49 and .36 for .52 and .39 by
400 draws).
"""

DRAWN_RESIDUAL_VARIANCE = 0.006
"""With which images are drawn: that of people. From 0.0025 to 0.03 the moments hardly
change.
"""

DRAWN_IMAGES = 400
"""For each of them, of all components, from any view, without outliers."""

PILOT_IMAGES = 100
"""The first of these, by which is learned how many are enough."""

DRAW_SEED = 1504_01507
"""Of the images that are drawn."""

WIDE_TRANSLATION_VARIANCE = 900.0
"""In the unit of shapes, which beside it hardly have a translation."""


def find_p_values(
    squared_mahalanobis: Floats,
    visible: NDArray[np.integer],
    inliers: Floats,
    table: Floats,
) -> Floats:
    """Return the p-values (n,) of images: the chance of a larger distance by the model.

    squared_mahalanobis (n,); visible (n,), the landmarks seen; inliers (n,), the
    expected number of those that are inliers; table (c, 3), the moments as `moments_at`
    returns them. It is nan where 3 are seen or fewer, which any view fits, and where
    there is no posterior. It is 0 where more are seen, but fewer than 3 or less than
    2/3 of them are inliers.
    """
    visible = np.asarray(visible)
    is_judged = (visible > VIEW_NUMBERS // 2) & np.isfinite(squared_mahalanobis)
    p = np.full(len(squared_mahalanobis), np.nan)
    if not is_judged.any():
        return p
    counts, excesses, shares = table.T
    excess = np.interp(visible[is_judged], counts, excesses)
    share = np.interp(visible[is_judged], counts, shares)
    freedom = 2 * inliers[is_judged] - VIEW_NUMBERS
    mean = np.maximum(freedom + excess, MIN_MEAN_DISTANCE)
    distance = np.maximum(squared_mahalanobis[is_judged], 0.0)
    p[is_judged] = find_chance_above(distance, mean, 2 * share * mean)
    has_few_inliers = inliers < np.maximum(MIN_INLIERS, MIN_INLIER_SHARE * visible)
    p[is_judged & has_few_inliers] = 0.0
    return p


def moments_at(table: Floats, scale: float) -> Floats:
    """Interpolate the moments (c, 3) of a p-value table (t, 4) at a scale of the prior.

    Linearly in the logarithm of the scale, which is the first column of the table and
    left out; beyond its scales as at the nearest.
    """
    # without counts np.unique imports masked arrays, which takes time
    scales, _ = np.unique(table[:, 0], return_counts=True)
    rows = np.stack([table[table[:, 0] == one, 1:] for one in scales])
    rows[..., 2] = np.log(rows[..., 2])
    place = np.interp(np.log(scale), np.log(scales), np.arange(len(scales)))
    low = min(int(place), max(len(scales) - 2, 0))
    high = min(low + 1, len(scales) - 1)
    share = place - low
    moments: Floats = (1 - share) * rows[low] + share * rows[high]
    moments[:, 2] = np.exp(moments[:, 2])
    return moments


def with_p_value_table(dictionary: Dictionary) -> Dictionary:
    """Return the dictionary with its table of p-values; as it is, without a prior."""
    if dictionary.prior is None:
        return dictionary
    return replace(dictionary, p_value_table=draw_table(dictionary.prior))


def draw_table(prior: Mixture, scales: tuple[float, ...] = DRAWN_SCALES) -> Floats:
    """Return the p-value table (t, 4): moments of distances of images drawn.

    They are found by drawing images. Columns: scale of the prior; landmarks seen,
    ascending; excess, how much larger its mean is than 2 b - 6 for b inliers; share of
    the variance 2 (2 b - 6 + excess) of chi^2.
    """
    p = prior.means.shape[2]
    most = DRAWN_LANDMARKS[-1]
    if p > most:
        # the time to find a posterior grows with their cube
        some = np.random.default_rng(DRAW_SEED).permutation(p)[:most]
        prior = prior.marginal(np.sort(some))
        p = most
    counts = [count for count in DRAWN_LANDMARKS if MIN_COUNT_RATIO * count < p]
    places = [(scale, count) for scale in scales for count in (*counts, p)]
    table = np.empty((len(places), 4))

    def fill(row: int) -> None:
        """Fill in a row of the table."""
        scale, count = places[row]
        table[row] = (scale, count, *draw_moments(widen(prior, scale), count))

    # the last takes longest, and others would wait for it
    on_threads(fill, reversed(range(len(places))), 0)
    return table


def draw_moments(prior: Mixture, count: int) -> tuple[float, float]:
    """Compare distances of drawn images with chi^2: excess of mean, ratio of variance.

    Of images of `count` landmarks, see `draw_table`. The distance x is compared with y,
    that from what is expected at the true view and component, which is chi^2 with f = 2
    count - 2 degrees of freedom (a control variate): with b the slope of x over y, and
    z = x - b (y - f), the mean of x is that of z and its variance Var z + 2 f b^2. With
    the correlation r, (1 - r^4) times as many images tell as much of that as all do
    without y.
    """
    drawn = draw_images(prior, count)
    freedom = 2.0 * count - 2
    pilot = drawn.part(slice(PILOT_IMAGES))
    of_pilot = find_posterior_of(pilot, prior)
    y = true_distances(prior, pilot)
    _, r = slope_and_correlation(of_pilot.squared_mahalanobis, y)
    enough = max(PILOT_IMAGES, round(DRAWN_IMAGES * (1 - r**4)))
    others = drawn.part(slice(PILOT_IMAGES, enough))
    of_others = find_posterior_of(others, prior)
    x = np.concatenate([of_pilot.squared_mahalanobis, of_others.squared_mahalanobis])
    y = np.concatenate([y, true_distances(prior, others)])
    inliers = np.concatenate(
        [of_pilot.inlier_probability, of_others.inlier_probability]
    )
    b, _ = slope_and_correlation(x, y)
    z = x - b * (y - freedom)
    mean = float(np.nanmean(z))
    number = np.where(drawn.shown[: len(x)], inliers, 0.0).sum(axis=1)
    excess = mean - float(2 * np.nanmean(number) - VIEW_NUMBERS)
    variance = float(np.nanvar(z) + 2 * freedom * b**2)
    return excess, variance / (2 * mean)


class Drawn(NamedTuple):
    """Images drawn from the model.

    component k (n,), rotation R (n, 3, 3), landmarks w (n, 2, p), shown (n, p).
    """

    component: Integers
    rotation: Floats
    landmarks: Floats
    shown: Flags

    def part(self, rows: slice) -> Drawn:
        """Return the drawn images `rows`."""
        return Drawn(
            self.component[rows],
            self.rotation[rows],
            self.landmarks[rows],
            self.shown[rows],
        )


def draw_images(prior: Mixture, count: int) -> Drawn:
    """Draw images of shapes of the prior, with `count` shown landmarks each."""
    rng = np.random.default_rng((DRAW_SEED, count))
    n = DRAWN_IMAGES
    p = prior.means.shape[2]
    roots = np.linalg.cholesky(prior.covariances)
    k = rng.choice(len(prior), size=n, p=prior.weights / prior.weights.sum())
    away = rng.normal(size=(n, 3 * p))
    for i, root in enumerate(roots):
        away[k == i] = np.einsum("ij,nj->ni", root, away[k == i])
    R = random_rotations(n, rng)
    w = (R @ (prior.means[k] + away.reshape(n, 3, p)))[:, :2]
    w += np.sqrt(DRAWN_RESIDUAL_VARIANCE) * rng.normal(size=w.shape)
    shown = rng.random((n, p)).argsort(axis=1) < count
    return Drawn(k, R, w, shown)


def find_posterior_of(drawn: Drawn, prior: Mixture) -> Posterior:
    """Return the posterior of drawn images, sought from their true views."""
    n, p = drawn.shown.shape
    return find_posterior(
        landmarks=drawn.landmarks,
        residual_variance=np.where(drawn.shown, DRAWN_RESIDUAL_VARIANCE, np.inf),
        noise=np.zeros((n, p, 2, 2)),
        prior=prior,
        starts=drawn.rotation[:, None],
        outliers=OUTLIERS,
        shapes=False,
        threads=1,
    )


def slope_and_correlation(x: Floats, y: Floats) -> tuple[float, float]:
    """Return the slope of x (n,) over y (n,), and their correlation.

    Pairs whose x is nan do not count.
    """
    finite = np.isfinite(x)
    C = np.cov(x[finite], y[finite])
    slope = C[0, 1] / C[1, 1]
    correlation = C[0, 1] / np.sqrt(C[0, 0] * C[1, 1])
    return float(slope), float(correlation)


def true_distances(prior: Mixture, drawn: Drawn) -> Floats:
    """Return squared Mahalanobis distances (n,) of drawn images by their true states.

    These are the component and the view of which each was drawn.
    """
    k, R, w, shown = drawn
    n = len(k)
    rows = np.arange(n)[:, None]
    m = int(shown[:1].sum())  # of every image
    landmark = np.nonzero(shown)[1].reshape(n, m)
    P = R[:, None, None, :2]
    by_landmark = prior.by_landmark
    C = by_landmark[k[:, None, None], landmark[:, :, None], :, landmark[:, None], :]
    blocks = P @ C @ P.swapaxes(3, 4) + WIDE_TRANSLATION_VARIANCE * np.eye(2)
    S = blocks.transpose(0, 1, 3, 2, 4).reshape(n, 2 * m, 2 * m)
    S = S + DRAWN_RESIDUAL_VARIANCE * np.eye(2 * m)
    residual = w - (R @ prior.means[k])[:, :2]
    r = residual[rows, :, landmark].reshape(n, 2 * m, 1)
    squares: Floats = (r * np.linalg.solve(S, r)).sum(axis=(1, 2))
    return squares


def find_chance_above(x: Floats, mean: Floats, variance: Floats) -> Floats:
    """Return P(X > x) (n,) for Gamma variables X of these means and variances (n,).

    By Wilson and Hilferty, for whom the root X^(1/3) is nearly normal: (X / mean)^(1/3)
    has the mean 1 - c and the variance c = variance / (3 mean)^2.
    """
    c = variance / (3 * mean) ** 2
    z = (np.cbrt(x / mean) - (1 - c)) / np.sqrt(c)
    return np.array([0.5 * erfc(value) for value in (z / np.sqrt(2)).tolist()])

"""What every sequence allows: posterior means that do not jitter from frame to frame.

    argmin_y  sum_t (y_t - m_t)^2 / (k sd_t^2)  +  sum_t (y_(t-1) - 2 y_t + y_(t+1))^2 / a^2

for the mean m and the standard deviation sd of each coordinate in single images. Errors of
neighbouring images are much alike, and smoothing cannot take them away: it would but blur the
motion. k is the share of the variance that is independent from image to image, found in the means
themselves. The means are not taken apart into modes, and no bone is held rigid: this is for
sequences that know no better.
"""

from __future__ import annotations

import numpy as np

from shapefit.arrays import Floats

DIFFERENCE = (1.0, -2.0, 1.0)

LEAST_JITTER = 1e-6


def steady(means: Floats, deviations: Floats, acceleration: Floats) -> Floats:
    """Smooth means (t, 3, p) of standard deviations (t, 3, p), inf where nothing is known.

    acceleration a (p,); two frames at least must be known.
    """
    from scipy.linalg import solveh_banded  # which few sequences need

    t, _, p = means.shape
    weight = 1 / (find_jitter(means, deviations)[:, None] * deviations**2)
    fixed = np.zeros((3, t))
    for a, left in enumerate(DIFFERENCE if t > 2 else ()):
        for b, right in enumerate(DIFFERENCE[: a + 1]):
            fixed[a - b, b : b + t - 2] += left * right
    smoothed = np.empty_like(means)
    for axis in range(3):
        for j in range(p):
            bands = fixed / acceleration[j] ** 2
            bands[0] += weight[:, axis, j]
            pull = weight[:, axis, j] * means[:, axis, j]
            smoothed[:, axis, j] = solveh_banded(bands, pull, lower=True)
    return smoothed


def find_jitter(means: Floats, deviations: Floats) -> Floats:
    """Share k (3,) of the variances that jitters, from 0 to 1, x and y taken together.

    As in `find_haste`, second differences of a steady motion have the variance v and the covariance
    0.7 v of neighbours, those of white noise 6 and -4 times its variance, which is then
    (0.7 variance - covariance) / 8.2.
    """
    known = np.isfinite(deviations)
    second = means[2:] - 2 * means[1:-1] + means[:-2]
    if len(second) < 2:
        return np.full(3, LEAST_JITTER)
    variance, covariance = (second**2).mean(axis=0), (second[1:] * second[:-1]).mean(axis=0)
    white = np.maximum(0.7 * variance - covariance, 0.0) / 8.2
    own = np.where(known, deviations, 0.0) ** 2
    whole = own.sum(axis=0) / np.maximum(known.sum(axis=0), 1)
    of_plane = white[:2].sum() / max(float(whole[:2].sum()), 1e-300)
    of_depth = white[2].sum() / max(float(whole[2].sum()), 1e-300)
    share: Floats = np.clip(np.array([of_plane, of_plane, of_depth]), LEAST_JITTER, 1.0)
    return share

"""The parameters of a skeleton from the landmarks themselves, without truth.

    argmax_theta  sum_t log p(w_t | theta) + sum_k log N(log theta_k; log mean_k, spread_k^2)

over some images t of the files: how high the head is, how wide hips and shoulders are, is as much
the choice of a detector as it is of a body.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from shapefit.io.skeletons import THETA

Theta = Mapping[str, float]

STEPS = (-0.2, -0.1, 0.0, 0.1, 0.2)
"""Of the logarithm of a parameter, tried about its mean, and half of them about the best."""

IMAGES = 20
"""Images that are asked, spread over those that are looked at."""

FEWEST_SEEN = 8
"""Landmarks of an image that is asked."""


class Found(NamedTuple):
    """A theta, and the standard deviations of the logarithms of its parameters."""

    theta: dict[str, float]
    spread: dict[str, float]


def find_theta(evidence: Callable[[Theta], float], names: Sequence[str], fixed: Theta) -> Found:
    """Maximise the posterior of the named parameters, one after the other, twice.

    evidence is log p(w | theta); `fixed` parameters stay. Each is taken to the top of the parabola
    through the best value tried and its neighbours, whose curvature gives its spread.
    """
    theta = {name: parameter.mean for name, parameter in THETA.items()} | dict(fixed)
    spread: dict[str, float] = {}
    for factor in (1.0, 0.5):
        for name in names:
            if name in fixed:
                continue
            mean, wide = THETA[name].mean, THETA[name].spread
            tried = np.log(theta[name]) + factor * np.array(STEPS)
            values = np.array(
                [
                    evidence(theta | {name: float(np.exp(x))})
                    - 0.5 * ((x - np.log(mean)) / wide) ** 2
                    for x in tried
                ]
            )
            best = min(max(int(np.argmax(values)), 1), len(tried) - 2)
            below, at, above = values[best - 1 : best + 2]
            step = tried[1] - tried[0]
            curvature = (2 * at - below - above) / step**2
            top = tried[int(np.argmax(values))]
            if curvature > 0:
                top = tried[best] + np.clip((above - below) / (2 * step * curvature), -step, step)
                spread[name] = float(curvature**-0.5)
            theta[name] = float(np.exp(top))
    return Found(theta, spread)

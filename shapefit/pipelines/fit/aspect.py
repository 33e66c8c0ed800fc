"""Whether x and y have the same scale: a picture that is stretched shows other people.

Shares and percents of the image, and sizes of images that are exchanged, stretch
landmarks along one axis. The prior knows how tall and how wide people look. Let x be
wider by a factor a than it should be: then w' = (x / a, y) is what a camera would have
seen, and the log evidence of an image changes by

    g(a) = log p(w' / s') - log p(w / s) - (m - 1) (log a + 2 log s' - 2 log s)

for m landmarks that are seen, normalised by their sizes s and s', since a density is
one of x and y, and two of its 2m coordinates go into the place of the body. A file is
stretched where g(a) is large for most images alike: a few images of any file gain a
lot, where a pose resembles another one that is stretched. So the lower quartile over
the images is judged, not the mean.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from shapefit.arrays import Floats, median
from shapefit.pipelines.fit.image_posterior import ImagePosterior
from shapefit.records import Landmarks

STRETCH_FACTORS = (0.5, 0.62, 1.6, 2.0)
"""Stretches of x that are looked for. Smaller ones are taken for people of another
build.
"""

MIN_STRETCH_GAIN = 1.5
"""Log evidence, in nats, that three images in four must gain: one right clip in 275 on
film of seven bodies has so much.
"""

MIN_STRETCH_IMAGES = 20
"""Images of a sample that say something of its file."""

FIRST_LOOK = 3
"""The first of so many images are looked at first: where too many of them gain too
little, the others need no look. Nearly all do in a file that is not stretched.
"""

MIN_STRETCH_LANDMARKS = 10
"""Median number of landmarks of an image: half bodies fit a stretched picture, too."""


def find_stretch(sample: Landmarks, posterior: ImagePosterior) -> float:
    """Return the factor of STRETCH_FACTORS by which x of a sample is too wide, else 1.

    People alone: the posterior must know the usual lengths of their limbs.
    """
    seen = sample.visible().sum(axis=1)
    if posterior.limbs is None or len(sample) < MIN_STRETCH_IMAGES:
        return 1.0
    if median(seen) < MIN_STRETCH_LANDMARKS:
        return 1.0
    posterior = replace(posterior, camera=None)
    few = find_gains(
        sample.take(slice(None, None, FIRST_LOOK)), posterior, STRETCH_FACTORS
    )
    possible = [
        factor for factor, gain in few.items() if may_be_enough(gain, len(sample))
    ]
    if not possible:
        return 1.0
    gains = find_gains(sample, posterior, possible)
    quartiles = {factor: first_quartile(gain) for factor, gain in gains.items()}
    best = max(quartiles, key=lambda factor: quartiles[factor])
    return best if quartiles[best] > MIN_STRETCH_GAIN else 1.0


def find_gains(
    images: Landmarks, posterior: ImagePosterior, factors: Sequence[float]
) -> dict[float, Floats]:
    """Return the gains g(a) (n,) of images for each factor a."""
    seen = images.visible().sum(axis=1)
    before = log_density(images, posterior)
    gains = {}
    for factor in factors:
        after = log_density(divide_x(images, factor), posterior)
        gains[factor] = after - before - (seen - 1) * np.log(factor)
    return gains


def may_be_enough(gains: Floats, n: int) -> bool:
    """Whether the lower quartile of n gains can be enough, by those known so far.

    It cannot where it lies between two of the gains that are too small.
    """
    too_small = int((gains <= MIN_STRETCH_GAIN).sum())
    return too_small < (n - 1) // 4 + 2


def describe_stretch(factor: float) -> str:
    """Return a text that warns of a file whose x is too wide by a factor."""
    how = f"{factor:.2g} times as wide" if factor > 1 else f"{factor:.2g} of the width"
    return (
        f"people in it have about {how} that a camera shows: x and y have different"
        " scales; are these percent of the image, or are its width and height"
        " exchanged? Give landmarks in pixels"
    )


def divide_x(images: Landmarks, factor: float) -> Landmarks:
    """Return images whose x is divided by a factor."""
    scale = np.array([factor, 1.0])
    return replace(images, landmarks=images.landmarks / scale)


def log_density(images: Landmarks, posterior: ImagePosterior) -> Floats:
    """Return the log density (n,) of the landmarks of each image, per square unit."""
    lifting = posterior.lift(images)
    seen = (lifting.problem.weights > 0).sum(axis=1)
    evidence = lifting.estimate.log_evidence
    density: Floats = evidence - 2 * (seen - 1) * np.log(lifting.scale)
    return density


def first_quartile(values: Floats) -> float:
    """Return the lower quartile of the finite values, -inf if there is none."""
    finite = values[np.isfinite(values)]
    return float(np.quantile(finite, 0.25)) if len(finite) else -np.inf

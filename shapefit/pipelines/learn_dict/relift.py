"""Landmarks lifted as `fit` does, by a dictionary that is being learned from them."""

from __future__ import annotations

from collections.abc import Callable, Generator
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from shapefit.config import FitConfig
from shapefit.dictionary.from_2d.model import evenly, hide
from shapefit.dictionary.model import LEARNED_FROM, Dictionary
from shapefit.errors import counted
from shapefit.geometry.normalisation import spread
from shapefit.io import LandmarkSet, ShapeSet
from shapefit.pipelines.fit.chain import fit_images
from shapefit.pipelines.fit.plan import plan_fit
from shapefit.pipelines.learn_dict.from_2d import Learned, gaussian_prior
from shapefit.pipelines.outcome import Outcome

Floats = NDArray[np.float64]

SAMPLE = 500
"""Images by which priors are compared."""


MIXTURES = 4
"""Rounds of learning a mixture at most."""

IMAGES_PER_COMPONENT, MOST_COMPONENTS = 150, 32

HOPELESS = 1.3
"""Factor of the error from which a mixture is no start for a better one."""

CLOSE = 1.1
"""Factor of the Gaussian's error up to which a mixture of several is kept.

They say little of depth, of which a mixture that is as good in the image knows more.
"""

LARGER = 2.0
"""Factor of size from one round to the next beyond which an image was misread."""

QUICK = 3
"""Rounds of learning atoms that only have to find views."""

Make = Callable[[ShapeSet, int, int], Generator[Outcome, None, Dictionary]]
"""Makes a dictionary of shapes, with so many components of its prior, in so many rounds."""


def relift(
    learned: Learned, make: Make, components: int, iterations: int
) -> Generator[Outcome, None, Dictionary]:
    """Learn mixtures of the shapes that the prior before lifted, while they predict better.

    components of the mixtures, 0 for as many as the images allow; iterations for the atoms.
    """
    images, shapes = learned.images, learned.shapes
    method = "posterior" if images.sequences is None else "sequences"
    number = components or int(np.clip(len(images) // IMAGES_PER_COMPONENT, 1, MOST_COMPONENTS))
    made = yield from make(shapes, 0, QUICK)
    best = replace(made, **gaussian_prior(learned, made.mean_shape))
    error = hidden_error(images, best)
    of_best = shapes
    for _ in range(MIXTURES):
        mixed = yield from make(shapes, number, QUICK)
        found = hidden_error(images, mixed)
        gaussian = best.misfit is not None
        kept = found < (CLOSE * error if gaussian and number > 1 else error)
        yield Outcome(
            line=f"prior of {counted(number, 'component')}: hidden landmarks {found:.4f} off, "
            f"{error:.4f} before; {'kept' if kept else 'left out'}"
        )
        if found > HOPELESS * error:
            break
        if kept:
            best, error, of_best = mixed, found, shapes
        lifted = lift_again(images, mixed, method)
        grown = np.linalg.norm(lifted, axis=(1, 2)) / np.linalg.norm(shapes.shapes, axis=(1, 2))
        fine = (grown > 1 / LARGER) & (grown < LARGER)  # not so where it is nan
        shapes = replace(shapes, shapes=np.where(fine[:, None, None], lifted, shapes.shapes))
    made = yield from make(of_best, 0, iterations)
    provenance = {**made.provenance, LEARNED_FROM: "landmarks"}
    return replace(made, prior=best.prior, misfit=best.misfit, provenance=provenance)


def lift_again(images: LandmarkSet, dictionary: Dictionary, method: str) -> Floats:
    """Return the shapes (n, 3, p) that `fit` with its defaults has; nan where it has none."""
    config = FitConfig.model_construct(
        landmarks=(Path("landmarks"),),
        dictionary=Path("dictionary"),
        output=Path("result.h5"),
        method=method,
    )
    return fit_images(
        images, dictionary, plan_fit(config, dictionary, dictionary.landmark_names).lift
    ).shapes


def hidden_error(images: LandmarkSet, dictionary: Dictionary) -> float:
    """Median distance of landmarks that are hidden from `fit`, in the size of their image.

    In a sample of the images, each by itself.
    """
    some = images.take(evenly(len(images), SAMPLE))
    seen = some.seen()
    hidden = hide(seen)
    known = replace(some, landmarks=np.where(hidden[:, None], np.nan, some.landmarks))
    placed = lift_again(known, dictionary, "posterior")[:, :2]
    apart = np.linalg.norm(placed - some.landmarks, axis=1) / spread(some.landmarks, seen)[:, None]
    return float(np.nanmedian(apart[hidden]))

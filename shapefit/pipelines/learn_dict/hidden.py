"""Landmarks that are hidden from `fit`, and how well a dictionary predicts them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from shapefit.arrays import Floats
from shapefit.config import FitConfig
from shapefit.config.commands.fit_sections import CAMERA_MATRIX, ViewingConfig
from shapefit.dictionary.from_2d.model import evenly, hide
from shapefit.dictionary.model import Dictionary
from shapefit.geometry.normalisation import spread
from shapefit.io import LandmarkSet
from shapefit.lifting.lift import Lifting
from shapefit.lifting.methods import PosteriorOptions
from shapefit.pipelines.fit.camera import read_intrinsics
from shapefit.pipelines.fit.chain import fit_images
from shapefit.pipelines.fit.plan import find_misfit, plan_fit

SAMPLE = 500
"""Images by which dictionaries are compared."""


@dataclass(frozen=True)
class Predicted:
    """Median distance of hidden landmarks from where they are, in the size of their image.

    log_density (n,) of them, the mean of each image, nan where none was hidden or predicted.
    """

    error: float
    log_density: Floats


def lift_by(
    images: LandmarkSet, dictionary: Dictionary, method: str, camera: str | None = None
) -> Lifting:
    """Lift images as `fit` does with its defaults; they have the landmarks of the dictionary.

    camera names the dataset of their camera matrices, None for weak perspective.
    """
    plan = plan_fit(_config(method, camera), dictionary, dictionary.landmark_names)
    return fit_images(images, dictionary, plan.lift)


def evidence_of_mirror(images: LandmarkSet, dictionary: Dictionary) -> tuple[float, float]:
    """Log evidence an image that the class is mirrored, as the cameras see it; standard error.

    The mirror image of a class is seen as the class is in mirrored images.
    """
    some = images.take(evenly(len(images), SAMPLE))
    middle = read_intrinsics(some, CAMERA_MATRIX)[1][:, :1]
    w = some.landmarks.copy()
    w[:, 0] = 2 * middle - w[:, 0]
    kept, mirrored = (
        lift_by(each, dictionary, "posterior", CAMERA_MATRIX).estimate.further["log_evidence"]
        for each in (some, some.replaced(landmarks=w))
    )
    gain = (mirrored - kept)[np.isfinite(mirrored - kept)]
    if len(gain) < 2:
        return 0.0, np.inf
    return float(gain.mean()), float(gain.std() / np.sqrt(len(gain)))


def _config(method: str, camera: str | None = None) -> FitConfig:
    looks = ViewingConfig(model="perspective", intrinsics=camera) if camera else ViewingConfig()
    return FitConfig.model_construct(
        landmarks=(Path("landmarks"),),
        dictionary=Path("dictionary"),
        output=Path("result.h5"),
        method=method,
        camera=looks,
    )


def predict_hidden(images: LandmarkSet, dictionary: Dictionary) -> Predicted:
    """Hide a tenth of the landmarks of a sample of the images, each by itself, and predict them.

    Their density is that of `method: posterior`: normal, or, of gross ones, even.
    """
    some = images.take(evenly(len(images), SAMPLE))
    seen = some.seen()
    hidden = hide(seen)
    known = some.replaced(landmarks=np.where(hidden[:, None], np.nan, some.landmarks))
    found = lift_by(known, dictionary, "posterior")
    deviation = found.estimate.deviation
    assert deviation is not None, "a posterior has deviations"
    size = spread(some.landmarks, seen)[:, None]
    apart = (found.shapes[:, :2] - some.landmarks) / size[..., None]
    options = PosteriorOptions()
    misfit = find_misfit(_config("posterior"), dictionary)
    variance = (found.scale[:, None, None] / size[..., None] * deviation[:, :2]) ** 2 + misfit
    normal = np.exp(-0.5 * (apart**2 / variance).sum(axis=1)) / (
        2 * np.pi * np.sqrt(variance.prod(axis=1))
    )
    chance = options.gross_chance
    density = np.log((1 - chance) * normal + chance * options.gross_density)
    known_there = hidden & np.isfinite(density)
    count = known_there.sum(axis=1)
    total = np.where(known_there, density, 0.0).sum(axis=1)
    distance = np.linalg.norm(apart, axis=1)
    return Predicted(
        error=float(np.nanmedian(distance[hidden])),
        log_density=np.where(count > 0, total / np.maximum(count, 1), np.nan),
    )

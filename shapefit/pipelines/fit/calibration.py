"""What a fit settles from one sample of its images, once for all its parts."""

from __future__ import annotations

from collections.abc import Generator

from shapefit import log
from shapefit.config import FitConfig
from shapefit.dictionary.model import LEARNED_FROM
from shapefit.errors import counted
from shapefit.pipelines.fit.camera import (
    choose_camera,
    read_calibrated_camera,
    remove_distortion,
    warn_of_landmarks_outside,
)
from shapefit.pipelines.fit.choices import choose_family, place_of_names
from shapefit.pipelines.fit.family import Calibration, Cost
from shapefit.pipelines.joints import LandmarkMatch
from shapefit.pipelines.result import Result
from shapefit.records import Landmarks

SAMPLE_POOL = 1024
"""Images of which the sample is drawn: the same whatever the batches and parts."""

ANNOUNCE_AFTER_SECONDS = 60.0
"""Of a fit that is announced before it starts."""

Calibrating = Generator[Result, None, Calibration]
"""Yields what is to be shown before the first image is lifted."""


def calibrate(
    config: FitConfig, match: LandmarkMatch, images: Landmarks, total: int
) -> Calibrating:
    """Estimate what the config leaves open from `images`, the first of a `total`.

    Yields a Result with the time that the fit may take, where that is long, and returns
    the Calibration. The camera is chosen first, since the family settles the rest as it
    sees them.
    """
    images = remove_distortion(images, read_calibrated_camera(config))
    family = choose_family(config, match)
    family.check(images)
    named = match.arrange(images, place_of_names(config))
    text = format_duration(family.predict_cost(named, total), total)
    if text:
        yield Result(line=text)

    from_landmarks = LEARNED_FROM in match.dictionary.provenance
    camera = choose_camera(config, images, from_landmarks=from_landmarks)
    outside = warn_of_landmarks_outside(config, images)
    config = config.changed(camera=dict(camera.keys))
    settled = choose_family(config, match).calibrate(images)
    log.debug("fit", "camera: %s", camera.line)
    log.debug("fit", "settled by a sample: %s", settled)
    return settled._replace(
        camera=camera.keys,
        lines=(f"camera: {camera.line}", *settled.lines),
        warnings=(*settled.warnings, *((outside,) if outside else ())),
    )


def format_duration(cost: Cost, total: int) -> str:
    """Return a line on how long all images may take, "" for less than a minute."""
    seconds = cost.per_image * cost.liftings
    if seconds < ANNOUNCE_AFTER_SECONDS:
        return ""
    duration = f"{seconds / 60:,.0f} minutes"
    if seconds < 120:
        duration = f"{seconds:.0f} seconds"
    if total > 1:
        duration += f", {cost.per_image:.2g} s each"
    fix = "give fewer landmarks, or a dictionary with fewer components or atoms"
    return f"{counted(total, 'image')} may take up to {duration}: {fix}"

"""Which images a sweep fits, and with which landmarks made wrong."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from shapefit.config.commands.sweep import CorruptionConfig
from shapefit.errors import input_error
from shapefit.io import LandmarkSet, landmark_writer, open_landmarks
from shapefit.io.extras import CORRUPTED, Extras
from shapefit.pipelines.project.imperfections import BATCH, Purpose, corrupt, stream

WARM_UP = 8
"""Images of the file to warm up with."""


MARGIN = 0.1
"""By what share of its size the box in which wrong points lie is grown on each side."""


@dataclass(frozen=True)
class Choice:
    """Every n-th image, from the one at `offset` on, of those with so many visible landmarks."""

    least_visible: int
    offset: int
    every: int


def choose_images(
    landmarks: Sequence[Path],
    choice: Choice,
    corruption: CorruptionConfig | None,
    names: Sequence[str],
    chosen: Path,
    warm_up: Path,
) -> None:
    """Write the chosen images to one file, and the first few of them to one to warm up with.

    With `corruption` their landmarks are arranged as `names`, and the images get the dataset
    `corrupted`. What is drawn for an image depends on its place in the landmark files, not on
    the choice. Raises InputError where no image is left.
    """
    enough, written = 0, 0
    with (
        open_landmarks(landmarks) as source,
        landmark_writer(chosen) as writer,
        landmark_writer(warm_up) as first_ones,
    ):
        for batch, images in enumerate(source.chunks(BATCH)):
            visible = images.seen().sum(axis=1)
            rows = np.flatnonzero(visible >= choice.least_visible)
            number = enough + np.arange(len(rows)) - choice.offset
            enough += len(rows)
            rows = rows[(number >= 0) & (number % choice.every == 0)]
            if corruption is not None:
                images = corrupted(images.arrange(names), corruption, batch)
            kept = images.take(rows)
            writer.append(kept)
            if written < WARM_UP:
                first_ones.append(kept.take(slice(WARM_UP - written)))
            written += len(rows)
        if not written:
            found = f"{enough} images with {choice.least_visible} visible landmarks or more"
            fix = "lower `least_visible` or `offset`: no image is left to fit"
            raise input_error(", ".join(map(str, landmarks)), found, fix)


def corrupted(images: LandmarkSet, config: CorruptionConfig, batch: int) -> LandmarkSet:
    """Return the images of a batch with some landmarks replaced, and the dataset that says so."""
    rng = stream(config.seed, Purpose.CORRUPTION, batch)
    seen = images.seen()
    landmarks, wrong = corrupt(images.landmarks, seen, config.share, MARGIN, rng)
    extras = Extras.of(images.extras, len(images))
    before = extras.get(CORRUPTED)
    extras |= {CORRUPTED: wrong if before is None else wrong | np.asarray(before, bool)}
    return replace(images, landmarks=landmarks, extras=extras)

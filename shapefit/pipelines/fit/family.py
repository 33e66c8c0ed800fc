"""What a family of methods is: those that combine atoms, and those with a prior.

A family has its options and its dictionary. It says what images must hold for it, what
a fit will cost, settles from a sample what its options leave open, lifts a batch, and
lays out what it alone knows of it. Each stands in a file of its own, which is imported
where it is chosen.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Integers
from shapefit.convex.problem import find_blocks
from shapefit.core import IMAGES_PER_BLOCK
from shapefit.dictionary.model import Dictionary
from shapefit.io import LandmarkSource
from shapefit.lifting.lift import Lifting
from shapefit.lifting.methods import METHODS
from shapefit.pipelines.joints import DetectorShapes
from shapefit.records import Fit, Landmarks
from shapefit.threads import thread_count

if TYPE_CHECKING:
    from shapefit.config import FitConfig


SECONDS_PER_BATCH = 1.0
"""Of a batch, after which the progress is shown."""

GROWTH = 4
"""Factor between the sizes of batches, while they grow or shrink to the pace."""

CameraKey = float | str | tuple[float, float]
"""A value of the section `camera`."""


class Calibration(NamedTuple):
    """Values of a fit that were estimated from a sample, for all of its parts.

    It is small enough for a manifest. camera, keys of that section of the config; lines
    about what was settled, the camera's first; warnings about all images. Of methods
    with a prior: skeleton, factors of a detector's, None where it has none; prior_scale
    and residual_variance; bar_scale, where a report of errors has changed it; growth
    (p,), factors on covariances of landmarks, empty for none; shown (p,), which of them
    most images show, empty if unknown; reason, why no image is to be trusted, "" for
    none; numbers, stored with the result.
    """

    camera: Mapping[str, CameraKey] = {}
    lines: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    skeleton: Mapping[str, float] | None = None
    prior_scale: float | None = None
    residual_variance: float | None = None
    bar_scale: float | None = None
    growth: tuple[float, ...] = ()
    shown: tuple[bool, ...] = ()
    reason: str = ""
    numbers: Mapping[str, float] = {}

    def apply_to(self, config: FitConfig) -> FitConfig:
        """Return the config with calibrated values of the keys that it left open."""
        return config.changed(**self.config_values(config))

    def config_values(self, config: FitConfig) -> dict[str, Any]:
        """Return key of the config -> calibrated value, for `FitConfig.changed`."""
        keys: dict[str, Any] = {"camera": dict(self.camera)}
        if not METHODS[config.method].needs_prior:
            return keys
        prior: dict[str, float | None] = {
            "scale": self.prior_scale,
            "residual_variance": self.residual_variance,
        }
        if self.bar_scale is not None:
            prior |= {"bar_scale": self.bar_scale, "calibration": None}
        skeleton = None if self.skeleton is None else dict(self.skeleton)
        return {**keys, "prior": prior, "skeleton": skeleton}


class Batch(NamedTuple):
    """Images that are lifted together, and the number (n,) of the file of each.

    Images start from others of their file alone, so that a file has the same results
    whatever others are given. None where they are of one file, or that does not count.
    """

    images: Landmarks
    group: Integers | None = None


class LiftedImages(NamedTuple):
    """A batch of n images, lifted to shapes of the dictionary's landmarks.

    detected, the landmarks of the files in 3D, where these are not those of the
    dictionary; omitted (n,), the item of the dictionary that the fit did without.
    """

    lifting: Lifting[Any]
    detected: DetectorShapes | None = None
    omitted: NDArray[np.str_] | None = None


class Cost(NamedTuple):
    """Seconds for an image, and how many are lifted, those of a sample included."""

    per_image: float
    liftings: int


class Family(Protocol):
    """A way to lift images, with its options."""

    @property
    def dictionary(self) -> Dictionary:
        """Return the dictionary whose landmarks are lifted."""
        ...

    def check(self, sample: Landmarks) -> None:
        """Raise InputError where images of the files lack what an option needs."""
        ...

    def predict_cost(self, sample: Landmarks, total: int) -> Cost:
        """Predict seconds per image, and how many liftings `total` images take."""
        ...

    def calibrate(self, sample: Landmarks) -> Calibration:
        """Estimate what the options leave open, from a sample of the images."""
        ...

    def read_batches(self, source: LandmarkSource, pace: Pace) -> Iterator[Batch]:
        """Yield the images of a source, as many at a time as the pace says.

        What is lifted together stays so.
        """
        ...

    def lift(self, images: Landmarks, group: Integers | None = None) -> LiftedImages:
        """Lift images, which have the landmarks of the dictionary, to 3D shapes.

        group: see `Batch`.
        """
        ...

    def add_columns(self, fit: Fit, lifting: Lifting[Any]) -> Fit:
        """Return the fit with the columns that this family adds, from its lifting."""
        ...


@dataclass(eq=False, repr=False)
class Pace:
    """How many images are lifted before the next are read and something is shown.

    A batch takes a second or so, up to `max_images`. It begins with as few as
    occupy all threads.
    """

    max_images: int
    images: int

    @classmethod
    def of(cls, max_images: int, threads: int) -> Pace:
        """Return the first pace of a fit on `threads` threads, 0 for one per core."""
        all_threads = thread_count(threads)
        return cls(max_images, min(max_images, IMAGES_PER_BLOCK * all_threads))

    @contextmanager
    def timed(self, images: int) -> Iterator[None]:
        """Adapt the size of the next batches to the time of one, which the block lifts.

        images, how many it has.
        """
        began = time.monotonic()
        yield
        self.follow(images, time.monotonic() - began)

    def follow(self, images: int, seconds: float) -> None:
        """Adapt the size of the next batches to the seconds that a batch took."""
        if seconds < SECONDS_PER_BATCH / GROWTH:
            self.images = min(self.max_images, max(self.images, GROWTH * images))
        elif seconds > SECONDS_PER_BATCH:
            self.images = max(IMAGES_PER_BLOCK, self.images // GROWTH)


def read_blocks(source: LandmarkSource, pace: Pace) -> Iterator[Batch]:
    """Yield batches of whole blocks of images, sized by the pace.

    A batch has images of several files where these are small.
    """
    for images, file in source.batches_of_files(round_to_blocks(pace.max_images)):
        begins = np.flatnonzero(find_blocks(file))
        start = 0
        while start < len(images):
            after = begins[begins >= start + pace.images]
            stop = int(after[0]) if len(after) else len(images)
            yield Batch(images.take(slice(start, stop)), file[start:stop])
            start = stop
        if not len(images):
            yield Batch(images)


def round_to_blocks(images: int) -> int:
    """Return a number of images rounded up to a multiple of IMAGES_PER_BLOCK.

    Within a block images start from their neighbours' solutions.
    """
    return math.ceil(images / IMAGES_PER_BLOCK) * IMAGES_PER_BLOCK

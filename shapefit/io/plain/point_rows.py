"""Points of one body per image, however they were written down, as a recording."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from shapefit.arrays import Floats
from shapefit.errors import input_error
from shapefit.io.detectors.frame_files import are_series
from shapefit.io.foreign.recording import ANYBODY, FRACTION, Instances, Recording, video_name
from shapefit.io.layout import UNKNOWN_UNIT
from shapefit.io.problems import warn_of_zeros

LEAST, MOST = -0.5, 1.5
"""Coordinates that are all within these are fractions of an image, those outside of it too."""


def of_bodies(
    path: Path,
    points: Floats,
    confidence: Floats | None,
    *,
    labels: Sequence[str] | None = None,
    frames: Sequence[int] | None = None,
    videos: Sequence[str] | None = None,
    images: bool = False,
    notes: tuple[str, ...] = (),
    **further: Any,
) -> Recording:
    """Return a recording of points (n, p, 2 or 3), one body per image, NaN where one is missing.

    labels (n) are names or numbers of the images, by default their places; frames (n) do not fall
    within a video. They are `images` that have nothing to do with one another, or the frames of a
    video. (0, 0) with a confidence of 0 is missing. `further` are fields of a Recording. Raises
    InputError for confidences below 0.
    """
    n, p, dimensions = points.shape
    points = points.copy()
    if confidence is not None and (confidence < 0).any():
        found = f"has a confidence of {np.nanmin(confidence):g}"
        raise input_error(path, found, "write 0 (hidden) or a positive number")
    if dimensions == 2:
        at_zero = (points == 0).all(axis=2)
        if confidence is not None:
            points[at_zero & (confidence == 0)] = np.nan
        else:
            notes += warn_of_zeros(points)
    fraction = dimensions == 2 and are_fractions(points[np.isfinite(points)])
    names = labels if labels is not None else [str(row) for row in range(n)]
    every = Instances(
        points=points,
        confidence=confidence,
        frames=np.arange(n) if frames is None else np.array(frames, dtype=np.int64),
        labels=names,
        individuals=np.full(n, ANYBODY if images else 0, np.int64),
        videos=videos,
    )

    return Recording(
        name=str(path),
        video=video_name(path),
        dimensions=3 if dimensions == 3 else 2,
        landmark_count=p,
        blocks=every.blocks,
        frames=n,
        unit=FRACTION if fraction else UNKNOWN_UNIT,
        size_needed=fraction,
        unordered=images and not are_series(names),
        notes=notes,
        **further,
    )


def are_fractions(known: Floats) -> bool:
    """Whether coordinates are fractions of an image rather than pixels."""
    return known.size > 0 and bool(known.min() >= LEAST and known.max() <= MOST)

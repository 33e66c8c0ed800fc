"""Keys that several commands have: how files and the truth are read; metres."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Literal

from pydantic import Field

from shapefit.config.model import Auto, CommandConfig, Pair

Text = Annotated[str, Field(min_length=1)]
Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
Count = Annotated[int, Field(ge=1)]


class LandmarksConfig(CommandConfig):
    """How files of 2D landmarks are read."""

    format: Text = "auto"
    """Format of the files (docs/formats.md); auto recognises it by their content."""
    individual: Text | None = None
    """Read only this individual; by default, all."""
    rename: Mapping[str, str] = Field(default_factory=dict)
    """Landmarks to rename: name in the files -> name in the dictionary or in the
    results.
    """
    keypoints: Text | None = None
    """Skeleton of files without names, such as body_25b; numbered: 0, 1 and so on."""
    min_confidence: Auto[NotNegative] = None
    """Hide less confident landmarks; auto: 0.1 for a fit with a prior, otherwise 0."""
    y_axis: Literal["down", "up"] | None = None
    """Direction of y in the images; by default that of the format, or down (pixels)."""
    image_size: Pair[Positive] | None = None
    """Width and height of the images in pixels; fractions of it (MediaPipe, YOLO) need
    it.
    """


class MetresConfig(LandmarksConfig):
    """How outputs in metres (TRC, C3D, BVH, tables) are written."""

    frame_rate: Positive | None = None
    """Frames per second of the files, before `every`; by default, as they state it."""
    height: Annotated[float, Field(gt=0, le=3)] | None = None
    """Height of the body or object, for outputs in metres; by default of the training
    shapes.
    """
    markers: Literal["joints", "input"] = "joints"
    """Markers of a TRC file: joints, or input for the landmarks of the detector by
    their names.
    """


class TruthConfig(CommandConfig):
    """How results are compared with the truth."""

    match: Text = "item"
    """What identifies the true shape of an image: `item`; `frame` (and sequence); or a
    dataset that holds items of the truth.
    """
    rename: Mapping[str, str] = Field(default_factory=dict)
    """Landmarks of the truth to rename: name in its files -> name in the results."""

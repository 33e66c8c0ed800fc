"""The keys by which files of landmarks and of shapes are read, the same in every command."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Literal

from pydantic import Field

from shapefit.config.model import Auto, CommandConfig, FromLists
from shapefit.config.paths import Description

Pixels = Annotated[float, Field(gt=0)]


class ReadingConfig(CommandConfig):
    """How files of any kind are read."""

    format: str = Field(default="auto", min_length=1)
    """Format of the files (docs/formats.md); auto recognises it by their content."""
    individual: str | None = Field(default=None, min_length=1)
    """Read only this individual; by default, all."""


class RenamingConfig(ReadingConfig):
    """How files are read whose landmarks are matched by name."""

    rename: Mapping[str, str] = Field(default_factory=dict)
    """Landmarks to rename: name in the files that are read -> name in the dictionary or the
    results."""


class LandmarksConfig(RenamingConfig):
    """How files of 2D landmarks are read."""

    keypoints: str | None = Field(default=None, min_length=1)
    """Skeleton that names the landmarks of files without names, such as body_25b or coco_17
    (docs/formats.md); numbered: 0, 1 and so on."""
    min_confidence: Auto[Annotated[float, Field(ge=0)]] = None
    """Hide landmarks whose confidence is below this; auto: 0.1 for a fit with a prior, otherwise
    0."""
    y_axis: Literal["down", "up"] | None = None
    """Direction of y in the images; by default that of the format, and down (pixels) where it has
    none."""
    image_size: Annotated[
        tuple[Pixels, Pixels] | None, Description("a list of two numbers > 0"), FromLists
    ] = None
    """Width and height of the images in pixels; by default as the files state it. The camera needs
    it, and so do coordinates that are fractions of it (MediaPipe, YOLO)."""

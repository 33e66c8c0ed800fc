"""The section `input`: how files of landmarks and of shapes are read, the same in every command."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from shapefit.config.model import ConfigModel, FromLists, Renaming
from shapefit.config.paths import Expected

_SIZE = "a list of two numbers > 0"

Pixels = Annotated[float, Field(gt=0)]


class FilesInput(ConfigModel):
    """How files of any kind are read."""

    format: str = Field(default="auto", min_length=1)
    """Format of the files (docs/formats.md); auto: by their content."""
    individual: str | None = Field(default=None, min_length=1)
    """Read only this individual; by default, all."""


class ShapesInput(FilesInput):
    """How files of 3D shapes are read. `--set rename=...` is short for `--set input.rename=...`."""

    rename: Renaming = Field(default_factory=dict)
    """Landmarks to rename: name in the files that are read -> name in the dictionary or the
    results."""
    landmarks: Annotated[tuple[str, ...] | None, FromLists] = Field(default=None, min_length=1)
    """Landmarks to keep, in this order, by their names after `rename`; by default, all."""


class DetectionsInput(FilesInput):
    """How files of a detector are understood."""

    keypoints: str | None = Field(default=None, min_length=1)
    """Skeleton that names the landmarks of files without names, such as body_25b or coco_17
    (docs/formats.md); numbered: 0, 1 and so on."""
    track: Literal["nearest", "none"] | None = None
    """Detections without identity: nearest joins them over frames, none makes each an item of its
    own. By default nearest where sequences are asked for."""
    image_size: Annotated[tuple[Pixels, Pixels] | None, Expected(_SIZE), FromLists] = None
    """Width and height of the images in pixels. Coordinates that are fractions of them (MediaPipe,
    YOLO) are multiplied by it, and `fit` assumes a camera by it; by default as the files state it,
    or the smallest usual size that holds all landmarks."""
    y_axis: Literal["down", "up"] | None = None
    """Where y points in landmarks. By default as the format has it, and down, as pixels are
    counted, where it does not say so (CSV); files of ours that state the opposite are refused."""


class InputConfig(DetectionsInput, ShapesInput):
    """How files are read. `--set keypoints=NAME` is short for `--set input.keypoints=NAME`."""

    likelihood_below: float = Field(default=0, ge=0)
    """Hide landmarks whose confidence is below this."""

"""The config of `view`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

from pydantic import Field

from shapefit.config.model import CommandConfig, FromLists
from shapefit.config.paths import (
    NamedFiles,
    OptionalDictionaryPath,
    OptionalInputPaths,
    OptionalPath,
    PathField,
    absolute_path,
    unless_none,
)


class ViewConfig(CommandConfig):
    """Write one HTML page that shows results, to rotate and play."""

    COMMAND = "view"

    files: NamedFiles
    """Results, shapes or landmarks to show, each with its name on the page; files in a list are
    named after the file, without folder and suffix."""
    truth: OptionalInputPaths = ()
    """Files of the true 3D shapes, aligned with the first result by the best similarity."""
    match: str = Field(default="item", min_length=1)
    """What identifies the true shape of an image: `item`; `frame`, its frame and sequence; or the
    name of a dataset of the result that holds items of the truth."""
    rename: Mapping[str, str] = Field(default_factory=dict)
    """Landmarks of the truth to rename: name in its files -> name in the results."""
    keypoints: str | None = Field(default=None, min_length=1)
    """Skeleton that names the landmarks of files without names, such as body_25b."""
    dictionary: OptionalDictionaryPath = None
    """Dictionary with the edges and meshes to draw; by default, the one with which the result was
    fitted, if it still exists."""
    images: Annotated[
        Path | None,
        PathField("a folder, or a path with {item} in it"),
        unless_none(absolute_path),
    ] = None
    """Images that the landmarks were found in, PNG or JPEG: a folder, whose files are named after
    the items or are the numbered frames of a video, or a path in which `{item}` stands for the
    item. They are made smaller and embedded."""
    items: Annotated[tuple[str, ...], FromLists] = ("*",)
    """Items to show: names or globs."""
    frame_rate: float | None = Field(default=None, gt=0)
    """Frames per second; by default, as stated in the files."""
    output: OptionalPath = None
    """HTML file to write; by default NAME.html in the working directory, after the first file."""

"""The config of `view`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from pydantic import BeforeValidator, Field

from shapefit.config.model import CommandConfig, FromLists, Renaming
from shapefit.config.named_files import NamedFiles
from shapefit.config.paths import (
    OptionalInputPath,
    OptionalInputPaths,
    OptionalPath,
    PathWords,
    absolute_path,
)


class ViewConfig(CommandConfig):
    """Write one HTML page that shows results, turns them, and plays them."""

    files: NamedFiles = Field(
        description="Results, shapes or landmarks to show (HDF5 or CSV), each under the name it "
        "will have on the page; in a list, a file is called by its name without folder and ending."
    )
    truth: OptionalInputPaths = Field(
        default=(),
        description="Files of the true 3D shapes, laid onto the first result by the best "
        "similarity.",
    )
    match: str = Field(
        default="item",
        min_length=1,
        description="What tells the true shape of an image: `item`, or the name of a dataset of "
        "the result that holds items of the truth.",
    )
    rename: Renaming = Field(
        default_factory=dict,
        description="Landmarks that the truth calls otherwise: name in the truth -> name in the "
        "files to show.",
    )
    dictionary: OptionalInputPath = Field(
        default=None,
        description="Dictionary with the edges and meshes to draw; left out, the one that the "
        "result was fitted with, as long as it is where it was.",
    )
    images: Annotated[
        Path | None,
        PathWords("a folder, or a path with {item} in it"),
        BeforeValidator(lambda value: None if value is None else absolute_path(value)),
    ] = Field(
        default=None,
        description="Images that the landmarks were found in, PNG or JPEG: a folder, whose files "
        "are called by the items, or a path in which `{item}` stands for the item.",
    )
    items: Annotated[tuple[str, ...], FromLists] = Field(
        default=("*",), description="Items to show: names or globs."
    )
    frame_rate: float | None = Field(
        default=None,
        gt=0,
        description="Frames a second; left out, what the files say.",
    )
    megabytes: float = Field(
        default=20,
        ge=1,
        le=500,
        description="Largest page; of more frames than fit, every n-th is shown.",
    )
    output: OptionalPath = Field(
        default=None,
        description="HTML file to write; left out, one in the working directory named after the "
        "first file.",
    )

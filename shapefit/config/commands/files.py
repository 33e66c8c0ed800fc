"""The configs of the commands that only read or write files: `convert`, `info`."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from shapefit.config.commands.input import LandmarksConfig
from shapefit.config.model import CommandConfig, Height
from shapefit.config.paths import InputPaths, NamedInputPaths, OptionalDictionaryPath, OutputPath


class ConvertConfig(LandmarksConfig):
    """Write what files hold in another format."""

    COMMAND = "convert"

    files: InputPaths
    """Files of landmarks, shapes or results, all of one kind, in any format that can be read, or
    folders with one file per frame."""
    output: OutputPath
    """File to write, or the folder of meshes; - is stdout (CSV)."""
    dictionary: OptionalDictionaryPath = None
    """Dictionary that a result was fitted with, for meshes: its meshes or edges are written."""
    to: str = Field(default="auto", min_length=1)
    """Format to write (docs/export.md); auto: as the name of the output says, HDF5 without an
    ending. obj, ply and glb write a mesh of each image of a result into the folder `output`."""
    every: int = Field(default=1, ge=1)
    """Take every n-th item of each sequence, the first one first; of all items where there are no
    sequences."""
    frame_rate: float | None = Field(default=None, gt=0)
    """Frames per second of the sequences, before `every`; by default, as stated in the files."""
    height: Height = None
    """Height of the body or object in metres, for outputs in metres (docs/export.md); by default
    results are as large as the training shapes of their dictionary."""
    unit: str | None = Field(default=None, min_length=1)
    """Unit of shapes whose files do not say it (m, cm, mm, ...), for outputs in metres."""
    up: Literal["x", "y", "z", "-x", "-y", "-z"] | None = None
    """Axis that points up, of the shapes or of the world of the camera, for outputs in metres: it
    becomes y. By default shapes keep their axes, and the world's is the one nearest to up in the
    image."""
    markers: Literal["joints", "input"] = "joints"
    """Markers of a TRC file: joints, or input for the landmarks of the detector by their names."""


class InfoConfig(CommandConfig):
    """Tell what files hold, and how to go on with them."""

    COMMAND = "info"

    files: NamedInputPaths = ()
    """Files of any kind and format, folders with one file per frame, and installed dictionaries by
    name; without any, what is installed is listed."""
    format: str = Field(default="auto", min_length=1)
    """Format of the files (docs/formats.md); auto recognises it by their content."""
    keypoints: str | None = Field(default=None, min_length=1)
    """Skeleton that names the landmarks of files without names, such as body_25b."""

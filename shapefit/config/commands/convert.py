"""The config of `convert`."""

from __future__ import annotations

from pydantic import Field

from shapefit.config.commands.input import InputConfig
from shapefit.config.model import CommandConfig
from shapefit.config.paths import InputPaths, OutputPath


class ConvertConfig(CommandConfig):
    """Write what files hold in another format."""

    files: InputPaths = Field(
        description="Files of landmarks, shapes or results, all of one kind, in any format that "
        "can be read; what is one recording may be a folder."
    )
    input: InputConfig = Field(
        default_factory=InputConfig.model_construct, description="How the files are read."
    )
    output: OutputPath = Field(description="File to write; - is stdout (CSV).")
    to: str = Field(
        default="auto",
        min_length=1,
        description="Format to write (docs/formats.md); auto: as the name of the output says, "
        "else HDF5.",
    )
    frame_rate: float | None = Field(
        default=None,
        gt=0,
        description="Frames per second of the sequences; by default, as stated in the files.",
    )
    chunk: int = Field(
        default=4096, ge=1, le=10_000_000, description="Items held in memory at a time."
    )

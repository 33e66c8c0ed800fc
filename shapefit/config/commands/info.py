"""The config of `info`."""

from __future__ import annotations

from pydantic import Field

from shapefit.config.commands.input import InputConfig
from shapefit.config.dictionaries import NamedInputPaths
from shapefit.config.model import CommandConfig


class InfoConfig(CommandConfig):
    """Tell what files hold, and how to go on with them.

    What is wrong with one file does not keep the others from being described.
    """

    files: NamedInputPaths = Field(
        description="Files of any kind and format; folders of frames, too, and installed "
        "dictionaries by name, such as people."
    )
    input: InputConfig = Field(
        default_factory=InputConfig.model_construct, description="How the files are read."
    )

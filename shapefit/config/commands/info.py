"""The config of `info`."""

from __future__ import annotations

from shapefit.config.commands.input import InputConfig
from shapefit.config.dictionaries import NamedInputPaths
from shapefit.config.model import CommandConfig, section


class InfoConfig(CommandConfig):
    """Tell what files hold, and how to go on with them."""

    files: NamedInputPaths
    """Files of any kind and format, folders with one file per frame, and installed dictionaries by
    name, such as people."""
    input: InputConfig = section(InputConfig)

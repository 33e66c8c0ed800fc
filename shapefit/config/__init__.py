"""Schema and loader of the YAML configs; a command's schema is imported when used."""

from typing import TYPE_CHECKING

from shapefit.config.commands import CONFIGS
from shapefit.config.loader import dump_config, load_config
from shapefit.config.model import CommandConfig

if TYPE_CHECKING:
    from shapefit.config.commands.fit import FitConfig
    from shapefit.config.commands.others import (
        ConvertConfig,
        EvalConfig,
        InfoConfig,
        LearnDictConfig,
        ProjectConfig,
        ViewConfig,
    )

__all__ = [
    "CONFIGS",
    "CommandConfig",
    "ConvertConfig",
    "EvalConfig",
    "FitConfig",
    "InfoConfig",
    "LearnDictConfig",
    "ProjectConfig",
    "ViewConfig",
    "dump_config",
    "load_config",
]


def __getattr__(name: str) -> type[CommandConfig]:
    """Return the config of a command by its class's name, such as LearnDictConfig."""
    for command in CONFIGS:
        if name == f"{command.title().replace('-', '')}Config":
            return CONFIGS[command]
    raise AttributeError(name)

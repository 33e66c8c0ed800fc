"""Schema and loader of the YAML configs; the schema of a command is imported when it is used."""

from typing import TYPE_CHECKING, Any

from shapefit.config.commands import CONFIGS, NAMES
from shapefit.config.loader import dump_config, load_config
from shapefit.config.model import CommandConfig

if TYPE_CHECKING:
    from shapefit.config.commands.evaluate import EvalConfig
    from shapefit.config.commands.files import ConvertConfig, InfoConfig, ProjectConfig, ViewConfig
    from shapefit.config.commands.fit import FitConfig
    from shapefit.config.commands.learn_dict import LearnDictConfig

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


def __getattr__(name: str) -> Any:
    """Return the config of a command, by the name of its class."""
    for command, config in NAMES.items():
        if config == name:
            return CONFIGS[command]
    raise AttributeError(name)

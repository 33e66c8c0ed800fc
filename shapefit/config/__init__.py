"""Schema and loader of the YAML configs; the schema of a command is imported when it is used."""

from typing import TYPE_CHECKING, Any

from shapefit.config.loader import CONFIGS, dump_config, find_config, load_config
from shapefit.config.model import CommandConfig

if TYPE_CHECKING:
    from shapefit.config.commands.evaluate import EvalConfig
    from shapefit.config.commands.files import ConvertConfig, InfoConfig
    from shapefit.config.commands.fit import FitConfig
    from shapefit.config.commands.learn_dict import LearnDictConfig
    from shapefit.config.commands.project import ProjectConfig
    from shapefit.config.commands.view import ViewConfig

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
    "find_config",
    "load_config",
]


def __getattr__(name: str) -> Any:
    """Return the config of a command."""
    for command, schema in CONFIGS.places.items():
        if schema.rpartition(".")[2] == name:
            return CONFIGS[command]
    raise AttributeError(name)

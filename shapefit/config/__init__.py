"""Schema and loader of the YAML configs; the schema of a command is imported when it is used."""

from typing import TYPE_CHECKING, Any

from shapefit.config.commands import COMMANDS, CONFIGS
from shapefit.config.loader import dump_config, load_config
from shapefit.config.model import CommandConfig

if TYPE_CHECKING:
    from shapefit.config.commands.fit import FitConfig as FitConfig
    from shapefit.config.commands.learn_dict import LearnDictConfig as LearnDictConfig
    from shapefit.config.commands.others import ConvertConfig as ConvertConfig
    from shapefit.config.commands.others import EvalConfig as EvalConfig
    from shapefit.config.commands.others import InfoConfig as InfoConfig
    from shapefit.config.commands.others import ProjectConfig as ProjectConfig
    from shapefit.config.commands.others import ViewConfig as ViewConfig

__all__ = ["CONFIGS", "CommandConfig", "dump_config", "load_config"]


def __getattr__(name: str) -> Any:
    """Return the config of a command by the name of its class, such as LearnDictConfig."""
    for command in COMMANDS:
        if name == f"{command.title().replace('-', '')}Config":
            return CONFIGS[command]
    raise AttributeError(name)

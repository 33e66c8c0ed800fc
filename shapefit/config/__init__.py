"""Schema and loader of the YAML configs; the schema of a command is imported when it is used."""

from typing import TYPE_CHECKING, Any

from shapefit.config.loader import CONFIGS, dump_config, load_config
from shapefit.config.model import CommandConfig

if TYPE_CHECKING:
    from shapefit.config.evaluate import EvalConfig
    from shapefit.config.fit import FitConfig
    from shapefit.config.learn_dict import LearnDictConfig
    from shapefit.config.project import ProjectConfig
    from shapefit.config.simulate import SimulateConfig
    from shapefit.config.sweep import SweepConfig

__all__ = [
    "CONFIGS",
    "CommandConfig",
    "EvalConfig",
    "FitConfig",
    "LearnDictConfig",
    "ProjectConfig",
    "SimulateConfig",
    "SweepConfig",
    "dump_config",
    "load_config",
]


def __getattr__(name: str) -> Any:
    """Return the config of a command."""
    for command, schema in CONFIGS.places.items():
        if schema.rpartition(".")[2] == name:
            return CONFIGS[command]
    raise AttributeError(name)

"""Schema and loader of the YAML configs."""

from shapefit.config.evaluate import EvalConfig
from shapefit.config.fit import FitConfig
from shapefit.config.learn_dict import LearnDictConfig
from shapefit.config.loader import CONFIGS, dump_config, load_config
from shapefit.config.model import CommandConfig
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

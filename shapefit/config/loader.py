"""From a YAML file, `--set` options and arguments to a checked config, and back to YAML."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from pathlib import Path

from pydantic import ValidationError
from ruamel.yaml import YAML

from shapefit.config.evaluate import EvalConfig
from shapefit.config.expectation import field_keys
from shapefit.config.fit import FitConfig
from shapefit.config.learn_dict import LearnDictConfig
from shapefit.config.model import CommandConfig
from shapefit.config.paths import PathWords
from shapefit.config.problems import schema_problems
from shapefit.config.project import ProjectConfig
from shapefit.config.settings import Settings
from shapefit.config.simulate import SimulateConfig
from shapefit.errors import InputError

CONFIGS: Mapping[str, type[CommandConfig]] = {
    "learn-dict": LearnDictConfig,
    "fit": FitConfig,
    "eval": EvalConfig,
    "project": ProjectConfig,
    "simulate": SimulateConfig,
}


def load_config(
    command: str,
    path: Path | None = None,
    overrides: Sequence[str] = (),
    arguments: Mapping[str, object] | None = None,
) -> CommandConfig:
    """Return the checked config of `command`.

    `overrides` (each `a.b=value`) go over what the YAML file at `path` says, and `arguments`
    (key -> value; None and empty ones do not count) over both. Paths in the file are relative to
    the file, the others to the working directory; in the config they are absolute and globs are
    expanded. Raises InputError with every problem at once, each with its place.
    """
    model = CONFIGS[command]
    settings = Settings(_path_keys(model))
    if path is not None:
        settings.read_file(path)
    for option in overrides:
        settings.set_option(option)
    for key, value in (arguments or {}).items():
        if value is not None and value != ():
            settings.set_argument(key, value)
    problems = settings.problems
    try:
        config = model.model_validate(settings.with_data(), by_alias=True, by_name=False)
    except ValidationError as error:
        problems = problems + schema_problems(model, error, settings)
    if problems:
        raise InputError(problems)
    return config


def _path_keys(model: type[CommandConfig]) -> set[str]:
    return {
        key
        for key, field in field_keys(model).items()
        if any(isinstance(entry, PathWords) for entry in field.metadata)
    }


def dump_config(config: CommandConfig) -> str:
    """Return the config as YAML, every default spelled out; it loads again to the same config."""
    text = io.StringIO()
    YAML().dump(config.model_dump(mode="json"), text)
    return text.getvalue()

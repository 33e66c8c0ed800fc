"""Settings checked against the schema of a config, and the config that they make."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TypeVar

from pydantic import BaseModel, ValidationError

from shapefit.config.expectation import field_keys, submodel
from shapefit.config.model import ConfigModel
from shapefit.config.paths import PathKeys, PathWords
from shapefit.config.problems import schema_problems
from shapefit.config.settings import Settings
from shapefit.errors import InputError

Config = TypeVar("Config", bound=ConfigModel)


def load_model(
    model: type[Config],
    path: Path | None = None,
    overrides: Sequence[str] = (),
    arguments: Mapping[str, object] | None = None,
) -> Config:
    """Return the checked config of a YAML file, with overrides and arguments over it.

    `overrides` (each `a.b=value`) go over what the YAML file at `path` says, and `arguments`
    (key -> value; None and empty ones do not count) over both. Raises InputError with every
    problem at once, each with its place.
    """
    settings = Settings(path_keys(model))
    if path is not None:
        settings.read_file(path)
    for option in overrides:
        settings.set_option(option)
    for key, value in (arguments or {}).items():
        if value is not None and value != ():
            settings.set_argument(key, value)
    return check(model, settings)


def check(model: type[Config], settings: Settings) -> Config:
    """Return the config that the settings make; raises InputError with every problem at once."""
    problems = settings.problems
    if not settings.readable:  # what the schema misses may well be there
        raise InputError(problems)
    try:
        config = model.model_validate(settings.with_data(), by_alias=True, by_name=False)
    except ValidationError as error:
        problems = problems + schema_problems(model, error, settings)
    if problems:
        raise InputError(problems)
    return config


def path_keys(model: type[BaseModel]) -> PathKeys:
    """Return the keys of a model that hold paths, and within them those of its sections."""
    keys: dict[str, PathKeys] = {}
    for key, field in field_keys(model).items():
        inner = submodel(field)
        within = path_keys(inner) if inner is not None else {}
        if within or any(isinstance(entry, PathWords) for entry in field.metadata):
            keys[key] = within
    return keys

"""Keyword arguments checked against the config of a command: the same keys, defaults and errors."""

from __future__ import annotations

from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from pydantic import BaseModel

from shapefit.config import find_config
from shapefit.config.model import CommandConfig, field_keys, submodel
from shapefit.config.settings import OPTION, Place, Settings, check
from shapefit.errors import input_error

Config = TypeVar("Config", bound=CommandConfig)


def default(model: type[CommandConfig], name: str) -> Any:
    """Return the default of a key of a command."""
    return model.model_fields[name].get_default(call_default_factory=True)


def config_of(
    model: type[Config],
    function: str,
    given: Mapping[str, Any],
    options: Mapping[str, Any],
    files: Mapping[str, Any],
    config: str | PathLike[str] | None = None,
    *,
    final: bool = True,
) -> Config:
    """Return the config that the arguments of a function make, over those of a config file.

    `given` are those of its signature, `options` further keys of the command. `files` (key ->
    value) are the keys whose place arrays take; in the config they hold these values, for messages.
    Raises InputError for what the config refuses, each problem with the name of its argument.
    """
    closed = {*files, "data", "export", "pictures"} & model.model_fields.keys()
    for key in options.keys() & closed:
        found = f"there is no argument `{key}`"
        fix = f"it is for files: use the command line, or the functions of shapefit for `{key}`"
        raise input_error(f"{function}.{key}", found, fix)
    settings = Settings(model, function)
    if config is not None:
        file = find_config(function, Path(config))
        assert file is not None
        settings.read_file(file.path, is_preset=True)
    _give(settings, model, function, dict.fromkeys(files, "-") | plain({**given, **options}))
    return check(model, settings, final=final).model_copy(update=dict(files))


def _give(
    settings: Settings,
    model: type[BaseModel],
    place: str,
    values: Mapping[str, Any],
    above: tuple[str, ...] = (),
) -> None:
    """Set the values of a mapping, those of sections key by key."""
    for key, value in values.items():
        field, named = field_keys(model).get(key), f"{place}.{key}"
        section = None if field is None else submodel(field)
        if section is not None and isinstance(value, dict):
            _give(settings, section, named, value, (*above, key))
        else:
            settings.set((*above, key), value, {(): Place(named, named, OPTION)})


def plain(value: Any) -> Any:
    """Return a value as YAML would have it: no numbers or arrays of NumPy, no tuples, no paths."""
    if isinstance(value, Mapping):
        return {str(key): plain(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    return str(value) if isinstance(value, Path) else value

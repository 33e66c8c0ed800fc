"""Keyword arguments checked against the config of a command: the same keys, defaults and errors."""

from __future__ import annotations

from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from shapefit.config import find_config
from shapefit.config.model import CommandConfig, marked_keys
from shapefit.config.paths import OfTheData, PathWords
from shapefit.config.settings import Settings, check
from shapefit.errors import InputError, input_error

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
    settings = Settings({})
    stream = dict.fromkeys(files, "-")
    known = {} if config is None else file_values(model, function, Path(config))
    said = stream | plain({**given, **options})
    settings.take_section(function, merged(known, said))
    settings.chosen = frozenset(known.keys() - said.keys())
    return check(model, settings, final=final).model_copy(update=dict(files))


def file_values(model: type[CommandConfig], command: str, config: Path) -> dict[str, Any]:
    """Return the settings of a YAML file or an installed config, without what is for its data."""
    file = find_config(command, config)
    assert file is not None
    settings = Settings(marked_keys(model, PathWords))
    settings.read_file(file.path)
    if settings.problems:
        raise InputError(settings.problems)
    settings.drop(marked_keys(model, PathWords, OfTheData))
    return settings.values


def merged(below: Mapping[str, Any], above: Mapping[str, Any]) -> dict[str, Any]:
    """Return the values of both, those of a section key by key; what is above wins."""
    both = {key: (below[key], above[key]) for key in below.keys() & above.keys()}
    sections = {
        key: merged(low, high)
        for key, (low, high) in both.items()
        if isinstance(low, dict) and isinstance(high, dict)
    }
    return {**below, **above, **sections}


def plain(value: Any) -> Any:
    """Return a value as YAML would have it: no numbers or arrays of NumPy, no tuples, no paths."""
    if isinstance(value, Mapping):
        return {str(key): plain(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    return str(value) if isinstance(value, Path) else value

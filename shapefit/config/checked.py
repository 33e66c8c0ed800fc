"""Settings checked against the schema of a config, and the config that they make."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TypeVar

from pydantic import BaseModel, ValidationError

from shapefit.config.expectation import field_keys, submodel
from shapefit.config.model import ConfigModel
from shapefit.config.paths import OfTheData, PathKeys, PathWords
from shapefit.config.places import Location
from shapefit.config.presets import ConfigFile
from shapefit.config.problems import schema_problems
from shapefit.config.settings import Settings
from shapefit.errors import InputError
from shapefit.stores.options import STORAGE_OPTIONS, use_storage_options

SHORT = ("input", ("keypoints", "individual", "track", "likelihood_below", "rename"))
"""A section, and its keys that may be given beside it, in short."""

Config = TypeVar("Config", bound=ConfigModel)


def load_model(
    model: type[Config],
    file: ConfigFile | None = None,
    overrides: Sequence[str] = (),
    arguments: Mapping[str, object] | None = None,
) -> Config:
    """Return the checked config of a YAML file, with overrides and arguments over it.

    `overrides` (each `a.b=value`) override what the YAML file says, and `arguments` (key -> value;
    None and empty ones do not count) both. Raises InputError with every problem at once, each with
    its place.
    """
    settings = Settings(path_keys(model))
    if file is not None:
        settings.read_file(file.path)
        if file.is_preset:
            settings.drop(data_keys(model))
    for option in overrides:
        settings.set_option(option)
    for key, value in (arguments or {}).items():
        if value is not None and value != ():
            settings.set_argument(key, value)
    if file is not None and file.is_preset:
        settings.drop_idle()
    return check(model, settings)


def check(model: type[Config], settings: Settings) -> Config:
    """Return the config that the settings make; raises InputError with every problem at once."""
    problems = settings.problems
    for at in _short_places(model):
        settings.fold(at, *SHORT)
    options = settings.values.get(STORAGE_OPTIONS)
    if isinstance(options, dict):  # what paths name is looked up while they are checked
        use_storage_options(options)
    if not settings.readable:  # what the schema misses may well be there
        raise InputError(problems)
    try:
        config = model.model_validate(settings.with_data(), by_alias=True, by_name=False)
    except ValidationError as error:
        problems = problems + schema_problems(model, error, settings)
    if problems:
        raise InputError(problems)
    return config


def _short_places(model: type[BaseModel]) -> Iterator[Location]:
    """Yield where, in a config of this model, keys may stand that are short for a section's."""
    fields = field_keys(model)
    if SHORT[0] in fields:
        yield ()
    for key, field in fields.items():
        inner = submodel(field)
        if inner is not None and SHORT[0] in field_keys(inner):
            yield (key,)


def path_keys(model: type[BaseModel]) -> PathKeys:
    """Return the keys of a model that hold paths, and within them those of its sections."""
    return _keys_marked(model, (PathWords,))


def data_keys(model: type[BaseModel]) -> PathKeys:
    """Return the keys of a model that fit certain data only, paths among them."""
    return _keys_marked(model, (PathWords, OfTheData))


def _keys_marked(model: type[BaseModel], marks: tuple[type, ...]) -> PathKeys:
    keys: dict[str, PathKeys] = {}
    for key, field in field_keys(model).items():
        inner = submodel(field)
        marked = any(isinstance(entry, marks) for entry in field.metadata)
        within = _keys_marked(inner, marks) if inner is not None else {}
        if within or marked:
            keys[key] = within
    return keys

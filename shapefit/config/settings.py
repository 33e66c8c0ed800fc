"""From a config file, `--set` options and arguments to a checked config, or every problem at once.

`Settings` is their one tree of values, each with its place; `check` holds it against the schema.
"""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails

from shapefit.config.effects import idle_keys
from shapefit.config.model import (
    ConfigModel,
    Location,
    Place,
    dotted_keys,
    expectation,
    field_keys,
    meaning,
    submodel,
)
from shapefit.config.paths import (
    STANDARD_STREAM,
    PathKeys,
    anchored,
    change_paths,
    with_data,
)
from shapefit.errors import InputError, input_error
from shapefit.stores import MASK, STORAGE_OPTIONS, is_url, use_storage_options

COMMAND_LINE, STANDARD_INPUT = "command line", "standard input"

MOST_BYTES = 1 << 20
"""Of a config: beyond that it is something else."""

SECTION = "input"

SHORT = (
    "keypoints",
    "individual",
    "track",
    "likelihood_below",
    "rename",
    "image_size",
    "y_axis",
    "landmarks",
)
"""Keys of the section that may be given beside it, in short."""

PRESET, FILE, OPTION = range(3)
"""Who set a value: an installed config, a file, the command line."""

_CONSTANT = "it is a constant of the method now; leave it out"
_OF_LANDMARKS = ("keypoints", "track", "likelihood_below", "image_size", "y_axis")
_NOT_SHAPES = "it counts for landmarks only; leave it out, or `convert` the shapes with it"

GONE: Mapping[str, Mapping[str, str]] = {
    "fit": {
        "posterior.views": "it starts from the poses of the convex program alone; leave it out",
        "posterior.max_rounds": _CONSTANT,
        "posterior.gross_density": _CONSTANT,
        "posterior.csv_deviations": "CSV has sd_x, sd_y, sd_z where the method knows them",
        "camera.ridge": _CONSTANT,
        "camera.softness": _CONSTANT,
        "camera.image_size": "write `image_size` beside `camera`",
        "outliers.draws": _CONSTANT,
        "outliers.seed": _CONSTANT,
        "part_format": "parts are HDF5; `convert` writes them as Parquet",
        "pictures.format": "pictures are PNG; leave it out",
        "export.landmarks": "`convert` writes landmarks as GLB; leave it out",
        "export.wireframe": "edges are written as tubes; leave it out",
        "outliers.lambda": "truncated least squares went; take `outliers: {method: ransac}`",
    },
    "learn-dict": {
        "batch": "all shapes are in memory; take fewer with `every`",
        "prior.max_rounds": _CONSTANT,
        "start_weight": "`start` counts as many images as there are; leave it out",
        "prior.folds": "`prior.components` states their number",
    },
    "convert": {"chunk": _CONSTANT},
    "info": {
        f"input.{key}": "it changes nothing that `info` tells; leave it out"
        for key in ("rename", "landmarks", "likelihood_below")
    },
    "view": {"megabytes": "a page has 20 MB at most; `items` chooses what it shows"},
    "project": {f"input.{key}": _NOT_SHAPES for key in _OF_LANDMARKS},
    "eval": {
        **{f"input.{key}": _NOT_SHAPES for key in _OF_LANDMARKS},
        "calibration": "error bars are judged wherever results have them; leave it out",
        "floors": "`python -m benchmarks.oracles` measures them",
        "examples": "`view` shows the best and the worst images, sorted by error",
    },
}
"""Keys of the release before, by command -> what replaces them; for one release."""

Config = TypeVar("Config", bound=ConfigModel)


@dataclass
class Settings:
    """Values for a config before they are checked; `problems` is what is wrong already.

    `path_keys` are the keys that hold paths. Where a file is not `readable`, the keys that it
    gives are unknown; `refused` are the keys of --set options whose value cannot be read. What an
    installed config says, all or the `chosen` keys, may be without effect.
    """

    path_keys: PathKeys
    values: dict[str, Any] = field(default_factory=dict)
    problems: list[str] = field(default_factory=list)
    readable: bool = True
    refused: set[Location] = field(default_factory=set)
    is_preset: bool = False
    chosen: frozenset[str] = frozenset()
    _places: dict[Location, Place] = field(
        default_factory=lambda: {(): Place(COMMAND_LINE, COMMAND_LINE)}
    )

    def take_section(self, name: str, values: dict[str, Any]) -> None:
        """Take the values of a section; the place of each is its path, such as `fit.lambda`."""
        self.values = values
        self._places[()] = Place(name, name)
        self._place_section(values, (), name)

    def _place_section(self, values: dict[str, Any], location: Location, name: str) -> None:
        for key, value in values.items():
            inner, path = (*location, key), f"{name}.{key}"
            self._places[inner] = Place(path, path)
            if isinstance(value, dict):
                self._place_section(value, inner, path)

    def read_file(self, path: Path) -> None:
        """Take the values of a YAML file, or of standard input for `-`.

        Its paths are relative to its folder, those of standard input to the working folder.
        """
        from shapefit.config.yaml12 import read_yaml

        name = STANDARD_INPUT if path == STANDARD_STREAM else str(path)
        document = read_yaml(_text(path), lambda line, column: f"{name}:{line}:{column}")
        self.problems += document.problems
        self.readable = document.readable
        self._places |= document.places
        if document.value is None:
            self._places[()] = Place(f"{name}:1:1", f"{name}:1:1")
        elif isinstance(document.value, dict):
            self.values = document.value
        else:
            self.problems.append(
                f"{self.place(())}: expected keys with values (key: value), "
                f"found {found(document.value)}"
            )
        folder = Path.cwd() / path.parent
        self.values = change_paths(self.values, self.path_keys, partial(anchored, folder=folder))

    def drop(self, keys: PathKeys) -> None:
        """Leave out the values of these keys, and sections that have no others."""
        self.values = without(self.values, keys)

    def drop_idle(self) -> None:
        """Leave out what a file says of outputs in a folder that nothing names."""
        for name, within in self.path_keys.items():
            section = self.values.get(name)
            if "folder" in within and isinstance(section, dict) and not section.get("folder"):
                said = {key for key in section if self.place((name, key)).startswith("--set ")}
                self.values[name] = {key: section[key] for key in section if key in said}

    def set_option(self, option: str) -> None:
        """Take `a.b=value`, the argument of a --set option; the value is YAML, or a bare `-`."""
        place = f"--set {option}"
        path, equals, text = option.partition("=")
        keys = path.strip().split(".")
        if STORAGE_OPTIONS in keys:
            place = f"--set {path}={MASK}"
        if not equals or not all(keys):
            self.problems.append(f"{place}: expected key=value or key.key=value")
            return
        from shapefit.config.yaml12 import read_yaml

        text = "'-'" if text.strip() == "-" else text  # in YAML a list with nothing in it
        document = read_yaml(text, lambda _line, _column: place)
        self.problems += document.problems
        if document.problems:
            self.refused.add(tuple(keys))
        else:
            self._set(tuple(keys), document.value, place)

    def set_argument(self, key: str, value: Any) -> None:
        """Take a value that an argument of the command line gives."""
        self._set((key,), value, f"{COMMAND_LINE}, {key}")

    def _set(self, keys: tuple[str, ...], value: Any, place: str) -> None:
        *parents, last = keys
        mapping = self.values
        for depth, key in enumerate(parents, start=1):
            if key not in mapping:
                mapping[key] = {}
                self._places[keys[:depth]] = Place(place, place)
            mapping = mapping[key]
            if not isinstance(mapping, dict):
                self.problems.append(
                    f"{place}: {'.'.join(keys[:depth])} is {found(mapping)} and has no keys"
                )
                return
        mapping[last] = value
        for location in [known for known in self._places if known[: len(keys)] == keys]:
            del self._places[location]
        self._places[keys] = Place(place, place)

    def fold(self, at: Location, section: str, keys: Sequence[str]) -> None:
        """Move these keys of the mapping at `at` into a section of it, for which they are short."""
        mapping: Any = self.values
        for key in at:
            mapping = mapping.get(key) if isinstance(mapping, dict) else None
        if not isinstance(mapping, dict) or not isinstance(mapping.get(section, {}), dict):
            return
        for key in [key for key in keys if key in mapping]:
            mapping[section] = {**mapping.get(section, {}), key: mapping.pop(key)}
            self._places.setdefault((*at, section), self._places[(*at, key)])
            short, whole = (*at, key), (*at, section, key)
            for known in [known for known in self._places if known[: len(short)] == short]:
                self._places[whole + known[len(short) :]] = self._places.pop(known)

    def fill_in_data(self) -> None:
        """Fill in `{data}`, where the key `data` holds a path."""
        data = self.values.get("data")
        if isinstance(data, str) and not is_url(data):
            data = str(Path.cwd() / os.path.expanduser(data))
        self.values = change_paths(self.values, self.path_keys, partial(with_data, data=data))

    def level(self, location: Location) -> int:
        """Return how far above others the value at `location`, or within it, was set."""
        within = [known for known in self._places if known[: len(location)] == location]
        return max(map(self._level_of, within), default=PRESET - 1)

    def _level_of(self, location: Location) -> int:
        if self._places[location].key.startswith((COMMAND_LINE, "--set ")):
            return OPTION
        return PRESET if self.is_preset or location[0] in self.chosen else FILE

    def said(self, location: Location) -> bool:
        """Whether the file, an option or an argument gave a value at `location`."""
        return location in self._places

    def place(self, location: Location, *, key: bool = False) -> str:
        """Return where the value at `location` (or its key) was said, or else its surroundings."""
        if location in self._places:
            place = self._places[location]
            return place.key if key else place.value
        return self.place(location[:-1])


def without(values: Mapping[str, Any], keys: PathKeys) -> dict[str, Any]:
    """Return `values` without what stands under the keys, nor sections that are empty then."""
    kept = {}
    for key, value in values.items():
        if key not in keys:
            kept[key] = value
        elif keys[key] and isinstance(value, dict):
            within = without(value, keys[key])
            if within:
                kept[key] = within
    return kept


def found(value: Any) -> str:
    """Return a value as a message names it."""
    match value:
        case None:
            return "nothing"
        case bool():
            return str(value).lower()
        case str():
            return repr(value) if len(value) <= 200 else f"{value[:200]!r}..."
        case Mapping():
            return "a mapping"
        case list() | tuple():
            return "a list"
    return str(value)


def _text(path: Path) -> str:
    stream = path == STANDARD_STREAM
    name = STANDARD_INPUT if stream else path
    if stream and sys.stdin is None:
        raise input_error(name, "is closed", "send a config there, or name a file")
    if path.is_fifo() and path.parent.name != "fd":  # but <(...) of a shell is /dev/fd/63
        raise input_error(name, "is a pipe", "save the config to a file, or send it to -")
    try:
        with nullcontext(sys.stdin.buffer) if stream else path.open("rb") as file:
            data = file.read(MOST_BYTES + 1)
        if len(data) > MOST_BYTES:
            raise input_error(name, f"larger than {MOST_BYTES} bytes", "give a config in YAML")
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise input_error(name, "not UTF-8 text", "save it as UTF-8") from None
    except OSError as error:
        raise input_error(name, error.strerror or "cannot be read", "check the path") from None


def check(model: type[Config], settings: Settings, *, final: bool = True) -> Config:
    """Return the config that the settings make; raises InputError with every problem at once.

    Keys without effect are a problem where the config is `final`.
    """
    problems = settings.problems
    for at, keys in _short_places(model):
        settings.fold(at, SECTION, keys)
    options = settings.values.get(STORAGE_OPTIONS)
    if isinstance(options, dict):  # what paths name is looked up while they are checked
        use_storage_options(options)
    if not settings.readable:  # what the schema misses may well be there
        raise InputError(problems)
    try:
        config = model.model_validate(settings.values, by_alias=True, by_name=False)
    except ValidationError as error:
        problems = problems + _schema_problems(model, error, settings)
    else:
        if final:
            problems = [*problems, *_idle_problems(config, settings)]
    if problems:
        raise InputError(problems)
    return config


def _idle_problems(config: ConfigModel, settings: Settings) -> Iterator[str]:
    """Yield a line for each key that was set and has no effect in this config.

    What an installed config sets is no mistake, nor what a file sets and the command line overrules
    by another choice.
    """
    for keys, effect in idle_keys(type(config).COMMAND, config):
        level = settings.level(keys)
        overruled = any(settings.level(tuple(key.split("."))) > level for key in effect.because)
        if level == PRESET or overruled:
            continue
        for key in _changed_keys(config, keys):
            if settings.said(key):
                name = ".".join(key)
                found = f"`{name}` has no effect here, only {effect.condition}"
                yield f"{settings.place(key, key=True)}: {found}; leave it out"


def _changed_keys(config: BaseModel, location: tuple[str, ...]) -> Iterator[tuple[str, ...]]:
    """Yield the key at `location`, or those of the section there, whose values are no defaults."""
    owner: Any = config
    for key in location[:-1]:
        owner = getattr(owner, key)
    name, field = next(
        (name, field)
        for name, field in type(owner).model_fields.items()
        if location[-1] == (field.alias or name)
    )
    value = getattr(owner, name)
    if isinstance(value, BaseModel):
        for key in field_keys(type(value)):
            yield from _changed_keys(config, (*location, key))
    elif value != field.get_default(call_default_factory=True):
        yield location


def _short_places(model: type[BaseModel]) -> Iterator[tuple[Location, list[str]]]:
    """Yield where keys may stand in short in a config of this model, and which."""
    within = {(key,): submodel(field) for key, field in field_keys(model).items()}
    for at, inner in ((), model), *within.items():
        keys = {} if inner is None else field_keys(inner)
        if SECTION in keys:
            yield at, [key for key in SHORT if key not in keys]


def _schema_problems(
    model: type[BaseModel], error: ValidationError, settings: Settings
) -> list[str]:
    """Return one line for each thing that the schema of `model` rejects in `settings`.

    A key whose value cannot be read is not missing.
    """
    details = [
        detail
        for detail in error.errors()
        if not (detail["type"] == "missing" and detail["loc"] in settings.refused)
    ]
    return list(dict.fromkeys(_problem(model, detail, settings) for detail in details))


def _problem(model: type[BaseModel], detail: ErrorDetails, settings: Settings) -> str:
    location = detail["loc"]
    owner, field = _schema_at(model, location)
    key = str(location[-1]) if location else ""
    match detail["type"]:
        case "extra_forbidden":
            place = settings.place(location, key=True)
            return f"{place}: unknown key {key!r}{_known(model, owner, location)}"
        case "missing" if field and field is field_keys(owner).get(key):
            place = settings.place(location[:-1])
            return f"{place}: missing key {key!r} ({meaning(owner, key)})"
        case "value_error":
            message = str(detail["ctx"]["error"])
            return f"{settings.place(_first_named(message, location, settings))}: {message}"
    choices = re.findall(r"'([^']+)'", detail.get("ctx", {}).get("expected", ""))
    wanted = " or ".join(choices) or (expectation(field) if field else detail["msg"])
    return (
        f"{settings.place(location)}: expected {wanted}, "
        f"found {found(detail['input'])}{_did_you_mean(str(detail['input']), choices)}"
    )


def _first_named(message: str, location: Location, settings: Settings) -> Location:
    """Return where the first of the keys was said that a message names as `key` or `key: value`.

    Of keys that do not go together none is at fault alone; their common `location` is the answer
    where the settings say none of them.
    """
    named = ((*location, word) for word in re.findall(r"`(\w+)", message))
    return next(filter(settings.said, named), location)


def _schema_at(
    model: type[BaseModel], location: Location
) -> tuple[type[BaseModel], FieldInfo | None]:
    """Return the field that `location` is or lies in (None if unknown), and its owner.

    A problem of several keys together lies in none of them: its location is empty.
    """
    if not location:
        return model, None
    owner = model
    for key in location[:-1]:
        field = field_keys(owner)[str(key)]
        inner = submodel(field)
        if inner is None:
            return owner, field
        owner = inner
    return owner, field_keys(owner).get(str(location[-1]))


def _known(model: type[BaseModel], owner: type[BaseModel], location: Location) -> str:
    """Return the end of a message on an unknown key: the nearest key, or all that are known."""
    key = str(location[-1])
    command = getattr(model, "COMMAND", "")
    gone = GONE.get(command, {}).get(".".join(map(str, location)))
    if gone is not None:
        return f"; it is gone: {gone}"
    guess = _did_you_mean(key, field_keys(owner))
    if not guess:
        elsewhere = [known for known in dotted_keys(model) if known.split(".")[-1] == key]
        guess = "".join(f"; did you mean {known!r}?" for known in elsewhere[:1])
    return guess or f"; the keys here are {', '.join(field_keys(owner))}"


def _did_you_mean(text: str, choices: Iterable[str]) -> str:
    from difflib import get_close_matches

    nearest = get_close_matches(text, list(choices), n=1)
    return f"; did you mean {nearest[0]!r}?" if nearest else ""

"""From a config file, `--set` options and arguments to a checked config, or every problem at once.

`Settings` is their one tree of values, each with its place; `check` holds it against the schema.
"""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import nullcontext
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails

from shapefit.config.effects import idle_keys
from shapefit.config.model import (
    ConfigModel,
    all_fields,
    dotted_keys,
    expected,
    field_keys,
    marked_keys,
    meaning,
    submodel,
)
from shapefit.config.paths import (
    STANDARD_STREAM,
    OfTheData,
    PathWords,
    anchored,
    change_texts,
    with_data,
)
from shapefit.errors import InputError, input_error
from shapefit.stores import MASK, STORAGE_OPTIONS, is_url, use_storage_options

COMMAND_LINE, STANDARD_INPUT = "command line", "standard input"

MOST_BYTES = 1 << 20
"""Of a config: beyond that it is something else."""

SHORT: Mapping[str, str] = {
    **dict.fromkeys(["keypoints", "individual", "track", "likelihood_below", "rename"], "input"),
    **dict.fromkeys(["image_size", "y_axis", "landmarks"], "input"),
    "frame_rate": "sequences",
}
"""Keys of sections that may be given beside these, in short."""

ALIKE = 0.65
"""Share of letters in common from which on a name is taken for a misspelt one."""

PRESET, FILE, OPTION = range(3)
"""Who set a value: an installed config, a file, the command line."""

_CONSTANT = "it is a constant of the method now; leave it out"
_OF_LANDMARKS = ("keypoints", "track", "likelihood_below", "image_size", "y_axis")
_NOT_SHAPES = "it counts for landmarks only; leave it out, or `convert` the shapes with it"

GONE: Mapping[str, Mapping[str, str]] = {
    "fit": {
        "posterior.views": "it starts from the poses of the convex program alone; leave it out",
        "posterior.max_rounds": _CONSTANT,
        "posterior.widest": _CONSTANT,
        "posterior.gross_density": _CONSTANT,
        "posterior.csv_deviations": "CSV has sd_x, sd_y, sd_z where the method knows them",
        "camera.ridge": _CONSTANT,
        "camera.softness": _CONSTANT,
        "camera.image_size": "write `image_size` beside `camera`",
        "outliers.draws": _CONSTANT,
        "outliers.seed": _CONSTANT,
        "part_format": "parts are HDF5; `convert` writes them as Parquet",
        "export.landmarks": "`convert` writes landmarks as GLB; leave it out",
        "export.wireframe": "edges are written as tubes; leave it out",
        "search.modes": "`global` finds the optimum alone; leave it out",
        "search.signed": "`global` searches coefficients >= 0; leave it out",
        "outliers.lambda": "truncated least squares went; take `outliers: {method: ransac}`",
    },
    "learn-dict": {
        "batch": "all shapes are in memory; take fewer with `every`",
        "prior.max_rounds": _CONSTANT,
        "start_weight": "`start` counts as many images as there are; leave it out",
        "prior.folds": "`prior.components` states their number",
        "prior.copies": "shapes that are varied have 2 copies, few shapes more; leave it out",
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

Location = tuple[str | int, ...]


class Place(NamedTuple):
    """Where a key and its value stand, as a message names them, and who set the value."""

    key: str
    value: str
    level: int


class Settings:
    """Values for a config before they are checked; `problems` is what is wrong already.

    Where a file is not `readable`, the keys that it gives are unknown; `refused` are the keys of
    --set options whose value cannot be read.
    """

    def __init__(self, model: type[ConfigModel], place: str = COMMAND_LINE) -> None:
        self.path_keys = marked_keys(model, PathWords)
        self.data_keys = marked_keys(model, PathWords, OfTheData)
        own = field_keys(model)
        self._short = {key for key, within in SHORT.items() if key not in own and within in own}
        self.values: dict[str, Any] = {}
        self.problems: list[str] = []
        self.readable = True
        self.refused: set[Location] = set()
        self._places: dict[Location, Place] = {(): Place(place, place, OPTION)}

    def read_file(self, path: Path, *, is_preset: bool = False) -> None:
        """Take the values of a YAML file, or of standard input for `-`.

        Its paths are relative to its folder, those of standard input to the working folder. Of an
        installed config only the settings count, not what it says of its own data.
        """
        from shapefit.config.yaml12 import read_yaml

        name = STANDARD_INPUT if path == STANDARD_STREAM else str(path)
        document = read_yaml(_text(path), lambda line, column: f"{name}:{line}:{column}")
        self.problems += document.problems
        self.readable = document.readable
        level = PRESET if is_preset else FILE
        places = {at: Place(*place, level) for at, place in document.places.items()}
        top = f"{name}:1:1"
        self._places[()] = places.get((), Place(top, top, level))
        if not isinstance(document.value, dict | None):
            found = f"expected keys with values (key: value), found {_found(document.value)}"
            self.problems.append(f"{self.place(())}: {found}")
            return
        folder = Path.cwd() / path.parent
        values = document.value or {}
        _change_paths(values, self.path_keys, partial(anchored, folder=folder))
        for owner, key in list(_held(values, self.data_keys)) if is_preset else ():
            del owner[key]
        for key in sorted(values, key=self._short.__contains__):  # they go over the section's
            within = {at[1:]: place for at, place in places.items() if at and at[0] == key}
            self.set((key,), values[key], within)

    def set_option(self, option: str) -> None:
        """Take `a.b=value`, the argument of a --set option; the value is YAML, or a bare `-`."""
        from shapefit.config.yaml12 import read_yaml

        path, equals, text = option.partition("=")
        keys = path.strip().split(".")
        place = f"--set {path}={MASK}" if STORAGE_OPTIONS in keys else f"--set {option}"
        if not equals or not all(keys):
            self.problems.append(f"{place}: expected key=value or key.key=value")
            return
        text = "'-'" if text.strip() == "-" else text  # in YAML a list with nothing in it
        document = read_yaml(text, lambda _line, _column: place)
        self.problems += document.problems
        if document.problems:
            self.refused.add(tuple(keys))
        else:
            self.set(tuple(keys), document.value, {(): Place(place, place, OPTION)})

    def set_argument(self, key: str, value: Any, place: str = COMMAND_LINE) -> None:
        """Take a value that an argument of the command line, or of a function, gives."""
        named = f"{place}, {key}" if place == COMMAND_LINE else f"{place}.{key}"
        self.set((key,), value, {(): Place(named, named, OPTION)})

    def set(self, keys: tuple[str, ...], value: Any, places: Mapping[Location, Place]) -> None:
        """Put a value in; `places` says where it stands, and what is in it."""
        keys = (SHORT[keys[0]], *keys) if keys[0] in self._short else keys
        *parents, last = keys
        mapping = self.values
        for depth, key in enumerate(parents, start=1):
            if key not in mapping:
                mapping[key] = {}
                self._places[keys[:depth]] = places[()]
            mapping = mapping[key]
            if not isinstance(mapping, dict):
                found = f"{'.'.join(keys[:depth])} is {_found(mapping)} and has no keys"
                self.problems.append(f"{places[()].key}: {found}")
                return
        mapping[last] = value
        for location in [known for known in self._places if known[: len(keys)] == keys]:
            del self._places[location]
        self._places |= {(*keys, *at): place for at, place in places.items()}

    def finish(self) -> None:
        """Fill in `{data}`, and drop what a preset says of a folder that nothing names."""
        for name, *within in self.path_keys:
            section = self.values.get(name)
            if within == ["folder"] and isinstance(section, dict) and not section.get("folder"):
                levels = {key: self._places.get((name, key), self._places[()]) for key in section}
                kept = {key: section[key] for key in section if levels[key].level != PRESET}
                self.values[name] = kept
        data = self.values.get("data")
        if isinstance(data, str) and not is_url(data):
            data = str(Path.cwd() / os.path.expanduser(data))
        _change_paths(self.values, self.path_keys, partial(with_data, data=data))

    def level(self, location: Location) -> int:
        """Return how far above others the value at `location`, or within it, was set."""
        within = (p.level for at, p in self._places.items() if at[: len(location)] == location)
        return max(within, default=PRESET - 1)

    def said(self, location: Location) -> bool:
        """Whether the file, an option or an argument gave a value at `location`."""
        return location in self._places

    def value(self, location: Location) -> Any:
        """Return the value at `location`."""
        value: Any = self.values
        for key in location:
            value = value[key]
        return value

    def place(self, location: Location, *, key: bool = False) -> str:
        """Return where the value at `location` (or its key) was said, or else its surroundings."""
        while location not in self._places:
            location = location[:-1]
        place = self._places[location]
        return place.key if key else place.value


def _held(values: Any, keys: Iterable[tuple[str, ...]]) -> Iterator[tuple[dict[str, Any], str]]:
    """Yield the mapping and the key of each of the `keys` (ways to a value) that has a value."""
    for *above, last in keys:
        owner = values
        for key in above:
            owner = owner.get(key) if isinstance(owner, dict) else None
        if isinstance(owner, dict) and last in owner:
            yield owner, last


def _change_paths(
    values: dict[str, Any], keys: Iterable[tuple[str, ...]], change: Callable[[str], str]
) -> None:
    """Change every text that is or is in the value of one of the `keys`."""
    for owner, key in _held(values, keys):
        owner[key] = change_texts(owner[key], change)


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
    settings.finish()
    options = settings.values.get(STORAGE_OPTIONS)
    if isinstance(options, dict):  # what paths name is looked up while they are checked
        use_storage_options(options)
    if not settings.readable:  # what the schema misses may well be there
        raise InputError(settings.problems)
    try:
        config = model.model_validate(settings.values, by_alias=True, by_name=False)
    except ValidationError as error:
        unread = [("missing", keys) for keys in settings.refused]  # which are not missing
        details = (each for each in error.errors() if (each["type"], each["loc"]) not in unread)
        lines = [*settings.problems, *(_problem(model, each, settings) for each in details)]
    else:
        lines = [*settings.problems, *(_idle_problems(config, settings) if final else ())]
        if not lines:
            return config
    raise InputError(list(dict.fromkeys(lines)))


def _idle_problems(config: ConfigModel, settings: Settings) -> Iterator[str]:
    """Yield a line for each key that was set and has no effect in this config.

    What an installed config sets is no mistake, nor what a file sets and the command line overrules
    by another choice.
    """
    changed = config.model_dump(exclude_defaults=True)
    for keys, effect in idle_keys(config.COMMAND, config):
        level = settings.level(keys)
        overruled = any(settings.level(tuple(key.split("."))) > level for key in effect.because)
        if level == PRESET or overruled:
            continue
        for key, field in all_fields(type(config)):
            of_effect = key[: len(keys)] == keys and submodel(field) is None
            if of_effect and settings.said(key) and any(_held(changed, [key])):
                found = f"`{'.'.join(key)}` has no effect here, only {effect.condition}"
                yield f"{settings.place(key, key=True)}: {found}; leave it out"


def _problem(model: type[BaseModel], detail: ErrorDetails, settings: Settings) -> str:
    """Return what is wrong in pydantic's words, with its place and the nearest that is right."""
    location, value = detail["loc"], detail["input"]
    owner, own, field = _field_at(model, location)
    key = str(location[len(own) - 1]) if own else ""
    phrase = None if field is None else expected(field)
    match detail["type"]:
        case "extra_forbidden":
            place = settings.place(location, key=True)
            return f"{place}: unknown key {key!r}{_known(model, owner, location)}"
        case "missing" if own == location:
            place = settings.place(location[:-1])
            return f"{place}: missing key {key!r} ({meaning(owner, key)})"
        case "value_error":
            message = str(detail["ctx"]["error"])
            return f"{settings.place(_first_named(message, location, settings))}: {message}"
        case "model_type" if field is not None and (inner := submodel(field)):
            phrase = f"a mapping with the keys {', '.join(field_keys(inner))}"
    if phrase:  # of the kinds of values that a field takes each has its own complaint
        place, value = settings.place(own), settings.value(own)
        return f"{place}: expected {phrase}, found {_found(value)}"
    choices = re.findall(r"'([^']+)'", detail.get("ctx", {}).get("expected", ""))
    wanted = detail["msg"].replace("Input", f"`{key}`", 1)
    nearest = _did_you_mean(str(value), choices)
    return f"{settings.place(location)}: {wanted}, found {_found(value)}{nearest}"


def _first_named(message: str, location: Location, settings: Settings) -> Location:
    """Return where the first of the keys was said that a message names as `key` or `key: value`.

    Of keys that do not go together none is at fault alone; their common `location` is the answer
    where the settings say none of them.
    """
    named = ((*location, word) for word in re.findall(r"`(\w+)", message))
    return next(filter(settings.said, named), location)


def _field_at(
    model: type[BaseModel], location: Location
) -> tuple[type[BaseModel], Location, FieldInfo | None]:
    """Return the field that `location` is or lies in (None if unknown), its owner and location."""
    owner, field = model, None
    own: Location = ()
    for depth, key in enumerate(map(str, location), start=1):
        own, field = location[:depth], field_keys(owner).get(key)
        inner = None if field is None else submodel(field)
        if inner is None or depth == len(location):
            break
        owner = inner
    return owner, own, field


def _known(model: type[BaseModel], owner: type[BaseModel], location: Location) -> str:
    """Return the end of a message on an unknown key: the nearest key, or all that are known.

    Keys of all sections count, those that may be given in short as such.
    """
    key, own = str(location[-1]), field_keys(owner)
    gone = GONE.get(getattr(model, "COMMAND", ""), {}).get(".".join(map(str, location)))
    if gone is not None:
        return f"; it is gone: {gone}"
    ways = {way.rpartition(".")[2]: way for way in reversed([*dotted_keys(model)])}
    ways |= {short: short for short in SHORT if short in ways} | {name: name for name in own}
    return _did_you_mean(key, ways) or f"; the keys here are {', '.join(own)}"


def _did_you_mean(text: str, choices: Iterable[str] | Mapping[str, str]) -> str:
    """Say which choice is like a text; a mapping says how each is written."""
    from difflib import get_close_matches

    written = choices if isinstance(choices, Mapping) else {choice: choice for choice in choices}
    nearest = get_close_matches(text, written, n=1, cutoff=ALIKE)
    return f"; did you mean {written[nearest[0]]!r}?" if nearest else ""


def _found(value: Any) -> str:
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

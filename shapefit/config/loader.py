"""From YAML files, `--set` options and arguments to a checked config, or every problem at once.

The name of an installed config stands for a file: `cars` of `fit` is `configs/cars/fit.yaml`.
"""

from __future__ import annotations

import importlib
import io
import os
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import nullcontext
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from pydantic import ValidationError
from pydantic_core import ErrorDetails

from shapefit.config.model import (
    CommandConfig,
    Location,
    Place,
    all_fields,
    expected,
    field_at,
    field_keys,
    listed_keys,
    marked_keys,
    meaning,
    submodel,
    with_all_optional,
)
from shapefit.config.paths import STANDARD_STREAM, PathField, change_texts, in_folder, with_data
from shapefit.errors import InputError, input_error

COMMAND_LINE, STANDARD_INPUT = "command line", "standard input"

MAX_BYTES = 1 << 20
"""Of a config: beyond that it is something else."""

SIMILAR = 0.65
"""Share of letters in common from which on a name is taken for a misspelt one."""

OF_ONE_DATA_SET = ("leave_one_out", "principal_point", "match", "groups", "truth_frame")
"""Keys of an installed config that count only for its own data, as its paths do."""

_PACKAGE = Path(__file__).resolve().parents[1]

WHOLE_SEQUENCES = "people/sequences.yaml"
"""A second config for people, so a file of that name beside the one for single images."""


class ConfigFile(NamedTuple):
    """The YAML file of a config; of a preset only the settings count, not its own data."""

    path: Path
    is_preset: bool = False


def presets_folder() -> Path:
    """Return the folder of installed configs: in the package, or beside it in a checkout."""
    installed = _PACKAGE / "configs"
    return installed if installed.is_dir() else _PACKAGE.parent / "configs"


def find_presets(command: str) -> dict[str, Path]:
    """Return the installed configs of a command by name, sorted."""
    files = {file.parent.name: file for file in presets_folder().glob(f"*/{command}.yaml")}
    if command == "fit":
        files |= {file.stem: file for file in presets_folder().glob(WHOLE_SEQUENCES)}
    return dict(sorted(files.items()))


def find_config(command: str, path: Path | None) -> ConfigFile | None:
    """Return the config file that a path or the name of a preset stands for.

    A file wins over a preset of the same name. Raises InputError where there is neither.
    """
    if path is None:
        return None
    if path == STANDARD_STREAM or (path.exists() and not path.is_dir()):
        return ConfigFile(path)
    presets = find_presets(command)
    if str(path) in presets:
        return ConfigFile(presets[str(path)], is_preset=True)
    found = "it is a folder" if path.is_dir() else "no such file"
    names = f"or one of the installed configs: {', '.join(presets)}" if presets else "to read"
    raise input_error(path, found, f"name a YAML file, {names}")


class Schemas(Mapping[str, type[CommandConfig]]):
    """The config of each command, imported on first use: a schema takes long to build."""

    def __init__(self, places: Mapping[str, str]) -> None:
        self.places = places

    def __getitem__(self, command: str) -> type[CommandConfig]:
        module, _, name = self.places[command].rpartition(".")
        schema: type[CommandConfig] = getattr(importlib.import_module(module), name)
        return schema

    def __iter__(self) -> Iterator[str]:
        return iter(self.places)

    def __len__(self) -> int:
        return len(self.places)


CONFIGS = Schemas(
    {
        "learn-dict": "shapefit.config.commands.learn_dict.LearnDictConfig",
        "fit": "shapefit.config.commands.fit.FitConfig",
        "eval": "shapefit.config.commands.evaluate.EvalConfig",
        "project": "shapefit.config.commands.project.ProjectConfig",
        "convert": "shapefit.config.commands.files.ConvertConfig",
        "info": "shapefit.config.commands.files.InfoConfig",
        "view": "shapefit.config.commands.view.ViewConfig",
    }
)


def load_config(
    command: str,
    file: Path | ConfigFile | None = None,
    overrides: Sequence[str] = (),
    arguments: Mapping[str, object] | None = None,
    *,
    place: str = COMMAND_LINE,
    to_show: bool = False,
) -> CommandConfig:
    """Return the checked config of a command.

    `overrides` (each `a.b=value`) replace values of the `file`, and `arguments` (`a.b` -> value;
    None and () are not given) replace both; `place` names the arguments in messages. Paths in the
    file are relative to the file, others to the working directory. A config `to_show` may lack
    required keys. Raises InputError with every problem, each with its place.
    """
    file = ConfigFile(file) if isinstance(file, Path) else file
    schema = with_all_optional(CONFIGS[command]) if to_show else CONFIGS[command]
    values = _Values(schema, place)
    if file is not None:
        values.read_file(file)
    for option in overrides:
        values.read_option(option)
    for key, value in (arguments or {}).items():
        if value is not None and value != ():
            named = f"{place}, {key}" if place == COMMAND_LINE else f"{place}.{key}"
            values.put(tuple(key.split(".")), value, {(): Place(named, named)})
    config = values.check()
    readers = ["the config"] if file and file.path == STANDARD_STREAM else []
    readers += [f"`{key}`" for key, path in config.inputs() if path == STANDARD_STREAM]
    if len(readers) > 1:
        found = f"{' and '.join(readers)} would both read it"
        raise input_error(STANDARD_INPUT, found, "name a file for one of them")
    return config


def dump_config(config: CommandConfig) -> str:
    """Return the config as YAML with every default; it loads again to the same config."""
    from ruamel.yaml import YAML

    text = io.StringIO()
    YAML().dump(config.as_plain(), text)
    return text.getvalue()


class _Values:
    """The values of a config before they are checked, the place of each, and what is wrong."""

    def __init__(self, schema: type[CommandConfig], place: str) -> None:
        self.schema = schema
        self.values: dict[str, Any] = {}
        self.places: dict[Location, Place] = {(): Place(place, place)}
        self.problems: list[str] = []
        self.unread: set[Location] = set()

    def read_file(self, file: ConfigFile) -> None:
        """Take the values of a YAML file, or of standard input for `-`."""
        from shapefit.config.yaml12 import read_yaml

        name = STANDARD_INPUT if file.path == STANDARD_STREAM else str(file.path)
        document = read_yaml(_read_text(file.path), lambda line, col: f"{name}:{line}:{col}")
        if not document.readable:
            raise InputError(document.problems)
        self.problems += document.problems
        self.places = {(): Place(f"{name}:1:1", f"{name}:1:1")} | document.places
        if not isinstance(document.value, dict | None):
            found = f"expected keys with values (key: value), found {_describe(document.value)}"
            raise InputError(f"{self.places[()].value}: {found}")
        self.values = document.value or {}
        for owner, key in self._paths():
            if file.is_preset:
                del owner[key]
            else:
                anchor = partial(in_folder, folder=Path.cwd() / file.path.parent)
                owner[key] = change_texts(owner[key], anchor)
        for owner in (self.values, self.values.get("camera", {})) if file.is_preset else ():
            for key in OF_ONE_DATA_SET:
                owner.pop(key, None)

    def read_option(self, option: str) -> None:
        """Take `a.b=value`, the argument of a --set option; the value is YAML, or a bare `-`."""
        from shapefit.config.yaml12 import read_yaml

        path, equals, text = option.partition("=")
        keys, place = tuple(path.strip().split(".")), f"--set {option}"
        if not equals or not all(keys):
            self.problems.append(f"{place}: expected key=value or key.key=value")
            return
        text = "'-'" if text.strip() == "-" else text  # in YAML a list with nothing in it
        document = read_yaml(text, lambda _line, _column: place)
        self.problems += document.problems
        if document.problems:
            self.unread.add(keys)
        else:
            self.put(keys, document.value, {(): Place(place, place)})

    def put(self, keys: tuple[str, ...], value: Any, places: Mapping[Location, Place]) -> None:
        """Set a value; `places` says where it and the values in it stand."""
        owner = self.values
        for depth, key in enumerate(keys[:-1], start=1):
            owner = owner.setdefault(key, {})
            if not isinstance(owner, dict):
                found = f"{'.'.join(map(str, keys[:depth]))} is {_describe(owner)} and has no keys"
                self.problems.append(f"{places[()].key}: {found}")
                return
            self.places.setdefault(keys[:depth], places[()])
        owner[keys[-1]] = value
        self.places = {at: p for at, p in self.places.items() if at[: len(keys)] != keys}
        self.places |= {(*keys, *at): place for at, place in places.items()}

    def check(self) -> CommandConfig:
        """Return the config; raises InputError with every problem."""
        data = self.values.get("data")
        if isinstance(data, str):
            data = os.path.abspath(os.path.expanduser(data))
            for owner, key in self._paths():
                owner[key] = change_texts(owner[key], partial(with_data, data=data))
        problems = self.problems
        try:
            config = self.schema.model_validate(self.values, by_alias=True, by_name=False)
        except ValidationError as error:
            problems = [*problems, *map(self._message, filter(self._is_new, error.errors()))]
        if problems:
            raise InputError(dict.fromkeys(problems))
        return config

    def _paths(self) -> list[tuple[dict[str, Any], str]]:
        """Return the mapping and the key of each value that holds paths."""
        found = []
        for *above, last in marked_keys(self.schema, PathField):
            owner: Any = self.values
            for key in above:
                owner = owner.get(key) if isinstance(owner, dict) else None
            if isinstance(owner, dict) and last in owner:
                found.append((owner, last))
        return found

    def _is_new(self, error: ErrorDetails) -> bool:
        """Whether an error is not of a key whose value could not be read."""
        return error["type"] != "missing" or error["loc"] not in self.unread

    def _place(self, location: Location, *, of_key: bool = False) -> str:
        while location not in self.places:
            location = location[:-1]
        return self.places[location].key if of_key else self.places[location].value

    def _message(self, error: ErrorDetails) -> str:
        """Return what is wrong, with its place and the nearest value or key that is right."""
        location = error["loc"]
        owner, own, field = field_at(self.schema, location)
        key = ".".join(map(str, own))
        if error["type"] == "extra_forbidden":
            return f"{self._place(location, of_key=True)}: {self._unknown(location, owner)}"
        if error["type"] == "missing" and own == location:
            about = meaning(owner, str(own[-1]))
            return f"{self._place(location[:-1])}: missing key {key!r} ({about})"
        if error["type"] == "value_error":
            message = str(error["ctx"]["error"])
            named = [word.split(":")[0] for word in message.split("`")[1::2]]
            ways = [(*location, *name.split(".")) for name in named]
            at = next((way for way in ways if way in self.places), location)
            return f"{self._place(at)}: {message}"
        phrase = None if field is None else expected(field)
        if phrase is None and error["type"] == "model_type" and field is not None:
            inner = submodel(field)
            phrase = f"a mapping with the keys {', '.join(listed_keys(inner))}" if inner else None
        if phrase is not None:
            value: Any = self.values
            for step in own:
                value = value[step]
            return f"{self._place(own)}: expected {phrase}, found {_describe(value)}"
        choices = str(error.get("ctx", {}).get("expected", "")).split("'")[1::2]
        wanted = error["msg"].replace("Input", f"`{key}`", 1)
        message = f"{wanted}, found {_describe(error['input'])}"
        return f"{self._place(location)}: {message}{_nearest(str(error['input']), choices)}"

    def _unknown(self, location: Location, owner: type[Any]) -> str:
        """Return the message of an unknown key: the nearest of all keys, or those known here."""
        keys = field_keys(owner)
        ways = {way[-1]: ".".join(way) for way, _ in all_fields(self.schema)}
        above = ".".join(map(str, location[:-1]))
        ways |= {key: f"{above}.{key}" if above else key for key in keys}
        name = ".".join(map(str, location))
        near = _nearest(str(location[-1]), ways)
        return f"unknown key {name!r}" + (
            near or f"; the keys here are {', '.join(listed_keys(owner))}"
        )


def _read_text(path: Path) -> str:
    """Return the text of a config; raises InputError where it cannot be read."""
    stream = path == STANDARD_STREAM
    name = STANDARD_INPUT if stream else path
    if stream and sys.stdin is None:
        raise input_error(name, "is closed", "send a config there, or name a file")
    if path.is_fifo() and path.parent.name != "fd":  # but <(...) of a shell is /dev/fd/63
        raise input_error(name, "is a pipe", "save the config to a file, or send it to -")
    try:
        with nullcontext(sys.stdin.buffer) if stream else path.open("rb") as file:
            data = file.read(MAX_BYTES + 1)
        if len(data) > MAX_BYTES:
            raise input_error(name, f"larger than {MAX_BYTES} bytes", "give a config in YAML")
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise input_error(name, "not UTF-8 text", "save it as UTF-8") from None
    except OSError as error:
        raise input_error(name, error.strerror or "cannot be read", "check the path") from None


def _nearest(text: str, choices: Iterable[str] | Mapping[str, str]) -> str:
    """Return the end of a message that names the choice like a text, if there is one."""
    from difflib import get_close_matches

    written = choices if isinstance(choices, Mapping) else {choice: choice for choice in choices}
    nearest = get_close_matches(text, written, n=1, cutoff=SIMILAR)
    return f"; did you mean {written[nearest[0]]!r}?" if nearest else ""


def _describe(value: Any) -> str:
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

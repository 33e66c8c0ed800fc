"""From YAML files, `--set` options and arguments to a checked config, or every problem at once."""

from __future__ import annotations

import io
import os
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from pydantic import ValidationError
from pydantic_core import ErrorDetails

from shapefit.config.commands import CONFIGS
from shapefit.config.model import (
    CommandConfig,
    Location,
    all_fields,
    field_at,
    field_keys,
    find_mark,
    is_listed,
    submodel,
)
from shapefit.config.paths import (
    STANDARD_STREAM,
    Description,
    PathField,
    change_texts,
    find_presets,
    in_folder,
)
from shapefit.errors import InputError, input_error

STANDARD_INPUT = "standard input"

SIMILAR = 0.65
"""Share of letters in common from which on a name is taken for a misspelt one."""

OF_ONE_DATA_SET = ("leave_one_out", "principal_point", "match", "groups", "truth_frame")
"""Keys of an installed config that count only for its own data, as its paths do."""


def load_config(
    command: str,
    file: Path | None = None,
    overrides: Sequence[str] = (),
    arguments: Mapping[str, Any] | None = None,
    *,
    name: Callable[[str], str] = str,
    stand_ins: Mapping[str, Any] | None = None,
) -> Any:
    """Return the checked config of a command.

    `file` is a YAML file, `-`, or the name of an installed config. `overrides` (each `a.b=value`)
    replace its values, and `arguments` (`a.b` -> value; None and () are not given) replace both;
    `name` words their keys in messages. Paths in the file are relative to the file, others to the
    working directory. `stand_ins` replace files, or, where they are None, fill keys of files that
    are not given. Raises InputError with every problem, each with its place.
    """
    values = _Values(CONFIGS[command], command)
    if file is not None:
        values.read_file(file)
    for option in overrides:
        values.read_option(option)
    values.take(arguments or {}, name)
    replaced = values.replace_files(stand_ins or {})
    config = values.check().model_copy(update=replaced)
    readers = ["the config"] if file == STANDARD_STREAM else []
    readers += [f"`{key}`" for key, path in config.inputs() if path == STANDARD_STREAM]
    if len(readers) > 1:
        fault = f"{' and '.join(readers)} would both read it"
        raise input_error(STANDARD_INPUT, fault, "name a file for one of them")
    return config


def dump_config(config: CommandConfig) -> str:
    """Return the config as YAML with every default; it loads again to the same config."""
    from ruamel.yaml import YAML

    text = io.StringIO()
    YAML().dump(config.as_plain(), text)
    return text.getvalue()


class _Values:
    """The values of a config before they are checked, and the places of their keys and values."""

    def __init__(self, schema: type[CommandConfig], command: str) -> None:
        self.schema = schema
        self.command = command
        self.values: dict[str, Any] = {}
        self.places: dict[Location, tuple[str, str]] = {(): (command, command)}

    def read_file(self, path: Path) -> None:
        """Take the values of a YAML file, of standard input for `-`, or of an installed config.

        Of an installed config only the settings count, not what it says of its own data.
        """
        from shapefit.config.yaml12 import read_yaml

        presets = find_presets(self.command)
        preset = presets.get(str(path)) if not path.exists() or path.is_dir() else None
        text, name = _read_text(preset or path, presets)
        values, self.places = read_yaml(text, lambda line, column: f"{name}:{line}:{column}")
        if not isinstance(values, dict | None):
            fault = f"expected keys with values (key: value), found {_describe(values)}"
            raise InputError(f"{name}:1:1: {fault}")
        self.values = values or {}
        self.places[()] = (f"{name}:1:1",) * 2
        for owner, key, field in self._paths():
            if preset is not None:
                del owner[key]
            else:
                owner[key] = in_folder(owner[key], Path.cwd() / path.parent, field)
        if preset is not None:
            for owner in (self.values, self.values.get("camera", {})):
                for key in OF_ONE_DATA_SET:
                    owner.pop(key, None)

    def read_option(self, option: str) -> None:
        """Take `a.b=value`, the argument of a --set option; the value is YAML, or a bare `-`."""
        from shapefit.config.yaml12 import read_yaml

        path, equals, text = option.partition("=")
        keys, place = tuple(path.strip().split(".")), f"--set {option}"
        if not equals or not all(keys):
            raise InputError(f"{place}: expected key=value or key.key=value")
        text = "'-'" if text.strip() == "-" else text  # in YAML a list with nothing in it
        value, places = read_yaml(text, lambda _line, _column: place)
        self.put(keys, value, places)

    def take(
        self, arguments: Mapping[str, Any], name: Callable[[str], str], above: str = ""
    ) -> None:
        """Take values by their keys; a mapping for a section sets the keys that it has."""
        for key, value in arguments.items():
            keys = (above + key).split(".")
            field = field_at(self.schema, tuple(keys))[2]
            if isinstance(value, Mapping) and field is not None and submodel(field):
                self.take(value, name, f"{above}{key}.")
            elif value is not None and value != ():
                place = name(above + key)
                self.put(tuple(keys), value, {(): (place, place)})

    def put(
        self, keys: tuple[str, ...], value: Any, places: Mapping[Location, tuple[str, str]]
    ) -> None:
        """Set a value; `places` says where it and the values in it stand."""
        owner = self.values
        for depth, key in enumerate(keys[:-1], start=1):
            owner = owner.setdefault(key, {})
            if not isinstance(owner, dict):
                fault = f"{'.'.join(keys[:depth])} is {_describe(owner)} and has no keys"
                raise InputError(f"{places[()][0]}: {fault}")
            self.places.setdefault(keys[:depth], places[()])
        owner[keys[-1]] = value
        self.places = {at: p for at, p in self.places.items() if at[: len(keys)] != keys}
        self.places |= {(*keys, *at): place for at, place in places.items()}

    def replace_files(self, stand_ins: Mapping[str, Any]) -> dict[str, Any]:
        """Set keys of files to what passes the check; return what they are to be afterwards."""
        keys = field_keys(self.schema).keys()
        absent = keys - self.values.keys()
        replaced = {
            key: value
            for key, value in stand_ins.items()
            if key in (keys if value is not None else absent)
        }
        self.values |= {key: "-" if key == "output" else os.devnull for key in replaced}
        return replaced

    def check(self) -> CommandConfig:
        """Return the config; raises InputError with every problem."""
        data = self.values.get("data")
        if isinstance(data, str):
            folder = os.path.abspath(os.path.expanduser(data))
            for owner, key, _ in self._paths():
                owner[key] = change_texts(
                    owner[key],
                    lambda path: folder + path[6:] if path.startswith("{data}") else path,
                )
        try:
            return self.schema.model_validate(self.values, by_alias=True, by_name=False)
        except ValidationError as error:
            errors = error.errors()
            around = {each["loc"][:depth] for each in errors for depth in range(len(each["loc"]))}
            innermost = (each for each in errors if each["loc"] not in around)
            raise InputError(dict.fromkeys(map(self._message, innermost))) from None

    def _paths(self) -> list[tuple[dict[str, Any], str, PathField]]:
        """Return the mapping, the key and the field of each value that holds paths."""
        paths = []
        for (*above, last), field in all_fields(self.schema):
            owner: Any = self.values
            for key in above:
                owner = owner.get(key) if isinstance(owner, dict) else None
            kind = find_mark(field, PathField)
            if kind is not None and isinstance(owner, dict) and last in owner:
                paths.append((owner, last, kind))
        return paths

    def _message(self, error: ErrorDetails) -> str:
        """Return what is wrong, with its place and the nearest value or key that is right."""
        from shapefit.config.reference import expects, meaning

        location, kind = error["loc"], error["type"]
        owner, own, field = field_at(self.schema, location)
        at = next(
            location[:depth]
            for depth in range(len(location), -1, -1)
            if location[:depth] in self.places
        )
        of_key, of_value = self.places[at]
        if kind == "extra_forbidden":
            return f"{of_key}: {self._unknown(location, owner)}"
        if kind == "missing" and own == location:
            return f"{of_value}: missing key {own[-1]!r} ({meaning(owner, str(own[-1]))})"
        if kind == "value_error":
            message = str(error["ctx"]["error"])
            named = [word.partition(":")[0] for word in message.split("`")[1::2]]
            ways = ((*location, *name.split(".")) for name in named)
            place = next((self.places[way][1] for way in ways if way in self.places), of_value)
            return f"{place}: {message}"
        value: Any = self.values
        inside = len(at) > len(own) and field is not None and not find_mark(field, Description)
        for step in at if inside else own:
            value = value[step]
        if field is None or inside:
            words = error["msg"].removeprefix("Input should be ")
        else:
            words, of_value = expects(field), self.places[own][1]
        choices = str(error.get("ctx", {}).get("expected", "")).split("'")[1::2]
        near = _nearest(str(value), choices)
        return f"{of_value}: expected {words}, found {_describe(value)}{near}"

    def _unknown(self, location: Location, owner: type[Any]) -> str:
        """Return the message of an unknown key: the nearest key, or those of its section."""
        *above, last = map(str, location)
        keys = {key: ".".join((*above, key)) for key in field_keys(owner)}
        ways = {way[-1]: ".".join(way) for way, _ in all_fields(self.schema)} | keys
        listed = [key for key, field in field_keys(owner).items() if is_listed(field)]
        near = _nearest(last, ways) or f"; the keys here are {', '.join(listed)}"
        return f"unknown key {'.'.join((*above, last))!r}{near}"


def _read_text(path: Path, presets: Iterable[str]) -> tuple[str, str]:
    """Return the text of a config and its name; raises InputError where it cannot be read."""
    stream = path == STANDARD_STREAM
    name = STANDARD_INPUT if stream else str(path)
    if stream and sys.stdin is None:
        raise input_error(name, "is closed", "send a config there, or name a file")
    if not stream and (path.is_dir() or not path.exists()):
        fault = "it is a folder" if path.is_dir() else "no such file"
        others = ", ".join(presets)
        fix = f"name a YAML file, or one of the installed configs: {others}"
        raise input_error(name, fault, fix if others else "name a YAML file")
    if path.is_fifo() and path.parent.name != "fd":  # but <(...) of a shell is /dev/fd/63
        raise input_error(name, "is a pipe", "save the config to a file, or send it to -")
    try:
        data = sys.stdin.buffer.read() if stream else path.read_bytes()
        return data.decode("utf-8-sig"), name
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
    if isinstance(value, str):
        return repr(value) if len(value) <= 200 else f"{value[:200]!r}..."
    if isinstance(value, dict | list | tuple):
        return "a mapping" if isinstance(value, dict) else "a list"
    return "nothing" if value is None else str(value).lower()

"""From YAML files, `--set` and arguments to a checked config, or all its problems."""

from __future__ import annotations

import io
import re
import sys
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from pydantic import ValidationError

from shapefit.config.commands import CONFIGS
from shapefit.config.model import CommandConfig, ConfigKey, list_config_keys
from shapefit.config.paths import (
    STANDARD_STREAM,
    FileText,
    Paths,
    absolute_path,
    fill_in,
    find_presets,
)
from shapefit.errors import InputError, input_error, printable

if TYPE_CHECKING:
    from pydantic_core import ErrorDetails
    from ruamel.yaml.constructor import BaseConstructor
    from ruamel.yaml.error import StreamMark
    from ruamel.yaml.nodes import Node

Schema = type[CommandConfig]
Location = tuple[str | int, ...]
"""The keys and list positions that lead to a value."""

Places = dict[Location, str]
"""Where the key of a value, or an item of a list, stands, as a message names it."""

MAX_VALUES = 100_000
"""Aliases of aliases make more of them than memory holds, from a few lines."""

CORE_TAG = "tag:yaml.org,2002:"
"""Before the names of YAML's own tags."""

KINDS = {
    "ScalarNode": {
        *("str", "int", "float", "bool", "null"),
        *("timestamp", "merge", "value"),  # of plain texts, which they stay
    },
    "SequenceNode": {"seq"},
    "MappingNode": {"map"},
}
"""Tags that a node of YAML can have; all others would name what to make of it."""

OF_ONE_DATA_SET = ("leave_one_out", "principal_point", "match", "groups", "truth_frame")
"""Keys of an installed config that count only for its own data, as its paths do."""


def load_config(
    command: str,
    file: Path | None = None,
    overrides: Sequence[str] = (),
    arguments: Mapping[str, object] | None = None,
    *,
    prefix: str = "",
    placeholders: Mapping[str, object] | None = None,
) -> Any:
    """Return the checked config of a command: a file, `overrides`, then `arguments`.

    `file` is a YAML file, `-`, or the name of an installed config; paths in it are
    relative to it, others to the working directory. `overrides` are texts `a.b=value`;
    `arguments` (`a.b` -> value) count unless None or (), and messages name them after
    `prefix`. `placeholders` replace files, or, where they are None, fill keys of files
    that are not given. Raises InputError with every problem, each with its place.
    """
    schema = CONFIGS[command]
    values: dict[str, object] = {}
    places: Places = {(): command}
    if file is not None:
        values = _read_config(schema, command, file, places)
    for option in overrides:
        origin = f"--set {option}"
        name, equals, text = option.partition("=")
        path = tuple(name.strip().split("."))
        if not equals or not all(path):
            raise InputError(f"{origin}: expected key=value or key.key=value")
        _set_value(values, places, path, read_yaml(text, origin), origin)
    for name, value in (arguments or {}).items():
        if value is not None and value != ():
            path = tuple(name.split("."))
            _set_value(values, places, path, value, prefix + name)
    replaced = {
        key: value
        for key, value in (placeholders or {}).items()
        if value is not None or key not in values
    }
    values.update(dict.fromkeys(replaced, "-"))
    data = values.get("data")
    if isinstance(data, str):
        folder = str(absolute_path(data))
        values = {key: fill_in(value, folder) for key, value in values.items()}
    try:
        config = schema.model_validate(values, by_alias=True, by_name=False)
    except ValidationError as error:
        problems = _list_problems(schema, error, values, places)
        raise InputError(problems) from None
    return config.model_copy(update=replaced)


def dump_config(config: CommandConfig) -> str:
    """Return the config as YAML with every default; it loads to the same config."""
    from ruamel.yaml import YAML

    text = io.StringIO()
    YAML().dump(config.as_plain(), text)
    return text.getvalue()


def _read_config(
    schema: Schema, command: str, path: Path, places: Places
) -> dict[str, object]:
    """Return the values of a YAML file, of standard input, or of an installed config.

    Of an installed config only the settings count, not what it says of its own data.
    """
    presets = find_presets(command)
    preset = None if path.is_file() else presets.get(str(path))
    name = "standard input" if path == STANDARD_STREAM else str(path)
    # <(...) of a shell, which is /dev/fd/63, is read as other files are
    if path.is_fifo() and path.parent.name != "fd":
        raise input_error(
            name, "is a pipe", "save the config to a file, or send it to -"
        )
    try:
        if path == STANDARD_STREAM:
            content = sys.stdin.buffer.read() if sys.stdin else b""
        else:
            content = (preset or path).read_bytes()
        text = content.decode("utf-8-sig")
        values = read_yaml(text, name, places, Path.cwd() / path.parent)
    except UnicodeDecodeError:
        raise input_error(name, "not UTF-8 text", "save it as UTF-8") from None
    except OSError as error:
        names = ", ".join(["a YAML file", *presets])
        raise input_error(
            name, f"{error.strerror}".lower(), f"give one of: {names}"
        ) from None
    places[()] = f"{name}:1:1"
    if values is None:
        values = {}
    if not isinstance(values, dict):
        fault = f"expected keys with values (key: value), found {_in_words(values)}"
        raise InputError(f"{places[()]}: {fault}")
    if preset is not None:
        places[()] = f"the installed config {name}, which has settings and no files"
        _leave_out_own_data(schema, values, places)
    return values


def _leave_out_own_data(
    schema: Schema, values: dict[str, object], places: Places
) -> None:
    """Remove, in place, the keys that fit only an installed config's own data.

    They are paths, and those of OF_ONE_DATA_SET.
    """
    for path, key in list_config_keys(schema).items():
        *sections, name = path
        if isinstance(key.description, Paths) or name in OF_ONE_DATA_SET:
            of_section: object = values
            for section in sections:
                of_section = _child_of(of_section, section)
            if isinstance(of_section, dict):
                of_section.pop(name, None)
            places.pop(path, None)


def _child_of(section: object, key: str | int) -> object:
    """Return the value of a key of a section, or at an index of a list, or None."""
    if isinstance(section, dict):
        return section.get(key)
    if isinstance(section, list | tuple) and isinstance(key, int):
        return section[key]
    return None


def read_yaml(
    text: str, name: str, places: Places | None = None, folder: Path = Path()
) -> object:
    """Parse a YAML 1.2 text, whose paths are relative to `folder`, to plain values.

    `places` gets the line and column of each value. Keys and dates are texts. Raises
    InputError, which names the text, and the line and column if there are places, for
    what is not YAML, for a key that stands twice, and for tags but those of the core
    schema.
    """
    if places is None and text.strip() not in ("true", "false", "null"):
        # A word, - too (in YAML a list), or a number alone: ruamel.yaml takes 10 ms to
        # import.
        if re.fullmatch(" *(-|[a-z][a-z+-]*) *", text):
            return text.strip()
        if re.fullmatch(r"[0-9]{1,9}(\.[0-9]+)?", text):
            return float(text) if "." in text else int(text)
    from ruamel.yaml import YAML
    from ruamel.yaml.error import MarkedYAMLError, YAMLError, YAMLWarning

    yaml = YAML(typ="safe", pure=True)
    reader = _NodeReader(yaml.constructor, name, places, folder)
    place = name if places is None else f"{name}:1:1"
    try:
        with warnings.catch_warnings():
            # on YAML 1.1, and repeated anchors
            warnings.simplefilter("ignore", YAMLWarning)
            root = yaml.compose(text)
            return None if root is None else reader.read(root, ())
    except MarkedYAMLError as error:
        problem = error.problem or error.context
        mark = error.problem_mark or error.context_mark
        if mark:
            place = reader.place_of(mark)
    except (YAMLError, ValueError, LookupError) as error:
        problem = str(error).splitlines()[0]
    except RecursionError:
        problem = "lists or mappings are nested too deeply, or an alias contains itself"
    raise InputError(f"{place}: not valid YAML: {problem}")


class _NodeReader:
    """Reads nodes of YAML as plain values, and writes down where each stands."""

    def __init__(
        self,
        constructor: BaseConstructor,
        name: str,
        places: Places | None,
        folder: Path,
    ) -> None:
        self.constructor = constructor
        self.name = name
        self.has_places = places is not None
        self.places: Places = {} if places is None else places
        self.folder = folder

    def place_of(self, mark: StreamMark) -> str:
        """Return the name of the text, with line and column if there are places."""
        if not self.has_places:
            return self.name
        return f"{self.name}:{mark.line + 1}:{mark.column + 1}"

    def read(self, node: Node, location: Location) -> object:
        """Return the plain value of a YAML node, found at `location`, a path of keys.

        Raises InputError for tags and repeated keys, ValueError for too many values.
        """
        if len(self.places) > MAX_VALUES:
            raise ValueError(
                f"more than {MAX_VALUES} values, aliases written out; write fewer"
            )
        kind = str(node.tag).removeprefix(CORE_TAG)
        if kind not in KINDS[type(node).__name__]:
            found = printable(node.tag).replace(CORE_TAG, "!!")
            place = self.place_of(node.start_mark)
            raise InputError(
                f"{place}: the tag {found} has no meaning here; leave it out"
            )
        if isinstance(node.value, str):
            return self._read_scalar(node, kind)
        entries: list[tuple[str | int, Node, Node]]
        if kind == "seq":
            entries = [(number, item, item) for number, item in enumerate(node.value)]
        else:
            entries = [(str(key.value), key, item) for key, item in node.value]
        items: dict[str | int, object] = {}
        for step, marked, item in entries:
            place = self.place_of(marked.start_mark)
            self.places[*location, step] = place
            if step in items:
                raise InputError(
                    f"{place}: not valid YAML: found duplicate key {step!r}"
                )
            items[step] = self.read(item, (*location, step))
        return list(items.values()) if kind == "seq" else items

    def _read_scalar(self, node: Node, kind: str) -> object:
        """Return a number, a truth value or nothing, else the text as it is written."""
        if any("\ud800" <= letter <= "\udfff" for letter in node.value):
            raise ValueError("half a letter, which no file can hold")
        if kind in ("int", "float", "bool", "null"):
            try:
                return self.constructor.construct_object(node)
            except (ValueError, LookupError) as error:
                place = self.place_of(node.start_mark)
                raise InputError(
                    f"{place}: not valid YAML: {node.value!r} is no {kind}"
                ) from error
        text = FileText(node.value)
        text.folder = self.folder
        return text


def _set_value(
    values: dict[str, object],
    places: Places,
    path: tuple[str, ...],
    value: object,
    origin: str,
) -> None:
    """Set the value at a path of keys, in place; `origin` names it in messages."""
    for depth, key in enumerate(path[:-1], start=1):
        section = values.get(key)
        if not isinstance(section, dict):
            section = values[key] = {}
            places[path[:depth]] = origin
        values = section
    values[path[-1]] = value
    for location in list(places):
        if location[: len(path)] == path:
            del places[location]
    places[path] = origin


def _list_problems(
    schema: Schema,
    error: ValidationError,
    values: Mapping[str, object],
    places: Places,
) -> list[str]:
    """Return the messages that say what is wrong with a config, each once."""
    problems = error.errors()
    # a list with wrong items is itself no problem
    outer = {problem["loc"][:-1] for problem in problems if problem["loc"]}
    lines = [
        _describe_problem(schema, problem, values, places)
        for problem in problems
        if problem["loc"] not in outer
    ]
    return list(dict.fromkeys(lines))


def _describe_problem(
    schema: Schema, problem: ErrorDetails, values: Mapping[str, object], places: Places
) -> str:
    """Return what is wrong, its place, and the nearest value or key that is right."""
    from shapefit.config.reference import expects, meaning

    location = problem["loc"]
    kind = problem["type"]
    keys = cast("Mapping[Location, ConfigKey]", list_config_keys(schema))
    paths = [location[:depth] for depth in range(len(location), -1, -1)]
    known_path = next(path for path in paths if path in places)
    place = places[known_path]
    if kind == "extra_forbidden":
        return f"{place}: {_describe_unknown(location, list(list_config_keys(schema)))}"
    if kind == "value_error":
        message = str(problem["ctx"]["error"])
        return f"{_place_of_named(message, location, places) or place}: {message}"
    key_path = next(path for path in paths if path in keys)
    key = keys[key_path]
    if kind == "missing" and key_path == location:
        return f"{place}: missing key {key.name!r} ({meaning(key)})"
    # the whole value of a key that is described as a whole, else the wrong part of it
    value_path = key_path
    if not key.description and len(known_path) > len(key_path):
        value_path = known_path
    value: object = values
    for step in value_path:
        value = _child_of(value, step)
    allowed = problem["msg"].split("'")[1::2]
    near = _suggest_nearest(str(value), {word: word for word in allowed})
    return f"{place}: expected {expects(key)}, found {_in_words(value)}{near}"


def _describe_unknown(location: Location, keys: Sequence[tuple[str, ...]]) -> str:
    """Say that no key is at a location, and name the nearest or all of the section."""
    siblings = [path for path in keys if path[:-1] == location[:-1]]
    choices = {path[-1]: ".".join(path) for path in [*keys, *siblings]}
    hint = _suggest_nearest(str(location[-1]), choices)
    if not hint:
        hint = f"; the keys here are {', '.join(path[-1] for path in siblings)}"
    return f"unknown key {'.'.join(map(str, location))!r}{hint}"


def _place_of_named(message: str, section: Location, places: Places) -> str | None:
    """Return the place of the first key that a message names, `like.this`, if any."""
    for quoted in message.split("`")[1::2]:
        name, _, _ = quoted.partition(":")
        place = places.get((*section, *name.split(".")))
        if place is not None:
            return place
    return None


def _suggest_nearest(name: str, choices: Mapping[str, str]) -> str:
    """Return the end of a message, `; did you mean 'X'?`, or "" where no key is near.

    The name is compared with the keys of `choices`; X is the value of the nearest.
    """
    from difflib import get_close_matches

    near = get_close_matches(name, choices, n=1)
    return f"; did you mean {choices[near[0]]!r}?" if near else ""


def _in_words(value: object) -> str:
    """Return a value as a message names it."""
    if isinstance(value, dict):
        return "a mapping"
    if isinstance(value, list | tuple):
        return "a list"
    if isinstance(value, str):
        return f"{value!r:.200}"
    return "nothing" if value is None else str(value).lower()

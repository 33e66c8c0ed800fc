"""From YAML files, `--set` options and arguments to a checked config, or every problem
at once.
"""

from __future__ import annotations

import io
import re
import sys
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from shapefit.config.commands import CONFIGS
from shapefit.config.model import CommandConfig, keys_of
from shapefit.config.paths import (
    STANDARD_STREAM,
    FileText,
    Paths,
    absolute_path,
    fill_in,
    find_presets,
)
from shapefit.errors import InputError, input_error, printable

Schema = type[CommandConfig]
Location = tuple[str | int, ...]
"""The keys and list positions that lead to a value."""

Places = dict[Location, str]
"""Where the key of a value, or an item of a list, stands, as a message names it."""

MAX_VALUES = 100_000
"""Aliases of aliases make more of them than memory holds, from a few lines."""

CORE = "tag:yaml.org,2002:"
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
    arguments: Mapping[str, Any] | None = None,
    *,
    prefix: str = "",
    stand_ins: Mapping[str, Any] | None = None,
) -> Any:
    """Return the checked config of a command: a file, then `overrides`, then
    `arguments`.

    `file` is a YAML file, `-`, or the name of an installed config; paths in it are
    relative to it, others to the working directory. `overrides` are texts `a.b=value`;
    `arguments` (`a.b` -> value) count unless None or (), and messages name them after
    `prefix`. `stand_ins` replace files, or, where they are None, fill keys of files
    that are not given. Raises InputError with every problem, each with its place.
    """
    schema, values, places = CONFIGS[command], dict[str, Any](), Places({(): command})
    if file is not None:
        values = _read_config(schema, command, file, places)
    for option in overrides:
        name, equals, text = option.partition("=")
        keys, origin = name.strip().split("."), f"--set {option}"
        if not equals or not all(keys):
            raise InputError(f"{origin}: expected key=value or key.key=value")
        _put(values, places, tuple(keys), read_yaml(text, origin), origin)
    for name, value in (arguments or {}).items():
        if value is not None and value != ():
            _put(values, places, tuple(name.split(".")), value, prefix + name)
    replaced = {
        k: v for k, v in (stand_ins or {}).items() if v is not None or k not in values
    }
    values |= dict.fromkeys(replaced, "-")
    if isinstance(data := values.get("data"), str):
        values = fill_in(values, str(absolute_path(data)))
    try:
        config = schema.model_validate(values, by_alias=True, by_name=False)
    except ValidationError as error:
        problems = error.errors()
        outer = {
            p["loc"][:-1] for p in problems if p["loc"]
        }  # a list without its wrong items
        lines = (
            _describe(schema, p, values, places)
            for p in problems
            if p["loc"] not in outer
        )
        raise InputError(dict.fromkeys(lines)) from None
    return config.model_copy(update=replaced)


def dump_config(config: CommandConfig) -> str:
    """Return the config as YAML with every default; it loads again to the same
    config.
    """
    from ruamel.yaml import YAML

    text = io.StringIO()
    YAML().dump(config.as_plain(), text)
    return text.getvalue()


def _read_config(
    schema: Schema, command: str, path: Path, places: Places
) -> dict[str, Any]:
    """Return the values of a YAML file, of standard input, or of an installed config.

    Of an installed config only the settings count, not what it says of its own data.
    """
    presets = find_presets(command)
    preset = None if path.is_file() else presets.get(str(path))
    name = "standard input" if path == STANDARD_STREAM else str(path)
    if (
        path.is_fifo() and path.parent.name != "fd"
    ):  # but <(...) of a shell is /dev/fd/63
        raise input_error(
            name, "is a pipe", "save the config to a file, or send it to -"
        )
    try:
        if path == STANDARD_STREAM:
            content = sys.stdin.buffer.read() if sys.stdin else b""
        else:
            content = (preset or path).read_bytes()
        values = read_yaml(
            content.decode("utf-8-sig"), name, places, Path.cwd() / path.parent
        )
    except UnicodeDecodeError:
        raise input_error(name, "not UTF-8 text", "save it as UTF-8") from None
    except OSError as error:
        names = ", ".join(["a YAML file", *presets])
        raise input_error(
            name, f"{error.strerror}".lower(), f"give one of: {names}"
        ) from None
    places[()] = f"{name}:1:1"
    if not isinstance(values, dict | None):
        fault = f"expected keys with values (key: value), found {_shown(values)}"
        raise InputError(f"{places[()]}: {fault}")
    values = values or {}
    for way, key in keys_of(schema).items() if preset is not None else ():
        if isinstance(key.description, Paths) or way[-1] in OF_ONE_DATA_SET:
            (values if len(way) == 1 else values.get(way[0], {})).pop(way[-1], None)
    return values


def read_yaml(
    text: str, name: str, places: Places | None = None, folder: Path = Path()
) -> Any:
    """Return the values of a YAML 1.2 text in a folder; `places` gets the line and
    column of each.

    Keys and dates are texts. Raises InputError, which names the text, and the line and
    column if there are places, for what is not YAML, for a key that stands twice, and
    for tags but those of the core schema.
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

    yaml, lines = YAML(typ="safe", pure=True), Places() if places is None else places

    def position(mark: Any) -> str:
        return name if places is None else f"{name}:{mark.line + 1}:{mark.column + 1}"

    def plain(node: Any, location: Location) -> Any:
        if len(lines) > MAX_VALUES:
            raise ValueError(
                f"more than {MAX_VALUES} values, aliases written out; write fewer"
            )
        kind = str(node.tag).removeprefix(CORE)
        if kind not in KINDS[type(node).__name__]:
            found = printable(node.tag).replace(CORE, "!!")
            raise InputError(
                f"{position(node.start_mark)}: the tag {found} has no meaning here;"
                " leave it out"
            )
        if isinstance(node.value, str):
            if any("\ud800" <= letter <= "\udfff" for letter in node.value):
                raise ValueError("half a letter, which no file can hold")
            if kind in ("int", "float", "bool", "null"):
                try:
                    return yaml.constructor.construct_object(node)
                except (ValueError, LookupError) as error:
                    where = position(node.start_mark)
                    raise InputError(
                        f"{where}: not valid YAML: {node.value!r} is no {kind}"
                    ) from error
            written = FileText(node.value)
            written.folder = folder
            return written
        items: dict[Any, Any] = {}
        for number, entry in enumerate(node.value):
            key, inner = (entry, entry) if kind == "seq" else entry
            step = number if kind == "seq" else str(key.value)
            place = lines[*location, step] = position(key.start_mark)
            if step in items:
                raise InputError(
                    f"{place}: not valid YAML: found duplicate key {step!r}"
                )
            items[step] = plain(inner, (*location, step))
        return list(items.values()) if kind == "seq" else items

    place = name if places is None else f"{name}:1:1"
    try:
        with warnings.catch_warnings():
            warnings.simplefilter(
                "ignore", YAMLWarning
            )  # on YAML 1.1, and repeated anchors
            root = yaml.compose(text)
            return None if root is None else plain(root, ())
    except MarkedYAMLError as error:
        mark, problem = (
            error.problem_mark or error.context_mark,
            error.problem or error.context,
        )
        place = position(mark) if mark else place
    except (YAMLError, ValueError, LookupError) as error:
        problem = str(error).splitlines()[0]
    except RecursionError:
        problem = "lists or mappings are nested too deeply, or an alias contains itself"
    raise InputError(f"{place}: not valid YAML: {problem}")


def _put(
    values: dict[str, Any],
    places: Places,
    keys: tuple[str, ...],
    value: Any,
    origin: str,
) -> None:
    """Set a value, in the place of the old one; `origin` names it in messages."""
    for depth, key in enumerate(keys[:-1], start=1):
        if not isinstance(values.get(key), dict):
            values[key] = {}
            places[keys[:depth]] = origin
        values = values[key]
    values[keys[-1]] = value
    for location in [other for other in places if other[: len(keys)] == keys]:
        del places[location]
    places[keys] = origin


def _describe(
    schema: Schema, problem: Any, values: Mapping[str, Any], places: Places
) -> str:
    """Return what is wrong, with its place and the nearest value or key that is
    right.
    """
    from shapefit.config.reference import expects, meaning

    location, kind, keys = problem["loc"], problem["type"], keys_of(schema)
    ways = [location[:depth] for depth in range(len(location), -1, -1)]
    located: Any = next(way for way in ways if way in places)
    if kind == "extra_forbidden":
        siblings = [way for way in keys if way[:-1] == location[:-1]]
        near = _nearest(
            location[-1], {way[-1]: ".".join(way) for way in [*keys, *siblings]}
        )
        names = ", ".join(way[-1] for way in siblings)
        hint = near or f"; the keys here are {names}"
        return f"{places[located]}: unknown key {'.'.join(location)!r}{hint}"
    if kind == "value_error":
        message = str(problem["ctx"]["error"])
        quoted = (name.partition(":")[0] for name in message.split("`")[1::2])
        named = ((*location, *name.split(".")) for name in quoted)
        return (
            f"{places[next((way for way in named if way in places), located)]}:"
            f" {message}"
        )
    of_key = next(way for way in ways if way in keys)
    key = keys[of_key]
    if kind == "missing" and of_key == location:
        return f"{places[located]}: missing key {key.name!r} ({meaning(key)})"
    value: Any = values
    for step in of_key if key.description else max(located, of_key, key=len):
        value = value[step]
    near = _nearest(
        str(value), {word: word for word in problem["msg"].split("'")[1::2]}
    )
    return f"{places[located]}: expected {expects(key)}, found {_shown(value)}{near}"


def _nearest(name: str, choices: Mapping[str, str]) -> str:
    """Return the end of a message with the choice like a name, if there is one."""
    from difflib import get_close_matches

    near = get_close_matches(name, choices, n=1)
    return f"; did you mean {choices[near[0]]!r}?" if near else ""


def _shown(value: Any) -> str:
    """Return a value as a message names it."""
    if isinstance(value, dict | list | tuple):
        return "a mapping" if isinstance(value, dict) else "a list"
    if isinstance(value, str):
        return f"{value!r:.200}"
    return "nothing" if value is None else str(value).lower()

"""From YAML files, `--set` options and arguments to a checked config, or every problem at once."""

from __future__ import annotations

import io
import os
import sys
import warnings
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from shapefit.config.commands import CONFIGS
from shapefit.config.model import CommandConfig, Location, keys_of
from shapefit.config.paths import (
    DATA,
    STANDARD_STREAM,
    Description,
    change_texts,
    find_presets,
    in_folder,
)
from shapefit.errors import InputError, input_error

Schema = type[CommandConfig]
Places = dict[Location, str]
"""Where the key of a value, or an item of a list, stands, as a message names it."""

MAX_VALUES = 100_000
"""Aliases of aliases make more of them than memory holds, from a few lines."""

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
    prefix: str = "",
    stand_ins: Mapping[str, Any] | None = None,
) -> Any:
    """Return the checked config of a command: a file, then `overrides`, then `arguments`.

    `file` is a YAML file, `-`, or the name of an installed config; paths in it are relative to it,
    others to the working directory. `overrides` are texts `a.b=value`; `arguments` (`a.b` -> value)
    count unless None or (), and messages name them after `prefix`. `stand_ins` replace files, or,
    where they are None, fill keys of files that are not given. Raises InputError with every
    problem, each with its place.
    """
    schema, places = CONFIGS[command], Places({(): command})
    values: dict[str, Any] = {}
    if file is not None:
        values, places = _read_config(schema, command, file)
    for option in overrides:
        way, equals, text = option.partition("=")
        set_keys, origin = tuple(way.strip().split(".")), f"--set {option}"
        if not equals or not all(set_keys):
            raise InputError(f"{origin}: expected key=value or key.key=value")
        text = "'-'" if text.strip() == "-" else text  # in YAML a list with nothing in it
        value, _ = read_yaml(text, origin, with_lines=False)
        for keys, inner in _leaves(schema, set_keys, value):
            _put(values, places, keys, inner, origin)
    for way, argument in (arguments or {}).items():
        for keys, inner in _leaves(schema, tuple(way.split(".")), argument):
            if inner is not None and inner != ():
                _put(values, places, keys, inner, prefix + ".".join(keys))
    replaced = {
        key: value
        for key, value in (stand_ins or {}).items()
        if value is not None or ((key,) in keys_of(schema) and key not in values)
    }
    values |= {key: "-" if key == "output" else os.devnull for key in replaced}
    if isinstance(data := values.get("data"), str):
        folder = os.path.abspath(os.path.expanduser(data))
        for owner, key, _ in _path_values(schema, values):
            owner[key] = change_texts(
                owner[key],
                lambda path: folder + path.removeprefix(DATA) if path.startswith(DATA) else path,
            )
    try:
        config = schema.model_validate(values, by_alias=True, by_name=False)
    except ValidationError as error:
        problems = error.errors()
        outer = {p["loc"][:depth] for p in problems for depth in range(len(p["loc"]))}
        lines = (_describe(schema, p, values, places) for p in problems if p["loc"] not in outer)
        raise InputError(dict.fromkeys(lines)) from None
    return config.model_copy(update=replaced)


def dump_config(config: CommandConfig) -> str:
    """Return the config as YAML with every default; it loads again to the same config."""
    from ruamel.yaml import YAML

    text = io.StringIO()
    YAML().dump(config.as_plain(), text)
    return text.getvalue()


def _read_config(schema: Schema, command: str, path: Path) -> tuple[dict[str, Any], Places]:
    """Return the values and places of a YAML file, of standard input, or of an installed config.

    Of an installed config only the settings count, not what it says of its own data.
    """
    presets = find_presets(command)
    preset = presets.get(str(path)) if not path.exists() or path.is_dir() else None
    name = "standard input" if path == STANDARD_STREAM else str(path)
    if path.is_fifo() and path.parent.name != "fd":  # but <(...) of a shell is /dev/fd/63
        raise input_error(name, "is a pipe", "save the config to a file, or send it to -")
    try:
        if path == STANDARD_STREAM:
            text = (sys.stdin.buffer.read() if sys.stdin else b"").decode("utf-8-sig")
        else:
            text = (preset or path).read_text("utf-8-sig")
    except UnicodeDecodeError:
        raise input_error(name, "not UTF-8 text", "save it as UTF-8") from None
    except OSError as error:
        others = f", or one of the installed configs: {', '.join(presets)}" if presets else ""
        fault = (error.strerror or "cannot be read").lower()
        raise input_error(name, fault, f"name a YAML file{others}") from None
    values, places = read_yaml(text, name)
    if not isinstance(values, dict | None):
        fault = f"expected keys with values (key: value), found {_shown(values)}"
        raise InputError(f"{name}:1:1: {fault}")
    values, places[()] = values or {}, f"{name}:1:1"
    for owner, key, field in _path_values(schema, values):
        if preset is None:
            owner[key] = in_folder(owner[key], Path.cwd() / path.parent, names=field.names)
        else:
            del owner[key]
    for owner in (values, values.get("camera", {})) if preset is not None else ():
        for key in OF_ONE_DATA_SET:
            owner.pop(key, None)
    return values, places


def read_yaml(text: str, name: str, *, with_lines: bool = True) -> tuple[Any, Places]:
    """Return the values of a YAML 1.2 text, named in messages, and the places of them.

    Keys, dates and whatever has another tag are texts. Raises InputError for what is not YAML, and
    for a key that stands twice.
    """
    from ruamel.yaml import YAML
    from ruamel.yaml.error import MarkedYAMLError, YAMLError, YAMLWarning

    yaml, places = YAML(typ="safe", pure=True), Places()

    def position(mark: Any) -> str:
        return f"{name}:{mark.line + 1}:{mark.column + 1}" if with_lines else name

    def plain(node: Any, location: Location) -> Any:
        if len(places) > MAX_VALUES:
            raise ValueError(f"more than {MAX_VALUES} values, aliases written out; write fewer")
        kind = str(node.tag).rpartition(":")[2]
        if isinstance(node.value, str):
            if any("\ud800" <= letter <= "\udfff" for letter in node.value):
                raise ValueError("half a letter, which no file can hold")
            is_text = kind not in ("int", "float", "bool", "null")
            return node.value if is_text else yaml.constructor.construct_object(node)
        items: dict[Any, Any] = {}
        for number, entry in enumerate(node.value):
            key, inner = (entry, entry) if kind == "seq" else entry
            step = number if kind == "seq" else str(key.value)
            place = places[*location, step] = position(key.start_mark)
            if step in items:
                raise InputError(f"{place}: not valid YAML: found duplicate key {step!r}")
            items[step] = plain(inner, (*location, step))
        return list(items.values()) if kind == "seq" else items

    first = f"{name}:1:1" if with_lines else name
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", YAMLWarning)  # on YAML 1.1, and repeated anchors
            root = yaml.compose(text)
            return (None if root is None else plain(root, ())), places
    except MarkedYAMLError as error:
        mark, problem = error.problem_mark or error.context_mark, error.problem or error.context
        first = position(mark) if mark else first
    except (YAMLError, ValueError) as error:
        problem = str(error).splitlines()[0]
    except RecursionError:
        problem = "lists or mappings are nested too deeply, or an alias contains itself"
    raise InputError(f"{first}: not valid YAML: {problem}")


def _leaves(
    schema: Schema, keys: tuple[str, ...], value: Any
) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Yield the keys and the value; of a mapping for a section those of each key in it."""
    key = keys_of(schema).get(keys)
    if isinstance(value, Mapping) and key is not None and key.section is not None:
        for name, inner in value.items():
            yield from _leaves(schema, (*keys, name), inner)
    else:
        yield keys, value


def _put(
    values: dict[str, Any], places: Places, keys: tuple[str, ...], value: Any, origin: str
) -> None:
    """Set a value, in the place of the old one; `origin` names it in messages."""
    for depth, key in enumerate(keys[:-1], start=1):
        values = values.setdefault(key, {})
        if not isinstance(values, dict):
            fault = f"{'.'.join(keys[:depth])} is {_shown(values)} and has no keys"
            raise InputError(f"{origin}: {fault}")
        places.setdefault(keys[:depth], origin)
    values[keys[-1]] = value
    for location in [other for other in places if other[: len(keys)] == keys]:
        del places[location]
    places[keys] = origin


def _path_values(
    schema: Schema, values: dict[str, Any]
) -> Iterator[tuple[dict[str, Any], str, Description]]:
    """Yield the mapping, the key and the description of each value that holds paths."""
    for (*above, last), key in keys_of(schema).items():
        owner: Any = values
        for name in above:
            owner = owner.get(name) if isinstance(owner, dict) else None
        field = key.mark(Description)
        if field is not None and field.paths and isinstance(owner, dict) and last in owner:
            yield owner, last, field


def _describe(schema: Schema, error: Any, values: Mapping[str, Any], places: Places) -> str:
    """Return what is wrong, with its place and the nearest value or key that is right."""
    from shapefit.config.reference import expects, meaning

    location, kind, keys = error["loc"], error["type"], keys_of(schema)
    ways = [location[:depth] for depth in range(len(location), -1, -1)]
    located: Any = next(way for way in ways if way in places)
    place = places[located]
    if kind == "extra_forbidden":
        *owner, last = location
        here = {way[-1]: key for way, key in keys.items() if way[:-1] == tuple(owner)}
        ways_to = {way[-1]: way for way in keys} | {name: (*owner, name) for name in here}
        near = _nearest(last, {name: ".".join(way) for name, way in ways_to.items()})
        near = near or f"; the keys here are {', '.join(n for n in here if here[n].listed)}"
        return f"{place}: unknown key {'.'.join(location)!r}{near}"
    if kind == "value_error":
        message = str(error["ctx"]["error"])
        names = (word.partition(":")[0] for word in message.split("`")[1::2])
        named = ((*location, *name.split(".")) for name in names)
        return f"{next((places[way] for way in named if way in places), place)}: {message}"
    of_key = next(way for way in ways if way in keys)
    key = keys[of_key]
    if kind == "missing" and of_key == location:
        return f"{place}: missing key {key.name!r} ({meaning(key)})"
    located = of_key if key.mark(Description) else located
    value: Any = values
    for step in located:
        value = value[step]
    choices = str(error.get("ctx", {}).get("expected", "")).split("'")[1::2]
    near = _nearest(str(value), {choice: choice for choice in choices})
    return f"{places[located]}: expected {expects(key)}, found {_shown(value)}{near}"


def _nearest(text: str, choices: Mapping[str, str]) -> str:
    """Return the end of a message that names the choice like a text, if there is one."""
    from difflib import get_close_matches

    nearest = get_close_matches(text, choices, n=1, cutoff=SIMILAR)
    return "".join(f"; did you mean {choices[name]!r}?" for name in nearest)


def _shown(value: Any) -> str:
    """Return a value as a message names it."""
    if isinstance(value, str):
        return repr(value) if len(value) <= 200 else f"{value[:200]!r}..."
    if isinstance(value, dict | list | tuple):
        return "a mapping" if isinstance(value, dict) else "a list"
    return "nothing" if value is None else str(value).lower()

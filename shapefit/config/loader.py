"""From YAML files, `--set` options and arguments to a checked config, or every problem at once."""

from __future__ import annotations

import io
import os
import sys
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from shapefit.config.commands import CONFIGS
from shapefit.config.model import CommandConfig, Location, keys_of
from shapefit.config.paths import (
    DATA,
    STANDARD_STREAM,
    Description,
    PathField,
    change_texts,
    find_presets,
    in_folder,
)
from shapefit.errors import InputError, input_error

Schema = type[CommandConfig]
Places = dict[Location, tuple[str, str]]
"""Where a key and its value stand, as a message names them."""

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
    """Return the checked config of a command.

    `file` is a YAML file, `-`, or the name of an installed config. `overrides` (each `a.b=value`)
    replace its values, and `arguments` (`a.b` -> value; None and () are not given) replace both;
    messages name an argument by its key, after `prefix`. Paths in the file are relative to the
    file, others to the working directory. `stand_ins` replace files, or, where they are None, fill
    keys of files that are not given. Raises InputError with every problem, each with its place.
    """
    schema = CONFIGS[command]
    values: dict[str, Any] = {}
    places: Places = {(): (command, command)}
    if file is not None:
        values, places = _read_config(schema, command, file)
    for option in overrides:
        keys, equals, text = option.partition("=")
        if not equals or not all(keys.strip().split(".")):
            raise InputError(f"--set {option}: expected key=value or key.key=value")
        text = "'-'" if text.strip() == "-" else text  # in YAML a list with nothing in it
        value, _ = read_yaml(text, f"--set {option}", with_lines=False)
        _put(values, places, tuple(keys.strip().split(".")), value, f"--set {option}")
    for location, value in _given(schema, arguments or {}):
        _put(values, places, location, value, prefix + ".".join(location))
    replaced = {
        key: value
        for key, value in (stand_ins or {}).items()
        if value is not None or ((key,) in keys_of(schema) and key not in values)
    }
    values |= {key: "-" if key == "output" else os.devnull for key in replaced}
    if isinstance(data := values.get("data"), str):
        folder = os.path.abspath(os.path.expanduser(data))
        for owner, key, _ in _paths(schema, values):
            owner[key] = change_texts(
                owner[key],
                lambda path: folder + path.removeprefix(DATA) if path.startswith(DATA) else path,
            )
    try:
        config = schema.model_validate(values, by_alias=True, by_name=False)
    except ValidationError as error:
        problems = error.errors()
        outer = {p["loc"][:depth] for p in problems for depth in range(len(p["loc"]))}
        innermost = (problem for problem in problems if problem["loc"] not in outer)
        raise InputError(
            dict.fromkeys(_describe(schema, problem, values, places) for problem in innermost)
        ) from None
    return config.model_copy(update=replaced)


def dump_config(config: CommandConfig) -> str:
    """Return the config as YAML with every default; it loads again to the same config."""
    from ruamel.yaml import YAML

    text = io.StringIO()
    YAML().dump(config.as_plain(), text)
    return text.getvalue()


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

    def plain(node: Any, location: Location, at: tuple[str, str]) -> Any:
        places[location] = at
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
            of_key, of_value = position(key.start_mark), position(inner.start_mark)
            if step in items:
                raise InputError(f"{of_key}: not valid YAML: found duplicate key {step!r}")
            is_empty = inner.value == "" and inner.style is None  # its mark is on another line
            at = (of_key, of_key if is_empty else of_value)
            items[step] = plain(inner, (*location, step), at)
        return list(items.values()) if kind == "seq" else items

    first = f"{name}:1:1" if with_lines else name
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", YAMLWarning)  # on YAML 1.1, and repeated anchors
            root = yaml.compose(text)
            return (None if root is None else plain(root, (), (first, first))), places
    except MarkedYAMLError as error:
        mark, problem = error.problem_mark or error.context_mark, error.problem or error.context
        first = position(mark) if mark else first
    except (YAMLError, ValueError) as error:
        problem = str(error).splitlines()[0]
    except RecursionError:
        problem = "lists or mappings are nested too deeply, or an alias contains itself"
    raise InputError(f"{first}: not valid YAML: {problem}")


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
            data = sys.stdin.buffer.read() if sys.stdin else b""
        else:
            data = (preset or path).read_bytes()
        text = data.decode("utf-8-sig")
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
    values = values or {}
    places[()] = (f"{name}:1:1",) * 2
    for owner, key, field in _paths(schema, values):
        if preset is None:
            owner[key] = in_folder(owner[key], Path.cwd() / path.parent, field)
        else:
            del owner[key]
    for owner in (values, values.get("camera", {})) if preset is not None else ():
        for key in OF_ONE_DATA_SET:
            owner.pop(key, None)
    return values, places


def _given(
    schema: Schema, arguments: Mapping[str, Any], above: tuple[str, ...] = ()
) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Yield the keys and the value of each argument; a mapping for a section sets what it has."""
    for key, value in arguments.items():
        keys = (*above, *key.split("."))
        if isinstance(value, Mapping) and keys in keys_of(schema) and keys_of(schema)[keys].section:
            yield from _given(schema, value, keys)
        elif value is not None and value != ():
            yield keys, value


def _put(
    values: dict[str, Any], places: Places, keys: tuple[str, ...], value: Any, origin: str
) -> None:
    """Set a value, in the place of the old one; `origin` names its argument."""
    for depth, key in enumerate(keys[:-1], start=1):
        values = values.setdefault(key, {})
        if not isinstance(values, dict):
            fault = f"{'.'.join(keys[:depth])} is {_shown(values)} and has no keys"
            raise InputError(f"{origin}: {fault}")
        places.setdefault(keys[:depth], (origin, origin))
    values[keys[-1]] = value
    for location in [other for other in places if other[: len(keys)] == keys]:
        del places[location]
    places[keys] = (origin, origin)


def _paths(
    schema: Schema, values: dict[str, Any]
) -> Iterator[tuple[dict[str, Any], str, PathField]]:
    """Yield the mapping, the key and the field of each value that holds paths."""
    for (*above, last), key in keys_of(schema).items():
        owner: Any = values
        for name in above:
            owner = owner.get(name) if isinstance(owner, dict) else None
        kind = key.mark(PathField)
        if kind is not None and isinstance(owner, dict) and last in owner:
            yield owner, last, kind


def _describe(schema: Schema, error: Any, values: Mapping[str, Any], places: Places) -> str:
    """Return what is wrong, with its place and the nearest value or key that is right."""
    from shapefit.config.reference import expects, meaning

    location, kind = error["loc"], error["type"]
    keys, depths = keys_of(schema), range(len(location), -1, -1)
    located = next(location[:depth] for depth in depths if location[:depth] in places)
    of_key: Any = next((location[:depth] for depth in depths if location[:depth] in keys), ())
    key = keys.get(of_key)
    at_key, at_value = places[located]
    if kind == "extra_forbidden":
        *above, last = map(str, location)
        here = {way[-1]: k for way, k in keys.items() if way[:-1] == tuple(above)}
        ways = {way[-1]: ".".join(way) for way in keys} | {n: ".".join((*above, n)) for n in here}
        near = _nearest(last, ways)
        near = (
            near or f"; the keys here are {', '.join(name for name in here if here[name].listed)}"
        )
        return f"{at_key}: unknown key {'.'.join((*above, last))!r}{near}"
    if kind == "missing" and key is not None and of_key == location:
        return f"{at_value}: missing key {location[-1]!r} ({meaning(key)})"
    if kind == "value_error":
        message = str(error["ctx"]["error"])
        names = [word.partition(":")[0] for word in message.split("`")[1::2]]
        ways_to = ((*location, *name.split(".")) for name in names)
        return f"{next((places[w][1] for w in ways_to if w in places), at_value)}: {message}"
    value: Any = values
    if key is None or (len(located) > len(of_key) and not key.mark(Description)):
        wanted = error["msg"].removeprefix("Input should be ")
    else:
        wanted, located = expects(key), of_key
        at_value = places.get(of_key, (at_value, at_value))[1]
    for step in located:
        value = value[step]
    choices = str(error.get("ctx", {}).get("expected", "")).split("'")[1::2]
    near = _nearest(str(value), dict(zip(choices, choices, strict=True)))
    return f"{at_value}: expected {wanted}, found {_shown(value)}{near}"


def _nearest(text: str, choices: Mapping[str, str]) -> str:
    """Return the end of a message that names the choice like a text, if there is one."""
    from difflib import get_close_matches

    nearest: Iterable[str] = get_close_matches(text, choices, n=1, cutoff=SIMILAR)
    return "".join(f"; did you mean {choices[name]!r}?" for name in nearest)


def _shown(value: Any) -> str:
    """Return a value as a message names it."""
    if isinstance(value, str):
        return repr(value) if len(value) <= 200 else f"{value[:200]!r}..."
    if isinstance(value, dict | list | tuple):
        return "a mapping" if isinstance(value, dict) else "a list"
    return "nothing" if value is None else str(value).lower()

"""The page of all config keys, written from the schema."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from pathlib import Path
from textwrap import wrap
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, NamedTuple, Union, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from shapefit.config.loader import CONFIGS
from shapefit.config.model import AutoField, expected, field_keys, is_hidden, meaning, submodel
from shapefit.errors import input_error

_INTRODUCTION = """\
# Config keys

Each command reads one YAML file (`-c`), in YAML 1.2: `1e-3` is a number and `no` is a string. \
`--set key=value` and `--set key.key=value` override the file; arguments override both.

- Paths in a file are relative to the file, paths on the command line to the working directory.
- A path to read may be a glob (`*`, `?`, `[...]`, `**`); it must match at least one file.
- `-` is standard input or output, as CSV.
- A path may begin with `{data}`: it is replaced by the folder that the key `data` names. Every
  command has this key.
- `-c NAME` stands for the command's own file of an installed folder: `-c cars` of `fit` is
  `configs/cars/fit.yaml`, and `-c sequences` is `configs/people/sequences.yaml`. An existing file
  of that name is preferred. Of an installed file what applies only to its own data is ignored:
  paths, `leave_one_out`, `camera.principal_point`, `match`, `groups` and `truth_frame`.
- `-d NAME`, or `dictionary: NAME` in a file, stands for an installed dictionary, such as `people`.
  An existing file of that name is preferred.
- `--print-config` prints the resolved config, with every default; `shapefit config COMMAND` prints
  what is on this page.
"""


def reference_page() -> str:
    """Return the page of all keys of all commands, as Markdown."""
    sections = [_section(command, model) for command, model in CONFIGS.items()]
    return "\n".join([_INTRODUCTION, *sections])


def keys_text(command: str, section: str = "", width: int = 80) -> str:
    """Return the keys of a command, or those of one section of it, for a terminal.

    Raises InputError where the command has no such section.
    """
    lines = []
    for key in find_rows(command, section):
        default = key.default if key.default == "required" else f"default {key.default}"
        lines += [f"{key.name}: {key.expects}; {default}".replace("`", "")]
        lines += [*wrap(key.meaning, width, initial_indent="    ", subsequent_indent="    ")]
    return "\n".join(lines) + "\n"


def find_rows(command: str, section: str = "") -> list[Key]:
    """Return the keys of a command, or those of one section; raises InputError for no section."""
    keys = [key for key in rows(CONFIGS[command]) if is_in(section, key.name)]
    if not keys:
        sections = dict.fromkeys(key.name.split(".")[0] for key in rows(CONFIGS[command]))
        found = f"there is no key or section '{section}'"
        raise input_error(f"config {command}", found, f"name one of: {', '.join(sections)}")
    return keys


def is_in(section: str, key: str) -> bool:
    """Whether a key is the section, or stands in it; all do where none is named."""
    return not section or f"{key}.".startswith(f"{section}.")


def _section(command: str, model: type[BaseModel]) -> str:
    table = "\n".join(
        f"| `{key.name}` | {key.expects} | {key.default} | {key.meaning} |" for key in rows(model)
    )
    return (
        f"## `{command}`\n\n{model.__doc__}\n\n"
        f"| key | expects | default | meaning |\n|---|---|---|---|\n{table}\n"
    )


class Key(NamedTuple):
    """A row of the page."""

    name: str
    expects: str
    default: str
    meaning: str


def rows(model: type[BaseModel], prefix: str = "") -> Iterator[Key]:
    """Yield a row for each key of a model, those of sections as `a.b`."""
    for key, field in field_keys(model).items():
        if key == "data" or is_hidden(field):
            continue
        inner = submodel(field)
        if inner is None or expected(field):
            yield Key(prefix + key, _expects(field), _default(field), meaning(model, key))
        else:
            yield from rows(inner, f"{prefix}{key}.")


_WORDS = {bool: "true or false", int: "a whole number", float: "a number", str: "a string"}
_PLURALS = {int: "whole numbers", float: "numbers", str: "strings"}
_BOUNDS = {"ge": ">=", "gt": ">", "le": "<=", "lt": "<"}


def _expects(field: FieldInfo) -> str:
    """Return what a field expects, such as `a whole number >= 1`."""
    words = expected(field) or _with_bounds(field.annotation, field.metadata)
    return f"{words} or auto" if _is_auto(field) else words


def _is_auto(field: FieldInfo) -> bool:
    return any(isinstance(entry, AutoField) for entry in field.metadata)


def _with_bounds(annotation: Any, metadata: Iterable[Any]) -> str:
    entries = [entry for each in metadata for entry in getattr(each, "metadata", (each,))]
    bounds = [
        f"{sign} {getattr(entry, name)}"
        for entry in entries
        for name, sign in _BOUNDS.items()
        if hasattr(entry, name)
    ]
    return f"{_kind(annotation)} {' and '.join(bounds)}".rstrip()


def _kind(annotation: Any) -> str:
    origin, arguments = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        return _with_bounds(arguments[0], arguments[1:])
    if origin in (Union, UnionType):
        return " or ".join(_kind(kind) for kind in arguments if kind is not NoneType)
    if origin is Literal:
        return " or ".join(arguments)
    if origin is tuple:
        plural = _PLURALS.get(arguments[0])
        return f"a list of {plural}" if plural else f"a list, each {_kind(arguments[0])}"
    if origin is not None:
        return f"a mapping to {_PLURALS[arguments[1]]}"
    return _WORDS[annotation]


def _default(field: FieldInfo) -> str:
    if field.is_required():
        return "required"
    default = field.get_default(call_default_factory=True)
    if isinstance(default, Path):
        return f"`{default.stem}`" if default.stem else "by the input"
    if default is None:
        return "`auto`" if _is_auto(field) else "none"
    return f"`{json.dumps(default)}`"

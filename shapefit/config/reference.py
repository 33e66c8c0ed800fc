"""What a schema says of its keys, in words: for messages, `shapefit config` and docs/config.md."""

from __future__ import annotations

import ast
import inspect
import json
import re
from collections.abc import Iterable, Iterator
from functools import cache
from itertools import pairwise
from pathlib import Path
from textwrap import dedent, wrap
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, NamedTuple, Union, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from shapefit.config.commands import CONFIGS
from shapefit.config.model import AutoField, field_keys, find_mark, is_listed, submodel
from shapefit.config.paths import Description
from shapefit.errors import input_error, listed

_WORDS = {int: "a whole number", float: "a number", str: "a text"}
_BOUNDS = {"ge": ">=", "gt": ">", "le": "<=", "lt": "<"}


class Row(NamedTuple):
    """A key: its name (`a.b` in a section), what it expects, its default and its meaning."""

    name: str
    expects: str
    default: str
    meaning: str


def find_rows(command: str, section: str = "") -> list[Row]:
    """Return the keys of a command, or those of one section; raises InputError for no section."""
    all_rows = list(rows(CONFIGS[command]))
    start = f"{section}." if section else ""
    selected = [row for row in all_rows if f"{row.name}.".startswith(start)]
    if not selected:
        sections = dict.fromkeys(row.name.partition(".")[0] for row in all_rows)
        fault = f"there is no key or section '{section}'"
        raise input_error(f"config {command}", fault, f"name one of: {', '.join(sections)}")
    return selected


def keys_text(command: str, section: str = "", width: int = 80) -> str:
    """Return the keys of a command, or those of one section of it, for a terminal."""
    lines = []
    for row in find_rows(command, section):
        default = row.default if row.default == "required" else f"default {row.default}"
        lines += [f"{row.name}: {row.expects}; {default}"]
        lines += [*wrap(row.meaning, width, initial_indent="    ", subsequent_indent="    ")]
    return "\n".join(lines) + "\n"


def rows(model: type[BaseModel], prefix: str = "") -> Iterator[Row]:
    """Yield a row for each listed key of a model, those of sections as `a.b`."""
    for key, field in field_keys(model).items():
        inner = submodel(field)
        if inner is not None:
            yield from rows(inner, f"{prefix}{key}.")
        elif is_listed(field) and key != "data":
            yield Row(prefix + key, expects(field), _default(field), meaning(model, key))


def _default(field: FieldInfo) -> str:
    if field.is_required():
        return "required"
    default = field.get_default(call_default_factory=True)
    if isinstance(default, Path):
        return default.stem or "by the input"
    if default is None:
        return "auto" if find_mark(field, AutoField) else "none"
    return json.dumps(default)


def expects(field: FieldInfo) -> str:
    """Return what a field expects, such as `a whole number >= 1`."""
    if inner := submodel(field):
        keys = [key for key, inside in field_keys(inner).items() if is_listed(inside)]
        return f"a mapping with the keys {', '.join(keys)}"
    if description := find_mark(field, Description):
        return description.phrase
    return _kind(field.annotation, field.metadata)


def _kind(annotation: Any, metadata: Iterable[Any] = ()) -> str:
    """Return the words for a type and its bounds."""
    auto = ["auto"] if any(isinstance(entry, AutoField) for entry in metadata) else []
    entries = [entry for each in metadata for entry in getattr(each, "metadata", (each,))]
    bounds = [
        f"{sign} {getattr(entry, bound)}"
        for entry in entries
        for bound, sign in _BOUNDS.items()
        if hasattr(entry, bound)
    ]
    words = listed(dict.fromkeys([*_alternatives(annotation), *auto]))
    return f"{words} {' and '.join(bounds)}".rstrip()


def _alternatives(annotation: Any) -> Iterator[str]:
    """Yield the words for each type of a union, and each value of a literal."""
    origin, arguments = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        yield _kind(arguments[0], arguments[1:])
    elif origin in (Union, UnionType):
        for kind in arguments:
            yield from _alternatives(kind)
    elif origin is Literal:
        yield from arguments
    elif origin is tuple:
        number = "" if Ellipsis in arguments else f"{len(arguments)} "
        yield f"a list of {number}{_plural(arguments[0])}"
    elif origin is not None:
        yield f"a mapping to {_plural(arguments[1])}"
    elif annotation is bool:
        yield from ("true", "false")
    elif annotation is not NoneType:
        yield _WORDS[annotation]


def _plural(annotation: Any) -> str:
    return re.sub("^a (whole number|number|text)", r"\1s", _kind(annotation))


def meaning(model: type[BaseModel], key: str) -> str:
    """Return what a key means: the text below its field, or that of its section."""
    name, field = next((n, f) for n, f in model.model_fields.items() if key == (f.alias or n))
    inner = submodel(field)
    text = field.description or _docstrings(model).get(name) or (inner.__doc__ if inner else "")
    return " ".join((text or "").split())


@cache
def _docstrings(model: type[BaseModel]) -> dict[str, str]:
    """Return the texts below the fields of a model and of its bases, by field.

    pydantic's `use_attribute_docstrings` finds the same, at every start: 30 ms for `fit`.
    """
    texts: dict[str, str] = {}
    for kind in reversed(model.__mro__):
        if kind.__module__.startswith("shapefit."):
            (body,) = ast.parse(dedent(inspect.getsource(kind))).body
            assert isinstance(body, ast.ClassDef)
            for field, text in pairwise(body.body):
                match field, text:
                    case (
                        ast.AnnAssign(target=ast.Name(id=name)),
                        ast.Expr(value=ast.Constant(value=str(about))),
                    ):
                        texts[name] = about
    return texts

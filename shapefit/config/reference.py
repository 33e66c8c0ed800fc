"""What a schema says of its keys, in words: for messages, `shapefit config` and docs/config.md."""

from __future__ import annotations

import ast
import inspect
import json
from collections.abc import Iterator, Sequence
from functools import cache
from itertools import pairwise
from pathlib import Path
from textwrap import dedent, wrap
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, NamedTuple, Union, get_args, get_origin

from pydantic import BaseModel

from shapefit.config.commands import CONFIGS
from shapefit.config.model import AUTO, Key, keys_of
from shapefit.config.paths import Description
from shapefit.errors import input_error, listed

WORDS = {int: "a whole number", float: "a number", str: "a text", bool: "true or false"}
PLURALS = {"a whole number": "whole numbers", "a number": "numbers", "a text": "texts"}
BOUNDS = {"ge": ">=", "gt": ">", "le": "<=", "lt": "<"}


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


def rows(model: type[BaseModel]) -> Iterator[Row]:
    """Yield a row for each listed key of a model, those of sections as `a.b`."""
    for way, key in keys_of(model).items():
        if key.section is None and key.listed and way != ("data",):
            yield Row(".".join(way), expects(key), _default(key), meaning(key))


def _default(key: Key) -> str:
    if key.field.is_required():
        return "required"
    default = key.field.get_default(call_default_factory=True)
    if isinstance(default, Path):
        return default.stem or "by the input"
    if default is None:
        return AUTO if AUTO in key.field.metadata else "none"
    return json.dumps(default)


def expects(key: Key) -> str:
    """Return what a key expects, such as `a whole number >= 1`."""
    if key.section is not None:
        names = [way[0] for way, inner in keys_of(key.section).items() if inner.listed]
        return f"a mapping with the keys {', '.join(names)}"
    description = key.mark(Description)
    return description.phrase if description else _words(key.field.annotation, key.field.metadata)


def _words(annotation: Any, metadata: Sequence[Any] = ()) -> str:
    """Return the words for a type and its bounds, for a union those of its types."""
    kinds = [annotation]
    if get_origin(annotation) in (Union, UnionType):
        kinds = [kind for kind in get_args(annotation) if kind is not NoneType]
    words = [word for kind in kinds for word in _kind_words(kind)]
    words += [AUTO] if AUTO in metadata else []
    flat = [inner for entry in metadata for inner in getattr(entry, "metadata", (entry,))]
    bounds = [f"{BOUNDS[n]} {getattr(b, n)}" for b in flat for n in BOUNDS if hasattr(b, n)]
    return f"{listed(words)} {' and '.join(bounds)}".rstrip()


def _kind_words(kind: Any) -> tuple[str, ...]:
    """Return the words for one type, or for each value of a literal."""
    origin, inner = get_origin(kind), get_args(kind)
    if origin is Annotated:
        return (_words(inner[0], inner[1:]),)
    if origin is Literal:
        return inner
    if origin is None:
        return tuple(WORDS[kind].split(" or "))
    values = _words(inner[0] if origin is tuple else inner[1])
    for word, plural in PLURALS.items():
        values = values.replace(word, plural)
    if origin is tuple:
        return (f"a list of {values}" if Ellipsis in inner else f"a list of {len(inner)} {values}",)
    return (f"a mapping to {values}",)


def meaning(key: Key) -> str:
    """Return what a key means: the text below its field, or that of its section."""
    text = key.field.description or _docstrings(key.owner).get(key.name)
    return " ".join((text or str(key.section and key.section.__doc__)).split())


@cache
def _docstrings(model: type[BaseModel]) -> dict[str, str]:
    """Return the texts below the fields of a model and of its bases, by field.

    pydantic's `use_attribute_docstrings` reads the same, at every start: 30 ms for `fit`.
    """
    texts: dict[str, str] = {}
    for kind in reversed(model.__mro__):
        if kind.__module__.startswith("shapefit."):
            (definition,) = ast.parse(dedent(inspect.getsource(kind))).body
            for node, text in pairwise(definition.body):  # type: ignore[attr-defined]
                if isinstance(node, ast.AnnAssign) and isinstance(text, ast.Expr):
                    texts[node.target.id] = text.value.value  # type: ignore[attr-defined, union-attr]
    return texts

"""What a schema says of its keys in words, for messages and docs/config.md."""

from __future__ import annotations

import ast
import inspect
import json
from collections.abc import Sequence
from functools import cache
from itertools import pairwise
from pathlib import Path
from textwrap import dedent
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, NamedTuple, Union, get_args, get_origin

from pydantic import BaseModel

from shapefit.config.model import AUTO_TEXT, ConfigKey, list_config_keys
from shapefit.errors import input_error, listed

WORDS = {int: "a whole number", float: "a number", str: "a text", bool: "true or false"}
BOUNDS = {"ge": ">=", "gt": ">", "le": "<=", "lt": "<"}


class KeyInWords(NamedTuple):
    """A key: its name (`a.b` in a section), what it expects, default and meaning."""

    name: str
    expects: str
    default: str
    meaning: str


def describe_keys(model: type[BaseModel], section: str = "") -> list[KeyInWords]:
    """Describe in words each key of a model except `data`, or of one section of it.

    Raises InputError where there is no such section.
    """
    table = [
        KeyInWords(".".join(path), expects(key), _default(key), meaning(key))
        for path, key in list_config_keys(model).items()
        if key.section is None and path != ("data",)
    ]
    if not section:
        return table
    selected = [row for row in table if f"{row.name}.".startswith(f"{section}.")]
    if not selected:
        names = ", ".join(dict.fromkeys(row.name.partition(".")[0] for row in table))
        fault = f"there is no key or section '{section}'"
        raise input_error("config", fault, f"name one of: {names}")
    return selected


def _default(key: ConfigKey) -> str:
    """Return a key's default in words: JSON, or `required`, `auto`, `none` and such.

    A path is called by its name without ending, or `by the input`.
    """
    if key.field.is_required():
        return "required"
    default = key.field.get_default(call_default_factory=True)
    if isinstance(default, Path):
        return default.stem or "by the input"
    if default is not None:
        return json.dumps(default)
    return AUTO_TEXT if AUTO_TEXT in key.field.metadata else "none"


def expects(key: ConfigKey) -> str:
    """Say which values a key accepts, such as `a whole number >= 1`."""
    if key.section is not None:
        names = [path[0] for path in list_config_keys(key.section)]
        return f"a mapping with the keys {', '.join(names)}"
    if key.description:
        return key.description.phrase
    return _phrase(key.field.annotation, key.field.metadata)


def _phrase(annotation: object, metadata: Sequence[object] = ()) -> str:
    """Describe a type and its bounds in words, such as `a whole number >= 1`."""
    words = _words(annotation)
    if AUTO_TEXT in metadata:
        words.append(AUTO_TEXT)
    flat = [
        inner for entry in metadata for inner in getattr(entry, "metadata", (entry,))
    ]
    bounds = [
        f"{sign} {getattr(bound, name)}"
        for bound in flat
        for name, sign in BOUNDS.items()
        if hasattr(bound, name)
    ]
    return f"{listed(words)} {' and '.join(bounds)}".rstrip()


def _words(kind: Any) -> list[str]:
    """Return the words for a type, each type of a union, or each value of a literal."""
    origin = get_origin(kind)
    inner = get_args(kind)
    if origin in (Union, UnionType):
        return [word for part in inner if part is not NoneType for word in _words(part)]
    if origin is Annotated:
        return [_phrase(inner[0], inner[1:])]
    if origin is Literal:
        return list(inner)
    if origin is tuple:
        number = "" if Ellipsis in inner else f" of {len(inner)} items"
        return [f"a list{number}, each {_phrase(inner[0])}"]
    if origin is not None:
        return [f"a mapping to values, each {_phrase(inner[1])}"]
    return WORDS[kind].split(" or ")


def words_of(key: ConfigKey) -> list[str]:
    """Return the words that a key may have as its value, such as auto; [] for none."""
    words = _literals(key.field.annotation)
    return [*words, AUTO_TEXT] if AUTO_TEXT in key.field.metadata else words


def _literals(kind: object) -> list[str]:
    """Return the texts that a type, or a type of a union, allows as literals."""
    if get_origin(kind) is Literal:
        return list(get_args(kind))
    if get_origin(kind) in (Union, UnionType, Annotated):
        return [word for part in get_args(kind) for word in _literals(part)]
    return []


def meaning(key: ConfigKey) -> str:
    """Return what a key means: the text below its field, or that of its section."""
    text = key.field.description or _docstrings(key.owner).get(key.name)
    if not text and key.section is not None:
        text = key.section.__doc__
    return " ".join(str(text).split())


@cache
def _docstrings(model: type[BaseModel]) -> dict[str, str]:
    """Return the docstrings of the fields of a model and of its bases, by field.

    pydantic's `use_attribute_docstrings` reads the same, at every start: 30 ms for
    `fit`.
    """
    texts: dict[str, str] = {}
    for kind in reversed(model.__mro__):
        if kind.__module__.startswith("shapefit."):
            (definition,) = ast.parse(dedent(inspect.getsource(kind))).body
            for node, text in pairwise(definition.body):  # type: ignore[attr-defined]
                if isinstance(node, ast.AnnAssign) and isinstance(text, ast.Expr):
                    texts[node.target.id] = text.value.value  # type: ignore[attr-defined, union-attr]
    return texts

"""What a schema says of its fields: the keys, the words for what each expects, their places."""

from __future__ import annotations

import ast
import inspect
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from itertools import pairwise
from types import NoneType, UnionType
from typing import Any, Literal, NamedTuple, Union, get_args, get_origin

from annotated_types import Ge, Gt, Le, Lt
from pydantic import BaseModel
from pydantic.fields import FieldInfo

Location = tuple[str | int, ...]
"""The keys and list positions that lead to a value."""


class Place(NamedTuple):
    """Where a key and its value stand, as a message names them."""

    key: str
    value: str


@dataclass(frozen=True)
class Expected:
    """Annotation metadata: the words for a field whose type alone does not say them well."""

    phrase: str


_WORDS = {bool: "true or false", int: "a whole number", float: "a number", str: "a string"}
_PLURALS = {int: "whole numbers", float: "numbers", str: "strings"}


def expectation(field: FieldInfo) -> str:
    """Return what the field expects, such as `a whole number >= 1`."""
    return (
        in_words(field)
        or f"{_type_words(field.annotation)} {' and '.join(_bounds(field.metadata))}".rstrip()
    )


def in_words(field: FieldInfo) -> str | None:
    """Return the words that were given for what the field expects, None where its type says it."""
    return next((entry.phrase for entry in field.metadata if isinstance(entry, Expected)), None)


def _type_words(annotation: Any) -> str:
    origin, arguments = get_origin(annotation), get_args(annotation)
    if origin in (Union, UnionType):
        return " or ".join(_type_words(kind) for kind in arguments if kind is not NoneType)
    if origin is Literal:
        return " or ".join(arguments)
    if origin is tuple:
        if arguments[0] in _PLURALS:
            return f"a list of {_PLURALS[arguments[0]]}"
        return f"a list, each {_type_words(arguments[0])}"
    if isinstance(origin, type) and issubclass(origin, Mapping):
        return f"a mapping to {_PLURALS.get(arguments[1]) or _type_words(arguments[1])}"
    if issubclass(annotation, BaseModel):
        return f"a mapping with the keys {', '.join(field_keys(annotation))}"
    return _WORDS[annotation]


def _bounds(metadata: Iterable[Any]) -> Iterator[str]:
    for entry in metadata:
        match entry:
            case Ge(ge=bound):
                yield f">= {bound}"
            case Gt(gt=bound):
                yield f"> {bound}"
            case Le(le=bound):
                yield f"<= {bound}"
            case Lt(lt=bound):
                yield f"< {bound}"


def field_keys(model: type[BaseModel]) -> dict[str, FieldInfo]:
    """Return the fields of a model under the keys that YAML uses for them."""
    return {field.alias or name: field for name, field in model.model_fields.items()}


def meaning(model: type[BaseModel], key: str) -> str:
    """Return what a key means: its description, the text below it, or that of its section."""
    name, field = next(
        (name, field) for name, field in model.model_fields.items() if key == (field.alias or name)
    )
    own = [kind for kind in model.__mro__ if kind.__module__.startswith("shapefit.")]
    texts = (_texts(kind.__module__).get((kind.__name__, name)) for kind in own)
    inner = submodel(field)
    text = field.description or next(filter(None, texts), inner.__doc__ if inner else "")
    return " ".join((text or "").split())


@cache
def _texts(module: str) -> dict[tuple[str, str], str]:
    """Return the texts below the fields of the classes of a module, by class and name of field."""
    tree = ast.parse(inspect.getsource(import_module(module)))
    return {
        (kind.name, field.target.id): text.value.value
        for kind in tree.body
        if isinstance(kind, ast.ClassDef)
        for field, text in pairwise(kind.body)
        if isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name)
        if isinstance(text, ast.Expr) and isinstance(text.value, ast.Constant)
        if isinstance(text.value.value, str)
    }


def submodel(field: FieldInfo) -> type[BaseModel] | None:
    """Return the model of a field that is a mapping with known keys, or None if it is not."""
    kinds = [field.annotation]
    if get_origin(field.annotation) in (Union, UnionType):
        kinds = [kind for kind in get_args(field.annotation) if kind is not NoneType]
    kind = kinds[0]
    return kind if isinstance(kind, type) and issubclass(kind, BaseModel) else None


def dotted_keys(model: type[BaseModel], prefix: str = "") -> Iterator[str]:
    """Yield all keys of a model, those of sections with the section before them: `a.b`."""
    for key, field in field_keys(model).items():
        yield prefix + key
        inner = submodel(field)
        if inner is not None:
            yield from dotted_keys(inner, f"{prefix}{key}.")


def marked_keys(model: type[BaseModel], *marks: type) -> dict[str, Any]:
    """Return the keys of a model with one of these marks -> those within them; {} for none."""
    keys: dict[str, Any] = {}
    for key, field in field_keys(model).items():
        inner = submodel(field)
        marked = any(isinstance(entry, marks) for entry in field.metadata)
        within = {} if inner is None else marked_keys(inner, *marks)
        if within or marked:
            keys[key] = within
    return keys

"""What every config has in common."""

from __future__ import annotations

import ast
import inspect
import json
from collections.abc import Callable, Iterable, Iterator, Mapping
from copy import copy
from functools import cache
from importlib import import_module
from itertools import pairwise
from pathlib import Path
from types import NoneType, UnionType
from typing import (
    Annotated,
    Any,
    ClassVar,
    Literal,
    NamedTuple,
    Optional,
    Self,
    Union,
    get_args,
    get_origin,
)

from annotated_types import Ge, Gt, Le, Lt
from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ValidationError,
    WrapValidator,
    create_model,
    model_validator,
)
from pydantic.fields import FieldInfo
from pydantic_core import PydanticCustomError

from shapefit.config.paths import STANDARD_STREAM, Expected, Folder, ResultFolder
from shapefit.errors import path_text
from shapefit.stores import MASK, STORAGE_OPTIONS, real_path

Location = tuple[str | int, ...]
"""The keys and list positions that lead to a value."""


class Place(NamedTuple):
    """Where a key and its value stand, as a message names them."""

    key: str
    value: str


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


def _tuples(value: Any) -> Any:
    return tuple(_tuples(item) for item in value) if isinstance(value, list) else value


def _options(value: Any) -> Any:
    if not isinstance(value, Mapping):  # which may be a secret: it is not repeated
        raise ValueError(f"`{STORAGE_OPTIONS}` should be a mapping of options to values")
    return value


FromLists = BeforeValidator(_tuples)
"""Annotation metadata: lists (of lists ...) become tuples, so that a config cannot change."""


def _as_a_whole(value: Any, check: Callable[[Any], Any]) -> Any:
    try:
        return check(value)
    except ValidationError:
        raise PydanticCustomError("whole", "not one of these") from None


AS_A_WHOLE = WrapValidator(_as_a_whole)
"""Annotation metadata: of a field that takes several kinds of values, one problem is reported, with
the words that it is expected by."""

Renaming = Mapping[str, str]
"""Names of landmarks as files have them -> names that they are matched by."""

MOST_STEPS = 1_000_000
"""Rounds or iterations that nobody waits for; some are counted in memory that is got beforehand."""

MOST_THREADS = 1024

Height = Annotated[
    float | None, Field(gt=0, le=3), Expected("a height in metres, > 0 and at most 3, such as 1.78")
]
"""Of a body or object; one in centimetres would make a giant."""

Plots = Annotated[bool | Literal["auto"], Expected("true, false or auto")]
"""Whether plots are drawn."""


class ConfigModel(BaseModel):
    """A frozen mapping of known keys; nothing is converted silently ("3" is not a number).

    COMMAND is whose config it is.

    A section's default is its `model_construct`: to validate what is known to be valid would build
    the schema of the section once more.
    """

    COMMAND: ClassVar[str] = ""

    model_config = ConfigDict(
        frozen=True,
        extra="forbid",
        strict=True,
        allow_inf_nan=False,
        validate_by_name=True,
        validate_by_alias=True,
        serialize_by_alias=True,
        defer_build=True,  # a section is built within its config, once
    )


def section(model: type[ConfigModel]) -> Any:
    """Return the field of a section, which by default has its own defaults."""
    return Field(default_factory=model.model_construct)


class CommandConfig(ConfigModel):
    """Everything that can be set for one command."""

    data: Folder = None
    """Folder that replaces `{data}` at the beginning of any other path."""

    storage_options: Annotated[Mapping[str, Any], BeforeValidator(_options)] = Field(
        default_factory=dict, repr=False
    )
    """Options for s3:// and gs:// URLs beside what the environment says, as fsspec takes them: a
    mapping such as {endpoint_url: ...}. Shown as *** everywhere."""

    @model_validator(mode="after")
    def _keeps_its_inputs(self) -> Self:
        """Refuse an output that would take the place of an input."""
        output = getattr(self, "output", None) or STANDARD_STREAM
        output = output.manifest if isinstance(output, ResultFolder) else output
        for _, path in self.inputs():
            if path != STANDARD_STREAM and real_path(path) == real_path(output):
                raise ValueError(f"`output` would replace an input, {path}; name another file")
        return self

    def inputs(self) -> Iterator[tuple[str, Path]]:
        """Yield the files to read, those in sections aside, each with its key."""
        for key in type(self).model_fields:
            if key not in ("output", "data", STORAGE_OPTIONS):
                for path in _paths((getattr(self, key),)):
                    yield key, path

    def as_json(self) -> str:
        """Return the config as one line of JSON, with every default."""
        return json.dumps(self.as_plain(), ensure_ascii=False, separators=(",", ":"))

    def as_plain(self) -> dict[str, Any]:
        """Return the config as JSON has it, for others to see.

        A path that is not UTF-8 has escapes (`path_text`), and the storage options are masked.
        """
        values: dict[str, Any] = plain(self.model_dump(), path_text)
        return values


def with_all_optional(model: type[CommandConfig]) -> type[CommandConfig]:
    """Return a model whose required keys may be missing, and are None where they are."""
    optional: dict[str, Any] = {}
    for name, field in model.model_fields.items():
        if field.is_required():
            optional[name] = (Optional[field.annotation], copy(field))  # noqa: UP045
            optional[name][1].default = None
    changed: type[CommandConfig] = create_model(model.__name__, __base__=model, **optional)
    return changed


def plain(value: Any, text: Callable[[Path], str]) -> Any:
    """Return a value of a config as YAML or JSON has it, with `text` for each path."""
    if isinstance(value, Path):
        return text(value)
    if isinstance(value, Mapping):
        return {
            key: dict.fromkeys(inner, MASK) if key == STORAGE_OPTIONS else plain(inner, text)
            for key, inner in value.items()
        }
    if isinstance(value, tuple | list):
        return [plain(item, text) for item in value]
    return value


def _paths(values: Iterable[Any]) -> Iterator[Path]:
    """Yield the paths in values, tuples and mappings of them."""
    for value in values:
        if isinstance(value, Path):
            yield value
        elif isinstance(value, tuple):
            yield from _paths(value)
        elif isinstance(value, Mapping):
            yield from _paths(value.values())

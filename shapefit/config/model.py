"""What every config has in common, and what can be asked of a schema."""

from __future__ import annotations

import ast
import inspect
import json
from collections.abc import Callable, Iterator, Mapping
from copy import copy
from functools import cache
from itertools import pairwise
from pathlib import Path
from textwrap import dedent
from types import NoneType
from typing import Annotated, Any, ClassVar, Literal, Optional, Self, get_args

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    create_model,
    model_validator,
)
from pydantic.fields import FieldInfo

from shapefit.config.paths import STANDARD_STREAM, Expected, Folder, ResultFolder
from shapefit.errors import path_text
from shapefit.stores import MASK, STORAGE_OPTIONS, real_path

MOST_STEPS = 1_000_000
"""Rounds or iterations that nobody waits for; some are counted in memory that is got beforehand."""

MOST_THREADS = 1024

Keys = tuple[str, ...]


def _tuples(value: Any) -> Any:
    return tuple(_tuples(item) for item in value) if isinstance(value, list) else value


def _options(value: Any) -> Any:
    if not isinstance(value, Mapping):  # which may be a secret: it is not repeated
        raise ValueError(f"`{STORAGE_OPTIONS}` should be a mapping of options to values")
    return value


FromLists = BeforeValidator(_tuples)
"""Annotation metadata: lists (of lists ...) become tuples, so that a config cannot change."""

Renaming = Mapping[str, str]
"""Names of landmarks as files have them -> names that they are matched by."""

Height = Annotated[
    float | None, Field(gt=0, le=3), Expected("a height in metres, > 0 and at most 3, such as 1.78")
]
"""Of a body or object; one in centimetres would make a giant."""

Plots = Annotated[bool | Literal["auto"], Expected("true, false or auto")]
"""Whether plots are drawn."""


class ConfigModel(BaseModel):
    """A frozen mapping of known keys; nothing is converted silently ("3" is not a number).

    COMMAND is whose config it is. A section's default is its `model_construct`: to validate what
    is known to be valid would build the schema of the section once more.
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
                for path in _paths(getattr(self, key)):
                    yield key, path

    def changed(self, **values: Any) -> Self:
        """Return the config with other values, unchecked; those of a section as a mapping."""
        old = {key: getattr(self, key) for key in values}
        changes = {
            key: old[key].model_copy(update=value) if isinstance(old[key], ConfigModel) else value
            for key, value in values.items()
        }
        return self.model_copy(update=changes)

    def as_json(self) -> str:
        """Return the config as one line of JSON, with every default."""
        return json.dumps(self.as_plain(), ensure_ascii=False, separators=(",", ":"))

    def as_plain(self) -> dict[str, Any]:
        """Return the config as JSON has it, for others to see.

        A path that is not UTF-8 has escapes (`path_text`), and the storage options are masked.
        """
        values: dict[str, Any] = plain(self.model_dump(), path_text)
        return values


def plain(value: Any, text: Callable[[Path], str]) -> Any:
    """Return a value of a config as YAML or JSON has it, with `text` for each path."""
    if isinstance(value, Path):
        return text(value)
    if isinstance(value, Mapping):
        return {
            key: dict.fromkeys(inner, MASK) if key == STORAGE_OPTIONS else plain(inner, text)
            for key, inner in value.items()
        }
    return [plain(item, text) for item in value] if isinstance(value, tuple | list) else value


def _paths(value: Any) -> Iterator[Path]:
    """Yield the paths in a value: itself, or those in tuples and mappings."""
    if isinstance(value, Path):
        yield value
    elif isinstance(value, tuple | Mapping):
        for inner in value.values() if isinstance(value, Mapping) else value:
            yield from _paths(inner)


def with_all_optional(model: type[CommandConfig]) -> type[CommandConfig]:
    """Return a model whose required keys may be missing, and are None where they are."""
    optional: dict[str, Any] = {}
    for name, field in model.model_fields.items():
        if field.is_required():
            optional[name] = (Optional[field.annotation], copy(field))  # noqa: UP045
            optional[name][1].default = None
    changed: type[CommandConfig] = create_model(model.__name__, __base__=model, **optional)
    return changed


def field_keys(model: type[BaseModel]) -> dict[str, FieldInfo]:
    """Return the fields of a model under the keys that YAML uses for them."""
    return {field.alias or name: field for name, field in model.model_fields.items()}


def submodel(field: FieldInfo) -> type[BaseModel] | None:
    """Return the model of a field that is a mapping with known keys, or None if it is not."""
    kinds = [kind for kind in get_args(field.annotation) if kind is not NoneType]
    kind = kinds[0] if kinds else field.annotation
    return kind if isinstance(kind, type) and issubclass(kind, BaseModel) else None


def expected(field: FieldInfo) -> str | None:
    """Return the words that were given for what the field expects, None where its type says it."""
    return next((entry.phrase for entry in field.metadata if isinstance(entry, Expected)), None)


def all_fields(model: type[BaseModel], above: Keys = ()) -> Iterator[tuple[Keys, FieldInfo]]:
    """Yield all fields of a model, sections before what is in them, each with the way to it."""
    for key, field in field_keys(model).items():
        yield (*above, key), field
        if (inner := submodel(field)) is not None:
            yield from all_fields(inner, (*above, key))


def dotted_keys(model: type[BaseModel]) -> Iterator[str]:
    """Yield all keys of a model, those of sections with the section before them: `a.b`."""
    return (".".join(keys) for keys, _ in all_fields(model))


def marked_keys(model: type[BaseModel], *marks: type) -> list[Keys]:
    """Return the ways to the fields of a model that have one of these marks."""
    fields = all_fields(model)
    return [keys for keys, field in fields if any(isinstance(m, marks) for m in field.metadata)]


def meaning(model: type[BaseModel], key: str) -> str:
    """Return what a key means: the text below its field, or that of its section."""
    name, field = next((n, f) for n, f in model.model_fields.items() if key == (f.alias or n))
    inner = submodel(field)
    text = field.description or _docstrings(model).get(name) or (inner.__doc__ if inner else "")
    return " ".join((text or "").split())


@cache
def _docstrings(model: type[BaseModel]) -> dict[str, str]:
    """Return the texts below the fields of a model and of those that it builds on, by field.

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
                        ast.Expr(value=ast.Constant(value=str(said))),
                    ):
                        texts[name] = said
    return texts

"""What every config has in common, and a walk through the fields of a schema."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, ClassVar, Self, TypeVar

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    PlainSerializer,
    model_validator,
)
from pydantic.fields import FieldInfo

from shapefit.config.paths import STANDARD_STREAM, UNNAMED, OptionalPath, ResultFolder
from shapefit.errors import path_text

MAX_THREADS = 1024

Location = tuple[str | int, ...]
"""The keys and list positions that lead to a value."""


def _tuples(value: Any) -> Any:
    return tuple(_tuples(item) for item in value) if isinstance(value, list) else value


FromLists = BeforeValidator(_tuples)
"""Annotation metadata: lists (of lists ...) become tuples, so that a config cannot change."""


class Hidden:
    """Annotation metadata: a key of experiments, which no page lists."""


HIDDEN = Hidden()

Value = TypeVar("Value")
Mark = TypeVar("Mark")


class AutoField:
    """Annotation metadata: None inside is `auto` in YAML."""


Auto = Annotated[
    Value | None,
    AutoField(),
    BeforeValidator(lambda value: None if value == "auto" else value),
    PlainSerializer(lambda value: "auto" if value is None else value),
]
"""A value, or `auto`, which is None inside."""


class ConfigModel(BaseModel):
    """A frozen mapping of known keys; nothing is converted silently ("3" is not a number).

    A section's default is its `model_construct`: to validate what is known to be valid would build
    the schema of the section once more.
    """

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
    """Everything that can be set for one command; COMMAND is its name."""

    COMMAND: ClassVar[str] = ""
    OUTPUT: ClassVar[str] = ""
    """End of the name of an output that is not given, after the name of the first input."""

    data: OptionalPath = None
    """Folder that replaces `{data}` at the beginning of any other path."""

    @model_validator(mode="after")
    def _names_its_output(self) -> Self:
        """Name the output after the first input where it is not given."""
        if self.OUTPUT and getattr(self, "output", None) == UNNAMED:
            files = [path for _, path in self.inputs() if path != STANDARD_STREAM]
            stem = files[0].name.partition(".")[0] or "standard" if files else "standard"
            output = Path.cwd() / f"{stem}{self.OUTPUT}"
            if any(output == path for path in files):
                output = output.with_name(f"{stem}_result{output.suffix}")
            object.__setattr__(self, "output", output)
        return self

    @model_validator(mode="after")
    def _keeps_its_inputs(self) -> Self:
        """Refuse an output that would take the place of an input."""
        output = getattr(self, "output", None) or STANDARD_STREAM
        output = output.manifest if isinstance(output, ResultFolder) else output
        for _, path in self.inputs():
            if path != STANDARD_STREAM and os.path.realpath(path) == os.path.realpath(output):
                raise ValueError(f"`output` would replace an input, {path}; name another file")
        return self

    def inputs(self) -> Iterator[tuple[str, Path]]:
        """Yield the files to read, except those of sections, each with its key."""
        for key in type(self).model_fields:
            if key not in ("output", "data"):
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
        """Return the config as JSON has it; a path that is not UTF-8 has escapes (`path_text`)."""
        values: dict[str, Any] = plain(self.model_dump(warnings=False), path_text)
        return values


def plain(value: Any, text: Callable[[Path], str]) -> Any:
    """Return a value of a config as YAML or JSON has it, with `text` for each path."""
    if isinstance(value, Path):
        return text(value)
    if isinstance(value, Mapping):
        return {key: plain(inner, text) for key, inner in value.items()}
    return [plain(item, text) for item in value] if isinstance(value, tuple | list) else value


def _paths(value: Any) -> Iterator[Path]:
    """Yield the paths in a value: itself, or those in tuples and mappings."""
    if isinstance(value, Path):
        yield value
    elif isinstance(value, tuple | Mapping):
        for inner in value.values() if isinstance(value, Mapping) else value:
            yield from _paths(inner)


def field_keys(model: type[BaseModel]) -> dict[str, FieldInfo]:
    """Return the fields of a model under the keys that YAML uses for them."""
    return {field.alias or name: field for name, field in model.model_fields.items()}


def submodel(field: FieldInfo) -> type[BaseModel] | None:
    """Return the model of a field that is a section, or None if it is not."""
    kind = field.annotation
    return kind if isinstance(kind, type) and issubclass(kind, BaseModel) else None


def all_fields(
    model: type[BaseModel], above: tuple[str, ...] = ()
) -> Iterator[tuple[tuple[str, ...], FieldInfo]]:
    """Yield all fields of a model, sections before what is in them, each with its keys."""
    for key, field in field_keys(model).items():
        yield (*above, key), field
        if (inner := submodel(field)) is not None:
            yield from all_fields(inner, (*above, key))


def field_at(
    model: type[BaseModel], location: Location
) -> tuple[type[BaseModel], Location, FieldInfo | None]:
    """Return the field that `location` is or lies in (None if unknown), its owner and location."""
    owner, field = model, None
    for depth, key in enumerate(map(str, location), start=1):
        field = field_keys(owner).get(key)
        inner = None if field is None else submodel(field)
        if inner is None or depth == len(location):
            return owner, location[:depth], field
        owner = inner
    return owner, (), None


def find_mark(field: FieldInfo, mark: type[Mark]) -> Mark | None:
    """Return the annotation metadata of a type that a field has, if any."""
    return next((entry for entry in field.metadata if isinstance(entry, mark)), None)


def is_listed(field: FieldInfo) -> bool:
    """Whether pages and messages list a key; those of experiments they do not."""
    return find_mark(field, Hidden) is None

"""What every config has in common, and the keys of a schema."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Annotated, Any, ClassVar, NamedTuple, Self, TypeVar

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    PlainSerializer,
    model_validator,
)
from pydantic.fields import FieldInfo

from shapefit.config.paths import (
    STANDARD_STREAM,
    UNNAMED_OUTPUT,
    Description,
    OptionalPath,
    ResultFolder,
)
from shapefit.errors import path_text

Value = TypeVar("Value")


FROM_LIST = Field(strict=False)
ListOf = Annotated[tuple[Value, ...], FROM_LIST]
Pair = Annotated[tuple[Value, Value], FROM_LIST]
"""Lists of YAML, which become tuples, so that a config cannot change."""

AUTO_TEXT = "auto"
"""Annotation metadata, and the text in YAML that is None inside."""

Auto = Annotated[
    Value | None,
    AUTO_TEXT,
    BeforeValidator(lambda value: None if value == AUTO_TEXT else value),
    PlainSerializer(lambda value: AUTO_TEXT if value is None else value),
]
"""A value, or `auto`."""


class ConfigModel(BaseModel):
    """A frozen mapping of fixed keys; nothing is converted silently: "3" is a text."""

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
    """Return the field of a section, whose default is its model with all defaults."""
    return Field(default_factory=model.model_construct)


class CommandConfig(ConfigModel):
    """Everything that can be set for one command."""

    OUTPUT: ClassVar[str] = ""
    """End of the name of an output that is not given, after that of the first input."""

    data: OptionalPath = None
    """Folder that replaces `{data}` at the beginning of any other path."""

    @model_validator(mode="after")
    def _check_output(self) -> Self:
        """Name an output that is not given; refuse to replace inputs."""
        files = [path for _, path in self.inputs() if path != STANDARD_STREAM]
        output = getattr(self, "output", None)
        if self.OUTPUT and output == UNNAMED_OUTPUT:
            output = self._name_after(files)
            object.__setattr__(self, "output", output)
        target = output.manifest if isinstance(output, ResultFolder) else output
        for path in files:
            if target and os.path.realpath(path) == os.path.realpath(target):
                raise ValueError(
                    f"`output` would replace an input, {path}; name another file"
                )
        return self

    def _name_after(self, files: Sequence[Path]) -> Path:
        """Return the path of the output, which is named after the first input file."""
        stem = files[0].name.partition(".")[0] if files else ""
        stem = stem or "standard"
        output = Path.cwd() / f"{stem}{self.OUTPUT}"
        if output in files:
            return output.with_name(f"{stem}_result{output.suffix}")
        return output

    def inputs(self) -> Iterator[tuple[str, Path]]:
        """Yield the files to read, except those of sections, each with its key."""
        for key in type(self).model_fields:
            if key in ("output", "data"):
                continue
            value = getattr(self, key)
            groups = value.values() if isinstance(value, Mapping) else [value]
            for group in groups:
                paths = group if isinstance(group, tuple) else [group]
                yield from ((key, path) for path in paths if isinstance(path, Path))

    def changed(self, **values: object) -> Self:
        """Return the config with other values of keys, which are not checked.

        For a section a mapping gives the values of some of its keys; the others stay.
        """
        for key, value in values.items():
            old = getattr(self, key)
            if isinstance(old, ConfigModel):
                assert isinstance(value, Mapping), "values of some keys of a section"
                values[key] = old.model_copy(update=value)
        return self.model_copy(update=values)

    def as_json(self) -> str:
        """Return the config as one line of JSON, with every default.

        A path that is not UTF-8 has escapes (`path_text`).
        """
        values = self.model_dump(warnings=False)
        return json.dumps(
            values, ensure_ascii=False, separators=(",", ":"), default=path_text
        )

    def as_plain(self) -> dict[str, object]:
        """Return the config as dicts, lists, texts and numbers, with every default."""
        values: dict[str, object] = json.loads(self.as_json())
        return values


class ConfigKey(NamedTuple):
    """A key: the model that has it, its name and field there; a section has a model."""

    owner: type[BaseModel]
    name: str
    field: FieldInfo
    section: type[BaseModel] | None
    description: Description | None


@cache
def list_config_keys(model: type[BaseModel]) -> dict[tuple[str, ...], ConfigKey]:
    """Return all keys of a model by their paths, as YAML spells them.

    A section comes before its keys.
    """
    keys: dict[tuple[str, ...], ConfigKey] = {}
    for name, field in model.model_fields.items():
        path = (field.alias or name,)
        kind = field.annotation
        section = None
        if isinstance(kind, type) and issubclass(kind, BaseModel):
            section = kind
        descriptions = [
            part for part in field.metadata if isinstance(part, Description)
        ]
        description = descriptions[0] if descriptions else None
        keys[path] = ConfigKey(model, name, field, section, description)
        if section is not None:
            for inner, key in list_config_keys(section).items():
                keys[path + inner] = key
    return keys

"""What every config has in common."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping
from copy import copy
from pathlib import Path
from typing import Annotated, Any, Literal, Optional, Self

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, create_model, model_validator

from shapefit.config.fields import Expected
from shapefit.config.paths import STANDARD_STREAM, Folder, ResultFolder
from shapefit.errors import path_text
from shapefit.stores.opening import MASK, STORAGE_OPTIONS
from shapefit.stores.urls import real_path


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

MOST_STEPS = 1_000_000
"""Rounds or iterations that nobody waits for; some are counted in memory that is got beforehand."""

MOST_THREADS = 1024

Plots = Annotated[bool | Literal["auto"], Expected("true, false or auto")]
"""Whether plots are drawn."""


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

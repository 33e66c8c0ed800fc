"""What every config has in common."""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field

from shapefit.config.paths import Folder


def _tuples(value: Any) -> Any:
    return tuple(_tuples(item) for item in value) if isinstance(value, list) else value


FromLists = BeforeValidator(_tuples)
"""Annotation metadata: lists (of lists ...) become tuples, so that a config cannot change."""


class ConfigModel(BaseModel):
    """A frozen mapping of known keys; nothing is converted silently ("3" is not a number)."""

    model_config = ConfigDict(
        frozen=True,
        extra="forbid",
        strict=True,
        allow_inf_nan=False,
        validate_by_name=True,
        validate_by_alias=True,
        serialize_by_alias=True,
    )


class CommandConfig(ConfigModel):
    """Everything that one command can be told."""

    data: Folder = Field(
        default=None,
        description="Folder that `{data}` stands for at the beginning of any other path.",
    )

    def as_json(self) -> str:
        """Return the config as one line of JSON, with every default."""
        return self.model_dump_json()

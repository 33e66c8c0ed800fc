"""`storage_options`: what is given to stores beside the environment; secret, whatever it is."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Mapping
from contextvars import ContextVar
from types import MappingProxyType
from typing import Any

STORAGE_OPTIONS = "storage_options"
"""Key of the configs, and how the options are called in messages."""

MASK = "***"

_SECRET = re.compile(r"(KEY|SECRET|TOKEN|PASSWORD|CREDENTIALS)")
"""In the name of a variable of the environment whose value is not shown."""

_OF_STORES = ("AWS_", "FSSPEC_", "GOOGLE_", "GCSFS_")

_given: ContextVar[Mapping[str, Any]] = ContextVar(
    STORAGE_OPTIONS, default=MappingProxyType({})
)  # of each thread its own: workers do parts of several runs


def use_storage_options(options: Mapping[str, Any]) -> None:
    """Open stores with these options from now on, in this thread."""
    _given.set(dict(options))


def storage_options() -> dict[str, Any]:
    """Return the options to open stores with."""
    return dict(_given.get())


def masked(text: str) -> str:
    """Return a text with *** for every option of stores, and secret of the environment, in it."""
    secrets = {secret for secret in (*_texts(_given.get()), *_of_environment()) if secret}
    for secret in sorted(secrets, key=len, reverse=True):
        text = text.replace(secret, MASK)
    return text


def _texts(value: Any) -> Iterator[str]:
    if isinstance(value, str):
        yield value
    elif isinstance(value, Mapping):
        for inner in value.values():
            yield from _texts(inner)
    elif isinstance(value, list | tuple):
        for inner in value:
            yield from _texts(inner)


def _of_environment() -> Iterator[str]:
    for name, value in os.environ.items():
        if name.startswith(_OF_STORES) and _SECRET.search(name):
            yield value

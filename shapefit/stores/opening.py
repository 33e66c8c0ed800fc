"""The store of a URL, its secret options, and its errors in the words of a user."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from types import MappingProxyType
from typing import Any

from shapefit.errors import InputError, input_error, printable
from shapefit.stores.urls import UrlPath

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


LIBRARIES = {"s3": "s3fs", "s3a": "s3fs", "gs": "gcsfs", "gcs": "gcsfs"}
"""Schemes of URLs -> the extra that reads and writes them."""

PATIENCE: Mapping[str, Mapping[str, Any]] = {
    "s3": {
        "config_kwargs": {
            "connect_timeout": 5,
            "read_timeout": 60,
            "retries": {"mode": "standard", "max_attempts": 3},
        }
    }
}
"""Protocol -> options that bound how long its store is waited for."""

ACCESS = f"check the credentials in the environment, or set `{STORAGE_OPTIONS}`"


class StoreError(InputError):
    """A store does not answer, or cannot do what it should: this may pass."""


def open_store(path: UrlPath) -> tuple[Any, str]:
    """Return the file system of fsspec that a URL is in, and its name there.

    Raises InputError where what speaks to it is not installed, or does not know the options.
    """
    library = LIBRARIES.get(path.scheme, "fsspec")
    try:
        import fsspec

        fsspec.get_filesystem_class(path.scheme)
    except ImportError as error:
        found = f"cannot be opened ({first_line(error)})"
        raise input_error(path, found, f"run `pip install {library}`") from None
    except ValueError:
        found = f"there is no kind of store {path.scheme!r}"
        raise input_error(path, found, "give s3:// or gs://, or a file") from None
    patience = PATIENCE.get(path.scheme.replace("s3a", "s3"), {})
    options = {**patience, "use_listings_cache": False, **storage_options()}
    with store_errors(path):
        system, name = fsspec.url_to_fs(path.url, **options)
    return system, name


@contextmanager
def store_errors(path: UrlPath, done: str = "read") -> Iterator[None]:
    """Turn what a store raises into InputErrors at the URL; `done` is what cannot be done."""
    try:
        yield
    except InputError:
        raise
    except FileNotFoundError as error:
        missing = "bucket" if "bucket does not exist" in str(error) else "object"
        raise input_error(path, f"there is no such {missing}", "check its name") from None
    except PermissionError as error:
        found = f"cannot be {done}: access is denied ({first_line(error)})"
        raise input_error(path, found, ACCESS) from None
    except TypeError as error:
        if not storage_options():
            raise
        found = f"the store of {path} does not take them ({first_line(error)})"
        raise input_error(STORAGE_OPTIONS, found, "give those that it knows") from None
    except Exception as error:  # each library of a store has kinds of its own
        if "Credential" in type(error).__name__:
            found = f"cannot be {done}: there are no credentials ({first_line(error)})"
            raise input_error(path, found, ACCESS) from None
        fix = "check the connection, and try again"
        line = f"{path}: cannot be {done} ({first_line(error)}); {fix}"
        raise StoreError(line) from None


def first_line(error: BaseException) -> str:
    """Return what an error says, on one line, without secrets."""
    said = str(error).strip().partition("\n")[0]
    return printable(masked(said)) or type(error).__name__

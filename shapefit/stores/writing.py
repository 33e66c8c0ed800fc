"""Objects that appear whole or not at all: written here, then put into the store at once."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from shapefit.errors import input_error
from shapefit.stores.opening import LIBRARIES, open_store, store_errors
from shapefit.stores.shelf import current_shelf
from shapefit.stores.urls import UrlPath

READ_ONLY = frozenset({"http", "https"})


def check_target(target: UrlPath) -> None:
    """Raise InputError where no object can be put at the URL; nothing is written.

    That is found out as far as the bucket: whether it takes the object shows when it is put.
    """
    if target.scheme in READ_ONLY:
        fix = "name a file, or a URL of an object store (s3://, gs://)"
        raise input_error(target, "is read only", fix)
    if len(target.parts) < 3:
        raise input_error(target, "is no object", f"name one, such as {target}/result.h5")
    if target.scheme not in LIBRARIES:  # other stores make what is missing
        return
    bucket = type(target)(*target.parts[:2])
    system, name = open_store(bucket)
    with store_errors(bucket, "written"), suppress(PermissionError):
        try:  # whoever may write need not be allowed to ask
            system.info(name)
        except FileNotFoundError:
            fix = "make it, or check its name"
            raise input_error(bucket, "there is no such bucket", fix) from None


@contextmanager
def uploaded(target: UrlPath) -> Iterator[Path]:
    """Give the path of an empty local file that is put at `target` on a clean exit.

    One request puts it there, or several of which the last one does; until then what is there
    stays. Raises InputError as `check_target` does, and StoreError where it cannot be put.
    """
    check_target(target)
    with tempfile.TemporaryDirectory(prefix="shapefit-upload-") as folder:
        local = Path(folder) / target.name
        local.touch()
        yield local
        system, name = open_store(target)
        with store_errors(target, "written"):
            system.put_file(str(local), name)
        current_shelf().forget(target)


def remove(path: Path) -> None:
    """Remove a file, here or in a store, if it is there."""
    if not isinstance(path, UrlPath):
        path.unlink(missing_ok=True)
        return
    system, name = open_store(path)
    with store_errors(path, "removed"), suppress(FileNotFoundError):
        system.rm_file(name)
    current_shelf().forget(path)

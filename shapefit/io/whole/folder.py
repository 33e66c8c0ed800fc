"""Many files for one folder: written aside, then moved there one by one, each of them whole."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from pathlib import Path, PurePosixPath

from shapefit.errors import input_error
from shapefit.io.sources import is_stream
from shapefit.io.whole.atomic import (
    check_output,
    is_writable,
    new_folders,
    shortened,
    storage_errors,
    write_all,
)
from shapefit.io.whole.litter import lock_new, remove_litter
from shapefit.stores import UrlPath

Write = Callable[[Path], object]


class StagedFiles:
    """Files on their way to `folder`, in a hidden folder."""

    def __init__(self, folder: Path, staging: Path) -> None:
        self.folder = folder
        self._staging = staging
        self.empty = True

    def __contains__(self, name: PurePosixPath) -> bool:
        """Whether folder/name was written, or what the file system takes for the same name."""
        return (self._staging / name).exists()

    def write(self, name: PurePosixPath, write: Write, item: str) -> None:
        """Let `write` fill the file of an item that becomes folder/name, its folders included.

        Raises InputError where it cannot be written, where something in the folder is in the way,
        and where a file of another item is: the names of two items may be equal for the
        file system.
        """
        target, path = self.folder / name, self._staging / name
        with storage_errors(target, None):
            occupied = next(place for place in (path, *path.parents) if place.exists())
            if occupied == path or not occupied.is_dir():
                found = f"is a file of another item as well as of {item!r}"
                place = self.folder / occupied.relative_to(self._staging)
                raise input_error(place, found, "rename one of them, or choose another format")
            check_replaceable(target)
            path.parent.mkdir(parents=True, exist_ok=True)
            write(path)
            self.empty = False

    def write_bytes(self, name: PurePosixPath, content: bytes) -> None:
        """Write the file that becomes folder/name, and have it on the disk."""
        write = partial(write_and_sync, lambda path: path.write_bytes(content))
        self.write(name, write, str(name))

    @contextmanager
    def opened(self, name: str) -> Iterator[Callable[[bytes | memoryview], None]]:
        """Give what writes the file that becomes folder/name, piece by piece."""
        target = self.folder / name
        check_replaceable(target)
        self.empty = False
        with storage_errors(target, None):
            file = (self._staging / name).open("wb", buffering=0)
        with file:

            def write(piece: bytes | memoryview) -> None:
                with storage_errors(target, None):
                    write_all(file, piece)

            yield write
            with storage_errors(target, None):
                os.fsync(file.fileno())

    def publish(self) -> None:
        """Move every file to its place, over the one of an earlier run if there is one.

        Raises InputError, before anything moves, where something is in the way.
        """
        made = [Path(place, name) for place, _, names in os.walk(self._staging) for name in names]
        targets = {path: self.folder / path.relative_to(self._staging) for path in made}
        for target in targets.values():
            check_replaceable(target)
        for path, target in targets.items():
            with storage_errors(target, None):
                target.parent.mkdir(parents=True, exist_ok=True)
                path.replace(target)


@contextmanager
def staged_files(folder: Path) -> Iterator[StagedFiles]:
    """Give files that move into `folder` on a clean exit, and are gone on any error before.

    They lie in a hidden folder: in `folder` itself, or beside it as long as it does not exist. What
    else the folder holds stays; without files it is not made. The files are not synced one by one,
    which would take most of the time: a power failure, unlike a killed process, may leave empty
    ones. Raises InputError as `StagedFiles` does.
    """
    around = folder if folder.is_dir() else folder.parent
    start, end = f".{shortened(folder.name)}-", ".partial"
    with new_folders(around):
        for place in (folder, folder.parent):
            remove_litter(place, start, end, shutil.rmtree)
        with storage_errors(folder, None):
            staging, held = lock_new(lambda: Path(tempfile.mkdtemp(end, start, around)))
        try:
            files = StagedFiles(folder, staging)
            yield files
            files.publish()
        finally:
            shutil.rmtree(staging, ignore_errors=True)
            os.close(held)


def check_replaceable(target: Path) -> None:
    """Raise InputError where no file can be put at `target` although its folders may be made."""
    if target.is_dir():
        fix = "remove or rename it, or choose another folder"
        raise input_error(target, "it is a folder, but must be a file", fix)
    around = next(folder for folder in target.parents if os.path.lexists(folder))
    if not around.is_dir():
        fix = "remove or rename it, or choose another folder"
        raise input_error(around, "it is not a folder, but files must go into it", fix)
    if not is_writable(around):
        fix = "change its permissions, or choose another folder"
        raise input_error(around, "it is not writable, but files must go into it", fix)


def refuse_folder(folder: Path) -> None:
    """Raise InputError for a folder of files that appear together: a store has no such thing."""
    if isinstance(folder, UrlPath):
        found = "a folder of files is not written to an object store"
        raise input_error(folder, found, "choose a folder of this machine, and copy it there")


def check_folder(folder: Path) -> None:
    """Raise InputError unless the folder can be made or written to; change nothing."""
    if is_stream(folder):
        raise input_error("output", "a report is several files", "give the name of a folder")
    refuse_folder(folder)
    if os.path.exists(folder) and not os.path.isdir(folder):
        raise input_error(folder, "it is not a folder", "give the name of a folder")
    check_output(folder / "report" if os.path.isdir(folder) else folder)


def write_folder(folder: Path, writers: Mapping[str, Write]) -> tuple[Path, ...]:
    """Write each file, name -> writer, to the folder, which is made; return their paths.

    Nothing appears before all are written and on the disk. Raises InputError where that is not
    possible.
    """
    with staged_files(folder) as staged:
        for name, write in writers.items():
            staged.write(PurePosixPath(name), partial(write_and_sync, write), name)
    return tuple(folder / name for name in writers)


def write_and_sync(write: Write, path: Path) -> None:
    """Write a file, and have it on the disk."""
    write(path)
    with path.open("rb") as written:
        os.fsync(written.fileno())

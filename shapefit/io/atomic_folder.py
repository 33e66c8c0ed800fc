"""Many files that appear together: write them aside, then move them into their folder."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path, PurePosixPath

from shapefit.errors import input_error

Write = Callable[[Path], object]


class StagedFiles:
    """Files on their way to `folder`."""

    def __init__(self, folder: Path, staging: Path) -> None:
        self.folder = folder
        self._staging = staging

    def __contains__(self, name: PurePosixPath) -> bool:
        """Whether folder/name was written, or what the file system takes for the same name."""
        return (self._staging / name).exists()

    def write(self, name: PurePosixPath, write: Write) -> None:
        """Let `write` fill the file that becomes folder/name, folders in between included.

        Raises InputError where it cannot be written, and where it was written before: the names of
        two items may differ in nothing that the file system can tell.
        """
        target, path = self.folder / name, self._staging / name
        if name in self:
            found = "two items have this file name"
            raise input_error(target, found, "give one of them another name")
        with _writing_errors(target):
            path.parent.mkdir(parents=True, exist_ok=True)
            write(path)

    def move(self) -> None:
        """Move every file to its place, over the one of an earlier run if there is one."""
        for path in _files(self._staging):
            target = self.folder / path.relative_to(self._staging)
            with _writing_errors(target):
                target.parent.mkdir(parents=True, exist_ok=True)
                path.replace(target)


@contextmanager
def staged_files(folder: Path) -> Iterator[StagedFiles]:
    """Give files that move into `folder` on a clean exit, and are gone on any error.

    They lie in a hidden folder: in `folder` itself, or beside it as long as it does not exist. What
    else the folder holds stays. The files are not synced one by one, which would take most of the
    time: a power failure, unlike a killed process, may leave empty ones.
    """
    around = folder if folder.is_dir() else folder.parent
    with _writing_errors(folder):
        staging = Path(tempfile.mkdtemp(".partial", f".{folder.name}-", around))
    try:
        files = StagedFiles(folder, staging)
        yield files
        with _writing_errors(folder):
            folder.mkdir(exist_ok=True)
        files.move()
    finally:
        shutil.rmtree(staging, ignore_errors=True)


@contextmanager
def _writing_errors(target: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        found = f"cannot be written: {error.strerror}"
        fix = "choose another folder, or free some space if there is none"
        raise input_error(target, found, fix) from error


def _files(folder: Path) -> Iterator[Path]:
    """Yield the files under a folder one by one, however many there are."""
    with os.scandir(folder) as entries:
        for entry in entries:
            if entry.is_dir(follow_symlinks=False):
                yield from _files(Path(entry.path))
            else:
                yield Path(entry.path)

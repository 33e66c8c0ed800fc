"""The folder of a report: checked before the work, filled at once after it."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path, PurePosixPath

from shapefit.errors import input_error
from shapefit.io.sources import is_stream
from shapefit.io.whole.atomic import check_output
from shapefit.io.whole.folder import staged_files
from shapefit.stores.writing import refuse_folder

Writer = Callable[[Path], object]


def check_folder(folder: Path) -> None:
    """Raise InputError unless the folder can be made or written to; change nothing."""
    if is_stream(folder):
        raise input_error("output", "a report is several files", "give the name of a folder")
    refuse_folder(folder)
    if os.path.exists(folder) and not os.path.isdir(folder):
        raise input_error(folder, "it is not a folder", "give the name of a folder")
    check_output(folder / "report" if os.path.isdir(folder) else folder)


def write_folder(folder: Path, writers: Mapping[str, Writer]) -> tuple[Path, ...]:
    """Write each file, name -> writer, to the folder, which is made; return their paths.

    They appear together. Raises InputError where that is not possible; the folder then stays as
    it was.
    """
    with staged_files(folder) as staged:
        for name, write in writers.items():
            staged.write(PurePosixPath(name), partial(_write_and_sync, write), name)
    return tuple(folder / name for name in writers)


def _write_and_sync(write: Writer, path: Path) -> None:
    write(path)
    with path.open("rb") as written:
        os.fsync(written.fileno())

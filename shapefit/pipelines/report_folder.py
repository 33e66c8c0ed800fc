"""The folder of a report: checked before the work, filled file by file after it."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

from shapefit.errors import input_error
from shapefit.io.atomic import atomic_path, check_output
from shapefit.io.sources import is_stream

Writer = Callable[[Path], object]


def check_folder(folder: Path) -> None:
    """Raise InputError unless the folder can be made or written to; change nothing."""
    if is_stream(folder):
        raise input_error("output", "a report is several files", "give the name of a folder")
    if os.path.exists(folder) and not os.path.isdir(folder):
        raise input_error(folder, "it is not a folder", "give the name of a folder")
    check_output(folder / "report" if os.path.isdir(folder) else folder)


def write_folder(folder: Path, writers: Mapping[str, Writer]) -> Iterator[Path]:
    """Make the folder and write each file, name -> writer; yields the files as they are complete.

    Raises InputError where that is not possible.
    """
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        found = f"the folder cannot be made: {error.strerror}"
        raise input_error(folder, found, "choose another folder") from error
    for name, write in writers.items():
        with atomic_path(folder / name) as path:
            write(path)
        yield folder / name

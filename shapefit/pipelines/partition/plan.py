"""The parts of a fit: files, recordings of several files, or ranges of rows of an HDF5 file."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import Any, NamedTuple

from shapefit.config import FitConfig
from shapefit.errors import InputError, input_error, path_text
from shapefit.io import LandmarkSource, open_landmarks
from shapefit.io.detect import group_inputs
from shapefit.io.formats import CSV, HDF5, FileFormat
from shapefit.io.inputs import HDF5_SIGNATURE, begins_with
from shapefit.lifting.methods import METHODS
from shapefit.pipelines.fit.lift import whole_stretches
from shapefit.pipelines.fit.prepare import read_options
from shapefit.threads import on_threads

FEWEST_BYTES = 16
"""Of an image, by which an HDF5 file is known to be too small to be divided."""

LARGE_TEXT = 1 << 28
"""Bytes of a CSV file from which on it is said that it is one part."""

Rows = tuple[int, int] | None
State = tuple[int, int]
Key = tuple[tuple[str, ...], Rows]


@dataclass(frozen=True)
class Part:
    """Images that become one result file.

    number      of the file; it stays when inputs are added
    inputs      a file, or those of one recording
    rows        of the one HDF5 file: from the first to before the second; None for all
    state       size in bytes and time of change in ns of each input
    """

    number: int
    inputs: tuple[Path, ...]
    rows: Rows
    state: tuple[State, ...]

    @property
    def file(self) -> str:
        """Name of its result."""
        return f"part-{self.number:05}{HDF5.suffixes[0]}"

    @property
    def key(self) -> Key:
        """What is lifted: the paths of the inputs, and the rows."""
        return tuple(map(path_text, self.inputs)), self.rows

    def describe(self) -> dict[str, Any]:
        """Return what the part is made of, as the manifest says it."""
        return {
            "file": self.file,
            "inputs": list(self.key[0]),
            "rows": None if self.rows is None else list(self.rows),
            "sizes": [size for size, _ in self.state],
            "changed": [changed for _, changed in self.state],
        }


class Piece(NamedTuple):
    """An input, the rows into which it is divided, and its sequences where these stay whole."""

    inputs: tuple[Path, ...]
    rows: Sequence[Rows] = (None,)
    sequences: Sequence[str] = ()


def plan_parts(config: FitConfig, numbers: Mapping[Key, int] | None = None) -> list[Part]:
    """Return the parts of a fit, in the order of the inputs.

    Parts of these keys keep their numbers; the others get free ones. An HDF5 file is cut where
    no result changes: after whole stretches of images, which start from one another's solutions,
    and between sequences where those are lifted whole. Raises InputError for sequences over two
    files.
    """
    states = {path: find_state(path) for path in config.landmarks}
    whole, options = METHODS[config.method].sequences, read_options(config)

    def is_small(path: Path) -> bool:
        small = not whole and states[path][0] < FEWEST_BYTES * config.partition
        return small and options.format in ("auto", "hdf5") and begins_with(path, HDF5_SIGNATURE)

    def divide(group: tuple[FileFormat, tuple[Path, ...]]) -> Piece:
        known, inputs = group
        if known is not HDF5 and not whole:
            return Piece(inputs)
        try:
            with open_landmarks(inputs, options, check=False) as source:
                if whole:
                    return cut_between_sequences(inputs, source, config.partition, known is HDF5)
                size, images = whole_stretches(config.partition), source.count
                rows = [(at, min(at + size, images)) for at in range(0, images, size)]
                return Piece(inputs, rows if len(rows) > 1 else (None,))
        except InputError:  # whoever does its part reports it
            return Piece(inputs)

    small = dict(zip(states, on_threads(is_small, states), strict=True))
    pieces = {path: Piece((path,)) for path in states if small[path]}
    groups = group_inputs([path for path in states if not small[path]], options)
    # files of text are read whole for their sequences: one at a time
    divided = list(map(divide, groups)) if whole else on_threads(divide, groups)
    pieces |= {piece.inputs[0]: piece for piece in divided}
    ordered = [pieces[path] for path in states if path in pieces]
    check_sequences(ordered)
    numbers = numbers or {}
    used = set(numbers.values())
    free = (number for number in count() if number not in used)
    parts = []
    for piece in ordered:
        for rows in piece.rows:
            part = Part(0, piece.inputs, rows, tuple(states[path] for path in piece.inputs))
            number = numbers[part.key] if part.key in numbers else next(free)
            parts.append(Part(number, part.inputs, rows, part.state))
    return parts


def find_state(path: Path) -> State:
    """Return the size and the time of change of a file; zeros where there is none."""
    try:
        state = path.stat()
    except OSError:
        return 0, 0
    return state.st_size, state.st_mtime_ns


def warn_of_large(parts: Sequence[Part]) -> tuple[str, ...]:
    """Name large tables, each of which is one part."""
    return tuple(
        f"{path.name} is one part, as text is not divided: `shapefit convert {path.name} -o "
        f"{path.stem}.h5` makes a file that is"
        for part in parts
        for path, (size, _) in zip(part.inputs, part.state, strict=True)
        if size >= LARGE_TEXT and path.suffix.lower() in CSV.suffixes
    )


def cut_between_sequences(
    inputs: tuple[Path, ...], source: LandmarkSource, size: int, divisible: bool
) -> Piece:
    """Return a file in row ranges of whole sequences, at least `size` images each but the last."""
    rows: list[Rows] = []
    names: list[str] = []
    start = 0
    for name, first in sequence_starts(source):
        names.append(name)
        if divisible and first - start >= size:
            rows.append((start, first))
            start = first
    return Piece(inputs, (*rows, (start, source.count) if rows else None), names)


def sequence_starts(source: LandmarkSource) -> Iterator[tuple[str, int]]:
    """Yield the name and the first row of every run of images of one sequence."""
    row, last = 0, ""
    for block in source.sequences():
        for name in block:
            if name != last:
                yield name, row
            last, row = name, row + 1


def check_sequences(pieces: Sequence[Piece]) -> None:
    """Raise InputError where a sequence is in two files, or goes on after another one."""
    holders: dict[str, Path] = {}
    for path, names in ((piece.inputs[0], piece.sequences) for piece in pieces):
        for name in names:
            if name in holders:
                where = sorted({str(holders[name]), str(path)})
                found = f"the sequence '{name}' is in {' and in '.join(where)}"
                found += ", in two places" if len(where) == 1 else ""
                raise input_error(path, found, "put its images together, in one file")
            holders[name] = path

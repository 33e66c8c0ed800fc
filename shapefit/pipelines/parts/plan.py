"""Which parts a fit has: files, recordings of several files, or row ranges of a large file."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path
from typing import Any, NamedTuple

from shapefit.config import FitConfig
from shapefit.errors import InputError, input_error, path_text
from shapefit.io import LandmarkSource, open_landmarks
from shapefit.io.csv_file import Stretch, index_items
from shapefit.io.formats import CSV, HDF5, FileFormat, group_inputs
from shapefit.io.inputs import HDF5_SIGNATURE, begins_with, is_stream
from shapefit.lifting.methods import METHODS
from shapefit.pipelines.fit.lift import whole_stretches
from shapefit.pipelines.fit.prepare import FIRST, read_options
from shapefit.stores import State, UrlPath, find_state
from shapefit.threads import on_threads

FEWEST_BYTES = 16
"""Of an image, by which an HDF5 file is known to be too small to be divided."""

Rows = tuple[int, int] | None


@dataclass(frozen=True)
class Part:
    """Images that become one result file.

    number      in the order of the inputs, counted from 0
    inputs      a file, or those of one recording
    rows        of the one HDF5 or CSV file: from the first to before the second; None for all
    state       size and time of change (or etag) of the inputs, by which a changed file is known
    stretch     where the rows of a CSV file are, and those that estimates are made of
    """

    number: int
    inputs: tuple[Path, ...]
    rows: Rows
    state: tuple[State, ...]
    stretch: tuple[Stretch, Stretch] | None = None

    @property
    def file(self) -> str:
        """Name of its result."""
        return f"part-{self.number:05}{HDF5.suffixes[0]}"

    def describe(self) -> dict[str, Any]:
        """Return what the part is made of, as the manifest says it."""
        return {
            "file": self.file,
            "inputs": [path_text(path) for path in self.inputs],
            "rows": None if self.rows is None else list(self.rows),
            "sizes": [size for size, _ in self.state],
            "changed": [changed for _, changed in self.state],
        }


class Piece(NamedTuple):
    """An input, the rows into which it is divided, and its sequences where these stay whole."""

    inputs: tuple[Path, ...]
    rows: Sequence[Rows] = (None,)
    sequences: Sequence[str] = ()
    stretches: Sequence[tuple[Stretch, Stretch] | None] = ()


def plan_parts(config: FitConfig) -> list[Part]:
    """Return the parts of a fit, in the order of the inputs.

    A large HDF5 or CSV file is cut where no result changes: after whole stretches of images, which
    start from one another's solutions, and (HDF5) between sequences where those are lifted whole.
    Raises InputError for sequences over two files.
    """
    states = {path: find_state(path) or (0, "") for path in config.landmarks}
    whole, options = METHODS[config.method].sequences, read_options(config)

    def is_small(path: Path) -> bool:
        small = not whole and states[path][0] < FEWEST_BYTES * config.partition
        return small and options.format in ("auto", "hdf5") and begins_with(path, HDF5_SIGNATURE)

    def divide(group: tuple[FileFormat, tuple[Path, ...]]) -> Piece:
        known, inputs = group
        if known is CSV and not whole and states[inputs[0]][0] >= FEWEST_BYTES * config.partition:
            return divide_text(inputs[0], config.partition)
        if known is not HDF5 and not whole:
            return Piece(inputs)
        try:
            with open_landmarks(inputs, options, check=False) as source:
                if whole:
                    return cut_between_sequences(inputs, source, config.partition, known is HDF5)
                size, count = whole_stretches(config.partition), source.count
                rows = [(at, min(at + size, count)) for at in range(0, count, size)]
                return Piece(inputs, rows if len(rows) > 1 else (None,))
        except InputError:  # whoever does its part reports it
            return Piece(inputs)

    small = dict(zip(states, on_threads(is_small, states), strict=True))
    pieces = {path: Piece((path,)) for path in states if small[path]}
    groups = group_inputs([path for path in states if not small[path]], options)
    # files of text are read whole for their sequences: one at a time
    found = list(map(divide, groups)) if whole else on_threads(divide, groups)
    pieces |= {piece.inputs[0]: piece for piece in found}
    ordered = [pieces[path] for path in states if path in pieces]
    check_sequences(ordered)
    each = [
        (piece.inputs, rows, stretch)
        for piece in ordered
        for rows, stretch in zip_longest(piece.rows, piece.stretches)
    ]
    return [
        Part(number, inputs, rows, tuple(states[path] for path in inputs), stretch)
        for number, (inputs, rows, stretch) in enumerate(each)
    ]


def divide_text(path: Path, size: int) -> Piece:
    """Return a CSV file in ranges of `size` images, where its rows let it be divided."""
    step = whole_stretches(1)
    index = None if isinstance(path, UrlPath) or is_stream(path) else index_items(path, step)
    size = whole_stretches(size)
    if index is None or index.size <= size:
        return Piece((path,))
    rows = [(at, min(at + size, index.size)) for at in range(0, index.size, size)]

    def between(start: int, stop: int) -> Stretch:
        first, last = start // step, math.ceil(stop / step)
        ends = int(index.starts[first]), int(index.starts[last])
        return Stretch(*ends, int(index.lines[first]), index.landmarks)

    stretches = [(between(*own), between(own[0], min(own[0] + FIRST, own[1]))) for own in rows]
    return Piece((path,), rows, stretches=stretches)


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

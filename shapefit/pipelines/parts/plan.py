"""Which parts a fit has: files, or row ranges of large HDF5 and Parquet files."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from shapefit.config import FitConfig
from shapefit.core import STRETCH
from shapefit.errors import InputError, input_error
from shapefit.io import open_landmarks
from shapefit.io.foreign.opening import group_inputs
from shapefit.io.formats import FORMATS, HDF5
from shapefit.io.layout import LANDMARKS
from shapefit.io.options import InputOptions
from shapefit.io.sources import is_stream
from shapefit.io.stored.files import open_stored
from shapefit.io.stored.reader import StoredReader
from shapefit.lifting.methods import METHODS
from shapefit.pipelines.fit.plan import read_options
from shapefit.stores.shelf import State, find_state

BATCH = 4096
"""Images that are read at a time for the names of their sequences."""


@dataclass(frozen=True)
class Part:
    """Images that become one result file.

    number    counts the parts of a run, from 0
    inputs    the file, or the files that are one recording
    rows      of the one HDF5 or Parquet file: from the first to before the second; None for all
    state     size and time of change (or etag) of the inputs, by which a changed file is known
    suffix    of the result
    """

    number: int
    inputs: tuple[Path, ...]
    rows: tuple[int, int] | None
    state: tuple[State, ...]
    suffix: str = HDF5.suffixes[0]

    @property
    def file(self) -> str:
        """Name of its result."""
        return f"part-{self.number:05}{self.suffix}"


def plan_parts(config: FitConfig) -> list[Part]:
    """Return the parts of a fit, in the order of the inputs.

    A large HDF5 or Parquet file is cut where no result changes: after whole stretches of images,
    which start from one another's solutions, and between sequences where those are lifted whole.
    Raises InputError for standard input, and for sequences over two files.
    """
    if any(map(is_stream, config.landmarks)):
        found = "standard input cannot be divided into parts"
        raise input_error("landmarks", found, "save it to a file and name that")
    whole = METHODS[config.method].sequences
    parts: list[Part] = []
    holders: dict[str, Path] = {}
    suffix = FORMATS[config.part_format].suffixes[0]
    options = read_options(config)
    for known, paths in group_inputs(config.landmarks, options):
        state = tuple(state for state in map(find_state, paths) if state is not None)
        rows: list[tuple[int, int] | None] = [None]
        reader = _opened(paths[0]) if known.reader is not None else None
        if reader is not None:
            with reader:
                if whole:
                    rows = _between_sequences(reader, config.partition, holders)
                else:
                    rows = _between_stretches(reader, config.partition)
        elif whole:
            for name in _named_sequences(paths, options):
                _hold(name, paths[0], holders)
        parts += [
            Part(number, paths, each, state, suffix)
            for number, each in enumerate(rows, start=len(parts))
        ]
    return parts


def _opened(path: Path) -> StoredReader | None:
    """Open a file; None where that fails, which whoever does its part reports."""
    try:
        return open_stored(path, LANDMARKS)
    except InputError:
        return None


def _between_stretches(reader: StoredReader, size: int) -> list[tuple[int, int] | None]:
    """Return row ranges of `size` images or more; where there are row groups, best of whole ones.

    Between groups there is a part of up to twice that size rather than one that begins in the
    middle of a group, which is decoded from its start.
    """
    count = reader.count
    size = _whole_stretches(size)
    cuts = [_whole_stretches(first) for first in reader.groups]
    rows: list[tuple[int, int] | None] = []
    start = 0
    while count - start > size:
        near = (cut for cut in cuts if start + size <= cut <= start + 2 * size)
        stop = min(next(near, start + size), count)
        rows.append((start, stop))
        start = stop
    if not rows:
        return [None]
    return [*rows, (start, count)] if start < count else rows


def _whole_stretches(images: int) -> int:
    return -(-images // STRETCH) * STRETCH


def _between_sequences(
    reader: StoredReader, size: int, holders: dict[str, Path]
) -> list[tuple[int, int] | None]:
    """Return row ranges of whole sequences, at least `size` images each but the last."""
    rows: list[tuple[int, int] | None] = []
    start = 0
    for name, first in _sequence_starts(reader):
        _hold(name, reader.path, holders)
        if first - start >= size:
            rows.append((start, first))
            start = first
    if not rows:
        return [None]
    return [*rows, (start, reader.count)]


def _hold(name: str, path: Path, holders: dict[str, Path]) -> None:
    """Note the file of a sequence; raise InputError where it was in another one, or stopped."""
    if name in holders:
        where = sorted({str(holders[name]), str(path)})
        found = f"the sequence '{name}' is in {' and in '.join(where)}"
        found += ", in two places" if len(where) == 1 else ""
        raise input_error(path, found, "put its images together, in one file")
    holders[name] = path


def _named_sequences(paths: tuple[Path, ...], options: InputOptions) -> Iterator[str]:
    """Yield the names of the sequences in a recording that has to be read for them."""
    try:
        with open_landmarks(paths, options) as source:
            names: dict[str, None] = {}
            for images in source.chunks(BATCH):
                names.update(dict.fromkeys(images.sequences or ()))
    except InputError:  # whoever does the part reports it
        return
    yield from names


def _sequence_starts(reader: StoredReader) -> Iterator[tuple[str, int]]:
    """Yield the name and the first row of every run of images of one sequence."""
    row, last = 0, None
    blocks: Iterator[Sequence[str]] = (
        reader.read_blocks("sequence") if reader.has("sequence") else iter(())
    )
    for block in blocks:
        for name in block:
            if name != last:
                yield name, row
            last, row = name, row + 1

"""Which parts a fit has: files, some small ones together, or row ranges of a large one."""

from __future__ import annotations

import threading
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from math import isqrt
from pathlib import Path
from typing import TYPE_CHECKING, Any

from shapefit.config import FitConfig
from shapefit.core import STRETCH
from shapefit.errors import InputError, input_error, path_text
from shapefit.io import open_landmarks
from shapefit.io.formats import HDF5, FileFormat, group_inputs
from shapefit.io.inputs import HDF5_SIGNATURE, PARQUET_SIGNATURE, begins_with
from shapefit.io.layout import LANDMARKS
from shapefit.io.options import InputOptions
from shapefit.lifting.methods import METHODS
from shapefit.pipelines.fit.prepare import read_options
from shapefit.stores import State, find_state, on_threads

if TYPE_CHECKING:
    from shapefit.io.hdf5_records import Hdf5Reader


BATCH = 4096
"""Images that are read at a time for the names of their sequences."""

BYTES, FEWEST_BYTES = 256, 16
"""Of an image, by which images are guessed where no file says their number; and of the shortest,
by which a file is known to be too small to be divided."""

Rows = tuple[int, int] | None


@dataclass(frozen=True)
class Part:
    """Images that become one result file.

    number      of its first input, counted from 0; each row range counts as an input
    inputs      files, each or some of them a recording
    rows        of the one HDF5 or Parquet file: from the first to before the second; None for all
    state       size and time of change (or etag) of the inputs, by which a changed file is known
    recordings  how many inputs each recording has, where the part may be divided
    """

    number: int
    inputs: tuple[Path, ...]
    rows: Rows
    state: tuple[State, ...]
    recordings: tuple[int, ...] = field(default=(), compare=False)

    @property
    def file(self) -> str:
        """Name of its result."""
        return f"part-{self.number:05}{HDF5.suffixes[0]}"

    def describe(self) -> dict[str, Any]:
        """Return what the part is made of, as the manifest says it."""
        return {
            "inputs": [path_text(path) for path in self.inputs],
            "rows": None if self.rows is None else list(self.rows),
            "sizes": [size for size, _ in self.state],
            "changed": [changed for _, changed in self.state],
        }

    def divide(self) -> Iterator[Part]:
        """Yield some smaller parts, of a few recordings each; none for a single recording."""
        count = len(self.recordings)
        if count < 2:
            return
        width = isqrt(count)
        for start in range(0, count, width):
            own = self.recordings[start : start + width]
            first = sum(self.recordings[:start])
            taken = slice(first, first + sum(own))
            number, inputs, state = self.number + first, self.inputs[taken], self.state[taken]
            yield Part(number, inputs, None, state, own)


@dataclass(frozen=True)
class Piece:
    """What is known of an input, or of the inputs that are one recording.

    images     about how many there are
    rows       into which it is divided
    sequences  of its images, where these are lifted whole
    grows      whether further files of its folder would belong to it
    """

    inputs: tuple[Path, ...]
    images: int
    rows: Sequence[Rows] = (None,)
    sequences: Sequence[str] = ()
    grows: bool = False


def plan_parts(config: FitConfig, done: Iterable[Mapping[str, Any]] = ()) -> list[Part]:
    """Return the parts of a fit, in the order of the inputs.

    A large HDF5 or Parquet file is cut where no result changes: after whole stretches of images,
    which start from one another's solutions, and between sequences where those are lifted whole.
    Small inputs that follow one another are a part together. Whole inputs that are `done`, by
    their entries in the manifest, and as they were, stay together and are not looked into; but
    where a recording of several files may have grown, and where there are new files of sequences
    that are lifted whole, all are. Raises InputError for sequences over two files.
    """
    states = {path: find_state(path) or (0, "") for path in config.landmarks}
    kept = _kept(states, done, config.partition)
    inside = {path for piece in kept for path in piece.inputs}
    new = _look_into([path for path in states if path not in inside], states, config)
    if kept and new and (METHODS[config.method].sequences or any(piece.grows for piece in new)):
        kept, new = [], _look_into(list(states), states, config)
    pieces = {piece.inputs[0]: piece for piece in (*kept, *new)}
    ordered = [pieces[path] for path in states if path in pieces]
    _check_sequences(ordered)
    parts: list[Part] = []
    number = 0
    for together, rows in _joined(ordered, config.partition):
        inputs = tuple(path for piece in together for path in piece.inputs)
        recordings = tuple(len(piece.inputs) for piece in together)
        state = tuple(states[path] for path in inputs)
        parts.append(Part(number, inputs, rows, state, recordings))
        number += len(inputs) if rows is None else 1
    return parts


def _kept(
    states: Mapping[Path, State], done: Iterable[Mapping[str, Any]], size: int
) -> list[Piece]:
    """Return the inputs of parts that are done, where they still follow one another unchanged."""
    paths = list(states)
    places = {path_text(path): place for place, path in enumerate(paths)}
    kept = []
    for entry in done:
        names = entry.get("inputs") or [""]
        place = places.get(names[0], len(paths))
        inputs = tuple(paths[place : place + len(names)])
        told = Part(0, inputs, None, tuple(states[path] for path in inputs)).describe()
        if inputs and told.items() <= entry.items():
            kept.append(Piece(inputs, size))
    return kept


def _joined(pieces: Iterable[Piece], size: int) -> Iterator[tuple[list[Piece], Rows]]:
    """Yield what is a part: a row range, or whole pieces of `size` images at most together."""
    together: list[Piece] = []
    room = 0
    for piece in pieces:
        if together and (piece.images > room or len(piece.rows) > 1):
            yield together, None
            together = []
        if len(piece.rows) > 1:
            yield from (([piece], rows) for rows in piece.rows)
            continue
        room = (room if together else size) - piece.images
        together.append(piece)
    if together:
        yield together, None


def _look_into(
    paths: Sequence[Path], states: Mapping[Path, State], config: FitConfig
) -> list[Piece]:
    """Return what is found of inputs; small files that are known by their first bytes stay shut."""
    whole = METHODS[config.method].sequences
    options, one_at_a_time = read_options(config), threading.Lock()

    def is_small(path: Path) -> bool:
        small = not whole and states[path][0] < FEWEST_BYTES * config.partition
        return small and begins_with(path, HDF5_SIGNATURE, PARQUET_SIGNATURE)

    def guess(inputs: tuple[Path, ...]) -> int:
        size = sum(states[path][0] for path in inputs)
        return config.partition if inputs[0].is_dir() else 1 + size // BYTES

    small = dict(zip(paths, on_threads(is_small, paths), strict=True))
    pieces = [Piece((path,), guess((path,))) for path in paths if small[path]]
    groups = group_inputs([path for path in paths if not small[path]], options)

    def look(group: tuple[FileFormat, tuple[Path, ...]]) -> Piece:
        from shapefit.io.hdf5_records import Hdf5Reader

        known, inputs = group
        if known.reader is None:
            with one_at_a_time:  # files of text are read whole for their sequences
                sequences = tuple(_named_sequences(inputs, options)) if whole else ()
            grows = known.together and not inputs[0].is_dir()
            return Piece(inputs, guess(inputs), sequences=sequences, grows=grows)
        try:
            with Hdf5Reader(inputs[0], LANDMARKS) as reader:
                if whole:
                    return _cut_between_sequences(reader, config.partition)
                return Piece(inputs, reader.count, _between_stretches(reader, config.partition))
        except InputError:  # whoever does its part reports it
            return Piece(inputs, config.partition)

    return pieces + on_threads(look, groups)


def _between_stretches(reader: Hdf5Reader, size: int) -> list[Rows]:
    """Return row ranges of `size` images, rounded up to whole stretches."""
    size = _whole_stretches(size)
    starts = range(0, reader.count, size)
    rows: list[Rows] = [(start, min(start + size, reader.count)) for start in starts]
    return rows if len(rows) > 1 else [None]


def _whole_stretches(images: int) -> int:
    return -(-images // STRETCH) * STRETCH


def _cut_between_sequences(reader: Hdf5Reader, size: int) -> Piece:
    """Return a file in row ranges of whole sequences, at least `size` images each but the last."""
    starts = list(_sequence_starts(reader))
    rows: list[Rows] = []
    start = 0
    for _, first in starts:
        if first - start >= size:
            rows.append((start, first))
            start = first
    names = tuple(name for name, _ in starts)
    last = (start, reader.count) if rows else None
    return Piece((reader.path,), reader.count, (*rows, last), names)


def _check_sequences(pieces: Iterable[Piece]) -> None:
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


def _named_sequences(paths: tuple[Path, ...], options: InputOptions) -> Iterator[str]:
    """Yield the names of the sequences in a recording that has to be read for them."""
    try:
        with open_landmarks(paths, options) as source:
            names: dict[str, None] = {}
            for images in source.batches(BATCH):
                names.update(dict.fromkeys(images.sequences or ()))
    except InputError:  # whoever does the part reports it
        return
    yield from names


def _sequence_starts(reader: Hdf5Reader) -> Iterator[tuple[str, int]]:
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

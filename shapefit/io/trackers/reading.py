"""HDF5 files of trackers: opened once, with every damage named by file and dataset."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import prod
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from shapefit.errors import input_error
from shapefit.io.hdf5.file import Hdf5File

BLOCK_FRAMES = 4096
"""Of a video that are read at a time."""

BLOCK_BYTES = 1 << 24
"""Of a dataset that are read at a time; MOST_BYTES where its chunks are larger."""
MOST_BYTES = 1 << 27

MOST_TEXTS = 1_000_000
"""Names that a dataset of names can hold."""


class TrackerFile(Hdf5File):
    """An open HDF5 file of another tool."""

    def groups(self, group: str) -> tuple[str, ...]:
        """Return the names of the groups in a group."""
        with self.damage(group):
            node = self.root[group]
            return tuple(name for name in node if isinstance(node.get(name), h5py.Group))

    def has(self, name: str) -> bool:
        """Whether there is such a dataset or group."""
        with self.damage(name):
            return self.root.get(name) is not None

    def shape(self, name: str, axes: str = "") -> tuple[int, ...]:
        """Return the shape of a dataset; InputError unless it has as many axes as are listed."""
        shape = self.stored(name).shape
        if axes and len(shape) != len(axes.split(", ")):
            raise self.fault(name, f"has the shape {shape}", f"its axes should be ({axes})")
        return shape

    def check_shape(self, name: str, wanted: Sequence[int]) -> None:
        """Raise InputError unless a dataset has this shape."""
        shape = self.shape(name)
        if shape != tuple(wanted):
            found = f"has the shape {shape}, and other datasets want {tuple(wanted)}"
            raise self.fault(name, found)

    def fields(self, name: str) -> tuple[str, ...]:
        """Return the names of the columns of a table; InputError where it is none."""
        found = self.stored(name).dataset.dtype.names
        if not found:
            raise self.fault(name, "is not a table of named columns")
        return tuple(found)

    def numbers(self, name: str, rows: slice | tuple[Any, ...] = ()) -> NDArray[np.float64]:
        """Return rows of a dataset as numbers. Raises InputError where they are none."""
        if self.stored(name).dataset.dtype.kind not in "biuf":
            raise self.fault(name, "holds no numbers")
        values = self.rows(name, rows)
        with self.damage(name):
            return np.asarray(values, np.float64)

    def arranged(
        self, name: str, axes: Sequence[str], wanted: Sequence[str], rows: slice
    ) -> NDArray[np.float64]:
        """Return rows along the first of the wanted axes, these in order; 1 for one not there."""
        part = self.numbers(name, tuple(rows if a == wanted[0] else slice(None) for a in axes))
        present = [axis for axis in wanted if axis in axes]
        part = part.transpose([axes.index(axis) for axis in present])
        return part.reshape([part.shape[present.index(a)] if a in axes else 1 for a in wanted])

    def is_text(self, name: str) -> bool:
        """Whether a dataset holds text."""
        return self.stored(name).text

    def scales(self, name: str) -> tuple[str, ...]:
        """Return the names of the dimension scales of a dataset; InputError without them."""
        dataset = self.stored(name).dataset
        with self.damage(name):  # h5py's own `dims` can abort the process on damaged files
            scales = dataset.attrs["DIMENSION_LIST"]
            names = [text(h5py.h5r.get_name(own[0], self.root.id) or b"") for own in scales]
        return tuple(name.strip("/") for name in names)

    def ranges(self, name: str, axis: int) -> Iterator[slice]:
        """Divide an axis of a dataset into blocks, each of whole chunks where they are not large.

        A chunk that two blocks share is decompressed for each of them.
        """
        self.check_written(name)
        with self.damage(name):
            dataset = self.stored(name).dataset
            count, chunks = dataset.shape[axis], dataset.chunks
            entry = dataset.nbytes // max(count, 1)
        step = max(min(BLOCK_FRAMES, BLOCK_BYTES // max(entry, 1)), 1)
        if chunks is not None:
            whole = -(-step // chunks[axis]) * chunks[axis]
            step = whole if whole * entry <= MOST_BYTES else step
        return frame_ranges(count, step)

    def texts(self, name: str) -> tuple[str, ...]:
        """Return a dataset of names. Raises InputError where they are none, or too many."""
        stored = self.stored(name)
        if prod(stored.shape) > MOST_TEXTS:
            raise self.fault(name, f"holds {stored.shape} names")
        if not stored.text:
            if stored.dataset.size == 0:
                return ()  # SLEAP writes lists without entries as numbers
            raise self.fault(name, "holds no text")
        with self.damage(name):
            found = np.ravel(stored.dataset[()])
        return tuple(text(value) for value in found)


def text(value: Any) -> str:
    """Return bytes of a file as text; what is not UTF-8 as escapes."""
    return value.decode("utf-8", "backslashreplace") if isinstance(value, bytes) else str(value)


def check_unique(place: str, names: Sequence[str], what: str) -> None:
    """Raise InputError for names that are empty or repeat."""
    known: set[str] = set()
    for name in names:
        if not name:
            raise input_error(place, f"a {what} has no name", "name each of them")
        if name in known:
            found = f"the {what} {name!r} is there twice"
            raise input_error(place, found, "give each a name of its own")
        known.add(name)


def frame_ranges(count: int, at_once: int = BLOCK_FRAMES) -> Iterator[slice]:
    """Divide frames into blocks."""
    return (slice(start, min(start + at_once, count)) for start in range(0, count, at_once))


def read_edges(file: TrackerFile, name: str, count: int) -> tuple[tuple[int, int], ...]:
    """Return the pairs of landmarks in a dataset (e, 2); none where it is absent or empty."""
    if not file.is_dataset(name) or 0 in file.shape(name):
        return ()
    shape = file.shape(name)
    if len(shape) != 2 or shape[1] != 2:
        raise file.fault(name, f"has the shape {shape}, not (edges, 2)")
    pairs = file.numbers(name)
    if not ((pairs >= 0) & (pairs < count)).all():
        raise file.fault(name, "points at landmarks that are not there")
    return tuple((int(a), int(b)) for a, b in pairs)

"""Datasets of many chunks, read piece by piece, and how much memory they take."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from math import prod
from typing import Any, Self

import h5py
import numpy as np
from numpy.typing import NDArray

from shapefit.errors import input_error

TEXT = 100
"""Bytes of a short text in memory, and of the place where it is held."""

COPIES = 2
"""Of what is read: as it stands in the file, and as the records have it."""


MOST_COMPRESSED = 2000
"""No filter of HDF5 makes data smaller by more: beyond that they were never written."""


def was_written(dataset: Any) -> bool:
    """Whether the values of a dataset can have been written, by the place that they take."""
    return bool(dataset.nbytes <= MOST_COMPRESSED * dataset.id.get_storage_size())


@dataclass(frozen=True)
class Stored:
    """A dataset, and what h5py takes long to say of it, and every read wants to know."""

    dataset: Any
    text: bool
    shape: tuple[int, ...]
    chunks: tuple[int, ...] | None
    itemsize: int

    @classmethod
    def of(cls, dataset: Any) -> Self:
        """Ask a dataset once."""
        kind = dataset.dtype
        text = h5py.check_string_dtype(kind) is not None
        return cls(dataset, text, dataset.shape or (), dataset.chunks, kind.itemsize)


def size_in_memory(stored: Stored, rows: slice | tuple[()]) -> int:
    """Bytes that these rows of a dataset take while they are read, with a chunk of the file."""
    shape = stored.shape
    if shape and isinstance(rows, slice):
        shape = (len(range(*rows.indices(shape[0]))), *shape[1:])
    entry = TEXT if stored.text else COPIES * max(stored.itemsize, 8)
    chunk = prod(stored.chunks or ()) * stored.itemsize if prod(shape) else 0
    return prod(shape) * entry + chunk


MOST_CHUNKS = 10_000
"""That are read at once: HDF5 takes some 6 kB for each, whatever it holds."""

MOST_AT_ONCE = 1_000_000
"""Chunks of rows that are wanted together: more take HDF5 ten seconds and up."""

Place = tuple[slice, ...]


def read_rows(stored: Stored, rows: slice | tuple[()]) -> Any:
    """Return these rows of a dataset, texts as str; `()` is all of it, a scalar too.

    Raises InputError where they lie in more chunks than `MOST_AT_ONCE`.
    """
    source, chunks, shape = stored.dataset, stored.chunks, stored.shape
    if not chunks or _count(shape, chunks) <= MOST_CHUNKS:
        return _texts(source[rows]) if stored.text else source[rows]
    start, stop, _ = (rows if isinstance(rows, slice) else slice(None)).indices(shape[0])
    wanted = (max(stop - start, 0), *shape[1:])
    if (count := _count(wanted, chunks)) > MOST_AT_ONCE:
        place = f"{stored.dataset.file.filename}:{stored.dataset.name}"
        raise input_error(place, f"lies in {count} chunks", "store it in larger ones")
    values: NDArray[Any] = np.empty(wanted, object if stored.text else stored.dataset.dtype)
    for piece in _pieces(wanted, chunks):
        first = piece[0]
        values[piece] = source[slice(start + first.start, start + first.stop), *piece[1:]]
    return _texts(values) if stored.text else values


def _texts(stored: Any) -> Any:
    """Return bytes as str, an array of them as an array; in half the time of h5py's `asstr`."""
    if isinstance(stored, bytes):
        return stored.decode()
    texts = np.empty(stored.size, object)
    texts[:] = [*map(bytes.decode, stored.ravel().tolist())]
    return texts.reshape(stored.shape)


def _count(shape: tuple[int, ...], chunks: tuple[int, ...]) -> int:
    return prod(-(-size // chunk) for size, chunk in zip(shape, chunks, strict=True))


def _pieces(shape: tuple[int, ...], chunks: tuple[int, ...]) -> Iterator[Place]:
    """Divide an array into blocks of at most so many chunks each."""
    steps = list(shape)
    for axis, (size, chunk) in enumerate(zip(shape, chunks, strict=True)):
        others = _count(tuple(steps[axis + 1 :]), chunks[axis + 1 :])
        steps[axis] = min(size, chunk * max(MOST_CHUNKS // max(others, 1), 1))
    ranges = [range(0, size, max(step, 1)) for size, step in zip(shape, steps, strict=True)]
    for starts in product(*ranges):
        yield tuple(
            slice(start, min(start + step, size))
            for start, step, size in zip(starts, steps, shape, strict=True)
        )

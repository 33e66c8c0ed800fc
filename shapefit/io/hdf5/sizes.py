"""How much memory the datasets of an HDF5 file take once they are read."""

from __future__ import annotations

from dataclasses import dataclass
from math import prod
from typing import Any, Self

import h5py

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

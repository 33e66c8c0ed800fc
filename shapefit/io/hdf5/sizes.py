"""How much memory the datasets of an HDF5 file take once they are read."""

from __future__ import annotations

from math import prod
from typing import Any

TEXT = 100
"""Bytes of a short text in memory, and of the place where it is held."""

COPIES = 2
"""Of what is read: as it stands in the file, and as the records have it."""


def size_in_memory(dataset: Any, rows: slice | tuple[()], *, text: bool) -> int:
    """Bytes that these rows of a dataset take while they are read, with a chunk of the file."""
    shape = dataset.shape or ()
    if shape and isinstance(rows, slice):
        shape = (len(range(*rows.indices(shape[0]))), *shape[1:])
    entry = TEXT if text else COPIES * max(dataset.dtype.itemsize, 8)
    chunk = prod(dataset.chunks or ()) * dataset.dtype.itemsize if prod(shape) else 0
    return prod(shape) * entry + chunk

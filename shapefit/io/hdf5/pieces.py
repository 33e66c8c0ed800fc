"""Datasets of many chunks, read piece by piece."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product
from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shapefit.io.hdf5.sizes import Stored

MOST_CHUNKS = 10_000
"""That are read at once: HDF5 takes some 6 kB for each, whatever it holds."""

Place = tuple[slice, ...]


def read_rows(stored: Stored, rows: slice | tuple[()]) -> Any:
    """Return these rows of a dataset, texts as str; `()` is all of it, a scalar too."""
    source = stored.dataset.asstr() if stored.text else stored.dataset
    chunks, shape = stored.chunks, stored.shape
    if not chunks or _count(shape, chunks) <= MOST_CHUNKS:
        return source[rows]
    start, stop, _ = (rows if isinstance(rows, slice) else slice(None)).indices(shape[0])
    wanted = (max(stop - start, 0), *shape[1:])
    values: NDArray[Any] = np.empty(wanted, object if stored.text else stored.dataset.dtype)
    for piece in _pieces(wanted, chunks):
        first = piece[0]
        values[piece] = source[slice(start + first.start, start + first.stop), *piece[1:]]
    return values


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

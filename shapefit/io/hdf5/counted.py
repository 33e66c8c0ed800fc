"""Where the rows of an item are in a dataset that holds several rows for each item."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from shapefit.errors import input_error
from shapefit.io.layout import AXES, Dataset

if TYPE_CHECKING:
    from shapefit.io.hdf5.reading import Hdf5Reader


class CountedRows:
    """Adds up the counts of a file; goes on from where the last items began or ended."""

    def __init__(self) -> None:
        self._known: dict[str, dict[int, int]] = {}

    def of(self, reader: Hdf5Reader, dataset: Dataset, items: slice) -> slice:
        """Return the rows of a counted dataset that belong to these items.

        Raises InputError where the counts do not fit the dataset.
        """
        start, stop, _ = items.indices(reader.count)
        known = self._known.get(dataset.name, {})
        item, row = max((each for each in known.items() if each[0] <= start), default=(0, 0))
        first = row + _total(reader, dataset, slice(item, start))
        end = first + _total(reader, dataset, slice(start, stop))
        _check_length(reader, dataset, end, last=stop == reader.count)
        self._known[dataset.name] = {start: first, stop: end}
        return slice(first, end)


def _total(reader: Hdf5Reader, dataset: Dataset, items: slice) -> int:
    if items.start >= items.stop:
        return 0
    counts = reader.read(dataset.counted_by, items)
    axis = str(dataset.axes[0])
    most = reader.size("k") if axis == "a" else None
    most = most or reader.size(axis) or 0
    wrong = np.flatnonzero((counts < 0) | (counts > most))
    if len(wrong):
        place = reader.place(dataset.counted_by, items.start + int(wrong[0]))
        found = f"is {counts[wrong[0]]}, not a number of {AXES[axis]}"
        raise input_error(place, found, "the file was changed: fit again")
    return int(counts.sum())


def _check_length(reader: Hdf5Reader, dataset: Dataset, end: int, *, last: bool) -> None:
    axis = str(dataset.axes[0])
    length = reader.size(axis) or 0
    if end > length or (last and end != length):
        found = f"holds {length} {AXES[axis]}, and {dataset.counted_by} counts {end}"
        place = reader.place(dataset.name)
        raise input_error(place, found, "the file was changed: fit again")

"""What writers of our own layouts share: records that are all alike, one after the other."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shapefit.io.layout import Dataset, Layout
from shapefit.io.options import Summary
from shapefit.io.writing import NOTHING_APPENDED

Array = NDArray[Any]


def as_stored(dataset: Dataset, value: Any) -> Array:
    """Return a field of a record as it stands in a file: one point per row, texts as objects."""
    array = np.asarray(value, object) if dataset.kind == "text" else storable(np.asarray(value))
    array = array.astype(dataset.stored) if dataset.stored else array
    return array.swapaxes(-1, -2) if dataset.points else array


def storable(values: Array) -> Array:
    """Return texts as objects, numbers as they are."""
    return values.astype(object) if values.dtype.kind == "U" else values


class StoredWriter(ABC):
    """Appends records of one layout to a file.

    What is not per item comes from the first record. `attributes` are stored at the end;
    records that have attributes add theirs.
    """

    def __init__(self, form: Layout) -> None:
        self.attributes: dict[str, str | float | int] = {}
        self.summary = Summary()
        self._form = form
        self._first: Any = None
        self._whole: Mapping[str, Array] = {}

    def append(self, record: Any) -> None:
        """Write the items of a record after those that are there.

        Raises ValueError where its landmarks or datasets are not those of the first record.
        """
        columns = getattr(record, "further", {})
        of_file = getattr(record, "of_file", ())
        if self._first is None:
            self._first = record.take(slice(0)) if self._form.per_item else record
            self._whole = {name: columns[name] for name in columns if name in of_file}
        if record.landmark_names != self._first.landmark_names:
            raise ValueError("the landmarks of this record are not those of the first")
        # What was whole in the first record is per item by chance: it has as many rows as these.
        further = {k: values for k, values in columns.items() if k not in self._whole}
        self._write_items(record, further)
        self.attributes.update(getattr(record, "attributes", {}))

    @abstractmethod
    def _write_items(self, record: Any, further: Mapping[str, Array]) -> None:
        """Write what a record has for each item, `further` datasets too.

        Raises ValueError where these are not the datasets of the first record.
        """

    def _check_begun(self) -> None:
        """Raise ValueError where nothing was appended."""
        if self._first is None:
            raise ValueError(NOTHING_APPENDED)


def check_alike(datasets: object, first: object) -> None:
    """Raise ValueError where the datasets of a record are not those of the first."""
    if datasets != first:
        raise ValueError("the datasets of this record are not those of the first")

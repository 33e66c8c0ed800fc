"""Records that a program gives in place of files: the same checks, the same errors."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from shapefit.dictionary.model import Dictionary
from shapefit.io.joined import Source, SourceFile
from shapefit.io.kinds.dictionaries import check_dictionary
from shapefit.io.landmark_names import check_known
from shapefit.io.layout import DICTIONARY, Format, fit_axes
from shapefit.io.name_index import ItemList
from shapefit.io.records import LandmarkSet, Record
from shapefit.io.stored.checks import check_values


class Given:
    """Datasets in memory, with what the checks ask an open file for."""

    def __init__(self, name: str, record: Any, form: Format) -> None:
        self._name = name
        self._values: Mapping[str, Any] = {
            dataset.name: getattr(record, dataset.attribute) for dataset in form.datasets
        }
        self._sizes: dict[str, int] = {}
        for dataset in form.datasets:
            if (value := self._values[dataset.name]) is not None:
                shape = (len(value),) if dataset.kind == "text" else value.shape
                fit_axes(dataset.memory_axes, shape, self._sizes)
        self.landmark_names: tuple[str, ...] = record.landmark_names

    def has(self, name: str) -> bool:
        """Whether there is such a dataset."""
        return self._values[name] is not None

    def size(self, axis: str) -> int | None:
        """Length of an axis of the format; None if nothing has it."""
        return self._sizes.get(axis)

    def place(self, name: str, row: int | None = None) -> str:
        """Name a dataset, or a row of it, in messages."""
        whole = self._name if name == self._name else f"{self._name}.{name}"
        return whole + ("" if row is None else f"[{row}]")

    def read(self, name: str) -> Any:
        """Return a dataset; None if there is none."""
        return self._values[name]

    def read_blocks(self, name: str, part: slice | None = None) -> Iterator[Any]:
        """Read a dataset, or the rows of a part of it."""
        yield self._values[name][part or slice(None)]

    def is_written(self, name: str) -> bool:
        """Whether the dataset has values: in memory all have."""
        return True


def given_source(
    records: Record, name: str, rename: Mapping[str, str], *, gaps: bool = False
) -> Source[Record]:
    """Return landmarks or shapes in memory as a source; `name` stands for a file in messages.

    With `gaps` landmarks of shapes may be unknown. Raises InputError as for what a file holds.
    """
    given = Given(name, records, records.FORM)
    check_values(given, records.FORM, gaps=gaps, items=records.items)
    check_known(rename, [(name, records.landmark_names)])
    records = records.with_whole_points().renamed(rename, name)
    items = ItemList(lambda: [records.items], lambda row: given.place("item", row))
    stated = records.y_axis if isinstance(records, LandmarkSet) else None
    return Source([SourceFile.held(name, records, items, y_axis=stated)])


def check_given_dictionary(dictionary: Dictionary, name: str) -> None:
    """Raise InputError for what `read_dictionary` would not read from a file."""
    check_dictionary(Given(name, dictionary, DICTIONARY))

"""Read files of 2D landmarks in chunks, several files as one."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, Self

import numpy as np

from shapefit.io.agreement import agreed, check_same_extras
from shapefit.io.duplicates import ItemList, check_unique_items
from shapefit.io.extras import Extras
from shapefit.io.layout import LANDMARKS, UNKNOWN_UNIT
from shapefit.io.records import LandmarkSet, concatenate
from shapefit.io.sources import is_hdf5, source_name

Read = Callable[[slice], LandmarkSet]
Direction = Literal["up", "down"]


@dataclass(frozen=True)
class _File:
    """One file of a source: `head` has all but the images, `open` gives a reader of rows."""

    name: str
    head: LandmarkSet
    y_axis: Direction | None
    count: int
    items: ItemList
    open: Callable[[], AbstractContextManager[Read]]


def open_landmarks(paths: Sequence[Path]) -> LandmarkSource:
    """Open HDF5 and CSV files of landmarks (`-` is standard input) as one source.

    Everything is checked before the first image is given out. Raises InputError for what is
    wrong with a file, for items that occur twice, and for files that do not go together (other
    units, directions of y, or further datasets). HDF5 is read a chunk at a time, CSV whole.
    """
    return LandmarkSource([_open(path) for path in paths])


class LandmarkSource:
    """The images of one or more files: `with open_landmarks(paths) as source: ...`.

    Landmarks are matched by name: `landmark_names` are those of all files in order of
    appearance, and what a file lacks is unseen. `count` images have `unit` and `y_axis`.
    """

    def __init__(self, files: Sequence[_File]) -> None:
        self._files = files
        self._running: list[Generator[LandmarkSet, None, None]] = []
        check_unique_items([file.items for file in files])
        self._check_agreement()

    @property
    def landmark_names(self) -> tuple[str, ...]:
        """Names of the landmarks, in the order of the arrays."""
        return self._head.landmark_names

    @property
    def count(self) -> int:
        """Number of images."""
        return sum(file.count for file in self._files)

    @property
    def unit(self) -> str:
        """Unit of the landmarks."""
        return self._head.unit

    @property
    def y_axis(self) -> Direction:
        """Whether y points up or down."""
        return self._head.y_axis

    @property
    def further_datasets(self) -> tuple[str, ...]:
        """Names of the datasets that the format does not know."""
        return tuple(self._head.extras)

    def chunks(self, size: int) -> Iterator[LandmarkSet]:
        """Give out the images in order, `size` at a time (fewer in the last chunk).

        A source without images gives one empty set, so that what is made of it can be written.
        """
        if size < 1:
            raise ValueError(f"size must be at least 1, not {size}")
        chunks = self._read(size)
        self._running.append(chunks)
        return chunks

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        for chunks in self._running:
            chunks.close()

    def _read(self, size: int) -> Generator[LandmarkSet, None, None]:
        if self.count == 0:
            yield self._head
        parts: list[LandmarkSet] = []
        room = size
        for file in self._files:
            with file.open() as read:
                start = 0
                while start < file.count:
                    stop = min(start + room, file.count)
                    parts.append(self._conform(read(slice(start, stop)), file.name))
                    room -= stop - start
                    start = stop
                    if room == 0:
                        yield concatenate(parts)
                        parts, room = [], size
        if parts:
            yield concatenate(parts)

    def _check_agreement(self) -> None:
        """Set the head of the whole source; InputError where its files do not go together."""
        files = [file for file in self._files if file.count] or self._files
        units = [(file.name, _stated_unit(file.head)) for file in files]
        check_same_extras([(file.name, Extras.of(file.head.extras, 0)) for file in files])
        first = files[0].head
        names = dict.fromkeys(name for file in files for name in file.head.landmark_names)
        sequences = any(file.head.sequences is not None for file in files)
        confidence = any(file.head.confidence is not None for file in files)
        self._head = LandmarkSet(
            landmarks=np.empty((0, 2, len(names))),
            confidence=np.empty((0, len(names))) if confidence else None,
            landmark_names=tuple(names),
            items=(),
            sequences=() if sequences else None,
            unit=agreed("unit", units, UNKNOWN_UNIT),
            y_axis=agreed("y_axis", [(file.name, file.y_axis) for file in files], "up"),
            extras=first.arrange(tuple(names)).extras,
        )

    def _conform(self, part: LandmarkSet, place: str) -> LandmarkSet:
        """Give a part of one file the landmarks and fields of the whole source."""
        changes: dict[str, Any] = {"unit": self._head.unit, "y_axis": self._head.y_axis}
        if self._head.confidence is not None and part.confidence is None:
            changes["confidence"] = np.ones((len(part), len(part.landmark_names)))
        if self._head.sequences is not None and part.sequences is None:
            changes["sequences"] = ("",) * len(part)
        return replace(part, **changes).arrange(self._head.landmark_names, place)


def _stated_unit(head: LandmarkSet) -> str | None:
    return None if head.unit == UNKNOWN_UNIT else head.unit


def _open(path: Path) -> _File:
    return _open_hdf5(path) if is_hdf5(path) else _open_table(path)


def _open_table(path: Path) -> _File:
    from shapefit.io.csv_tables import read_landmark_table

    table = read_landmark_table(path)
    name = source_name(path)
    items = ItemList(lambda: [table.items], lambda _: name)
    return _File(
        name, table.take(slice(0)), None, len(table), items, lambda: nullcontext(table.take)
    )


def _open_hdf5(path: Path) -> _File:
    from shapefit.io import hdf5_checks
    from shapefit.io.hdf5_reading import Hdf5Reader

    @contextmanager
    def opened() -> Iterator[Read]:
        with Hdf5Reader(path, LANDMARKS) as reader:
            yield lambda rows: _read_rows(reader, rows)

    def items() -> Iterator[tuple[str, ...]]:
        with Hdf5Reader(path, LANDMARKS) as reader:
            yield from reader.read_blocks("item")

    with Hdf5Reader(path, LANDMARKS) as reader:
        hdf5_checks.check_named(reader, reader.read_blocks("item"))
        hdf5_checks.check_not_infinite(reader, "landmarks", reader.read_blocks("landmarks"))
        if reader.has("confidence"):
            hdf5_checks.check_confidence(reader, reader.read_blocks("confidence"))
        head = _read_rows(reader, slice(0))
        item_list = ItemList(items, lambda row: f"{path}:/item[{row}]")
        return _File(str(path), head, head.y_axis, reader.count, item_list, opened)


def _read_rows(reader: Any, rows: slice) -> LandmarkSet:
    fields = reader.fields(rows)
    landmarks = fields["landmarks"]
    unseen = np.isnan(landmarks).any(axis=1, keepdims=True)
    fields["landmarks"] = np.where(unseen, np.nan, landmarks)
    extras = reader.extras(rows)
    return LandmarkSet(**fields, unit=reader.unit, y_axis=reader.y_axis, extras=extras)

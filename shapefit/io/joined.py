"""Several files of records as one source, some items at a time."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass, replace
from itertools import chain
from typing import Any, Generic, Self

import numpy as np
from numpy.typing import NDArray

from shapefit.io.agreement import common_head, conform
from shapefit.io.columns import stretches
from shapefit.io.name_index import ItemList, check_unique_items
from shapefit.io.options import Direction
from shapefit.io.records import LandmarkSet, Record, ResultSet, ShapeSet, concatenate


@dataclass(frozen=True)
class SourceFile(Generic[Record]):
    """One file of a source: `head` has all but the items, `open` gives a reader of rows.

    notes are warnings about what was left out of it; `sequences` reads those of all items, if it
    has any; y_axis is where y points, None where it does not say it.
    """

    name: str
    head: Record
    count: int
    items: ItemList
    open: Callable[[], AbstractContextManager[Callable[[slice], Record]]]
    notes: tuple[str, ...] = ()
    sequences: Callable[[], Iterable[Sequence[str]]] = tuple
    y_axis: Direction | None = None

    @classmethod
    def held(cls, name: str, records: Record, items: ItemList | None = None, **said: Any) -> Self:
        """Return records in memory as a file; without `items` messages name the file alone."""
        return cls(
            name,
            records.take(slice(0)),
            len(records),
            items or ItemList(lambda: [records.items], lambda _: name),
            lambda: nullcontext(records.take),
            sequences=lambda: [records.sequences or ()],
            **said,
        )

    def changed(self, change: Callable[[Record], Record]) -> Self:
        """Return a file that gives its records out changed, its head too."""

        @contextmanager
        def opened() -> Iterator[Callable[[slice], Record]]:
            with self.open() as read:
                yield lambda rows: change(read(rows))

        return replace(self, head=change(self.head), open=opened)


class Source(Generic[Record]):
    """The items of one or more files; a context manager, which closes the files.

    `head` has all but the items: their landmarks, unit, datasets; `count` is how many items there
    are. y_axis is where y points in files that do not say it.
    """

    def __init__(self, files: Sequence[SourceFile[Record]], y_axis: Direction = "down") -> None:
        """Take files; raises InputError for items that occur twice, and for files that differ."""
        self._files = files
        self._running: list[Generator[Record, None, None]] = []
        self.count = sum(file.count for file in files)
        self.head: Record = self._checked_head(y_axis)

    def _checked_head(self, y_axis: Direction) -> Record:
        """Return what all items have in common; files without items do not count."""
        check_unique_items([file.items for file in self._files])
        filled = [file for file in self._files if file.count] or self._files[:1]
        heads = [(file.name, file.head) for file in filled]
        head: Record = common_head(heads, [(f.name, f.y_axis) for f in filled], y_axis)
        return head

    @property
    def states_y_axis(self) -> bool:
        """Whether a file says where y points."""
        return any(file.y_axis is not None for file in self._files)

    @property
    def notes(self) -> tuple[str, ...]:
        """Warnings about what was left out of the files."""
        return tuple(note for file in self._files for note in file.notes)

    def chunks(self, size: int) -> Iterator[Record]:
        """Give out the items in order, `size` at a time (fewer in the last chunk).

        A source without items gives one empty set, so that what is made of it can be written.
        """
        if size < 1:
            raise ValueError(f"size must be at least 1, not {size}")
        chunks = self._read(size)
        self._running.append(chunks)
        return chunks

    def file_chunks(self, size: int) -> Iterator[Record]:
        """Give out the items like `chunks`, but none of two files together.

        So what is made of a file does not depend on those before it.
        """
        chunks = self._read_files(size)
        self._running.append(chunks)
        return chunks

    def names(self) -> Iterator[Sequence[str]]:
        """Read the items, block by block."""
        return chain.from_iterable(file.items.blocks() for file in self._files)

    def sequences(self) -> Iterator[Sequence[str]]:
        """Read the sequences of all items, block by block; an empty text where there is none."""
        for file in self._files:
            if file.head.sequences is None:
                yield ("",) * file.count
            else:
                yield from file.sequences()

    def take(self, rows: NDArray[np.intp]) -> Record:
        """Return the items of these rows, which ascend, none twice; near ones are read together."""
        parts: list[Record] = []
        starts = np.cumsum([0, *(file.count for file in self._files)])
        numbers = np.searchsorted(starts, rows, "right") - 1
        for number in np.unique(numbers).tolist():
            file, own = self._files[number], rows[numbers == number] - starts[number]
            with file.open() as read:
                for near in (own[part] for part in stretches(own)):
                    first, last = int(near[0]), int(near[-1])
                    part = read(slice(first, last + 1))
                    part = part if len(part) == len(near) else part.take(near - first)
                    parts.append(conform(part, self.head, file.name))
        return concatenate(parts) if parts else self.head

    def whole(self) -> Record:
        """Return all items as one record."""
        return concatenate(list(self.chunks(max(self.count, 1))))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        for chunks in self._running:
            chunks.close()

    def _read(self, size: int) -> Generator[Record, None, None]:
        parts: list[Record] = []
        held = 0
        for part in self._read_files(size):
            while held + len(part) > size:
                if room := size - held:
                    parts.append(part.take(slice(0, room)))
                    part = part.take(slice(room, None))
                yield concatenate(parts)
                parts, held = [], 0
            parts.append(part)
            held += len(part)
        if parts:
            yield concatenate(parts)

    def _read_files(self, size: int) -> Generator[Record, None, None]:
        if self.count == 0:
            yield self.head
        for file in self._files:
            with file.open() as read:
                for start in range(0, file.count, size):
                    rows = slice(start, min(start + size, file.count))
                    yield conform(read(rows), self.head, file.name)


LandmarkSource = Source[LandmarkSet]
ShapeSource = Source[ShapeSet]
ResultSource = Source[ResultSet]

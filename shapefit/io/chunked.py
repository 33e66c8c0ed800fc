"""Several files of records, read as one, some items at a time."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain
from typing import Any, Generic, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from shapefit.io.duplicates import ItemList, check_unique_items
from shapefit.io.records import LandmarkSet, ResultSet, ShapeSet, concatenate
from shapefit.io.renaming import renamed
from shapefit.io.spilled.columns import stretches

Record = TypeVar("Record", ShapeSet, LandmarkSet, ResultSet)


@dataclass(frozen=True)
class SourceFile(Generic[Record]):
    """One file of a source: `head` has all but the items, `open` gives a reader of rows.

    notes are warnings about what was left out of it.
    """

    name: str
    head: Record
    count: int
    items: ItemList
    open: Callable[[], AbstractContextManager[Callable[[slice], Record]]]
    notes: tuple[str, ...] = ()


File = TypeVar("File", bound=SourceFile[Any])


def changed(file: File, change: Callable[[Any], Any]) -> File:
    """Return a file that gives its records out changed, its head too."""

    @contextmanager
    def opened() -> Iterator[Callable[[slice], Any]]:
        with file.open() as read:
            yield lambda rows: change(read(rows))

    return replace(file, head=change(file.head), open=opened)


def with_names(file: File, rename: Mapping[str, str]) -> File:
    """Return a file that gives its landmarks out under their new names (`renamed`)."""
    return changed(file, partial(renamed, rename=rename, place=file.name)) if rename else file


class ChunkedSource(ABC, Generic[Record, File]):
    """The items of one or more files; a context manager, which closes the files."""

    def __init__(self, files: Sequence[File]) -> None:
        """Take files; raises InputError for items that occur twice."""
        self._files = files
        self._running: list[Generator[Record, None, None]] = []
        check_unique_items([file.items for file in files])

    @property
    @abstractmethod
    def head(self) -> Record:
        """All of the source but its items."""

    @abstractmethod
    def _conform(self, part: Record, place: str) -> Record:
        """Give a part of one file the landmarks and fields of the whole source."""

    @property
    def count(self) -> int:
        """Number of items."""
        return sum(file.count for file in self._files)

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
                    parts.append(self._conform(part, file.name))
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
                room = size - held
                parts.append(part.take(slice(0, room)))
                yield concatenate(parts)
                part = part.take(slice(room, None))
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
                    yield self._conform(read(rows), file.name)

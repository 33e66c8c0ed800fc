"""Several files of records as one source: whether they go together, and some items at a time."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass, replace
from itertools import chain
from typing import Any, Generic, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from shapefit.errors import input_error, listed
from shapefit.io.columns import stretches
from shapefit.io.layout import EDGES, UNKNOWN_UNIT
from shapefit.io.name_index import ItemList, check_unique_items
from shapefit.io.options import Direction
from shapefit.io.problems import Axis, check_magnitudes
from shapefit.io.records import LandmarkSet, Record, ResultSet, ShapeSet, concatenate

Array = NDArray[Any]
Text = TypeVar("Text", bound=str)
APART = "use files that agree, or process them separately"
ALL_OR_NONE = "give it to all files (CSV cannot hold it) or to none, or process them separately"


def common_head(
    heads: Sequence[tuple[str, Any]],
    y_axes: Sequence[tuple[str, Direction | None]],
    y_axis: Direction | None,
) -> Any:
    """Return what all items of files have in common, each head and direction with the file's name.

    The landmarks of images are those of all files in order of appearance, those of shapes and of
    results are the same in all; where no file states the direction of y, it is `y_axis`, and down
    without. Raises InputError where files do not go together, or state another direction.
    """
    (_, first), *_ = heads
    names = first.landmark_names
    if isinstance(first, LandmarkSet):
        names = tuple(dict.fromkeys(name for _, head in heads for name in head.landmark_names))
    if isinstance(first, ResultSet):
        _check_same_datasets(heads)
    else:
        heads = [(place, head.arrange(names, place)) for place, head in heads]
    if isinstance(first, LandmarkSet):
        stated = (_edges(head) for _, head in heads)
        lines = next((each for each in stated if each is not None), None)
        heads = [(place, _with_edges(head, lines)) for place, head in heads]
    if isinstance(first, ShapeSet):
        meshes = [(place, head.mesh_vertices) for place, head in heads]
        sizes = [(place, None if m is None else np.array(m.shape[1:])) for place, m in meshes]
        check_same_array("mesh", sizes)
        check_same_array("mesh_faces", [(place, head.mesh_faces) for place, head in heads])
    check_same_columns(heads)
    units = [(place, None if head.unit == UNKNOWN_UNIT else head.unit) for place, head in heads]
    changes: dict[str, Any] = {
        "unit": agreed("unit", units, UNKNOWN_UNIT),
        "frame_rate": agreed_rate([(place, head.frame_rate) for place, head in heads]),
    }
    if not isinstance(first, ShapeSet):
        changes["y_axis"] = found = agreed("y_axis", y_axes, y_axis or "down")
        if y_axis not in (None, found):
            place = next(place for place, stated in y_axes if stated == found)
            fix = "leave the key out; if the file is wrong, correct its attribute y_axis"
            raise input_error(place, f"states that y points {found}, and `y_axis` is {y_axis}", fix)
    for name in ("sequences", "confidence", "edges"):
        known = (getattr(head, name, None) for _, head in heads)
        if (value := next((each for each in known if each is not None), None)) is not None:
            changes[name] = value
    return heads[0][1].replaced(**changes)


def conform(part: Any, head: Any, place: str) -> Any:
    """Return a part of one file with the landmarks and fields of the whole source."""
    changes: dict[str, Any] = {"unit": head.unit, "frame_rate": head.frame_rate}
    if head.sequences is not None and part.sequences is None:
        changes["sequences"] = ("",) * len(part)
    if isinstance(part, ResultSet):
        items, landmarks = Axis("item", part.items), Axis("landmark", part.landmark_names)
        check_magnitudes(place, part.shapes, items, landmarks)
        return part.replaced(**changes, y_axis=head.y_axis, attributes=head.attributes)
    if isinstance(part, ShapeSet):
        return part.arrange(head.landmark_names, place).replaced(**changes, edges=head.edges)
    if head.confidence is not None and part.confidence is None:
        changes["confidence"] = np.ones((len(part), len(part.landmark_names)))
    part = part.replaced(**changes, y_axis=head.y_axis).arrange(head.landmark_names, place)
    return _with_edges(part, _edges(head))


def _edges(images: LandmarkSet) -> Array | None:
    return images.columns.get(EDGES)


def _with_edges(images: LandmarkSet, edges: Array | None) -> LandmarkSet:
    """Return images whose edges are those of the first file that has any."""
    if edges is None:
        return images
    return images.with_columns({EDGES: edges}, of_file=[EDGES])


def agreed(what: str, stated: Sequence[tuple[str, Text | None]], default: Text) -> Text:
    """Return what all files state, `default` if none does; each comes with its name.

    Raises InputError where two files differ.
    """
    first: tuple[str, Text] | None = None
    for place, value in stated:
        if value is None:
            continue
        if first is None:
            first = (place, value)
        elif value != first[1]:
            found = f"its {what} is '{value}', that of {first[0]} is '{first[1]}'"
            raise input_error(place, found, APART)
    return default if first is None else first[1]


def agreed_rate(stated: Sequence[tuple[str, float | None]]) -> float | None:
    """Return the frame rate that all files state, None if none does; raises as `agreed`."""
    texts = [(place, None if rate is None else f"{rate:.17g}") for place, rate in stated]
    text = agreed("frame_rate", texts, "")
    return float(text) if text else None


def check_same_array(what: str, files: Sequence[tuple[str, NDArray[np.int64] | None]]) -> None:
    """Raise InputError unless all files have the same array, or none has it."""
    for place, array in files[1:]:
        _compare(what, files[0], (place, array))


def check_same_columns(heads: Sequence[tuple[str, Any]]) -> None:
    """Raise InputError unless all files have the same columns beside those of the layout.

    Those per item must agree in the shape of a row, the others in their values.
    """
    (first_place, first), *others = heads
    for place, head in others:
        one, other = first.further.keys(), head.further.keys()
        for has, names in (("has no", one - other), ("has the", other - one)):
            if names:
                found = f"{has} dataset {', '.join(sorted(names))}, unlike {first_place}"
                raise input_error(place, found, ALL_OR_NONE)
        for name in one:
            arrays = _comparable(first, name), _comparable(head, name)
            _compare(f"dataset {name}", (first_place, arrays[0]), (place, arrays[1]))


def _check_same_datasets(heads: Sequence[tuple[str, ResultSet]]) -> None:
    """Raise InputError unless all results have the same landmarks and datasets."""
    (first_place, first), *others = heads
    for place, head in others:
        if head.landmark_names != first.landmark_names:
            found = f"its landmarks are not those of {first_place}, in their order"
            raise input_error(place, found, APART)
        if differing := sorted(head.datasets ^ first.datasets):
            found = f"only one of it and {first_place} has {listed(differing, 'and')}"
            raise input_error(place, found, APART)


def _comparable(head: Any, name: str) -> Array:
    if name in head.of_file:
        return np.asarray(head.columns[name])
    return np.array(["per item", *head.columns[name].shape[1:]], dtype=object)


def _compare(what: str, first: tuple[str, Array | None], file: tuple[str, Array | None]) -> None:
    place, array = file
    first_place, expected = first
    if array is None and expected is None:
        return
    if array is None:
        raise input_error(place, f"has no {what}, unlike {first_place}", APART)
    if expected is None:
        raise input_error(place, f"has a {what}, unlike {first_place}", APART)
    floats = array.dtype.kind == expected.dtype.kind == "f"
    if not np.array_equal(array, expected, equal_nan=floats):
        raise input_error(place, f"its {what} is not that of {first_place}", APART)


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

    def __init__(
        self, files: Sequence[SourceFile[Record]], y_axis: Direction | None = None
    ) -> None:
        """Take files; raises InputError for items that occur twice, and for files that differ."""
        self._files = files
        self._running: list[Generator[Record, None, None]] = []
        self.count = sum(file.count for file in files)
        self.head: Record = self._checked_head(y_axis)

    def _checked_head(self, y_axis: Direction | None) -> Record:
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

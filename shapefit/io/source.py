"""Files of landmarks, shapes and results, in any format, as one source that gives out batches."""

from __future__ import annotations

from collections.abc import Callable, Collection, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from typing import Any, Generic, Self

import numpy as np
from numpy.typing import NDArray

from shapefit.errors import input_error
from shapefit.io.checks import check_magnitudes, check_values, place_in_memory, warn_of_zeros
from shapefit.io.formats import (
    HDF5,
    FileFormat,
    check_holds,
    detect_format,
    group_inputs,
    mixture,
    record_writer,
)
from shapefit.io.inputs import source_name
from shapefit.io.joined import common_head, conform
from shapefit.io.layout import LANDMARKS, PROOF, RESULTS, SHAPES, UNKNOWN_UNIT, Layout
from shapefit.io.names import check_items, check_known
from shapefit.io.options import AS_THEY_ARE, Direction, InputOptions
from shapefit.io.readers.items import keep_landmarks, size_needed
from shapefit.io.readers.poses import are_fractions
from shapefit.io.records import LandmarkSet, Record, ResultSet, ShapeSet, concatenate

PROOFS = frozenset(PROOF)
"""Datasets of results that stay in the file unless they are asked for."""

CENTRED = 0.1
"""Share of coordinates below 0 from which on they are no fractions of an image, but points about
a centre in a unit of their own."""

MOST_HELD = 1 << 21
"""Landmarks of all items and files together that are held, some 50 MB; more are read again."""

BLOCK = 1 << 12
"""Images by which landmarks are first looked at."""

CHECKED_BYTES = 1 << 24
"""Of an HDF5 file that are read at a time to be checked."""

GAP = 1 << 10
"""Rows that are read and dropped rather than begun anew behind them."""


def open_landmarks(
    paths: Sequence[Path],
    options: InputOptions = AS_THEY_ARE,
    rows: slice | None = None,
    *,
    selects: bool = False,
    check: bool = True,
    largest: int | None = None,
) -> LandmarkSource:
    """Open files of landmarks in any format (`-` is standard input) as one source.

    Everything is checked before the first image is given out. Raises InputError for what is
    wrong with a file, for items that occur twice, and for files that do not go together (other
    units, directions of y, frame rates, or further datasets), and for names of landmarks to rename
    that no file has. HDF5 is read a batch at a time, all else whole. `rows` are those of the one
    HDF5 file that are given out: nothing else of it is read. Without `check` nothing but
    heads is read of HDF5, and values and names are believed. The caller `selects` the individual
    in files of ours, or it is refused there. Further datasets of HDF5 of more bytes than `largest`
    are not read.
    """
    how: dict[str, Any] = {"rows": rows, "check": check, "largest": largest}
    files = _open_all(LANDMARKS, paths, options, selects, **how)
    return Source(files, options.y_axis, check=check)


def open_shapes(
    paths: Sequence[Path],
    options: InputOptions = AS_THEY_ARE,
    *,
    gaps: bool = False,
    selects: bool = False,
    check: bool = True,
    largest: int | None = None,
) -> ShapeSource:
    """Open files of shapes in any format (`-` is standard input) as one source.

    Landmarks are matched by name and stand in the order of the first file, items in the order of
    the files; where only some files have sequences, those of the others are empty texts.
    Everything is checked before the first shape is given out. Raises InputError for what is wrong
    with a file, for items that occur twice, and for files that do not go together (other
    landmarks, units, meshes or further datasets). HDF5 is read a batch at a time, all else whole.

    With `gaps` a landmark of an item may be unknown: it is NaN, in all coordinates where it is in
    one, and may lack its row in CSV. Without, that is wrong. `check`, `selects` and `largest` as
    in `open_landmarks`.
    """
    how: dict[str, Any] = {"gaps": gaps, "check": check, "largest": largest}
    files = _open_all(SHAPES, paths, options, selects, **how)
    return Source(files, check=check)


def open_results(
    paths: Sequence[Path],
    without: Collection[str] | None = None,
    *,
    proofs: bool = False,
    check: bool = True,
    old: bool = False,
    largest: int | None = None,
) -> ResultSource:
    """Open results as one source; datasets in `without` are not read.

    That is what proves the optimum, unless `proofs` asks for it. Of CSV all but
    shapes, names, items and sequences is None. HDF5 is read a batch at a time, CSV whole. Raises
    InputError for what is wrong with a file, for items that occur twice, and for files that do not
    go together. `check` and `largest` as in `open_landmarks`; `old` files of version 1 are read,
    too.
    """
    left = (() if proofs else PROOFS) if without is None else without
    known = [(detect_format(path), (path,)) for path in paths]
    how: dict[str, Any] = {"without": left, "check": check, "old": old, "largest": largest}
    files = [_open(RESULTS, *own, AS_THEY_ARE, **how) for own in known]
    return Source(files, check=check)


def source_of(
    records: Record, name: str, rename: Mapping[str, str], *, gaps: bool = False
) -> Source[Record]:
    """Return landmarks or shapes in memory as a source; `name` stands for a file in messages.

    With `gaps` landmarks of shapes may be unknown. Raises InputError as for what a file holds.
    """
    place = place_in_memory(name)
    check_values(records.columns, records.LAYOUT, place, records.landmark_names, gaps=gaps)
    check_known(rename, [(name, records.landmark_names)])
    records = records.with_whole_points().renamed(rename, name)
    stated = records.y_axis if isinstance(records, LandmarkSet) else None
    file = SourceFile.held(name, records, lambda row: place("item", row), y_axis=stated)
    return Source([file])


def read_shapes(
    paths: Sequence[Path], options: InputOptions = AS_THEY_ARE, *, gaps: bool = False
) -> ShapeSet:
    """Read shapes from files of any format as one set, as `open_shapes` opens them."""
    with open_shapes(paths, options, gaps=gaps) as source:
        return source.whole()


def read_results(path: Path, *, proofs: bool = False) -> ResultSet:
    """Read a result from a file of any format that has one (`-` is standard input), as one.

    What proves the optimum stays in the file unless `proofs` asks for it. Raises InputError as
    `open_results`.
    """
    with open_results([path], proofs=proofs) as source:
        return source.whole()


def write_shapes(path: Path, shapes: ShapeSet) -> None:
    """Write shapes to HDF5, or to a table where the name says so (without mesh and edges).

    Raises InputError where the file cannot be written; the old one then stays as it was.
    """
    with record_writer(path, SHAPES) as writer:
        writer.append(shapes)


Reader = Callable[[slice], Record]


@dataclass(frozen=True)
class SourceFile(Generic[Record]):
    """One file of a source: `head` has all but the items, `open` gives a reader of rows.

    texts reads the datasets item and sequence of all items anew, block by block; `place` names a
    row in messages; notes are warnings about what was left out; y_axis is where y points, None
    where the file does not say it.
    """

    name: str
    head: Record
    count: int
    open: Callable[[], AbstractContextManager[Reader[Record]]]
    texts: Callable[[str], Iterable[Sequence[str]]]
    place: Callable[[int], str]
    notes: tuple[str, ...] = ()
    y_axis: Direction | None = None

    @classmethod
    def held(
        cls, name: str, records: Record, place: Callable[[int], str] | None = None, **stated: Any
    ) -> Self:
        """Return records in memory as a file; without `place` messages name the file alone."""
        return cls(
            name=name,
            head=records.take(slice(0)),
            count=len(records),
            open=lambda: nullcontext(records.take),
            texts=lambda kind: [records.items if kind == "item" else records.sequences or ()],
            place=place or (lambda _: name),
            **stated,
        )

    def changed(self, change: Callable[[Record], Record]) -> Self:
        """Return a file that gives its records out changed, its head too."""

        @contextmanager
        def opened() -> Iterator[Reader[Record]]:
            with self.open() as read:
                yield lambda rows: change(read(rows))

        return replace(self, head=change(self.head), open=opened)

    def called(self, name: str) -> Self:
        """Return the file with its items and sequences called `name/...`."""

        def longer(texts: Iterable[str]) -> tuple[str, ...]:
            return tuple(text and f"{name}/{text}" for text in texts)

        def change(records: Record) -> Record:
            known = records.sequences
            sequences = None if known is None else longer(known)
            return records.replaced(items=longer(records.items), sequences=sequences)

        return replace(self.changed(change), texts=lambda kind: map(longer, self.texts(kind)))


class Source(Generic[Record]):
    """The items of one or more files; a context manager, which closes the files.

    `head` has all but the items: their landmarks, unit, columns; `count` is how many items there
    are. y_axis is where y points in files that do not say it.
    """

    def __init__(
        self,
        files: Sequence[SourceFile[Record]],
        y_axis: Direction | None = None,
        *,
        check: bool = True,
    ) -> None:
        """Take files; raises InputError for files that differ, and, if `check`, equal items in one.

        Items that are in two files begin with the name of their file, as all then do.
        """
        if check:
            files = _told_apart(files)
        self._files = files
        self._running: list[Generator[Record, None, None]] = []
        self.count = sum(file.count for file in files)
        filled = [file for file in files if file.count] or files[:1]  # what is empty may differ
        heads = [(file.name, file.head) for file in filled]
        self.head: Record = common_head(heads, [(f.name, f.y_axis) for f in filled], y_axis)

    @property
    def states_y_axis(self) -> bool:
        """Whether a file says where y points."""
        return any(file.y_axis is not None for file in self._files)

    @property
    def notes(self) -> tuple[str, ...]:
        """Warnings about what was left out of the files."""
        return tuple(note for file in self._files for note in file.notes)

    def batches(self, size: int, *, by_file: bool = False) -> Iterator[Record]:
        """Give out the items in order, `size` at a time (fewer in the last batch).

        `by_file` gives none of two files together, so that what is made of a file does not depend
        on those before it. A source without items gives one empty set, so that what is made of it
        can be written.
        """
        if size < 1:
            raise ValueError(f"size must be at least 1, not {size}")
        batches = self._read_files(size) if by_file else self._read(size)
        self._running.append(batches)
        return batches

    def first(self, count: int) -> Record:
        """Return the first items, at most `count`."""
        return next(self.batches(count))

    def whole(self) -> Record:
        """Return all items as one record."""
        return concatenate(list(self.batches(max(self.count, 1))))

    def names(self) -> Iterator[Sequence[str]]:
        """Read the items, block by block."""
        return chain.from_iterable(file.texts("item") for file in self._files)

    def sequences(self) -> Iterator[Sequence[str]]:
        """Read the sequences of all items, block by block; an empty text where there is none."""
        for file in self._files:
            if file.head.sequences is None:
                yield ("",) * file.count
            else:
                yield from file.texts("sequence")

    def take(self, rows: NDArray[np.intp]) -> Record:
        """Return the items of these rows, which ascend, none twice; near ones are read together."""
        parts: list[Record] = []
        starts = np.cumsum([0, *(file.count for file in self._files)])
        numbers = np.searchsorted(starts, rows, "right") - 1
        for number in np.unique(numbers).tolist():
            file, own = self._files[number], rows[numbers == number] - starts[number]
            with file.open() as read:
                for near in np.split(own, np.flatnonzero(np.diff(own) > GAP) + 1):
                    part = read(slice(int(near[0]), int(near[-1]) + 1)).take(near - near[0])
                    parts.append(conform(part, self.head, file.name))
        return concatenate(parts) if parts else self.head

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        for batches in self._running:
            batches.close()

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


def _told_apart(files: Sequence[SourceFile[Any]]) -> Sequence[SourceFile[Any]]:
    """Return files whose items and sequences begin with the file's name if two have an item."""
    again = check_items([(lambda file=file: file.texts("item"), file.place) for file in files])  # type: ignore[misc]
    if again is None:
        return files
    paths = [Path(file.name).with_suffix("").parts for file in files]
    depths = range(1, max(map(len, paths)) + 1)
    depth = next((d for d in depths if len({own[-d:] for own in paths}) == len(paths)), None)
    if depth is None:
        found = f"the item '{again.item}' is in two files of this name"
        raise input_error(files[0].name, found, "give each file once, under a name of its own")
    names = ["/".join(own[-depth:]) for own in paths]
    example = f"'{again.item}'" + (f" and {again.number - 1} more" if again.number > 1 else "")
    note = f"{example} in more than one file: items begin with the file, '{names[0]}/...'"
    named = [file.called(name) for file, name in zip(files, names, strict=True)]
    return [replace(named[0], notes=(*named[0].notes, note)), *named[1:]]


LandmarkSource = Source[LandmarkSet]
ShapeSource = Source[ShapeSet]
ResultSource = Source[ResultSet]


def _open_all(
    form: Layout,
    paths: Sequence[Path],
    options: InputOptions,
    selects: bool,
    **how: Any,
) -> list[SourceFile[Any]]:
    """Open files of landmarks or shapes, their landmarks renamed, and of these those kept.

    Raises InputError for an individual of files that are ours, unless the caller `selects` it.
    """
    groups = group_inputs(paths, options)
    if options.individual is not None and not selects and not any(f.read_poses for f, _ in groups):
        fix = "write that individual to a file by `shapefit convert`, and use this"
        raise input_error(paths[0], "`individual` is for files of other tools", fix)
    held = MOST_HELD // len(groups) if form is LANDMARKS else 0
    files = [_open(form, *own, options, most_held=held, **how) for own in groups]
    if form is LANDMARKS:
        files[0] = replace(files[0], notes=files[0].notes + mixture(groups))
    if options == AS_THEY_ARE:
        return files
    rename, kept = options.rename, options.landmarks
    check_known(rename, [(file.name, file.head.landmark_names) for file in files])

    def change(records: Any, place: str) -> Any:
        records = records.renamed(rename, place)
        return records if kept is None else keep_landmarks(records, kept, place)

    if not rename and kept is None:
        return files
    return [file.changed(lambda r, place=file.name: change(r, place)) for file in files]  # type: ignore[misc]


def _open(
    form: Layout,
    known: FileFormat,
    paths: tuple[Path, ...],
    options: InputOptions,
    *,
    most_held: int = 0,
    gaps: bool = False,
    **how: Any,
) -> SourceFile[Any]:
    """Open a file of any format; one that is read whole gives out parts of what was read."""
    path, name = paths[0], source_name(paths[0])
    notes: tuple[str, ...] = ()
    records: Any
    if known.read_poses is not None and form is not RESULTS:
        from shapefit.io.readers.items import read_landmarks
        from shapefit.io.readers.items import read_shapes as read_foreign_shapes

        if form is LANDMARKS:
            images, notes = read_landmarks(known, paths, options)
            stated = images.y_axis if known.states_y_axis else None
            return SourceFile.held(name, images, notes=notes, y_axis=stated)
        records, notes = read_foreign_shapes(known, paths, options, gaps=gaps)
    else:
        check_holds(path, form.kind, known)
        if known is HDF5:
            file = _open_hdf5(path, form, options, gaps, most_held, **how)
            return _hiding(file, options.min_confidence)
        assert known.read_records is not None
        records = known.read_records(path, form.kind, gaps=gaps)
    if form is SHAPES:
        check_magnitudes(name, records.shapes, records.items, records.landmark_names)
    elif form is LANDMARKS:
        records = in_pixels(records, options, name)
        if records.confidence is None:
            found = warn_of_zeros(records.landmarks.swapaxes(1, 2))
            notes += tuple(f"{name}: {text}" for text in found)
    stated = records.y_axis if known.states_y_axis else None
    file = SourceFile.held(name, records, notes=notes, y_axis=stated)
    return _hiding(file, options.min_confidence)


def _open_hdf5(
    path: Path,
    form: Layout,
    options: InputOptions,
    gaps: bool,
    most_held: int,
    *,
    rows: slice | None = None,
    without: Collection[str] = (),
    check: bool = True,
    old: bool = False,
    largest: int | None = None,
) -> SourceFile[Any]:
    """Open a file of landmarks, shapes or results, or a part of its rows, but for some datasets.

    Items of at most so many landmarks together are read once and held, others whenever they are
    needed. Raises InputError for what is wrong with it.
    """
    from shapefit.io.hdf5_records import Hdf5Reader

    def read(reader: Hdf5Reader, rows: slice, *, check: bool = False) -> Any:
        """Return the records of these items."""
        large = () if largest is None else reader.larger_further(largest)
        found = reader.records(rows, {*without, *large})
        if check:
            names = reader.landmark_names
            check_values(found.columns, form, reader.place, names, start=rows.start, gaps=gaps)
        return found if form is RESULTS else found.with_whole_points()

    def blocks(reader: Hdf5Reader) -> Iterator[slice]:
        size = max(1, min(BLOCK * 4, CHECKED_BYTES // (48 * max(len(reader.landmark_names), 1))))
        return (slice(at, min(at + size, stop)) for at in range(start, stop, size))

    @contextmanager
    def opened() -> Iterator[Reader[Any]]:
        with Hdf5Reader(path, form, old=old) as reader:
            yield lambda rows: read(reader, slice(start + rows.start, start + rows.stop))

    def texts(name: str) -> Iterator[Sequence[str]]:
        with Hdf5Reader(path, form, old=old) as reader:
            for rows in blocks(reader):
                yield reader.read(name, rows)

    def place(row: int) -> str:
        return f"{path}:/item[{start + row}]"

    with Hdf5Reader(path, form, old=old) as reader:
        start, stop, _ = (rows or slice(None)).indices(reader.count)
        stated = reader.y_axis
        if check and (stop - start) * len(reader.landmark_names) <= most_held:
            records = read(reader, slice(start, stop), check=True)
            if form is LANDMARKS and records.unit in ("px", UNKNOWN_UNIT):
                records = in_pixels(records, options, str(path))
            return SourceFile.held(str(path), records, place, y_axis=stated)
        unchecked = ("item", "sequence")
        for each in blocks(reader) if check and form is not RESULTS else ():
            fields = reader.fields(each, without=unchecked)
            names = reader.landmark_names
            check_values(fields, form, reader.place, names, start=each.start, gaps=gaps)
        head = read(reader, slice(0, 0))
        file = SourceFile(str(path), head, stop - start, opened, texts, place, y_axis=stated)
        if form is not LANDMARKS or not check or head.unit not in ("px", UNKNOWN_UNIT):
            return file
        first = read(reader, slice(start, min(start + BLOCK, stop)))
        if in_pixels(first, options, str(path)) is first:
            return file
        size = np.array(options.image_size)[:, None]
        return file.changed(lambda r: r.replaced(landmarks=r.landmarks * size, unit="px"))


def in_pixels(images: LandmarkSet, options: InputOptions, name: str) -> LandmarkSet:
    """Return landmarks of a table of ours in pixels, where they are fractions of an image.

    Raises InputError for fractions without `image_size`.
    """
    first = images.landmarks[:BLOCK]
    if np.isfinite(first).any() and not are_fractions(first[np.isfinite(first)]):
        return images  # whatever the others are; a copy of all would be half of what is held
    placed = images.landmarks[np.isfinite(images.landmarks)]
    if not placed.any() or not are_fractions(placed) or (placed < 0).mean() > CENTRED:
        return images
    if options.image_size is None:
        raise size_needed(name)
    size = np.array(options.image_size)[:, None]
    return images.replaced(landmarks=images.landmarks * size, unit="px")


def _hiding(file: SourceFile[Any], least: float) -> SourceFile[Any]:
    """Return a file that hides landmarks whose confidence is below `least`."""
    if not least or getattr(file.head, "confidence", None) is None:
        return file

    def hidden(images: LandmarkSet) -> LandmarkSet:
        assert images.confidence is not None
        doubtful = images.confidence < least
        return images.replaced(
            landmarks=np.where(doubtful[:, None], np.nan, images.landmarks),
            confidence=np.where(doubtful, 0.0, images.confidence),
        )

    return file.changed(hidden)

"""Files of landmarks, shapes and results, in any format, as one source that gives out
batches.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache, partial
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Generic, Literal, Self, cast

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Flags, Floats, Integers
from shapefit.errors import abbreviate, counted, input_error
from shapefit.io.checks import (
    CENTRED,
    PlaceNamer,
    check_values,
    place_in_memory,
    warn_of_codes,
    warn_of_zeros,
)
from shapefit.io.formats import (
    CSV,
    HDF5,
    FileFormat,
    check_our_format,
    our_format,
    record_writer,
)
from shapefit.io.inputs import is_stream, source_name
from shapefit.io.layout import (
    FRAME,
    LAYOUT_OF,
    PROOF,
    RESULTS,
    SHAPES,
    UNKNOWN_UNIT,
    Layout,
)
from shapefit.io.merge import align_to, merge_heads
from shapefit.io.names import match_landmarks, prefix_with_file, rename_landmarks
from shapefit.io.options import AS_THEY_ARE, Direction, InputOptions
from shapefit.records.fit import Fit
from shapefit.records.frames import check_frames, order_by_frame
from shapefit.records.items import Items, Record, concatenate
from shapefit.records.landmarks import Landmarks
from shapefit.records.shapes import Shapes

if TYPE_CHECKING:
    from shapefit.io.hdf5_file import Hdf5Reader

FileKind = Literal["landmarks", "shapes", "result", "dictionary"]

MAX_OPEN = 64
"""HDF5 files that stay open together; of more, those that were read last."""

ITEMS_PER_BLOCK = 1 << 12
"""Items whose names are read together, and images that are looked at."""

OPTIONAL_DATASETS = RESULTS.unmarked - {"item", "sequence", "shapes"}
"""Datasets of results that a command need not read; the others, and those that no field
lists, always are.
"""


def open_landmarks(
    paths: Sequence[Path],
    options: InputOptions = AS_THEY_ARE,
    rows: slice | None = None,
    *,
    head: bool = False,
) -> LandmarkSource:
    """Open files of landmarks in any format (`-` is standard input) as one source.

    HDF5 is read by batches, large CSV in one pass, all else whole; of HDF5 only `rows`,
    if given. Raises InputError: at once for items that occur twice, files that do not
    go together, and names to rename that no file has; for wrong values when they are
    read. With `head` nothing is checked, and only the first rows of CSV are read.
    """
    return _open_files(Landmarks, paths, options, rows=rows, head=head)


def open_shapes(
    paths: Sequence[Path],
    options: InputOptions = AS_THEY_ARE,
    *,
    gaps: bool = False,
    head: bool = False,
) -> ShapeSource:
    """Open files of shapes as one source, landmarks in the order of the first file.

    All else is as in `open_landmarks`. With `gaps` a landmark of an item may be
    unknown, NaN, and may lack its row in CSV.
    """
    return _open_files(Shapes, paths, options, gaps=gaps, head=head)


def open_results(
    paths: Sequence[Path],
    without: Collection[str] = PROOF,
    *,
    head: bool = False,
    old: bool = False,
) -> ResultSource:
    """Open files of results as one source that does not read the datasets `without`.

    All else is as in `open_landmarks`; with `old` those of version 1 are read, too.
    """
    return _open_files(Fit, paths, without=without, old=old, head=head)


def find_kind(path: Path, options: InputOptions = AS_THEY_ARE) -> FileKind:
    """Return the kind of a file, by its contents; a table with a column z has shapes.

    Raises InputError for what is wrong with the file, and for standard input, which
    could not be read again.
    """
    if is_stream(path):
        raise input_error(
            "-", "standard input can be read only once", "save it and name the file"
        )
    from shapefit.io.detect import detect_format

    file_format = detect_format(path, options.format)
    if file_format is HDF5:
        from shapefit.io.hdf5_file import hdf5_kind

        return cast(FileKind, hdf5_kind(path))
    if file_format is CSV:
        from shapefit.io.csv_file import csv_kind

        return cast(FileKind, csv_kind(path))
    if len(file_format.records) == 1:  # JSON, for one, would be read whole to say so
        return cast(FileKind, file_format.records[0])
    from shapefit.io.readers.items import read_poses

    return (
        "landmarks"
        if read_poses(file_format, (path,)).points.shape[2] == 2
        else "shapes"
    )


def source_of(
    record: Record, name: str, rename: Mapping[str, str], *, gaps: bool = False
) -> Source[Record]:
    """Return landmarks or shapes in memory as a source, checked as a file is.

    `name` stands for it in messages.
    """
    place = place_in_memory(name)
    check_frames(record.sequences, record.frames, record.items, name)
    order = order_by_frame(record.sequences, record.frames)
    if order is not None:
        record = record.take(order)
    file: SourceFile[Record] = SourceFile.of(name, record, place, y_axis=record.y_axis)
    files = [_warn_of_codes_in(file)]
    options = InputOptions(rename=rename)
    return Source(_with_options(type(record), files, options, gaps))


def source_of_stream(
    images: Landmarks, name: str, options: InputOptions
) -> LandmarkSource:
    """Return images from a pipe as a source, which checks them and applies `options`.

    Frames are as they come, and landmarks in pixels already.
    """
    file = SourceFile.of(name, images)
    if options.keypoints is not None:
        file = _name_by_skeleton(file, options.keypoints)
    prepared = _with_options(Landmarks, [file], options, gaps=False)
    return Source(prepared, options.y_axis)


def read_shapes(
    paths: Sequence[Path], options: InputOptions = AS_THEY_ARE, *, gaps: bool = False
) -> Shapes:
    """Read shapes from files of any format as one record, see `open_shapes`."""
    with open_shapes(paths, options, gaps=gaps) as source:
        return source.whole()


def read_results(path: Path, *, proofs: bool = False) -> Fit:
    """Read a result file as one Fit; with `proofs` its certificate datasets, too."""
    with open_results([path], () if proofs else PROOF) as source:
        return source.whole()


def write_shapes(path: Path, shapes: Shapes) -> None:
    """Write shapes in the format that the name of the file asks for.

    Raises InputError where that is not possible.
    """
    with record_writer(path, SHAPES) as writer:
        writer.append(shapes)


@dataclass(frozen=True, eq=False, repr=False)
class SourceFile(Generic[Record]):
    """One file of a source, of which some rows can be read.

    `read` returns the items of some rows as a record; texts reads the dataset item or
    sequence of some rows; `place` names a row of a dataset in messages; y_axis is None
    where the file does not say it; estimate is the number of items in the file, if only
    the first `count` were read; left_out, how many others the options leave out;
    has_unique_items is set where its reader has made sure that no item is twice in it.
    """

    name: str
    count: int
    read: Callable[[slice], Record]
    texts: Callable[[str, slice], Sequence[str]]
    place: PlaceNamer
    close: Callable[[], None] = lambda: None
    notes: tuple[str, ...] = ()
    y_axis: Direction | None = None
    estimate: int = 0
    left_out: int = 0
    has_unique_items: bool = False

    @classmethod
    def of(
        cls,
        name: str,
        record: Record,
        place: PlaceNamer | None = None,
        *,
        notes: tuple[str, ...] = (),
        y_axis: Direction | None = None,
        estimate: int = 0,
        has_unique_items: bool = False,
    ) -> SourceFile[Record]:
        """Make a file of a source from a record in memory.

        Without `place` messages name the item.
        """
        return SourceFile(
            name=name,
            count=len(record),
            read=record.take,
            texts=lambda dataset, rows: _column_texts(record.take(rows), dataset),
            place=place or (lambda _, row: f"{name}: item '{record.items[row]}'"),
            notes=notes,
            y_axis=y_axis,
            estimate=estimate,
            has_unique_items=has_unique_items,
        )

    @cached_property
    def head(self) -> Record:
        """The file's record without its items: landmarks, columns and unit."""
        return self.read(slice(0, 0))

    def blocks(self, dataset: str) -> Iterator[Sequence[str]]:
        """Yield names of items or sequences (`dataset`), ITEMS_PER_BLOCK at a time.

        They are empty where there is no such dataset.
        """
        missing = dataset == "sequence" and self.head.sequences is None
        for start in range(0, self.count, ITEMS_PER_BLOCK):
            stop = min(start + ITEMS_PER_BLOCK, self.count)
            yield (
                ("",) * (stop - start)
                if missing
                else self.texts(dataset, slice(start, stop))
            )

    def with_prefix(self, prefix: str) -> Self:
        """Return the file with `prefix/` before the names of items and sequences."""

        def add_prefix(texts: Sequence[str]) -> tuple[str, ...]:
            """Return texts with the prefix; "" stays."""
            return tuple(text and f"{prefix}/{text}" for text in texts)

        def read(rows: slice) -> Record:
            """Read some rows of the file, their names with the prefix."""
            record = self.read(rows)
            sequences = record.sequences
            if sequences is not None:
                sequences = add_prefix(sequences)
            return replace(record, items=add_prefix(record.items), sequences=sequences)

        def texts(dataset: str, rows: slice) -> Sequence[str]:
            """Read the items or sequences of some rows, with the prefix."""
            return add_prefix(self.texts(dataset, rows))

        return replace(self, read=read, texts=texts)


def _column_texts(record: Items, dataset: str) -> Sequence[str]:
    """Return a record's items or sequences, by their dataset; () without sequences."""
    return record.items if dataset == "item" else record.sequences or ()


class Source(Generic[Record]):
    """The items of one or more files; a context manager, which closes the files.

    `head` is the record without items: landmarks, unit, columns; `count` is how many
    items there are, `estimate` how many the files have if only their first ones were
    read, `left_out` how many were left out by the options; `notes` are warnings about
    what was left out of the files.
    """

    def __init__(
        self,
        files: Sequence[SourceFile[Record]],
        y_axis: Direction | None = None,
        *,
        check: bool = True,
    ) -> None:
        """Join files into one source; `y_axis` is that of files that do not state it.

        Raises InputError for files that do not go together, and, if `check`, for an
        item that is twice in one; where two files have an item, all items begin with
        the name of their file.
        """
        self._files: Sequence[SourceFile[Record]] = files
        self.notes = tuple(chain.from_iterable(file.notes for file in files))
        if check:
            self._files, note = prefix_with_file(files)
            self.notes = (*note, *self.notes)
        filled = [file for file in self._files if file.count] or self._files[:1]
        self.head: Record = merge_heads(filled, y_axis)  # what is empty may differ
        self.count = sum(file.count for file in files)
        self.estimate = sum(file.estimate or file.count for file in files)
        self.left_out = sum(file.left_out for file in files)
        self.states_y_axis = any(file.y_axis is not None for file in files)

    def batches(self, size: int) -> Iterator[Record]:
        """Yield records of `size` >= 1 items in order, the last one of fewer.

        A source without items gives one empty record, so that what is made of it can be
        written.
        """
        parts: list[Record] = []
        remaining = size
        for file in self._files:
            start = 0
            while start < file.count:
                stop = min(start + remaining, file.count)
                parts.append(self._read(file, slice(start, stop)))
                remaining, start = remaining - (stop - start), stop
                if remaining == 0:
                    yield concatenate(parts)
                    parts, remaining = [], size
        if parts or not self.count:
            yield concatenate(parts) if parts else self.head

    def batches_of_files(self, size: int) -> Iterator[tuple[Record, Integers]]:
        """Yield records of up to `size` items, and the number (n,) of the file of each.

        Files stay whole, several of them together, but for those of more items, which
        are divided into records of `size` and a rest. A source without items gives one
        empty record.
        """
        parts: list[Record] = []
        numbers: list[Integers] = []
        room = size
        for number, file in enumerate(self._files):
            for start in range(0, file.count, size):
                count = min(size, file.count - start)
                if count > room:
                    yield concatenate(parts), np.concatenate(numbers)
                    parts = []
                    numbers = []
                    room = size
                parts.append(self._read(file, slice(start, start + count)))
                numbers.append(np.full(count, number))
                room -= count
        if parts:
            yield concatenate(parts), np.concatenate(numbers)
        elif not self.count:
            yield self.head, np.empty(0, np.int64)

    def _read(self, file: SourceFile[Record], rows: slice) -> Record:
        """Read some rows of one of the files, with the columns that all have."""
        return align_to(file.read(rows), self.head, file.name)

    def select(self, rows: NDArray[np.intp], size: int) -> Iterator[Record]:
        """Yield the items at `rows` (ascending), read in batches of `size` items."""
        start = 0
        for batch in self.batches(size):
            first, last = np.searchsorted(rows, [start, start + len(batch)])
            if first < last:
                yield batch.take(rows[first:last] - start)
            start += len(batch)

    def first(self, count: int) -> Record:
        """Return the first `count` items as one record, or all if there are fewer."""
        return next(self.batches(count))

    def whole(self) -> Record:
        """Return all items as one record."""
        return self.first(max(self.count, 1))

    def item_names(self) -> Iterator[Sequence[str]]:
        """Yield the names of all items, block by block."""
        return chain.from_iterable(file.blocks("item") for file in self._files)

    def sequences(self) -> Iterator[Sequence[str]]:
        """Yield the name of each item's sequence, block by block; "" without one."""
        return chain.from_iterable(file.blocks("sequence") for file in self._files)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self.close()

    def close(self) -> None:
        """Close all files."""
        for file in self._files:
            file.close()


LandmarkSource = Source[Landmarks]
ShapeSource = Source[Shapes]
ResultSource = Source[Fit]
AnyRecord = Fit | Shapes | Landmarks


def _open_files(
    kind: type[Record],
    paths: Sequence[Path],
    options: InputOptions = AS_THEY_ARE,
    *,
    gaps: bool = False,
    head: bool = False,
    rows: slice | None = None,
    without: Collection[str] = (),
    old: bool = False,
) -> Source[Record]:
    """Open files as one source of records of class `kind`, each in its format.

    The other arguments are those of `open_landmarks`, `open_shapes` and `open_results`.
    Other tools' readers are imported if needed.
    """
    layout = LAYOUT_OF[kind]
    readers = _Readers(layout, old)
    files: list[SourceFile[Record]] = []
    for file_format, group in _group_paths(list(dict.fromkeys(paths)), options):
        if file_format.read_poses is not None and kind is not Fit:
            file = _file_of_poses(kind, file_format, group, options)
            files.append(_select_frames(file, options))
            continue
        check_our_format(group[0], layout.kind, file_format)
        if options.individual is not None:
            fix = "write that individual to a file by `shapefit convert`, and use this"
            raise input_error(group[0], "`individual` is for files of other tools", fix)
        if file_format is HDF5:
            of_file = None if options.skips_frames else rows
            file = _file_of_hdf5(kind, group[0], readers, of_file, without)
            file = _select_frames(file, options, rows)
        else:
            file = _select_frames(_file_of_csv(kind, group[0], head=head), options)
        if kind is not Fit and options.keypoints is not None:
            file = _name_by_skeleton(file, options.keypoints)
        if kind is Landmarks and not head:
            file = _convert_to_pixels(file, options)
        files.append(file)
    if kind is not Fit:
        files = [*map(_warn_of_codes_in, files)]
    prepared = _with_options(kind, files, options, gaps, check=not head)
    return Source(prepared, options.y_axis, check=not head)


class _Readers:
    """Readers of HDF5 files of one layout, of which a few stay open."""

    def __init__(self, layout: Layout, old: bool) -> None:
        self._layout = layout
        self._old = old
        self._opened = lru_cache(MAX_OPEN)(self._open)

    def open(self, path: Path) -> Hdf5Reader:
        """Return the reader of a file; open the file if it is not open."""
        return self._opened(path)

    def close(self) -> None:
        """Close all files."""
        self._opened.cache_clear()

    def _open(self, path: Path) -> Hdf5Reader:
        """Open a file, and return its reader."""
        from shapefit.io.hdf5_file import Hdf5Reader

        return Hdf5Reader(path, self._layout, old=self._old)


def _group_paths(
    paths: Sequence[Path], options: InputOptions
) -> Sequence[tuple[FileFormat, tuple[Path, ...]]]:
    """Group input paths, one recording a group; return each group after its format."""
    groups = []
    for path in paths:
        ours = our_format(path) if options.format == "auto" else None
        if ours is None:
            from shapefit.io.detect import group_inputs

            return group_inputs(paths, options)
        groups.append((ours, (path,)))
    return groups


def _as_kind(kind: type[Record], record: Items) -> Record:
    """Assert for the type checker that a record is of class `kind`, and return it."""
    assert isinstance(record, kind), f"{type(record).__name__} for {kind.__name__}"
    return record


def _file_of_poses(
    kind: type[Record],
    file_format: FileFormat,
    group: tuple[Path, ...],
    options: InputOptions,
) -> SourceFile[Record]:
    """Read files of one recording by another tool as one file of a source."""
    from shapefit.io.readers import items

    record: Landmarks | Shapes
    if kind is Landmarks:
        record, notes = items.read_as_landmarks(file_format, group, options)
    else:
        record, notes = items.read_as_shapes(file_format, group, options)
    stated = record.y_axis if file_format.states_y_axis else None
    name = source_name(group[0])
    return SourceFile.of(name, _as_kind(kind, record), notes=notes, y_axis=stated)


def _file_of_csv(kind: type[Record], path: Path, *, head: bool) -> SourceFile[Record]:
    """Read a tidy CSV table as a file of a source; with `head` its first rows only."""
    from shapefit.io.csv_file import Spool, read_csv, read_csv_head

    name = source_name(path)
    layout = LAYOUT_OF[kind]
    if head:
        first, share = read_csv_head(path, layout.kind)
        estimate = round(len(first) / share)
        return SourceFile.of(name, _as_kind(kind, first), estimate=estimate)
    table = read_csv(path, layout.kind)
    if not isinstance(table, Spool):
        return SourceFile.of(name, _as_kind(kind, table), has_unique_items=True)

    def place(_: str, row: int) -> str:
        """Return how messages name a row: by its item."""
        item = table.take(slice(row, row + 1)).items[0]
        return f"{name}: item '{item}'"

    return SourceFile(
        name=name,
        count=len(table),
        read=lambda rows: _as_kind(kind, table.take(rows)),
        texts=lambda dataset, rows: _column_texts(table.take(rows), dataset),
        place=place,
        has_unique_items=True,
    )


def _select_frames(
    file: SourceFile[Record], options: InputOptions, rows: slice | None = None
) -> SourceFile[Record]:
    """Restrict a file to the options' `frames` and `every`; of these only `rows`.

    Frames keep their numbers and times. Without numbers, their places in the sequence
    count, or those of single images in the file.
    """
    if not options.skips_frames:
        return file
    numbers, are_places = _numbers_of_frames(file)
    first, stop = options.frames
    start = first or 0
    is_chosen = (numbers >= start) & ((numbers - start) % options.every == 0)
    if stop is not None:
        is_chosen &= numbers < stop
    chosen = np.flatnonzero(is_chosen)
    left_out = 0 if rows is not None and rows.start else file.count - len(chosen)
    chosen = chosen[rows or slice(None)]

    def span(part: slice) -> tuple[slice, NDArray[np.intp]]:
        """Return file rows that span a part of the chosen frames, and which to take."""
        wanted = chosen[part]
        begin = int(wanted[0]) if len(wanted) else 0
        end = int(wanted[-1]) + 1 if len(wanted) else 0
        return slice(begin, end), wanted - begin

    def read(part: slice) -> Record:
        """Read a part of the chosen frames."""
        around, wanted = span(part)
        record = file.read(around).take(wanted)
        if are_places and record.sequences is not None:
            return record.replaced(frames=numbers[chosen[part]])
        return record

    def texts(dataset: str, part: slice) -> Sequence[str]:
        """Read the items or sequences of a part of the chosen frames."""
        around, wanted = span(part)
        every = file.texts(dataset, around)
        return [every[row] for row in wanted]

    return replace(
        file,
        count=len(chosen),
        read=read,
        texts=texts,
        place=lambda dataset, row: file.place(dataset, int(chosen[row])),
        left_out=left_out,
    )


def _numbers_of_frames(file: SourceFile[Record]) -> tuple[NDArray[np.int64], bool]:
    """Return each item's frame number (n,), and whether it is counted, not stated.

    Where the file has no frames it is the item's place in its sequence.
    """
    numbers = []
    places: Counter[str] = Counter()
    for start in range(0, file.count, ITEMS_PER_BLOCK):
        records = file.read(slice(start, min(start + ITEMS_PER_BLOCK, file.count)))
        if records.frames is not None:
            numbers += records.frames.tolist()
            continue
        for sequence in records.sequences or ("",) * len(records):
            numbers.append(places[sequence])
            places[sequence] += 1
    return np.array(numbers, np.int64), file.head.frames is None


def _warn_of_codes_in(file: SourceFile[Record]) -> SourceFile[Record]:
    """Add warnings to a file's notes if codes such as -999 may mark missing points."""
    first = file.read(slice(0, min(file.count, ITEMS_PER_BLOCK)))
    codes = warn_of_codes(first.points, _weights_of(first))
    notes = tuple(f"{file.name}: {text}" for text in codes)
    return replace(file, notes=(*file.notes, *notes)) if notes else file


def _weights_of(record: Items) -> Floats | None:
    """Return the confidences (n, p) of landmarks or shapes, None if they have none."""
    if isinstance(record, Landmarks):
        return record.confidence
    confidence = record.extras.get("confidence")
    return None if confidence is None else np.asarray(confidence, np.float64)


def _file_of_hdf5(
    kind: type[Record],
    path: Path,
    readers: _Readers,
    rows: slice | None,
    without: Collection[str],
) -> SourceFile[Record]:
    """Open `rows` of a shapefit HDF5 file as a file of a source, without some datasets.

    `without` names these. Its images and shapes come in order of their frames; where
    they stand in another, they are read at once.
    """
    file = readers.open(path)
    start, stop, _ = (rows or slice(None)).indices(file.count)
    order = None if kind is Fit else _order_of_frames(file, str(path))
    if order is not None:
        part = order[start:stop]
        record = file.read_record(slice(0, file.count), without)
        return SourceFile.of(
            str(path),
            _as_kind(kind, record).take(part),
            lambda dataset, row: f"{path}:/{dataset}[{part[row]}]",
            y_axis=file.y_axis,
        )

    def within(part: slice) -> slice:
        """Return the rows of the file for a part of `rows`."""
        return slice(start + part.start, start + part.stop)

    return SourceFile(
        name=str(path),
        count=stop - start,
        read=lambda part: _as_kind(
            kind, readers.open(path).read_record(within(part), without)
        ),
        texts=lambda dataset, part: readers.open(path).read(dataset, within(part)),
        place=lambda dataset, row: f"{path}:/{dataset}[{start + row}]",
        close=readers.close,
        y_axis=file.y_axis,
    )


def _order_of_frames(file: Hdf5Reader, place: str) -> NDArray[np.intp] | None:
    """Return the indices that sort an HDF5 file's rows by frame, None if it is sorted.

    Raises InputError at the place for two items in one frame.
    """
    if not (file.has_dataset(FRAME) and file.has_dataset("sequence")):
        return None
    sequences = file.read("sequence")
    frames = file.read(FRAME)
    check_frames(sequences, frames, file.read("item"), place)
    return order_by_frame(sequences, frames)


MIN_SHARE = 0.9
"""Of the shapes of a file in which a landmark that is used is known."""


def _keep_complete(file: SourceFile[Record]) -> SourceFile[Record]:
    """Leave out shapes of a file that lack a landmark (NaN), and add notes on them.

    Landmarks known in less than MIN_SHARE of the shapes are left out first. Raises
    InputError where no landmark is known often.
    """
    if not file.count:
        return file
    known = _known_landmarks(file)
    if known.all():
        return file
    from shapefit.io.readers.items import keep_shape_landmarks

    often = known.mean(axis=0) >= MIN_SHARE
    if not often.any():
        number = counted(file.count, "shape")
        problem = f"no landmark is known in {MIN_SHARE:.0%} of its {number}"
        raise input_error(file.name, problem, "give shapes with fewer gaps")
    names = np.array(file.head.landmark_names, object)
    whole = np.flatnonzero(known[:, often].all(axis=1))

    def span(rows: slice) -> tuple[slice, NDArray[np.intp]]:
        """Return file rows that span some complete shapes, and which to take."""
        taken = whole[rows]
        first, end = (taken[0], taken[-1] + 1) if len(taken) else (0, 0)
        return slice(int(first), int(end)), taken - first

    def read(rows: slice) -> Record:
        """Read some complete shapes, with the landmarks that are mostly known."""
        around, taken = span(rows)
        record = file.read(around).take(taken)
        if often.all() or not isinstance(record, Shapes):
            return record
        return keep_shape_landmarks(record, names[often])

    def texts(dataset: str, rows: slice) -> Sequence[str]:
        """Read the items or sequences of some complete shapes."""
        around, taken = span(rows)
        read_texts = file.texts(dataset, around)
        return [read_texts[row] for row in taken]

    def place(name: str, row: int | None = None) -> str:
        """Return how messages name a dataset, or a complete shape in it."""
        return file.place(name, None if row is None else int(whole[row]))

    left_out = _notes_of_unknown(file, names[~often].tolist(), len(whole))
    return replace(
        file,
        count=len(whole),
        read=read,
        texts=texts,
        place=place,
        notes=(*file.notes, *left_out),
    )


def _known_landmarks(file: SourceFile[Record]) -> Flags:
    """Return a mask (n, p) of the landmarks of a file's shapes that are not NaN."""
    starts = range(0, file.count, ITEMS_PER_BLOCK)
    blocks = [
        slice(start, min(start + ITEMS_PER_BLOCK, file.count)) for start in starts
    ]
    return ~np.concatenate(
        [np.isnan(file.read(rows).points).any(axis=2) for rows in blocks]
    )


def _notes_of_unknown(
    file: SourceFile[Record], rare: Sequence[str], complete: int
) -> list[str]:
    """Return notes on `rare` landmarks left out, and on all but `complete` shapes."""
    notes = []
    if rare:
        text = f"left out, known in less than {MIN_SHARE:.0%} of the shapes"
        text = f"{counted(len(rare), 'landmark')} {text} ({abbreviate(rare)})"
        notes.append(f"{file.name}: {text}")
    omitted = file.count - complete
    if omitted:
        text = f"{counted(omitted, 'shape')} left out, in which a landmark is unknown"
        notes.append(f"{file.name}: {text}")
    return notes


def _name_by_skeleton(file: SourceFile[Record], skeleton: str) -> SourceFile[Record]:
    """Rename the landmarks of a file, if they are numbers, to those of a skeleton."""
    from shapefit.io.readers.items import name_numbers

    before = file.head.landmark_names
    names, notes = name_numbers(before, skeleton, file.name)
    if names == before:
        return file
    renames = dict(zip(before, names, strict=True))

    def read(rows: slice) -> Record:
        """Read some rows of the file, with the names of the skeleton."""
        record = file.read(rows)
        new_names = tuple(renames.get(name, name) for name in record.landmark_names)
        return replace(record, landmark_names=new_names)

    named_notes = tuple(f"{file.name}: {text}" for text in notes)
    return replace(file, read=read, notes=(*file.notes, *named_notes))


def _convert_to_pixels(
    file: SourceFile[Record], options: InputOptions
) -> SourceFile[Record]:
    """Scale landmarks of a file to pixels if they are fractions of the image.

    Adds a warning where many are at (0, 0). Raises InputError where the first are
    fractions, and there is no `image_size`.
    """
    images = file.read(slice(0, min(file.count, ITEMS_PER_BLOCK)))
    if images.column("confidence") is None:
        zeros = [f"{file.name}: {text}" for text in warn_of_zeros(images.points)]
        file = replace(file, notes=(*file.notes, *zeros))
    size = find_pixel_scale(images, options, file.name)
    if size is None:
        return file

    def read(rows: slice) -> Record:
        """Read some rows of the file, in pixels."""
        return as_pixels(file.read(rows), size)

    return replace(file, read=read)


def find_pixel_scale(
    images: Items, options: InputOptions, name: str
) -> tuple[float, float] | None:
    """Return the image size in pixels if landmarks are fractions of it, else None.

    Raises InputError where they are, and the options have no `image_size`.
    """
    if images.unit not in ("px", UNKNOWN_UNIT) or not _are_fractions(images.points):
        return None
    if options.image_size is None:
        from shapefit.io.readers.items import FRACTIONS, SIZE_FIX

        raise input_error(name, FRACTIONS, SIZE_FIX)
    return options.image_size


def as_pixels(record: Record, size: tuple[float, float]) -> Record:
    """Convert landmarks from fractions of the image `size` (x, y) to pixels."""
    return replace(record.with_points(record.points * np.array(size)), unit="px")


MAX_FRACTION = 1.5
"""Coordinate up to which landmarks may be fractions of an image, some outside it."""


def _are_fractions(landmarks: Floats) -> bool:
    """Whether landmarks are likely fractions of an image: small, and few negative."""
    values = landmarks[np.isfinite(landmarks)]
    if not values.any():
        return False
    small = np.abs(values).max() <= MAX_FRACTION
    return bool(small and (values < 0).mean() <= CENTRED)


def _with_options(
    kind: type[Record],
    files: Sequence[SourceFile[Record]],
    options: InputOptions,
    gaps: bool,
    *,
    check: bool = True,
) -> list[SourceFile[Record]]:
    """Return files that check records as they are read, and apply options to them.

    A point with a NaN coordinate is all NaN. Landmarks are hidden where their
    confidence is below the least, renamed, and only some of them retained.
    """
    if kind is Shapes and not gaps:
        files = [*map(_keep_complete, files)]
    if options.rename:
        names = dict.fromkeys(
            name for file in files for name in file.head.landmark_names
        )
        match_landmarks(tuple(names), tuple(options.rename), "rename")

    def read(file: SourceFile[Record], rows: slice) -> Record:
        """Read some rows of a file, checked, and changed as the options say."""

        def place(dataset: str, row: int) -> str:
            """Return how messages name a row that was read."""
            return file.place(dataset, rows.start + row)

        record = file.read(rows)
        if check:
            check_values(record, place, gaps=gaps)
        return (
            record if isinstance(record, Fit) else _apply_options(record, options, file)
        )

    return [replace(file, read=partial(read, file)) for file in files]


def _apply_options(
    record: Record, options: InputOptions, file: SourceFile[Record]
) -> Record:
    """Rename, hide and select the landmarks of a record, as the options say."""
    names = rename_landmarks(record.landmark_names, options.rename, file.name)
    record = record.with_whole_points()
    if names != record.landmark_names:
        record = replace(record, landmark_names=names)
    if isinstance(record, Landmarks) and options.min_confidence:
        record = hide_below(record, options.min_confidence)
    if options.landmarks is None:
        return record
    from shapefit.io.readers.items import keep_landmarks

    return keep_landmarks(record, options.landmarks, file.name)


def hide_below(images: Record, min_confidence: float) -> Record:
    """Hide landmarks whose confidence is below `min_confidence`: NaN, confidence 0."""
    if not isinstance(images, Landmarks) or images.confidence is None:
        return images
    doubtful = images.confidence < min_confidence
    points = np.where(doubtful[..., None], np.nan, images.landmarks)
    weights = np.where(doubtful, 0, images.confidence)
    return replace(images, landmarks=points, confidence=weights)

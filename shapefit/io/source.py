"""Files of landmarks, shapes and results, in any format, as one source that gives out batches."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any, Generic, Literal, Self, cast

import numpy as np
from numpy.typing import NDArray

from shapefit.errors import InputError, input_error
from shapefit.io.checks import Place, check_values, place_in_memory, warn_of_zeros
from shapefit.io.formats import CSV, HDF5, FileFormat, check_holds, own_format, record_writer
from shapefit.io.inputs import is_stream, source_name
from shapefit.io.layout import LANDMARKS, PROOF, RESULTS, SHAPES, UNKNOWN_UNIT, Layout
from shapefit.io.merge import align_to, merge_heads
from shapefit.io.names import find_shared_item, match_landmarks
from shapefit.io.options import AS_THEY_ARE, Direction, InputOptions
from shapefit.io.records import LandmarkSet, Record, ResultSet, ShapeSet, concatenate

Kind = Literal["landmarks", "shapes", "result", "dictionary"]

CENTRED = 0.1
"""Share of coordinates below 0 from which on they are no fractions of an image, but points about
a centre in a unit of their own."""

MAX_OPEN = 64
"""HDF5 files that are open together; of more, each is open only while it is read."""

BLOCK = 1 << 12
"""Images that are looked at, to see whether landmarks are fractions of an image."""

OPTIONAL = frozenset(n for n, c in RESULTS.datasets.items() if not c.required) - {"sequence"}
"""Datasets of results that need not be read."""


def open_landmarks(
    paths: Sequence[Path],
    options: InputOptions = AS_THEY_ARE,
    rows: slice | None = None,
    *,
    check: bool = True,
    head: bool = False,
) -> LandmarkSource:
    """Open files of landmarks in any format (`-` is standard input) as one source.

    Large HDF5 is read by batches, CSV in one pass, all else whole; of one HDF5 file only `rows`, if
    given. Raises InputError: at once for items that occur twice, files that do not go together, and
    names to rename that no file has; for wrong values when they are read. Without `check` neither
    is looked for. With `head` only the first rows of CSV are read.
    """
    files = _open_all(LANDMARKS, paths, options, rows=rows, check=check, head=head)
    return Source(files, options.y_axis, check=check)


def open_shapes(
    paths: Sequence[Path],
    options: InputOptions = AS_THEY_ARE,
    *,
    gaps: bool = False,
    check: bool = True,
    head: bool = False,
) -> ShapeSource:
    """Open files of shapes in any format as one source, checked as `open_landmarks` does.

    Landmarks are matched by name and stand in the order of the first file. With `gaps` a landmark
    of an item may be unknown, NaN, and may lack its row in CSV.
    """
    files = _open_all(SHAPES, paths, options, gaps=gaps, check=check, head=head)
    return Source(files, check=check)


def open_results(
    paths: Sequence[Path],
    without: Collection[str] = PROOF,
    *,
    check: bool = True,
    old: bool = False,
) -> ResultSource:
    """Open results as one source, checked as `open_landmarks` does, `old` ones of version 1, too.

    Datasets in `without` are not read, by default what proves the optimum.
    """
    files = _open_all(RESULTS, paths, AS_THEY_ARE, without=without, check=check, old=old)
    return Source(files, check=check)


def find_kind(path: Path, options: InputOptions = AS_THEY_ARE) -> Kind:
    """Return what a file holds. A table with the column z holds shapes.

    Raises InputError for what is wrong with the file, and for standard input, which could not be
    read again.
    """
    if is_stream(path):
        raise input_error("-", "standard input can be read only once", "save it and name the file")
    from shapefit.io.detect import detect_format

    file_format = detect_format(path, options.format)
    if file_format is HDF5:
        from shapefit.io.hdf5_file import hdf5_kind

        return cast(Kind, hdf5_kind(path))
    if file_format is CSV:
        from shapefit.io.csv_file import csv_kind

        return cast(Kind, csv_kind(path))
    if len(file_format.records) == 1:  # JSON, for one, would be read whole to say so
        return cast(Kind, file_format.records[0])
    from shapefit.io.readers.items import read_poses

    return "landmarks" if read_poses(file_format, (path,)).dimensions == 2 else "shapes"


def source_of(
    records: Record, name: str, rename: Mapping[str, str], *, gaps: bool = False
) -> Source[Record]:
    """Return landmarks or shapes in memory as a source, checked as a file of this name is."""
    place = place_in_memory(name)
    check_values(records.columns, records.LAYOUT, place, records.landmark_names, gaps)
    match_landmarks(records.landmark_names, tuple(rename), "rename")
    records = records.with_whole_points().renamed(rename, name)
    stated = records.y_axis if isinstance(records, LandmarkSet) else None
    return Source([SourceFile.of(name, records, place, y_axis=stated)])


def read_shapes(
    paths: Sequence[Path], options: InputOptions = AS_THEY_ARE, *, gaps: bool = False
) -> ShapeSet:
    """Read shapes from files of any format as one set, as `open_shapes` opens them."""
    with open_shapes(paths, options, gaps=gaps) as source:
        return source.whole()


def read_results(path: Path, *, proofs: bool = False) -> ResultSet:
    """Read a result as one, with what proves the optimum only if `proofs` asks for it."""
    with open_results([path], () if proofs else PROOF) as source:
        return source.whole()


def write_shapes(path: Path, shapes: ShapeSet) -> None:
    """Write shapes in the format of the name. Raises InputError where that is not possible."""
    with record_writer(path, SHAPES) as writer:
        writer.append(shapes)


@dataclass(frozen=True)
class SourceFile(Generic[Record]):
    """One file of a source: `head` has all but the items, `read` returns those of some rows.

    texts reads the dataset item or sequence, block by block; `place` names a row of a dataset in
    messages; y_axis is None where the file does not say it; share, of all items, those that were
    read.
    """

    name: str
    head: Record
    count: int
    read: Callable[[slice], Record]
    texts: Callable[[str], Iterable[Sequence[str]]]
    place: Place
    close: Callable[[], None] = lambda: None
    notes: tuple[str, ...] = ()
    y_axis: Direction | None = None
    share: float = 1.0

    @classmethod
    def of(cls, name: str, records: Record, place: Place | None = None, **stated: Any) -> Self:
        """Return records in memory as a file; without `place` messages name the item."""
        return cls(
            name=name,
            head=records.take(slice(0, 0)),
            count=len(records),
            read=records.take,
            texts=lambda kind: [records.items if kind == "item" else records.sequences or ()],
            place=place or (lambda _, row: f"{name}: item '{records.items[row]}'"),
            **stated,
        )

    def changed(self, change: Callable[[Record], Record]) -> Self:
        """Return a file that gives its records out changed, its head too."""
        read = self.read
        return replace(self, head=change(self.head), read=lambda rows: change(read(rows)))

    def with_prefix(self, name: str) -> Self:
        """Return the file with its items and sequences called `name/...`."""

        def longer(texts: Iterable[str]) -> tuple[str, ...]:
            return tuple(text and f"{name}/{text}" for text in texts)

        def change(records: Record) -> Record:
            sequences = None if records.sequences is None else longer(records.sequences)
            return records.replaced(items=longer(records.items), sequences=sequences)

        return replace(self.changed(change), texts=lambda kind: map(longer, self.texts(kind)))


class Source(Generic[Record]):
    """The items of one or more files; a context manager, which closes the files.

    `head` has all but the items: their landmarks, unit, columns; `count` is how many items there
    are, `estimate` how many the files have if only their first ones were read; `notes` are warnings
    about what was left out of the files.
    """

    def __init__(
        self,
        files: Sequence[SourceFile[Record]],
        y_axis: Direction | None = None,
        *,
        check: bool = True,
    ) -> None:
        """Take files, and where y points in those that do not say it.

        Raises InputError for files that do not go together, and, if `check`, for an item that is
        twice in one; where two files have an item, all items begin with the name of their file.
        """
        self._files = files
        try:
            self._files = _make_unique(files) if check else files
            self.count = sum(file.count for file in files)
            self.estimate = round(sum(file.count / file.share for file in files))
            filled = [file for file in self._files if file.count] or self._files[:1]
            self.head: Record = merge_heads(filled, y_axis)  # what is empty may differ
        except BaseException:
            self.close()
            raise
        self.notes = tuple(note for file in self._files for note in file.notes)

    @property
    def states_y_axis(self) -> bool:
        """Whether a file says where y points."""
        return any(file.y_axis is not None for file in self._files)

    def batches(self, size: int, *, by_file: bool = False) -> Iterator[Record]:
        """Give out the items in order, `size` >= 1 at a time, `by_file` none of two files together.

        A source without items gives one empty set, so that what is made of it can be written.
        """
        parts: list[Record] = []
        remaining = size
        for file in self._files:
            start = 0
            while start < file.count:
                stop = min(start + remaining, file.count)
                parts.append(align_to(file.read(slice(start, stop)), self.head, file.name))
                remaining, start = remaining - (stop - start), stop
                if remaining == 0 or (by_file and stop == file.count):
                    yield concatenate(parts)
                    parts, remaining = [], size
        if parts or not self.count:
            yield concatenate(parts) if parts else self.head

    def chosen(self, rows: NDArray[np.intp], size: int) -> Iterator[Record]:
        """Give out the items of these rows, which ascend, from batches of `size`."""
        start = 0
        for batch in self.batches(size):
            first, last = np.searchsorted(rows, [start, start + len(batch)])
            if first < last:
                yield batch.take(rows[first:last] - start)
            start += len(batch)

    def first(self, count: int) -> Record:
        """Return the first items, at most `count`."""
        return next(self.batches(count))

    def whole(self) -> Record:
        """Return all items as one record."""
        return self.first(max(self.count, 1))

    def names(self) -> Iterator[Sequence[str]]:
        """Read the items, block by block."""
        return chain.from_iterable(file.texts("item") for file in self._files)

    def sequences(self) -> Iterator[Sequence[str]]:
        """Read the sequences of all items, block by block; an empty text where there is none."""
        for file in self._files:
            missing = file.head.sequences is None
            yield from [("",) * file.count] if missing else file.texts("sequence")

    def close(self) -> None:
        """Close the files."""
        for file in self._files:
            file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self.close()


LandmarkSource = Source[LandmarkSet]
ShapeSource = Source[ShapeSet]
ResultSource = Source[ResultSet]
AnyRecords = ResultSet | ShapeSet | LandmarkSet


def _make_unique(files: Sequence[SourceFile[Any]]) -> Sequence[SourceFile[Any]]:
    """Return files whose items and sequences begin with the file's name if two have an item."""
    shared = find_shared_item([(partial(file.texts, "item"), file.place) for file in files])
    if shared is None:
        return files
    paths = [Path(file.name).with_suffix("").parts for file in files]
    depths = range(1, max(map(len, paths)) + 1)
    depth = next((d for d in depths if len({parts[-d:] for parts in paths}) == len(paths)), None)
    if depth is None:
        fault = f"the item '{shared}' is in two files of this name"
        raise input_error(files[0].name, fault, "give each file once, under a name of its own")
    named = [
        file.with_prefix("/".join(parts[-depth:])) for file, parts in zip(files, paths, strict=True)
    ]
    example = f"'{'/'.join(paths[0][-depth:])}/...'"
    note = f"'{shared}' in more than one file: items begin with the file, {example}"
    return [replace(named[0], notes=(*named[0].notes, note)), *named[1:]]


def _open_all(
    form: Layout,
    paths: Sequence[Path],
    options: InputOptions,
    **how: Any,
) -> list[SourceFile[Any]]:
    """Open files of one layout, their landmarks renamed, and of these those that are retained."""
    groups = _groups(paths, options)
    if options.individual is not None and not any(group[0].read_poses for group in groups):
        fix = "write that individual to a file by `shapefit convert`, and use this"
        raise input_error(paths[0], "`individual` is for files of other tools", fix)
    files = [_open(form, *group, options, share=len(groups), **how) for group in groups]
    if rename := options.rename:
        names = dict.fromkeys(name for file in files for name in file.head.landmark_names)
        match_landmarks(tuple(names), tuple(rename), "rename")
        files = [f.changed(lambda r, n=f.name: r.renamed(rename, n)) for f in files]  # type: ignore[misc]
    if (retained := options.landmarks) is not None:
        from shapefit.io.readers.items import keep_landmarks

        files = [f.changed(lambda r, n=f.name: keep_landmarks(r, retained, n)) for f in files]  # type: ignore[misc]
    return files


def _groups(
    paths: Sequence[Path], options: InputOptions
) -> list[tuple[FileFormat, tuple[Path, ...]]]:
    """Return inputs with their formats; the readers of other tools' are imported where needed."""
    paths = list(dict.fromkeys(paths))
    ours = [own_format(path) if options.format == "auto" else None for path in paths]
    if all(ours):
        return [(each, (path,)) for each, path in zip(ours, paths, strict=True) if each]
    from shapefit.io.detect import group_inputs

    return group_inputs(paths, options)


def _open(
    form: Layout,
    file_format: FileFormat,
    paths: tuple[Path, ...],
    options: InputOptions,
    *,
    gaps: bool = False,
    check: bool = True,
    head: bool = False,
    **how: Any,
) -> SourceFile[Any]:
    """Open a file of any format; one that is read whole gives out parts of what was read."""
    path, name = paths[0], source_name(paths[0])
    notes: tuple[str, ...] = ()
    records: Any
    if file_format.read_poses is not None and form is not RESULTS:
        from shapefit.io.readers import items

        if form is LANDMARKS:
            records, notes = items.read_landmarks(file_format, paths, options)
            stated = records.y_axis if file_format.states_y_axis else None
            return SourceFile.of(name, records, notes=notes, y_axis=stated)
        records, notes = items.read_shapes(file_format, paths, options, gaps=gaps)
        return _checked(SourceFile.of(name, records, notes=notes), form, gaps=True)
    check_holds(path, form.kind, file_format)
    if file_format is HDF5:
        file = _open_hdf5(path, form, **how)
    elif head:
        from shapefit.io.csv_file import read_csv_head

        records, share = read_csv_head(path, form.kind)
        file = SourceFile.of(name, records, share=share)
    else:
        from shapefit.io.csv_file import Spool, read_csv

        records, notes = read_csv(path, form.kind, gaps=gaps)
        file = SourceFile.of(name, records, notes=notes)
        if isinstance(records, Spool):
            file = replace(file, texts=records.texts, close=records.close)
        if form is LANDMARKS and file.head.confidence is None:
            some = file.read(slice(0, min(file.count, BLOCK))).landmarks
            zeros = tuple(f"{name}: {text}" for text in warn_of_zeros(some.swapaxes(1, 2)))
            file = replace(file, notes=notes + zeros)
        gaps = True  # the table has looked for them
    file = _checked(file, form, gaps) if check else file
    if form is LANDMARKS:
        try:
            file = _in_pixels(file, options) if check else file
        except InputError:
            file.close()
            raise
        file = _hiding(file, options.min_confidence)
    return file


def _open_hdf5(
    path: Path,
    form: Layout,
    *,
    share: int,
    rows: slice | None = None,
    without: Collection[str] = (),
    old: bool = False,
) -> SourceFile[Any]:
    """Open a file of ours, or a part of its rows, but for some datasets.

    It stays open, unless it is one of more than MAX_OPEN that `share` a source.
    """
    from shapefit.io.hdf5_file import Hdf5Reader

    reader = Hdf5Reader(path, form, old=old)
    start, stop, _ = (rows or slice(None)).indices(reader.count)

    @contextmanager
    def opened() -> Iterator[Hdf5Reader]:
        nonlocal reader
        if not reader.root:
            reader = Hdf5Reader(path, form, old=old)
        try:
            yield reader
        finally:
            if share > MAX_OPEN:
                reader.close()

    def read(part: slice) -> Any:
        with opened() as file:
            return file.records(slice(start + part.start, start + part.stop), without)

    def texts(name: str) -> Iterator[Sequence[str]]:
        for first in range(start, stop, BLOCK):
            with opened() as file:
                block = file.read(name, slice(first, min(first + BLOCK, stop)))
            yield block

    def place(name: str, row: int) -> str:
        return f"{path}:/{name}[{start + row}]"

    stated = reader.stated["y_axis"]
    close: Callable[[], None] = lambda: reader.close()  # noqa: E731 the one that is open then
    try:
        head = read(slice(0, 0))
    except BaseException:
        close()
        raise
    return SourceFile(str(path), head, stop - start, read, texts, place, close, y_axis=stated)


def _checked(file: SourceFile[Any], form: Layout, gaps: bool) -> SourceFile[Any]:
    """Return a file whose values are checked when they are read, and whose points are whole."""

    def read(rows: slice) -> Any:
        records = file.read(rows)
        place = lambda name, row: file.place(name, rows.start + row)  # noqa: E731
        check_values(records.columns, form, place, records.landmark_names, gaps)
        return records if form is RESULTS else records.with_whole_points()

    return replace(file, read=read)


def _in_pixels(file: SourceFile[Any], options: InputOptions) -> SourceFile[Any]:
    """Return a file of ours with landmarks in pixels, if the first are fractions of an image.

    Raises InputError for fractions without `image_size`.
    """
    if file.head.unit not in ("px", UNKNOWN_UNIT):
        return file
    points = file.read(slice(0, min(file.count, BLOCK))).landmarks
    values = points[np.isfinite(points)]
    if not values.any() or np.abs(values).max() > 2 or (values < 0).mean() > CENTRED:
        return file
    from shapefit.io.readers import items, poses

    if not poses.are_fractions(values):
        return file
    if options.image_size is None:
        raise items.size_needed(file.name)
    size = np.array(options.image_size)[:, None]
    return file.changed(lambda r: r.replaced(landmarks=r.landmarks * size, unit="px"))


def _hiding(file: SourceFile[Any], least: float) -> SourceFile[Any]:
    """Return a file that hides landmarks whose confidence is below `least`."""
    if not least or file.head.confidence is None:
        return file

    def hidden(images: Any) -> Any:
        doubtful = images.confidence < least
        points = np.where(doubtful[:, None], np.nan, images.landmarks)
        weights = np.where(doubtful, 0, images.confidence)
        return images.replaced(landmarks=points, confidence=weights)

    return file.changed(hidden)

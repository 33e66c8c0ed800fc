"""Files of landmarks, shapes and results, in any format, as one source that gives out batches."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from typing import Any, Generic, Self

import numpy as np
from numpy.typing import NDArray

from shapefit.errors import input_error
from shapefit.io.checks import check_magnitudes, check_values, place_in_memory, warn_of_zeros
from shapefit.io.formats import HDF5, FileFormat, check_holds, own_format, record_writer
from shapefit.io.inputs import source_name
from shapefit.io.layout import LANDMARKS, PROOF, RESULTS, SHAPES, UNKNOWN_UNIT, Layout
from shapefit.io.merge import align_to, merge_heads
from shapefit.io.names import check_items, check_renamed
from shapefit.io.options import AS_THEY_ARE, Direction, InputOptions
from shapefit.io.records import LandmarkSet, Record, ResultSet, ShapeSet, concatenate

CENTRED = 0.1
"""Share of coordinates below 0 from which on they are no fractions of an image, but points about
a centre in a unit of their own."""

MAX_IN_MEMORY = 1 << 21
"""Landmarks of all files together that are held, some 50 MB; of more, rows are read as needed."""

MAX_OPEN = 64
"""HDF5 files that stay open; of more, each is opened anew for its rows."""

BLOCK = 1 << 12
"""Images by which landmarks are first looked at."""

CHECKED_BYTES = 1 << 24
"""Of an HDF5 file that are read at a time to be checked."""

PIXELS = 2
"""Beyond which a coordinate is no fraction of an image."""

LARGEST = 1 << 24
"""Bytes of a carried dataset that is read where only the first items are wanted."""

GAP = 1 << 10
"""Rows that are read and dropped rather than begun anew behind them."""


def open_landmarks(
    paths: Sequence[Path],
    options: InputOptions = AS_THEY_ARE,
    rows: slice | None = None,
    *,
    selects: bool = False,
    check: bool = True,
    first: int | None = None,
) -> LandmarkSource:
    """Open files of landmarks in any format (`-` is standard input) as one source.

    Of HDF5 rows are read as they are asked for, CSV is read in one pass, all else whole. Everything
    is checked before the first image is given out, and raises InputError: what is wrong with a
    file, items that occur twice, files that do not go together, names to rename that no file has.

    rows     those of the one HDF5 file that are given out: nothing else of it is read
    selects  the caller selects the individual in files of ours; without, that is refused
    check    without, only heads are read of HDF5, and values and names are not checked
    first    so many landmarks are read of CSV, and the source has an `estimate` of its count; of
             HDF5 no carried dataset of more than LARGEST bytes is read
    """
    how: dict[str, Any] = {"rows": rows, "check": check, "first": first}
    files = _open_all(LANDMARKS, paths, options, selects, **how)
    return Source(files, options.y_axis, check=check)


def open_shapes(
    paths: Sequence[Path],
    options: InputOptions = AS_THEY_ARE,
    *,
    gaps: bool = False,
    selects: bool = False,
    check: bool = True,
    first: int | None = None,
) -> ShapeSource:
    """Open files of shapes in any format as one source, checked as `open_landmarks` does.

    Landmarks are matched by name and stand in the order of the first file, items in the order of
    the files. With `gaps` a landmark of an item may be unknown: it is NaN, in all coordinates where
    it is in one, and may lack its row in CSV. Without, that is wrong.
    """
    how: dict[str, Any] = {"gaps": gaps, "check": check, "first": first}
    files = _open_all(SHAPES, paths, options, selects, **how)
    return Source(files, check=check)


def open_results(
    paths: Sequence[Path],
    without: Collection[str] | None = None,
    *,
    proofs: bool = False,
    check: bool = True,
    old: bool = False,
    first: int | None = None,
) -> ResultSource:
    """Open results as one source, checked as `open_landmarks` does.

    Datasets in `without` are not read, by default what proves the optimum unless `proofs`. Of CSV
    all but shapes, names, items and sequences is None. `old` files of version 1 are read, too.
    """
    left = (() if proofs else frozenset(PROOF)) if without is None else without
    keep = len(paths) <= MAX_OPEN
    how: dict[str, Any] = {"without": left, "check": check, "old": old, "first": first}
    files = [
        _open(RESULTS, *group, AS_THEY_ARE, keep_open=keep, **how)
        for path in paths
        for group in _groups([path], AS_THEY_ARE)
    ]
    return Source(files, check=check)


def source_of(
    records: Record, name: str, rename: Mapping[str, str], *, gaps: bool = False
) -> Source[Record]:
    """Return landmarks or shapes in memory as a source; `name` stands for a file in messages.

    With `gaps` landmarks of shapes may be unknown. Raises InputError as for what a file holds.
    """
    place = place_in_memory(name)
    check_values(records.columns, records.LAYOUT, place, records.landmark_names, gaps=gaps)
    check_renamed(rename, [(name, records.landmark_names)])
    records = records.with_whole_points().renamed(rename, name)
    stated = records.y_axis if isinstance(records, LandmarkSet) else None
    return Source([SourceFile.of(name, records, lambda row: place("item", row), y_axis=stated)])


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


@dataclass(frozen=True)
class SourceFile(Generic[Record]):
    """One file of a source: `head` has all but the items, `read` returns those of some rows.

    texts reads the datasets item and sequence of all items, block by block; `place` names a row in
    messages; notes are warnings about what was left out; y_axis is where y points, None where the
    file does not say it; estimate is the count of a file of which only the first were read.
    """

    name: str
    head: Record
    count: int
    read: Callable[[slice], Record]
    texts: Callable[[str], Iterable[Sequence[str]]]
    place: Callable[[int], str]
    close: Callable[[], None] = lambda: None
    notes: tuple[str, ...] = ()
    y_axis: Direction | None = None
    estimate: int | None = None

    @classmethod
    def of(
        cls, name: str, records: Record, place: Callable[[int], str] | None = None, **stated: Any
    ) -> Self:
        """Return records in memory as a file; without `place` messages name the file alone."""
        return cls(
            name=name,
            head=records.take(slice(0, 0)),
            count=len(records),
            read=records.take,
            texts=lambda kind: [records.items if kind == "item" else records.sequences or ()],
            place=place or (lambda _: name),
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
    are.
    """

    def __init__(
        self,
        files: Sequence[SourceFile[Record]],
        y_axis: Direction | None = None,
        *,
        check: bool = True,
    ) -> None:
        """Take files, where y points in those that do not say it; check that they go together.

        Items that are in two files begin with the name of their file, as all then do. Raises
        InputError for files that differ, and, if `check`, for equal items in one.
        """
        self._files = files
        try:
            self._files = make_unique(files) if check else files
            self.count = sum(file.count for file in files)
            filled = [file for file in self._files if file.count] or self._files[:1]
            heads = [(file.name, file.head) for file in filled]  # what is empty may differ
            self.head: Record = merge_heads(heads, [(f.name, f.y_axis) for f in filled], y_axis)
        except BaseException:
            self.close()
            raise

    @property
    def states_y_axis(self) -> bool:
        """Whether a file says where y points."""
        return any(file.y_axis is not None for file in self._files)

    @property
    def estimate(self) -> int | None:
        """About how many items there are, where only the first of them were read."""
        counts = [file.count if file.estimate is None else file.estimate for file in self._files]
        return sum(counts) if sum(counts) > self.count else None

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
        return self._batches(size, by_file)

    def _batches(self, size: int, by_file: bool) -> Iterator[Record]:
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

    def take(self, rows: NDArray[np.intp]) -> Record:
        """Return the items of these rows, which ascend, none twice; near ones are read together."""
        parts: list[Record] = []
        starts = np.cumsum([0, *(file.count for file in self._files)])
        numbers = np.searchsorted(starts, rows, "right") - 1
        for number in np.unique(numbers).tolist():
            file, own = self._files[number], rows[numbers == number] - starts[number]
            for near in np.split(own, np.flatnonzero(np.diff(own) > GAP) + 1):
                part = file.read(slice(int(near[0]), int(near[-1]) + 1)).take(near - near[0])
                parts.append(align_to(part, self.head, file.name))
        return concatenate(parts) if parts else self.head

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


def make_unique(files: Sequence[SourceFile[Any]]) -> Sequence[SourceFile[Any]]:
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
    named = [file.with_prefix(name) for file, name in zip(files, names, strict=True)]
    return [replace(named[0], notes=(*named[0].notes, note)), *named[1:]]


Group = tuple[FileFormat, tuple[Path, ...]]


def _groups(paths: Sequence[Path], options: InputOptions) -> list[Group]:
    """Return inputs with their formats; the readers of other tools' are imported where needed."""
    paths = list(dict.fromkeys(paths))
    own = [own_format(path) if options.format == "auto" else None for path in paths]
    if all(own):
        return [(one, (path,)) for one, path in zip(own, paths, strict=True) if one]
    from shapefit.io.detect import group_inputs

    return group_inputs(paths, options)


def _open_all(
    form: Layout, paths: Sequence[Path], options: InputOptions, selects: bool, **how: Any
) -> list[SourceFile[Any]]:
    """Open files of landmarks or shapes, their landmarks renamed, and of these those kept.

    Raises InputError for an individual of files that are ours, unless the caller `selects` it.
    """
    groups = _groups(paths, options)
    third_party = any(one.read_poses for one, _ in groups)
    if options.individual is not None and not selects and not third_party:
        fix = "write that individual to a file by `shapefit convert`, and use this"
        raise input_error(paths[0], "`individual` is for files of other tools", fix)
    most = MAX_IN_MEMORY // len(groups) if form is LANDMARKS else 0
    how |= {"max_in_memory": most, "keep_open": len(groups) <= MAX_OPEN}
    files = [_open(form, *group, options, **how) for group in groups]
    rename, retained = options.rename, options.landmarks
    check_renamed(rename, [(file.name, file.head.landmark_names) for file in files])
    if third_party and form is LANDMARKS:
        from shapefit.io.detect import warn_of_mixture

        files[0] = replace(files[0], notes=files[0].notes + warn_of_mixture(groups))
    if rename:
        files = [f.changed(lambda r, n=f.name: r.renamed(rename, n)) for f in files]  # type: ignore[misc]
    if retained is not None:
        from shapefit.io.readers.items import keep_landmarks

        files = [f.changed(lambda r, n=f.name: keep_landmarks(r, retained, n)) for f in files]  # type: ignore[misc]
    return files


def _open(
    form: Layout,
    file_format: FileFormat,
    paths: tuple[Path, ...],
    options: InputOptions,
    *,
    gaps: bool = False,
    first: int | None = None,
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
        check_magnitudes(name, records.shapes, records.items, records.landmark_names)
        return SourceFile.of(name, records, notes=notes)
    check_holds(path, form.kind, file_format)
    if file_format is HDF5:
        file = _open_hdf5(path, form, gaps, large=first is None, **how)
    else:
        from shapefit.io.tidy_table import Spool, read_csv

        records, notes = read_csv(path, form.kind, gaps=gaps)
        file = SourceFile.of(name, records)
        if isinstance(records, Spool):
            file = replace(file, texts=records.texts, close=records.close)
        if form is LANDMARKS and file.head.confidence is None:
            some = file.read(slice(0, min(file.count, BLOCK))).landmarks
            notes += tuple(f"{name}: {text}" for text in warn_of_zeros(some.swapaxes(1, 2)))
        if form is SHAPES:
            check_magnitudes(name, records.shapes, records.items, records.landmark_names)
        file = replace(file, notes=notes)
    if form is LANDMARKS:
        file = _in_pixels(file, options) if how["check"] else file
        return _hiding(file, options.min_confidence)
    return file


def _open_hdf5(
    path: Path,
    form: Layout,
    gaps: bool,
    *,
    large: bool = True,
    rows: slice | None = None,
    without: Collection[str] = (),
    check: bool = True,
    old: bool = False,
    max_in_memory: int = 0,
    keep_open: bool = True,
) -> SourceFile[Any]:
    """Open a file of landmarks, shapes or results, or a part of its rows, but for some datasets.

    Unless `large`, carried datasets of more than LARGEST bytes are left out, too.

    Items of at most so many landmarks together are read once and held, others whenever they are
    needed. Raises InputError for what is wrong with it.
    """
    from shapefit.io.hdf5_records import Hdf5Reader

    reader = Hdf5Reader(path, form, old=old)
    stated, names = reader.stated["y_axis"], reader.landmark_names
    start, stop, _ = (rows or slice(None)).indices(reader.count)

    def opened() -> Hdf5Reader:
        nonlocal reader
        if not reader.root:
            reader = Hdf5Reader(path, form, old=old)
        return reader

    def blocks() -> Iterator[slice]:
        size = max(1, min(BLOCK * 4, CHECKED_BYTES // (48 * max(len(names), 1))))
        return (slice(at, min(at + size, stop)) for at in range(start, stop, size))

    def read(own: slice) -> Any:
        rows = slice(start + own.start, start + own.stop)
        records = opened().records(rows, without)
        if not keep_open and rows.stop >= stop:
            reader.close()
        return records if form is RESULTS else records.with_whole_points()

    def texts(name: str) -> Iterator[Sequence[str]]:
        return (opened().read(name, rows) for rows in blocks())

    def place(row: int) -> str:
        return f"{path}:/item[{start + row}]"

    def check_rows(fields: Mapping[str, Any], at: int) -> None:
        check_values(fields, form, reader.place, names, start=at, gaps=gaps)

    try:
        if check and (stop - start) * len(names) <= max_in_memory:
            records = reader.records(slice(start, stop), without)
            check_rows(records.columns, start)
            reader.close()
            return SourceFile.of(str(path), records.with_whole_points(), place, y_axis=stated)
        for block in blocks() if check and form is not RESULTS else ():
            check_rows(reader.fields(block, without=("item", "sequence")), block.start)
        head = read(slice(0, 0))
    except BaseException:
        reader.close()
        raise
    if not keep_open:
        reader.close()
    close = lambda: reader.close()  # noqa: E731 the one that is open then
    return SourceFile(str(path), head, stop - start, read, texts, place, close, y_axis=stated)


def _in_pixels(file: SourceFile[Any], options: InputOptions) -> SourceFile[Any]:
    """Return a file of ours with landmarks in pixels, where they are fractions of an image.

    Raises InputError for fractions without `image_size`.
    """
    if file.head.unit not in ("px", UNKNOWN_UNIT):
        return file
    count, below, zeros = 0, 0, 0
    for start in range(0, file.count, BLOCK):
        points = file.read(slice(start, min(start + BLOCK, file.count))).landmarks
        values = points[np.isfinite(points)]
        if np.abs(values).max(initial=0) > PIXELS or not _are_fractions(values):
            return file
        count, below = count + values.size, below + int((values < 0).sum())
        zeros += int((values == 0).sum())
    if count == zeros or below > CENTRED * count:
        return file
    if options.image_size is None:
        from shapefit.io.readers.items import size_needed

        raise size_needed(file.name)
    size = np.array(options.image_size)[:, None]
    return file.changed(lambda r: r.replaced(landmarks=r.landmarks * size, unit="px"))


def _are_fractions(values: NDArray[Any]) -> bool:
    from shapefit.io.readers.poses import are_fractions

    return not values.size or are_fractions(values)


def _hiding(file: SourceFile[Any], least: float) -> SourceFile[Any]:
    """Return a file that hides landmarks whose confidence is below `least`."""
    if not least or file.head.confidence is None:
        return file

    def hidden(images: LandmarkSet) -> LandmarkSet:
        assert images.confidence is not None
        doubtful = images.confidence < least
        return images.replaced(
            landmarks=np.where(doubtful[:, None], np.nan, images.landmarks),
            confidence=np.where(doubtful, 0.0, images.confidence),
        )

    return file.changed(hidden)

"""Read files of results, in chunks or whole, several files as one."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from pathlib import Path

from shapefit.errors import input_error, listed
from shapefit.io.agreement import APART, agreed, agreed_rate, check_same_extras
from shapefit.io.chunked import ChunkedSource, SourceFile
from shapefit.io.duplicates import ItemList
from shapefit.io.extras import Extras
from shapefit.io.formats import find_reader
from shapefit.io.layout import PROOF, RESULTS, TREES, UNKNOWN_UNIT, Dataset
from shapefit.io.magnitudes import Axis, check_magnitudes
from shapefit.io.records import ResultSet
from shapefit.io.sources import source_name
from shapefit.io.stored.checks import check_named
from shapefit.io.stored.opening import open_stored
from shapefit.io.stored.reader import StoredReader


def read_results(path: Path, *, proofs: bool = False) -> ResultSet:
    """Read a result from a file of any format that has one (`-` is standard input), as one.

    What proves the optimum stays in the file, see proofs.py, unless `proofs` asks for it. Raises
    InputError as `open_results`.
    """
    with open_results([path], proofs=proofs) as source:
        return source.whole()


def open_results(paths: Sequence[Path], *, proofs: bool = False) -> ResultSource:
    """Open results as one source; with `proofs` also what proves them.

    From CSV all but shapes, names, items and sequences is None. HDF5 and Parquet are read a chunk
    at a time, CSV whole. Raises InputError for what is wrong with a file, for items that occur
    twice, and for files that do not go together.
    """
    return ResultSource([_open(path, proofs=proofs) for path in paths])


class ResultSource(ChunkedSource[ResultSet, SourceFile[ResultSet]]):
    """The results of one or more files: `with open_results(paths) as source: ...`."""

    def __init__(self, files: Sequence[SourceFile[ResultSet]]) -> None:
        super().__init__(files)
        self._head = _common_head([file for file in files if file.count] or files[:1])

    @property
    def head(self) -> ResultSet:
        """All of the source but its results; the attributes are those of the first file."""
        return self._head

    def _conform(self, part: ResultSet, place: str) -> ResultSet:
        items, landmarks = Axis("item", part.items), Axis("landmark", part.landmark_names)
        check_magnitudes(place, part.shapes, items, landmarks)
        head = self._head
        return replace(part, unit=head.unit, frame_rate=head.frame_rate, attributes=head.attributes)


def open_stored_file(path: Path, *, proofs: bool = False) -> SourceFile[ResultSet]:
    """Open an HDF5 or Parquet file of results, which is read a chunk at a time."""
    without = () if proofs else PROOF + TREES

    @contextmanager
    def opened() -> Iterator[Callable[[slice], ResultSet]]:
        with open_stored(path, RESULTS) as reader:
            yield lambda rows: read_rows(reader, rows, without)

    def items() -> Iterator[tuple[str, ...]]:
        with open_stored(path, RESULTS) as reader:
            yield from reader.read_blocks("item")

    with open_stored(path, RESULTS) as reader:
        check_named(reader, reader.read_blocks("item"))
        head = read_rows(reader, slice(0), without)
        item_list = ItemList(items, lambda row: reader.place("item", row))
        return SourceFile(str(path), head, reader.count, item_list, opened)


def read_rows(reader: StoredReader, rows: slice, without: Collection[Dataset] = ()) -> ResultSet:
    """Return the results of these items, but for some datasets."""
    return ResultSet(
        **reader.fields(rows, without=without),
        extras=reader.extras(rows),
        unit=reader.unit,
        y_axis=reader.y_axis or "down",
        frame_rate=reader.frame_rate,
        attributes=reader.attributes,
    )


def _open(path: Path, *, proofs: bool) -> SourceFile[ResultSet]:
    read = find_reader(path, "result")
    if read is open_stored_file:
        return open_stored_file(path, proofs=proofs)
    table: ResultSet = read(path)
    name = source_name(path)
    items = ItemList(lambda: [table.items], lambda _: name)
    return SourceFile(
        name, table.take(slice(0)), len(table), items, lambda: nullcontext(table.take)
    )


def _common_head(files: Sequence[SourceFile[ResultSet]]) -> ResultSet:
    """Return the head of a whole source; InputError where its files do not go together."""
    first = files[0]
    check_same_extras([(file.name, Extras.of(file.head.extras, 0)) for file in files])
    for file in files[1:]:
        if file.head.landmark_names != first.head.landmark_names:
            found = f"its landmarks are not those of {first.name}, in their order"
            raise input_error(file.name, found, APART)
        if differing := sorted(_datasets(file.head) ^ _datasets(first.head)):
            found = f"only one of it and {first.name} has {listed(differing, 'and')}"
            raise input_error(file.name, found, APART)
    agreed("y_axis", [(file.name, file.head.y_axis) for file in files], "down")
    units = [(file.name, file.head.unit) for file in files]
    known = [(name, None if unit == UNKNOWN_UNIT else unit) for name, unit in units]
    return replace(
        first.head,
        unit=agreed("unit", known, UNKNOWN_UNIT),
        frame_rate=agreed_rate([(file.name, file.head.frame_rate) for file in files]),
    )


def _datasets(head: ResultSet) -> set[str]:
    return {known.name for known in RESULTS.datasets if getattr(head, known.attribute) is not None}

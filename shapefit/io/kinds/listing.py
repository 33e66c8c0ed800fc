"""What a file holds, without its numbers: kind, items, sequences, names of landmarks."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

from shapefit.errors import input_error
from shapefit.io.formats import find_format, find_lister
from shapefit.io.kinds.kind import find_kind, has_depth
from shapefit.io.kinds.landmarks import open_landmarks
from shapefit.io.kinds.results import read_results, read_rows
from shapefit.io.kinds.shapes import read_shapes
from shapefit.io.layout import DICTIONARY, RESULTS, UNKNOWN_UNIT
from shapefit.io.options import AS_THEY_ARE, InputOptions
from shapefit.io.records import LandmarkSet, ResultSet, ShapeSet
from shapefit.io.sources import is_stream
from shapefit.io.stored.opening import open_stored, stored_form

ListedKind = Literal["result", "shapes", "landmarks"]
Records = ResultSet | ShapeSet | LandmarkSet

BLOCK = 16384
"""Items that are read at a time."""


@dataclass(frozen=True)
class Listing:
    """A file of results, shapes or landmarks: n items, and the root attributes.

    y_axis is None for shapes, and where the file does not say it; frame_rate as in the records;
    datasets are the names of all that an HDF5 or Parquet file holds.
    """

    path: Path
    kind: ListedKind
    items: tuple[str, ...]
    sequences: tuple[str, ...] | None
    landmark_names: tuple[str, ...]
    unit: str = UNKNOWN_UNIT
    y_axis: Literal["up", "down"] | None = None
    frame_rate: float | None = None
    attributes: Mapping[str, Any] = field(default_factory=dict)
    datasets: frozenset[str] = frozenset()
    options: InputOptions = AS_THEY_ARE


def list_file(path: Path, options: InputOptions = AS_THEY_ARE) -> Listing:
    """Tell what a file holds, by its content.

    A CSV file with the column z is taken for a result: shapes in the frame of a camera. Raises
    InputError for what is wrong with the file, for other kinds, and for standard input.
    """
    if is_stream(path):
        found = "standard input can be read only once"
        raise input_error("-", found, "save it to a file and name that")
    if find_format(path, options.format).recorder is not None:
        return list_records(path, find_kind(path, options), options)
    lister = find_lister(path)
    if lister is None:
        return list_records(path, next(iter(find_format(path).readers)))
    listing: Listing = lister(path)
    return listing


def list_records(path: Path, kind: str, options: InputOptions = AS_THEY_ARE) -> Listing:
    """List a file by reading it."""
    if kind == "landmarks":
        with open_landmarks([path], options) as source:
            records = source.whole()
            listing = _listing(path, "landmarks", records, source.y_axis)
    elif kind == "shapes":
        listing = _listing(path, "shapes", read_shapes([path], options, gaps=True), None)
    else:
        results = read_results(path)
        listing = _listing(path, "result", results, results.y_axis)
    return replace(listing, options=options)


def _listing(
    path: Path, kind: ListedKind, records: Records, y_axis: Literal["up", "down"] | None
) -> Listing:
    return Listing(
        path=path,
        kind=kind,
        items=records.items,
        sequences=records.sequences,
        landmark_names=records.landmark_names,
        unit=records.unit,
        y_axis=y_axis,
        frame_rate=records.frame_rate,
    )


def list_stored(path: Path) -> Listing:
    """List an HDF5 or Parquet file of results, shapes or landmarks."""
    form = stored_form(path)
    if form is DICTIONARY:
        raise input_error(path, f"is a {form.name} file", "give results, shapes or landmarks")
    kind: Any = form.kind
    with open_stored(path, form) as reader:
        return Listing(
            path=path,
            kind=kind,
            items=reader.read("item"),
            sequences=reader.read("sequence"),
            landmark_names=reader.landmark_names,
            unit=reader.unit,
            y_axis=None if kind == "shapes" else reader.y_axis,
            frame_rate=reader.frame_rate,
            attributes=reader.attributes,
            datasets=reader.names,
        )


def read_chunks(listing: Listing, of_results: Collection[str]) -> Iterator[Records]:
    """Read what was listed, in order, some thousand items at a time; shapes and CSV at once.

    Of the datasets that results may have beside their shapes, only those `of_results` are read.
    """
    if listing.kind == "landmarks":
        with open_landmarks([listing.path], listing.options) as source:
            yield from source.chunks(BLOCK)
    elif listing.kind == "shapes":
        own = bool(listing.datasets)  # in which landmarks must be known, as everywhere
        yield read_shapes([listing.path], listing.options, gaps=not own)
    elif listing.datasets:
        yield from _result_chunks(listing.path, of_results)
    else:
        yield read_results(listing.path)


def _result_chunks(path: Path, wanted: Collection[str]) -> Iterator[ResultSet]:
    without = [each for each in RESULTS.datasets if not each.required and each.name not in wanted]
    with open_stored(path, RESULTS) as reader:
        for start in range(0, max(1, reader.count), BLOCK):
            yield read_rows(reader, slice(start, min(start + BLOCK, reader.count)), without)


def list_table(path: Path) -> Listing:
    """List a CSV table."""
    from shapefit.io.csv.tables import read_landmark_table, read_result_table

    solid = has_depth(path)
    table = read_result_table(path) if solid else read_landmark_table(path)
    return Listing(
        path=path,
        kind="result" if solid else "landmarks",
        items=table.items,
        sequences=table.sequences,
        landmark_names=table.landmark_names,
    )

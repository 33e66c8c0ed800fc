"""What a file holds, without its numbers: kind, items, sequences, names of landmarks."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np

from shapefit.errors import input_error
from shapefit.io.formats import find_format, find_lister
from shapefit.io.kinds.landmarks import open_landmarks
from shapefit.io.kinds.results import read_results
from shapefit.io.kinds.shapes import read_shapes
from shapefit.io.layout import LANDMARKS, RESULTS, SHAPES, UNKNOWN_UNIT, Format
from shapefit.io.records import LandmarkSet, ResultSet, ShapeSet
from shapefit.io.sources import is_stream

ListedKind = Literal["result", "shapes", "landmarks"]
Records = ResultSet | ShapeSet | LandmarkSet

LAYOUTS: Mapping[str, tuple[ListedKind, Format]] = {
    RESULTS.name: ("result", RESULTS),
    SHAPES.name: ("shapes", SHAPES),
    LANDMARKS.name: ("landmarks", LANDMARKS),
}

LONGEST_HEADER = 1 << 16
"""Characters of a first line that are looked at: a device may never end it."""

BLOCK = 16384
"""Items that are read at a time."""


@dataclass(frozen=True)
class Listing:
    """A file of results, shapes or landmarks: n items, and the root attributes.

    y_axis is None for shapes; frame_rate as in the records; datasets are the names of all that an
    HDF5 file holds.
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


def list_file(path: Path) -> Listing:
    """Tell what a file holds, by its content.

    A CSV file with the column z is taken for a result: shapes in the frame of a camera. Raises
    InputError for what is wrong with the file, for other kinds, and for standard input.
    """
    if is_stream(path):
        found = "standard input can be read only once"
        raise input_error("-", found, "save it to a file and name that")
    lister = find_lister(path)
    if lister is None:
        return list_records(path)
    listing: Listing = lister(path)
    return listing


def list_records(path: Path) -> Listing:
    """List a file by reading it, as the first kind that its format can hold."""
    kind = next(iter(find_format(path).readers))
    if kind == "landmarks":
        with open_landmarks([path]) as source:
            (records,) = source.chunks(max(source.count, 1))
            return _listing(path, "landmarks", records, source.y_axis)
    if kind == "shapes":
        return _listing(path, "shapes", read_shapes([path]), None)
    results = read_results(path)
    return _listing(path, "result", results, results.y_axis)


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


def list_hdf5(path: Path) -> Listing:
    """List an HDF5 file of results, shapes or landmarks."""
    from shapefit.io.hdf5.reading import Hdf5Reader

    kind, form = _kind_of(path)
    with Hdf5Reader(path, form) as reader:
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
            datasets=_datasets(path),
        )


def read_chunks(listing: Listing, of_results: Collection[str]) -> Iterator[Records]:
    """Read what was listed, in order, some thousand items at a time; shapes and CSV at once.

    Of the datasets that results may have beside their shapes, only those `of_results` are read.
    """
    if listing.kind == "landmarks":
        with open_landmarks([listing.path]) as source:
            yield from source.chunks(BLOCK)
    elif listing.kind == "shapes":
        yield read_shapes([listing.path])
    elif listing.datasets:
        yield from _result_chunks(listing.path, of_results)
    else:
        yield read_results(listing.path)


def _result_chunks(path: Path, wanted: Collection[str]) -> Iterator[ResultSet]:
    from shapefit.io.hdf5.reading import Hdf5Reader

    with Hdf5Reader(path, RESULTS) as reader:
        for start in range(0, max(1, reader.count), BLOCK):
            rows = slice(start, min(start + BLOCK, reader.count))
            fields = {
                dataset.attribute: reader.read(
                    dataset.name, rows if dataset.per_item else slice(None)
                )
                for dataset in RESULTS.datasets
                if dataset.required or dataset.name in wanted
            }
            yield ResultSet(
                **fields,
                extras=reader.extras(rows),
                unit=reader.unit,
                y_axis=reader.y_axis,
                frame_rate=reader.frame_rate,
                attributes=reader.attributes,
            )


def _kind_of(path: Path) -> tuple[ListedKind, Format]:
    import h5py

    try:
        with h5py.File(path, "r") as file:
            stated = file.attrs.get("format")
    except (OSError, RuntimeError, KeyError, TypeError, ValueError) as error:
        found = f"cannot be read ({str(error).partition(chr(10))[0]})"
        fix = "the file may be cut off or damaged: copy or make it again"
        raise input_error(path, found, fix) from error
    name = stated.decode("utf-8", "replace") if isinstance(stated, bytes | np.bytes_) else stated
    if not isinstance(name, str) or name not in LAYOUTS:
        named = f"is a {name} file" if isinstance(name, str) else "has a format that is no text"
        found = "has no root attribute format" if name is None else named
        raise input_error(path, found, f"give one of {', '.join(LAYOUTS)}")
    return LAYOUTS[name]


def _datasets(path: Path) -> frozenset[str]:
    import h5py

    with h5py.File(path, "r") as file:
        return frozenset(file)


def list_table(path: Path) -> Listing:
    """List a CSV table."""
    from shapefit.io.csv.tables import read_landmark_table, read_result_table

    with path.open(encoding="utf-8", errors="replace") as file:
        columns = file.readline(LONGEST_HEADER).lstrip("\ufeff").strip().split(",")
    solid = "z" in {column.strip(' "') for column in columns}
    table = read_result_table(path) if solid else read_landmark_table(path)
    return Listing(
        path=path,
        kind="result" if solid else "landmarks",
        items=table.items,
        sequences=table.sequences,
        landmark_names=table.landmark_names,
        y_axis="up",
    )

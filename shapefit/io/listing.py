"""What a file holds, without its numbers: kind, items, sequences, names of landmarks."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path
from typing import Any, Literal, cast

import numpy as np
from numpy.typing import NDArray

from shapefit.errors import input_error
from shapefit.io.formats import CSV, HDF5, detect_format
from shapefit.io.inputs import is_stream
from shapefit.io.layout import RESULTS, UNKNOWN_UNIT
from shapefit.io.options import AS_THEY_ARE, Direction, InputOptions
from shapefit.io.readers.items import peek_poses
from shapefit.io.records import LandmarkSet, ResultSet, ShapeSet
from shapefit.io.source import open_landmarks, open_results, open_shapes

Kind = Literal["landmarks", "shapes", "result", "dictionary"]
ListedKind = Literal["result", "shapes", "landmarks"]
AnyRecords = ResultSet | ShapeSet | LandmarkSet

OPTIONAL = frozenset(n for n, c in RESULTS.datasets.items() if not c.required) - {"sequence"}
"""Datasets of results that need not be read."""


def find_kind(path: Path, options: InputOptions = AS_THEY_ARE) -> Kind:
    """Return what a file holds. A table with the column z holds shapes.

    Raises InputError for what is wrong with the file, and for standard input, which could not be
    read again.
    """
    if is_stream(path):
        found = "standard input can be read only once"
        raise input_error("-", found, "save it to a file and name that")
    known = detect_format(path, options.format)
    kind = known.records[0]  # JSON, for one, would be read whole to say so
    if known.holds:
        kind = known.holds(path)
    elif len(known.records) > 1:
        kind = "landmarks" if peek_poses(known, (path,)).dimensions == 2 else "shapes"
    return cast(Kind, kind)


@dataclass(frozen=True)
class Listing:
    """A file of results, shapes or landmarks: n items, and the root attributes.

    y_axis is None for shapes, and where the file does not say it; frame_rate as in the records;
    datasets are the names of those that the layout does not know.
    """

    path: Path
    kind: ListedKind
    items: tuple[str, ...]
    sequences: tuple[str, ...] | None
    landmark_names: tuple[str, ...]
    unit: str = UNKNOWN_UNIT
    y_axis: Direction | None = None
    frame_rate: float | None = None
    attributes: Mapping[str, Any] = field(default_factory=dict)
    datasets: frozenset[str] = frozenset()
    options: InputOptions = AS_THEY_ARE


def list_file(path: Path, options: InputOptions = AS_THEY_ARE) -> Listing:
    """Tell what a file holds, by its content.

    A CSV file with the column z is taken for a result: shapes in the frame of a camera. Raises
    InputError for what is wrong with the file, for other kinds, and for standard input.
    """
    kind: Any = find_kind(path, options)
    if kind == "dictionary":
        found = "is a shapefit-dictionary file"
        raise input_error(path, found, "give results, shapes or landmarks")
    if kind == "shapes" and detect_format(path, options.format) is CSV:
        kind = "result"
    with _open(path, kind, options, OPTIONAL) as source:
        head = source.head
        sequences = None if head.sequences is None else chain.from_iterable(source.sequences())
        return Listing(
            path=path,
            kind=kind,
            items=tuple(chain.from_iterable(source.names())),
            sequences=None if sequences is None else tuple(sequences),
            landmark_names=head.landmark_names,
            unit=head.unit,
            y_axis=head.y_axis if source.states_y_axis else None,
            frame_rate=head.frame_rate,
            attributes=head.attributes,
            datasets=frozenset(head.further),
            options=options,
        )


def read_rows(listing: Listing, of_results: Collection[str], rows: NDArray[np.intp]) -> AnyRecords:
    """Read some of what was listed, by rows of the file that ascend.

    Of the datasets that results may have beside their shapes, only those `of_results` are read.
    """
    without = OPTIONAL - set(of_results)
    with _open(listing.path, listing.kind, listing.options, without) as source:
        records: AnyRecords = source.take(rows)
        return records


def _open(path: Path, kind: ListedKind, options: InputOptions, without: Collection[str]) -> Any:
    """Open a file of a kind as a source; only in our own files must shapes have all landmarks."""
    if kind == "landmarks":
        return open_landmarks([path], options)
    if kind == "shapes":
        return open_shapes([path], options, gaps=detect_format(path, options.format) is not HDF5)
    return open_results([path], without)

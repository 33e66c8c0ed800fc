"""What kind of records a file holds."""

from __future__ import annotations

from pathlib import Path
from typing import Literal, cast

from shapefit.errors import input_error
from shapefit.io.formats import CSV, HDF5, own_format
from shapefit.io.inputs import is_stream
from shapefit.io.layout import RESULTS
from shapefit.io.options import AS_THEY_ARE, InputOptions
from shapefit.io.records import LandmarkSet, ResultSet, ShapeSet

Kind = Literal["landmarks", "shapes", "result", "dictionary"]
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
    file_format = own_format(path) if options.format == "auto" else None
    if file_format is None:
        from shapefit.io.detect import detect_format

        file_format = detect_format(path, options.format)
    if file_format is HDF5:
        from shapefit.io.hdf5_records import hdf5_kind

        return cast(Kind, hdf5_kind(path))
    if file_format is CSV:
        from shapefit.io.csv_file import csv_kind

        return cast(Kind, csv_kind(path))
    if len(file_format.records) == 1:  # JSON, for one, would be read whole to say so
        return cast(Kind, file_format.records[0])
    from shapefit.io.readers.items import read_poses

    return "landmarks" if read_poses(file_format, (path,)).dimensions == 2 else "shapes"

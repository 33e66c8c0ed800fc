"""Read files of results."""

from __future__ import annotations

from pathlib import Path

from shapefit.io.duplicates import ItemList, check_unique_items
from shapefit.io.formats import find_reader
from shapefit.io.layout import PROOF, RESULTS, TREES
from shapefit.io.magnitudes import Axis, check_magnitudes
from shapefit.io.records import ResultSet
from shapefit.io.sources import source_name


def read_results(path: Path, *, proofs: bool = False) -> ResultSet:
    """Read a result from HDF5 or CSV (`-` is standard input).

    From CSV all but shapes, names, items and sequences is None. What proves the optimum stays in
    the file, see proofs.py, unless `proofs` asks for it. Raises InputError for what is wrong with
    the file, and for items that occur twice.
    """
    reader = find_reader(path, "result")
    results: ResultSet = (
        reader(path, proofs=True) if reader is read_hdf5 and proofs else reader(path)
    )
    items, landmarks = Axis("item", results.items), Axis("landmark", results.landmark_names)
    check_magnitudes(source_name(path), results.shapes, items, landmarks)
    return results


def read_hdf5(path: Path, *, proofs: bool = False) -> ResultSet:
    """Read a result from HDF5; with `proofs` also what proves it."""
    from shapefit.io.hdf5.checks import check_named
    from shapefit.io.hdf5.reading import Hdf5Reader

    with Hdf5Reader(path, RESULTS) as reader:
        items = reader.read("item")
        check_named(reader, [items])
        check_unique_items([ItemList(lambda: [items], lambda row: reader.place("item", row))])
        return ResultSet(
            **reader.fields(without=() if proofs else PROOF + TREES),
            extras=reader.extras(),
            unit=reader.unit,
            y_axis=reader.y_axis,
            frame_rate=reader.frame_rate,
            attributes=reader.attributes,
        )

"""DeepLabCut: the columns of its tables, as CSV and as the HDF5 that pandas writes."""

from __future__ import annotations

import csv
import io
import pickle
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from shapefit.arrays import Floats
from shapefit.errors import abbreviate, printable
from shapefit.io.csv_file import read_numbers
from shapefit.io.readers.poses import (
    Poses,
    image_labels,
    number_labels,
    of_frames,
    require,
)
from shapefit.io.readers.text import read_table, read_text
from shapefit.io.readers.trackers import TrackerFile

HEADER = ("scorer", "individuals", "bodyparts", "coords")

Columns = list[tuple[str, ...]]
"""(scorer, [individual,] body part, coordinate) of each column."""


def read_csv(paths: tuple[Path, ...]) -> Poses:
    """Read DeepLabCut CSV, which Lightning Pose writes, too: a row for each frame,
    columns by name.

    Three lines of names (scorer, bodyparts, coords) come first, four with
    `individuals`. The first column is the number of the frame, or the path of an image,
    which may be split in three columns. Before it may stand a column of pandas that
    numbers the rows; cells may have semicolons or tabs between them, as Excel saves
    them.
    """
    path, text = paths[0], read_text(paths[0])
    delimiter = _delimiter(text)
    if _is_numbered(text, delimiter):
        rows = text.split("\n")
        text = "\n".join(row.partition(delimiter)[2] for row in rows)
    levels: dict[str, list[str]] = {}
    first_rows = text.split("\n", len(HEADER))[: len(HEADER)]
    for cells in csv.reader(first_rows, delimiter=delimiter):
        name, *_ = row = [cell.strip() for cell in cells] or [""]
        if name not in HEADER or name in levels:
            break
        levels[name] = row
    names = [
        levels[name] for name in HEADER[1:] if name in levels or name != "individuals"
    ]
    require(
        len({*map(len, names)}) == 1,
        "the lines of names have different numbers of cells",
    )
    columns = [("", *column) for column in zip(*names, strict=True)]
    placed = [number for number, column in enumerate(columns) if number and column[-1]]
    first = text.split("\n", len(levels))[-1].partition(delimiter)[0].strip('" ')
    numbered = not read_numbers([first])[1].any()
    labels = ["/".join(column[1:]) for column in columns]
    table = read_table(
        path, text, labels, delimiter, after=len(levels), padded=not numbered
    )
    if numbered:
        values = table.numbers([0, *placed])
        frames, values = number_labels(values[:, 0]), values[:, 1:]
    else:
        values, parts = (
            table.numbers(placed),
            table.texts(*range(min(placed, default=1))),
        )
        frames = image_labels(
            ["/".join(filter(None, row)) for row in zip(*parts, strict=True)]
        )
    return _of_columns(path, [columns[number] for number in placed], values, frames)


def row_names(lines: Sequence[str]) -> list[str]:
    """Return the names of the first rows of a table, without a column of pandas."""
    delimiter = _delimiter(lines[0])
    column = 1 if _is_numbered(lines[0], delimiter) else 0
    rows = [line.split(delimiter) for line in lines]
    return [row[column].strip(" \"'") if len(row) > column else "" for row in rows]


def _delimiter(text: str) -> str:
    """Return what stands between the cells of the first line most often."""
    first = text.partition("\n")[0]
    return max((",", ";", "\t"), key=first.count)


def _is_numbered(text: str, delimiter: str) -> bool:
    """Whether a column without a name, or of numbers, stands before that of names."""
    cells = [cell.strip(' "') for cell in text.partition("\n")[0].split(delimiter, 2)]
    return len(cells) > 1 and cells[0] not in HEADER and cells[1] in HEADER


def read_hdf5(paths: tuple[Path, ...]) -> Poses:
    """Read a table that pandas wrote, in one of its two layouts, without pandas.

    *table* (predictions): KEY/table has an index and blocks of numbers, their column
     names pickled
    in an attribute. *fixed* (labels): KEY/block0_values, its names beside it as levels
        and codes.
    """
    columns: Columns = []
    blocks = []
    with TrackerFile(paths[0]) as file:
        keys = [name for name in file.root if file.text("pandas_type", name)]
        require(
            len(keys) == 1,
            f"the tables {', '.join(keys)}; save one of them in its own file",
        )
        (key,) = keys
        if file.is_dataset(f"{key}/table"):
            rows = file.rows(f"{key}/table")
            index = rows["index"]
            for field in [name for name in rows.dtype.names if name != "index"]:
                columns += _unpickle_names(
                    file.attribute(f"{field}_kind", f"{key}/table")
                )
                blocks.append(rows[field].reshape(len(rows), -1))
        else:
            while file.is_dataset(block := f"{key}/block{len(blocks)}_values"):
                values = file.numbers(block)
                blocks.append(
                    values if file.attribute("transposed", block) else values.T
                )
                columns += _names_of_codes(file, block.replace("_values", "_items"))
            images = _names_of_codes(file, f"{key}/axis1")
            index = np.array(["/".join(filter(None, row)) for row in images], object)
            index = index if images else np.ravel(file.rows(f"{key}/axis1"))
    numbered = index.dtype.kind in "iuf"
    labels = (
        number_labels(index) if numbered else image_labels([*map(str, index.tolist())])
    )
    values = np.concatenate(blocks, axis=1).astype(np.float64)
    require(values.shape == (len(labels), len(columns)), f"{values.shape} values")
    return _of_columns(paths[0], columns, values, labels)


class NameUnpickler(pickle._Unpickler):
    """Reads lists and tuples of names: whatever a pickle asks to import is refused.

    It is pickle's own in Python: that in C makes room for as many objects as a damaged
    file says.
    """

    def find_class(self, module: str, name: str) -> Any:
        """Refuse what would be imported, and could be called."""
        raise pickle.UnpicklingError(
            f"asks for {module}.{name}, which is never executed here"
        )


def _unpickle_names(pickled: Any) -> Columns:
    """Return the names of columns, a list of tuples, that an attribute has pickled."""
    data = pickled.encode() if isinstance(pickled, str) else pickled
    return [tuple(map(str, name)) for name in NameUnpickler(io.BytesIO(data)).load()]


def _names_of_codes(file: TrackerFile, start: str) -> Columns:
    """Return the names that levels and codes stand for, one tuple each; a code of -1 is
    no name.
    """
    levels: list[list[str]] = []
    while file.is_dataset(place := f"{start}_level{len(levels)}"):
        names = [*file.texts(place), ""]
        codes = np.ravel(file.rows(f"{start}_label{len(levels)}"))
        levels.append([names[code] for code in codes.tolist()])
    return list(zip(*levels, strict=True))


COORDINATES = ("x", "y", "z", "likelihood")


def _of_columns(
    path: Path, columns: Columns, values: Floats, labels: Sequence[str]
) -> Poses:
    """Return the poses of rows (n, columns), each individual a pose of the frame.

    A landmark that only some individuals have is missing for the others. Columns of
    other coordinates are left out, with a note. Raises ValueError for columns that
    repeat or lack others.
    """
    sizes = {len(column) for column in columns}
    require(sizes in ({3}, {4}), "no columns of coordinates")
    named = sizes == {4}
    keys = [(column[1] if named else "", *column[-2:]) for column in columns]
    place = {key: number for number, key in enumerate(keys)}
    require(len(place) == len(keys), "a column twice; save the columns of one scorer")
    others = [
        *dict.fromkeys(printable(axis) for *_, axis in keys if axis not in COORDINATES)
    ]
    keys = [key for key in keys if key[-1] in COORDINATES]
    axes = [axis for axis in COORDINATES if any(axis == key[-1] for key in keys)]
    require(axes[:2] == ["x", "y"], f"no columns x and y ({abbreviate(others)})")
    lost = [
        f"{key[1]} {axis}"
        for key in keys
        for axis in axes
        if (*key[:2], axis) not in place
    ]
    require(not lost, f"no column {lost[:1]}")
    individuals, landmarks = (
        tuple(dict.fromkeys(key[at] for key in keys)) for at in (0, 1)
    )
    numbers = [
        [
            [place.get((individual, landmark, axis), -1) for axis in axes]
            for landmark in landmarks
        ]
        for individual in individuals
    ]
    # (n, columns and one of NaN) -> (n, individual, landmark, axis)
    points, confidence = (
        np.column_stack([values, np.full(len(values), np.nan)])[:, numbers],
        None,
    )
    if "likelihood" in axes:
        points, confidence = points[..., :-1], points[..., -1]
        points[confidence < 0] = (
            np.nan
        )  # what newer versions write for animals not found
    return of_frames(
        path,
        points,
        confidence,
        labels,
        landmark_names=landmarks,
        individuals=individuals if named else None,
        notes=(f"columns left out: {abbreviate(others)}",) if others else (),
    )

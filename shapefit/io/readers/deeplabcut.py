"""DeepLabCut: the columns of its tables, as CSV and as the HDF5 that pandas writes."""

from __future__ import annotations

import csv
import io
import pickle
from collections.abc import Mapping, Sequence
from pathlib import Path, PureWindowsPath
from typing import NoReturn

import numpy as np
from typing_extensions import TypedDict

from shapefit.arrays import MAX_EXACT, Floats, Integers, are_whole
from shapefit.errors import abbreviate, printable
from shapefit.io.csv_cells import read_numbers
from shapefit.io.formats import Head
from shapefit.io.readers.poses import (
    FormatError,
    Poses,
    library_reads,
    number_labels,
    place_images,
    poses_from_frames,
    require,
    video_name,
)
from shapefit.io.readers.text import decode, read_table, read_text
from shapefit.io.readers.trackers import TrackerFile

HEADER = ("scorer", "individuals", "bodyparts", "coords")

TableColumns = list[tuple[str, ...]]
"""(scorer, [individual,] body part, coordinate) of each column."""


class TableRows(TypedDict, total=False):
    """Fields of `poses_from_frames` that say what the rows are."""

    labels: Sequence[str]
    frames: Integers
    video: str | Sequence[str]
    unordered: bool


MANY = 10**9
"""Frames of a video for one that is labelled: any."""


def is_csv(head: Head) -> bool:
    """Whether a text begins with DeepLabCut's rows of names.

    A row can be cut off, where the head of the file ends.
    """
    lines = [decode(line) for line in head.lines[:3]]
    first, *others = row_names(lines)
    if first == "scorer" and len(lines[0]) > len("scorer"):
        return len(others) < 2 or "bodyparts" in others
    return first in ("bodyparts", "individuals") and "coords" in others


def read_deeplabcut_csv(paths: tuple[Path, ...]) -> Poses:
    """Read DeepLabCut's CSV: a row for each frame, columns by name.

    Lightning Pose writes it, too.

    Three lines of names (scorer, bodyparts, coords) come first, four with
    `individuals`. The first column is the number of the frame, or the path of an image,
    which may be split in three columns. Before it may stand a column of pandas that
    numbers the rows; cells may have semicolons or tabs between them, as Excel saves
    them.
    """
    path = paths[0]
    text = read_text(path)
    delimiter = _find_delimiter(text)
    if _has_row_numbers(text, delimiter):
        rows = text.split("\n")
        text = "\n".join(row.partition(delimiter)[2] for row in rows)
    levels = _read_name_rows(text, delimiter)
    columns = _columns_of_levels(levels)
    placed = [number for number, column in enumerate(columns) if number and column[-1]]
    first = text.split("\n", len(levels))[-1].partition(delimiter)[0].strip('" ')
    numbered = not read_numbers([first])[1].any()
    labels = ["/".join(column[1:]) for column in columns]
    table = read_table(
        path, text, labels, delimiter, after=len(levels), padded=not numbered
    )
    retained = [columns[number] for number in placed]
    if numbered:
        values = table.numbers([0, *placed])
        return _poses_of_columns(
            path, retained, values[:, 1:], _rows_by_frame(values[:, 0])
        )
    parts = table.texts(*range(min(placed, default=1)))
    images = ["/".join(filter(None, row)) for row in zip(*parts, strict=True)]
    return _poses_of_columns(
        path, retained, table.numbers(placed), _rows_by_image(path, images)
    )


def _read_name_rows(text: str, delimiter: str) -> dict[str, list[str]]:
    """Read the rows of column names at the beginning: first cell -> all cells."""
    first_lines = text.split("\n", len(HEADER))[: len(HEADER)]
    with library_reads("the lines of names have no end"):
        rows = [*csv.reader(first_lines, delimiter=delimiter)]
    levels: dict[str, list[str]] = {}
    for cells in rows:
        row = [cell.strip() for cell in cells] or [""]
        name = row[0]
        if name not in HEADER or name in levels:
            break
        levels[name] = row
    return levels


def _columns_of_levels(levels: Mapping[str, list[str]]) -> TableColumns:
    """Return (scorer, [individual,] landmark, coordinate) of each column of a table.

    levels: the lines of names at the beginning of the table, by what they name. The
    first column is that of the frames; scorers are left empty. Raises FormatError
    where lines are lacking, or have different numbers of cells.
    """
    needed = [name for name in HEADER[1:] if name != "individuals"]
    lacking = [name for name in needed if name not in levels]
    require(not lacking, f"there is no line {abbreviate(lacking)}")
    names = [levels[name] for name in HEADER[1:] if name in levels]
    require(
        len({*map(len, names)}) == 1,
        "the lines of names have different numbers of cells",
    )
    return [("", *column) for column in zip(*names, strict=True)]


def is_hdf5(head: Head) -> bool:
    """Whether an HDF5 file has a table that pandas wrote."""
    return any(name.endswith("@pandas_type") for name in head.hdf5)


def row_names(lines: Sequence[str]) -> list[str]:
    """Return the first cells of lines of a table, which name its header rows.

    A column of pandas before these does not count.
    """
    delimiter = _find_delimiter(lines[0])
    column = 1 if _has_row_numbers(lines[0], delimiter) else 0
    rows = [line.split(delimiter) for line in lines]
    return [row[column].strip(" \"'") if len(row) > column else "" for row in rows]


def _find_delimiter(text: str) -> str:
    """Return the most frequent of comma, semicolon and tab in the first line."""
    first = text.partition("\n")[0]
    return max((",", ";", "\t"), key=first.count)


def _has_row_numbers(text: str, delimiter: str) -> bool:
    """Whether a column of row numbers, as pandas writes it, precedes that of names."""
    cells = [cell.strip(' "') for cell in text.partition("\n")[0].split(delimiter, 2)]
    return len(cells) > 1 and cells[0] not in HEADER and cells[1] in HEADER


def read_hdf5(paths: tuple[Path, ...]) -> Poses:
    """Read DeepLabCut's HDF5, a table that pandas wrote, without pandas.

    *table* (predictions): KEY/table has an index and blocks of numbers, whose column
    names are pickled in an attribute.
    *fixed* (labels): KEY/block0_values, its names beside it as levels and codes.
    """
    columns: TableColumns = []
    blocks = []
    with TrackerFile(paths[0]) as file:
        keys = [name for name in file.names() if file.text("pandas_type", name)]
        require(
            len(keys) == 1,
            f"the tables {', '.join(keys)}; save one of them in its own file",
        )
        (key,) = keys
        if file.has_dataset(f"{key}/table"):
            rows = np.asarray(file.read_rows(f"{key}/table"))
            fields: tuple[str, ...] = rows.dtype.names or ()
            require("index" in fields, "a table without an index")
            index = rows["index"]
            for field in [name for name in fields if name != "index"]:
                columns += _unpickle_names(
                    file.attribute(f"{field}_kind", f"{key}/table")
                )
                blocks.append(rows[field].reshape(len(rows), -1))
        else:
            while file.has_dataset(block := f"{key}/block{len(blocks)}_values"):
                values = file.numbers(block)
                blocks.append(
                    values if file.attribute("transposed", block) else values.T
                )
                columns += _read_multi_index(file, block.replace("_values", "_items"))
            images = _read_multi_index(file, f"{key}/axis1")
            index = np.array(["/".join(filter(None, row)) for row in images], object)
            index = index if images else np.ravel(file.read_rows(f"{key}/axis1"))
    if index.dtype.kind in "iuf":
        table_rows = _rows_by_frame(np.asarray(index, np.float64))
    else:
        table_rows = _rows_by_image(paths[0], [*map(str, index.tolist())])
    require(blocks, "no columns of coordinates")
    alike = all(block.ndim == 2 and len(block) == len(index) for block in blocks)
    numeric = alike and all(block.dtype.kind in "biuf" for block in blocks)
    require(numeric, "blocks of other lengths than the index, or not of numbers")
    values = np.concatenate(blocks, axis=1).astype(np.float64)
    require(values.shape == (len(index), len(columns)), f"{values.shape} values")
    return _poses_of_columns(paths[0], columns, values, table_rows)


def _rows_by_frame(index: Floats) -> TableRows:
    """Return the labels and frames of rows whose index (n,) is a frame number.

    Raises FormatError for no whole number.
    """
    labels = number_labels(index)
    require(
        are_whole(index).all(), "a frame that is no whole number", "number the frames"
    )
    frames = index.astype(np.int64)
    return {"labels": labels, "frames": frames - frames.min(initial=MAX_EXACT)}


def _rows_by_image(path: Path, images: Sequence[str]) -> TableRows:
    """Return the labels, frames and videos of rows whose index is the path of an image.

    They are labelled frames of videos, in a folder each, whose names end in the number
    of the frame.
    """
    folders = [PureWindowsPath(image).parent.name for image in images]
    several = len({*folders}) > 1
    placed = place_images(path, images, folders if several else None, sparsest=MANY)
    return {
        "labels": placed.labels,
        "frames": np.array(placed.frames, np.int64),
        "video": placed.videos if several else video_name(path),
        "unordered": placed.unordered,
    }


class NameUnpickler(pickle._Unpickler):
    """An unpickler of lists and tuples of names, which refuses all imports.

    It is pickle's own in Python: that in C makes room for as many objects as a damaged
    file says.
    """

    def find_class(self, module: str, name: str) -> NoReturn:
        """Raise FormatError, as a pickle asks to import `name` and could call it."""
        raise FormatError(f"asks for {module}.{name}, which is never executed here")


def _unpickle_names(pickled: object) -> TableColumns:
    """Unpickle the names of columns, a list of tuples, from an attribute's value."""
    data = pickled.encode() if isinstance(pickled, str) else pickled
    if not isinstance(data, bytes):
        raise FormatError("the names of its columns are missing")
    with library_reads("the names of its columns are damaged"):
        names = NameUnpickler(io.BytesIO(data)).load()
    listed = isinstance(names, list) and all(isinstance(name, tuple) for name in names)
    require(listed, "the names of its columns are no list of names")
    return [tuple(map(str, name)) for name in names]


def _read_multi_index(file: TrackerFile, start: str) -> TableColumns:
    """Read pandas' MultiIndex from datasets of levels and codes, as tuples of names.

    start: what their names begin with; [] where there are none. A code of -1 is "".
    Raises FormatError for codes that have no name.
    """
    levels: list[list[str]] = []
    while file.has_dataset(place := f"{start}_level{len(levels)}"):
        names = [*file.texts(place), ""]
        codes = np.ravel(file.read_rows(f"{start}_label{len(levels)}"))
        known = codes.dtype.kind in "iu" and (codes < len(names) - 1).all()
        require(known and (codes >= -1).all(), f"{place} lacks names of columns")
        levels.append([names[code] for code in codes.tolist()])
    same = len({*map(len, levels)}) <= 1
    require(same, f"the levels of {start} have different lengths")
    return list(zip(*levels, strict=True))


COORDINATES = ("x", "y", "z", "likelihood")


def _poses_of_columns(
    path: Path, columns: TableColumns, values: Floats, rows: TableRows
) -> Poses:
    """Make Poses of a table's values (n, columns): one for each row and individual.

    A landmark that only some individuals have is missing for the others. Columns of
    other coordinates are left out, with a note. Raises FormatError for columns that
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
    return poses_from_frames(
        path,
        points,
        confidence,
        **rows,
        landmark_names=landmarks,
        individuals=individuals if named else None,
        notes=(f"columns left out: {abbreviate(others)}",) if others else (),
    )

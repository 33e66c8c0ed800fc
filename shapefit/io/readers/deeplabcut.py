"""DeepLabCut: the columns of its tables, as CSV and as the HDF5 that pandas writes."""

from __future__ import annotations

import io
import pickle
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats
from shapefit.errors import abbreviate, input_error, listed, printable
from shapefit.io.readers.poses import (
    FormatError,
    Poses,
    image_labels,
    number_labels,
    of_frames,
    parsing,
    require,
)
from shapefit.io.readers.text import Table, read_text, split_rows
from shapefit.io.readers.trackers import TrackerFile, as_text, open_tracker
from shapefit.io.tidy_table import read_numbers

HEADER = ("scorer", "individuals", "bodyparts", "coords")
SAVE = "save the table again with DeepLabCut"

Columns = list[tuple[str, ...]]


def read_csv(paths: tuple[Path, ...]) -> Poses:
    """Read DeepLabCut CSV, which Lightning Pose writes, too: a row for each frame, columns by name.

    Three lines of names (scorer, bodyparts, coords) come first, four with `individuals`. The first
    column is the number of the frame, or the path of an image, which may be split in three columns.
    """
    path = paths[0]
    table = Table(path, split_rows(path, read_text(path)))
    header: dict[str, list[str]] = {}
    for row in range(min(len(table.rows), len(HEADER))):
        cells = table.cells(row)
        if cells[0] not in HEADER or cells[0] in header:
            break
        header[cells[0]] = cells
    with parsing(f"{path}:1", SAVE):
        levels = [header[name] for name in HEADER[1:] if name != "individuals" or name in header]
        sizes = sorted({*map(len, levels)})
        require(len(sizes) == 1, f"the lines of names have {' and '.join(map(str, sizes))} cells")
    named = [column for column, name in enumerate(header["coords"]) if column and name]
    columns = [("", *(level[column] for level in levels)) for column in named]
    table.names = ["/".join(names) for names in zip(*levels, strict=True)]
    table.rows = table.rows[len(header) :]
    first = table.cells(0) if table.rows else ["0"]
    numbered = not read_numbers(first[:1])[1].any()
    if not numbered and "." not in first[0] and not any(first[1:]):
        table.rows = table.rows[1:]  # the name of the index
    table.padded = not numbered
    if numbered:
        values, _, lines = table.read([0, *named])
        if (wrong := ~np.isfinite(values[:, 0])).any():
            problem = "does not say its frame, and others are numbers"
            raise input_error(f"{path}:{lines[int(wrong.argmax())]}", problem, "number the frames")
        labels, values = number_labels(values[:, 0]), values[:, 1:]
    else:
        values, parts, _ = table.read(named, range(named[0] if named else 1))
        labels = image_labels(["/".join(filter(None, row)) for row in zip(*parts, strict=True)])
    with parsing(f"{path}:1", SAVE):
        return _of_columns(path, columns, values, labels)


KEYS = ("df_with_missing", "tracks")
"""Groups that DeepLabCut writes; another one is read where it is the only one."""


def read_hdf5(paths: tuple[Path, ...]) -> Poses:
    """Read a table that pandas wrote, in one of its two layouts, without pandas.

    *table* (predictions): KEY/table has rows of an index and blocks of numbers, whose column names
    are pickled in an attribute. *fixed* (labels): KEY/block0_values has the numbers, and the column
    names stand beside it as levels and codes.
    """
    path = paths[0]
    blocks: list[tuple[Columns, NDArray[Any]]] = []
    with open_tracker(path) as file:
        tables = [n for n in file.root if isinstance(n, str) and file.text("pandas_type", n)]
        tables = [name for name in KEYS if name in tables] or tables
        if len(tables) != 1:
            texts = listed(map(printable, tables), "and") if tables else "none"
            fix = "save one of them in a file of its own"
            raise input_error(path, f"holds the tables {texts} of pandas", fix)
        key = tables[0]
        if file.is_dataset(f"{key}/table"):
            rows = file.table(f"{key}/table")
            index = rows["index"]
            for field in [name for name in rows.dtype.names if name != "index"]:
                names = _unpickle_names(file.attribute(f"{field}_kind", f"{key}/table"))
                blocks.append((names, rows[field].reshape(len(rows), -1)))
        else:
            while file.is_dataset(block := f"{key}/block{len(blocks)}_values"):
                values = file.table(block)
                values = values if file.attribute("transposed", block) else values.T
                blocks.append((_levels(file, block.replace("_values", "_items")), values))
            index = _levels(file, f"{key}/axis1") or np.ravel(file.table(f"{key}/axis1"))
        for names, values in blocks:
            numeric = values.dtype.kind in "biuf"
            require(numeric, "holds pickled values, not numbers; save it as CSV")
            fits = values.shape[1:] == (len(names),)
            require(fits, f"has the shape {values.shape} for {len(names)} columns")
        if isinstance(index, list):
            labels = image_labels(["/".join(filter(None, row)) for row in index])
        elif index.dtype.kind in "iuf":
            labels = number_labels(index)
        else:
            labels = image_labels([*map(as_text, index.tolist())])
        file.last = key
        values = np.column_stack([values for _, values in blocks]).astype(np.float64)
        require(len(labels) == len(values), f"names {len(labels)} of {len(values)} frames")
        return _of_columns(
            path, [column for names, _ in blocks for column in names], values, labels
        )


class NameUnpickler(pickle._Unpickler):
    """Reads lists and tuples of names: whatever a pickle asks to import is refused.

    It is pickle's own in Python: that in C makes room for as many objects as a damaged file says.
    """

    def find_class(self, module: str, name: str) -> Any:
        """Refuse what would be imported, and could be called."""
        raise pickle.UnpicklingError(f"asks for {module}.{name}, which is never executed here")


def _unpickle_names(pickled: Any) -> Columns:
    """Return the names of columns, a list of tuples, that an attribute has pickled."""
    try:
        data = pickled.encode() if isinstance(pickled, str) else pickled
        names = NameUnpickler(io.BytesIO(data)).load()
        require(isinstance(names, list), "not a list")
        return [tuple(map(str, name)) for name in names]
    except Exception as error:  # damage raises whatever its opcodes lead to
        raise FormatError(f"holds no list of names ({printable(str(error))})") from error


def _levels(file: TrackerFile, start: str) -> Columns:
    """Return the names that levels and codes stand for, one tuple each; a code of -1 is no name."""
    levels: list[list[str]] = []
    while file.is_dataset(place := f"{start}_level{len(levels)}"):
        names = [*map(as_text, np.ravel(file.table(place)).tolist()), ""]
        codes = np.ravel(file.table(f"{start}_label{len(levels)}"))
        require(codes.dtype.kind in "iu" and codes.min(initial=-1) >= -1, "are no codes")
        levels.append([names[code] for code in codes.tolist()])
    return list(zip(*levels, strict=True))


COORDINATES = ("x", "y", "z", "likelihood")


def _of_columns(path: Path, columns: Columns, values: Floats, labels: Sequence[str]) -> Poses:
    """Return the poses of rows (n, columns), each individual a pose of the frame.

    Columns are named (scorer, [individual,] body part, coordinate). Individuals and landmarks stand
    in order of appearance; a landmark that only some individuals have is missing for the others.
    Columns of other coordinates are left out, with a note. Raises FormatError for columns that are
    there twice, and for those of a landmark without the others.
    """
    depths = {len(column) for column in columns}
    require(depths in ({3}, {4}), "has no columns of coordinates, or of different depths")
    keys = [(column[1] if len(column) == 4 else "", *column[-2:]) for column in columns]
    place = {key: number for number, key in enumerate(keys)}
    require(len(place) == len(keys), "has a column twice; save the columns of one scorer")
    others = [*dict.fromkeys(printable(axis) for *_, axis in keys if axis not in COORDINATES)]
    keys = [key for key in keys if key[-1] in COORDINATES]
    axes = [axis for axis in COORDINATES if any(axis == key[-1] for key in keys)]
    require(axes[:2] == ["x", "y"], f"has no columns x and y ({abbreviate(others)})")
    lost = [(*key[:2], axis) for key in keys for axis in axes if (*key[:2], axis) not in place]
    require(not lost, f"has no column {' '.join(filter(None, (lost or [()])[0]))}")
    individuals, landmarks = (tuple(dict.fromkeys(key[at] for key in keys)) for at in (0, 1))
    # (n, columns, NaN) -> (n, individual, landmark, axis)
    cells = np.column_stack([values, np.full(len(values), np.nan)])[
        :,
        [[[place.get((i, p, axis), -1) for axis in axes] for p in landmarks] for i in individuals],
    ]
    points, confidence = cells, None
    if "likelihood" in axes:
        points, confidence = cells[..., :-1], cells[..., -1]
        points[confidence < 0] = np.nan  # what newer versions write for animals not found
    return of_frames(
        path,
        points,
        confidence,
        labels,
        landmark_names=landmarks,
        individuals=individuals if depths == {4} else None,
        notes=(f"columns left out: {abbreviate(others)}",) if others else (),
    )

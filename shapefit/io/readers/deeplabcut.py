"""DeepLabCut: the columns of its tables, as CSV and as the HDF5 that pandas writes."""

from __future__ import annotations

import io
import pickle
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats
from shapefit.errors import InputError, abbreviate, input_error, listed, printable
from shapefit.io.inputs import is_stream
from shapefit.io.readers.poses import (
    Edges,
    Poses,
    image_labels,
    number_labels,
    of_frames,
    parsing,
    read_yaml,
    require,
)
from shapefit.io.readers.text_table import Table
from shapefit.io.readers.trackers import TrackerFile, text
from shapefit.io.tidy_table import read_numbers

COORDINATES = ("x", "y", "z", "likelihood")

SAVE = "save the table again with DeepLabCut"
SAVE_CSV = "save it as CSV"

Columns = list[tuple[str, ...]]


def of_columns(
    path: Path, place: str, columns: Columns, values: Floats, labels: Sequence[str]
) -> Poses:
    """Return the poses of rows (n, columns), each individual a pose of the frame.

    Columns are named (scorer, [individual,] body part, coordinate), in the file at `place`.
    Individuals and landmarks stand in order of appearance; a landmark that only some individuals
    have is missing for the others. Columns of other coordinates are left out, with a note. Raises
    InputError for columns that are there twice, and for those of a landmark without the others.
    """
    depths = {len(column) for column in columns}
    number: dict[tuple[str, str, str], int] = {}
    with parsing(place, f"{SAVE}, with the columns of one scorer, x and y for each body part"):
        require(columns, "has no columns of coordinates")
        require(depths in ({3}, {4}), f"its columns have {abbreviate([*map(str, depths)])} names")
        for column, names in enumerate(columns):
            key = (names[1] if len(names) == 4 else "", names[-2], names[-1])
            require(key not in number, f"{key[2]} of {' '.join(key[:2]).strip()} is there twice")
            number[key] = column
        others = dict.fromkeys(printable(c[-1]) for c in columns if c[-1] not in COORDINATES)
        points_of = dict.fromkeys(key[:2] for key in number if key[2] in COORDINATES)
        individuals, landmarks = (
            tuple(dict.fromkeys(key[at] for key in points_of)) for at in (0, 1)
        )
        axes = [axis for axis in COORDINATES if axis in {key[2] for key in number}]
        require(axes[:2] == ["x", "y"], f"has no columns x and y ({abbreviate([*others])})")
        for who, landmark in points_of:
            lost = [axis for axis in axes if (who, landmark, axis) not in number]
            require(not lost, f"{landmark} has no column {''.join(lost[:1])}")
    columns_of = [
        [[number.get((who, name, axis), -1) for axis in axes] for name in landmarks]
        for who in individuals
    ]
    padded = np.column_stack([values, np.full(len(values), np.nan)])
    points: Floats = padded[:, np.array(columns_of)]  # (n, individuals, landmarks, axes)
    confidence = None
    if "likelihood" in axes:
        points, confidence = points[..., :-1], points[..., -1]
        points[confidence < 0] = np.nan  # what newer versions write for animals not found
    return of_frames(
        path,
        points,
        confidence,
        labels,
        landmark_names=landmarks,
        individuals=individuals if depths == {4} else None,
        notes=(f"columns left out: {abbreviate([*others])}",) if others else (),
        edges=skeleton_edges(path, landmarks),
    )


HEADER = ("scorer", "individuals", "bodyparts", "coords")


def read_csv(paths: tuple[Path, ...]) -> Poses:
    """Read DeepLabCut CSV, which Lightning Pose writes, too: a row for each frame, columns by name.

    Three lines of names (scorer, bodyparts, coords) come first, four with `individuals`. The first
    column is the number of the frame, or the path of an image, which may be split in three columns.
    """
    path = paths[0]
    table = Table(path)
    rows = table.first_rows(len(HEADER) + 1)
    header: dict[str, list[str]] = {}
    for _, row in rows:
        if (name := row[0].strip()) not in HEADER or name in header:
            break
        header[name] = [cell.strip() for cell in row]
    with parsing(f"{path}:1", SAVE):
        for name in ("bodyparts", "coords"):
            require(name in header, f"there is no line {name!r}")
        levels = [header[name] for name in HEADER[1:] if name in header]
        sizes = sorted({*map(len, levels)})
        require(len(sizes) == 1, f"the lines of names have {' and '.join(map(str, sizes))} cells")
    named = [column for column, name in enumerate(header["coords"]) if column and name]
    columns = [("", *(level[column] for level in levels)) for column in named]
    first = next((row for _, row in rows[len(header) :]), ["0"])
    numbered = not read_numbers(first[:1])[1].any()
    index_named = not numbered and "." not in first[0] and not any(first[1:])
    lines = rows[len(header) + index_named - 1][0]
    table.skip(lines, ["/".join(each) for each in zip(*levels, strict=True)])
    table.padded = not numbered
    if numbered:
        values, _, places = table.read([0, *named])
        if (wrong := ~np.isfinite(values[:, 0])).any():
            found = "does not say its frame, and others are numbers"
            raise input_error(f"{path}:{places[wrong][0]}", found, "number the frames")
        labels, values = number_labels(str(path), values[:, 0]), values[:, 1:]
    else:
        values, parts, _ = table.read(named, range(named[0] if named else 1))
        labels = image_labels(["/".join(filter(None, row)) for row in zip(*parts, strict=True)])
    return of_columns(path, f"{path}:1", columns, values, labels)


CONFIG = "config.yaml"
FOLDERS_ABOVE = 2
"""Predictions lie in a folder of the project, labels in a folder of that."""


def skeleton_edges(path: Path, names: Sequence[str]) -> Edges:
    """Return the edges of `skeleton` between these landmarks, by place in `names`.

    It lists pairs of names, or chains of them. A pair with a name that the table has not is left
    out; a file that is no YAML, or not of DeepLabCut, gives none.
    """
    if is_stream(path):
        return ()
    try:
        _, content = read_yaml(path.parent, CONFIG, FOLDERS_ABOVE) or (None, None)
    except (InputError, OSError):
        return ()
    chains = content.get("skeleton") if isinstance(content, dict) else None
    chains = chains if isinstance(chains, list) else []
    pairs = [p for chain in chains if isinstance(chain, list) for p in pairwise(map(str, chain))]
    place = {name: number for number, name in enumerate(names)}
    pairs = [(a, b) for a, b in pairs if a != b and {a, b} <= place.keys()]
    return tuple(dict.fromkeys((place[a], place[b]) for a, b in pairs))


class NameUnpickler(pickle._Unpickler):
    """Reads lists and tuples of names: whatever a pickle asks to import is refused.

    It is pickle's own in Python: that in C makes room for as many objects as a damaged file says.
    """

    def find_class(self, module: str, name: str) -> Any:
        """Refuse what would be imported, and could be called."""
        raise pickle.UnpicklingError(f"asks for {module}.{name}, which is never executed here")


def unpickle_names(place: str, pickled: Any) -> Columns:
    """Return the names of columns, a list of tuples, that an attribute at `place` has pickled."""
    pickled = pickled.encode() if isinstance(pickled, str) else pickled
    try:
        names = NameUnpickler(io.BytesIO(pickled)).load()
        require(isinstance(names, list), "not a list")
        return [tuple(map(str, name)) for name in names]
    except Exception as error:  # damage raises whatever its opcodes lead to
        found = f"holds no list of names ({printable(str(error))})"
        raise input_error(place, found, SAVE_CSV) from error


KEYS = ("df_with_missing", "tracks")
"""Groups that DeepLabCut writes; another one is read where it is the only one."""


def read_hdf5(paths: tuple[Path, ...]) -> Poses:
    """Read a table that pandas wrote, in one of its two layouts, without pandas.

    *table* (predictions): KEY/table has rows of an index and blocks of numbers, whose column names
    are pickled in an attribute. *fixed* (labels): KEY/block0_values has the numbers, and the column
    names stand beside it as levels and codes.
    """
    path = paths[0]
    with TrackerFile(path) as file:
        kinds = {name: file.attribute("pandas_type", name) for name in file.groups("/")}
        tables = [name for name, kind in kinds.items() if kind is not None]
        tables = [name for name in KEYS if name in tables] or tables
        if len(tables) != 1:
            stored = listed(map(printable, tables), "and") if tables else "none"
            fix = "save one of them in a file of its own"
            raise input_error(path, f"holds the tables {stored} of pandas", fix)
        key = tables[0]
        table = file.is_dataset(f"{key}/table")
        blocks, index = _read_table(file, f"{key}/table") if table else _read_fixed(file, key)
        columns = [column for names, _ in blocks for column in names]
        values = np.column_stack([_numbers(values, len(names)) for names, values in blocks])
        require(index.ndim == 1, "its index is no number")
        if index.dtype.kind in "iuf":
            labels = number_labels(file.place(key), index)
        else:
            labels = image_labels([*map(text, index.tolist())])
        require(len(labels) == len(values), f"names {len(labels)} of {len(values)} frames")
    return of_columns(path, file.place(key), columns, values, labels)


Blocks = list[tuple[Columns, NDArray[Any]]]
"""Names of columns, and their values (n, columns)."""


def _read_table(file: TrackerFile, table: str) -> tuple[Blocks, NDArray[Any]]:
    """Return the blocks of the table layout, and its index (n,)."""
    rows = file.table(table, "index")
    blocks = []
    for field in rows.dtype.names:
        if field != "index":
            place = f"{file.place(table)}@{printable(field)}_kind"
            names = unpickle_names(place, file.attribute(f"{field}_kind", table))
            blocks.append((names, rows[field]))
    return blocks, rows["index"]


def _read_fixed(file: TrackerFile, key: str) -> tuple[Blocks, NDArray[Any]]:
    """Return the blocks of the fixed layout, and its index (n,)."""
    blocks: Blocks = []
    while file.is_dataset(dataset := f"{key}/block{len(blocks)}_values"):
        names = _levels(file, f"{key}/block{len(blocks)}_items")
        values = file.rows(dataset)
        blocks.append((names, values if file.attribute("transposed", dataset) else values.T))
    require(blocks, "has no columns")
    axis = f"{key}/axis1"
    if not file.is_dataset(f"{axis}_level0"):
        return blocks, np.ravel(file.rows(axis))
    paths = ["/".join(filter(None, row)) for row in _levels(file, axis)]
    return blocks, np.array(paths, object)


def _numbers(values: NDArray[Any], columns: int) -> Floats:
    """Return the values (n, columns) of a block as numbers."""
    values = values[:, None] if values.ndim == 1 else values
    require(values.dtype.kind in "biuf", "holds pickled values, not numbers; save it as CSV")
    require(values.shape[1:] == (columns,), f"has the shape {values.shape} for {columns} columns")
    return np.asarray(values, np.float64)


def _levels(file: TrackerFile, start: str) -> Columns:
    """Return the names that levels and codes stand for, one tuple each; a code of -1 is no name."""
    levels: list[list[str]] = []
    while file.is_dataset(place := f"{start}_level{len(levels)}"):
        names = [*map(text, np.ravel(file.rows(place)).tolist()), ""]
        codes = np.ravel(file.rows(f"{start}_label{len(levels)}"))
        proper = codes.dtype.kind in "iu" and ((codes >= -1) & (codes < len(names) - 1)).all()
        require(proper, "are no codes")
        levels.append([names[code] for code in codes.tolist()])
    return list(zip(*levels, strict=True))

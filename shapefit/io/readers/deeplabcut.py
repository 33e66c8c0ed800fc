"""DeepLabCut: the columns of its tables, as CSV and as the HDF5 that pandas writes."""

from __future__ import annotations

import pickle
import pickletools
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

Columns = list[tuple[str, ...]]
Blocks = list[tuple[Columns, NDArray[Any]]]
"""Names of columns, and their numbers (n, columns)."""


def of_columns(
    path: Path, place: str, columns: Columns, values: Floats, labels: Sequence[str]
) -> Poses:
    """Return the recording of rows (n, columns), each individual an instance.

    Columns are named (scorer, [individual,] body part, coordinate), in the file at `place`.
    Individuals and landmarks stand in order of appearance; a landmark that only some individuals
    have is missing for the others. Columns of other coordinates are left out, with a note. Raises
    InputError for columns that are there twice, and for those of a landmark without the others.
    """
    number: dict[tuple[str, str, str], int] = {}
    others: dict[str, None] = {}
    depths = {len(column) for column in columns}
    with parsing(place, f"{SAVE}, with the columns of one scorer, x and y for each body part"):
        require(columns, "has no columns of coordinates")
        require(depths in ({3}, {4}), f"its columns have {abbreviate([*map(str, depths)])} names")
        for place_in_row, column in enumerate(columns):
            key = (column[1] if len(column) == 4 else "", column[-2], column[-1])
            if key[2] not in COORDINATES:
                others.setdefault(printable(key[2]))
                continue
            require(key not in number, f"{key[2]} of {' '.join(key[:2]).strip()} is there twice")
            number[key] = place_in_row
        individuals, landmarks, present = (
            tuple(dict.fromkeys(key[level] for key in number)) for level in range(3)
        )
        axes = [axis for axis in COORDINATES[:3] if axis in present]
        require(axes[:2] == ["x", "y"], f"has no columns x and y ({abbreviate([*others])})")
        wanted = [axis for axis in COORDINATES if axis in present]
        for who, landmark in {key[:2] for key in number}:
            lost = [axis for axis in wanted if (who, landmark, axis) not in number]
            require(not lost, f"{landmark} has no column {''.join(lost[:1])}")
    shape = (len(values), len(individuals), len(landmarks))
    found = {axis: np.full(shape, np.nan) for axis in present}
    for (who, landmark, axis), column_in_row in number.items():
        own = found[axis][:, individuals.index(who)]
        own[:, landmarks.index(landmark)] = values[:, column_in_row]
    points, confidence = np.stack([found[axis] for axis in axes], axis=-1), found.get("likelihood")
    if confidence is not None:
        points[confidence < 0] = np.nan  # what newer versions write for animals not found
    return of_frames(
        path,
        points,
        confidence,
        labels,
        landmark_names=landmarks,
        individuals=individuals if depths == {4} else None,
        notes=(f"columns left out: {abbreviate(list(others))}",) if others else (),
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
    for name in ("bodyparts", "coords"):
        if name not in header:
            raise input_error(f"{path}:1", f"there is no line {name!r}", SAVE)
    coords = header["coords"]
    levels = [header[name] for name in HEADER[1:] if name in header]
    with parsing(f"{path}:1", "give each column a name in each line"):
        sizes = sorted({*map(len, levels)})
        require(len(sizes) == 1, f"the lines of names have {' and '.join(map(str, sizes))} cells")
    named = [column for column in range(1, len(coords)) if coords[column]]
    scorers = [*header.get("scorer", []), *[""] * len(coords)]
    columns = [(scorers[at], *(level[at] for level in levels)) for at in named]
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


FILE = "config.yaml"
FOLDERS_ABOVE = 2
"""Predictions lie in a folder of the project, labels in a folder of that."""


def skeleton_edges(path: Path, names: Sequence[str]) -> Edges:
    """Return the edges of `skeleton` between these landmarks, by place in `names`.

    It lists pairs of names, or chains of them. A pair with a name that the table has not is left
    out; a file that is no YAML, or not of DeepLabCut, says nothing.
    """
    if is_stream(path):
        return ()
    try:
        _, found = read_yaml(path.parent, FILE, FOLDERS_ABOVE) or (None, None)
    except (InputError, OSError):
        return ()
    chains = found.get("skeleton") if isinstance(found, dict) else None
    place = {name: number for number, name in enumerate(names)}
    pairs = [
        (place.get(a, -1), place.get(b, -1))
        for chain in (chains if isinstance(chains, list) else ())
        if isinstance(chain, list)
        for a, b in pairwise(map(str, chain))
    ]
    return tuple(dict.fromkeys((a, b) for a, b in pairs if a != b and min(a, b) >= 0))


ALLOWED = frozenset(
    ("MARK", "LIST", "TUPLE", "INT", "LONG", "UNICODE", "PUT", "GET", "APPEND", "STOP")
)
"""Opcodes of lists and tuples of names and numbers in protocol 0, which can execute nothing."""

FIX = "save it as CSV"


def names_of(place: str, pickled: Any) -> Columns:
    """Return the list of names of columns that an attribute at `place` holds as a pickle.

    Raises InputError for what is not such a list, naming the opcode where there is another.
    """
    pickled = pickled.encode() if isinstance(pickled, str) else pickled
    try:
        with parsing(place, FIX):
            require(isinstance(pickled, bytes), "holds no list of names")
            for code, argument, _ in pickletools.genops(pickled):
                known = code.name in ALLOWED
                require(known, f"holds the opcode {code.name}, which is not read here")
                if code.name == "PUT":  # pickle would make room
                    few = int(argument or 0) <= len(pickled)
                    require(few, f"it puts {argument} names aside")
            names = pickle.loads(pickled)
            whole = isinstance(names, list) and all(isinstance(one, tuple) for one in names)
            require(whole, "holds no list of names")
            return [tuple(map(str, name)) for name in names]
    except (pickle.UnpicklingError, EOFError) as error:
        raise input_error(place, f"holds a list that cannot be read ({error})", FIX) from error


KEYS = ("df_with_missing", "tracks")
"""Groups that DeepLabCut writes; another one is read where it is the only one."""

TABLE, FIXED = "frame_table", "frame"


def read_hdf5(paths: tuple[Path, ...]) -> Poses:
    """Read a table that pandas wrote, in one of its two layouts, without pandas.

    *table* (predictions): KEY/table has rows of an index and blocks of numbers, whose column names
    are pickled in an attribute. *fixed* (labels): KEY/block0_values has the numbers, and the column
    names stand beside it as levels and codes.
    """
    path = paths[0]
    with TrackerFile(path) as file:
        key = _key(file)
        kind = text(file.attribute("pandas_type", key) or "")
        if kind not in (TABLE, FIXED):
            raise file.fault(key, f"is a {printable(kind)} of pandas, not a table of frames", FIX)
        blocks, labels = (_read_table if kind == TABLE else _read_fixed)(file, key)
        columns = [column for own, _ in blocks for column in own]
        values = np.concatenate([_numbers(block, len(own)) for own, block in blocks], axis=1)
    return of_columns(path, file.place(key), columns, values, labels)


def _key(file: TrackerFile) -> str:
    """Return the group of the table."""
    with file.damage():
        nodes = {name: file.root.get(name) for name in file.root}
        found = [n for n, one in nodes.items() if one is not None and "pandas_type" in one.attrs]
    known = [key for key in KEYS if key in found] or found
    if len(known) != 1:
        tables = listed(map(printable, known), "and") if known else "none"
        fix = "save one of them in a file of its own"
        raise input_error(file.path, f"holds the tables {tables} of pandas", fix)
    return known[0]


def _numbers(values: Any, columns: int) -> Floats:
    """Return a block (n, columns) as numbers."""
    values = values[:, None] if values.ndim == 1 else values
    require(values.dtype.kind in "biuf", "holds pickled values, not numbers; save it as CSV")
    require(values.shape[1:] == (columns,), f"has the shape {values.shape} for {columns} columns")
    return np.asarray(values, np.float64)


def _labels(file: TrackerFile, name: str, values: NDArray[Any], *, texts: bool) -> list[str]:
    """Return what the frames are called that an index numbers or names."""
    if texts:
        return image_labels([text(value) for value in values.tolist()])
    require(values.dtype.kind in "iuf" and values.ndim == 1, "its index is no number")
    return number_labels(file.place(name), values)


def _read_table(file: TrackerFile, key: str) -> tuple[Blocks, list[str]]:
    """Return the blocks of the table layout, and labels of its frames."""
    table = f"{key}/table"
    rows = file.table(table, "index")
    blocks = [
        (
            names_of(
                f"{file.place(table)}@{printable(field)}_kind",
                file.attribute(f"{field}_kind", table),
            ),
            rows[field],
        )
        for field in rows.dtype.names
        if field != "index"
    ]
    texts = text(file.attribute("index_kind", table) or "").startswith("string")
    return blocks, _labels(file, table, rows["index"], texts=texts)


def _read_fixed(file: TrackerFile, key: str) -> tuple[Blocks, list[str]]:
    """Return the same of the fixed layout, whose columns are levels and codes."""
    blocks: Blocks = []
    count = file.attribute("nblocks", key)
    for number in range(count if isinstance(count, int) and 0 <= count < 100 else 1):
        own = _levels(file, f"{key}/block{number}_items")
        dataset = f"{key}/block{number}_values"
        values = file.rows(dataset)
        blocks.append((own, values if file.attribute("transposed", dataset) else values.T))
    axis = f"{key}/axis0"
    if file.is_dataset(f"{axis}_level0"):
        columns = sorted(column for own, _ in blocks for column in own)
        require(sorted(_levels(file, axis)) == columns, "names other columns than its blocks")
    axis = f"{key}/axis1"
    if text(file.attribute("axis1_variety", key) or "") == "multi":
        labels = image_labels(["/".join(filter(None, row)) for row in _levels(file, axis)])
    else:
        values = np.ravel(file.rows(axis))
        labels = _labels(file, axis, values, texts=values.dtype.kind not in "iuf")
    rows = len(blocks[0][1])
    require(len(labels) == rows, f"names {len(labels)} frames, and there are {rows}")
    return blocks, labels


def _levels(file: TrackerFile, start: str) -> Columns:
    """Return the names that levels and codes stand for, one tuple each."""
    levels: list[list[str]] = []
    while file.is_dataset(place := f"{start}_level{len(levels)}"):
        known = [*map(text, np.ravel(file.rows(place)).tolist()), ""]
        codes = np.ravel(file.rows(f"{start}_label{len(levels)}"))
        require(codes.dtype.kind in "iu" and (codes >= -1).all(), "are no codes")
        require((codes < len(known) - 1).all(), "are no codes")
        levels.append([known[code] for code in codes.tolist()])
    require(levels, f"has no names for the columns of {start}")
    return list(zip(*levels, strict=True))

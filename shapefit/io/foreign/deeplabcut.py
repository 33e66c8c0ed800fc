"""DeepLabCut: the columns of its tables, as CSV and as the HDF5 that pandas writes."""

from __future__ import annotations

import pickle
import pickletools
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats
from shapefit.errors import InputError, abbreviate, input_error, listed, printable
from shapefit.io.foreign.recording import (
    Edges,
    Recording,
    image_labels,
    number_labels,
    read_yaml,
)
from shapefit.io.foreign.text_table import Table
from shapefit.io.foreign.trackers import TrackerFile, text
from shapefit.io.hdf5_file import DAMAGED
from shapefit.io.inputs import is_stream
from shapefit.io.tidy_table import read_numbers
from shapefit.stores import UrlPath

COORDINATES = ("x", "y", "z", "likelihood")

SAVE = "save the table again with DeepLabCut"


@dataclass(frozen=True)
class Layout:
    """Where the numbers of a row stand.

    individuals and landmarks are names; points (i, p, d) and likelihood (i, p) are columns of a
    row that has a NaN appended, which is what is missing points at; notes are about columns that
    are left out.
    """

    individuals: tuple[str, ...]
    landmarks: tuple[str, ...]
    points: NDArray[np.intp]
    likelihood: NDArray[np.intp] | None
    notes: tuple[str, ...] = ()

    def recording(self, path: Path, values: Floats, labels: Sequence[str]) -> Recording:
        """Return the recording of rows (n, columns), each individual an instance."""
        padded = np.column_stack([values, np.full(len(values), np.nan)])
        points = padded[:, self.points]
        confidence = None if self.likelihood is None else padded[:, self.likelihood]
        if confidence is not None:
            points[confidence < 0] = np.nan  # what newer versions write for animals not found
        return Recording.of_frames(
            path,
            points,
            confidence,
            labels,
            landmark_names=self.landmarks,
            individual_names=self.individuals,
            notes=self.notes,
            edges=skeleton_edges(path, self.landmarks),
        )


def arrange(place: str, columns: Sequence[tuple[str, ...]]) -> Layout:
    """Sort columns, named (scorer, [individual,] body part, coordinate), each after `place`.

    Individuals and landmarks stand in order of appearance; a column that is there for some of
    them only is missing for the others. Columns of other coordinates are left out, with a note.
    Raises InputError for columns that are there twice, and for coordinates without the others.
    """
    if not columns:
        raise input_error(place, "has no columns of coordinates", SAVE)
    depth = len(columns[0])
    if depth not in (3, 4) or any(len(column) != depth for column in columns):
        found = f"its columns have {depth} names each"
        raise input_error(place, found, f"{SAVE}: scorer, (individual,) body part, coordinate")
    number: dict[tuple[str, str, str], int] = {}
    others: dict[str, None] = {}
    for place_in_row, column in enumerate(columns):
        key = (column[1] if depth == 4 else "", column[-2], column[-1])
        if key[2] not in COORDINATES:
            others.setdefault(printable(key[2]))
            continue
        if key in number:
            scorers = abbreviate(sorted({printable(other[0]) for other in columns}))
            found = f"{key[2]} of {printable(' '.join(key[:2]).strip())} is there twice"
            raise input_error(place, found, f"keep the columns of one scorer (here {scorers})")
        number[key] = place_in_row
    individuals = tuple(dict.fromkeys(key[0] for key in number))
    landmarks = tuple(dict.fromkeys(key[1] for key in number))
    present = {key[2] for key in number}
    axes = [axis for axis in COORDINATES[:3] if axis in present]
    if axes[:2] != ["x", "y"]:
        have = f" ({abbreviate(list(others))})" if others else ""
        raise input_error(place, f"has no columns x and y{have}", SAVE)
    for who, landmark in {key[:2] for key in number}:
        if lost := [axis for axis in axes if (who, landmark, axis) not in number]:
            found = f"{printable(landmark)} has no column {lost[0]}"
            raise input_error(place, found, "add it, or remove the landmark")
    missing = len(columns)

    def find(axis: str) -> NDArray[np.intp]:
        return np.array(
            [[number.get((who, name, axis), missing) for name in landmarks] for who in individuals],
            dtype=np.intp,
        )

    return Layout(
        individuals if depth == 4 else (),
        landmarks,
        np.stack([find(axis) for axis in axes], axis=-1),
        find("likelihood") if "likelihood" in present else None,
        (f"columns left out: {abbreviate(list(others))}",) if others else (),
    )


HEADER = ("scorer", "individuals", "bodyparts", "coords")


def read_csv(paths: tuple[Path, ...]) -> Recording:
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
    if sizes := sorted({len(level) for level in levels} - {len(coords)}):
        found = f"the lines of names have {sizes[0]} and {len(coords)} cells"
        raise input_error(f"{path}:1", found, "give each column a name in each line")
    named = [column for column in range(1, len(coords)) if coords[column]]
    scorers = [*header.get("scorer", []), *[""] * len(coords)]
    columns = [(scorers[at], *(level[at] for level in levels)) for at in named]
    layout = arrange(f"{path}:1", columns)
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
    return layout.recording(path, values, labels)


FILE = "config.yaml"
FOLDERS_ABOVE = 2
"""Predictions lie in a folder of the project, labels in a folder of that."""


def skeleton_edges(path: Path, names: Sequence[str]) -> Edges:
    """Return the edges of `skeleton` between these landmarks, by place in `names`.

    It lists pairs of names, or chains of them. A pair with a name that the table has not is left
    out; a file that is no YAML, or not of DeepLabCut, says nothing.
    """
    if is_stream(path) or isinstance(path, UrlPath):
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

BROKEN = (ValueError, IndexError, KeyError, TypeError, AttributeError, EOFError, OverflowError)
"""What the standard library raises for pickles that are cut off or damaged."""

FIX = "save it as CSV"


def names_of(place: str, pickled: Any) -> list[Any]:
    """Return the list that an attribute at `place` holds.

    Raises InputError for what is not such a list, naming the opcode where there is another.
    """
    if not isinstance(pickled, bytes):
        raise input_error(place, "holds no list of names", FIX)
    try:
        for code, argument, _ in pickletools.genops(pickled):
            if code.name not in ALLOWED:
                found = f"holds the opcode {code.name}, which is not read here"
                raise input_error(place, found, FIX)
            if code.name == "PUT" and int(argument or 0) > len(pickled):
                raise ValueError(f"it puts {argument} names aside")  # pickle would make room
        names = pickle.loads(pickled)
    except (*BROKEN, pickle.UnpicklingError) as error:
        text = printable(str(error).partition("\n")[0])
        raise input_error(place, f"holds a list that cannot be read ({text})", FIX) from error
    if not isinstance(names, list):
        raise input_error(place, "holds no list of names", FIX)
    return names


KEYS = ("df_with_missing", "tracks")
"""Groups that DeepLabCut writes; another one is read where it is the only one."""

TABLE, FIXED = "frame_table", "frame"

Columns = list[tuple[str, ...]]


def read_hdf5(paths: tuple[Path, ...]) -> Recording:
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
        read = _read_table if kind == TABLE else _read_fixed
        columns, values, labels = read(file, key)
        layout = arrange(file.place(key), columns)
    return layout.recording(path, values, labels)


def _key(file: TrackerFile) -> str:
    """Return the group of the table."""
    with file.damage():
        nodes = {name: file.root.get(name) for name in file.root}
        found = [n for n, one in nodes.items() if one is not None and "pandas_type" in one.attrs]
    known = [key for key in KEYS if key in found] or found
    if len(known) == 1:
        return known[0]
    if not known:
        raise input_error(file.path, "holds no table of pandas", DAMAGED)
    tables = listed(map(printable, known), "and")
    fix = "save one of them in a file of its own"
    raise input_error(file.path, f"holds the tables {tables}", fix)


def _read_table(file: TrackerFile, key: str) -> tuple[Columns, Floats, list[str]]:
    """Return names of columns, numbers (n, columns) and labels of frames of the table layout."""
    table = f"{key}/table"
    fields = file.fields(table)
    if "index" not in fields:
        raise file.fault(table, "has no column 'index' for the frames", FIX)
    columns: Columns = []
    parts = []
    rows: Any = None
    for field in (name for name in fields if name != "index"):
        place = f"{file.place(table)}@{printable(field)}_kind"
        pickled = file.attribute(f"{field}_kind", table)
        own = names_of(place, pickled.encode() if isinstance(pickled, str) else pickled)
        for column in own:
            if not isinstance(column, tuple):
                raise input_error(place, f"names a column {printable(repr(column))}", FIX)
        rows = file.rows(table) if rows is None else rows
        parts.append(_numbers(file, table, rows[field], len(own)))
        columns += [tuple(map(str, column)) for column in own]
    if not parts:
        raise file.fault(table, "has no numbers", FIX)
    index = rows["index"]
    if text(file.attribute("index_kind", table) or "").startswith("string"):
        labels = image_labels([text(value) for value in index])
    elif index.dtype.kind not in "iuf" or index.ndim != 1:
        raise file.fault(table, "its index is no number", FIX)
    else:
        labels = number_labels(file.place(table), index)
    return columns, np.concatenate(parts, axis=1), labels


def _read_fixed(file: TrackerFile, key: str) -> tuple[Columns, Floats, list[str]]:
    """Return the same of the fixed layout, whose columns are levels and codes."""
    columns: Columns = []
    parts = []
    count = file.attribute("nblocks", key)
    for number in range(count if isinstance(count, int) and 0 <= count < 100 else 1):
        dataset = f"{key}/block{number}_values"
        if text(file.attribute(f"block{number}_items_variety", key) or "") != "multi":
            raise file.fault(dataset, "its columns have no levels (scorer, bodyparts, coords)", FIX)
        own = _levels(file, f"{key}/block{number}_items")
        rows, width = file.shape(dataset, "frames, columns")
        transposed = not file.attribute("transposed", dataset)
        if (rows if transposed else width) != len(own):
            raise file.fault(dataset, f"has the shape {(rows, width)} for {len(own)} columns")
        values = file.rows(dataset)
        parts.append(_numbers(file, dataset, values.T if transposed else values, len(own)))
        columns += own
    if not parts:
        raise file.fault(key, "has no numbers", FIX)
    axis = f"{key}/axis0"
    if file.is_dataset(f"{axis}_level0") and sorted(_levels(file, axis)) != sorted(columns):
        raise file.fault(axis, "names other columns than its blocks")
    labels = _fixed_labels(file, key)
    if len(labels) != len(parts[0]):
        found = f"names {len(labels)} frames, and there are {len(parts[0])}"
        raise file.fault(f"{key}/axis1", found)
    return columns, np.concatenate(parts, axis=1), labels


def _fixed_labels(file: TrackerFile, key: str) -> list[str]:
    """Return what the frames are called in the fixed layout."""
    axis = f"{key}/axis1"
    if text(file.attribute("axis1_variety", key) or "") == "multi":
        return image_labels(["/".join(filter(None, row)) for row in _levels(file, axis)])
    values = np.ravel(file.rows(axis))
    if values.dtype.kind in "iuf":
        return number_labels(file.place(axis), values)
    return image_labels([text(value) for value in values.tolist()])


def _levels(file: TrackerFile, start: str) -> Columns:
    """Return the names that levels and codes stand for, one tuple each."""
    levels: list[list[str]] = []
    while file.is_dataset(f"{start}_level{len(levels)}"):
        number = len(levels)
        known = [text(value) for value in np.ravel(file.rows(f"{start}_level{number}")).tolist()]
        codes = np.ravel(file.rows(f"{start}_label{number}"))
        if codes.dtype.kind not in "iu" or ((codes < -1) | (codes >= len(known))).any():
            raise file.fault(f"{start}_label{number}", "are no codes")
        levels.append(["" if code < 0 else known[code] for code in codes.tolist()])
    if not levels or len({len(level) for level in levels}) > 1:
        raise file.fault(start, "its levels do not go together")
    return list(zip(*levels, strict=True))


def _numbers(file: TrackerFile, dataset: str, values: Any, columns: int) -> Floats:
    """Return a block as numbers (n, columns)."""
    values = np.asarray(values)
    if values.ndim == 1:
        values = values[:, None]
    if values.dtype.kind not in "biuf":
        raise file.fault(dataset, "holds pickled values, not numbers", FIX)
    if values.shape[1:] != (columns,):
        found = f"has rows of {values.shape[1:]} numbers for {columns} columns"
        raise file.fault(dataset, found)
    return values.astype(np.float64, copy=False)

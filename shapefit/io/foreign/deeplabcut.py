"""DeepLabCut: the columns of its tables, a project's skeleton, and the HDF5 that pandas writes."""

from __future__ import annotations

import pickle
import pickletools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats
from shapefit.errors import abbreviate, input_error, listed, printable
from shapefit.io.foreign.recording import (
    Recording,
    all_individuals,
    image_labels,
    number_labels,
    video_name,
)
from shapefit.io.foreign.trackers import TrackerFile, text
from shapefit.io.hdf5_file import DAMAGED
from shapefit.io.inputs import is_stream
from shapefit.io.layout import UNKNOWN_UNIT
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

    @property
    def unit(self) -> str:
        """Pixels for landmarks; tables of 3D points do not say it."""
        return "px" if self.points.shape[2] == 2 else UNKNOWN_UNIT

    def instances(self, values: Floats, labels: Sequence[str]) -> dict[str, Any]:
        """Return the fields of a recording of rows (n, columns), each individual an instance."""
        padded = np.column_stack([values, np.full(len(values), np.nan)])
        points = padded[:, self.points]
        confidence = None if self.likelihood is None else padded[:, self.likelihood]
        if confidence is not None:
            points[confidence < 0] = np.nan  # what newer versions write for animals not found
        return all_individuals(points, confidence, labels)


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


FILE = "config.yaml"
FOLDERS_ABOVE = 2
"""Predictions lie in a folder of the project, labels in a folder of that."""


def skeleton_edges(path: Path, names: Sequence[str]) -> tuple[tuple[int, int], ...]:
    """Return the edges of `skeleton` between these landmarks, by place in `names`.

    It lists pairs of names, or chains of them. A pair with a name that the table has not is left
    out; a file that is no YAML, or not of DeepLabCut, says nothing.
    """
    if is_stream(path) or isinstance(path, UrlPath):
        return ()
    folder = path.resolve().parent
    near = (each / FILE for each in (folder, *folder.parents[:FOLDERS_ABOVE]))
    found = next((each for each in near if each.is_file()), None)
    place = {name: number for number, name in enumerate(names)}
    pairs = () if found is None else _pairs(found)
    edges = ((place[a], place[b]) for a, b in pairs if a != b and a in place and b in place)
    return tuple(dict.fromkeys(edges))


def _pairs(path: Path) -> Iterator[tuple[str, str]]:
    """Yield neighbours of each chain in the skeleton of a project."""
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError

    try:
        found: Any = YAML(typ="safe", pure=True).load(path)
    except (YAMLError, OSError, ValueError, RecursionError):
        return
    chains = found.get("skeleton") if isinstance(found, dict) else None
    for chain in chains if isinstance(chains, list) else ():
        if isinstance(chain, list):
            yield from pairwise(map(str, chain))


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


@dataclass(frozen=True)
class _Block:
    """A dataset of numbers, or a field of one: where it is, and the names of its columns."""

    dataset: str
    field: str
    columns: list[tuple[str, ...]]
    transposed: bool = False


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
        blocks = _table_blocks(file, key) if kind == TABLE else _fixed_blocks(file, key)
        layout = arrange(file.place(key), [name for block in blocks for name in block.columns])
        if kind == TABLE:
            rows = file.rows(f"{key}/table")
            values = [_numbers(file, block, rows[block.field]) for block in blocks]
            labels = _table_labels(file, key, rows["index"])
        else:
            values = [
                _numbers(file, block, each.T if block.transposed else each)
                for block in blocks
                for each in (file.rows(block.dataset),)
            ]
            labels = _fixed_labels(file, key, len(values[0]))
    return Recording(
        name=str(path),
        video=video_name(path),
        **layout.instances(np.concatenate(values, axis=1), labels),
        landmark_names=layout.landmarks,
        individual_names=layout.individuals,
        notes=layout.notes,
        edges=skeleton_edges(path, layout.landmarks),
        frame_count=len(labels),
        unit=layout.unit,
    )


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


def _table_blocks(file: TrackerFile, key: str) -> list[_Block]:
    """Return the blocks of the table layout, whose columns are pickled lists."""
    table = f"{key}/table"
    fields = file.fields(table)
    if "index" not in fields:
        raise file.fault(table, "has no column 'index' for the frames", FIX)
    blocks = []
    for field in (name for name in fields if name != "index"):
        name = f"{field}_kind"
        place = f"{file.place(table)}@{printable(name)}"
        columns = [_column(place, column) for column in names_of(place, _bytes(file, name, table))]
        blocks.append(_Block(table, field, columns))
    if not blocks:
        raise file.fault(table, "has no numbers", FIX)
    return blocks


def _bytes(file: TrackerFile, name: str, node: str) -> Any:
    value = file.attribute(name, node)
    return value.encode() if isinstance(value, str) else value


def _column(place: str, column: Any) -> tuple[str, ...]:
    if not isinstance(column, tuple):
        raise input_error(place, f"names a column {printable(repr(column))}", FIX)
    return tuple(str(name) for name in column)


def _fixed_blocks(file: TrackerFile, key: str) -> list[_Block]:
    """Return the blocks of the fixed layout, whose columns are levels and codes."""
    blocks = []
    count = file.attribute("nblocks", key)
    for number in range(count if isinstance(count, int) and 0 <= count < 100 else 1):
        dataset = f"{key}/block{number}_values"
        if text(file.attribute(f"block{number}_items_variety", key) or "") != "multi":
            raise file.fault(dataset, "its columns have no levels (scorer, bodyparts, coords)", FIX)
        columns = _levels(file, f"{key}/block{number}_items")
        rows, width = file.shape(dataset, "frames, columns")
        transposed = not file.attribute("transposed", dataset)
        if (rows if transposed else width) != len(columns):
            raise file.fault(dataset, f"has the shape {(rows, width)} for {len(columns)} columns")
        blocks.append(_Block(dataset, "", columns, transposed))
    if not blocks:
        raise file.fault(key, "has no numbers", FIX)
    axis = f"{key}/axis0"
    named = sorted(each for block in blocks for each in block.columns)
    if file.is_dataset(f"{axis}_level0") and sorted(_levels(file, axis)) != named:
        raise file.fault(axis, "names other columns than its blocks")
    return blocks


def _levels(file: TrackerFile, start: str) -> list[tuple[str, ...]]:
    """Return the names that levels and codes stand for, one tuple each."""
    levels: list[list[str]] = []
    while file.is_dataset(f"{start}_level{len(levels)}"):
        number = len(levels)
        level = f"{start}_level{number}"
        known = [text(value) for value in np.ravel(file.rows(level)).tolist()]
        codes = np.ravel(file.rows(f"{start}_label{number}"))
        if codes.dtype.kind not in "iu" or ((codes < -1) | (codes >= len(known))).any():
            raise file.fault(f"{start}_label{number}", "are no codes")
        levels.append(["" if code < 0 else known[code] for code in codes.tolist()])
    if not levels or len({len(level) for level in levels}) > 1:
        raise file.fault(start, "its levels do not go together")
    return list(zip(*levels, strict=True))


def _fixed_labels(file: TrackerFile, key: str, frames: int) -> list[str]:
    """Return what the frames are called in the fixed layout."""
    variety = text(file.attribute("axis1_variety", key) or "")
    if variety == "multi":
        rows = _levels(file, f"{key}/axis1")
        labels = image_labels(["/".join(filter(None, row)) for row in rows])
    else:
        values = np.ravel(file.rows(f"{key}/axis1"))
        if values.dtype.kind in "iuf":
            labels = number_labels(file.place(f"{key}/axis1"), values)
        else:
            labels = image_labels([text(value) for value in values.tolist()])
    if len(labels) != frames:
        raise file.fault(f"{key}/axis1", f"names {len(labels)} frames, and there are {frames}")
    return labels


def _table_labels(file: TrackerFile, key: str, index: Any) -> list[str]:
    """Return what the frames are called in the table layout."""
    if text(file.attribute("index_kind", f"{key}/table") or "").startswith("string"):
        return image_labels([text(value) for value in index])
    if index.dtype.kind not in "iuf" or index.ndim != 1:
        raise file.fault(f"{key}/table", "its index is no number", FIX)
    return number_labels(file.place(f"{key}/table"), index)


def _numbers(file: TrackerFile, block: _Block, values: Any) -> Floats:
    values = np.asarray(values)
    if values.ndim == 1:
        values = values[:, None]
    if values.dtype.kind not in "biuf":
        place = file.place(block.dataset)
        raise input_error(place, "holds pickled values, not numbers", FIX)
    if values.shape[1:] != (len(block.columns),):
        found = f"has rows of {values.shape[1:]} numbers for {len(block.columns)} columns"
        raise file.fault(block.dataset, found)
    return values.astype(np.float64, copy=False)

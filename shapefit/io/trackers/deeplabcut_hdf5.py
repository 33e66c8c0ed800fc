"""DeepLabCut HDF5: a table that pandas wrote, in one of its two layouts, read without pandas.

*table* (predictions): KEY/table has rows of an index and blocks of numbers, whose column names
are pickled in an attribute. *fixed* (labels): KEY/block0_values has the numbers, and the column
names stand beside it as levels and codes.
"""

from __future__ import annotations

import pickle
import pickletools
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from shapefit.arrays import Floats
from shapefit.errors import input_error, listed, printable
from shapefit.io.foreign.recognition import look
from shapefit.io.foreign.recording import Instances, Recording, video_name
from shapefit.io.hdf5.file import DAMAGED
from shapefit.io.sources import HDF5_SIGNATURE
from shapefit.io.trackers.deeplabcut_table import Layout, arrange, skeleton_edges
from shapefit.io.trackers.frame_names import image_labels, number_labels
from shapefit.io.trackers.reading import TrackerFile, frame_ranges, text

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


def record(paths: tuple[Path, ...]) -> Recording:
    """Open a file; its numbers are read when its blocks are."""
    path = paths[0]
    with TrackerFile(path) as file:
        key = _key(path)
        kind = text(file.attribute("pandas_type", key) or "")
        if kind not in (TABLE, FIXED):
            raise file.fault(key, f"is a {printable(kind)} of pandas, not a table of frames", FIX)
        blocks = _table_blocks(file, key) if kind == TABLE else _fixed_blocks(file, key)
        frames = file.shape(blocks[0].dataset)[1 if blocks[0].transposed else 0]
        labels = None if kind == TABLE else _fixed_labels(file, key, frames)
        if kind == TABLE and _is_text(file, key):
            index = file.rows(f"{key}/table")["index"]
            labels = list(image_labels([text(value) for value in index]))
        names = [column for block in blocks for column in block.columns]
        layout = arrange(file.place(key), names)
    return Recording(
        name=str(path),
        video=video_name(path),
        dimensions=layout.dimensions,
        landmark_names=layout.landmarks,
        blocks=lambda: _read(path, key, blocks, layout, labels),
        individuals=layout.individuals,
        notes=layout.notes,
        edges=skeleton_edges(path, layout.landmarks),
        frames=frames,
        unit=layout.unit,
    )


def _key(path: Path) -> str:
    """Return the group of the table."""
    found = look(path, HDF5_SIGNATURE).pandas
    known = [key for key in KEYS if key in found] or list(found)
    if len(known) == 1:
        return known[0]
    if not known:
        raise input_error(path, "holds no table of pandas", DAMAGED)
    tables = listed(map(printable, known), "and")
    raise input_error(path, f"holds the tables {tables}", "save one of them in a file of its own")


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
        labels = list(image_labels(["/".join(filter(None, row)) for row in rows]))
    else:
        values = np.ravel(file.rows(f"{key}/axis1"))
        if values.dtype.kind in "iuf":
            labels = number_labels(file.place(f"{key}/axis1"), values)
        else:
            labels = list(image_labels([text(value) for value in values.tolist()]))
    if len(labels) != frames:
        raise file.fault(f"{key}/axis1", f"names {len(labels)} frames, and there are {frames}")
    return labels


def _is_text(file: TrackerFile, key: str) -> bool:
    return text(file.attribute("index_kind", f"{key}/table") or "").startswith("string")


def _read(
    path: Path, key: str, blocks: list[_Block], layout: Layout, labels: Any
) -> Iterator[Instances]:
    """Read the frames, some thousand at a time."""
    with TrackerFile(path) as file:
        frames = file.shape(blocks[0].dataset)[1 if blocks[0].transposed else 0]
        for rows in frame_ranges(frames):
            if blocks[0].field:
                read = file.rows(blocks[0].dataset, rows)
                parts = [_numbers(file, block, read[block.field]) for block in blocks]
                names = labels[rows] if labels else _index_labels(file, key, read["index"])
            else:
                parts = [_numbers(file, block, _fixed_rows(file, block, rows)) for block in blocks]
                names = labels[rows]
            yield layout.instances(np.concatenate(parts, axis=1), rows.start, names)


def _fixed_rows(file: TrackerFile, block: _Block, rows: slice) -> Any:
    if block.transposed:
        return file.rows(block.dataset, (slice(None), rows)).T
    return file.rows(block.dataset, rows)


def _index_labels(file: TrackerFile, key: str, index: Any) -> list[str]:
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

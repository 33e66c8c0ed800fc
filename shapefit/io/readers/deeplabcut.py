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
    FormatError,
    Poses,
    find_yaml,
    image_labels,
    number_labels,
    of_frames,
    parsing,
    require,
)
from shapefit.io.readers.tables import Table, read_text, split_rows
from shapefit.io.readers.trackers import TrackerFile, as_text
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
        for name in ("bodyparts", "coords"):
            require(name in header, f"there is no line {name!r}")
        levels = [header[name] for name in HEADER[1:] if name in header]
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
            raise input_error(f"{path}:{lines[wrong][0]}", problem, "number the frames")
        labels, values = number_labels(str(path), values[:, 0]), values[:, 1:]
    else:
        values, parts, _ = table.read(named, range(named[0] if named else 1))
        labels = image_labels(["/".join(filter(None, row)) for row in zip(*parts, strict=True)])
    return _of_columns(path, f"{path}:1", columns, values, labels)


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
    with TrackerFile(path) as file:
        tables = [name for name in file.groups("/") if file.text("pandas_type", name)]
        tables = [name for name in KEYS if name in tables] or tables
        if len(tables) != 1:
            texts = listed(map(printable, tables), "and") if tables else "none"
            fix = "save one of them in a file of its own"
            raise input_error(path, f"holds the tables {texts} of pandas", fix)
        key = tables[0]
        if file.is_dataset(f"{key}/table"):
            rows = file.table(f"{key}/table", "index")
            index = rows["index"]
            require(index.ndim == 1, "its index is no number")
            for field in [name for name in rows.dtype.names if name != "index"]:
                names = _unpickle_names(file.attribute(f"{field}_kind", f"{key}/table"))
                blocks.append((names, rows[field].reshape(len(rows), -1)))
        else:
            while file.is_dataset(block := f"{key}/block{len(blocks)}_values"):
                values = file.rows(block)
                values = values if file.attribute("transposed", block) else values.T
                blocks.append((_levels(file, block.replace("_values", "_items")), values))
            index = _levels(file, f"{key}/axis1") or np.ravel(file.rows(f"{key}/axis1"))
        require(blocks, "has no columns")
        for names, values in blocks:
            require(
                values.dtype.kind in "biuf", "holds pickled values, not numbers; save it as CSV"
            )
            fits = values.shape[1:] == (len(names),)
            require(fits, f"has the shape {values.shape} for {len(names)} columns")
        if isinstance(index, list):
            labels = image_labels(["/".join(filter(None, row)) for row in index])
        elif index.dtype.kind in "iuf":
            labels = number_labels(file.place(key), index)
        else:
            labels = image_labels([*map(as_text, index.tolist())])
        values = np.column_stack([values for _, values in blocks]).astype(np.float64)
        require(len(labels) == len(values), f"names {len(labels)} of {len(values)} frames")
    columns = [column for names, _ in blocks for column in names]
    return _of_columns(path, file.place(key), columns, values, labels)


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
        names = [*map(as_text, np.ravel(file.rows(place)).tolist()), ""]
        codes = np.ravel(file.rows(f"{start}_label{len(levels)}"))
        proper = codes.dtype.kind in "iu" and ((codes >= -1) & (codes < len(names) - 1)).all()
        require(proper, "are no codes")
        levels.append([names[code] for code in codes.tolist()])
    return list(zip(*levels, strict=True))


COORDINATES = ("x", "y", "z", "likelihood")


def _of_columns(
    path: Path, place: str, columns: Columns, values: Floats, labels: Sequence[str]
) -> Poses:
    """Return the poses of rows (n, columns), each individual a pose of the frame.

    Columns are named (scorer, [individual,] body part, coordinate), in the file at `place`.
    Individuals and landmarks stand in order of appearance; a landmark that only some individuals
    have is missing for the others. Columns of other coordinates are left out, with a note. Raises
    InputError for columns that are there twice, and for those of a landmark without the others.
    """
    depths = {len(column) for column in columns}
    number: dict[tuple[str, str], dict[str, int]] = {}
    with parsing(place, f"{SAVE}, with the columns of one scorer, x and y for each body part"):
        require(columns, "has no columns of coordinates")
        require(depths in ({3}, {4}), f"its columns have {abbreviate([*map(str, depths)])} names")
        for column, names in enumerate(columns):
            who = names[1] if len(names) == 4 else ""
            axes_of = number.setdefault((who, names[-2]), {})
            twice = f"{names[-1]} of {f'{who} {names[-2]}'.strip()} is there twice"
            require(names[-1] not in axes_of, twice)
            axes_of[names[-1]] = column
        others = dict.fromkeys(printable(c[-1]) for c in columns if c[-1] not in COORDINATES)
        axes = [axis for axis in COORDINATES if any(axis in own for own in number.values())]
        require(axes[:2] == ["x", "y"], f"has no columns x and y ({abbreviate([*others])})")
        number = {key: own for key, own in number.items() if own.keys() & {*axes}}
        for (_, landmark), own in number.items():
            lost = [axis for axis in axes if axis not in own]
            require(not lost, f"{landmark} has no column {''.join(lost[:1])}")
    individuals, landmarks = (tuple(dict.fromkeys(key[at] for key in number)) for at in (0, 1))
    points = np.full((len(values), len(individuals), len(landmarks), len(axes)), np.nan)
    for (who, landmark), own in number.items():
        columns_of = [own[axis] for axis in axes]
        points[:, individuals.index(who), landmarks.index(landmark)] = values[:, columns_of]
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
        edges=_skeleton_edges(path, landmarks),
    )


def _skeleton_edges(path: Path, names: Sequence[str]) -> Edges:
    """Return the edges of `skeleton` in the config.yaml of the project between these landmarks.

    It lists pairs of names, or chains of them. A pair with a name that the table has not is left
    out; a file that is no YAML, or not of DeepLabCut, gives none.
    """
    if is_stream(path):
        return ()
    try:  # predictions lie in a folder of the project, labels in a folder of that
        _, content = find_yaml(path.parent, "config.yaml", 2) or (None, None)
    except (InputError, OSError):
        return ()
    chains = content.get("skeleton") if isinstance(content, dict) else None
    chains = (
        [chain for chain in chains if isinstance(chain, list)] if isinstance(chains, list) else []
    )
    place = {name: number for number, name in enumerate(names)}
    pairs = [pair for chain in chains for pair in pairwise(map(str, chain))]
    edges = ((place[a], place[b]) for a, b in pairs if a != b and {a, b} <= place.keys())
    return tuple(dict.fromkeys(edges))

"""Read and write files of 3D shapes."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from shapefit.errors import input_error
from shapefit.io.agreement import agreed, check_same_array, check_same_extras
from shapefit.io.chunked import ChunkedSource, SourceFile
from shapefit.io.duplicates import ItemList
from shapefit.io.extras import Array, Extras
from shapefit.io.layout import SHAPES, UNKNOWN_UNIT
from shapefit.io.magnitudes import Axis, check_magnitudes
from shapefit.io.records import ShapeSet, match_landmarks
from shapefit.io.sources import is_hdf5, source_name
from shapefit.io.writing import record_writer


@dataclass(frozen=True)
class _File(SourceFile[ShapeSet]):
    """One file of a source; `sequences` reads those of all its shapes, if it has any."""

    sequences: Callable[[], Iterable[Sequence[str]]]


def read_shapes(paths: Sequence[Path]) -> ShapeSet:
    """Read shapes from HDF5 and CSV files as one set, as `open_shapes` opens them."""
    with open_shapes(paths) as source:
        (shapes,) = source.chunks(max(source.count, 1))
        return shapes


def open_shapes(paths: Sequence[Path]) -> ShapeSource:
    """Open HDF5 and CSV files of shapes (`-` is standard input) as one source.

    Landmarks are matched by name and stand in the order of the first file, items in the order of
    the files; where only some files have sequences, those of the others are empty texts.
    Everything is checked before the first shape is given out. Raises InputError for what is wrong
    with a file, for items that occur twice, and for files that do not go together (other
    landmarks, units, meshes or further datasets). HDF5 is read a chunk at a time, CSV whole.
    """
    return ShapeSource([_open(path) for path in paths])


class ShapeSource(ChunkedSource[ShapeSet, _File]):
    """The shapes of one or more files: `with open_shapes(paths) as source: ...`."""

    def __init__(self, files: Sequence[_File]) -> None:
        super().__init__(files)
        self._head = _common_head([file for file in files if file.count] or files[:1])

    @property
    def head(self) -> ShapeSet:
        """All of the source but its shapes."""
        return self._head

    def sequences(self) -> Iterator[Sequence[str]]:
        """Read the sequences of all shapes, block by block; an empty text where there is none."""
        for file in self._files:
            if file.head.sequences is None:
                yield ("",) * file.count
            else:
                yield from file.sequences()

    def _conform(self, part: ShapeSet, place: str) -> ShapeSet:
        part = _arranged(part, self._head.landmark_names, place)
        sequences = part.sequences
        if self._head.sequences is not None and sequences is None:
            sequences = ("",) * len(part)
        edges, unit = self._head.edges, self._head.unit
        return replace(part, sequences=sequences, edges=edges, unit=unit)


def write_shapes(path: Path, shapes: ShapeSet) -> None:
    """Write shapes to HDF5, or to CSV for `-` and names in .csv (without mesh, edges, extras).

    Raises InputError where the file cannot be written; the old one then stays as it was.
    """
    with record_writer(path, SHAPES) as writer:
        writer.append(shapes)


def _open(path: Path) -> _File:
    return _open_hdf5(path) if is_hdf5(path) else _open_table(path)


def _open_table(path: Path) -> _File:
    from shapefit.io.csv.tables import read_shape_table

    table = read_shape_table(path)
    name, landmarks = source_name(path), Axis("landmark", table.landmark_names)
    check_magnitudes(name, table.shapes, Axis("item", table.items), landmarks)
    items = ItemList(lambda: [table.items], lambda _: name)
    return _File(
        name,
        table.take(slice(0)),
        len(table),
        items,
        lambda: nullcontext(table.take),
        lambda: [table.sequences or ()],
    )


def _open_hdf5(path: Path) -> _File:
    from shapefit.io.hdf5 import checks as hdf5_checks
    from shapefit.io.hdf5.reading import Hdf5Reader

    @contextmanager
    def opened() -> Iterator[Callable[[slice], ShapeSet]]:
        with Hdf5Reader(path, SHAPES) as reader:
            yield lambda rows: _read_rows(reader, rows)

    def texts(name: str) -> Iterator[tuple[str, ...]]:
        with Hdf5Reader(path, SHAPES) as reader:
            yield from reader.read_blocks(name)

    with Hdf5Reader(path, SHAPES) as reader:
        hdf5_checks.check_named(reader, reader.read_blocks("item"))
        hdf5_checks.check_finite(reader, "shapes", reader.read_blocks("shapes"))
        if reader.has("mesh_vertices"):
            hdf5_checks.check_finite(reader, "mesh_vertices", reader.read_blocks("mesh_vertices"))
        hdf5_checks.check_indices(reader, "edges", "p")
        hdf5_checks.check_indices(reader, "mesh_faces", "q")
        return _File(
            str(path),
            _read_rows(reader, slice(0)),
            reader.count,
            ItemList(lambda: texts("item"), lambda row: f"{path}:/item[{row}]"),
            opened,
            lambda: texts("sequence"),
        )


def _read_rows(reader: Any, rows: slice) -> ShapeSet:
    return ShapeSet(**reader.fields(rows), unit=reader.unit, extras=reader.extras(rows))


def _arranged(shapes: ShapeSet, names: tuple[str, ...], place: str) -> ShapeSet:
    """Return the shapes with their landmarks in the order of `names`."""
    if shapes.landmark_names == names:
        return shapes
    match_landmarks(names, shapes.landmark_names, place)
    columns = match_landmarks(shapes.landmark_names, names, place)
    position = np.argsort(columns)
    extras = Extras.of(shapes.extras, len(shapes))
    whole = dict(extras.whole)
    if "mirror_index" in whole:
        index = _mirror_index(whole["mirror_index"], names, place)
        whole["mirror_index"] = position[index[columns]]
    return replace(
        shapes,
        shapes=shapes.shapes[..., columns],
        landmark_names=names,
        edges=None if shapes.edges is None else position[shapes.edges],
        extras=Extras(extras.per_item, whole),
    )


def _mirror_index(index: Array, names: tuple[str, ...], place: str) -> Array:
    """Return the index of each landmark's mirror image; InputError where it is none."""
    whole_numbers = index.dtype.kind in "iu" and index.shape == (len(names),)
    if not whole_numbers or ((index < 0) | (index >= len(names))).any():
        found = "does not pair the landmarks"
        fix = "store the index of each landmark's mirror image, or remove it"
        raise input_error(f"{place}:/mirror_index", found, fix)
    return index


def _common_head(files: Sequence[_File]) -> ShapeSet:
    """Return the head of a whole source; InputError where its files do not go together."""
    names = files[0].head.landmark_names
    heads = [(file.name, _arranged(file.head, names, file.name)) for file in files]
    units = [(name, None if head.unit == UNKNOWN_UNIT else head.unit) for name, head in heads]
    unit = agreed("unit", units, UNKNOWN_UNIT)
    meshes = [(name, head.mesh_vertices) for name, head in heads]
    sizes = [(name, None if mesh is None else np.array(mesh.shape[1:])) for name, mesh in meshes]
    check_same_array("mesh", sizes)
    check_same_array("mesh_faces", [(name, head.mesh_faces) for name, head in heads])
    check_same_extras([(name, Extras.of(head.extras, 0)) for name, head in heads])
    edges = next((head.edges for _, head in heads if head.edges is not None), None)
    sequences = () if any(head.sequences is not None for _, head in heads) else None
    return replace(heads[0][1], unit=unit, edges=edges, sequences=sequences)

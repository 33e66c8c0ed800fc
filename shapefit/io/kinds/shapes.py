"""Read and write files of 3D shapes."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from shapefit.errors import input_error
from shapefit.io.agreement import agreed, agreed_rate, check_same_array, check_same_extras
from shapefit.io.chunked import ChunkedSource, SourceFile, with_names
from shapefit.io.duplicates import ItemList
from shapefit.io.extras import Array, Extras
from shapefit.io.foreign.file_format import FileFormat
from shapefit.io.foreign.gaps import without_gaps
from shapefit.io.foreign.opening import group_inputs, open_recording
from shapefit.io.formats import find_reader
from shapefit.io.layout import SHAPES, UNKNOWN_UNIT
from shapefit.io.magnitudes import Axis, check_magnitudes
from shapefit.io.options import AS_THEY_ARE, InputOptions
from shapefit.io.records import ShapeSet, match_landmarks
from shapefit.io.renaming import check_known
from shapefit.io.sources import source_name
from shapefit.io.stored import checks
from shapefit.io.stored.opening import open_stored
from shapefit.io.stored.reader import StoredReader
from shapefit.io.writing import record_writer


@dataclass(frozen=True)
class _File(SourceFile[ShapeSet]):
    """One file of a source; `sequences` reads those of all its shapes, if it has any."""

    sequences: Callable[[], Iterable[Sequence[str]]] = tuple


def read_shapes(
    paths: Sequence[Path], options: InputOptions = AS_THEY_ARE, *, gaps: bool = False
) -> ShapeSet:
    """Read shapes from files of any format as one set, as `open_shapes` opens them."""
    with open_shapes(paths, options, gaps=gaps) as source:
        return source.whole()


def open_shapes(
    paths: Sequence[Path], options: InputOptions = AS_THEY_ARE, *, gaps: bool = False
) -> ShapeSource:
    """Open files of shapes in any format (`-` is standard input) as one source.

    Landmarks are matched by name and stand in the order of the first file, items in the order of
    the files; where only some files have sequences, those of the others are empty texts.
    Everything is checked before the first shape is given out. Raises InputError for what is wrong
    with a file, for items that occur twice, and for files that do not go together (other
    landmarks, units, meshes or further datasets). HDF5 and Parquet are read a chunk at a time,
    all else whole.

    With `gaps` a landmark of an item may be unknown: it is NaN, in all coordinates where it is in
    one, and may lack its row in CSV. Without, that is wrong. `rename` as in `open_landmarks`.
    """
    files = [_open(known, own, options, gaps) for known, own in group_inputs(paths, options)]
    rename = options.rename
    check_known(rename, [(file.name, file.head.landmark_names) for file in files])
    return ShapeSource([with_names(file, rename) for file in files])


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
        head = self._head
        return replace(
            part,
            sequences=sequences,
            edges=head.edges,
            unit=head.unit,
            frame_rate=head.frame_rate,
        )


def write_shapes(path: Path, shapes: ShapeSet) -> None:
    """Write shapes to HDF5, or to CSV for `-` and names in .csv (without mesh, edges, extras).

    Raises InputError where the file cannot be written; the old one then stays as it was.
    """
    with record_writer(path, SHAPES) as writer:
        writer.append(shapes)


def _open(known: FileFormat, paths: tuple[Path, ...], options: InputOptions, gaps: bool) -> _File:
    """Open a file of any format; one that is read whole gives out parts of what was read."""
    path = paths[0]
    notes: tuple[str, ...] = ()
    if known.recorder is not None:
        from shapefit.io.foreign.sources import shape_file

        table, notes = shape_file(open_recording(known, paths, "shapes"), options)
        if not gaps:
            table, notes = without_gaps(table, notes, source_name(path))
    elif known.together:
        table, notes = find_reader(path, "shapes")(paths, gaps=gaps)
    else:
        table = find_reader(path, "shapes")(path, gaps=gaps)
    if isinstance(table, _File):
        return table
    name, landmarks = source_name(path), Axis("landmark", table.landmark_names)
    check_magnitudes(name, table.shapes, Axis("item", table.items), landmarks)
    items = ItemList(lambda: [table.items], lambda _: name)
    return _File(
        name,
        table.take(slice(0)),
        len(table),
        items,
        lambda: nullcontext(table.take),
        notes,
        lambda: [table.sequences or ()],
    )


def open_stored_file(path: Path, *, gaps: bool) -> _File:
    """Open an HDF5 or Parquet file, which is read a chunk at a time."""

    @contextmanager
    def opened() -> Iterator[Callable[[slice], ShapeSet]]:
        with open_stored(path, SHAPES) as reader:
            yield lambda rows: _read_rows(reader, rows)

    def texts(name: str) -> Iterator[tuple[str, ...]]:
        with open_stored(path, SHAPES) as reader:
            yield from reader.read_blocks(name)

    with open_stored(path, SHAPES) as reader:
        checks.check_named(reader, reader.read_blocks("item"))
        check_points = checks.check_finite_or_gap if gaps else checks.check_finite
        check_points(reader, "shapes", reader.read_blocks("shapes"))
        if reader.has("mesh_vertices"):
            checks.check_finite(reader, "mesh_vertices", reader.read_blocks("mesh_vertices"))
        checks.check_indices(reader, "edges", "p")
        checks.check_indices(reader, "mesh_faces", "q")
        return _File(
            str(path),
            _read_rows(reader, slice(0)),
            reader.count,
            ItemList(lambda: texts("item"), lambda row: reader.place("item", row)),
            opened,
            (),
            lambda: texts("sequence"),
        )


def _read_rows(reader: StoredReader, rows: slice) -> ShapeSet:
    fields = reader.fields(rows)
    unknown = np.isnan(fields["shapes"]).any(axis=1, keepdims=True)
    fields["shapes"] = np.where(unknown, np.nan, fields["shapes"])
    return ShapeSet(
        **fields,
        unit=reader.unit,
        frame_rate=reader.frame_rate,
        extras=reader.extras(rows),
    )


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
    rate = agreed_rate([(name, head.frame_rate) for name, head in heads])
    return replace(heads[0][1], unit=unit, edges=edges, sequences=sequences, frame_rate=rate)

"""Read and write files of 3D shapes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from shapefit.errors import input_error
from shapefit.io.agreement import agreed, check_same_array, check_same_extras
from shapefit.io.duplicates import ItemList, check_unique_items
from shapefit.io.extras import Array, Extras
from shapefit.io.layout import SHAPES, UNKNOWN_UNIT
from shapefit.io.magnitudes import Axis, check_magnitudes
from shapefit.io.records import ShapeSet, concatenate, match_landmarks
from shapefit.io.sources import is_hdf5, source_name
from shapefit.io.writing import record_writer


def read_shapes(paths: Sequence[Path]) -> ShapeSet:
    """Read shapes from HDF5 and CSV files (`-` is standard input) as one set.

    Landmarks are matched by name and stand in the order of the first file, items in the order of
    the files; where only some files have sequences, those of the others are empty texts. Raises
    InputError for what is wrong with a file, for items that occur twice, and for files that do
    not go together (other landmarks, units, meshes or further datasets).
    """
    sets = [_checked(_read(path), path) for path in paths]
    check_unique_items([_item_list(path, part) for path, part in zip(paths, sets, strict=True)])
    files = [(source_name(path), part) for path, part in zip(paths, sets, strict=True)]
    files = [file for file in files if len(file[1])] or files[:1]
    landmark_names = files[0][1].landmark_names
    files = [(name, _arranged(shapes, landmark_names, name)) for name, shapes in files]
    return concatenate(_completed(files))


def write_shapes(path: Path, shapes: ShapeSet) -> None:
    """Write shapes to HDF5, or to CSV for `-` and names in .csv (without mesh, edges, extras).

    Raises InputError where the file cannot be written; the old one then stays as it was.
    """
    with record_writer(path, SHAPES) as writer:
        writer.append(shapes)


def _read(path: Path) -> ShapeSet:
    if not is_hdf5(path):
        from shapefit.io.csv_tables import read_shape_table

        return read_shape_table(path)
    from shapefit.io import hdf5_checks
    from shapefit.io.hdf5_reading import Hdf5Reader

    with Hdf5Reader(path, SHAPES) as reader:
        shapes = ShapeSet(**reader.fields(), unit=reader.unit, extras=reader.extras())
        hdf5_checks.check_named(reader, [shapes.items])
        hdf5_checks.check_finite(reader, "shapes", [shapes.shapes])
        if shapes.mesh_vertices is not None:
            hdf5_checks.check_finite(reader, "mesh_vertices", [shapes.mesh_vertices])
        hdf5_checks.check_indices(reader, "edges", "p")
        hdf5_checks.check_indices(reader, "mesh_faces", "q")
    return shapes


def _checked(shapes: ShapeSet, path: Path) -> ShapeSet:
    place, items = source_name(path), Axis("item", shapes.items)
    check_magnitudes(place, shapes.shapes, items, Axis("landmark", shapes.landmark_names))
    check_magnitudes(place, shapes.mesh_vertices, items, Axis("vertex"))
    return shapes


def _item_list(path: Path, shapes: ShapeSet) -> ItemList:
    hdf5 = is_hdf5(path)
    name = source_name(path)
    return ItemList(lambda: [shapes.items], lambda row: f"{name}:/item[{row}]" if hdf5 else name)


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


def _completed(files: Sequence[tuple[str, ShapeSet]]) -> list[ShapeSet]:
    """Give all parts the same unit, edges and optional fields; InputError where they disagree."""
    units = [(name, None if part.unit == UNKNOWN_UNIT else part.unit) for name, part in files]
    unit = agreed("unit", units, UNKNOWN_UNIT)
    meshes = [(name, part.mesh_vertices) for name, part in files]
    sizes = [(name, None if mesh is None else np.array(mesh.shape[1:])) for name, mesh in meshes]
    check_same_array("mesh", sizes)
    check_same_array("mesh_faces", [(name, part.mesh_faces) for name, part in files])
    check_same_extras([(name, Extras.of(part.extras, len(part))) for name, part in files])
    edges = next((part.edges for _, part in files if part.edges is not None), None)
    parts = [replace(part, unit=unit, edges=edges) for _, part in files]
    if any(part.sequences is not None for part in parts):
        parts = [replace(part, sequences=part.sequences or ("",) * len(part)) for part in parts]
    return parts

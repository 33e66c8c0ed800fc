"""Mesh files of a result, one per image, named after its item: OBJ, PLY or GLB."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats
from shapefit.dictionary.model import Dictionary
from shapefit.errors import input_error
from shapefit.io import ResultSet
from shapefit.io.atomic import check_folder, file_stem, staged_files
from shapefit.io.inputs import is_stream
from shapefit.meshes.dense import metric_scale, object_frame
from shapefit.meshes.export import MeshFormat, mesh_file

BATCH = 64
"""Images whose vertices are in memory at a time."""


class MeshWriter:
    """Writes the mesh of each image of a result that has a shape."""

    def __init__(self, dictionary: Dictionary, to: MeshFormat, folder: Path, staging: Path) -> None:
        """Take what `check_dictionary` and `check_mesh_folder` let through.

        Files are written in `staging`, from where they move into the folder.
        """
        self._dictionary, self._format = dictionary, to
        self._folder, self._staging = folder, staging
        self._count = self._missing = 0

    def add(self, result: ResultSet) -> None:
        """Write the files of some images."""
        assert self._dictionary.mesh_faces is not None
        rows = np.flatnonzero(has_shape(result))
        self._missing += len(result) - len(rows)
        for start in range(0, len(rows), BATCH):
            images = result.take(rows[start : start + BATCH])
            placed = in_object_frame(images, self._dictionary)
            for item, points in zip(images.items, placed, strict=True):
                content = mesh_file(points, self._dictionary.mesh_faces, self._format)
                stem = file_stem(item)
                path = self._staging / stem.with_name(f"{stem.name}.{self._format}")
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_bytes(content)
                self._count += 1

    @property
    def written(self) -> tuple[Path, ...]:
        """The folder, if there is a file in it."""
        return (self._folder,) if self._count else ()

    @property
    def note(self) -> str:
        """How many images have files."""
        return f"{self._count} mesh{'' if self._count == 1 else 'es'}"

    @property
    def warnings(self) -> tuple[str, ...]:
        """Which images have no mesh, counted."""
        missing = f"images without a shape (failed, or with all coefficients 0): {self._missing}"
        return (f"{missing}; they have no mesh",) if self._missing else ()


@contextmanager
def mesh_writer(dictionary: Dictionary, folder: Path, to: MeshFormat) -> Iterator[MeshWriter]:
    """Give a writer of meshes to a folder; the files appear together on a clean exit."""
    with staged_files(folder) as staging:
        yield MeshWriter(dictionary, to, folder, staging)


def check_dictionary(dictionary: Dictionary, place: str | Path, *, mixes_atoms: bool) -> None:
    """Raise InputError at `place` where results of this dictionary have no meshes.

    mixes_atoms: whether the shapes are combinations of the atoms, as the meshes then are.
    """
    if dictionary.mesh_vertices is None:
        fix = "learn it from shapes with `mesh_vertices` and `mesh_faces`"
        raise input_error(place, "has no mesh to export", fix)
    if not mixes_atoms:
        found = "the result has no coefficients to combine the meshes of the atoms"
        raise input_error(place, found, "fit with `--method convex` or `convex+refine`")


def check_mesh_folder(folder: Path, key: str, to: MeshFormat, result: Path | None = None) -> None:
    """Raise InputError for a folder that cannot get files, or that could replace the result."""
    if is_stream(folder):
        raise input_error(key, "- is standard output", "give the name of a folder")
    if os.path.islink(folder) and not os.path.exists(folder):
        found = f"it is a link to {os.path.realpath(folder)}, which does not exist"
        raise input_error(folder, found, "create that folder, or remove the link")
    check_folder(folder)
    if result is None:
        return
    inside, own = Path(os.path.realpath(folder)), Path(os.path.realpath(result))
    if own == inside:
        raise input_error(key, f"{folder} is also the output", "give it a different name")
    if own.is_relative_to(inside) and own.suffix.lower() == f".{to}":
        found = f"has the same name as the .{to} files that go into {folder}"
        raise input_error(result, found, "name it .h5 or .csv")


def in_object_frame(result: ResultSet, dictionary: Dictionary) -> Floats:
    """size * sum_i c_i V_i: (n, 3, q).

    The frame is that of the dictionary, in which objects stand upright. The size is that of the
    dictionary's shapes (metres, for instance) where it knows the sizes of its atoms, else that of
    the shape in the image.
    """
    c, size = result.coefficients, result.scale
    assert c is not None
    assert size is not None
    assert dictionary.mesh_vertices is not None
    if dictionary.atom_scale is not None:
        size = metric_scale(dictionary.atoms, c, dictionary.atom_scale)
    return np.asarray(size[:, None, None] * object_frame(dictionary.mesh_vertices, c))


def has_shape(result: ResultSet) -> NDArray[np.bool_]:
    """Which of n images have a shape with an extent, a place and a rotation."""
    extent = np.ptp(result.shapes, axis=2).max(axis=1)
    turned = np.zeros(len(result)) if result.rotation is None else result.rotation.sum(axis=(1, 2))
    fitted: NDArray[np.bool_] = np.isfinite(extent + turned) & (extent > 0)
    return fitted

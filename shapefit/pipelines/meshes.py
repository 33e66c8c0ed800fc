"""Mesh files of a result, one per image, named after its item: OBJ, PLY or GLB."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Literal

import numpy as np

from shapefit.arrays import Flags, Floats, Integers
from shapefit.dictionary.model import Dictionary
from shapefit.errors import counted, input_error
from shapefit.io import ResultSet
from shapefit.io.atomic import check_folder, file_stem, staged_files, storage_errors
from shapefit.meshes.dense import metric_scale

MeshFormat = Literal["obj", "ply", "glb"]
"""OBJ keeps 8 decimals, PLY and GLB single precision."""
BATCH = 64
"""Images whose vertices are in memory at a time."""
COLOUR = (120, 155, 190)
"""Of a mesh, in GLB."""


class MeshWriter:
    """Writes the mesh of each image of a result that has a shape into a folder.

    count and missing are the images with a mesh and those without.
    """

    def __init__(self, dictionary: Dictionary, to: MeshFormat, folder: Path, staging: Path) -> None:
        """Take a dictionary with meshes; files move from `staging` into the folder at the end."""
        self._dictionary, self._format = dictionary, to
        self._folder, self._staging = folder, staging
        self.count = self.missing = 0

    def add(self, result: ResultSet) -> None:
        """Write the files of some images."""
        assert self._dictionary.mesh_faces is not None
        rows = np.flatnonzero(has_shape(result))
        self.missing += len(result) - len(rows)
        for start in range(0, len(rows), BATCH):
            images = result.take(rows[start : start + BATCH])
            placed = in_object_frame(images, self._dictionary)
            for item, points in zip(images.items, placed, strict=True):
                stem = file_stem(item)
                path = self._staging / stem.with_name(f"{stem.name}.{self._format}")
                path.parent.mkdir(parents=True, exist_ok=True)
                mesh = mesh_file(points, self._dictionary.mesh_faces, self._format)
                with storage_errors(self._folder, None):
                    path.write_bytes(mesh)
                self.count += 1

    @property
    def written(self) -> tuple[Path, ...]:
        """The folder, if there is a file in it."""
        return (self._folder,) if self.count else ()

    @property
    def note(self) -> str:
        """How many images have files."""
        return "1 mesh" if self.count == 1 else f"{self.count} meshes"

    @property
    def warnings(self) -> tuple[str, ...]:
        """How many images have no mesh."""
        without = f"{counted(self.missing, 'image')} without a shape and a mesh"
        return (without,) if self.missing else ()


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
        fault = "the result has no coefficients to combine the meshes of the atoms"
        raise input_error(place, fault, "fit with `--method convex` or `convex+refine`")


def check_mesh_folder(folder: Path, key: str, result: Path | None = None) -> None:
    """Raise InputError for a folder that cannot get files, or that is the result."""
    check_folder(folder)
    if result is not None and os.path.realpath(folder) == os.path.realpath(result):
        raise input_error(key, f"{folder} is also the output", "give it a different name")


def in_object_frame(result: ResultSet, dictionary: Dictionary) -> Floats:
    """size * sum_i c_i V_i: (n, 3, q).

    The frame is that of the dictionary, in which objects stand upright. The size is that of the
    dictionary's shapes (metres, for instance) where it knows the sizes of its atoms, else that of
    the shape in the image.
    """
    c, size = result.coefficients, result.scale
    assert dictionary.mesh_vertices is not None
    if dictionary.atom_scale is not None:
        size = metric_scale(dictionary.atoms, c, dictionary.atom_scale)
    return np.asarray(size[:, None, None] * np.tensordot(c, dictionary.mesh_vertices, axes=1))


def has_shape(result: ResultSet) -> Flags:
    """Which of n images have a shape with an extent, a place and a rotation."""
    extent = np.ptp(result.shapes, axis=2).max(axis=1)
    turned = 0.0 if result.rotation is None else result.rotation.sum(axis=(1, 2))
    return np.asarray(np.isfinite(extent + turned) & (extent > 0))


def mesh_file(vertices: Floats, faces: Integers, to: MeshFormat) -> bytes:
    """Encode one mesh, vertices (3, q) and faces (f, 3), as one object called `mesh`.

    Coordinates, order and winding stay as given, whatever the format.
    """
    from trimesh import Scene, Trimesh
    from trimesh.exchange.gltf import export_glb
    from trimesh.exchange.obj import export_obj
    from trimesh.exchange.ply import export_ply
    from trimesh.visual import TextureVisuals
    from trimesh.visual.material import PBRMaterial

    look = {"baseColorFactor": COLOUR, "metallicFactor": 0.0, "roughnessFactor": 0.6}
    visual = TextureVisuals(material=PBRMaterial(name="mesh", **look))
    mesh = Trimesh(vertices.T, faces, process=False, visual=visual, metadata={"name": "mesh"})
    if to == "ply":
        return bytes(export_ply(mesh, encoding="binary", vertex_normal=False))
    scene = Scene()
    scene.add_geometry(mesh, node_name="mesh", geom_name="mesh")
    if to == "glb":
        return bytes(export_glb(scene, include_normals=False))
    text: str = export_obj(scene, include_normals=False, include_texture=False, header=None)
    return text.strip().encode() + b"\n"

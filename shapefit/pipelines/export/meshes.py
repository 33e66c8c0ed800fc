"""Mesh files of fitted images: one per image, named after its item."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats
from shapefit.config.commands.fit_sections import ExportConfig
from shapefit.convex.transforms import Transforms
from shapefit.dictionary.model import Dictionary
from shapefit.errors import input_error
from shapefit.io import ResultSet
from shapefit.io.atomic import StagedFiles, file_stem
from shapefit.meshes.export import Files, MeshFormat, mesh_files
from shapefit.meshes.wireframe import tubes
from shapefit.pipelines.export.carried_mesh import Pose, find_meshes, find_obstacle
from shapefit.pipelines.export.placement import ModelPlacement
from shapefit.pipelines.items import ChosenItems

Encode = Callable[[Floats], Files]
"""Takes the points of one image."""

BATCH = 64
"""Images whose vertices are in memory at a time."""

FARTHEST = 1e38
"""Coordinate that PLY and GLB can hold, in single precision."""


def check_mesh_export(
    options: ExportConfig, pose: Pose, dictionary: Dictionary, place: Path
) -> None:
    """Raise InputError where the dictionary, of the file `place`, or the method cannot give it."""
    meshes = find_meshes(dictionary)
    if meshes is None and dictionary.edges is None:
        fix = "learn it from shapes with `mesh_vertices` and `mesh_faces`, or with `edges`"
        raise input_error(place, "has neither a mesh nor edges to export", fix)
    obstacle = find_obstacle(pose)
    if meshes is not None and obstacle is not None:
        raise input_error("export", *obstacle)
    if options.unit == "dictionary":
        _check_size(pose, dictionary, place)


def choose_encoder(options: ExportConfig, dictionary: Dictionary) -> Encode:
    """Return what makes the files of one image, from its mesh vertices or the ends of its edges."""
    file_format = MeshFormat(options.format)
    meshes, edges = find_meshes(dictionary), dictionary.edges
    if meshes is not None:
        faces = meshes.faces
        return lambda points: mesh_files(points, faces, file_format)
    assert edges is not None  # see check_mesh_export
    return lambda points: mesh_files(*tubes(points, edges), file_format)


class MeshExport:
    """Writes the mesh files of the images that `export.items` chooses."""

    sheets: tuple[Path, ...] = ()
    """It draws no contact sheet."""

    def __init__(
        self, options: ExportConfig, pose: Pose, dictionary: Dictionary, files: StagedFiles
    ) -> None:
        """Take what `check_mesh_export` lets through."""
        self._options = options
        self._pose = pose
        self._dictionary = dictionary
        self._files = files
        self._encode = choose_encoder(options, dictionary)
        self._items = ChosenItems("export.items", options.items)
        self._farthest = np.inf if options.format == "obj" else FARTHEST
        self._written = self._missing = self._far = 0

    def add(self, found: ResultSet, _: Transforms | None) -> None:
        """Write the files of a chunk."""
        chosen = np.array([item in self._items for item in found.items], dtype=bool)
        fitted = has_shape(found)
        self._missing += int(np.count_nonzero(chosen & ~fitted))
        rows = np.flatnonzero(chosen & fitted)
        for start in range(0, len(rows), BATCH):
            part = rows[start : start + BATCH]
            self._write(found.take(part))

    @property
    def note(self) -> str:
        """How many images have files."""
        return f"{self._written} mesh{'' if self._written == 1 else 'es'}"

    @property
    def warnings(self) -> tuple[str, ...]:
        """What was asked for and is not there."""
        missing = f"images without a shape (failed, or with all coefficients 0): {self._missing}"
        far = f"images with coordinates beyond {FARTHEST:g}, too far for the format: {self._far}"
        fix = "take `export.format: obj`, or a larger unit"
        return (
            *((f"{missing}; they have no mesh",) if self._missing else ()),
            *((f"{far}; they have no mesh: {fix}",) if self._far else ()),
            *self._items.warnings,
        )

    def _write(self, found: ResultSet) -> None:
        points = self._points(ModelPlacement(self._options, self._pose, self._dictionary, found))
        for item, shape in zip(found.items, points, strict=True):
            if np.abs(shape).max() > self._farthest:
                self._far += 1
                continue
            stem = file_stem(item)
            for suffix, content in self._encode(shape).items():
                name = stem.with_name(stem.name + suffix)
                self._files.write(name, partial(Path.write_bytes, data=content), item)
            self._written += 1

    def _points(self, placement: ModelPlacement) -> Floats:
        """Return mesh vertices (n, 3, q) or ends of edges (n, 3, p)."""
        meshes = find_meshes(self._dictionary)
        return placement.landmarks() if meshes is None else placement.carry(meshes.vertices)


def has_shape(found: ResultSet) -> NDArray[np.bool_]:
    """Which of n images have a shape with an extent, a place and a rotation."""
    extent = np.ptp(found.shapes, axis=2).max(axis=1)
    turned = np.zeros(len(found)) if found.rotation is None else found.rotation.sum(axis=(1, 2))
    fitted: NDArray[np.bool_] = np.isfinite(extent + turned) & (extent > 0)
    return fitted


def _check_size(pose: Pose, dictionary: Dictionary, place: Path) -> None:
    """Raise InputError where the size in the unit of the dictionary cannot be known."""
    fix = "set `export.unit: landmarks`"
    if dictionary.atom_scale is None:
        found = "has no `atom_scale`, the sizes of its atoms"
        raise input_error(place, found, f"learn it with `method: exemplars`, or {fix}")
    if not pose.mixes_atoms:
        found = f"`method: {pose.method}` gives no coefficients, so the size is not known"
        raise input_error("export.unit", found, fix)

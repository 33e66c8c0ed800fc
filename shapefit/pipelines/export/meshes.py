"""Mesh files of fitted images: one per image, named after its item."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats
from shapefit.config import FitConfig
from shapefit.convex.transforms import Transforms
from shapefit.dictionary.model import Dictionary
from shapefit.errors import input_error, listed
from shapefit.io import ResultSet
from shapefit.io.atomic import StagedFiles, file_stem
from shapefit.lifting.methods import METHODS, those
from shapefit.meshes.dense import around_centroid, camera_frame, metric_scale
from shapefit.meshes.export import mesh_file, tubes
from shapefit.pipelines.items import ChosenItems

BATCH = 64
"""Images whose vertices are in memory at a time."""
FARTHEST = 1e38
"""Coordinate that PLY and GLB can hold, in single precision."""

Known = TypeVar("Known")


def mixes_atoms(config: FitConfig) -> bool:
    """Whether shapes are sum_i c_i R_i B_i, so that what belongs to atoms can be mixed alike.

    Refined under a perspective camera they always are.
    """
    method, perspective = METHODS[config.method], config.camera.model == "perspective"
    return method.mixes_atoms or (perspective and method.perspective == "refined")


def check_mesh_export(config: FitConfig, dictionary: Dictionary) -> None:
    """Raise InputError where the dictionary or the method of a fit cannot give meshes."""
    place = config.dictionary
    has_mesh = dictionary.mesh_vertices is not None
    if not has_mesh and dictionary.edges is None:
        fix = "learn it from shapes with `mesh_vertices` and `mesh_faces`, or with `edges`"
        raise input_error(place, "has neither a mesh nor edges to export", fix)
    if has_mesh and not mixes_atoms(config):
        found = f"`method: {config.method}` gives no coefficients to combine the atoms' meshes"
        fix = f"choose {listed(those(lambda method: method.mixes_atoms))}"
        raise input_error("export", found, fix)
    if config.export.unit == "dictionary":
        fix = "set `export.unit: landmarks`"
        if dictionary.atom_scale is None:
            found = "has no `atom_scale`, the sizes of its atoms"
            raise input_error(place, found, f"learn it with `method: exemplars`, or {fix}")
        if not mixes_atoms(config):
            found = f"`method: {config.method}` gives no coefficients, so the size is not known"
            raise input_error("export.unit", found, fix)


class MeshExport:
    """Writes the mesh files of the images that `export.items` chooses."""

    sheet: Path | None = None
    """It draws no contact sheet."""

    def __init__(self, config: FitConfig, dictionary: Dictionary, files: StagedFiles) -> None:
        """Take what `check_mesh_export` lets through."""
        options = config.export
        self._options = options
        self._config = config
        self._dictionary = dictionary
        self._files = files
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
            points = place_model(self._config, self._dictionary, found.take(part))
            for row, shape in zip(part, points, strict=True):
                self._write(found.items[row], shape)

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

    def _write(self, item: str, points: Floats) -> None:
        """Write the file of one image, from its mesh vertices (3, q) or landmarks (3, p)."""
        if np.abs(points).max() > self._farthest:
            self._far += 1
            return
        vertices, faces = points, self._dictionary.mesh_faces
        if faces is None:
            vertices, faces = tubes(points, required(self._dictionary.edges))
        content = mesh_file(vertices, faces, self._options.format)
        stem = file_stem(item)
        name = stem.with_name(f"{stem.name}.{self._options.format.removesuffix('-ascii')}")
        self._files.write(name, partial(Path.write_bytes, data=content), item)
        self._written += 1


def place_model(config: FitConfig, dictionary: Dictionary, found: ResultSet) -> Floats:
    """size * S + origin, in the frame of the object size * R^T S, for n images with a shape.

    S are the vertices of the mesh (n, 3, q), mixed and turned by one rotation per image, else the
    landmarks (n, 3, p), in normalised units around the centroid of the landmarks, in the
    directions of the camera.
    """
    R, s, T = (required(each) for each in (found.rotation, found.scale, found.translation))
    one, none = np.ones(len(found)), np.zeros((len(found), 2))
    meshes, c = dictionary.mesh_vertices, found.coefficients
    if meshes is None:
        points = around_centroid(found.shapes, s, T)
    else:
        points = camera_frame(meshes, required(c), R, one, none)
    size, origin = s, np.zeros((len(found), 3))
    if config.export.unit == "landmarks":
        origin[:, :2] = T
    else:
        size = metric_scale(dictionary.atoms, required(c), required(dictionary.atom_scale))
        if config.camera.model == "perspective":
            origin = np.asarray(found.columns["position"], dtype=float)
    if config.export.frame == "object":
        return np.asarray(size[:, None, None] * (R.swapaxes(1, 2) @ points))
    return np.asarray(size[:, None, None] * points + origin[:, :, None])


def has_shape(found: ResultSet) -> NDArray[np.bool_]:
    """Which of n images have a shape with an extent, a place and a rotation."""
    extent = np.ptp(found.shapes, axis=2).max(axis=1)
    turned = np.zeros(len(found)) if found.rotation is None else found.rotation.sum(axis=(1, 2))
    fitted: NDArray[np.bool_] = np.isfinite(extent + turned) & (extent > 0)
    return fitted


def required(values: Known | None) -> Known:
    """Return an optional value of a record that this fit is sure to have."""
    assert values is not None
    return values

"""Pictures of fitted images: one file per image, and a contact sheet of images spread over all."""

from __future__ import annotations

from functools import partial
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING

import numpy as np

from shapefit.arrays import Floats
from shapefit.config import FitConfig
from shapefit.convex.transforms import Transforms
from shapefit.dictionary.model import Dictionary
from shapefit.evaluation.plots import save
from shapefit.geometry.pinhole import Camera, depth_sign, project
from shapefit.io import ResultSet
from shapefit.io.atomic import StagedFiles, file_stem
from shapefit.lifting.methods import METHODS
from shapefit.meshes.dense import around_centroid, camera_frame, camera_frame_sheared
from shapefit.meshes.pictures import FittedImage, Model, contact_sheet, fit_picture
from shapefit.pipelines.export.meshes import has_shape, mixes_atoms, required
from shapefit.pipelines.items import ChosenItems, spread

if TYPE_CHECKING:
    from matplotlib.figure import Figure


SHEETS = (PurePosixPath("contact_sheet"), PurePosixPath("contact_sheet%"))
"""Names of the contact sheet: the usual one, and what the file of an item is never called."""


class PictureExport:
    """Draws the images that `pictures` chooses; the contact sheet when all have come."""

    def __init__(
        self, config: FitConfig, dictionary: Dictionary, files: StagedFiles, count: int
    ) -> None:
        """Take where the files go, and how many images will come."""
        self._config = config
        self._options = config.pictures
        self._dictionary = dictionary
        self._files = files
        self._items = ChosenItems("pictures.items", self._options.items)
        self._places = frozenset(spread(self._options.sheet, count))
        self._sheet: list[FittedImage] = []
        self.sheet: Path | None = None
        self._awaited = count
        self._come = self._drawn = self._missing = 0

    def add(self, found: ResultSet, transforms: Transforms | None) -> None:
        """Draw the chosen images of a chunk; transforms where the method has them.

        Images without a shape are drawn alone only if an item is called so: a glob means others.
        """
        model = Model(found.y_axis, self._dictionary.mesh_faces, self._dictionary.edges)
        fitted = has_shape(found)
        for row, item in enumerate(found.items):
            alone = item in self._items and self._drawn < self._options.most
            if alone and not fitted[row] and item not in self._options.items:
                self._missing += 1
                alone = False
            on_sheet = self._come + row in self._places
            if not (alone or on_sheet):
                continue
            turned = None if transforms is None else transforms.take([row])
            one = found.take([row])
            image = fitted_image(one, turned, self._config, self._dictionary)
            if on_sheet:
                self._sheet.append(image)
            if alone:
                self._save(file_stem(item), fit_picture([image], model), item)
                self._drawn += 1
        self._come += len(found)
        if self._sheet and self._come == self._awaited:
            stem = next(stem for stem in SHEETS if self._named(stem) not in self._files)
            self._save(stem, contact_sheet(self._sheet, model), "contact sheet")
            self.sheet = self._files.folder / self._named(stem)

    @property
    def note(self) -> str:
        """How many images have a picture of their own, and how many the contact sheet shows."""
        alone = f"{self._drawn} picture{'' if self._drawn == 1 else 's'}"
        return f"{alone}, contact sheet of {len(self._sheet)}" if self._sheet else alone

    @property
    def warnings(self) -> tuple[str, ...]:
        """What was asked for and is not there."""
        found = f"images without a shape (failed, or with all coefficients 0): {self._missing}"
        fix = "they have no picture unless `pictures.items` lists them"
        return ((f"{found}; {fix}",) if self._missing else ()) + self._items.warnings

    def _save(self, stem: PurePosixPath, figure: Figure, item: str) -> None:
        draw = partial(save, figure, file_format="png")
        self._files.write(self._named(stem), draw, item)

    def _named(self, stem: PurePosixPath) -> PurePosixPath:
        return stem.with_name(f"{stem.name}.png")


def fitted_image(
    found: ResultSet, transforms: Transforms | None, config: FitConfig, dictionary: Dictionary
) -> FittedImage:
    """Gather one image (n = 1); without mesh where that cannot follow, all nan without a shape.

    The mesh has one rotation. Where the camera sees it is another matter: there it is projected as
    the fit projects it, with a rotation per atom (convex) or in perspective, so that it lies under
    the fitted landmarks.
    """
    extras = found.columns
    outliers = np.asarray(extras["outliers"][0], dtype=bool) if "outliers" in extras else None
    landmarks = np.asarray(extras["landmarks"][0], dtype=float).T
    (title,) = found.items
    if not has_shape(found)[0]:
        nowhere = np.full_like(found.shapes[0], np.nan)
        return FittedImage(title, landmarks, nowhere, nowhere[:2], outliers=outliers)
    place = required(found.scale), required(found.translation)
    atoms = dictionary.mesh_vertices if mixes_atoms(config) else None
    perspective = config.camera.model == "perspective"
    mesh = seen_mesh = None
    if atoms is not None:
        c, R = required(found.coefficients), required(found.rotation)
        mesh = seen_mesh = camera_frame(atoms, c, R, *place)
        if not (perspective or METHODS[config.method].one_rotation):
            M, orthogonal = required(transforms).dense(), config.rotations == "orthogonal"
            seen_mesh = camera_frame_sheared(atoms, M, *place, orthogonal=orthogonal)

    def as_seen(points: Floats) -> Floats:
        """Where (2, q) the camera sees points (1, 3, q) of the frame and unit of the shapes."""
        if not perspective:
            return points[0, :2]
        t, focal, centre = (
            np.asarray(extras[name], dtype=float)
            for name in ("camera_translation", "focal", "principal_point")
        )
        camera = Camera(focal, centre, depth_sign(found.y_axis))
        return project(camera, around_centroid(points, *place) + t[:, :, None])[0]

    return FittedImage(
        title=title,
        landmarks=landmarks,
        shape=found.shapes[0],
        seen=as_seen(found.shapes),
        mesh=None if mesh is None else mesh[0],
        seen_mesh=None if seen_mesh is None else as_seen(seen_mesh),
        outliers=outliers,
        sd=None if found.shape_sd is None else found.shape_sd[0],
        rotation=required(found.rotation)[0],
    )

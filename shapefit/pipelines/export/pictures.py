"""Pictures of fitted images: one file per image, and a contact sheet of images spread over all."""

from __future__ import annotations

from functools import partial
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING

from shapefit.config.commands.fit_sections import PicturesConfig
from shapefit.convex.transforms import Transforms
from shapefit.dictionary.model import Dictionary
from shapefit.evaluation.plots import save
from shapefit.io import ResultSet
from shapefit.io.atomic import StagedFiles, file_stem
from shapefit.meshes.pictures import FittedImage, Model, contact_sheet, fit_picture
from shapefit.pipelines.export.carried_mesh import Pose
from shapefit.pipelines.export.fitted_images import fitted_image
from shapefit.pipelines.export.meshes import has_shape
from shapefit.pipelines.items import ChosenItems, spread

if TYPE_CHECKING:
    from matplotlib.figure import Figure


SHEETS = (PurePosixPath("contact_sheet"), PurePosixPath("contact_sheet%"))
"""Names of the contact sheet: the usual one, and what the file of an item is never called."""


class PictureExport:
    """Draws the images that `pictures` chooses; the contact sheet when all have come."""

    def __init__(
        self,
        options: PicturesConfig,
        pose: Pose,
        dictionary: Dictionary,
        files: StagedFiles,
        count: int,
    ) -> None:
        """Take where the files go, and how many images will come."""
        self._options = options
        self._pose = pose
        self._dictionary = dictionary
        self._files = files
        self._items = ChosenItems("pictures.items", options.items)
        self._places = frozenset(spread(options.sheet, count))
        self._sheet: list[FittedImage] = []
        self.sheets: tuple[Path, ...] = ()
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
            image = fitted_image(one, turned, self._pose, self._dictionary)
            if on_sheet:
                self._sheet.append(image)
            if alone:
                self._save(file_stem(item), fit_picture([image], model), item)
                self._drawn += 1
        self._come += len(found)
        if self._sheet and self._come == self._awaited:
            stem = next(stem for stem in SHEETS if self._named(stem) not in self._files)
            self._save(stem, contact_sheet(self._sheet, model), "contact sheet")
            self.sheets = (self._files.folder / self._named(stem),)

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

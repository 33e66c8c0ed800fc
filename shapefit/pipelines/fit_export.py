"""What `fit` makes to be opened and looked at, beside its result: meshes and pictures."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from shapefit.config import FitConfig
from shapefit.dictionary.model import Dictionary
from shapefit.errors import input_error
from shapefit.io import ResultSet
from shapefit.io.atomic_folder import staged_files
from shapefit.io.sources import is_stream
from shapefit.pipelines.mesh_export import MeshExport, check_mesh_export
from shapefit.pipelines.picture_export import PictureExport, check_pictures
from shapefit.pipelines.report_folder import check_folder

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Exports:
    """Takes the results of a fit, chunk by chunk, to the exporters that the config asks for."""

    exporters: Sequence[MeshExport | PictureExport]
    folders: tuple[Path, ...]

    def add(self, found: ResultSet, transforms: Floats | None) -> None:
        """Export a chunk; transforms (n, k, 2, 3) where the method has them."""
        for exporter in self.exporters:
            exporter.add(found, transforms)

    @property
    def note(self) -> str:
        """What there is, counted."""
        return ", ".join(exporter.note for exporter in self.exporters)

    @property
    def warnings(self) -> tuple[str, ...]:
        """What was asked for and is not there."""
        return tuple(text for exporter in self.exporters for text in exporter.warnings)


@contextmanager
def open_exports(config: FitConfig, dictionary: Dictionary, count: int) -> Iterator[Exports]:
    """Give what exports the results of `count` images; the files appear on a clean exit.

    Raises InputError for everything that can be known to be wrong beforehand: folders, the
    dictionary, the method, matplotlib.
    """
    meshes, pictures = config.export.folder, config.pictures.folder
    if meshes is not None:
        _check_folder(meshes, "export.folder")
        check_mesh_export(config, dictionary)
    if pictures is not None:
        _check_folder(pictures, "pictures.folder")
        check_pictures()
    exporters: list[MeshExport | PictureExport] = []
    with ExitStack() as stack:
        if meshes is not None:
            files = stack.enter_context(staged_files(meshes))
            exporters.append(MeshExport(config, dictionary, files))
        if pictures is not None:
            files = stack.enter_context(staged_files(pictures))
            exporters.append(PictureExport(config, dictionary, files, count))
        yield Exports(exporters, tuple(dict.fromkeys(filter(None, (meshes, pictures)))))


def _check_folder(folder: Path, key: str) -> None:
    if is_stream(folder):
        raise input_error(key, "- is standard output", "give the name of a folder")
    check_folder(folder)

"""What `fit` makes to be opened and looked at, beside its result: meshes and pictures."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from shapefit.config import FitConfig
from shapefit.convex.transforms import Transforms
from shapefit.dictionary.model import Dictionary
from shapefit.errors import input_error
from shapefit.io import ResultSet
from shapefit.io.atomic import StagedFiles, check_folder, refuse_folder, staged_files
from shapefit.io.inputs import is_stream
from shapefit.stores import real_path

if TYPE_CHECKING:
    from shapefit.pipelines.export.meshes import MeshExport
    from shapefit.pipelines.export.pictures import PictureExport


@dataclass(frozen=True)
class Exports:
    """Takes the results of a fit, chunk by chunk, to the exporters that the config asks for."""

    exporters: Sequence[MeshExport | PictureExport]
    staged: Sequence[StagedFiles]

    def add(self, found: ResultSet, transforms: Transforms | None) -> None:
        """Export a chunk; transforms where the method has them."""
        for exporter in self.exporters:
            exporter.add(found, transforms)

    @property
    def written(self) -> tuple[Path, ...]:
        """The folders that get files, and the contact sheet."""
        sheets = [exporter.sheet for exporter in self.exporters if exporter.sheet]
        return (*(files.folder for files in self.staged if not files.empty), *sheets)

    @property
    def note(self) -> str:
        """What there is, counted."""
        return ", ".join(exporter.note for exporter in self.exporters)

    @property
    def warnings(self) -> tuple[str, ...]:
        """What was asked for and is not there."""
        return tuple(text for exporter in self.exporters for text in exporter.warnings)


def check_exports(config: FitConfig, dictionary: Dictionary) -> None:
    """Raise InputError for all of meshes and pictures that can be known to be wrong beforehand.

    That is folders, the dictionary, the method, matplotlib. What exports need is imported here.
    """
    output, meshes, pictures = config.output, config.export, config.pictures
    assert isinstance(output, Path), "a folder of results has no exports"
    if meshes.folder is not None:
        _check_folder(meshes.folder, "export.folder", output, meshes.format.removesuffix("-ascii"))
        from shapefit.pipelines.export.meshes import check_mesh_export

        check_mesh_export(config, dictionary)
    if pictures.folder is not None:
        _check_folder(pictures.folder, "pictures.folder", output, "png")
        from shapefit.evaluation.plots import check_can_draw

        check_can_draw("pictures")
        import_module("shapefit.pipelines.export.pictures")


@contextmanager
def open_exports(config: FitConfig, dictionary: Dictionary, count: int) -> Iterator[Exports]:
    """Give what exports the results of `count` images; the files appear on a clean exit."""
    exporters: list[MeshExport | PictureExport] = []
    staged: dict[str, StagedFiles] = {}
    with ExitStack() as stack:

        def stage(folder: Path) -> StagedFiles:
            """Have one folder staged once, so that its files do not clash unseen."""
            place = os.path.realpath(folder)
            if place not in staged:
                staged[place] = stack.enter_context(staged_files(folder))
            return staged[place]

        if config.export.folder is not None:
            from shapefit.pipelines.export.meshes import MeshExport

            exporters.append(MeshExport(config, dictionary, stage(config.export.folder)))
        if config.pictures.folder is not None:
            from shapefit.pipelines.export.pictures import PictureExport

            files = stage(config.pictures.folder)
            exporters.append(PictureExport(config, dictionary, files, count))
        yield Exports(exporters, tuple(staged.values()))


def _check_folder(folder: Path, key: str, output: Path, suffix: str) -> None:
    """Raise InputError for a folder that cannot get files, or one that could replace the result."""
    if is_stream(folder):
        raise input_error(key, "- is standard output", "give the name of a folder")
    refuse_folder(folder)
    result = real_path(output)
    if real_path(folder) == result:
        found = f"{folder} is also the output"
        raise input_error(key, found, "give the folder a different name")
    if os.path.islink(folder) and not os.path.exists(folder):
        found = f"it is a link to {os.path.realpath(folder)}, which does not exist"
        raise input_error(folder, found, "create that folder, or remove the link")
    check_folder(folder)
    if result.is_relative_to(real_path(folder)) and result.suffix.lower() == f".{suffix}":
        found = f"has the same name as the .{suffix} files that go into {folder}"
        raise input_error(output, found, "name it .h5 or .csv")

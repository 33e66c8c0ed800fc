"""What `fit` makes to be opened and looked at, beside its result: meshes and pictures."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from shapefit.config import FitConfig
from shapefit.config.commands.fit_sections import ExportConfig, PicturesConfig, ViewingConfig
from shapefit.convex.transforms import Transforms
from shapefit.dictionary.model import Dictionary
from shapefit.errors import input_error
from shapefit.io import ResultSet
from shapefit.io.atomic import StagedFiles, check_folder, refuse_folder, staged_files
from shapefit.io.inputs import is_stream
from shapefit.pipelines.drawing import check_can_draw
from shapefit.pipelines.export.pose import Pose
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
    def folders(self) -> tuple[Path, ...]:
        """The folders that get files."""
        return tuple(files.folder for files in self.staged if not files.empty)

    @property
    def sheets(self) -> tuple[Path, ...]:
        """The contact sheet, where there is one."""
        return tuple(sheet for exporter in self.exporters for sheet in exporter.sheets)

    @property
    def note(self) -> str:
        """What there is, counted."""
        return ", ".join(exporter.note for exporter in self.exporters)

    @property
    def warnings(self) -> tuple[str, ...]:
        """What was asked for and is not there."""
        return tuple(text for exporter in self.exporters for text in exporter.warnings)


class ExportPlan(NamedTuple):
    """The meshes and pictures that a fit is to have beside its result; those with a folder."""

    meshes: ExportConfig
    pictures: PicturesConfig
    pose: Pose

    def seen_through(self, camera: ViewingConfig) -> ExportPlan:
        """Return the plan once it is settled which camera sees the images."""
        return self._replace(pose=self.pose._replace(perspective=camera.model == "perspective"))


def plan_exports(config: FitConfig, dictionary: Dictionary) -> ExportPlan:
    """Return what the config asks for.

    Raises InputError for everything that can be known to be wrong beforehand: folders, the
    dictionary, the method, matplotlib. What exports need is imported here.
    """
    output, meshes, pictures = config.output, config.export, config.pictures
    assert isinstance(output, Path), "a folder of results has no exports"
    pose = Pose(config.method, config.rotations, config.camera.model == "perspective")
    if meshes.folder is not None:
        _check_folder(meshes.folder, "export.folder", output)
        _check_output(output, meshes.folder, meshes.format.removesuffix("-ascii"))
        from shapefit.pipelines.export.meshes import check_mesh_export

        check_mesh_export(meshes, pose, dictionary, config.dictionary)
    if pictures.folder is not None:
        _check_folder(pictures.folder, "pictures.folder", output)
        _check_output(output, pictures.folder, "png")
        check_can_draw("pictures")
        import_module("shapefit.pipelines.export.pictures")
    return ExportPlan(meshes, pictures, pose)


@contextmanager
def open_exports(plan: ExportPlan, dictionary: Dictionary, count: int) -> Iterator[Exports]:
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

        meshes, pictures, pose = plan
        if meshes.folder is not None:
            from shapefit.pipelines.export.meshes import MeshExport

            exporters.append(MeshExport(meshes, pose, dictionary, stage(meshes.folder)))
        if pictures.folder is not None:
            from shapefit.pipelines.export.pictures import PictureExport

            files = stage(pictures.folder)
            exporters.append(PictureExport(pictures, pose, dictionary, files, count))
        yield Exports(exporters, tuple(staged.values()))


def _check_folder(folder: Path, key: str, output: Path) -> None:
    if is_stream(folder):
        raise input_error(key, "- is standard output", "give the name of a folder")
    refuse_folder(folder)
    if real_path(folder) == real_path(output):
        found = f"{folder} is also the output"
        raise input_error(key, found, "give the folder a different name")
    if os.path.islink(folder) and not os.path.exists(folder):
        found = f"it is a link to {os.path.realpath(folder)}, which does not exist"
        raise input_error(folder, found, "create that folder, or remove the link")
    check_folder(folder)


def _check_output(output: Path, folder: Path, suffix: str) -> None:
    """Raise InputError where the result could replace a file that is exported."""
    resolved = real_path(output)
    if resolved.is_relative_to(real_path(folder)) and resolved.suffix.lower() == f".{suffix}":
        found = f"has the same name as the .{suffix} files that go into {folder}"
        raise input_error(output, found, "name it .h5 or .csv")

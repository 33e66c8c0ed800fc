"""Meshes of a result, which `fit` writes as `convert` does."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from shapefit.config import FitConfig
from shapefit.dictionary.model import Dictionary
from shapefit.errors import input_error
from shapefit.io.formats import HDF5, find_target_format
from shapefit.lifting.methods import METHODS
from shapefit.pipelines.result import Counted, Result


def check_export(config: FitConfig, dictionary: Dictionary) -> None:
    """Raise InputError if a config asks for meshes that its results cannot have."""
    if config.export.folder is None:
        return
    from shapefit.io.atomic import check_folder
    from shapefit.pipelines.meshes import check_has_meshes

    if find_target_format(Path(str(config.output))) is not HDF5:
        fix = "write the result as HDF5, -o result.h5"
        raise input_error("export.folder", "meshes are made of a result in HDF5", fix)
    check_folder(config.export.folder)
    method = METHODS[config.method]
    refined = config.camera.focal != "none" and method.perspective == "refined"
    mixes_atoms = method.mixes_atoms or refined
    check_has_meshes(dictionary, config.dictionary, mixes_atoms=mixes_atoms)


def export_meshes(config: FitConfig) -> Iterator[Result]:
    """Write the meshes of the result, if the config asks for them."""
    if config.export.folder is None:
        return
    from shapefit.pipelines.meshes import write_meshes

    result = (Path(str(config.output)),)
    folder = config.export.folder
    written = 0
    for part in write_meshes(result, config.dictionary, folder, config.export.format):
        warnings = part.warnings
        if part.failures:
            without = Counted(len(part.failures), "image", "without a shape and a mesh")
            warnings = (*warnings, without)
        written += part.done
        note = part.note or f"meshes of {written:,} of {part.total:,} images"
        # Its images are counted already, and those that failed.
        yield part._replace(
            done=0, total=None, failures=(), warnings=warnings, note=note
        )

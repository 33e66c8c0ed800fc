"""Folders of results that a run has not finished, told to who reads them."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path


def describe_unfinished(files: Iterable[Path]) -> tuple[str, ...]:
    """Return a warning for each folder of results whose run has not done all parts.

    files: the results that are read; a part that is read by itself is no such folder.
    """
    given = {*files}
    folders = sorted({file.parent for file in given if file.name.startswith("part-")})
    if not folders:
        return ()
    from shapefit.config.manifest import part_name
    from shapefit.pipelines.partition.manifest import read_manifest

    warnings = []
    for folder in folders:
        manifest = read_manifest(folder)
        if manifest is None or not {folder / name for name in manifest.done} <= given:
            continue
        planned = {part_name(number) for number in manifest.run.parts}
        missing = planned - manifest.done.keys()
        if missing:
            warnings.append(
                f"{folder}: {len(missing):,} of its {len(planned):,} parts have no"
                " result: run the same `fit` again"
            )
    return tuple(warnings)

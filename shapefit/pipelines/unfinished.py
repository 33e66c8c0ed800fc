"""Folders of results that a run has not finished, told to who reads them."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path


def describe_unfinished(files: Iterable[Path]) -> tuple[str, ...]:
    """Return a warning for each folder of results whose run has not done all parts.

    files: the results that are read; a part that is read by itself is no such folder.
    """
    parts = [file for file in files if file.name.startswith("part-")]
    if not parts:
        return ()
    from shapefit.pipelines.partition.manifest import find_whole_folders

    return tuple(
        f"{folder}: {len(manifest.missing):,} of its {len(manifest.run.parts):,} parts"
        " have no result: run the same `fit` again"
        for folder, manifest in find_whole_folders(parts)
        if manifest.missing
    )

"""What a folder of results holds, as its manifest says."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from shapefit.config.paths import ResultFolder
from shapefit.errors import counted
from shapefit.io.memory import in_words
from shapefit.pipelines.parts.manifest import Manifest, read_manifest


def find_folders(files: Sequence[Path]) -> dict[Path, Manifest]:
    """Return the folders whose results, two or more, are all among the files; their manifests.

    Raises InputError for a manifest that cannot be read.
    """
    given = set(files)
    found: dict[Path, Manifest] = {}
    for folder in dict.fromkeys(file.parent for file in files):
        manifest = read_manifest(ResultFolder(folder).manifest)
        if (
            manifest
            and len(manifest.parts) > 1
            and {folder / name for name in manifest.parts} <= given
        ):
            found[folder] = manifest
    return found


def sum_up(parts: Mapping[str, Mapping[str, object]]) -> list[tuple[str, str]]:
    """Return how many parts and images there are, how large, and the seconds that they took."""

    def total(key: str) -> float:
        values = (entry.get(key) for entry in parts.values())
        return sum(value for value in values if isinstance(value, int | float))

    images, failed, seconds = int(total("images")), int(total("failed")), total("seconds")
    rate = f", {images / seconds:,.0f} images/s" if seconds else ""
    return [
        ("parts", f"{len(parts):,}, {in_words(int(total('bytes')))}"),
        ("images", f"{images:,}" + (f", {failed:,} without a shape" if failed else "")),
        ("time", f"{counted(round(seconds), 'second')} in all parts{rate}"),
    ]

"""`manifest.jsonl`: what a folder of results holds, and of what, so that a run can go on.

Its first line is of the run: what was estimated, digests of what all parts depend on, and at the
end how many parts and images there are. Each other line is of a part, added when the part ends.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from shapefit import __version__
from shapefit.config.paths import DONE, MANIFEST, manifest_lines
from shapefit.errors import InputError, counted, input_error
from shapefit.io.atomic import append_bytes, atomic_path, check_folder
from shapefit.io.inputs import in_words
from shapefit.pipelines.partition.plan import Key

LOCK = ".lock"

Entry = dict[str, Any]


@dataclass
class Manifest:
    """A manifest: the line of the run, and the last line of each part by the name of its file."""

    path: Path
    run: Mapping[str, Any]
    parts: dict[str, Entry] = field(default_factory=dict)

    @property
    def done(self) -> dict[str, Entry]:
        """The lines of the parts that have a result."""
        return {file: entry for file, entry in self.parts.items() if entry["status"] == DONE}

    def write(self) -> None:
        """Write the manifest, whole or not at all, with the numbers of parts and images."""
        numbers = {
            "parts": len(self.parts),
            "images": sum(entry["images"] for entry in self.done.values()),
        }
        first = {"shapefit": __version__, **self.run, **numbers}
        with atomic_path(self.path) as temporary, temporary.open("wb") as file:
            file.writelines(map(_line, (first, *self.parts.values())))

    def add(self, entry: Entry) -> None:
        """Add the line of a part."""
        self.parts[entry["file"]] = entry
        append_bytes(self.path, _line(entry))


def _line(entry: Mapping[str, Any]) -> bytes:
    return json.dumps(entry).encode() + b"\n"


def read_manifest(folder: Path) -> Manifest | None:
    """Read the manifest of a folder; None where there is none.

    Raises InputError where it is something else, or cannot be read.
    """
    try:
        lines = manifest_lines(folder)
    except ValueError as error:
        raise InputError([str(error)]) from None
    if lines is None:
        return None
    run, *parts = lines
    return Manifest(folder / MANIFEST, run, {entry["file"]: entry for entry in parts})


def key_of(entry: Entry) -> Key:
    """Return what the part of a line was made of: paths of the inputs, and rows."""
    return tuple(entry["inputs"]), None if entry["rows"] is None else tuple(entry["rows"])


def find_gaps(manifest: Manifest) -> list[str]:
    """Say what a manifest lacks by its own numbers: lines of parts, images, rows of a file.

    That of a run that was killed has fewer numbers than lines; such a run is not complete.
    """
    found = []
    images = sum(entry["images"] for entry in manifest.done.values())
    for name, there in (("parts", len(manifest.parts)), ("images", images)):
        if manifest.run.get(name) != there:
            found.append(f"lists {there} {name}, and counts {manifest.run.get(name)}")
    reached: dict[tuple[str, ...], int] = {}
    for inputs, rows in sorted(key_of(entry) for entry in manifest.parts.values() if entry["rows"]):
        assert rows is not None
        if rows[0] != reached.get(inputs, 0):
            found.append(f"has no part of rows {reached.get(inputs, 0)} to {rows[0] - 1}")
        reached[inputs] = rows[1]
    for file, entry in manifest.done.items():
        if entry["rows"] and entry["images"] != entry["rows"][1] - entry["rows"][0]:
            found.append(f"has {entry['images']} images of other rows in {file}")
    return found


def result_digest(path: Path) -> str | None:
    """SHA-256 of a result; None where there is no regular file."""
    if not path.is_file():
        return None
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def clear_way(folder: Path, name: str) -> None:
    """Remove a symbolic link in a folder of results: what is written must not go elsewhere."""
    if (folder / name).is_symlink():
        (folder / name).unlink()


@contextmanager
def held_folder(folder: Path) -> Iterator[None]:
    """Hold a folder of results for this run.

    Raises InputError where another run holds it, and where it cannot be made or written to.
    """
    check_folder(folder)
    folder.mkdir(parents=True, exist_ok=True)
    for name in (LOCK, MANIFEST):
        clear_way(folder, name)
    try:
        import fcntl
    except ImportError:  # without such locks a second run is not noticed
        yield
        return
    with (folder / LOCK).open("w") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            found = "another run is writing results to it"
            raise input_error(folder, found, "wait until it ends, or choose another") from None
        except OSError:  # a file system without locks
            pass
        yield


def find_folders(files: Sequence[Path]) -> dict[Path, Manifest]:
    """Return the folders whose results, two or more, are all among the files; their manifests.

    Raises InputError for a manifest that cannot be read.
    """
    given, found = set(files), dict[Path, Manifest]()
    for folder in dict.fromkeys(file.parent for file in files):
        manifest = read_manifest(folder)
        results = set() if manifest is None else {folder / name for name in manifest.done}
        if manifest is not None and len(results) > 1 and results <= given:
            found[folder] = manifest
    return found


def sum_up(parts: Mapping[str, Mapping[str, Any]]) -> list[tuple[str, str]]:
    """Return how many parts and images there are, how large, and the seconds that they took."""
    images, failed, size, seconds = (
        sum(entry.get(key) or 0 for entry in parts.values())
        for key in ("images", "failed", "bytes", "seconds")
    )
    rate = f", {images / seconds:,.0f} images/s" if seconds else ""
    return [
        ("parts", f"{len(parts):,}, {in_words(int(size))}"),
        ("images", f"{images:,}" + (f", {failed:,} without a shape" if failed else "")),
        ("time", f"{counted(round(seconds), 'second')} in all parts{rate}"),
    ]

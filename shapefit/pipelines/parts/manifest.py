"""`manifest.jsonl`: what a folder of results holds, and of what, so that a run can go on.

Its first line is of the run: what was estimated, and digests of what all parts depend on. Each
other line is of a part, added when the part ends.
"""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from shapefit import __version__
from shapefit.config.paths import DONE, MANIFEST, ResultFolder, manifest_lines
from shapefit.errors import InputError, counted, input_error
from shapefit.io.atomic import append_bytes, atomic_path, check_folder
from shapefit.io.inputs import in_words
from shapefit.stores import UrlPath, find_state, held_object

LOCK = ".lock"

PAUSE = 10.0
"""Seconds between the times that the manifest is written to a store, whose objects cannot grow."""

Entry = dict[str, Any]


@dataclass
class Manifest:
    """A manifest: the line of the run, and the last line of each part by the name of its file."""

    path: Path
    run: Mapping[str, Any]
    parts: dict[str, Entry] = field(default_factory=dict)
    written: float = 0.0

    @property
    def done(self) -> dict[str, Entry]:
        """The lines of the parts that have a result."""
        return {file: entry for file, entry in self.parts.items() if entry["status"] == DONE}

    def write(self) -> None:
        """Write the manifest, whole or not at all."""
        first = {"shapefit": __version__, **self.run}
        with atomic_path(self.path) as temporary, temporary.open("wb") as file:
            file.writelines(map(_line, (first, *self.parts.values())))
        self.written = time.monotonic()

    def add(self, entry: Entry) -> None:
        """Add the line of a part."""
        self.parts[entry["file"]] = entry
        if isinstance(self.path, UrlPath):
            if time.monotonic() > self.written + PAUSE:
                self.write()
            return
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


def result_digest(path: Path) -> str | None:
    """SHA-256 of a result, or the etag of one in a store; None where there is none."""
    if isinstance(path, UrlPath):
        state = find_state(path)
        return None if state is None else str(state[1])
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError:
        return None


def clear_way(folder: Path, name: str) -> None:
    """Remove a symbolic link in a folder of results: what is written must not go elsewhere."""
    if not isinstance(folder, UrlPath) and (folder / name).is_symlink():
        (folder / name).unlink()


@contextmanager
def held_folder(folder: Path) -> Iterator[None]:
    """Hold a folder of results for this run.

    Raises InputError where another run holds it, and where it cannot be made or written to.
    """
    if isinstance(folder, UrlPath):
        with held_object(folder / LOCK) as held:
            if not held:
                raise _busy(folder, f" (if it was killed, remove {folder / LOCK})")
            yield
        return
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
            raise _busy(folder) from None
        except OSError:  # a file system without locks
            pass
        yield


def _busy(folder: Path, until: str = "") -> InputError:
    found = "another run is writing results to it"
    return input_error(folder, found, f"wait until it ends{until}, or choose another")


def find_folders(files: Sequence[Path]) -> dict[Path, Manifest]:
    """Return the folders whose results, two or more, are all among the files; their manifests.

    Raises InputError for a manifest that cannot be read.
    """
    given, found = set(files), dict[Path, Manifest]()
    for folder in dict.fromkeys(file.parent for file in files):
        manifest = read_manifest(ResultFolder(folder).path)
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

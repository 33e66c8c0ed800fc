"""`manifest.jsonl`: what a folder of results holds, and of what, so that a run can go
on.

Its first line is of the run; each other line is of a part, added when the part ends.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from shapefit import __version__
from shapefit.config.paths import DONE, MANIFEST, manifest_lines
from shapefit.errors import abbreviate, input_error, path_text, printable
from shapefit.io.atomic import atomic_path, check_folder, storage_errors
from shapefit.io.inputs import in_words

LOCK = ".lock"

Entry = dict[str, Any]
"""The line of a part: what it is made of (see Part.describe), its status, counts and
size.
"""

State = tuple[int, int]
"""Size and time of change of a file."""


class Part(NamedTuple):
    """Images that become one result file, which keeps its name when inputs are added.

    inputs are a file, or those of one recording, with their states; rows None are all.
    """

    file: str
    inputs: tuple[Path, ...]
    rows: tuple[int, int] | None
    states: tuple[State, ...]

    @property
    def slice(self) -> slice | None:
        """The rows, as files are opened with."""
        return None if self.rows is None else slice(*self.rows)

    def describe(self) -> Entry:
        """Return what the part is made of, as the manifest states it."""
        return {
            "file": self.file,
            "inputs": list(map(path_text, self.inputs)),
            "rows": None if self.rows is None else list(self.rows),
            "states": list(map(list, self.states)),
        }

    def __str__(self) -> str:
        rows = (
            "" if self.rows is None else f", rows {self.rows[0]} to {self.rows[1] - 1}"
        )
        return abbreviate([printable(path) for path in self.inputs]) + rows


@dataclass
class Manifest:
    """A manifest: the line of the run, and the last line of each part by the name of
    its file.
    """

    path: Path
    run: Mapping[str, Any]
    parts: dict[str, Entry] = field(default_factory=dict)

    @property
    def done(self) -> dict[str, Entry]:
        """The lines of the parts that have a result."""
        return {
            file: entry for file, entry in self.parts.items() if entry["status"] == DONE
        }

    def write(self) -> None:
        """Write the manifest, whole or not at all."""
        lines = ({"shapefit": __version__, **self.run}, *self.parts.values())
        with atomic_path(self.path) as temporary:
            temporary.write_bytes(
                b"".join(json.dumps(line).encode() + b"\n" for line in lines)
            )

    def add(self, entry: Entry) -> None:
        """Add the line of a part."""
        self.parts[entry["file"]] = entry
        with storage_errors(self.path, None), self.path.open("ab", buffering=0) as file:
            file.write(json.dumps(entry).encode() + b"\n")


def read_manifest(folder: Path) -> Manifest | None:
    """Read the manifest of a folder, None without one. Raises InputError for something
    else.
    """
    lines = manifest_lines(folder)
    if lines is None:
        return None
    return Manifest(
        folder / MANIFEST, lines[0], {entry["file"]: entry for entry in lines[1:]}
    )


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Hold a folder of results for this run. Raises InputError where that cannot be."""
    check_folder(folder)
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / LOCK).open("w") as file:
        try:
            import fcntl

            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            fault = "another run is writing results to it"
            raise input_error(
                folder, fault, "wait until it ends, or choose another"
            ) from None
        except (ImportError, OSError):  # a system or a disk without locks
            pass
        yield


def find_folders(files: Sequence[Path]) -> dict[Path, Manifest]:
    """Return the folders whose results, two or more, are all among the files; their
    manifests.
    """
    folders: dict[Path, Manifest] = {}
    for folder in dict.fromkeys(file.parent for file in files):
        if (manifest := read_manifest(folder)) is not None:
            results = {folder / name for name in manifest.done}
            if len(results) > 1 and results <= set(files):
                folders[folder] = manifest
    return folders


def sum_up(parts: Mapping[str, Entry]) -> list[tuple[str, str]]:
    """Return how many parts and images they are, and how large, for people."""
    keys = ("images", "failed", "bytes")
    images, failed, size = (sum(entry[key] for entry in parts.values()) for key in keys)
    without = f", {failed:,} without a shape" if failed else ""
    return [
        ("parts", f"{len(parts):,}, {in_words(size)}"),
        ("images", f"{images:,}{without}"),
    ]

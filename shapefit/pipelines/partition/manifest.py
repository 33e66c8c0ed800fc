"""What a folder of results holds, so that a run can go on; one run at a time."""

from __future__ import annotations

import json
import os
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any, NamedTuple

from shapefit.config.manifest import (
    DONE,
    EARLIER_MANIFEST,
    MANIFEST,
    ManifestLine,
    PartLine,
    PartStatus,
    RunLine,
    part_name,
    read_lines,
)
from shapefit.errors import abbreviate, input_error, path_text, printable
from shapefit.io.atomic import atomic_path, check_folder, storage_errors
from shapefit.io.inputs import State, format_bytes
from shapefit.pipelines.result import Numbers

LOCK_FILE = ".lock"
"""In a folder to which a run writes results."""

PARTS_PATTERN = "part-*"
"""Files that are results in a folder, of this version or an earlier one."""


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
        """Return the rows as a slice, None for all."""
        return None if self.rows is None else slice(*self.rows)

    def line(self, status: PartStatus, **outcome: Any) -> PartLine:
        """Return the line of the part in the manifest, with its status and outcome."""
        return PartLine(
            file=self.file,
            inputs=tuple(map(path_text, self.inputs)),
            rows=self.rows,
            states=self.states,
            status=status,
            **outcome,
        )

    def __str__(self) -> str:
        name = abbreviate([printable(path) for path in self.inputs])
        if self.rows is None:
            return name
        start, stop = self.rows
        return f"{name}, rows {start} to {stop - 1}"


@dataclass
class Manifest:
    """A manifest: the line of the run, and the last line of each part by its file."""

    path: Path
    run: RunLine
    parts: dict[str, PartLine] = field(default_factory=dict)

    @property
    def done(self) -> dict[str, PartLine]:
        """Return file -> line of the parts that have a result."""
        return {file: line for file, line in self.parts.items() if line.status == DONE}

    @property
    def missing(self) -> set[str]:
        """Return the names of the files that the run is still to write."""
        return {*map(part_name, self.run.parts)} - self.done.keys()

    @property
    def files(self) -> set[str]:
        """Return the names of the files that a run may replace or remove."""
        numbers = (*self.run.parts, *self.run.removed)
        return {*map(part_name, numbers), *self.parts}

    def write(self) -> None:
        """Write the manifest, whole or not at all."""
        lines = [self.run, *self.parts.values()]
        with atomic_path(self.path) as temporary:
            temporary.write_bytes(b"".join(map(_line_bytes, lines)))

    def add(self, line: PartLine) -> None:
        """Set the line of a part, and append it to the file."""
        self.parts[line.file] = line
        with storage_errors(self.path, None), self.path.open("ab", buffering=0) as file:
            file.write(_line_bytes(line))


def _line_bytes(line: ManifestLine) -> bytes:
    """Return a line of a manifest as JSON, with the end of the line."""
    return json.dumps(line.model_dump(exclude_unset=True)).encode() + b"\n"


def read_manifest(folder: Path) -> Manifest | None:
    """Read the manifest of a folder, None without one; InputError for another file."""
    lines = read_lines(folder)
    if lines is None:
        return None
    run, parts = lines
    return Manifest(folder / MANIFEST, run, {part.file: part for part in parts})


def find_unlisted(folder: Path, manifest: Manifest | None) -> list[Path]:
    """Return files in a folder that are named as its parts are, but are not listed.

    Without a manifest that is every part, and the list of parts of an earlier version.
    """
    ours = manifest.files if manifest is not None else set()
    unlisted = [path for path in folder.glob(PARTS_PATTERN) if path.name not in ours]
    if manifest is None and (folder / EARLIER_MANIFEST).is_file():
        unlisted.append(folder / EARLIER_MANIFEST)
    return sorted(unlisted)


def refuse_unlisted(folder: Path, unlisted: Sequence[Path]) -> None:
    """Raise InputError where a folder holds results that no manifest of it lists."""
    if not unlisted:
        return
    names = [printable(path.name) for path in unlisted]
    fault = f"holds {abbreviate(names, 3)}, which no {MANIFEST} lists"
    if EARLIER_MANIFEST in names:
        fault = f"was begun by an earlier version of shapefit ({EARLIER_MANIFEST})"
    fix = "name another folder, or add --replace, which removes these files"
    raise input_error(folder, fault, fix)


@contextmanager
def hold_lock(folder: Path) -> Iterator[None]:
    """Hold the lock of a folder of results, so that no other run writes to it.

    The folder is made where there is none, and removed if it stays empty. Raises
    InputError where another run holds it.
    """
    check_folder(folder)
    made = [place for place in (folder, *folder.parents) if not place.exists()]
    file = _open_lock(folder)
    try:
        yield
    finally:
        with suppress(OSError):  # a folder that holds something stays
            (folder / LOCK_FILE).unlink()
            for place in made:
                place.rmdir()
        file.close()


def _open_lock(folder: Path) -> IO[str]:
    """Return the open lock file of a folder; both are made where there are none.

    Raises InputError where another run holds the lock. A run that ends removes it: who
    then holds one that is no longer there tries again.
    """
    while True:
        folder.mkdir(parents=True, exist_ok=True)
        try:
            file = (folder / LOCK_FILE).open("w")
        except FileNotFoundError:
            continue
        try:
            import fcntl

            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            file.close()
            fault = "another run is writing results to it"
            fix = "wait until it ends, or choose another"
            raise input_error(folder, fault, fix) from None
        except (ImportError, OSError):  # a system or a disk without locks
            return file
        with suppress(FileNotFoundError):
            there = os.stat(folder / LOCK_FILE)
            if os.path.samestat(os.fstat(file.fileno()), there):
                return file
        file.close()


def find_folders(files: Sequence[Path]) -> dict[Path, Manifest]:
    """Return folder -> manifest where all results of a folder, 2 or more, are given."""
    whole = find_whole_folders(files)
    return {folder: manifest for folder, manifest in whole if len(manifest.done) > 1}


def find_whole_folders(files: Collection[Path]) -> Iterator[tuple[Path, Manifest]]:
    """Yield each folder all of whose results are given, with its manifest."""
    given = {*files}
    for folder in dict.fromkeys(file.parent for file in files):
        manifest = read_manifest(folder)
        if manifest is not None and {folder / name for name in manifest.done} <= given:
            yield folder, manifest


def describe_parts(parts: Mapping[str, PartLine]) -> list[tuple[str, str]]:
    """Return labels and texts on parts: their number, size, images and failures."""
    images = sum(part.images for part in parts.values())
    failed = sum(part.failed for part in parts.values())
    size = sum(part.bytes for part in parts.values())
    without = f", {failed:,} without a shape" if failed else ""
    return [
        ("parts", f"{len(parts):,}, {format_bytes(size)}"),
        ("images", f"{images:,}{without}"),
    ]


def numbers_of_parts(parts: Collection[PartLine]) -> Numbers:
    """Return the sums over parts, and their largest gap, as their lines state them.

    They are None where a part with images that were lifted does not state them.
    """
    numbers = Numbers(images=sum(part.images for part in parts))
    lifted = [part for part in parts if part.images > part.failed]
    judged = [part.trusted for part in lifted if part.trusted is not None]
    if judged and len(judged) == len(lifted):
        numbers = numbers._replace(trusted=sum(judged))
    gaps = [part.largest_gap for part in lifted if part.largest_gap is not None]
    if gaps and len(gaps) == len(lifted):
        numbers = numbers._replace(largest_gap=max(gaps))
    solved = [part.optimal for part in lifted if part.optimal is not None]
    missed = [part.not_optimal for part in lifted if part.not_optimal is not None]
    if lifted and len(solved) == len(missed) == len(lifted):
        numbers = numbers._replace(optimal=sum(solved), not_optimal=sum(missed))
    return numbers

"""`manifest.json`: what a folder of results holds, and of what, so that a run can go on."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from shapefit import __version__
from shapefit.config.paths import MANIFEST, ResultFolder
from shapefit.errors import InputError, counted, input_error
from shapefit.io.atomic import atomic_path, check_folder, storage_errors, write_all
from shapefit.io.inputs import in_words
from shapefit.io.source import open_results
from shapefit.pipelines.parts.equal_items import Span, by_length
from shapefit.pipelines.parts.plan import Part
from shapefit.stores import UrlPath, find_state, held_object, read_bytes

VERSION, OLD = 2, 1
"""In the first version parts were numbered one by one, now by their first input."""

LOCK = ".lock"
TAIL = "]}\n"
"""Of a manifest, in the place of which the next entry is written."""

SHARE_OF_WRITING = 0.05
"""Of the time of a run that rewriting a long manifest in a store may take."""

BATCH = 4096
"""Images of a result that was touched that are read at a time."""

Entry = dict[str, Any]


@dataclass
class Manifest:
    """The parts of a folder that are done, by the names of their files.

    terms: digests of what all parts depend on beside their inputs: the config, the dictionary.
    estimated: what the config left open, the same for all parts, and the digest of that config.
    """

    terms: Mapping[str, str]
    parts: dict[str, Entry] = field(default_factory=dict)
    estimated: Mapping[str, Any] = field(default_factory=dict)
    due: float = 0.0

    def holds(self, part: Part) -> bool:
        """Whether a part is done, and its inputs are as they were."""
        known = self.parts.get(part.file)
        return known is not None and all(
            known.get(key) == value for key, value in part.describe().items()
        )

    def spans(self, folder: Path) -> dict[Path, Span]:
        """Return where the names of the items of each result lie, of those that have some."""
        return {
            folder / name: Span(**entry["items"])
            for name, entry in self.parts.items()
            if entry.get("items")
        }

    def write(self, path: Path) -> None:
        """Write the manifest, whole or not at all, with a line for each part."""
        said = {"version": VERSION, "shapefit": __version__, **self.terms}
        said |= {"estimated": self.estimated}
        lines = [_line(name, self.parts[name]) for name in sorted(self.parts, key=by_length)]
        with atomic_path(path) as temporary, temporary.open("w", encoding="utf-8") as file:
            file.write(json.dumps(said)[:-1] + ', "parts": [\n' + ",".join(lines) + TAIL)

    def add(self, name: str, entry: Entry, path: Path) -> None:
        """Add a part, and write its line behind the others.

        An object of a store cannot grow: it is written anew, as often as takes little of the time.
        """
        first = not self.parts
        self.parts[name] = entry
        if isinstance(path, UrlPath):
            began = time.monotonic()
            if began >= self.due:
                self.write(path)
                now = time.monotonic()
                self.due = now + (now - began) / SHARE_OF_WRITING
            return
        with storage_errors(path, None), path.open("r+b", buffering=0) as file:
            file.seek(-len(TAIL), os.SEEK_END)
            line = ("" if first else ",") + _line(name, entry) + TAIL
            write_all(file, line.encode())


def _line(name: str, entry: Entry) -> str:
    return json.dumps({"file": name, **entry}) + "\n"


def parse(text: bytes) -> Any:
    """Return what a manifest holds, but for a last line that was not written to its end."""
    try:
        return json.loads(text)
    except ValueError:
        if not text.endswith(b"}\n"):
            text = text[: max(text.rindex(start) for start in (b"\n,", b"\n{") if start in text)]
        return json.loads(text + TAIL.encode())


def read_manifest(path: Path) -> Manifest | None:
    """Read a manifest; None where there is none. Raises InputError where it is something else."""
    try:
        content = parse(read_bytes(path))
        if content["version"] not in (VERSION, OLD):
            found = f"is a manifest of version {content['version']}, this is version {VERSION}"
            raise input_error(path, found, "choose another folder")
        parts = {entry.pop("file"): entry for entry in content["parts"]}
        terms = {key: content[key] for key in ("config", "dictionary")}
        estimated = dict(content.get("estimated") or {})
    except FileNotFoundError:
        return None
    except OSError as error:
        raise input_error(path, f"cannot be read: {error.strerror}", "check it") from None
    except (ValueError, KeyError, TypeError, AttributeError):
        found = "is not a manifest of results"
        raise input_error(path, found, "choose another folder, or remove it") from None
    return Manifest(terms, parts, estimated)


def damage_of(result: Path, entry: Mapping[str, Any]) -> InputError | None:
    """Return why a result cannot be read any more; one that is as it was written is not read."""
    if isinstance(result, UrlPath) or find_state(result) == (entry["bytes"], entry.get("written")):
        return None
    try:
        with open_results([result], without=()) as source:
            for _ in source.batches(BATCH):
                pass
    except InputError as error:
        return error
    return None


def replace_link(path: Path) -> None:
    """Remove a symbolic link in a folder of results: what is written must not go elsewhere."""
    if not isinstance(path, UrlPath) and path.is_symlink():
        path.unlink()


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
        replace_link(folder / name)
    try:
        import fcntl
    except ImportError:  # without such locks a second run is not noticed
        yield
        return
    path = folder / LOCK
    with path.open("w") as file:
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

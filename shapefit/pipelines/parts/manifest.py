"""`manifest.json`: what a folder of results holds, and of what, so that a run can go on."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from shapefit import __version__
from shapefit.errors import input_error, path_text
from shapefit.io.whole.atomic import atomic_path
from shapefit.pipelines.parts.plan import Part
from shapefit.pipelines.parts.spans import Span

VERSION = 1
LOCK = ".lock"

Entry = dict[str, Any]


@dataclass
class Manifest:
    """The parts of a folder that are done, by the names of their files.

    terms: digests of what all parts depend on beside their inputs: the config, the dictionary.
    """

    terms: Mapping[str, str]
    parts: dict[str, Entry] = field(default_factory=dict)

    def holds(self, part: Part) -> bool:
        """Whether a part is done, and its inputs are as they were."""
        known = self.parts.get(part.file)
        return known is not None and all(
            known.get(key) == value for key, value in describe(part).items()
        )

    def spans(self, folder: Path) -> dict[Path, Span]:
        """Return where the names of the items of each result lie, of those that have some."""
        return {
            folder / name: Span(**entry["items"])
            for name, entry in self.parts.items()
            if entry.get("items")
        }

    def write(self, path: Path) -> None:
        """Write the manifest, whole or not at all."""
        content = {
            "version": VERSION,
            "shapefit": __version__,
            **self.terms,
            "parts": [{"file": name, **entry} for name, entry in sorted(self.parts.items())],
        }
        with atomic_path(path) as temporary:
            temporary.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def describe(part: Part) -> Entry:
    """Return what a part is made of, as the manifest says it."""
    return {
        "inputs": [path_text(path) for path in part.inputs],
        "rows": None if part.rows is None else list(part.rows),
        "sizes": [size for size, _ in part.state],
        "changed": [changed for _, changed in part.state],
    }


def is_whole(path: Path, entry: Entry) -> bool:
    """Whether the result of a part is still there, as long as it was."""
    try:
        return path.stat().st_size == entry.get("bytes")
    except OSError:
        return False


def read_manifest(path: Path) -> Manifest | None:
    """Read a manifest; None where there is none. Raises InputError where it is something else."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        if content["version"] != VERSION:
            found = f"is a manifest of version {content['version']}, this is version {VERSION}"
            raise input_error(path, found, "choose another folder")
        parts = {entry.pop("file"): entry for entry in content["parts"]}
        terms = {key: content[key] for key in ("config", "dictionary")}
    except FileNotFoundError:
        return None
    except OSError as error:
        raise input_error(path, f"cannot be read: {error.strerror}", "check it") from None
    except (ValueError, KeyError, TypeError, AttributeError):
        found = "is not a manifest of results"
        raise input_error(path, found, "choose another folder, or remove it") from None
    return Manifest(terms, parts)


@contextmanager
def held_folder(folder: Path) -> Iterator[None]:
    """Hold a folder of results for this run. Raises InputError where another run holds it."""
    folder.mkdir(parents=True, exist_ok=True)
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
            found = "another run is writing results to it"
            raise input_error(folder, found, "wait until it ends, or choose another") from None
        except OSError:  # a file system without locks
            pass
        yield

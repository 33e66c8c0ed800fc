"""A folder of results as one claim: what its manifest states of the parts, compared with them."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from shapefit.errors import input_error
from shapefit.verification.terms import Terms

False_ = tuple[str, str]
"""What is stated falsely, and how it is."""

MANIFEST = "manifest.json"
VERSION, OLD = 2, 1
"""In the first version each part had the next number, now that of its first input."""

PART = re.compile(r"part-(\d{5,})\.\w+")

COMPARED = {
    "of the folder": ("version", "config", "dictionary", "parts"),
    "of a part": ("file", "inputs", "rows", "sizes", "images", "failed", "bytes", "items"),
}
STATED = {
    "of the folder": ("shapefit",),
    "of a part": ("changed", "written", "seconds", "failures"),
}
"""What a manifest states, by its keys: compared with the files, or stated only."""


@dataclass(frozen=True)
class Entry:
    """What a manifest states of a part; rows are those from the first to before the second."""

    file: str
    inputs: tuple[str, ...]
    rows: tuple[int, int] | None
    sizes: tuple[int, ...]
    images: int
    failed: int
    bytes: int
    items: Mapping[str, str] | None


@dataclass(frozen=True)
class Folder:
    """What a manifest states: digests of the config and the dictionary, and the parts.

    one_by_one: whether each part has the next number; else that of its first input.
    """

    config: str
    dictionary: str
    entries: tuple[Entry, ...]
    one_by_one: bool = False


def read_folder(manifest: Path, text: bytes) -> Folder:
    """Return what a manifest states. Raises InputError where it is none."""
    try:
        content = json.loads(text)
        entries = []
        for each in content["parts"]:
            rows, items = each["rows"], each["items"]
            first = None if rows is None else (int(rows[0]), int(rows[1]))
            images, failed, size = (int(each[name]) for name in ("images", "failed", "bytes"))
            inputs, sizes = tuple(map(str, each["inputs"])), tuple(map(int, each["sizes"]))
            if not inputs:
                raise ValueError("a part without inputs")
            spans = None if items is None else dict(items)
            entries.append(
                Entry(str(each["file"]), inputs, first, sizes, images, failed, size, spans)
            )
        if content["version"] not in (VERSION, OLD):
            raise ValueError(f"its version is {content['version']}")
        one_by_one = content["version"] == OLD
        said = str(content["config"]), str(content["dictionary"])
        return Folder(*said, tuple(entries), one_by_one)
    except (KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
        found = f"is not a manifest of results ({type(error).__name__}: {error})"
        raise input_error(manifest, found, "fit again") from None


@dataclass
class PartItems:
    """How many images a part has, how many of them failed, and where their names lie."""

    count: int = 0
    failed: int = 0
    bounds: dict[str, str] = field(default_factory=dict)

    def add(self, items: Sequence[str], failed: int) -> None:
        """Take in some more images."""
        self.count += len(items)
        self.failed += failed
        names = (*items, *self.bounds.values())
        if names:
            self.bounds = {
                "first": min(names),
                "last": max(names),
                "shortest": min(names, key=_by_length),
                "longest": max(names, key=_by_length),
            }


def _by_length(name: str) -> tuple[int, str]:
    return len(name), name


def false_list(folder: Folder, there: Mapping[str, int]) -> list[False_]:
    """Return what is wrong with the list of parts: their order, their rows, and what is there.

    there: the files in the folder, with their bytes.
    """
    wrong: list[False_] = [] if folder.entries else [("manifest", "lists no part")]
    reached: dict[tuple[str, ...], int] = {}
    number = 0
    for entry in folder.entries:
        match = PART.fullmatch(entry.file)
        if match is None or int(match[1]) != number:
            found = f"stands where part {number} should: a part is missing, or has another name"
            wrong.append((entry.file, found))
        if there.get(entry.file) != entry.bytes:
            size = f"{there[entry.file]} bytes" if entry.file in there else "not there"
            wrong.append((entry.file, f"is {size}, and the manifest states {entry.bytes} bytes"))
        first, last = entry.rows or (0, -1)
        if first != reached.get(entry.inputs, 0):
            wrong.append(
                (entry.file, f"begins at row {first} of {entry.inputs[0]}: rows are missing")
            )
        reached[entry.inputs] = last
        number += 1 if entry.rows or folder.one_by_one else len(entry.inputs)
    listed = {entry.file for entry in folder.entries}
    strange = sorted(name for name in there if PART.fullmatch(name) and name not in listed)
    return wrong + [(name, "is not in the manifest") for name in strange]


def false_terms(
    entry: Entry, folder: Folder, terms: Terms, config: Mapping[str, Any], apart: Collection[str]
) -> list[False_]:
    """Return what the fit of a part was otherwise than the manifest states.

    apart: the keys of its config that need not be those of the other parts.
    """
    shared = {key: value for key, value in config.items() if key not in apart}
    written = Path(str(config["output"])).name
    pairs = {
        "config": (config_digest(json.dumps(shared, sort_keys=True)), folder.config),
        "dictionary": (terms.inputs.get(terms.dictionary), folder.dictionary),
        "inputs": (terms.landmarks, entry.inputs),
        "name": (written, entry.file),
    }
    return [
        (entry.file, f"has another {key} than the manifest states")
        for key, (found, stated) in pairs.items()
        if found != stated
    ]


def false_items(entry: Entry, found: PartItems) -> list[False_]:
    """Return what the images of a part are otherwise than the manifest states."""
    rows = found.count if entry.rows is None else entry.rows[1] - entry.rows[0]
    pairs = {
        "images": (found.count, entry.images),
        "rows": (found.count, rows),
        "images that failed": (found.failed, entry.failed),
        "names": (found.bounds, dict(entry.items or {})),
    }
    return [
        (entry.file, f"has other {key} than the manifest states ({is_so}, {stated})")
        for key, (is_so, stated) in pairs.items()
        if is_so != stated
    ]


def config_digest(config: str) -> str:
    """Return the SHA-256 of the text of a config."""
    return hashlib.sha256(config.encode()).hexdigest()

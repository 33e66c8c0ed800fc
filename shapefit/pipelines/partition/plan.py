"""The parts of a fit, beside those that a folder has: what is to be done, and what is refused.

Parts are files, recordings of several files, or ranges of rows of an HDF5 file.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache
from itertools import chain, count
from pathlib import Path
from typing import Any, NamedTuple

from shapefit.config import FitConfig
from shapefit.config.paths import ResultFolder
from shapefit.errors import InputError, abbreviate, listed, path_text, printable
from shapefit.io import LandmarkSource, digest, digests, open_landmarks
from shapefit.io.detect import group_inputs
from shapefit.io.formats import CSV, HDF5, FileFormat
from shapefit.lifting.methods import METHODS
from shapefit.pipelines.fit.prepare import files_of, read_options
from shapefit.pipelines.fit.run import whole_stretches
from shapefit.pipelines.partition.manifest import Entry, Manifest
from shapefit.threads import on_threads

LARGE_TEXT = 1 << 28
"""Bytes of a CSV file from which on it is said that it is one part."""

OF_THE_RUN = {"landmarks", "output", "dictionary", "data", "threads"}
"""Keys that do not change what a part holds; the dictionary counts by its digest."""

Rows = tuple[int, int] | None
State = tuple[int, int]
Key = tuple[tuple[str, ...], Rows]


class Part(NamedTuple):
    """Images that become one result file.

    file        name of its result; it stays when inputs are added
    inputs      a file, or those of one recording
    rows        of the one HDF5 file: from the first to before the second; None for all
    states      size in bytes and time of change in ns of each input
    """

    file: str
    inputs: tuple[Path, ...]
    rows: Rows
    states: tuple[State, ...]

    def describe(self) -> Entry:
        """Return what the part is made of, as the manifest states it."""
        return {
            "file": self.file,
            "inputs": list(map(path_text, self.inputs)),
            "rows": None if self.rows is None else list(self.rows),
            "states": list(map(list, self.states)),
        }

    def __str__(self) -> str:
        rows = "" if self.rows is None else f", rows {self.rows[0]} to {self.rows[1] - 1}"
        return abbreviate([printable(path) for path in self.inputs]) + rows


class Plan(NamedTuple):
    """What a run does to a folder.

    parts     all that there are to be
    retained  lines of those that are done and as they were, by their files
    removed   files of results of other inputs
    refused   why results would be lost, "" where none would
    digests   of all that every part depends on
    """

    parts: Sequence[Part]
    retained: Mapping[str, Entry]
    removed: Sequence[str]
    refused: str
    digests: Mapping[str, str]

    @property
    def todo(self) -> list[Part]:
        """The parts that are to be done."""
        return [part for part in self.parts if part.file not in self.retained]


def make_plan(config: FitConfig, folder: ResultFolder, manifest: Manifest | None) -> Plan:
    """Compare the parts that a config asks for with those that a folder has.

    A part stays where its result has the size that was written, the config and its files are the
    same, and its inputs have not changed, by size and time or else by their digests.
    """
    old = manifest or Manifest(folder.manifest, {})
    done = old.done
    parts = find_parts(config, folder.partition, {key_of(p): f for f, p in old.parts.items()})
    plain = {key: value for key, value in config.as_plain().items() if key not in OF_THE_RUN}
    text = json.dumps(plain | {"partition": folder.partition}, sort_keys=True)
    inputs = {"config": hashlib.sha256(text.encode()).hexdigest()}
    inputs |= {key: digest(path) for key, path in files_of(config).items()}
    changed = [key for key in inputs if done and old.run.get(key) != inputs[key]]
    again = [part for part in parts if part.file in done]
    altered = [part for part in again if is_altered(part, done[part.file])]
    removed = [file for file in done if file not in {part.file for part in again}]
    retained = {
        part.file: done[part.file]
        for part in again
        if not changed
        and part not in altered
        and find_state(folder.path / part.file)[0] == done[part.file]["bytes"]
    }
    reasons = [f"of another {listed(changed, 'and')}"] if changed else []
    if altered:
        reasons += [f"of {abbreviate(list(map(str, altered)), 3)} before it changed"]
    if removed:
        names = dict.fromkeys(Path(path).name for file in removed for path in done[file]["inputs"])
        reasons += [f"of {abbreviate(list(names), 3)}, not among these parts"]
    return Plan(parts, retained, removed, ", and ".join(reasons), inputs)


def find_parts(config: FitConfig, size: int, named: Mapping[Key, str] | None = None) -> list[Part]:
    """Return the parts of a fit, of `size` images or more, in the order of the inputs.

    Those that are named already keep their files; the others get free ones. An HDF5 file is cut
    where no result changes: after whole stretches of images, which start from one another's
    solutions, and between sequences where those are lifted whole.
    """
    options = read_options(config)

    def divide(group: tuple[FileFormat, tuple[Path, ...]]) -> Sequence[Rows]:
        file_format, inputs = group
        if file_format is not HDF5:
            return (None,)
        try:
            with open_landmarks(inputs, options, check=False) as source:
                total, cuts = source.count, list(range(0, source.count, whole_stretches(size)))
                if METHODS[config.method].sequences:
                    cuts = [0]
                    for row in sequence_starts(source):
                        cuts += [row] if row - cuts[-1] >= size else []
        except InputError:  # whoever does its part reports it
            return (None,)
        rows = list(zip(cuts, [*cuts[1:], total], strict=True))
        return rows if len(rows) > 1 else (None,)

    groups = group_inputs(list(config.landmarks), options)
    named = dict(named or {})
    names = (f"part-{number:05}.h5" for number in count())
    free = (name for name in names if name not in named.values())
    parts = []
    for (_, inputs), ranges in zip(groups, on_threads(divide, groups), strict=True):
        for rows in ranges:
            part = Part("", inputs, rows, tuple(map(find_state, inputs)))
            file = named.get(key_of(part.describe()))
            parts.append(part._replace(file=file or next(free)))
    return parts


def sequence_starts(source: LandmarkSource) -> Iterator[int]:
    """Yield the first row of every run of images of one sequence."""
    last = ""
    for row, name in enumerate(chain.from_iterable(source.sequences())):
        if name != last:
            yield row
        last = name


def key_of(entry: Mapping[str, Any]) -> Key:
    """Return what the part of a line is made of: paths of the inputs, and rows."""
    return tuple(entry["inputs"]), entry["rows"] and tuple(entry["rows"])


def find_state(path: Path) -> State:
    """Return the size and the time of change of a file; zeros where there is none."""
    try:
        state = path.stat()
    except OSError:
        return 0, 0
    return state.st_size, state.st_mtime_ns


def is_altered(part: Part, entry: Entry) -> bool:
    """Whether inputs are not those of a line: by sizes and times of change, and then digests."""
    if part.describe()["states"] == entry.get("states"):
        return False
    return input_digests(part.inputs, part.states) != entry["digests"]


@lru_cache(maxsize=8)
def input_digests(inputs: tuple[Path, ...], _states: tuple[State, ...]) -> dict[str, str]:
    """Return the digests of files under their paths, once as long as they do not change."""
    return digests(inputs)


def warn_of_large(parts: Sequence[Part]) -> tuple[str, ...]:
    """Name large tables, each of which is one part."""
    return tuple(
        f"{path.name} is one part, as text is not divided: `shapefit convert {path.name} -o "
        f"{path.stem}.h5` makes a file that is"
        for part in parts
        for path, (size, _) in zip(part.inputs, part.states, strict=True)
        if size >= LARGE_TEXT and path.suffix.lower() in CSV.suffixes
    )

"""The parts of a fit, beside those that a folder has: what is to be done, and what is refused.

Parts are files, recordings of several files, or ranges of rows of an HDF5 file.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from itertools import chain, count
from pathlib import Path
from typing import Any, NamedTuple

from shapefit.config import FitConfig
from shapefit.config.paths import ResultFolder
from shapefit.errors import InputError, abbreviate, listed, path_text, printable
from shapefit.io import digest, open_landmarks
from shapefit.io.detect import group_inputs
from shapefit.io.formats import HDF5
from shapefit.io.options import InputOptions
from shapefit.lifting.methods import METHODS
from shapefit.pipelines.fit.prepare import files_of, read_options
from shapefit.pipelines.fit.run import whole_blocks
from shapefit.pipelines.partition.manifest import Entry, Manifest

OF_THE_RUN = {"landmarks", "output", "dictionary", "data", "threads"}
"""Keys that do not change what a part holds; the dictionary counts by its digest."""

Rows = tuple[int, int] | None
State = tuple[int, int]


class Part(NamedTuple):
    """Images that become one result file, which keeps its name when inputs are added.

    inputs are a file, or those of one recording, with their states; rows None are all.
    """

    file: str
    inputs: tuple[Path, ...]
    rows: Rows
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
        rows = "" if self.rows is None else f", rows {self.rows[0]} to {self.rows[1] - 1}"
        return abbreviate([printable(path) for path in self.inputs]) + rows


class Plan(NamedTuple):
    """What a run does to a folder: the parts that it is to have, and lines of those retained.

    removed are files of results of other inputs; refused says which would be lost, "" for none;
    digests are of all that every part depends on.
    """

    parts: Sequence[Part]
    retained: Mapping[str, Entry]
    removed: Sequence[str]
    refused: str
    digests: Mapping[str, str]


def make_plan(config: FitConfig, folder: ResultFolder, manifest: Manifest | None) -> Plan:
    """Compare the parts that a config asks for with those that a folder has.

    A part stays where its result has the size that was written, and config and inputs are the same.
    """
    old = manifest or Manifest(folder.manifest, {})
    parts = find_parts(config, folder.partition, {key_of(p): f for f, p in old.parts.items()})
    plain = {key: value for key, value in config.as_plain().items() if key not in OF_THE_RUN}
    text = json.dumps(plain | {"partition": folder.partition}, sort_keys=True)
    digests = {"config": hashlib.sha256(text.encode()).hexdigest()}
    digests |= {key: digest(path) for key, path in files_of(config).items()}
    done, states = old.done, {part.file: part.describe()["states"] for part in parts}
    changed = [key for key in digests if done and old.run.get(key) != digests[key]]
    lost = [file for file in done if changed or states.get(file) != done[file]["states"]]
    names = dict.fromkeys(Path(path).name for file in lost for path in done[file]["inputs"])
    others = f"of {abbreviate(list(names), 3)} before it changed, or not among the inputs"
    refused = f"of another {listed(changed, 'and')}" if changed else others
    sizes = {file: find_state(folder.path / file)[0] for file in done if file not in lost}
    return Plan(
        parts,
        {file: done[file] for file, size in sizes.items() if size == done[file]["bytes"]},
        [file for file in lost if file not in states],
        refused if lost else "",
        digests,
    )


def find_parts(
    config: FitConfig, size: int, named: Mapping[tuple[Any, ...], str] | None = None
) -> list[Part]:
    """Return the parts of a fit, of `size` images or more; those named already keep their files."""
    options, named = read_options(config), named or {}
    names = (f"part-{number:05}.h5" for number in count())
    free = (name for name in names if name not in named.values())
    parts = []
    for file_format, inputs in group_inputs(list(config.landmarks), options):
        ranges: Sequence[Rows] = [None]
        if file_format is HDF5:
            ranges = divide(inputs, options, size, by_sequence=METHODS[config.method].sequences)
        for rows in ranges:
            part = Part("", inputs, rows, tuple(map(find_state, inputs)))
            file = named.get(key_of(part.describe()))
            parts.append(part._replace(file=file or next(free)))
    return parts


def divide(
    inputs: tuple[Path, ...], options: InputOptions, size: int, *, by_sequence: bool
) -> Sequence[Rows]:
    """Return the ranges of rows of an HDF5 file that are parts, cut where no result changes.

    That is after whole blocks of images, which start from each other, or between sequences.
    """
    try:
        with open_landmarks(inputs, options, check=False) as source:
            total, cuts = source.count, list(range(0, source.count, whole_blocks(size)))
            if by_sequence:
                names, cuts = list(chain.from_iterable(source.sequences())), [0]
                for row in range(1, total):
                    if names[row] != names[row - 1] and row - cuts[-1] >= size:
                        cuts.append(row)
    except InputError:  # whoever does its part reports it
        return [None]
    return list(zip(cuts, [*cuts[1:], total], strict=True)) if len(cuts) > 1 else [None]


def key_of(entry: Mapping[str, Any]) -> tuple[Any, ...]:
    """Return what the part of a line is made of: paths of the inputs, and rows."""
    return tuple(entry["inputs"]), entry["rows"] and tuple(entry["rows"])


def find_state(path: Path) -> State:
    """Return the size and the time of change of a file; zeros where there is none."""
    try:
        state = path.stat()
    except OSError:
        return 0, 0
    return state.st_size, state.st_mtime_ns

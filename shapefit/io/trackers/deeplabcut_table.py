"""What DeepLabCut's tables share: columns of individuals and landmarks, and a skeleton."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats
from shapefit.errors import abbreviate, input_error, printable
from shapefit.io.foreign.recording import Instances
from shapefit.io.layout import UNKNOWN_UNIT
from shapefit.io.sources import is_stream
from shapefit.stores.urls import UrlPath

COORDINATES = ("x", "y", "z", "likelihood")

SAVE = "save the table again with DeepLabCut"


@dataclass(frozen=True)
class Layout:
    """Where the numbers of a row stand.

    individuals and landmarks are names; points (i, p, d) and likelihood (i, p) are columns of a
    row that has a NaN appended, which is what is missing points at; notes are about columns that
    are left out.
    """

    individuals: tuple[str, ...]
    landmarks: tuple[str, ...]
    points: NDArray[np.intp]
    likelihood: NDArray[np.intp] | None
    notes: tuple[str, ...] = ()

    @property
    def dimensions(self) -> Literal[2, 3]:
        """2, or 3 where there is a column z."""
        return 3 if self.points.shape[2] == 3 else 2

    @property
    def unit(self) -> str:
        """Pixels for landmarks; tables of 3D points do not say it."""
        return "px" if self.dimensions == 2 else UNKNOWN_UNIT

    def instances(self, values: Floats, start: int, labels: Sequence[str]) -> Instances:
        """Return the rows (n, columns) of frames `start` and on, each individual an instance."""
        padded = np.column_stack([values, np.full(len(values), np.nan)])
        points = padded[:, self.points]
        confidence = None if self.likelihood is None else padded[:, self.likelihood]
        if confidence is not None:
            points[confidence < 0] = np.nan  # what newer versions write for animals not found
        return Instances.of_all(points, confidence, start, labels)


def arrange(place: str, columns: Sequence[tuple[str, ...]]) -> Layout:
    """Sort columns, named (scorer, [individual,] body part, coordinate), each after `place`.

    Individuals and landmarks stand in order of appearance; a column that is there for some of
    them only is missing for the others. Columns of other coordinates are left out, with a note.
    Raises InputError for columns that are there twice, and for coordinates without the others.
    """
    if not columns:
        raise input_error(place, "has no columns of coordinates", SAVE)
    depth = len(columns[0])
    if depth not in (3, 4) or any(len(column) != depth for column in columns):
        found = f"its columns have {depth} names each"
        raise input_error(place, found, f"{SAVE}: scorer, (individual,) body part, coordinate")
    number: dict[tuple[str, str, str], int] = {}
    others: dict[str, None] = {}
    for place_in_row, column in enumerate(columns):
        key = (column[1] if depth == 4 else "", column[-2], column[-1])
        if key[2] not in COORDINATES:
            others.setdefault(printable(key[2]))
            continue
        if key in number:
            scorers = abbreviate(sorted({printable(other[0]) for other in columns}))
            found = f"{key[2]} of {printable(' '.join(key[:2]).strip())} is there twice"
            raise input_error(place, found, f"keep the columns of one scorer (here {scorers})")
        number[key] = place_in_row
    individuals = tuple(dict.fromkeys(key[0] for key in number))
    landmarks = tuple(dict.fromkeys(key[1] for key in number))
    present = {key[2] for key in number}
    axes = [axis for axis in COORDINATES[:3] if axis in present]
    if axes[:2] != ["x", "y"]:
        have = f" ({abbreviate(list(others))})" if others else ""
        raise input_error(place, f"has no columns x and y{have}", SAVE)
    for who, landmark in {key[:2] for key in number}:
        if lost := [axis for axis in axes if (who, landmark, axis) not in number]:
            found = f"{printable(landmark)} has no column {lost[0]}"
            raise input_error(place, found, "add it, or remove the landmark")
    missing = len(columns)

    def find(axis: str) -> NDArray[np.intp]:
        return np.array(
            [[number.get((who, name, axis), missing) for name in landmarks] for who in individuals],
            dtype=np.intp,
        )

    return Layout(
        individuals if depth == 4 else (),
        landmarks,
        np.stack([find(axis) for axis in axes], axis=-1),
        find("likelihood") if "likelihood" in present else None,
        (f"columns left out: {abbreviate(list(others))}",) if others else (),
    )


FILE = "config.yaml"
FOLDERS_ABOVE = 2
"""Predictions lie in a folder of the project, labels in a folder of that."""


def skeleton_edges(path: Path, names: Sequence[str]) -> tuple[tuple[int, int], ...]:
    """Return the edges of `skeleton` between these landmarks, by place in `names`.

    It lists pairs of names, or chains of them. A pair with a name that the table has not is left
    out; a file that is no YAML, or not of DeepLabCut, says nothing.
    """
    if is_stream(path) or isinstance(path, UrlPath):
        return ()
    folder = path.resolve().parent
    near = (each / FILE for each in (folder, *folder.parents[:FOLDERS_ABOVE]))
    found = next((each for each in near if each.is_file()), None)
    place = {name: number for number, name in enumerate(names)}
    pairs = () if found is None else _pairs(found)
    edges = ((place[a], place[b]) for a, b in pairs if a != b and a in place and b in place)
    return tuple(dict.fromkeys(edges))


def _pairs(path: Path) -> Iterator[tuple[str, str]]:
    """Yield neighbours of each chain in the skeleton of a project."""
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError

    try:
        found: Any = YAML(typ="safe", pure=True).load(path)
    except (YAMLError, OSError, ValueError, RecursionError):
        return
    chains = found.get("skeleton") if isinstance(found, dict) else None
    for chain in chains if isinstance(chains, list) else ():
        if isinstance(chain, list):
            yield from pairwise(map(str, chain))

"""What an NWB file has of ndx-pose: animals, their series, and the skeletons that order them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shapefit.arrays import Floats
from shapefit.errors import input_error
from shapefit.io.trackers.reading import DAMAGED, TrackerFile, check_unique, read_edges, text

TYPE = "neurodata_type"
POSE, SERIES = "PoseEstimation", "PoseEstimationSeries"

DEEPEST = 4
"""Groups below `processing` in which animals are looked for."""


@dataclass(frozen=True)
class Series:
    """The positions of one landmark: the group, its name, and what it says of its data.

    rate is None where the series has times of its own, start and rate are those of its first
    point otherwise; data are multiplied by `conversion`, and `offset` is added.
    """

    group: str
    name: str
    count: int
    dimensions: int
    unit: str
    conversion: float
    offset: float
    start: float | None
    rate: float | None
    has_confidence: bool

    def times(self, file: TrackerFile) -> Floats:
        """Return the time of each point. Raises InputError for times that do not increase."""
        if self.start is not None:
            return self.start + np.arange(self.count) / (self.rate or 1.0)
        name = f"{self.group}/timestamps"
        file.check_shape(name, (self.count,))
        times = file.numbers(name)
        if not np.isfinite(times).all() or (np.diff(times) <= 0).any():
            fix = "give each point a time of its own, in their order"
            raise input_error(file.place(name), "does not increase", fix)
        return times

    def points(self, file: TrackerFile, rows: slice) -> Floats:
        """Return some positions (n, 2) or (n, 3)."""
        return file.numbers(f"{self.group}/data", rows) * self.conversion + self.offset

    def confidence(self, file: TrackerFile, rows: slice) -> Floats:
        """Return the confidence of some positions (n,), NaN without one."""
        if not self.has_confidence:
            return np.full(rows.stop - rows.start, np.nan)
        return file.numbers(f"{self.group}/confidence", rows)


@dataclass(frozen=True)
class Animal:
    """A PoseEstimation: its group, its module and name, and the series of its landmarks."""

    group: str
    module: str
    name: str
    series: tuple[Series, ...]


def animals(file: TrackerFile) -> list[Animal]:
    """Return all animals in `processing` that have a series."""
    found: list[Animal] = []

    def visit(group: str, depth: int) -> None:
        for name in file.groups(group):
            below = f"{group}/{name}"
            if _type(file, below) == POSE:
                own = tuple(
                    _series(file, f"{below}/{each}", each)
                    for each in file.groups(below)
                    if _type(file, f"{below}/{each}") == SERIES
                )
                if own:
                    found.append(Animal(below, group.rpartition("/")[2], name, own))
            elif depth < DEEPEST:
                visit(below, depth + 1)

    if file.has("processing"):
        visit("processing", 1)
    return found


def landmarks_of(file: TrackerFile, found: list[Animal]) -> tuple[str, ...]:
    """Return the names of all landmarks: in the order of skeletons, then of appearance."""
    names: dict[str, None] = {}
    for animal in found:
        own = [series.name for series in animal.series]
        nodes = [name for name in _nodes(file, animal) if name in own]
        names |= dict.fromkeys([*nodes, *own])
    return tuple(names)


def edges_of(
    file: TrackerFile, found: list[Animal], names: tuple[str, ...]
) -> tuple[tuple[int, int], ...]:
    """Return the edges of all skeletons, by place in `names`."""
    place = {name: number for number, name in enumerate(names)}
    edges: dict[tuple[int, int], None] = {}
    for animal in found:
        for skeleton in _skeletons(file, animal)[:1]:
            nodes = file.texts(f"{skeleton}/nodes")
            for a, b in read_edges(file, f"{skeleton}/edges", len(nodes)):
                if nodes[a] in place and nodes[b] in place:
                    edges[place[nodes[a]], place[nodes[b]]] = None
    return tuple(edges)


def _nodes(file: TrackerFile, animal: Animal) -> tuple[str, ...]:
    skeletons = _skeletons(file, animal)
    if not skeletons:
        return ()
    nodes = file.texts(f"{skeletons[0]}/nodes")
    check_unique(file.place(f"{skeletons[0]}/nodes"), nodes, "node")
    return nodes


def _skeletons(file: TrackerFile, animal: Animal) -> list[str]:
    """Return the groups that have the nodes of an animal: its own, those it names, those beside.

    One of the module counts where it has all landmarks of the animal.
    """
    near = [animal.group, f"{animal.group}/skeleton"]
    beside = f"{animal.group.rpartition('/')[0]}/Skeletons"
    if not file.has(beside):
        beside = "processing/behavior/Skeletons"
    if file.has(beside):
        near += [f"{beside}/{name}" for name in file.groups(beside)]
    wanted = {series.name for series in animal.series}
    return [
        group
        for group in near
        if file.is_dataset(f"{group}/nodes") and wanted <= set(file.texts(f"{group}/nodes"))
    ]


def _series(file: TrackerFile, group: str, name: str) -> Series:
    data = f"{group}/data"
    shape = file.shape(data, "times, coordinates")
    if shape[1] not in (2, 3):
        raise input_error(file.place(data), f"has {shape[1]} coordinates", DAMAGED)
    has_confidence = file.is_dataset(f"{group}/confidence")
    if has_confidence:
        file.check_shape(f"{group}/confidence", shape[:1])
    start = rate = None
    if file.is_dataset(f"{group}/starting_time"):
        file.check_shape(f"{group}/starting_time", ())
        start = float(file.numbers(f"{group}/starting_time"))
        rate = _number(file.attribute("rate", f"{group}/starting_time"))
    elif not file.is_dataset(f"{group}/timestamps"):
        found = "has neither timestamps nor starting_time"
        raise input_error(file.place(group), found, DAMAGED)
    return Series(
        group=group,
        name=name,
        count=shape[0],
        dimensions=shape[1],
        unit=text(file.attribute("unit", data) or "pixels").lower(),
        conversion=_number(file.attribute("conversion", data)) or 1.0,
        offset=_number(file.attribute("offset", data)) or 0.0,
        start=start,
        rate=rate if rate is not None and rate > 0 else None,
        has_confidence=has_confidence,
    )


def _type(file: TrackerFile, group: str) -> str:
    return text(file.attribute(TYPE, group) or "")


def _number(value: object) -> float | None:
    finite = isinstance(value, int | float) and np.isfinite(value)
    return float(value) if finite and isinstance(value, int | float) else None

"""NWB files with the extension ndx-pose: a PoseEstimation for each animal, a series per landmark.

Series of one animal may have times of their own; they are joined by time. Several modules with
animals of the same names are several videos.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from shapefit.arrays import Floats, Integers
from shapefit.errors import input_error
from shapefit.io.foreign.recording import Recording, check_unique, number_label, video_name
from shapefit.io.foreign.trackers import TrackerFile, text

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
            if not np.isfinite(self.start):
                fix = "store the time of the first point"
                raise file.fault(f"{self.group}/starting_time", "is no number", fix)
            return self.start + np.arange(self.count) / (self.rate or 1.0)
        name = f"{self.group}/timestamps"
        file.check_shape(name, (self.count,))
        times = file.numbers(name)
        if not np.isfinite(times).all() or (np.diff(times) <= 0).any():
            fix = "give each point a time of its own, in their order"
            raise file.fault(name, "does not increase", fix)
        return times

    def points(self, file: TrackerFile) -> Floats:
        """Return the positions (n, 2) or (n, 3)."""
        return file.numbers(f"{self.group}/data") * self.conversion + self.offset

    def confidence(self, file: TrackerFile) -> Floats:
        """Return the confidence of the positions (n,), NaN without one."""
        if not self.has_confidence:
            return np.full(self.count, np.nan)
        return file.numbers(f"{self.group}/confidence")


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
            for a, b in file.edges(f"{skeleton}/edges", len(nodes)):
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
        raise file.fault(data, f"has {shape[1]} coordinates")
    has_confidence = file.is_dataset(f"{group}/confidence")
    if has_confidence:
        file.check_shape(f"{group}/confidence", shape[:1])
    start = rate = None
    if file.is_dataset(f"{group}/starting_time"):
        file.check_shape(f"{group}/starting_time", ())
        start = float(file.numbers(f"{group}/starting_time"))
        rate = _number(file.attribute("rate", f"{group}/starting_time"))
    elif not file.is_dataset(f"{group}/timestamps"):
        raise file.fault(group, "has neither timestamps nor starting_time")
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


UNITS = {"pixel": "px", "pixels": "px", "px": "px", "meters": "m", "metres": "m", "meter": "m"}

STEADY = 0.01
"""Share of a step by which times of a steady rate may deviate from it."""


def read_nwb(paths: tuple[Path, ...]) -> Recording:
    """Read every PoseEstimation below `processing`. Raises InputError where there is none."""
    path = paths[0]
    with TrackerFile(path) as file:
        found = animals(file)
        if not found:
            what = "holds no PoseEstimation (ndx-pose), so no landmarks"
            raise input_error(path, what, "give a file of estimated poses")
        names = landmarks_of(file, found)
        edges = edges_of(file, found, names)
        series = [each for animal in found for each in animal.series]
        dimensions = {each.dimensions for each in series}
        if len(dimensions) != 1:
            raise input_error(path, "holds 2D and 3D series", "save them in files of their own")
        people = tuple(dict.fromkeys(animal.name for animal in found))
        videos = [
            (module, _read_video(file, own, names, people)) for module, own in _by_module(found)
        ]
    points, confidence, times, frames, individuals = (
        np.concatenate(each) for each in zip(*(parts for _, parts in videos), strict=True)
    )
    flat, units = dimensions == {2}, {each.unit for each in series}
    unit = UNITS.get(next(iter(units)), "unknown") if len(units) == 1 else "unknown"
    called = [name for name, parts in videos for _ in parts[2]]
    every = [np.unique(times[np.array(called, dtype=object) == name]) for name, _ in videos]
    return Recording(
        name=str(path),
        video=video_name(path),
        points=points,
        confidence=None if np.isnan(confidence).all() else confidence,
        frames=frames,
        labels=[number_label(time) for time in times.tolist()],
        individuals=individuals,
        videos=called if len(videos) > 1 else None,
        landmark_names=names,
        individual_names=people,
        frame_count=sum(map(len, every)),
        frame_rate=_rate([each.rate for each in series if each.count > 1], every),
        unit=unit if not flat or unit == "px" else "px",
        edges=edges,
    )


def _by_module(found: list[Animal]) -> list[tuple[str, tuple[Animal, ...]]]:
    """Return the animals of each video; all together where their names differ."""
    if len({animal.name for animal in found}) == len(found):
        return [("", tuple(found))]
    modules = dict.fromkeys(animal.module for animal in found)
    return [(name, tuple(a for a in found if a.module == name)) for name in modules]


def _rate(rates: list[float | None], times: list[Floats]) -> float | None:
    """Return the frame rate that the series state, or that the times of all videos keep."""
    stated = set(rates)
    if len(stated) == 1 and (rate := next(iter(stated))) is not None:
        return rate
    steps = [np.diff(each) for each in times if len(each) > 2]
    if not steps or stated != {None}:
        return None
    every = np.concatenate(steps)
    middle = float(np.median(every))
    steady = bool((np.abs(every - middle) <= STEADY * middle).all())
    return 1 / middle if steady else None


def _read_video(
    file: TrackerFile, own: tuple[Animal, ...], names: tuple[str, ...], people: tuple[str, ...]
) -> tuple[Floats, Floats, Floats, Integers, Integers]:
    """Return points (N, p, d), confidence (N, p), times, frames and individuals (N,) of a module.

    A frame is a time that any series has; an instance an animal with a point then.
    """
    times = {each.group: each.times(file) for animal in own for each in animal.series}
    every = np.unique(np.concatenate(list(times.values())))
    shape = (len(every), len(own), len(names))
    points = np.full((*shape, own[0].series[0].dimensions), np.nan)
    confidence = np.full(shape, np.nan)
    present = np.zeros(shape[:2], bool)
    for number, animal in enumerate(own):
        for series in animal.series:
            frames = np.searchsorted(every, times[series.group])
            column = names.index(series.name)
            points[frames, number, column] = series.points(file)
            confidence[frames, number, column] = series.confidence(file)
            present[frames, number] = True
    frame, who = np.nonzero(present)
    individuals = np.array([people.index(animal.name) for animal in own])
    return points[frame, who], confidence[frame, who], every[frame], frame, individuals[who]

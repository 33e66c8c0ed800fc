"""NWB with the extension ndx-pose: a PoseEstimation for each animal, a series per landmark."""

from __future__ import annotations

from collections.abc import Iterator
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

UNITS = {"pixel": "px", "pixels": "px", "px": "px", "meters": "m", "metres": "m", "meter": "m"}

STEADY = 0.01
"""Share of a step by which times of a steady rate may deviate from it."""


@dataclass(frozen=True)
class Series:
    """One landmark of an animal: points (n, 2) or (n, 3), confidence and times (n,) in s.

    confidence is NaN where there is none; rate is that of a series that states its rate.
    """

    name: str
    points: Floats
    confidence: Floats
    times: Floats
    rate: float | None
    unit: str


@dataclass(frozen=True)
class Animal:
    """A PoseEstimation: its module and name, its series, and the group of its skeleton, if any."""

    module: str
    name: str
    series: tuple[Series, ...]
    skeleton: str | None


def read_nwb(paths: tuple[Path, ...]) -> Recording:
    """Read every PoseEstimation below `processing`. Raises InputError where there is none.

    Series of one animal may have times of their own; they are joined by time. Several modules with
    animals of the same names are several videos.
    """
    path = paths[0]
    with TrackerFile(path) as file:
        found = list(_animals(file, "processing", 1)) if file.has("processing") else []
        if not found:
            what = "holds no PoseEstimation (ndx-pose), so no landmarks"
            raise input_error(path, what, "give a file of estimated poses")
        names, edges = _landmarks(file, found)
    series = [each for animal in found for each in animal.series]
    if len(dimensions := {each.points.shape[1] for each in series}) != 1:
        raise input_error(path, "holds 2D and 3D series", "save them in files of their own")
    people = tuple(dict.fromkeys(animal.name for animal in found))
    modules = dict.fromkeys(animal.module for animal in found)
    several = len(people) < len(found)
    videos = [[a for a in found if a.module == m] for m in modules] if several else [found]
    read = [_join(own, names, people) for own in videos]
    points, confidence, frames, individuals = (
        np.concatenate(each) for each in zip(*(own[:4] for own in read), strict=True)
    )
    times = [own[4] for own in read]
    called = [module for module, own in zip(modules, read, strict=False) for _ in own[2]]
    units = {each.unit for each in series}
    unit = UNITS.get(next(iter(units)), "unknown") if len(units) == 1 else "unknown"
    return Recording(
        name=str(path),
        video=video_name(path),
        points=points,
        confidence=None if np.isnan(confidence).all() else confidence,
        frames=frames,
        labels=[number_label(own[4][frame]) for own in read for frame in own[2].tolist()],
        individuals=individuals,
        videos=called if several else None,
        landmark_names=names,
        individual_names=people,
        frame_count=sum(map(len, times)),
        frame_rate=_rate([each.rate for each in series if len(each.times) > 1], times),
        unit="px" if dimensions == {2} else unit,
        edges=edges,
    )


def _animals(file: TrackerFile, group: str, depth: int) -> Iterator[Animal]:
    """Yield all animals in a group that have a series."""
    for name in file.groups(group):
        below = f"{group}/{name}"
        if text(file.attribute(TYPE, below) or "") != POSE:
            if depth < DEEPEST:
                yield from _animals(file, below, depth + 1)
            continue
        own = tuple(
            _series(file, f"{below}/{each}", each)
            for each in file.groups(below)
            if text(file.attribute(TYPE, f"{below}/{each}") or "") == SERIES
        )
        if own:
            skeleton = _skeleton(file, below, {series.name for series in own})
            yield Animal(group.rpartition("/")[2], name, own, skeleton)


def _series(file: TrackerFile, group: str, name: str) -> Series:
    data, scores, start = (f"{group}/{each}" for each in ("data", "confidence", "starting_time"))
    count, axes = file.shape(data, "times, coordinates")
    if axes not in (2, 3):
        raise file.fault(data, f"has {axes} coordinates")
    confidence = np.full(count, np.nan)
    if file.is_dataset(scores):
        file.check_shape(scores, (count,))
        confidence = file.numbers(scores)
    rate = None
    if file.is_dataset(start):
        file.check_shape(start, ())
        first = float(file.numbers(start))
        if not np.isfinite(first):
            raise file.fault(start, "is no number", "store the time of the first point")
        stated = _number(file, "rate", start)
        rate = stated if stated is not None and stated > 0 else None
        times = first + np.arange(count) / (rate or 1.0)
    elif file.is_dataset(name_of_times := f"{group}/timestamps"):
        file.check_shape(name_of_times, (count,))
        times = file.numbers(name_of_times)
        if not np.isfinite(times).all() or (np.diff(times) <= 0).any():
            fix = "give each point a time of its own, in their order"
            raise file.fault(name_of_times, "does not increase", fix)
    else:
        raise file.fault(group, "has neither timestamps nor starting_time")
    factor, offset = (_number(file, each, data) for each in ("conversion", "offset"))
    points = file.numbers(data) * (factor or 1.0) + (offset or 0.0)
    unit = text(file.attribute("unit", data) or "pixels").lower()
    return Series(name, points, confidence, times, rate, unit)


def _number(file: TrackerFile, name: str, node: str) -> float | None:
    value = file.attribute(name, node)
    return float(value) if isinstance(value, int | float) and np.isfinite(value) else None


def _skeleton(file: TrackerFile, animal: str, landmarks: set[str]) -> str | None:
    """Return the group that has the nodes of an animal: its own, the one it names, one beside.

    One of the module counts where it has all landmarks of the animal.
    """
    near = [animal, f"{animal}/skeleton"]
    beside = f"{animal.rpartition('/')[0]}/Skeletons"
    if not file.has(beside):
        beside = "processing/behavior/Skeletons"
    if file.has(beside):
        near += [f"{beside}/{name}" for name in file.groups(beside)]
    for group in near:
        if file.is_dataset(f"{group}/nodes") and landmarks <= set(file.texts(f"{group}/nodes")):
            return group
    return None


def _landmarks(
    file: TrackerFile, found: list[Animal]
) -> tuple[tuple[str, ...], tuple[tuple[int, int], ...]]:
    """Return all landmarks, in the order of skeletons, then of appearance; and their edges."""
    names: dict[str, None] = {}
    pairs: dict[tuple[str, str], None] = {}
    for animal in found:
        own = [series.name for series in animal.series]
        nodes: tuple[str, ...] = ()
        if animal.skeleton is not None:
            nodes = file.texts(f"{animal.skeleton}/nodes")
            check_unique(file.place(f"{animal.skeleton}/nodes"), nodes, "node")
            lines = file.edges(f"{animal.skeleton}/edges", len(nodes))
            pairs |= dict.fromkeys((nodes[a], nodes[b]) for a, b in lines)
        names |= dict.fromkeys([*(name for name in nodes if name in own), *own])
    place = {name: number for number, name in enumerate(names)}
    edges = ((place[a], place[b]) for a, b in pairs if a in place and b in place)
    return tuple(names), tuple(edges)


def _join(
    own: list[Animal], names: tuple[str, ...], people: tuple[str, ...]
) -> tuple[Floats, Floats, Integers, Integers, Floats]:
    """Return points (N, p, d), confidence (N, p), frames and individuals (N,), and all times.

    A frame is a time that any series has; an instance an animal with a point then.
    """
    times = np.unique(np.concatenate([each.times for animal in own for each in animal.series]))
    shape = (len(times), len(own), len(names))
    points = np.full((*shape, own[0].series[0].points.shape[1]), np.nan)
    confidence = np.full(shape, np.nan)
    present = np.zeros(shape[:2], bool)
    for number, animal in enumerate(own):
        for series in animal.series:
            frames, column = np.searchsorted(times, series.times), names.index(series.name)
            points[frames, number, column] = series.points
            confidence[frames, number, column] = series.confidence
            present[frames, number] = True
    frame, who = np.nonzero(present)
    individuals = np.array([people.index(animal.name) for animal in own])[who]
    return points[frame, who], confidence[frame, who], frame, individuals, times


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

"""NWB files with the extension ndx-pose: a PoseEstimation for each animal, a series per landmark.

Series of one animal may have times of their own; they are joined by time. Several modules with
animals of the same names are several videos.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from shapefit.arrays import Floats
from shapefit.errors import input_error
from shapefit.io.foreign.recording import Instances, Recording, video_name
from shapefit.io.trackers.frame_names import number_label
from shapefit.io.trackers.nwb_groups import Animal, animals, edges_of, landmarks_of
from shapefit.io.trackers.reading import BLOCK_FRAMES, TrackerFile, frame_ranges

UNITS = {"pixel": "px", "pixels": "px", "px": "px", "meters": "m", "metres": "m", "meter": "m"}

STEADY = 0.01
"""Share of a step by which times of a steady rate may deviate from it."""


@dataclass(frozen=True)
class _Video:
    """A module of the file: its animals, and the distinct times of all their series."""

    name: str
    animals: tuple[Animal, ...]
    times: Floats


def record(paths: tuple[Path, ...]) -> Recording:
    """Open a file; its times are read at once, its points when its blocks are."""
    path = paths[0]
    with TrackerFile(path) as file:
        found = animals(file)
        if not found:
            what = "holds no PoseEstimation (ndx-pose), so no landmarks"
            raise input_error(path, what, "give a file of estimated poses")
        names = landmarks_of(file, found)
        edges = edges_of(file, found, names)
        videos = [
            _Video(module, own, _distinct([each.times(file) for a in own for each in a.series]))
            for module, own in _by_module(found)
        ]
        series = [each for animal in found for each in animal.series]
        dimensions = {each.dimensions for each in series}
        units = {each.unit for each in series}
        rates = [each.rate for each in series if each.count > 1]
    if len(dimensions) != 1:
        raise input_error(path, "holds 2D and 3D series", "save them in files of their own")
    flat = dimensions == {2}
    unit = UNITS.get(next(iter(units)), "unknown") if len(units) == 1 else "unknown"
    individuals = tuple(dict.fromkeys(animal.name for animal in found))
    return Recording(
        name=str(path),
        video=video_name(path),
        dimensions=2 if flat else 3,
        landmark_count=len(names),
        landmark_names=names,
        blocks=lambda: _read(path, videos, names, individuals),
        individuals=individuals,
        frames=sum(len(video.times) for video in videos),
        frame_rate=_rate(rates, videos),
        unit=unit if not flat or unit == "px" else "px",
        edges=edges,
    )


def _by_module(found: list[Animal]) -> list[tuple[str, tuple[Animal, ...]]]:
    """Return the animals of each video; all together where their names differ."""
    if len({animal.name for animal in found}) == len(found):
        return [("", tuple(found))]
    modules = dict.fromkeys(animal.module for animal in found)
    return [(name, tuple(a for a in found if a.module == name)) for name in modules]


def _distinct(times: list[Floats]) -> Floats:
    """Return the times of all series, each once."""
    first = times[0]
    if all(other is first or np.array_equal(other, first) for other in times):
        return first
    return np.unique(np.concatenate(times))


def _rate(rates: list[float | None], videos: list[_Video]) -> float | None:
    """Return the frame rate that the series state, or that the times of the only video keep."""
    stated = set(rates)
    if len(stated) == 1 and (rate := next(iter(stated))) is not None:
        return rate
    steps = [np.diff(video.times) for video in videos if len(video.times) > 2]
    if not steps or stated != {None}:
        return None
    every = np.concatenate(steps)
    middle = float(np.median(every))
    steady = bool((np.abs(every - middle) <= STEADY * middle).all())
    return 1 / middle if steady else None


def _read(
    path: Path, videos: list[_Video], names: tuple[str, ...], individuals: tuple[str, ...]
) -> Iterator[Instances]:
    """Read the points, some thousand frames at a time."""
    with TrackerFile(path) as file:
        for video in videos:
            times = {
                series.group: series.times(file)
                for animal in video.animals
                for series in animal.series
            }
            for rows in frame_ranges(len(video.times), BLOCK_FRAMES):
                yield _block(file, video, rows, times, names, individuals)


def _block(
    file: TrackerFile,
    video: _Video,
    rows: slice,
    times: dict[str, Floats],
    names: tuple[str, ...],
    individuals: tuple[str, ...],
) -> Instances:
    n, many = len(video.times[rows]), len(video.animals)
    dimensions = video.animals[0].series[0].dimensions
    points = np.full((n, many, len(names), dimensions), np.nan)
    confidence = np.full((n, many, len(names)), np.nan)
    present = np.zeros((n, many), bool)
    now = video.times[rows]
    for number, animal in enumerate(video.animals):
        for series in animal.series:
            own = times[series.group]
            part = slice(*np.searchsorted(own, [now[0], np.nextafter(now[-1], np.inf)]).tolist())
            if part.start == part.stop:
                continue
            frames = np.searchsorted(now, own[part])
            column = names.index(series.name)
            points[frames, number, column] = series.points(file, part)
            confidence[frames, number, column] = series.confidence(file, part)
            present[frames, number] = True
    frame, who = np.nonzero(present)
    labels = [number_label(time) for time in now.tolist()]
    numbers = np.array([individuals.index(animal.name) for animal in video.animals])
    scores = confidence[frame, who]
    return Instances(
        points=points[frame, who],
        confidence=None if np.isnan(scores).all() else scores,
        frames=frame + rows.start,
        labels=[labels[number] for number in frame.tolist()],
        individuals=numbers[who],
        videos=[video.name] * len(frame) if video.name else None,
    )

"""HDF5 of trackers, with every damage named; JABS, movement, and NWB with ndx-pose."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import prod
from pathlib import Path
from re import sub
from typing import Any

import h5py
import numpy as np

from shapefit.arrays import Floats, Integers
from shapefit.errors import input_error, printable
from shapefit.io.hdf5_file import Hdf5File, Stored
from shapefit.io.readers.poses import (
    PARSE_ERRORS,
    Edges,
    Poses,
    message,
    number_labels,
    of_frames,
    require,
    video_name,
)

MOST_TEXTS = 1_000_000
"""Names that a dataset of names can hold."""


class TrackerFile(Hdf5File):
    """An open HDF5 file of another tool.

    Whatever a reader stumbles over while it is open is told of the dataset that was read last.
    """

    last = ""

    def __exit__(self, *raised: object) -> None:
        super().__exit__()
        if isinstance(error := raised[1], PARSE_ERRORS):
            raise self.fault(self.last, message(error)) from error

    def stored(self, name: str) -> Stored:
        """Return a dataset, of which is told what goes wrong from now on."""
        self.last = name
        return super().stored(name)

    def groups(self, group: str, levels: int = 1) -> Iterator[str]:
        """Yield the groups below a group that is there, so many levels deep."""
        with self.damage(group):
            nodes = self.root.get(group, {})
            found = [name for name in nodes if isinstance(nodes.get(name), h5py.Group)]
        for name in found:
            yield (below := f"{group}/{name}".strip("/"))
            if levels > 1:
                yield from self.groups(below, levels - 1)

    def shape(self, name: str) -> tuple[int, ...]:
        """Return the shape of a dataset."""
        return self.stored(name).shape

    def numbers(self, name: str, *wanted: int | None) -> Floats:
        """Return a dataset as numbers, of the wanted shape if one is given; None is any length."""
        stored = self.stored(name)
        fits = len(wanted) == len(stored.shape) and all(
            length in (None, size) for length, size in zip(wanted, stored.shape, strict=True)
        )
        shape = str(wanted).replace("None", "any")
        require(not wanted or fits, f"has the shape {stored.shape}, not {shape}")
        require(stored.dataset.dtype.kind in "biuf", "holds no numbers")
        return np.asarray(self.rows(name), np.float64)

    def table(self, name: str, *columns: str) -> Any:
        """Return a table of these columns, and maybe others, as it stands in the file."""
        there = self.stored(name).dataset.dtype.names or ()
        lost = [column for column in columns if column not in there]
        require(not lost and len(self.shape(name)) == 1, f"is no table of {', '.join(columns)}")
        return self.rows(name)

    def scales(self, name: str) -> tuple[str, ...]:
        """Return the names of the dimension scales of a dataset."""
        dataset = self.stored(name).dataset
        with self.damage(name):  # h5py's own `dims` can abort the process on damaged files
            scales = dataset.attrs["DIMENSION_LIST"]
            names = [text(h5py.h5r.get_name(own[0], self.root.id) or b"") for own in scales]
        return tuple(name.strip("/") for name in names)

    def texts(self, name: str) -> tuple[str, ...]:
        """Return a dataset of names."""
        stored = self.stored(name)
        require(prod(stored.shape) <= MOST_TEXTS, f"holds {stored.shape} names")
        if not stored.text:  # SLEAP writes lists without entries as numbers
            require(stored.dataset.size == 0, "holds no text")
            return ()
        with self.damage(name):
            return tuple(map(text, np.ravel(stored.dataset[()])))

    def edges(self, name: str, count: int) -> Edges:
        """Return the pairs of landmarks in a dataset (e, 2); none where it is absent or empty."""
        if not self.is_dataset(name) or 0 in self.shape(name):
            return ()
        pairs = self.numbers(name, None, 2)
        there = ((pairs >= 0) & (pairs < count)).all()
        require(there, "points at landmarks that are not there")
        return tuple((int(a), int(b)) for a, b in pairs)


def text(value: Any) -> str:
    """Return bytes of a file as text; what is not UTF-8 as escapes."""
    return value.decode("utf-8", "backslashreplace") if isinstance(value, bytes) else str(value)


# JABS and movement.

MOUSE = (
    *("NOSE", "LEFT_EAR", "RIGHT_EAR", "BASE_NECK", "LEFT_FRONT_PAW", "RIGHT_FRONT_PAW"),
    *("CENTER_SPINE", "LEFT_REAR_PAW", "RIGHT_REAR_PAW", "BASE_TAIL", "MID_TAIL", "TIP_TAIL"),
)
"""The landmarks of JABS, which its files do not name."""

LINES = ((0, 1), (0, 2), (0, 3), (3, 6), (6, 9), (9, 10), (10, 11), (6, 4), (6, 5), (9, 7), (9, 8))


def read_jabs(paths: tuple[Path, ...]) -> Poses:
    """Read `poseest/points` of JABS: (frame, [instance,] point, [y, x]), where y comes first.

    A confidence of 0 is a point that was not found. Version 2 knows one mouse. Version 3 counts the
    instances of a frame and gives them tracks; from version 4 on they have identities, from 1, and
    0 where there is none.
    """
    path = paths[0]
    with TrackerFile(path) as file:
        points = file.numbers("poseest/points")[..., ::-1]
        require(points.ndim in (3, 4) and points.shape[-1] == 2, f"has the shape {points.shape}")
        frames, *many = points.shape[:-2]
        ids, absent = np.zeros((frames, 1)), np.zeros((frames, 1), bool)
        version = np.ravel(file.attribute("version", "poseest") or 2)[0]
        if many and version > 3:
            ids = file.numbers("poseest/instance_embed_id", frames, *many)
            absent = ids <= 0
        elif many:
            ids = file.numbers("poseest/instance_track_id", frames, *many)
            absent = np.arange(*many) >= file.numbers("poseest/instance_count", frames)[:, None]
        confidence = np.ones(points.shape[:-1])
        if file.is_dataset("poseest/confidence"):
            confidence = file.numbers("poseest/confidence", *points.shape[:-1])
    seen = confidence > 0
    lost = int((seen.any(axis=-1).reshape(absent.shape) & absent).sum())
    named = points.shape[-2] == len(MOUSE)
    return of_frames(
        path,
        np.where(seen[..., None], points, np.nan),
        confidence,
        present=~absent,
        video=sub(r"_pose_est(_v\d+)?$", "", video_name(path)),
        landmark_names=MOUSE if named else None,
        individuals=ids.astype(int).astype(str) if many else None,
        edges=LINES if named else (),
        notes=(f"{lost} instances without an identity left out",) if lost else (),
    )


WANTED = ("time", "individual", "keypoint", "space")
"""The axes of movement, in the order in which they are given out."""


def read_movement(paths: tuple[Path, ...]) -> Poses:
    """Read movement's netCDF, which is HDF5: `position` over time, space, keypoints, individuals.

    The axes are named by dimension scales, in any order. Newer versions say `keypoint` and
    `individual`; one individual or keypoint that was picked out has no axis.
    """
    path = paths[0]
    with TrackerFile(path) as file:
        if (kind := text(file.attribute("ds_type") or "")) != "poses":
            found = f"holds {printable(kind) or 'data of no stated type'}, not poses"
            fix = "give a data set of poses; bounding boxes have no landmarks"
            raise input_error(path, found, fix)
        points = _arranged(file, "position", WANTED)
        confidence = None
        if file.is_dataset("confidence"):
            confidence = _arranged(file, "confidence", WANTED[:3])
            fits = confidence.shape == points.shape[:3]
            require(fits, f"has the shape {confidence.shape}, and position {points.shape}")
        labels = None
        if file.is_dataset("time"):
            labels = number_labels(file.place("time"), file.numbers("time", len(points)))
        _, individuals, names, space = (
            _names(file, axis, size) for axis, size in zip(WANTED, points.shape, strict=True)
        )
        require(space in (("x", "y"), ("x", "y", "z")), f"names the coordinates {', '.join(space)}")
        rate = file.attribute("fps")
    return of_frames(
        path,
        points,
        confidence,
        labels,
        landmark_names=names,
        individuals=individuals,
        frame_rate=float(rate) if isinstance(rate, int | float) and 0 < rate < np.inf else None,
    )


def _arranged(file: TrackerFile, name: str, wanted: Sequence[str]) -> Floats:
    """Return a dataset with the wanted axes in order; an animal or point picked out is 1 long."""
    axes = [axis.removesuffix("s") for axis in file.scales(name)]
    kept = [axis for axis in wanted if axis in axes]
    needed = {"time", *wanted[3:]} <= set(axes)
    require(needed and sorted(kept) == sorted(axes), f"has the axes {', '.join(axes)}")
    values = file.numbers(name).transpose([axes.index(axis) for axis in kept])
    sizes = dict(zip(kept, values.shape, strict=True))
    return values.reshape([sizes.get(axis, 1) for axis in wanted])


def _names(file: TrackerFile, axis: str, size: int) -> tuple[str, ...]:
    """Return the names along an axis; its numbers where it has none."""
    place = next((name for name in (axis, f"{axis}s") if file.is_dataset(name)), None)
    if place is None or not file.stored(place).text:
        return tuple(f"{axis}_{number}" for number in range(size))
    names = file.texts(place)
    require(len(names) == size, f"names {len(names)}, and there are {size}")
    return names


# NWB.

UNITS = {"pixel": "px", "pixels": "px", "px": "px", "meters": "m", "metres": "m", "meter": "m"}

DEEPEST = 5
"""Levels of groups below `processing` that are looked at: modules, animals and their series."""

STEADY = 0.01
"""Share of a step by which times of a steady rate may deviate from it."""


@dataclass(frozen=True)
class Series:
    """A PoseEstimationSeries: one landmark over time, of an animal, which is in a module.

    points (n, 2 or 3) times the conversion that is stated; confidence (n,), NaN where there is
    none; times (n,) in seconds; rate in Hz, of a series that states it.
    """

    module: str
    animal: str
    landmark: str
    points: Floats
    confidence: Floats
    times: Floats
    rate: float | None
    unit: str


def read_nwb(paths: tuple[Path, ...]) -> Poses:
    """Read every PoseEstimation below `processing`. Raises InputError where there is none.

    Series of one animal may have times of their own; they are joined by time. Several modules with
    animals of the same names are several videos.
    """
    path = paths[0]
    with TrackerFile(path) as file:
        groups = tuple(file.groups("processing", DEEPEST))
        kinds = {name: text(file.attribute("neurodata_type", name) or "") for name in groups}
        series = [
            _read_series(file, name)
            for name in groups
            if kinds[name] == "PoseEstimationSeries"
            and kinds.get(name.rpartition("/")[0]) == "PoseEstimation"
        ]
        if not series:
            what = "holds no PoseEstimation (ndx-pose), so no landmarks"
            raise input_error(path, what, "give a file of estimated poses")
        names, edges = _landmarks(file, groups, series)
    dimensions = {each.points.shape[1] for each in series}
    if len(dimensions) > 1:
        raise input_error(path, "holds 2D and 3D series", "save them in files of their own")
    people = tuple(dict.fromkeys(each.animal for each in series))
    several = len(people) < len({(each.module, each.animal) for each in series})
    modules = dict.fromkeys(each.module if several else "" for each in series)
    videos = [
        _join([each for each in series if each.module == module or not several], names, people)
        for module in modules
    ]
    points, confidence, frame, who = map(np.concatenate, zip(*(v[1:] for v in videos), strict=True))
    labels = [np.array(number_labels(str(path), v[0]), object)[v[3]].tolist() for v in videos]
    videos_of_poses = [name for name, own in zip(modules, labels, strict=True) for _ in own]
    units = {UNITS.get(each.unit, "unknown") for each in series}
    return Poses(
        name=str(path),
        video=videos_of_poses if several else video_name(path),
        points=points,
        confidence=None if np.isnan(confidence).all() else confidence,
        frame=frame,
        label=[label for own in labels for label in own],
        individual=[people[number] for number in who.tolist()],
        landmark_names=names,
        frame_count=sum(len(video[0]) for video in videos),
        frame_rate=_rate(series, [video[0] for video in videos]),
        unit="px" if dimensions == {2} else units.pop() if len(units) == 1 else "unknown",
        edges=edges,
    )


def _read_series(file: TrackerFile, group: str) -> Series:
    module, animal, landmark = group.split("/")[-3:]
    data, scores, start = (f"{group}/{n}" for n in ("data", "confidence", "starting_time"))
    points = file.numbers(data, None, None)
    count, axes = points.shape
    require(axes in (2, 3), f"has {axes} coordinates")
    points = points * (_number(file, "conversion", data) or 1.0) + _number(file, "offset", data)
    unit = text(file.attribute("unit", data) or "pixels").lower()
    confidence = np.full(count, np.nan)
    if file.is_dataset(scores):
        confidence = file.numbers(scores, count)
    rate = None
    if file.is_dataset(start):
        rate = max(_number(file, "rate", start), 0.0) or None
        times = file.numbers(start).reshape(()) + np.arange(count) / (rate or 1.0)
        require(np.isfinite(times).all(), "is no number; store the time of the first point")
    else:
        times = file.numbers(f"{group}/timestamps", count)
        rising = np.isfinite(times).all() and (np.diff(times) > 0).all()
        require(rising, "does not increase; give each point a time of its own, in their order")
    return Series(module, animal, landmark, points, confidence, times, rate, unit)


def _number(file: TrackerFile, name: str, node: str) -> float:
    """Return an attribute that is a number; 0 for none."""
    value = file.attribute(name, node)
    return float(value) if isinstance(value, int | float) and np.isfinite(value) else 0.0


def _landmarks(
    file: TrackerFile, groups: Sequence[str], series: list[Series]
) -> tuple[tuple[str, ...], Edges]:
    """Return all landmarks, in the order of skeletons, then of appearance; and their edges.

    The skeleton of an animal is the first that has all of its landmarks; its own comes first.
    """
    names: dict[str, None] = {}
    pairs: dict[tuple[str, str], None] = {}
    stored = {group: f"{group}/nodes" for group in groups}
    nodes = {g: file.texts(name) for g, name in stored.items() if file.is_dataset(name)}
    landmarks: dict[tuple[str, str], dict[str, None]] = {}
    for each in series:
        landmarks.setdefault((each.module, each.animal), {})[each.landmark] = None
    for (module, animal), own in landmarks.items():
        inside = f"/{module}/{animal}/"
        near = sorted(nodes, key=lambda name: inside not in f"{name}/")
        group = next((name for name in near if own.keys() <= set(nodes[name])), None)
        if group is not None:
            lines = file.edges(f"{group}/edges", len(nodes[group]))
            pairs |= dict.fromkeys((nodes[group][a], nodes[group][b]) for a, b in lines)
            names |= dict.fromkeys(name for name in nodes[group] if name in own)
        names |= own
    place = {name: number for number, name in enumerate(names)}
    edges = ((place[a], place[b]) for a, b in pairs if a in place and b in place)
    return tuple(names), tuple(edges)


def _join(
    own: list[Series], names: tuple[str, ...], people: tuple[str, ...]
) -> tuple[Floats, Floats, Floats, Integers, Integers]:
    """Return the times (n,) of a video, and of its poses points, confidence, frame, individual.

    A frame is one of the times; a pose is an animal with a point then.
    """
    times = np.unique(np.concatenate([each.times for each in own]))
    shape = (len(times), len(people), len(names))
    points = np.full((*shape, own[0].points.shape[1]), np.nan)
    confidence = np.full(shape, np.nan)
    present = np.zeros(shape[:2], bool)
    for each in own:
        frames = np.searchsorted(times, each.times)
        who, landmark = people.index(each.animal), names.index(each.landmark)
        points[frames, who, landmark] = each.points
        confidence[frames, who, landmark] = each.confidence
        present[frames, who] = True
    frame, individual = np.nonzero(present)
    return times, points[present], confidence[present], frame, individual


def _rate(series: list[Series], times: list[Floats]) -> float | None:
    """Return the frame rate that the series state, or that the times of all videos keep."""
    stated = {each.rate for each in series if len(each.times) > 1}
    if len(stated) == 1 and (rate := stated.pop()) is not None:
        return rate
    steps = [np.diff(each) for each in times if len(each) > 2]
    if stated or not steps:
        return None
    middle = float(np.median(np.concatenate(steps)))
    steady = all((np.abs(own - middle) <= STEADY * middle).all() for own in steps)
    return 1 / middle if steady else None

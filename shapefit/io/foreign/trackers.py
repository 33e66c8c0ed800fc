"""HDF5 of trackers, with every damage named; JABS, movement, and NWB with ndx-pose."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import prod
from pathlib import Path
from re import sub
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats, Integers
from shapefit.errors import input_error, printable
from shapefit.io.foreign.recording import (
    Edges,
    Recording,
    check_unique,
    number_labels,
    video_name,
)
from shapefit.io.hdf5_file import Hdf5File

MOST_TEXTS = 1_000_000
"""Names that a dataset of names can hold."""


class TrackerFile(Hdf5File):
    """An open HDF5 file of another tool."""

    def groups(self, group: str) -> tuple[str, ...]:
        """Return the names of the groups in a group."""
        with self.damage(group):
            node = self.root[group]
            return tuple(name for name in node if isinstance(node.get(name), h5py.Group))

    def has(self, name: str) -> bool:
        """Whether there is such a dataset or group."""
        with self.damage(name):
            return self.root.get(name) is not None

    def shape(self, name: str, axes: str = "") -> tuple[int, ...]:
        """Return the shape of a dataset; InputError unless it has as many axes as are listed."""
        shape = self.stored(name).shape
        if axes and len(shape) != len(axes.split(", ")):
            raise self.fault(name, f"has the shape {shape}", f"its axes should be ({axes})")
        return shape

    def check_shape(self, name: str, wanted: Sequence[int]) -> None:
        """Raise InputError unless a dataset has this shape."""
        shape = self.shape(name)
        if shape != tuple(wanted):
            found = f"has the shape {shape}, and other datasets want {tuple(wanted)}"
            raise self.fault(name, found)

    def fields(self, name: str) -> tuple[str, ...]:
        """Return the names of the columns of a table; InputError where it is none."""
        found = self.stored(name).dataset.dtype.names
        if not found:
            raise self.fault(name, "is not a table of named columns")
        return tuple(found)

    def numbers(self, name: str) -> Floats:
        """Return a dataset as numbers. Raises InputError where they are none."""
        if self.stored(name).dataset.dtype.kind not in "biuf":
            raise self.fault(name, "holds no numbers")
        values = self.rows(name)
        with self.damage(name):
            return np.asarray(values, np.float64)

    def arranged(self, name: str, axes: Sequence[str], wanted: Sequence[str]) -> Floats:
        """Return a dataset with the wanted axes in order; one that it has not is 1 long."""
        values = self.numbers(name)
        present = [axis for axis in wanted if axis in axes]
        values = values.transpose([axes.index(axis) for axis in present])
        return values.reshape([values.shape[present.index(a)] if a in axes else 1 for a in wanted])

    def is_text(self, name: str) -> bool:
        """Whether a dataset holds text."""
        return self.stored(name).text

    def scales(self, name: str) -> tuple[str, ...]:
        """Return the names of the dimension scales of a dataset; InputError without them."""
        dataset = self.stored(name).dataset
        with self.damage(name):  # h5py's own `dims` can abort the process on damaged files
            scales = dataset.attrs["DIMENSION_LIST"]
            names = [text(h5py.h5r.get_name(own[0], self.root.id) or b"") for own in scales]
        return tuple(name.strip("/") for name in names)

    def texts(self, name: str) -> tuple[str, ...]:
        """Return a dataset of names. Raises InputError where they are none, or too many."""
        stored = self.stored(name)
        if prod(stored.shape) > MOST_TEXTS:
            raise self.fault(name, f"holds {stored.shape} names")
        if not stored.text:
            if stored.dataset.size == 0:
                return ()  # SLEAP writes lists without entries as numbers
            raise self.fault(name, "holds no text")
        with self.damage(name):
            found = np.ravel(stored.dataset[()])
        return tuple(text(value) for value in found)

    def edges(self, name: str, count: int) -> Edges:
        """Return the pairs of landmarks in a dataset (e, 2); none where it is absent or empty."""
        if not self.is_dataset(name) or 0 in self.shape(name):
            return ()
        shape = self.shape(name)
        if len(shape) != 2 or shape[1] != 2:
            raise self.fault(name, f"has the shape {shape}, not (edges, 2)")
        pairs = self.numbers(name)
        if not ((pairs >= 0) & (pairs < count)).all():
            raise self.fault(name, "points at landmarks that are not there")
        return tuple((int(a), int(b)) for a, b in pairs)


def text(value: Any) -> str:
    """Return bytes of a file as text; what is not UTF-8 as escapes."""
    return value.decode("utf-8", "backslashreplace") if isinstance(value, bytes) else str(value)


POINTS, CONFIDENCE = "poseest/points", "poseest/confidence"
COUNT, TRACK, IDENTITY = (
    "poseest/instance_count",
    "poseest/instance_track_id",
    "poseest/instance_embed_id",
)

MOUSE = (
    "NOSE LEFT_EAR RIGHT_EAR BASE_NECK LEFT_FRONT_PAW RIGHT_FRONT_PAW CENTER_SPINE "
    "LEFT_REAR_PAW RIGHT_REAR_PAW BASE_TAIL MID_TAIL TIP_TAIL"
)
"""The landmarks of JABS, which its files do not name."""

LINES = ((0, 1), (0, 2), (0, 3), (3, 6), (6, 9), (9, 10), (10, 11), (6, 4), (6, 5), (9, 7), (9, 8))


def read_jabs(paths: tuple[Path, ...]) -> Recording:
    """Read `poseest/points` of JABS: (frame, [instance,] point, [y, x]), where y comes first.

    A confidence of 0 is a point that was not found. Version 2 knows one mouse. Version 3 counts the
    instances of a frame and gives them tracks; from version 4 on they have identities, from 1, and
    0 where there is none.
    """
    path = paths[0]
    names = tuple(MOUSE.split())
    with TrackerFile(path) as file:
        shape = file.shape(POINTS)
        if len(shape) not in (3, 4) or shape[-1] != 2:
            found = f"has the shape {shape}"
            raise file.fault(POINTS, found, "its axes are (frame, [mouse,] point, 2)")
        if file.is_dataset(CONFIDENCE):
            file.check_shape(CONFIDENCE, shape[:-1])
        frames, many, p = shape[0], (shape[1] if len(shape) == 4 else 1), shape[-2]
        ids, absent = np.zeros((frames, many), np.int64), np.zeros((frames, many), bool)
        if len(shape) == 4:
            ids, absent = _identities(file, frames, many)
        points = file.numbers(POINTS).reshape(frames, many, p, 2)[..., ::-1]
        confidence = np.ones(points.shape[:-1])
        if file.is_dataset(CONFIDENCE):
            confidence = file.numbers(CONFIDENCE).reshape(confidence.shape)
    seen = confidence > 0
    points = np.where(seen[..., None], points, np.nan)
    known = np.unique(ids[~absent])
    lost = int((seen.any(axis=2) & absent).sum())
    named = p == len(names)
    return Recording.of_frames(
        path,
        points,
        confidence,
        individuals=np.searchsorted(known, ids),
        there=~absent,
        video=sub(r"_pose_est(_v\d+)?$", "", video_name(path)),
        landmark_names=names if named else None,
        individual_names=tuple(map(str, known.tolist())) if len(shape) == 4 else (),
        edges=LINES if named else (),
        notes=(f"{lost} instances without an identity left out",) if lost else (),
    )


def _identities(file: TrackerFile, frames: int, many: int) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return who is where (frame, instance) in a file of several mice, and where is nobody."""
    stated = file.attribute("version", "poseest")
    version = stated[0] if isinstance(stated, list) and stated else stated
    by_identity = version > 3 if isinstance(version, int) else file.is_dataset(IDENTITY)
    name = IDENTITY if by_identity else TRACK
    file.check_shape(name, (frames, many))
    ids = file.numbers(name).astype(np.int64)
    if by_identity:
        return ids, ids <= 0
    file.check_shape(COUNT, (frames,))
    return ids, np.arange(many) >= file.numbers(COUNT)[:, None]


POSITION, SCORES = "position", "confidence"

SINGULAR = {"keypoints": "keypoint", "individuals": "individual"}

WANTED = ("time", "individual", "keypoint", "space")
"""The axes of movement, in the order in which they are given out."""


def read_movement(paths: tuple[Path, ...]) -> Recording:
    """Read movement's netCDF, which is HDF5: `position` over time, space, keypoints, individuals.

    The axes are named by dimension scales, in any order. Newer versions say `keypoint` and
    `individual`; one individual or keypoint that was picked out has no axis.
    """
    path = paths[0]
    with TrackerFile(path) as file:
        kind = text(file.attribute("ds_type") or "")
        if kind != "poses":
            found = f"holds {printable(kind) or 'data of no stated type'}, not poses"
            fix = "give a data set of poses; bounding boxes have no landmarks"
            raise input_error(path, found, fix)
        axes = _axes(file, POSITION)
        sizes = dict(zip(axes, file.shape(POSITION), strict=True))
        for axis in ("time", "space"):
            if axis not in sizes:
                raise file.fault(POSITION, f"has no axis {axis}")
        names = _names(file, "keypoint", sizes.get("keypoint", 1))
        individuals = _names(file, "individual", sizes.get("individual", 1))
        space = _names(file, "space", sizes["space"])
        if space not in (("x", "y"), ("x", "y", "z")):
            found = f"names the coordinates {printable(', '.join(space))}"
            raise file.fault("space", found, "name them x, y and z")
        rate = file.attribute("fps")
        confidence = None
        if file.is_dataset(SCORES):
            own = _axes(file, SCORES)
            if {*own, "space"} != set(axes):
                found = f"has the axes {', '.join(own)}, and position {', '.join(axes)}"
                raise file.fault(SCORES, found)
            file.check_shape(SCORES, [sizes[axis] for axis in own])
            confidence = file.arranged(SCORES, own, WANTED[:3])
        times = np.arange(sizes["time"], dtype=float)
        if file.is_dataset("time"):
            file.check_shape("time", (sizes["time"],))
            times = file.numbers("time")
        points = file.arranged(POSITION, axes, WANTED)
        labels = number_labels(file.place("time"), times)
    return Recording.of_frames(
        path,
        points,
        confidence,
        labels,
        landmark_names=names,
        individual_names=individuals,
        frame_rate=float(rate) if isinstance(rate, int | float) and 0 < rate < np.inf else None,
    )


def _axes(file: TrackerFile, name: str) -> tuple[str, ...]:
    """Return the names of the axes of a dataset, as its dimension scales say."""
    found = [SINGULAR.get(axis, axis) for axis in file.scales(name)]
    if len(found) != len(file.shape(name)):
        raise file.fault(name, f"has the shape {file.shape(name)}, and names {len(found)} axes")
    if len(set(found)) != len(found) or not set(found) <= set(WANTED):
        what = f"has the axes {printable(', '.join(found))}"
        raise file.fault(name, what, f"name them {', '.join(WANTED)}")
    return tuple(found)


def _names(file: TrackerFile, axis: str, size: int) -> tuple[str, ...]:
    """Return the names along an axis; its numbers where it has none."""
    place = next((name for name in (axis, f"{axis}s") if file.is_dataset(name)), None)
    if place is None or not file.is_text(place):
        return tuple(f"{axis}_{number}" for number in range(size))
    names = file.texts(place)
    if len(names) != size:
        raise file.fault(place, f"names {len(names)}, and there are {size}")
    check_unique(file.place(place), names, axis)
    return names


TYPE = "neurodata_type"
POSE, SERIES = "PoseEstimation", "PoseEstimationSeries"

DEEPEST = 4
"""Groups below `processing` in which animals are looked for."""

UNITS = {"pixel": "px", "pixels": "px", "px": "px", "meters": "m", "metres": "m", "meter": "m"}

STEADY = 0.01
"""Share of a step by which times of a steady rate may deviate from it."""


@dataclass(frozen=True)
class Series:
    """A PoseEstimationSeries: the way of one landmark of one animal, which is in a module.

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


def read_nwb(paths: tuple[Path, ...]) -> Recording:
    """Read every PoseEstimation below `processing`. Raises InputError where there is none.

    Series of one animal may have times of their own; they are joined by time. Several modules with
    animals of the same names are several videos.
    """
    path = paths[0]
    with TrackerFile(path) as file:
        animals = dict(_animals(file, "processing", 1)) if file.has("processing") else {}
        if not animals:
            what = "holds no PoseEstimation (ndx-pose), so no landmarks"
            raise input_error(path, what, "give a file of estimated poses")
        names, edges = _landmarks(file, animals)
    series = [each for own in animals.values() for each in own]
    if len(dimensions := {each.points.shape[1] for each in series}) != 1:
        raise input_error(path, "holds 2D and 3D series", "save them in files of their own")
    people = tuple(dict.fromkeys(each.animal for each in series))
    several = len(people) < len(animals)
    modules = list(dict.fromkeys(each.module for each in series)) if several else [""]
    videos = [[each for each in series if each.module == m or not several] for m in modules]
    times = [np.unique(np.concatenate([each.times for each in own])) for own in videos]
    read = [_join(own, at, names, people) for own, at in zip(videos, times, strict=True)]
    points, confidence, frames, individuals = (
        np.concatenate(each) for each in zip(*read, strict=True)
    )
    called = [module for module, own in zip(modules, read, strict=True) for _ in own[2]]
    labels = [number_labels("", at[own[2]]) for at, own in zip(times, read, strict=True)]
    units = {UNITS.get(each.unit, "unknown") for each in series}
    unit = units.pop() if len({each.unit for each in series}) == 1 else "unknown"
    return Recording(
        name=str(path),
        video=video_name(path),
        points=points,
        confidence=None if np.isnan(confidence).all() else confidence,
        frames=frames,
        labels=[label for own in labels for label in own],
        individuals=individuals,
        videos=called if several else None,
        landmark_names=names,
        individual_names=people,
        frame_count=sum(map(len, times)),
        frame_rate=_rate({each.rate for each in series if len(each.times) > 1}, times),
        unit="px" if dimensions == {2} else unit,
        edges=edges,
    )


def _animals(file: TrackerFile, group: str, depth: int) -> Iterator[tuple[str, list[Series]]]:
    """Yield the groups of all animals below a group that have series, and these."""
    for name in file.groups(group):
        below = f"{group}/{name}"
        if text(file.attribute(TYPE, below) or "") != POSE:
            if depth < DEEPEST:
                yield from _animals(file, below, depth + 1)
            continue
        inner = [(each, f"{below}/{each}") for each in file.groups(below)]
        own = [
            _series(file, place, group.rpartition("/")[2], name, landmark)
            for landmark, place in inner
            if text(file.attribute(TYPE, place) or "") == SERIES
        ]
        if own:
            yield below, own


def _series(file: TrackerFile, group: str, module: str, animal: str, landmark: str) -> Series:
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
        stated = _number(file, "rate", start, 0.0)
        rate = stated if stated > 0 else None
        times = first + np.arange(count) / (rate or 1.0)
    elif file.is_dataset(stamps := f"{group}/timestamps"):
        file.check_shape(stamps, (count,))
        times = file.numbers(stamps)
        if not np.isfinite(times).all() or (np.diff(times) <= 0).any():
            fix = "give each point a time of its own, in their order"
            raise file.fault(stamps, "does not increase", fix)
    else:
        raise file.fault(group, "has neither timestamps nor starting_time")
    factor = _number(file, "conversion", data, 1.0) or 1.0
    points = file.numbers(data) * factor + _number(file, "offset", data, 0.0)
    unit = text(file.attribute("unit", data) or "pixels").lower()
    return Series(module, animal, landmark, points, confidence, times, rate, unit)


def _number(file: TrackerFile, name: str, node: str, default: float) -> float:
    value = file.attribute(name, node)
    return float(value) if isinstance(value, int | float) and np.isfinite(value) else default


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
    file: TrackerFile, animals: Mapping[str, list[Series]]
) -> tuple[tuple[str, ...], Edges]:
    """Return all landmarks, in the order of skeletons, then of appearance; and their edges."""
    names: dict[str, None] = {}
    pairs: dict[tuple[str, str], None] = {}
    for group, series in animals.items():
        own = [each.landmark for each in series]
        if (skeleton := _skeleton(file, group, set(own))) is not None:
            nodes = file.texts(f"{skeleton}/nodes")
            check_unique(file.place(f"{skeleton}/nodes"), nodes, "node")
            lines = file.edges(f"{skeleton}/edges", len(nodes))
            pairs |= dict.fromkeys((nodes[a], nodes[b]) for a, b in lines)
            names |= dict.fromkeys(name for name in nodes if name in own)
        names |= dict.fromkeys(own)
    place = {name: number for number, name in enumerate(names)}
    edges = ((place[a], place[b]) for a, b in pairs if a in place and b in place)
    return tuple(names), tuple(edges)


def _join(
    own: list[Series], times: Floats, names: tuple[str, ...], people: tuple[str, ...]
) -> tuple[Floats, Floats, Integers, Integers]:
    """Return points (N, p, d), confidence (N, p), and frames and individuals (N,).

    A frame is one of the times (n,); an instance an animal with a point then.
    """
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
    return points[present], confidence[present], frame, individual


def _rate(stated: set[float | None], times: list[Floats]) -> float | None:
    """Return the frame rate that the series state, or that the times of all videos keep."""
    if len(stated) == 1 and (rate := next(iter(stated))) is not None:
        return rate
    steps = [np.diff(each) for each in times if len(each) > 2]
    if not steps or stated != {None}:
        return None
    every = np.concatenate(steps)
    middle = float(np.median(every))
    steady = bool((np.abs(every - middle) <= STEADY * middle).all())
    return 1 / middle if steady else None

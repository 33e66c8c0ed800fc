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
from shapefit.io.hdf5_file import Hdf5File, Stored
from shapefit.io.readers.poses import (
    PARSE_ERRORS,
    Edges,
    Poses,
    check_names,
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

    def groups(self, group: str = "/") -> tuple[str, ...]:
        """Return the names of the groups in a group."""
        with self.damage(group):
            node = self.root[group]
            return tuple(name for name in node if isinstance(node.get(name), h5py.Group))

    def has(self, name: str) -> bool:
        """Whether there is such a dataset or group."""
        with self.damage(name):
            return self.root.get(name) is not None

    def shape(self, name: str) -> tuple[int, ...]:
        """Return the shape of a dataset."""
        return self.stored(name).shape

    def numbers(self, name: str, *wanted: int | None) -> Floats:
        """Return a dataset as numbers, of the wanted shape if one is given; None is any length."""
        stored = self.stored(name)
        found = f"has the shape {stored.shape}, and {wanted or 'others'} are wanted"
        fits = len(wanted) == len(stored.shape) and all(
            length in (None, size) for length, size in zip(wanted, stored.shape, strict=True)
        )
        require(not wanted or fits, found.replace("None", "any"))
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


MOUSE = (
    "NOSE LEFT_EAR RIGHT_EAR BASE_NECK LEFT_FRONT_PAW RIGHT_FRONT_PAW CENTER_SPINE "
    "LEFT_REAR_PAW RIGHT_REAR_PAW BASE_TAIL MID_TAIL TIP_TAIL"
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
    names = tuple(MOUSE.split())
    with TrackerFile(path) as file:
        points = file.numbers("poseest/points")
        shape = points.shape
        require(points.ndim in (3, 4) and shape[-1] == 2, f"has the shape {shape}")
        several = points.ndim == 4
        points = (points if several else points[:, None])[..., ::-1]
        confidence = np.ones(points.shape[:3])
        if file.is_dataset("poseest/confidence"):
            confidence = file.numbers("poseest/confidence", *shape[:-1]).reshape(points.shape[:3])
        ids, absent = np.zeros(points.shape[:2], np.int64), np.zeros(points.shape[:2], bool)
        if several:
            ids, absent = _identities(file, *points.shape[:2])
    seen = confidence > 0
    lost = int((seen.any(axis=2) & absent).sum())
    named = points.shape[2] == len(names)
    return of_frames(
        path,
        np.where(seen[..., None], points, np.nan),
        confidence,
        present=~absent,
        video=sub(r"_pose_est(_v\d+)?$", "", video_name(path)),
        landmark_names=names if named else None,
        individuals=ids.astype(str) if several else None,
        edges=LINES if named else (),
        notes=(f"{lost} instances without an identity left out",) if lost else (),
    )


def _identities(file: TrackerFile, frames: int, many: int) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return who is where (frame, instance) in a file of several mice, and where is nobody."""
    identity, track = "poseest/instance_embed_id", "poseest/instance_track_id"
    stated = file.attribute("version", "poseest")
    version = stated[0] if isinstance(stated, list) and stated else stated
    by_identity = version > 3 if isinstance(version, int) else file.is_dataset(identity)
    ids = file.numbers(identity if by_identity else track, frames, many).astype(np.int64)
    if by_identity:
        return ids, ids <= 0
    counts = file.numbers("poseest/instance_count", frames)
    return ids, np.arange(many) >= counts[:, None]


SINGULAR = {"keypoints": "keypoint", "individuals": "individual"}

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
        frames, people, landmarks, coordinates = points.shape
        confidence = None
        if file.is_dataset("confidence"):
            confidence = _arranged(file, "confidence", WANTED[:3])
            fits = confidence.shape == points.shape[:3]
            require(fits, f"has the shape {confidence.shape}, and position {points.shape}")
        times = np.arange(frames, dtype=float)
        if file.is_dataset("time"):
            times = file.numbers("time", frames)
        labels = number_labels(file.place("time"), times)
        space = _names(file, "space", coordinates)
        require(space in (("x", "y"), ("x", "y", "z")), f"names the coordinates {', '.join(space)}")
        rate = file.attribute("fps")
        names = _names(file, "keypoint", landmarks)
        individuals = _names(file, "individual", people)
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
    axes = [SINGULAR.get(axis, axis) for axis in file.scales(name)]
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


TYPE = "neurodata_type"

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


def read_nwb(paths: tuple[Path, ...]) -> Poses:
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
    points, confidence, frame, who = map(np.concatenate, zip(*read, strict=True))
    labels = [number_labels("", at[own[2]]) for at, own in zip(times, read, strict=True)]
    called = [module for module, own in zip(modules, read, strict=True) for _ in own[2]]
    units = {each.unit for each in series}
    unit = UNITS.get(units.pop(), "unknown") if len(units) == 1 else "unknown"
    return Poses(
        name=str(path),
        video=called if several else video_name(path),
        points=points,
        confidence=None if np.isnan(confidence).all() else confidence,
        frame=frame,
        label=[label for own in labels for label in own],
        individual=[people[number] for number in who.tolist()],
        landmark_names=names,
        frame_count=sum(map(len, times)),
        frame_rate=_rate({each.rate for each in series if len(each.times) > 1}, times),
        unit="px" if dimensions == {2} else unit,
        edges=edges,
    )


def _animals(file: TrackerFile, group: str, depth: int) -> Iterator[tuple[str, list[Series]]]:
    """Yield the groups of all animals below a group that have series, and these."""
    for name in file.groups(group):
        below = f"{group}/{name}"
        if text(file.attribute(TYPE, below) or "") == "PoseEstimation":
            own = [
                _series(file, f"{below}/{landmark}", group.rpartition("/")[2], name, landmark)
                for landmark in file.groups(below)
                if text(file.attribute(TYPE, f"{below}/{landmark}")) == "PoseEstimationSeries"
            ]
            if own:
                yield below, own
        elif depth < DEEPEST:
            yield from _animals(file, below, depth + 1)


def _series(file: TrackerFile, group: str, module: str, animal: str, landmark: str) -> Series:
    data, scores, start, stamps = (
        f"{group}/{name}" for name in ("data", "confidence", "starting_time", "timestamps")
    )
    points = file.numbers(data, None, None)
    count, axes = points.shape
    require(axes in (2, 3), f"has {axes} coordinates")
    confidence = np.full(count, np.nan)
    if file.is_dataset(scores):
        confidence = file.numbers(scores, count)
    rate = None
    if file.is_dataset(start):
        require(file.shape(start) == (), "is no number; store the time of the first point")
        stated = _number(file, "rate", start, 0.0)
        rate = stated if stated > 0 else None
        times = file.numbers(start) + np.arange(count) / (rate or 1.0)
        require(np.isfinite(times).all(), "is no number; store the time of the first point")
    else:  # one of the two is there
        times = file.numbers(stamps, count)
        rising = np.isfinite(times).all() and (np.diff(times) > 0).all()
        require(rising, "does not increase; give each point a time of its own, in their order")
    factor = _number(file, "conversion", data, 1.0) or 1.0
    points = points * factor + _number(file, "offset", data, 0.0)
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
            check_names(nodes, "node")
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

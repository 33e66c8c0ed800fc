"""HDF5 of trackers of animals: SLEAP, JABS, movement, and NWB with ndx-pose."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from pathlib import Path, PureWindowsPath
from typing import Any

import h5py
import numpy as np

from shapefit.arrays import Floats
from shapefit.io.hdf5_file import Hdf5File
from shapefit.io.layout import UNKNOWN_UNIT
from shapefit.io.readers.poses import (
    Edges,
    Poses,
    make_unique,
    number_labels,
    of_frames,
    require,
    video_name,
)


class TrackerFile(Hdf5File):
    """An open HDF5 file of another tool."""

    def numbers(self, name: str) -> Floats:
        """Return a dataset as numbers."""
        values = np.asarray(self.rows(name))
        require(values.dtype.kind in "biuf", f"{name} holds no numbers")
        return values.astype(np.float64)

    def numbers_if_any(self, name: str) -> Floats | None:
        """Return a dataset as numbers; None where it is absent."""
        return self.numbers(name) if self.is_dataset(name) else None

    def texts(self, name: str) -> tuple[str, ...]:
        """Return a dataset of names; () where it is absent or empty, as SLEAP writes
        numbers.
        """
        values = np.ravel(
            np.asarray(self.rows(name), object) if self.is_dataset(name) else ()
        )
        require(
            all(isinstance(value, str) for value in values), f"{name} holds no text"
        )
        return tuple(values.tolist())

    def text(self, attribute: str, node: str = "/") -> str:
        """Return an attribute as text; "" for none."""
        value = self.attribute(attribute, node) or ""
        return (
            value.decode("utf-8", "backslashreplace")
            if isinstance(value, bytes)
            else str(value)
        )

    def number(self, attribute: str, node: str = "/") -> float:
        """Return an attribute that is a number above 0; 0 for none."""
        return max(float(self.attribute(attribute, node) or 0), 0.0)

    def edges(self, name: str, count: int) -> Edges:
        """Return the pairs of landmarks in a dataset (e, 2); none where it is absent or
        empty.
        """
        pairs = (
            self.numbers(name).reshape(-1, 2)
            if self.is_dataset(name)
            else np.empty((0, 2))
        )
        require(
            ((pairs >= 0) & (pairs < count)).all(), f"{name} points at no landmarks"
        )
        return tuple((int(a), int(b)) for a, b in pairs)


# SLEAP: the analysis HDF5, an array of all tracks, and .slp, tables of frames and
# instances.

SLEAP_ORDER = ("track", "xy", "node", "frame")
FRAMES_FIRST = ("frame", "track", "node", "xy")


def read_sleap_analysis(paths: tuple[Path, ...]) -> Poses:
    """Read an analysis file, whose array `tracks` is (track, xy, node, frame), as SLEAP
    writes it, or (frame, track, node, xy).

    Newer files name the axes in the attribute `dims`; in older ones the lengths decide:
    those of `node_names`, and of `track_occupancy` (frame, track).
    """
    with TrackerFile(paths[0]) as file:
        nodes, names = file.texts("node_names"), file.texts("track_names")
        tracks, dims = file.numbers("tracks"), file.attribute("dims", "tracks")
        scores = file.numbers_if_any("point_scores")
        occupancy = getattr(file.numbers_if_any("track_occupancy"), "shape", None)
        edges = file.edges("edge_inds", len(nodes))

    sleap = tracks.shape[1:3] == (2, len(nodes)), tracks.shape[3::-3] == occupancy
    frames_first = tracks.shape[2:] == (len(nodes), 2), tracks.shape[:2] == occupancy
    axes = [*(FRAMES_FIRST if frames_first > sleap else SLEAP_ORDER)]
    if dims is not None:
        axes = [*map(str, dims if isinstance(dims, list) else json.loads(dims))]
    # any order -> (frame, track, node, xy)
    points = tracks.transpose([axes.index(axis) for axis in FRAMES_FIRST])
    require(
        points.shape[2:] == (len(nodes), 2),
        f"tracks {tracks.shape} of {len(nodes)} nodes",
    )
    if scores is not None:
        axes.remove("xy")
        scores = scores.transpose([axes.index(axis) for axis in FRAMES_FIRST[:3]])
    many = points.shape[1]
    names = tuple(
        name or f"track_{number}" for number, name in enumerate(names or ("",) * many)
    )
    return of_frames(
        paths[0],
        points,
        scores,
        present=np.asarray(np.isfinite(points).any(axis=(2, 3))) if many > 1 else None,
        landmark_names=nodes,
        individuals=make_unique(names) or None,
        edges=edges,
    )


USER, PREDICTED = 0, 1


def read_slp(paths: tuple[Path, ...]) -> Poses:
    """Read a .slp file of one skeleton: tables of labelled frames, their instances and
    points.

    An instance that a user placed replaces the predicted one from which it was made, or
    which has its track in the frame. Before version 1.1 the middle of the first pixel
    was at 0.5.
    """
    with TrackerFile(paths[0]) as file:
        tracks = [str(json.loads(text)[1]) for text in file.texts("tracks_json")]
        videos = [json.loads(text) for text in file.texts("videos_json")]
        names, edges = _read_skeleton(json.loads(file.text("json", "metadata")))
        shift = 0.0 if file.number("format_id", "metadata") >= 1.1 else 0.5
        frames, instances = file.rows("frames"), file.rows("instances")
        tables = [file.rows("points"), file.rows("pred_points")]
    frames = frames[np.lexsort((frames["frame_idx"], frames["video"]))]
    start, end = (
        frames[f"instance_id_{name}"].astype(np.int64) for name in ("start", "end")
    )
    exist = (start >= 0) & (end >= start) & (end <= len(instances))
    require(exist.all(), "frames of instances that it does not hold")
    of_frame = np.repeat(np.arange(len(frames)), end - start)
    rows = [np.arange(*ends) for ends in zip(start.tolist(), end.tolist(), strict=True)]
    instances = instances[np.concatenate([np.empty(0, int), *rows])]
    video, frame = (
        frames[name][of_frame].astype(int) for name in ("video", "frame_idx")
    )
    track, kind = (instances[name].astype(int) for name in ("track", "instance_type"))
    first, last = (
        instances[f"point_id_{name}"].astype(np.int64) for name in ("start", "end")
    )
    exist = (track >= -1) & (track < len(tracks)) & (instances["skeleton"] == 0)
    exist &= (
        (video >= 0) & (video < (len(videos) or 1)) & np.isin(kind, (USER, PREDICTED))
    )
    exist &= (first >= 0) & (last - first == len(names))
    require(
        exist.all(),
        "instances of tracks, skeletons, videos or points that it does not hold",
    )
    points = np.full((len(instances), len(names), 3), np.nan)  # x, y, score
    for number, table in enumerate(tables):
        mine = kind == number
        cells = table[first[mine, None] + np.arange(len(names))]
        for place, axis in enumerate("xy"):
            points[mine, :, place] = np.where(
                cells["visible"], cells[axis] - shift, np.nan
            )
        if number == PREDICTED:
            points[mine, :, 2] = cells["score"]
    user = kind == USER
    keys = list(zip(video.tolist(), frame.tolist(), track.tolist(), strict=True))
    placed = {key for key, by_user in zip(keys, user.tolist(), strict=True) if by_user}
    origins = instances["from_predicted"][user & (instances["from_predicted"] >= 0)]
    replaced = np.array([key in placed and key[2] >= 0 for key in keys], bool)
    replaced = ~user & (replaced | np.isin(instances["instance_id"], origins))
    lost = int(replaced.sum())
    individuals = (*make_unique(tracks), "")
    files = [
        about.get("filename") or about["backend"].get("filename") for about in videos
    ]
    video_names = make_unique(
        [PureWindowsPath(str(name or "video")).stem for name in files]
    )
    return Poses(
        name=str(paths[0]),
        video=(
            [video_names[n] for n in video] if len(videos) > 1 else video_name(paths[0])
        ),
        points=points[..., :2],
        confidence=None if np.isnan(points[~replaced, :, 2]).all() else points[..., 2],
        frame=frame,
        label=[*map(str, frame.tolist())],
        individual=[individuals[number] for number in track.tolist()],  # -1: none
        landmark_names=names,
        unit="px",
        edges=edges,
        notes=(f"{lost} predicted instances replaced by those that a user placed",)
        * bool(lost),
    ).take(~replaced)


def _read_skeleton(about: Any) -> tuple[tuple[str, ...], Edges]:
    """Return the nodes of the one skeleton, and its edges: links whose type, or its
    place, is 1.
    """
    (skeleton,) = about["skeletons"]
    ids = [node["id"] for node in skeleton["nodes"]]
    types: list[int] = []
    edges: dict[tuple[int, int], None] = {}
    for link in skeleton.get("links", ()):
        kind = link.get("type") or {}
        if "py/reduce" in kind:
            types.append(kind["py/reduce"][1]["py/tuple"][0])
        stated = len(types) if "py/reduce" in kind else kind.get("py/id", 1)
        if dict(enumerate(types, 1)).get(stated, stated) == 1:
            edges[ids.index(link["source"]), ids.index(link["target"])] = None
    return tuple(str(about["nodes"][number]["name"]) for number in ids), tuple(edges)


# JABS and movement.

MOUSE = (
    *(
        "NOSE",
        "LEFT_EAR",
        "RIGHT_EAR",
        "BASE_NECK",
        "LEFT_FRONT_PAW",
        "RIGHT_FRONT_PAW",
    ),
    *(
        "CENTER_SPINE",
        "LEFT_REAR_PAW",
        "RIGHT_REAR_PAW",
        "BASE_TAIL",
        "MID_TAIL",
        "TIP_TAIL",
    ),
)
"""The landmarks of JABS, which its files do not name."""

LINES = (
    (0, 1),
    (0, 2),
    (0, 3),
    (3, 6),
    (6, 9),
    (9, 10),
    (10, 11),
    (6, 4),
    (6, 5),
    (9, 7),
    (9, 8),
)


def read_jabs(paths: tuple[Path, ...]) -> Poses:
    """Read version 2 of JABS, of one mouse: (frame, point, [y, x]), missing with
    confidence 0.
    """
    with TrackerFile(paths[0]) as file:
        points = file.numbers("poseest/points")[..., ::-1]
        confidence = file.numbers("poseest/confidence")
    require(points.ndim == 3, "later versions, of several mice, are not read")
    return of_frames(
        paths[0],
        np.where(confidence[..., None] > 0, points, np.nan),
        confidence,
        landmark_names=MOUSE,
        edges=LINES,
    )


AXES = ("time", "individual", "keypoint", "space")


def read_movement(paths: tuple[Path, ...]) -> Poses:
    """Read movement's netCDF, which is HDF5: `position` over time, space, keypoints,
    individuals, in any order; newer versions say `keypoint` and `individual`.
    """
    with TrackerFile(paths[0]) as file:
        kind = file.text("ds_type")
        require(kind == "poses", f"{kind or 'data of no stated type'}, not poses")
        points, times = _arranged(file, "position", AXES), file.numbers_if_any("time")
        scored = file.is_dataset("confidence")
        confidence = _arranged(file, "confidence", AXES[:3]) if scored else None
        individuals, landmarks, space = (
            file.texts(axis if file.is_dataset(axis) else f"{axis}s")
            for axis in AXES[1:]
        )
        rate = file.number("fps")
    require(
        space == tuple("xyz"[: points.shape[3]]), f"the coordinates {', '.join(space)}"
    )
    return of_frames(
        paths[0],
        points,
        confidence,
        None if times is None else number_labels(times),
        landmark_names=landmarks,
        individuals=individuals,
        frame_rate=rate or None,
    )


def _arranged(file: TrackerFile, name: str, wanted: Sequence[str]) -> Floats:
    """Return a dataset with the wanted axes in order."""
    # h5py's own `dims` can abort the process on damaged files
    scales = file.root[name].attrs["DIMENSION_LIST"]
    paths = [h5py.h5r.get_name(scale[0], file.root.id) or b"" for scale in scales]
    axes = [path.decode().strip("/").removesuffix("s") for path in paths]
    require(sorted(wanted) == sorted(axes), f"{name} has the axes {', '.join(axes)}")
    return file.numbers(name).transpose([axes.index(axis) for axis in wanted])


# NWB.

POSES_OF_NWB = ("PoseEstimationSeries", "PoseEstimation")
UNITS = {"m": "m", "meter": "m", "meters": "m", "metres": "m"}

Series = tuple[
    Floats, Floats, Floats, float, str
]  # points, confidence, times, rate or 0, unit


def read_nwb(paths: tuple[Path, ...]) -> Poses:
    """Read all PoseEstimations of `processing`; ValueError where there is none, or one
    twice.
    """
    series: dict[tuple[str, str], Series] = {}
    with TrackerFile(paths[0]) as file:
        groups = [*_groups(file, "processing", 5)]  # modules, animals and their series
        kinds = {name: file.text("neurodata_type", name) for name in groups}
        for name in groups:
            if (kinds[name], kinds.get(name.rpartition("/")[0])) == POSES_OF_NWB:
                *_, animal, landmark = name.split("/")
                once = (animal, landmark) not in series
                require(
                    once,
                    "animals of one name in several modules; save each in its own file",
                )
                series[animal, landmark] = _read_series(file, name)
        require(series, "no PoseEstimation (ndx-pose), so no landmarks")
        skeleton = next((name for name in groups if file.texts(f"{name}/nodes")), "")
        nodes = file.texts(f"{skeleton}/nodes")
        pairs = file.edges(f"{skeleton}/edges", len(nodes))
    landmarks = [*dict.fromkeys(landmark for _, landmark in series)]
    names = [
        *dict.fromkeys([*(node for node in nodes if node in landmarks), *landmarks])
    ]
    animals = [*dict.fromkeys(animal for animal, _ in series)]
    all_points, _, all_times, all_rates, all_units = zip(*series.values(), strict=True)
    axes, units = {points.shape[1] for points in all_points}, {*all_units}
    require(len(axes) == 1, "2D and 3D series; save them in files of their own")
    times = np.unique(np.concatenate(all_times))
    cells = np.full((len(times), len(animals), len(names), *axes), np.nan)
    confidence = np.full(cells.shape[:3], np.nan)
    present = np.zeros(cells.shape[:2], bool)
    for (animal, landmark), (points, scores, at, *_) in series.items():
        rows, number = np.searchsorted(times, at), animals.index(animal)
        place = rows, number, names.index(landmark)
        cells[place], confidence[place], present[rows, number] = points, scores, True
    steps = np.diff(times)
    rates = {rate for rate, at in zip(all_rates, all_times, strict=True) if len(at) > 1}
    if rates == {0.0} and len(steps) > 1 and np.ptp(steps) <= 0.02 * np.median(steps):
        rates = {1 / float(np.median(steps))}
    return of_frames(
        paths[0],
        cells,
        None if np.isnan(confidence).all() else confidence,
        number_labels(times),
        individuals=animals,
        present=present,
        landmark_names=tuple(names),
        frame_rate=(rates.pop() or None) if len(rates) == 1 else None,
        unit="px" if axes == {2} else units.pop() if len(units) == 1 else UNKNOWN_UNIT,
        edges=tuple(
            (names.index(nodes[a]), names.index(nodes[b]))
            for a, b in pairs
            if {nodes[a], nodes[b]} <= {*landmarks}
        ),
    )


def _groups(file: TrackerFile, group: str, levels: int) -> Iterator[str]:
    """Yield the groups below a group, so many levels deep."""
    for name, node in file.root[group].items() if levels and group in file.root else ():
        if isinstance(node, h5py.Group):
            yield f"{group}/{name}"
            yield from _groups(file, f"{group}/{name}", levels - 1)


def _read_series(file: TrackerFile, group: str) -> Series:
    """Return points (n, 2 or 3), confidence (n,), times (n,) in s, rate in Hz or 0, and
    unit.
    """
    data, start, rate = f"{group}/data", f"{group}/starting_time", 0.0
    points = file.numbers(data) * (file.number("conversion", data) or 1.0)
    points += file.attribute("offset", data) or 0.0
    confidence = file.numbers_if_any(f"{group}/confidence")
    confidence = np.full(len(points), np.nan) if confidence is None else confidence
    if file.is_dataset(start):
        rate = file.number("rate", start)
        times = file.numbers(start) + np.arange(len(points)) / (rate or 1.0)
    else:
        times = file.numbers(f"{group}/timestamps")
    rising = np.isfinite(times).all() and (np.diff(times) > 0).all()
    require(rising, f"the times of {group} do not increase")
    fits = times.shape == confidence.shape == points.shape[:-1]
    require(fits, f"{group} has other numbers of points, times and confidences")
    return (
        points,
        confidence,
        times,
        rate,
        UNITS.get(file.text("unit", data).lower(), UNKNOWN_UNIT),
    )

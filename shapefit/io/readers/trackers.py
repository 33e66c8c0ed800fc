"""HDF5 of trackers of animals: SLEAP, JABS, movement, and NWB with ndx-pose."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from math import prod
from pathlib import Path
from re import sub
from typing import Any, NamedTuple

import h5py
import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Flags, Floats, Integers
from shapefit.errors import input_error, printable
from shapefit.io.hdf5_file import Hdf5File, Stored
from shapefit.io.readers.poses import (
    PARSE_ERRORS,
    Edges,
    Poses,
    check_names,
    file_name,
    make_unique,
    message,
    number_labels,
    of_frames,
    require,
    video_name,
)

REPEATED = "{} ({})"
"""What a name that is there already is called."""


class TrackerFile(Hdf5File):
    """An open HDF5 file of another tool.

    An error while it is open is reported of the dataset that was read last.
    """

    last = ""

    def __exit__(self, *raised: object) -> None:
        super().__exit__()
        if isinstance(error := raised[1], PARSE_ERRORS):
            raise self.fault(self.last, message(error)) from error

    def stored(self, name: str) -> Stored:
        """Return a dataset, which errors name from now on."""
        self.last = name
        return super().stored(name)

    def groups(self, group: str, levels: int = 1) -> Iterator[str]:
        """Yield the groups below a group that is there, so many levels deep."""
        with self.damage(group):
            nodes = self.root.get(group, {})
            names = [name for name in nodes if isinstance(nodes.get(name), h5py.Group)]
        for name in names:
            yield (below := f"{group}/{name}".strip("/"))
            if levels > 1:
                yield from self.groups(below, levels - 1)

    def numbers(self, name: str, *wanted: int | None) -> Floats:
        """Return a dataset as numbers, of the wanted shape if one is given; None is any length."""
        shape = self.stored(name).shape
        fits = [length in (None, size) for length, size in zip(wanted, shape, strict=False)]
        text = str(wanted).replace("None", "any")
        fitting = not wanted or (len(wanted) == len(shape) and all(fits))
        require(fitting, f"has the shape {shape}, not {text}")
        require(self.stored(name).dataset.dtype.kind in "biuf", "holds no numbers")
        return np.asarray(self.rows(name), np.float64)

    def number(self, attribute: str, node: str) -> float:
        """Return an attribute that is a number; 0 for none."""
        value = self.attribute(attribute, node)
        return float(value) if isinstance(value, int | float) and np.isfinite(value) else 0.0

    def text(self, attribute: str, node: str = "/") -> str:
        """Return an attribute as text; "" for none."""
        return as_text(self.attribute(attribute, node) or "")

    def table(self, name: str, *columns: str) -> Any:
        """Return a table of these columns, and maybe others, as it stands in the file."""
        stored = self.stored(name)
        lost = {*columns} - {*(stored.dataset.dtype.names or ())}
        require(not lost and len(stored.shape) == 1, f"is no table of {', '.join(columns)}")
        return self.rows(name)

    def texts(self, name: str) -> tuple[str, ...]:
        """Return a dataset of names."""
        stored = self.stored(name)
        require(prod(stored.shape) <= 1_000_000, f"holds {stored.shape} names")
        if not stored.text:  # SLEAP writes lists without entries as numbers
            require(stored.dataset.size == 0, "holds no text")
            return ()
        with self.damage(name):
            return tuple(map(as_text, np.ravel(stored.dataset[()])))

    def edges(self, name: str, count: int) -> Edges:
        """Return the pairs of landmarks in a dataset (e, 2); none where it is absent or empty."""
        if not self.is_dataset(name) or 0 in self.stored(name).shape:
            return ()
        pairs = self.numbers(name, None, 2)
        there = ((pairs >= 0) & (pairs < count)).all()
        require(there, "points at landmarks that are not there")
        return tuple((int(a), int(b)) for a, b in pairs)


def as_text(value: Any) -> str:
    """Return bytes of a file as text; what is not UTF-8 as escapes."""
    return value.decode("utf-8", "backslashreplace") if isinstance(value, bytes) else str(value)


# SLEAP: the analysis HDF5, an array of all tracks, and .slp, tables of frames and instances.

SLEAP_ORDER = ("track", "xy", "node", "frame")
FRAMES_FIRST = ("frame", "track", "node", "xy")


def read_sleap_analysis(paths: tuple[Path, ...]) -> Poses:
    """Read an analysis file, whose array `tracks` has one of two orders of its axes.

    SLEAP writes (track, xy, node, frame), others (frame, track, node, xy). Newer files name the
    axes in the attribute `dims`; in older ones the lengths decide: of `node_names`, and of
    `track_occupancy`, which is (frame, track) in both. Of several tracks, those that are in a frame
    are its instances.
    """
    path = paths[0]
    with TrackerFile(path) as file:
        nodes = file.texts("node_names")
        occupied = file.is_dataset("track_occupancy") and file.stored("track_occupancy").shape
        tracks = file.numbers("tracks", None, None, None, None)

        def agreement(order: tuple[str, ...]) -> tuple[bool, bool]:
            size = dict(zip(order, tracks.shape, strict=True))
            named = (size["xy"], size["node"]) == (2, len(nodes))
            return named, (size["frame"], size["track"]) == occupied

        axes = _axes(file, "tracks", max(SLEAP_ORDER, FRAMES_FIRST, key=agreement))
        # any order -> (frame, track, node, xy)
        points = tracks.transpose([axes.index(axis) for axis in FRAMES_FIRST])
        fits = points.shape[2:] == (len(nodes), 2)
        require(fits, f"has the shape {tracks.shape} for {len(nodes)} nodes")
        confidence = None
        if file.is_dataset("point_scores"):
            order = _axes(file, "point_scores", tuple(axis for axis in axes if axis != "xy"))
            sizes = [tracks.shape[axes.index(axis)] for axis in order]
            scores = file.numbers("point_scores", *sizes)
            confidence = scores.transpose([order.index(axis) for axis in FRAMES_FIRST[:3]])
        edges = file.edges("edge_inds", len(nodes))
        names = file.texts("track_names") if file.is_dataset("track_names") else ()
    many = points.shape[1]
    names = tuple(name or f"track_{n}" for n, name in enumerate(names or ("",) * many))
    return of_frames(
        path,
        points,
        confidence,
        present=np.asarray(np.isfinite(points).any(axis=(2, 3))) if many > 1 else None,
        landmark_names=nodes,
        individuals=make_unique(names, REPEATED)[0] or None,
        edges=edges,
    )


def _axes(file: TrackerFile, name: str, default: tuple[str, ...]) -> tuple[str, ...]:
    """Return the axes that the attribute `dims` of a dataset names, or else the default."""
    stated = file.attribute("dims", name)
    if stated is None:
        return default
    axes = stated if isinstance(stated, list) else json.loads(as_text(stated))
    axes = tuple(map(as_text, axes))
    require(sorted(axes) == sorted(default), f"has `dims` {axes}, not {', '.join(default)}")
    return axes


USER, PREDICTED = 0, 1
FRAME_COLUMNS = ("video", "frame_idx", "instance_id_start", "instance_id_end")
INSTANCE_COLUMNS = (
    *("instance_id", "instance_type", "skeleton", "track", "from_predicted"),
    *("point_id_start", "point_id_end"),
)


def read_slp(paths: tuple[Path, ...]) -> Poses:
    """Read a .slp file: tables of labelled frames, of their instances, and of their points.

    An instance that a user placed takes the place of the predicted one from which it was made, or
    which has its track in the same frame. Before version 1.1 of the format the middle of the first
    pixel was at 0.5.
    """
    path = paths[0]
    with TrackerFile(path) as file:
        tracks, videos = (
            [json.loads(text) for text in file.texts(name)] if file.is_dataset(name) else []
            for name in ("tracks_json", "videos_json")
        )
        names, skeletons, edges = _read_skeletons(file)
        sizes = np.array([len(places) for places in skeletons])
        limits = {"instance_type": 2, "skeleton": len(sizes), "video": max(len(videos), 1)}
        instances, labelled = _read_instances(file, limits | {"track": len(tracks)})
        lengths = instances["point_id_end"] - instances["point_id_start"]
        same = (lengths == sizes[instances["skeleton"]]).all()
        require(same, "has another number of points than its skeleton")
        replaced = _replaced(instances)
        instances = {column: values[~replaced] for column, values in instances.items()}
        version = file.number("format_id", "metadata")
        points = np.full((len(instances["track"]), len(names), 2), np.nan)
        confidence = np.full(points.shape[:2], np.nan)
        for kind, table in ((USER, "points"), (PREDICTED, "pred_points")):
            for number, places in enumerate(skeletons):
                own = (instances["instance_type"] == kind) & (instances["skeleton"] == number)
                if not own.any():
                    continue
                cells = file.table(table, "visible", "x", "y", *["score"] * kind)
                first = instances["point_id_start"][own]
                require(first.min() >= 0, "has other points than those that `instances` points at")
                rows = cells[first[:, None] + np.arange(len(places))]
                xy = np.stack([rows["x"], rows["y"]], axis=-1).astype(np.float64)
                xy -= 0.5 if version < 1.1 else 0.0
                visible = rows["visible"].astype(bool)[..., None]
                points[np.ix_(own, places)] = np.where(visible, xy, np.nan)
                if kind == PREDICTED:
                    confidence[np.ix_(own, places)] = rows["score"]
    individuals = (*make_unique([str(track[1]) for track in tracks], REPEATED)[0], "")  # -1: none
    video_names, _ = make_unique([_video(video) for video in videos], REPEATED)
    several, lost = len(videos) > 1, int(replaced.sum())
    return Poses(
        name=str(path),
        video=[video_names[n] for n in instances["video"]] if several else video_name(path),
        points=points,
        confidence=None if np.isnan(confidence).all() else confidence,
        frame=instances["frame_idx"],
        label=[*map(str, instances["frame_idx"].tolist())],
        individual=[individuals[number] for number in instances["track"].tolist()],
        landmark_names=names,
        frame_count=labelled,
        unit="px",
        edges=edges,
        notes=(f"{lost} predicted instances replaced by those that a user placed",) * bool(lost),
    )


def _read_skeletons(
    file: TrackerFile,
) -> tuple[tuple[str, ...], list[NDArray[np.intp]], Edges]:
    """Return the landmarks of all skeletons, the places of the nodes of each, and all edges.

    The type of a link, 1 for bones and 2 for symmetries, is stated in full the first time, later
    by its place among those.
    """
    about = json.loads(file.text("json", "metadata") or "{}")
    nodes = [str(node["name"]) for node in about["nodes"]]
    skeletons, pairs = [], []
    for skeleton in about["skeletons"]:
        graph = skeleton.get("nx_graph", skeleton)
        skeletons.append([nodes[node["id"]] for node in graph["nodes"]])
        check_names(skeletons[-1], "node of a skeleton")
        types: list[int] = []
        for link in graph.get("links", ()):
            kind = link.get("type") or {}
            if "py/reduce" in kind:
                types.append(kind["py/reduce"][1]["py/tuple"][0])
            stated = kind.get("py/id", 1)
            stated = dict(enumerate(types, 1)).get(stated, stated)
            if (types[-1] if "py/reduce" in kind else stated) == 1:
                pairs.append((nodes[link["source"]], nodes[link["target"]]))
    place = {n: i for i, n in enumerate(dict.fromkeys(n for own in skeletons for n in own))}
    require(place, "has no skeleton with nodes")
    edges = dict.fromkeys((place[a], place[b]) for a, b in pairs if {a, b} <= place.keys())
    places = [np.array([place[name] for name in own], np.intp) for own in skeletons]
    return tuple(place), places, tuple(edges)


def _read_instances(file: TrackerFile, limits: dict[str, int]) -> tuple[dict[str, Integers], int]:
    """Return columns of all instances, sorted by video and frame, and the number of frames.

    limits: how many there are of what a column numbers.
    """
    frames = file.table("frames", *FRAME_COLUMNS)
    table = file.table("instances", *INSTANCE_COLUMNS)
    frames = frames[np.lexsort((frames["frame_idx"], frames["video"]))]
    start, end = (frames[f"instance_id_{name}"].astype(np.int64) for name in ("start", "end"))
    there = (start >= 0) & (end >= start) & (end <= len(table))
    require(there.all(), "has other instances than those that `frames` points at")
    owner = np.repeat(np.arange(len(frames)), end - start)
    first = np.cumsum(end - start) - (end - start)
    rows = np.arange(len(owner)) + (start - first)[owner]
    columns = {name: table[name][rows].astype(np.int64) for name in INSTANCE_COLUMNS}
    columns |= {name: frames[name][owner].astype(np.int64) for name in ("frame_idx", "video")}
    for name, count in limits.items():
        values, lowest = columns[name], -1 if name == "track" else 0
        wrong = values[(values < lowest) | (values >= count)]
        require(not wrong.size, f"has the {name} {wrong[:1].sum()} of {count}")
    return columns, len(frames)


def _replaced(instances: dict[str, Integers]) -> Flags:
    """Whether each instance is a predicted one for which a user placed another."""
    user: Flags = instances["instance_type"] == USER
    columns = (instances[name].tolist() for name in ("video", "frame_idx", "track"))
    keys = list(zip(*columns, strict=True))
    placed = {key for key, own in zip(keys, user.tolist(), strict=True) if own and key[2] >= 0}
    origins = instances["from_predicted"][user & (instances["from_predicted"] >= 0)]
    same_track = np.array([key in placed for key in keys], bool)
    return ~user & (same_track | np.isin(instances["instance_id"], origins))


def _video(video: Any) -> str:
    """Return what a video is called: its name without suffix, or the folder of its images."""
    backend = video.get("backend") or {}
    name = video.get("filename") or backend.get("filename") or backend.get("filenames") or "video"
    if isinstance(name, list):
        name = str(name[0]).replace("\\", "/").rpartition("/")[0]
    return Path(file_name(str(name))).stem or "video"


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
    visible = confidence > 0
    lost = int((visible.any(axis=-1).reshape(absent.shape) & absent).sum())
    named = points.shape[-2] == len(MOUSE)
    return of_frames(
        path,
        np.where(visible[..., None], points, np.nan),
        confidence,
        present=~absent,
        video=sub(r"_pose_est(_v\d+)?$", "", video_name(path)),
        landmark_names=MOUSE if named else None,
        individuals=ids.astype(int).astype(str) if many else None,
        edges=LINES if named else (),
        notes=(f"{lost} instances without an identity left out",) if lost else (),
    )


AXES = ("time", "individual", "keypoint", "space")


def read_movement(paths: tuple[Path, ...]) -> Poses:
    """Read movement's netCDF, which is HDF5: `position` over time, space, keypoints, individuals.

    The axes are named by dimension scales, in any order. Newer versions say `keypoint` and
    `individual`; one individual or keypoint that was picked out has no axis.
    """
    path = paths[0]
    with TrackerFile(path) as file:
        if (kind := file.text("ds_type")) != "poses":
            problem = f"holds {printable(kind) or 'data of no stated type'}, not poses"
            fix = "give a data set of poses; bounding boxes have no landmarks"
            raise input_error(path, problem, fix)
        points = _arranged(file, "position", AXES)
        confidence = None
        if file.is_dataset("confidence"):
            confidence = _arranged(file, "confidence", AXES[:3])
            fits = confidence.shape == points.shape[:3]
            require(fits, f"has the shape {confidence.shape}, and position {points.shape}")
        labels = None
        if file.is_dataset("time"):
            labels = number_labels(file.place("time"), file.numbers("time", len(points)))
        names: dict[str, tuple[str, ...]] = {}
        for axis, size in zip(AXES[1:], points.shape[1:], strict=True):
            there = [name for name in (axis, f"{axis}s") if file.is_dataset(name)]
            texts = there and file.stored(there[0]).text
            numbered = tuple(f"{axis}_{number}" for number in range(size))
            names[axis] = file.texts(there[0]) if texts else numbered
            require(len(names[axis]) == size, f"names {len(names[axis])}, and there are {size}")
        space = names["space"]
        require(space in (("x", "y"), ("x", "y", "z")), f"names the coordinates {', '.join(space)}")
        rate = file.number("fps", "/")
    return of_frames(
        path,
        points,
        confidence,
        labels,
        landmark_names=names["keypoint"],
        individuals=names["individual"],
        frame_rate=rate if rate > 0 else None,
    )


def _arranged(file: TrackerFile, name: str, wanted: Sequence[str]) -> Floats:
    """Return a dataset with the wanted axes in order; an animal or point picked out is 1 long."""
    dataset = file.stored(name).dataset
    with file.damage(name):  # h5py's own `dims` can abort the process on damaged files
        scales = dataset.attrs["DIMENSION_LIST"]
        names = [as_text(h5py.h5r.get_name(own[0], file.root.id) or b"") for own in scales]
    axes = [axis.strip("/").removesuffix("s") for axis in names]
    retained = [axis for axis in wanted if axis in axes]
    needed = {"time", *wanted[3:]} <= {*axes}
    require(needed and sorted(retained) == sorted(axes), f"has the axes {', '.join(axes)}")
    values = file.numbers(name).transpose([axes.index(axis) for axis in retained])
    sizes = dict(zip(retained, values.shape, strict=True))
    return values.reshape([sizes.get(axis, 1) for axis in wanted])


# NWB.

UNITS = {"pixel": "px", "pixels": "px", "px": "px", "meters": "m", "metres": "m", "meter": "m"}


class Series(NamedTuple):
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
        groups = tuple(file.groups("processing", 5))  # modules, animals and their series
        kinds = {name: file.text("neurodata_type", name) for name in groups}
        series = [
            _read_series(file, name)
            for name in groups
            if kinds[name] == "PoseEstimationSeries"
            and kinds.get(name.rpartition("/")[0]) == "PoseEstimation"
        ]
        if not series:
            problem = "holds no PoseEstimation (ndx-pose), so no landmarks"
            raise input_error(path, problem, "give a file of estimated poses")
        names, edges = _skeletons_of(file, groups, series)
    dimensions = {one.points.shape[1] for one in series}
    if len(dimensions) > 1:
        raise input_error(path, "holds 2D and 3D series", "save them in files of their own")
    people = [*dict.fromkeys(one.animal for one in series)]
    several = len(people) < len({(one.module, one.animal) for one in series})
    videos, labels, times = [], [], []
    parts: list[tuple[Floats, Integers, Integers]] = []
    for module in dict.fromkeys(one.module if several else "" for one in series):
        own = [one for one in series if one.module == module or not several]
        times.append(np.unique(np.concatenate([one.times for one in own])))
        # x, y, [z,] confidence of each landmark of each animal
        cells = np.full((len(times[-1]), len(people), len(names), max(dimensions) + 1), np.nan)
        present = np.zeros(cells.shape[:2], bool)
        for one in own:
            at, who = np.searchsorted(times[-1], one.times), people.index(one.animal)
            values = np.column_stack([one.points, one.confidence])
            cells[at, who, names.index(one.landmark)] = values
            present[at, who] = True
        frame, individual = np.nonzero(present)
        parts.append((cells[present], frame, individual))
        texts = number_labels(str(path), times[-1])
        labels += [texts[number] for number in frame.tolist()]
        videos += [module] * len(frame)
    cells, frame, individual = map(np.concatenate, zip(*parts, strict=True))
    units = {UNITS.get(one.unit, "unknown") for one in series}
    return Poses(
        name=str(path),
        video=videos if several else video_name(path),
        points=cells[..., :-1],
        confidence=None if np.isnan(cells[..., -1]).all() else cells[..., -1],
        frame=frame,
        label=labels,
        individual=[people[number] for number in individual.tolist()],
        landmark_names=tuple(names),
        frame_count=sum(map(len, times)),
        frame_rate=_frame_rate(series, times),
        unit="px" if dimensions == {2} else units.pop() if len(units) == 1 else "unknown",
        edges=edges,
    )


def _read_series(file: TrackerFile, group: str) -> Series:
    module, animal, landmark = group.split("/")[-3:]
    data, scores, start = (f"{group}/{name}" for name in ("data", "confidence", "starting_time"))
    points = file.numbers(data, None, None)
    count, axes = points.shape
    require(axes in (2, 3), f"has {axes} coordinates")
    points = points * (file.number("conversion", data) or 1.0) + file.number("offset", data)
    unit = (file.text("unit", data) or "pixels").lower()
    confidence = file.numbers(scores, count) if file.is_dataset(scores) else np.full(count, np.nan)
    rate = None
    if file.is_dataset(start):
        rate = max(file.number("rate", start), 0.0) or None
        times = file.numbers(start).reshape(()) + np.arange(count) / (rate or 1.0)
        require(np.isfinite(times).all(), "is no number; store the time of the first point")
    else:
        times = file.numbers(f"{group}/timestamps", count)
        rising = np.isfinite(times).all() and (np.diff(times) > 0).all()
        require(rising, "does not increase; give each point a time of its own, in their order")
    return Series(module, animal, landmark, points, confidence, times, rate, unit)


def _skeletons_of(
    file: TrackerFile, groups: Sequence[str], series: Sequence[Series]
) -> tuple[list[str], Edges]:
    """Return all landmarks, in the order of skeletons, then of appearance; and their edges.

    The skeleton of an animal is the first that has all of its landmarks; its own comes first.
    """
    names: dict[str, None] = {}
    pairs: dict[tuple[str, str], None] = {}
    nodes = {g: file.texts(f"{g}/nodes") for g in groups if file.is_dataset(f"{g}/nodes")}
    for module, animal in dict.fromkeys((one.module, one.animal) for one in series):
        own = {one.landmark: None for one in series if (one.module, one.animal) == (module, animal)}
        near = sorted(nodes, key=lambda name: f"/{module}/{animal}/" not in f"{name}/")
        group = next((name for name in near if own.keys() <= {*nodes[name]}), None)
        if group is not None:
            lines = file.edges(f"{group}/edges", len(nodes[group]))
            pairs |= dict.fromkeys((nodes[group][a], nodes[group][b]) for a, b in lines)
            names |= dict.fromkeys(name for name in nodes[group] if name in own)
        names |= own
    order = [*names]
    edges = ((order.index(a), order.index(b)) for a, b in pairs if {a, b} <= names.keys())
    return order, tuple(edges)


def _frame_rate(series: Sequence[Series], times: Sequence[Floats]) -> float | None:
    """Return the frame rate that the series state, or that the times of all videos keep to 1%."""
    stated = {one.rate for one in series if len(one.times) > 1}
    if len(stated) == 1 and (rate := stated.pop()) is not None:
        return rate
    steps = [np.diff(own) for own in times if len(own) > 2]
    if stated or not steps:
        return None
    middle = float(np.median(np.concatenate(steps)))
    smooth = all((np.abs(own - middle) <= 0.01 * middle).all() for own in steps)
    return 1 / middle if smooth else None

"""HDF5 of trackers of animals: SLEAP, JABS, movement, and NWB with ndx-pose."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from re import sub
from typing import Any, NamedTuple

import h5py
import numpy as np

from shapefit.arrays import Floats
from shapefit.errors import input_error, printable
from shapefit.io.hdf5_file import DAMAGED, Hdf5File
from shapefit.io.layout import UNKNOWN_UNIT
from shapefit.io.readers.poses import (
    Edges,
    Poses,
    file_name,
    make_unique,
    number_labels,
    of_frames,
    parsing,
    require,
    video_name,
)

REPEATED = "{} ({})"
"""What a name that is there already is called."""


@contextmanager
def open_tracker(path: Path) -> Iterator[TrackerFile]:
    """Open an HDF5 file of another tool; errors are reported of the dataset that was read last."""
    with TrackerFile(path) as file, parsing(lambda: file.place(file.last), DAMAGED):
        yield file


class TrackerFile(Hdf5File):
    """An open HDF5 file of another tool."""

    last = ""

    def numbers(self, name: str) -> Floats:
        """Return a dataset as numbers."""
        self.last = name
        values = self.rows(name)
        require(np.asarray(values).dtype.kind in "biuf", "holds no numbers")
        return np.asarray(values, np.float64)

    def table(self, name: str) -> Any:
        """Return a table of named columns as it stands in the file."""
        self.last = name
        return self.rows(name)

    def texts(self, name: str) -> tuple[str, ...]:
        """Return a dataset of names; () where it is absent or empty, as SLEAP writes numbers."""
        self.last = name
        if not self.is_dataset(name) or self.stored(name).dataset.size == 0:
            return ()
        require(self.stored(name).text, "holds no text")
        with self.damage(name):
            return tuple(map(as_text, np.ravel(self.stored(name).dataset[()])))

    def text(self, attribute: str, node: str = "/") -> str:
        """Return an attribute as text; "" for none."""
        return as_text(self.attribute(attribute, node) or "")

    def number(self, attribute: str, node: str) -> float:
        """Return an attribute that is a number; 0 for none."""
        value = self.attribute(attribute, node)
        return float(value) if isinstance(value, int | float) and np.isfinite(value) else 0.0

    def edges(self, name: str, count: int) -> Edges:
        """Return the pairs of landmarks in a dataset (e, 2); none where it is absent or empty."""
        if not self.is_dataset(name) or 0 in self.stored(name).shape:
            return ()
        pairs = self.numbers(name)
        fits = pairs.ndim == 2 and pairs.shape[1] == 2 and ((pairs >= 0) & (pairs < count)).all()
        require(fits, "points at landmarks that are not there")
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
    with open_tracker(path) as file:
        nodes = file.texts("node_names")
        occupied = file.is_dataset("track_occupancy") and file.stored("track_occupancy").shape
        tracks = file.numbers("tracks")

        def agreement(order: tuple[str, ...]) -> tuple[bool, bool]:
            size = dict(zip(order, tracks.shape, strict=True))
            named = (size["xy"], size["node"]) == (2, len(nodes))
            return named, (size["frame"], size["track"]) == occupied

        axes = _dims(file, "tracks", max(SLEAP_ORDER, FRAMES_FIRST, key=agreement))
        # any order -> (frame, track, node, xy)
        points = tracks.transpose([axes.index(axis) for axis in FRAMES_FIRST])
        fits = points.shape[2:] == (len(nodes), 2)
        require(fits, f"has the shape {tracks.shape} for {len(nodes)} nodes")
        confidence = None
        if file.is_dataset("point_scores"):
            order = _dims(file, "point_scores", tuple(axis for axis in axes if axis != "xy"))
            scores = file.numbers("point_scores")
            confidence = scores.transpose([order.index(axis) for axis in FRAMES_FIRST[:3]])
        edges = file.edges("edge_inds", len(nodes))
        names = file.texts("track_names")
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


def _dims(file: TrackerFile, name: str, default: tuple[str, ...]) -> tuple[str, ...]:
    """Return the axes that the attribute `dims` of a dataset names, or else the default."""
    stated = file.attribute("dims", name)
    if stated is None:
        return default
    axes = stated if isinstance(stated, list) else json.loads(as_text(stated))
    axes = tuple(map(as_text, axes))
    require(sorted(axes) == sorted(default), f"has `dims` {axes}, not {', '.join(default)}")
    return axes


USER, PREDICTED = 0, 1


def read_slp(paths: tuple[Path, ...]) -> Poses:
    """Read a .slp file of one skeleton: tables of labelled frames, their instances and points.

    An instance that a user placed takes the place of the predicted one from which it was made, or
    which has its track in the same frame. Before version 1.1 of the format the middle of the first
    pixel was at 0.5.
    """
    path = paths[0]
    with open_tracker(path) as file:
        tracks, videos = (
            [json.loads(text) for text in file.texts(name)]
            for name in ("tracks_json", "videos_json")
        )
        shift = 0.0 if file.number("format_id", "metadata") >= 1.1 else 0.5
        names, edges = _read_skeleton(file)
        frames, table = file.table("frames"), file.table("instances")
        file.last = "frames"
        frames = frames[np.lexsort((frames["frame_idx"], frames["video"]))]
        start, end = (frames[f"instance_id_{name}"].astype(np.int64) for name in ("start", "end"))
        there = (start >= 0) & (end >= start) & (end <= len(table))
        require(there.all(), "points at instances that are not there")
        file.last = "instances"
        owner = np.repeat(np.arange(len(frames)), end - start)
        rows = [np.arange(*own) for own in zip(start.tolist(), end.tolist(), strict=True)]
        instances = table[np.concatenate([np.empty(0, int), *rows])]
        video, frame = (frames[name][owner].astype(int) for name in ("video", "frame_idx"))
        track, kind = (instances[name].astype(int) for name in ("track", "instance_type"))
        there = (track >= -1) & (track < len(tracks)) & (instances["skeleton"] == 0)
        there &= (video >= 0) & (video < (len(videos) or 1)) & np.isin(kind, (USER, PREDICTED))
        require(there.all(), "has tracks, types, skeletons or videos that are not there")
        first = instances["point_id_start"].astype(np.int64)
        count = instances["point_id_end"].astype(np.int64) - first
        fits = (count == len(names)).all() and first.min(initial=0) >= 0
        require(fits, "has another number of points than its skeleton")
        points = np.full((len(instances), len(names), 3), np.nan)  # x, y, score
        for number, name in enumerate(("points", "pred_points")):
            if (own := kind == number).any():
                cells = file.table(name)[first[own, None] + np.arange(len(names))]
                for place, axis in enumerate("xy"):
                    points[own, :, place] = np.where(cells["visible"], cells[axis] - shift, np.nan)
                if number == PREDICTED:
                    points[own, :, 2] = cells["score"]
    keys = list(zip(video.tolist(), frame.tolist(), track.tolist(), strict=True))
    user = kind == USER
    placed = {key for key, own in zip(keys, user.tolist(), strict=True) if own and key[2] >= 0}
    origins = instances["from_predicted"][user & (instances["from_predicted"] >= 0)]
    replaced = np.array([key in placed for key in keys], bool)
    replaced = ~user & (replaced | np.isin(instances["instance_id"], origins))
    lost = int(replaced.sum())
    individuals = (*make_unique([str(each[1]) for each in tracks], REPEATED)[0], "")  # -1: none
    video_names, _ = make_unique([_video(each) for each in videos], REPEATED)
    unscored = np.isnan(points[~replaced, :, 2]).all()
    return Poses(
        name=str(path),
        video=[video_names[n] for n in video] if len(videos) > 1 else video_name(path),
        points=points[..., :2],
        confidence=None if unscored else points[..., 2],
        frame=frame,
        label=[*map(str, frame.tolist())],
        individual=[individuals[number] for number in track.tolist()],
        landmark_names=names,
        frame_count=len(frames),
        unit="px",
        edges=edges,
        notes=(f"{lost} predicted instances replaced by those that a user placed",) * bool(lost),
    ).take(~replaced)


def _read_skeleton(file: TrackerFile) -> tuple[tuple[str, ...], Edges]:
    """Return the nodes of the one skeleton, and its edges.

    The type of a link, 1 for bones and 2 for symmetries, is stated in full the first time, later
    by its place among those.
    """
    file.last = "metadata"
    about = json.loads(file.text("json", "metadata") or "{}")
    require(len(about["skeletons"]) == 1, f"has {len(about['skeletons'])} skeletons, not 1")
    (skeleton,) = about["skeletons"]
    ids = [node["id"] for node in skeleton["nodes"]]
    types: list[int] = []
    edges = []
    for link in skeleton.get("links", ()):
        kind = link.get("type") or {}
        if "py/reduce" in kind:
            types.append(kind["py/reduce"][1]["py/tuple"][0])
        stated = len(types) if "py/reduce" in kind else kind.get("py/id", 1)
        if dict(enumerate(types, 1)).get(stated, stated) == 1:
            edges.append((ids.index(link["source"]), ids.index(link["target"])))
    names = tuple(str(about["nodes"][number]["name"]) for number in ids)
    require(names, "has no skeleton with nodes")
    return names, tuple(dict.fromkeys(edges))


def _video(video: Any) -> str:
    """Return what a video is called: the name of its file without suffix."""
    name = video.get("filename") or (video.get("backend") or {}).get("filename") or "video"
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
    with open_tracker(path) as file:
        points = file.numbers("poseest/points")[..., ::-1]
        require(points.ndim in (3, 4) and points.shape[-1] == 2, f"has the shape {points.shape}")
        frames, *many = points.shape[:-2]
        ids, absent = np.zeros((frames, 1)), np.zeros((frames, 1), bool)
        version = np.ravel(file.attribute("version", "poseest") or 2)[0]
        if many and version > 3:
            ids = file.numbers("poseest/instance_embed_id")
            absent = ids <= 0
        elif many:
            ids = file.numbers("poseest/instance_track_id")
            counts = file.numbers("poseest/instance_count")
            absent = np.arange(*many) >= counts[:, None]
        require(ids.shape == absent.shape == (frames, *(many or [1])), "is of other instances")
        confidence = np.ones(points.shape[:-1])
        if file.is_dataset("poseest/confidence"):
            confidence = file.numbers("poseest/confidence")
            require(confidence.shape == points.shape[:-1], f"has the shape {confidence.shape}")
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
    with open_tracker(path) as file:
        if (kind := file.text("ds_type")) != "poses":
            problem = f"holds {printable(kind) or 'data of no stated type'}, not poses"
            fix = "give a data set of poses; bounding boxes have no landmarks"
            raise input_error(path, problem, fix)
        points = _arranged(file, "position", AXES)
        scored = file.is_dataset("confidence")
        confidence = _arranged(file, "confidence", AXES[:3]) if scored else None
        labels = None
        if file.is_dataset("time"):
            labels = number_labels(file.numbers("time"))
            require(len(labels) == len(points), f"has {len(labels)} of {len(points)} frames")
        names: dict[str, tuple[str, ...]] = {}
        for axis, size in zip(AXES[1:], points.shape[1:], strict=True):
            numbered = tuple(f"{axis}_{number}" for number in range(size))
            dataset = next((name for name in (axis, f"{axis}s") if file.is_dataset(name)), "")
            names[axis] = file.texts(dataset) if dataset and file.stored(dataset).text else numbered
        space = names["space"]
        require(space in (("x", "y"), ("x", "y", "z")), f"names the coordinates {', '.join(space)}")
        require(len(space) == points.shape[3], "has another number of coordinates")
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
    values = file.numbers(name)
    with file.damage(name):  # h5py's own `dims` can abort the process on damaged files
        scales = file.stored(name).dataset.attrs["DIMENSION_LIST"]
        names = [as_text(h5py.h5r.get_name(own[0], file.root.id) or b"") for own in scales]
    axes = [axis.strip("/").removesuffix("s") for axis in names]
    retained = [axis for axis in wanted if axis in axes]
    needed = {"time", *wanted[3:]} <= {*axes}
    require(needed and sorted(retained) == sorted(axes), f"has the axes {', '.join(axes)}")
    values = values.transpose([axes.index(axis) for axis in retained])
    sizes = dict(zip(retained, values.shape, strict=True))
    return values.reshape([sizes.get(axis, 1) for axis in wanted])


# NWB.

UNITS = {"pixel": "px", "pixels": "px", "px": "px", "meters": "m", "metres": "m", "meter": "m"}


class Series(NamedTuple):
    """A PoseEstimationSeries: one landmark of an animal over time.

    points (n, 2 or 3) times the conversion that is stated; confidence (n,), NaN where there is
    none; times (n,) in seconds; rate in Hz, of a series that states it.
    """

    animal: str
    landmark: str
    points: Floats
    confidence: Floats
    times: Floats
    rate: float | None
    unit: str


def read_nwb(paths: tuple[Path, ...]) -> Poses:
    """Read every PoseEstimation below `processing`; a series may have times of its own.

    Raises InputError where there is none, and for animals of one name in several modules.
    """
    path = paths[0]
    with open_tracker(path) as file:
        groups = [*_groups(file, "processing", 5)]  # modules, animals and their series
        kinds = {name: file.text("neurodata_type", name) for name in groups}
        animals = [name for name in groups if kinds[name] == "PoseEstimation"]
        series = [
            _read_series(file, name)
            for name in groups
            if kinds[name] == "PoseEstimationSeries" and name.rpartition("/")[0] in animals
        ]
        if not series:
            problem = "holds no PoseEstimation (ndx-pose), so no landmarks"
            raise input_error(path, problem, "give a file of estimated poses")
        names, edges = _skeletons_of(file, groups, series)
        axes = {one.points.shape[1] for one in series}
        require(len(axes) == 1, "holds 2D and 3D series; save them in files of their own")
        people = [*dict.fromkeys(one.animal for one in series)]
        once = len({(one.animal, one.landmark) for one in series}) == len(series)
        require(once, "has animals of one name in several modules; save each in its own file")
    times = np.unique(np.concatenate([one.times for one in series]))
    points = np.full((len(times), len(people), len(names), *axes), np.nan)
    confidence = np.full(points.shape[:3], np.nan)
    present = np.zeros(points.shape[:2], bool)
    for one in series:
        at, who = np.searchsorted(times, one.times), people.index(one.animal)
        place = at, who, names.index(one.landmark)
        points[place], confidence[place], present[at, who] = one.points, one.confidence, True
    (unit, *others) = {UNITS.get(one.unit, UNKNOWN_UNIT) for one in series}
    return of_frames(
        path,
        points,
        None if np.isnan(confidence).all() else confidence,
        number_labels(times),
        individuals=people,
        present=present,
        landmark_names=tuple(names),
        frame_rate=_frame_rate(series, times),
        unit="px" if axes == {2} else UNKNOWN_UNIT if others else unit,
        edges=edges,
    )


def _groups(file: TrackerFile, group: str, levels: int) -> Iterator[str]:
    """Yield the groups below a group, so many levels deep."""
    with file.damage(group):
        nodes = file.root.get(group, {})
        names = [name for name in nodes if isinstance(nodes.get(name), h5py.Group)]
    for name in names if levels else ():
        yield f"{group}/{name}"
        yield from _groups(file, f"{group}/{name}", levels - 1)


def _read_series(file: TrackerFile, group: str) -> Series:
    animal, landmark = group.split("/")[-2:]
    data, scores, start = (f"{group}/{name}" for name in ("data", "confidence", "starting_time"))
    points = file.numbers(data)
    require(points.ndim == 2 and points.shape[1] in (2, 3), f"has the shape {points.shape}")
    count = len(points)
    points = points * (file.number("conversion", data) or 1.0) + file.number("offset", data)
    unit = (file.text("unit", data) or "pixels").lower()
    confidence = file.numbers(scores) if file.is_dataset(scores) else np.full(count, np.nan)
    rate = None
    if file.is_dataset(start):
        rate = max(file.number("rate", start), 0.0) or None
        times = file.numbers(start).reshape(()) + np.arange(count) / (rate or 1.0)
    else:
        times = file.numbers(f"{group}/timestamps")
    rising = np.isfinite(times).all() and (np.diff(times) > 0).all()
    require(rising, "does not increase; give each point a time of its own, in their order")
    fits = times.shape == confidence.shape == (count,)
    require(fits, f"is not of the {count} points of the series")
    return Series(animal, landmark, points, confidence, times, rate, unit)


def _skeletons_of(
    file: TrackerFile, groups: Sequence[str], series: Sequence[Series]
) -> tuple[list[str], Edges]:
    """Return all landmarks, in the order of skeletons, then of appearance; and their edges.

    The skeleton of an animal is the first that has all of its landmarks; its own comes first.
    """
    names: dict[str, None] = {}
    pairs: dict[tuple[str, str], None] = {}
    nodes = {group: file.texts(f"{group}/nodes") for group in groups}
    for animal in dict.fromkeys(one.animal for one in series):
        own = {one.landmark: None for one in series if one.animal == animal}
        near = sorted(nodes, key=lambda name: f"/{animal}/" not in f"{name}/")
        group = next((name for name in near if own.keys() <= {*nodes[name]}), None)
        if group is not None:
            lines = file.edges(f"{group}/edges", len(nodes[group]))
            pairs |= dict.fromkeys((nodes[group][a], nodes[group][b]) for a, b in lines)
            names |= dict.fromkeys(name for name in nodes[group] if name in own)
        names |= own
    order = [*names]
    edges = ((order.index(a), order.index(b)) for a, b in pairs if {a, b} <= names.keys())
    return order, tuple(edges)


def _frame_rate(series: Sequence[Series], times: Floats) -> float | None:
    """Return the frame rate that the series state, or that their times keep to 1%."""
    stated = {one.rate for one in series if len(one.times) > 1}
    if len(stated) == 1 and (rate := stated.pop()) is not None:
        return rate
    steps = np.diff(times)
    if stated or len(steps) < 2:
        return None
    middle = float(np.median(steps))
    return 1 / middle if (np.abs(steps - middle) <= 0.01 * middle).all() else None

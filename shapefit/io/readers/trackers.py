"""HDF5 of trackers of animals: SLEAP, JABS, movement, and NWB with ndx-pose."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path, PureWindowsPath
from typing import NamedTuple

import h5py
import numpy as np
from numpy.typing import NDArray
from typing_extensions import TypedDict

from shapefit.arrays import Flags, Floats, Integers
from shapefit.errors import abbreviate
from shapefit.geometry.normalisation import metres_in
from shapefit.io.formats import Head
from shapefit.io.hdf5_file import Hdf5File
from shapefit.io.layout import UNKNOWN_UNIT
from shapefit.io.readers.declared import check_json, parse_json
from shapefit.io.readers.poses import (
    Edges,
    FormatError,
    Poses,
    check_names,
    frames_of_times,
    number_labels,
    number_repeats,
    poses_from_frames,
    require,
    video_name,
)
from shapefit.timeline import find_rate


class TrackerFile(Hdf5File):
    """An open HDF5 file of another tool."""

    def names(self, group: str = "/") -> list[str]:
        """Return the names of the nodes in a group; [] where it is absent."""
        with self.damage_as_input_error(group.strip("/")):
            node = self.root.get(group)
            names = [*node] if isinstance(node, h5py.Group) else []
        plain = all(isinstance(name, str) for name in names)  # else bytes
        require(plain, f"a name in {group} is not UTF-8")
        return names

    def numbers(self, name: str) -> Floats:
        """Read a dataset as float64; FormatError where it holds no numbers."""
        values = np.asarray(self.read_rows(name))
        require(values.dtype.kind in "biuf", f"{name} holds no numbers")
        return values.astype(np.float64)

    def numbers_if_any(self, name: str) -> Floats | None:
        """Read a dataset as float64; None where it is absent."""
        return self.numbers(name) if self.has_dataset(name) else None

    def texts(self, name: str) -> tuple[str, ...]:
        """Read a dataset of texts; () where it is absent or empty.

        SLEAP writes an empty one as numbers. Raises FormatError for others.
        """
        values = np.ravel(
            np.asarray(self.read_rows(name), object) if self.has_dataset(name) else ()
        )
        require(
            all(isinstance(value, str) for value in values), f"{name} holds no text"
        )
        return tuple(values.tolist())

    def table(self, name: str, columns: Sequence[str]) -> NDArray[np.void]:
        """Read a structured dataset; FormatError unless `columns` are all numbers."""
        rows = np.asarray(self.read_rows(name))
        lacking = [one for one in columns if one not in (rows.dtype.names or ())]
        require(not lacking, f"{name} has no column {abbreviate(lacking)}")
        kinds = {rows.dtype[one].kind for one in columns}
        require(rows.ndim == 1 and kinds <= {*"biuf"}, f"{name} is no table of numbers")
        return rows

    def text(self, attribute: str, node: str = "/") -> str:
        """Return an attribute of a node as text; "" where it is absent."""
        value = self.attribute(attribute, node) or ""
        return (
            value.decode("utf-8", "backslashreplace")
            if isinstance(value, bytes)
            else str(value)
        )

    def number(self, attribute: str, node: str = "/") -> float:
        """Return an attribute of a node as a number >= 0; 0 where it is absent.

        Of several numbers the first. Raises FormatError for what is no number.
        """
        value: object = self.attribute(attribute, node) or 0
        if isinstance(value, list) and value:  # a version and that below it
            value = value[0]
        if not isinstance(value, int | float) or not math.isfinite(value):
            raise FormatError(f"{node.strip('/')}@{attribute} is no number")
        return max(float(value), 0.0)

    def edges(self, name: str, count: int) -> Edges:
        """Read edges from a dataset (e, 2), indices of `count` landmarks; () if absent.

        Raises FormatError for other indices.
        """
        given = self.numbers_if_any(name)
        if given is None or not given.size:
            return ()
        require(given.shape[-1:] == (2,), f"{name} holds no pairs of landmarks")
        pairs = given.reshape(-1, 2)
        exist = ((pairs >= 0) & (pairs < count)).all()
        require(exist, f"{name} points at no landmarks")
        return tuple((int(a), int(b)) for a, b in pairs)


# SLEAP: the analysis HDF5, an array of all tracks, and .slp, tables of frames and
# instances.

SLEAP_ORDER = ("track", "xy", "node", "frame")
FRAMES_FIRST = ("frame", "track", "node", "xy")


def is_sleap_analysis(head: Head) -> bool:
    """Whether a file is HDF5 with the datasets of SLEAP's analysis."""
    return {"tracks", "node_names"} <= head.hdf5


def read_sleap_analysis(paths: tuple[Path, ...]) -> Poses:
    """Read SLEAP's analysis file, whose array `tracks` has four axes.

    They are (track, xy, node, frame), as SLEAP writes it, or (frame, track, node, xy).

    Newer files name the axes in the attribute `dims`; in older ones the lengths decide:
    those of `node_names`, and of `track_occupancy` (frame, track).
    """
    with TrackerFile(paths[0]) as file:
        nodes = file.texts("node_names")
        names = file.texts("track_names")
        tracks = file.numbers("tracks")
        dims = file.attribute("dims", "tracks")
        scores = file.numbers_if_any("point_scores")
        occupancy = getattr(file.numbers_if_any("track_occupancy"), "shape", None)
        edges = file.edges("edge_inds", len(nodes))

    require(tracks.ndim == 4, f"tracks has {tracks.ndim} axes, not 4")
    if dims is None:
        sleap = tracks.shape[1:3] == (2, len(nodes)), tracks.shape[3::-3] == occupancy
        frames_first = (
            tracks.shape[2:] == (len(nodes), 2),
            tracks.shape[:2] == occupancy,
        )
        axes = [*(FRAMES_FIRST if frames_first > sleap else SLEAP_ORDER)]
    else:
        axes = (
            check_json(list[str], dims)
            if isinstance(dims, list)
            else parse_json(list[str], str(dims), "the attribute dims")
        )
    known = sorted(axes) == sorted(FRAMES_FIRST)
    require(known, f"tracks has the axes {abbreviate([*axes])}")
    # any order -> (frame, track, node, xy)
    points = tracks.transpose([axes.index(axis) for axis in FRAMES_FIRST])
    require(
        points.shape[2:] == (len(nodes), 2),
        f"tracks {tracks.shape} of {len(nodes)} nodes",
    )
    if scores is not None:
        axes.remove("xy")
        require(scores.ndim == 3, f"point_scores has {scores.ndim} axes, not 3")
        scores = scores.transpose([axes.index(axis) for axis in FRAMES_FIRST[:3]])
    many = points.shape[1]
    names = tuple(
        name or f"track_{number}" for number, name in enumerate(names or ("",) * many)
    )
    return poses_from_frames(
        paths[0],
        points,
        scores,
        present=np.asarray(np.isfinite(points).any(axis=(2, 3))) if many > 1 else None,
        landmark_names=nodes,
        individuals=number_repeats(names) or None,
        edges=edges,
    )


USER = 0
"""Type of an instance that a person has labelled."""

PREDICTED = 1
"""Type of an instance that a model has found."""

FRAME_COLUMNS = ("video", "frame_idx", "instance_id_start", "instance_id_end")
INSTANCE_COLUMNS = (
    "instance_id",
    "instance_type",
    "skeleton",
    "track",
    "from_predicted",
    "point_id_start",
    "point_id_end",
)
POINT_COLUMNS = ("x", "y", "visible")


class _Backend(TypedDict, total=False):
    filename: str | list[str] | None


class _Video(TypedDict, total=False):
    filename: str | list[str] | None
    backend: _Backend | None


class _NodeNumber(TypedDict):
    id: int


class _Graph(TypedDict, total=False):
    nodes: list[_NodeNumber]
    links: list[dict[str, object]]


class _Skeleton(_Graph, total=False):
    nx_graph: _Graph  # in skeletons of a preset


class _Node(TypedDict):
    name: str


class _Metadata(TypedDict):
    skeletons: list[_Skeleton]
    nodes: list[_Node]


class SlpFile(NamedTuple):
    """The content of a .slp file; `tables` are the points that a user placed, and the
    predicted points.
    """

    track_names: tuple[str, ...]
    video_names: tuple[str, ...]
    skeletons: list[SlpSkeleton]
    frames: NDArray[np.void]
    instances: NDArray[np.void]
    tables: tuple[NDArray[np.void], NDArray[np.void]]
    shift: float


class SlpSkeleton(NamedTuple):
    """The nodes of a skeleton, and its edges as pairs of their names."""

    nodes: tuple[str, ...]
    edges: tuple[tuple[str, str], ...]


def is_slp(head: Head) -> bool:
    """Whether a file is HDF5 with the tables of SLEAP's .slp."""
    return {"metadata@format_id", "frames", "instances"} <= head.hdf5


def read_slp(paths: tuple[Path, ...]) -> Poses:
    """Read a .slp file: tables of labelled frames, their instances and points.

    Several skeletons are read as one of all their nodes, of which an instance has its
    own. An instance that a user placed replaces the predicted one from which it was
    made, or which has its track in the frame. Before version 1.1 the middle of the
    first pixel was at 0.5.
    """
    file = _read_slp_tables(paths[0])
    order = np.lexsort((file.frames["frame_idx"], file.frames["video"]))
    frames = file.frames[order]
    instances, of_frame = _instances_by_frame(frames, file.instances)
    video = frames["video"][of_frame].astype(np.int64)
    frame = frames["frame_idx"][of_frame].astype(np.int64)
    track = instances["track"].astype(np.int64)
    exist = (track >= -1) & (track < len(file.track_names))
    exist &= (video >= 0) & (video < (len(file.video_names) or 1))
    require(exist.all(), "instances of tracks or videos that it does not hold")
    names, edges = _join_skeletons(file.skeletons)
    points = _place_points(file, instances, names)
    replaced = _are_replaced(instances, video, frame)
    lost = int(replaced.sum())
    note = f"{lost} predicted instances replaced by those that a user placed"
    scores = points[..., 2]
    individuals = (*number_repeats(file.track_names), "")  # the last is of track -1
    several = len(file.video_names) > 1
    return Poses(
        name=str(paths[0]),
        video=(
            [file.video_names[number] for number in video]
            if several
            else video_name(paths[0])
        ),
        points=points[..., :2],
        confidence=None if np.isnan(scores[~replaced]).all() else scores,
        frame=frame,
        label=[*map(str, frame.tolist())],
        individual=[individuals[number] for number in track.tolist()],
        landmark_names=names,
        unit="px",
        edges=edges,
        notes=(note,) if lost else (),
    ).take(~replaced)


def _read_slp_tables(path: Path) -> SlpFile:
    """Read tracks, videos, skeletons and tables of a .slp file, and check them."""
    with TrackerFile(path) as file:
        tracks = [
            parse_json(list[object], text, "tracks_json")
            for text in file.texts("tracks_json")
        ]
        require(all(len(track) > 1 for track in tracks), "a track without a name")
        videos = [
            parse_json(_Video, text, "videos_json")
            for text in file.texts("videos_json")
        ]
        metadata = parse_json(_Metadata, file.text("json", "metadata"), "metadata@json")
        format_id = file.number("format_id", "metadata")
        return SlpFile(
            track_names=tuple(str(track[1]) for track in tracks),
            video_names=number_repeats([_video_stem(video) for video in videos]),
            skeletons=[
                _read_slp_skeleton(one, metadata["nodes"])
                for one in metadata["skeletons"]
            ],
            frames=file.table("frames", FRAME_COLUMNS),
            instances=file.table("instances", INSTANCE_COLUMNS),
            tables=(
                file.table("points", POINT_COLUMNS),
                file.table("pred_points", (*POINT_COLUMNS, "score")),
            ),
            shift=0.0 if format_id >= 1.1 else 0.5,
        )


def _video_stem(video: _Video) -> str:
    """Return the name of a video, or of its first image, without folder and suffix."""
    backend = video.get("backend") or {}
    name = video.get("filename") or backend.get("filename") or "video"
    return PureWindowsPath(name if isinstance(name, str) else name[0]).stem


def _read_slp_skeleton(about: _Skeleton, nodes: Sequence[_Node]) -> SlpSkeleton:
    """Parse the JSON of a skeleton in .slp into its nodes and edges.

    Edges are the links of type 1, or with the number of an earlier link's type 1.

    A skeleton that comes from a preset has its graph in `nx_graph`.
    """
    graph: _Graph = about.get("nx_graph") or about
    require("nodes" in graph, "a skeleton without nodes")
    ids = [node["id"] for node in graph["nodes"]]
    exist = all(0 <= number < len(nodes) for number in ids)
    require(exist, "a skeleton of nodes that it does not hold")
    names = tuple(nodes[number]["name"] for number in ids)
    check_names(names, "node")
    name_of = dict(zip(ids, names, strict=True))
    types: list[int] = []
    edges: dict[tuple[str, str], None] = {}
    for link in graph.get("links", ()):
        stated_kind = link.get("type")
        kind = stated_kind if isinstance(stated_kind, dict) else {}
        if "py/reduce" in kind:
            types.append(_parse_edge_type(kind["py/reduce"]))
        stated = len(types) if "py/reduce" in kind else kind.get("py/id", 1)
        place = stated if isinstance(stated, int) else 1
        is_body = dict(enumerate(types, 1)).get(place, place) == 1
        ends = [link.get(end) for end in ("source", "target")]
        joined = [
            name_of[end] for end in ends if isinstance(end, int) and end in name_of
        ]
        if is_body and len(joined) == 2:
            edges[joined[0], joined[1]] = None
    return SlpSkeleton(names, tuple(edges))


def _parse_edge_type(pickled: object) -> int:
    """Parse the type of an edge from jsonpickle's [.., {py/tuple: [type]}, ..].

    It is 0 for other values.
    """
    steps = pickled[1] if isinstance(pickled, list) and len(pickled) > 1 else None
    values = steps.get("py/tuple") if isinstance(steps, dict) else None
    first = values[0] if isinstance(values, list) and values else 0
    return first if isinstance(first, int) else 0


def _instances_by_frame(
    frames: NDArray[np.void], instances: NDArray[np.void]
) -> tuple[NDArray[np.void], Integers]:
    """Return the instances in order of frames (n,), and the index of each one's frame.

    Raises FormatError for instances that are not there, or are shared.
    """
    start = frames["instance_id_start"].astype(np.int64)
    end = frames["instance_id_end"].astype(np.int64)
    exist = (start >= 0) & (end >= start) & (end <= len(instances))
    require(exist.all(), "frames of instances that it does not hold")
    require((end - start).sum() <= len(instances), "frames that share instances")
    rows = [np.arange(*ends) for ends in zip(start.tolist(), end.tolist(), strict=True)]
    which = np.concatenate([np.empty(0, np.int64), *rows])
    return instances[which], np.repeat(np.arange(len(frames)), end - start)


def _join_skeletons(skeletons: Sequence[SlpSkeleton]) -> tuple[tuple[str, ...], Edges]:
    """Merge skeletons; return the names of all nodes, and edges as pairs of indices."""
    names = tuple(
        dict.fromkeys(node for skeleton in skeletons for node in skeleton.nodes)
    )
    pairs = dict.fromkeys(pair for skeleton in skeletons for pair in skeleton.edges)
    return names, tuple((names.index(a), names.index(b)) for a, b in pairs)


def _place_points(
    file: SlpFile, instances: NDArray[np.void], names: Sequence[str]
) -> Floats:
    """Return x, y and score (n, p, 3) of n instances for all `names`, NaN if absent."""
    kind = instances["instance_type"].astype(np.int64)
    skeleton = instances["skeleton"].astype(np.int64)
    require(np.isin(kind, (USER, PREDICTED)).all(), "instances of an unknown type")
    exist = (skeleton >= 0) & (skeleton < len(file.skeletons))
    require(exist.all(), "instances of skeletons that it does not hold")
    points = np.full((len(instances), len(names), 3), np.nan)
    for number, (nodes, _) in enumerate(file.skeletons):
        columns = np.array([names.index(node) for node in nodes], np.int64)
        for chosen in (USER, PREDICTED):
            mine = np.flatnonzero((kind == chosen) & (skeleton == number))
            cells = _point_rows(file.tables[chosen], instances[mine], len(nodes))
            hidden = ~cells["visible"].astype(bool)
            for place, axis in enumerate("xy"):
                values = np.where(hidden, np.nan, cells[axis] - file.shift)
                points[mine[:, None], columns, place] = values
            if chosen == PREDICTED:
                points[mine[:, None], columns, 2] = cells["score"]
    return points


def _point_rows(
    table: NDArray[np.void], instances: NDArray[np.void], count: int
) -> NDArray[np.void]:
    """Return the rows (n, count) of a table of points for n instances.

    Raises FormatError for instances of another number of points.
    """
    start = instances["point_id_start"].astype(np.int64)
    end = instances["point_id_end"].astype(np.int64)
    inside = (start >= 0) & (start + count <= len(table))
    inside &= end - start == count
    require(inside.all(), "instances of points that it does not hold")
    cells: NDArray[np.void] = table[start[:, None] + np.arange(count)]
    return cells


def _are_replaced(
    instances: NDArray[np.void], video: Integers, frame: Integers
) -> Flags:
    """Return a mask (n,) of predicted instances that a user's instance replaces.

    video and frame (n,) are those of instances. A user's instance has the same track in
    the frame, or was made from the predicted one.
    """
    user = instances["instance_type"] == USER
    track = instances["track"].astype(np.int64)
    keys = list(zip(video.tolist(), frame.tolist(), track.tolist(), strict=True))
    placed = {key for key, by_user in zip(keys, user.tolist(), strict=True) if by_user}
    same_track = np.array([key in placed and key[2] >= 0 for key in keys], bool)
    origins = instances["from_predicted"][user & (instances["from_predicted"] >= 0)]
    made_from = np.isin(instances["instance_id"], origins)
    replaced: Flags = np.asarray(~user & (same_track | made_from))
    return replaced


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


UNASSIGNED = 0
"""Of identities from version 4 on, what belongs to no mouse."""


def is_jabs(head: Head) -> bool:
    """Whether a file is HDF5 with the dataset of points of JABS."""
    return {"poseest/points"} <= head.hdf5


def read_jabs(paths: tuple[Path, ...]) -> Poses:
    """Read the mice of a file of JABS; a point is missing with confidence 0.

    Points are (frame, point, [y, x]), or (frame, mouse, point, [y, x]) from version 3
    on.

    The mice of a frame are in any order. Version 3 counts them and numbers their
    tracks, later ones give identities, 0 for none.
    """
    with TrackerFile(paths[0]) as file:
        # (.., [y, x]) -> (.., [x, y])
        points = file.numbers("poseest/points")[..., ::-1]
        confidence = file.numbers("poseest/confidence")
        version = file.number("version", "poseest")
        count = file.numbers_if_any("poseest/instance_count")
        track = file.numbers_if_any("poseest/instance_track_id")
        identity = file.numbers_if_any("poseest/instance_embed_id")
    several = points.ndim == 4
    fits = points.ndim in (3, 4) and points.shape[-2:] == (len(MOUSE), 2)
    require(fits, f"points of the shape {points.shape}, not of {len(MOUSE)} landmarks")
    same = confidence.shape == points.shape[:-1]
    require(same, "other confidences than landmarks")
    points = np.where(confidence[..., None] > 0, points, np.nan)
    if not several:
        return poses_from_frames(
            paths[0], points, confidence, landmark_names=MOUSE, edges=LINES
        )
    frames, mice = points.shape[:2]
    numbers = identity if version > 3 or track is None else track
    require(numbers is not None, "several mice without identities")
    assert numbers is not None
    require(numbers.shape == (frames, mice), "other identities than mice")
    seen: Flags = np.asarray(np.isfinite(points).all(axis=3))
    valid = np.isfinite(numbers) & seen.any(axis=2)
    if numbers is identity:
        valid &= numbers > UNASSIGNED
    elif count is not None:
        require(count.shape == (frames,), "other counts of mice than frames")
        valid &= np.arange(mice) < count[:, None]
    frame, _ = np.nonzero(valid)
    return Poses(
        name=str(paths[0]),
        video=video_name(paths[0]),
        points=points[valid],
        confidence=confidence[valid],
        frame=frame,
        label=[*map(str, frame.tolist())],
        individual=[f"{number:g}" for number in numbers[valid].tolist()],
        landmark_names=MOUSE,
        unit="px",
        edges=LINES,
    )


AXES = ("time", "individual", "keypoint", "space")


def is_movement(head: Head) -> bool:
    """Whether a file is HDF5 with the attribute `ds_type` of movement."""
    return {"@ds_type"} <= head.hdf5


def read_movement(paths: tuple[Path, ...]) -> Poses:
    """Read the poses in a netCDF file of movement, which is HDF5.

    `position` is over time, space, keypoints, individuals, in any order; newer versions
    say `keypoint` and `individual`. Raises FormatError for data of another kind.
    """
    with TrackerFile(paths[0]) as file:
        kind = file.text("ds_type")
        require(kind == "poses", f"{kind or 'data of no stated type'}, not poses")
        points = _read_in_axis_order(file, "position", AXES)
        times = file.numbers_if_any("time")
        scored = file.has_dataset("confidence")
        confidence = (
            _read_in_axis_order(file, "confidence", AXES[:3]) if scored else None
        )
        individuals, landmarks, space = (
            file.texts(axis if file.has_dataset(axis) else f"{axis}s")
            for axis in AXES[1:]
        )
        rate = file.number("fps")
        in_frames = file.text("time_unit") == "frames"
        unit = file.text("units", "position")
    require(
        space == tuple("xyz"[: points.shape[3]]), f"the coordinates {', '.join(space)}"
    )
    same = times is None or times.shape == points.shape[:1]
    require(same, "another number of times than of frames")
    poses = poses_from_frames(
        paths[0],
        points,
        confidence,
        None if times is None else number_labels(times),
        frames=None if times is None else frames_of_times(times, rate),
        times=None if in_frames else times,
        landmark_names=landmarks,
        individuals=individuals,
        frame_rate=rate or None,
    )
    if metres_in(unit) is None:  # movement states no unit; what we write does
        return poses
    return replace(poses, unit=unit)


def _read_in_axis_order(file: TrackerFile, name: str, wanted: Sequence[str]) -> Floats:
    """Read a dataset, its axes transposed to the `wanted` order of their names.

    Raises FormatError where it has other axes.
    """
    # h5py's own `dims` can abort the process on damaged files
    with file.damage_as_input_error(name):
        scales = file.root[name].attrs["DIMENSION_LIST"]
        paths = [h5py.h5r.get_name(scale[0], file.root.id) or b"" for scale in scales]
    texts = [path.decode("utf-8", "replace").strip("/") for path in paths]
    axes = [text.removesuffix("s") for text in texts]
    values = file.numbers(name)
    require(sorted(wanted) == sorted(axes), f"{name} has the axes {', '.join(axes)}")
    number = f"{name} has {values.ndim} axes, and names of {len(axes)}"
    require(values.ndim == len(axes), number)
    return values.transpose([axes.index(axis) for axis in wanted])


# NWB.

POSES_OF_NWB = ("PoseEstimationSeries", "PoseEstimation")
UNITS = {"m": "m", "meter": "m", "meters": "m", "metres": "m"}


class Series(NamedTuple):
    """One landmark of an animal over n times.

    points (n, 2 or 3), confidence (n,), times (n,) in s, rate in Hz or 0, and unit.
    """

    points: Floats
    confidence: Floats
    times: Floats
    rate: float
    unit: str


SeriesOfAnimals = dict[tuple[str, str], Series]
"""The series of each animal and landmark."""


def is_nwb(head: Head) -> bool:
    """Whether a file is HDF5 with the attribute `nwb_version`."""
    return {"@nwb_version"} <= head.hdf5


def read_nwb(paths: tuple[Path, ...]) -> Poses:
    """Read the animals of an NWB file: all PoseEstimations in `processing`.

    Raises FormatError where there is none, or one twice.
    """
    with TrackerFile(paths[0]) as file:
        # modules, animals and their series
        groups = [*_walk_groups(file, "processing", 5)]
        series = _read_all_series(file, groups)
        nodes, pairs = _read_nwb_skeleton(file, groups)
    names = _order_landmarks(series, nodes)
    animals = [*dict.fromkeys(animal for animal, _ in series)]
    axes = {one.points.shape[1] for one in series.values()}
    require(len(axes) == 1, "2D and 3D series; save them in files of their own")
    times = np.unique(np.concatenate([one.times for one in series.values()]))
    points, confidence, present = _place_series(series, times, animals, names)
    rate = _common_rate(series)
    frames = frames_of_times(times, rate)
    if rate is None and frames is not None:
        rate = find_rate(np.array(frames), times)
    return poses_from_frames(
        paths[0],
        points,
        None if np.isnan(confidence).all() else confidence,
        number_labels(times),
        frames=frames,
        times=times,
        individuals=animals,
        present=present,
        landmark_names=names,
        frame_rate=rate,
        unit="px" if axes == {2} else _common_unit(series),
        edges=tuple(
            (names.index(nodes[a]), names.index(nodes[b]))
            for a, b in pairs
            if nodes[a] in names and nodes[b] in names
        ),
    )


def _walk_groups(file: TrackerFile, group: str, levels: int) -> Iterator[str]:
    """Yield the paths of the groups inside a group, down to `levels` levels."""
    for name in file.names(group) if levels else ():
        inner = f"{group}/{name}"
        with file.damage_as_input_error(inner):
            is_group = isinstance(file.root.get(inner), h5py.Group)
        if is_group:
            yield inner
            yield from _walk_groups(file, inner, levels - 1)


def _read_all_series(file: TrackerFile, groups: Sequence[str]) -> SeriesOfAnimals:
    """Read the series of all PoseEstimations among groups; FormatError for none."""
    kinds = {name: file.text("neurodata_type", name) for name in groups}
    series: SeriesOfAnimals = {}
    for name in groups:
        parent = name.rpartition("/")[0]
        if (kinds[name], kinds.get(parent)) != POSES_OF_NWB:
            continue
        *_, animal, landmark = name.split("/")
        require(
            (animal, landmark) not in series,
            "animals of one name in several modules; save each in its own file",
        )
        series[animal, landmark] = _read_series(file, name)
    require(series, "no PoseEstimation (ndx-pose), so no landmarks")
    return series


def _read_series(file: TrackerFile, group: str) -> Series:
    """Read the points, confidences and times of one landmark from its group.

    Raises FormatError where times do not increase, or numbers of values differ.
    """
    data = f"{group}/data"
    start = f"{group}/starting_time"
    rate = 0.0
    points = file.numbers(data) * (file.number("conversion", data) or 1.0)
    require(points.ndim == 2, f"{data} has {points.ndim} axes, not 2")
    offset = file.attribute("offset", data) or 0.0
    require(isinstance(offset, int | float), f"{data}@offset is no number")
    points += offset
    confidence = file.numbers_if_any(f"{group}/confidence")
    confidence = np.full(len(points), np.nan) if confidence is None else confidence
    if file.has_dataset(start):
        rate = file.number("rate", start)
        first = file.numbers(start)
        require(first.size == 1, f"{start} is not one number")
        times = first.ravel() + np.arange(len(points)) / (rate or 1.0)
    else:
        times = file.numbers(f"{group}/timestamps")
    require(times.ndim == 1, f"the times of {group} have {times.ndim} axes")
    rising = np.isfinite(times).all() and (np.diff(times) > 0).all()
    require(rising, f"the times of {group} do not increase")
    fits = times.shape == confidence.shape == points.shape[:-1]
    require(fits, f"{group} has other numbers of points, times and confidences")
    unit = UNITS.get(file.text("unit", data).lower(), UNKNOWN_UNIT)
    return Series(points, confidence, times, rate, unit)


def _read_nwb_skeleton(
    file: TrackerFile, groups: Sequence[str]
) -> tuple[tuple[str, ...], Edges]:
    """Read the nodes and edges of the first skeleton among groups; () if none."""
    skeleton = next((name for name in groups if file.texts(f"{name}/nodes")), "")
    nodes = file.texts(f"{skeleton}/nodes")
    return nodes, file.edges(f"{skeleton}/edges", len(nodes))


def _order_landmarks(series: SeriesOfAnimals, nodes: Sequence[str]) -> tuple[str, ...]:
    """Return the landmarks of all series: those in `nodes`, in that order, then others.

    nodes: the names of a skeleton.
    """
    landmarks = dict.fromkeys(landmark for _, landmark in series)
    in_skeleton = [node for node in nodes if node in landmarks]
    return tuple(dict.fromkeys([*in_skeleton, *landmarks]))


def _place_series(
    series: SeriesOfAnimals,
    times: Floats,
    animals: Sequence[str],
    names: Sequence[str],
) -> tuple[Floats, Floats, Flags]:
    """Place series in points (n, i, p, d), confidence (n, i, p) and presence (n, i).

    These are of `times` (n,), `animals` (i,) and landmark `names` (p,). Points and
    confidence are NaN where an animal lacks a landmark at a time; presence says whether
    it has any.
    """
    dimensions = next(iter(series.values())).points.shape[1]
    points = np.full((len(times), len(animals), len(names), dimensions), np.nan)
    confidence = np.full(points.shape[:3], np.nan)
    present = np.zeros(points.shape[:2], bool)
    for (animal, landmark), one in series.items():
        rows = np.searchsorted(times, one.times)
        number = animals.index(animal)
        place = names.index(landmark)
        points[rows, number, place] = one.points
        confidence[rows, number, place] = one.confidence
        present[rows, number] = True
    return points, confidence, present


def _common_rate(series: SeriesOfAnimals) -> float | None:
    """Return the rate in Hz of all series; None where they differ or state none.

    Series of one time do not count.
    """
    rates = {one.rate for one in series.values() if len(one.times) > 1}
    return (rates.pop() or None) if len(rates) == 1 else None


def _common_unit(series: SeriesOfAnimals) -> str:
    """Return the unit of all series; UNKNOWN_UNIT where they differ."""
    units = {one.unit for one in series.values()}
    return units.pop() if len(units) == 1 else UNKNOWN_UNIT

"""SLEAP: the analysis HDF5, an array of all tracks, and .slp, tables of frames and instances."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
import orjson
from numpy.typing import NDArray

from shapefit.arrays import Flags, Floats, Integers
from shapefit.errors import input_error, printable
from shapefit.io.foreign.recording import (
    ANYBODY,
    Edges,
    Recording,
    check_unique,
    name_of,
    numbered_repeats,
    video_name,
)
from shapefit.io.foreign.trackers import TrackerFile, text
from shapefit.io.hdf5_file import DAMAGED

# The analysis file.

SLEAP_ORDER = ("track", "xy", "node", "frame")
FRAMES_FIRST = ("frame", "track", "node", "xy")

Axes = tuple[str, ...]

REPEATED = "{} ({})"
"""What a name that is there already is called."""


def read_analysis(paths: tuple[Path, ...]) -> Recording:
    """Read an analysis file, whose array `tracks` has one of two orders of its axes.

    SLEAP writes (track, xy, node, frame), others (frame, track, node, xy). Newer files name the
    axes in the attribute `dims`; in older ones the lengths decide: of `node_names`, and of
    `track_occupancy`, which is (frame, track) in both. Of several tracks, those that are in a frame
    are its instances.
    """
    path = paths[0]
    with TrackerFile(path) as file:
        nodes = file.texts("node_names")
        check_unique(file.place("node_names"), nodes, "node")
        shape = file.shape("tracks", ", ".join(SLEAP_ORDER))
        axes = _stated_axes(file, "tracks", SLEAP_ORDER) or _fitting_axes(file, len(nodes))
        sizes = dict(zip(axes, shape, strict=True))
        if sizes["node"] != len(nodes) or sizes["xy"] != 2:
            raise file.fault("tracks", f"has the shape {shape} for {len(nodes)} nodes")
        confidence = None
        if file.is_dataset("point_scores"):
            wanted = tuple(axis for axis in axes if axis != "xy")
            own = _stated_axes(file, "point_scores", wanted) or wanted
            file.check_shape("point_scores", [sizes[axis] for axis in own])
            confidence = file.arranged("point_scores", own, FRAMES_FIRST[:3])
        edges = file.edges("edge_inds", len(nodes))
        individuals = _track_names(file, sizes["track"])
        points = file.arranged("tracks", axes, FRAMES_FIRST)
    several = sizes["track"] > 1
    return Recording.of_frames(
        path,
        points,
        confidence,
        there=np.asarray(np.isfinite(points).any(axis=(2, 3))) if several else None,
        landmark_names=nodes,
        individual_names=individuals,
        edges=edges,
    )


def _track_names(file: TrackerFile, count: int) -> tuple[str, ...]:
    """Return the names of the tracks; none for a single one that has no name."""
    names = file.texts("track_names") if file.has("track_names") else ()
    if not names:
        return () if count == 1 else tuple(f"track_{number}" for number in range(count))
    if len(names) != count:
        raise file.fault("track_names", f"names {len(names)} tracks, and there are {count}")
    return numbered_repeats([name or f"track_{n}" for n, name in enumerate(names)], REPEATED)[0]


def _stated_axes(file: TrackerFile, name: str, wanted: Axes) -> Axes | None:
    """Return the axes that the attribute `dims` of a dataset names; None without it."""
    stated = file.attribute("dims", name)
    if stated is None:
        return None
    try:
        axes = stated if isinstance(stated, list) else json.loads(text(stated))
        found = tuple(text(axis) for axis in axes)
    except (ValueError, TypeError):
        found = ()
    if sorted(found) != sorted(wanted):
        place = f"{file.place(name)}@dims"
        raise input_error(place, f"is {printable(stated)}", f"name the axes {', '.join(wanted)}")
    return found


def _fitting_axes(file: TrackerFile, nodes: int) -> Axes:
    """Return the order of axes that the lengths of the tracks fit; InputError for none."""
    shape = file.shape("tracks")
    orders = [dict(zip(order, shape, strict=True)) for order in (SLEAP_ORDER, FRAMES_FIRST)]
    fitting = [sizes for sizes in orders if (sizes["xy"], sizes["node"]) == (2, nodes)]
    if len(fitting) > 1 and file.is_dataset("track_occupancy"):
        occupied = file.shape("track_occupancy", "frame, track")
        agreeing = [sizes for sizes in fitting if (sizes["frame"], sizes["track"]) == occupied]
        fitting = agreeing or fitting
    if not fitting:
        found = f"has the shape {shape} for {nodes} nodes, which is in no order of axes"
        raise file.fault("tracks", found)
    return tuple(fitting[0])


# Labels and predictions, .slp.

USER, PREDICTED = 0, 1
TABLES = {USER: "points", PREDICTED: "pred_points"}
FRAME_COLUMNS = "video frame_idx instance_id_start instance_id_end"
INSTANCE_COLUMNS = (
    "instance_id instance_type skeleton track from_predicted point_id_start point_id_end"
)

REPLACED = "predicted instances replaced by those that a user placed"

PIXEL_MIDDLES = 1.1
"""The version from which on the middle of the first pixel is at 0."""

BODY = 1
"""The type of a link between nodes that is part of the body; others are symmetries."""


def read_labels(paths: tuple[Path, ...]) -> Recording:
    """Read a .slp file: tables of labelled frames, of their instances, and of their points.

    An instance that a user placed takes the place of the predicted one from which it was made, or
    which has its track in the same frame. Before version 1.1 of the format the middle of the first
    pixel was at 0.5.
    """
    path = paths[0]
    with TrackerFile(path) as file:
        metadata = _read_metadata(file)
        found, labelled = _read_instances(file)
        _check_instances(file, found, metadata)
        replaced = _replaced(found)
        found = {name: values[~replaced] for name, values in found.items()}
        points, confidence = _read_points(file, metadata, found)
    several = len(metadata.videos) > 1
    lost = int(replaced.sum())
    return Recording(
        name=str(path),
        video=video_name(path),
        points=points,
        confidence=None if np.isnan(confidence).all() else confidence,
        frames=found["frame_idx"],
        labels=list(map(str, found["frame_idx"].tolist())),
        individuals=found["track"],
        videos=[metadata.videos[row] for row in found["video"].tolist()] if several else None,
        landmark_names=metadata.landmarks,
        individual_names=metadata.tracks,
        frame_count=labelled,
        unit="px",
        edges=metadata.edges,
        notes=(f"{lost} {REPLACED}",) if lost else (),
    )


@dataclass(frozen=True)
class Metadata:
    """What a file says of its instances.

    skeletons: the places of the nodes of each among the landmarks, which are those of all; edges
    by place in `landmarks`; names of tracks and videos; shift of coordinates in pixels.
    """

    landmarks: tuple[str, ...]
    skeletons: list[NDArray[np.intp]]
    edges: Edges
    tracks: tuple[str, ...]
    videos: tuple[str, ...]
    shift: float


def _read_metadata(file: TrackerFile) -> Metadata:
    """Read the metadata of a file. Raises InputError where they are damaged."""
    version = file.attribute("format_id", "metadata")
    place = f"{file.place('metadata')}@json"
    try:
        found = orjson.loads(file.attribute("json", "metadata"))
    except (orjson.JSONDecodeError, TypeError) as error:
        raise input_error(place, "is no JSON", DAMAGED) from error
    listed = {name: file.texts(name) if file.is_dataset(name) else () for name in LISTS}
    try:
        nodes = [str(node["name"]) for node in found["nodes"]]
        skeletons, pairs = _skeletons(found["skeletons"], nodes)
        tracks = [str(orjson.loads(each)[1]) for each in listed["tracks_json"]]
        videos = [_video(orjson.loads(each)) for each in listed["videos_json"]]
    except (KeyError, IndexError, TypeError, ValueError, AttributeError) as error:
        what = f"is not as SLEAP writes it ({type(error).__name__}: {printable(error)})"
        raise input_error(place, what, DAMAGED) from error
    if not any(skeletons):
        raise input_error(place, "has no skeleton with nodes", DAMAGED)
    for skeleton in skeletons:
        check_unique(place, skeleton, "node of a skeleton")
    number = {name: i for i, name in enumerate(dict.fromkeys(n for s in skeletons for n in s))}
    return Metadata(
        tuple(number),
        [np.array([number[name] for name in skeleton], np.intp) for skeleton in skeletons],
        tuple(dict.fromkeys((number[a], number[b]) for a, b in pairs if {a, b} <= number.keys())),
        numbered_repeats(tracks, REPEATED)[0],
        numbered_repeats(videos, REPEATED)[0],
        0.0 if isinstance(version, int | float) and version >= PIXEL_MIDDLES else 0.5,
    )


LISTS = ("tracks_json", "videos_json")


def _skeletons(
    found: Sequence[Any], nodes: Sequence[str]
) -> tuple[list[tuple[str, ...]], list[tuple[str, str]]]:
    """Return the nodes of each skeleton in its order, and the edges of all, by name.

    The type of a link is stated in full the first time, later by its place among those.
    """
    skeletons, edges = [], []
    for skeleton in found:
        graph = skeleton.get("nx_graph", skeleton)
        ids = [node["id"] for node in graph["nodes"]]
        if any(isinstance(number, int) and number < 0 for number in ids):
            raise ValueError("a node has a negative number")
        skeletons.append(tuple(nodes[number] for number in ids))
        types: list[int] = []
        for link in graph.get("links", ()):
            kind = link.get("type") if isinstance(link.get("type"), dict) else {}
            number = kind.get("py/id", BODY)
            if "py/reduce" in kind:
                types.append(kind["py/reduce"][1]["py/tuple"][0])
                number = types[-1]
            elif 0 < number <= len(types):
                number = types[number - 1]
            if number == BODY:
                edges.append((nodes[link["source"]], nodes[link["target"]]))
    return skeletons, edges


def _video(found: Any) -> str:
    """Return what a video is called: its name without suffix, or the folder of its images."""
    backend = found.get("backend") or {}
    name = found.get("filename") or backend.get("filename") or backend.get("filenames") or "video"
    if isinstance(name, list):
        name = str(PurePosixPath(str(name[0]).replace("\\", "/")).parent)
    return PurePosixPath(name_of(str(name))).stem or "video"


def _read_instances(file: TrackerFile) -> tuple[dict[str, Integers], int]:
    """Return columns of all instances, sorted by video and frame, and the number of frames."""
    frames = _columns(file, "frames", FRAME_COLUMNS)
    table = _columns(file, "instances", INSTANCE_COLUMNS)
    start, end = frames["instance_id_start"], frames["instance_id_end"]
    if ((start < 0) | (end < start) | (end > len(table["track"]))).any():
        raise file.fault("frames", "points at instances that are not there")
    order = np.lexsort((frames["frame_idx"], frames["video"]))
    counts = (end - start)[order]
    owner = np.repeat(order, counts)
    rows = np.arange(len(owner)) - np.repeat(np.cumsum(counts) - counts, counts) + start[owner]
    found = {name: values[rows] for name, values in table.items()}
    return found | {name: frames[name][owner] for name in ("frame_idx", "video")}, len(start)


def _columns(file: TrackerFile, name: str, wanted: str) -> dict[str, Integers]:
    """Return columns of a table as integers."""
    _check_fields(file, name, wanted.split())
    file.shape(name, "rows")
    table = file.rows(name)
    return {column: table[column].astype(np.int64) for column in wanted.split()}


def _check_fields(file: TrackerFile, name: str, wanted: Sequence[str]) -> None:
    known = file.fields(name)
    if lost := [column for column in wanted if column not in known]:
        raise file.fault(name, f"has no column {lost[0]}")


def _check_instances(file: TrackerFile, found: Mapping[str, Integers], metadata: Metadata) -> None:
    """Raise InputError for instances of tracks, skeletons, videos or points that are not there."""
    place = file.place("instances")
    for column, count, lowest in (
        ("instance_type", 2, 0),
        ("track", len(metadata.tracks), -1),
        ("skeleton", len(metadata.skeletons), 0),
        ("video", max(len(metadata.videos), 1), 0),
    ):
        wrong = (found[column] < lowest) | (found[column] >= count)
        if wrong.any():
            value = int(found[column][np.argmax(wrong)])
            raise input_error(place, f"has the {column} {value} of {count}", DAMAGED)
    sizes = np.array([len(skeleton) for skeleton in metadata.skeletons])[found["skeleton"]]
    start, end = found["point_id_start"], found["point_id_end"]
    if (end - start != sizes).any() or (start < 0).any():
        raise input_error(place, "has another number of points than its skeleton", DAMAGED)
    for kind, table in TABLES.items():
        own = found["instance_type"] == kind
        if own.any():
            score = ["score"] if kind == PREDICTED else []
            _check_fields(file, table, [*score, "visible", "x", "y"])
            if end[own].max() > file.shape(table, "points")[0]:
                raise file.fault(table, "ends before the points of instances")


def _replaced(found: Mapping[str, Integers]) -> Flags:
    """Whether each instance is a predicted one for which a user placed another."""
    user = found["instance_type"] == USER
    if not user.any():
        return user
    origins = found["from_predicted"][user & (found["from_predicted"] >= 0)]
    tracked = found["track"] != ANYBODY
    keys = np.stack([found["video"], found["frame_idx"], found["track"]], axis=1)
    _, key = np.unique(keys, axis=0, return_inverse=True)
    key = key.ravel()
    same_track = tracked & np.isin(key, key[user & tracked])
    return ~user & (same_track | np.isin(found["instance_id"], origins))


def _read_points(
    file: TrackerFile, metadata: Metadata, found: Mapping[str, Integers]
) -> tuple[Floats, Floats]:
    """Return the points (N, p, 2) of the instances and their scores (N, p), NaN without one."""
    n, p = len(found["track"]), len(metadata.landmarks)
    points, confidence = np.full((n, p, 2), np.nan), np.full((n, p), np.nan)
    for kind, name in TABLES.items():
        of_kind = found["instance_type"] == kind
        table = file.rows(name) if of_kind.any() else None
        for number, places in enumerate(metadata.skeletons):
            own = of_kind & (found["skeleton"] == number)
            if table is None or not own.any() or not len(places):
                continue
            rows = table[found["point_id_start"][own][:, None] + np.arange(len(places))]
            xy = np.stack([rows["x"], rows["y"]], axis=-1).astype(np.float64) - metadata.shift
            seen = rows["visible"].astype(bool)
            points[np.ix_(own, places)] = np.where(seen[..., None], xy, np.nan)
            if kind == PREDICTED:
                confidence[np.ix_(own, places)] = rows["score"]
    return points, confidence

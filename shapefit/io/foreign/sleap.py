"""SLEAP: the analysis HDF5, an array of all tracks, and .slp, tables of frames and instances."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
import orjson
from numpy.typing import NDArray

from shapefit.arrays import Floats, Integers
from shapefit.errors import input_error, printable
from shapefit.io.foreign.recording import (
    ANYBODY,
    Recording,
    all_individuals,
    check_unique,
    name_of,
    numbered_repeats,
    take_instances,
    video_name,
)
from shapefit.io.foreign.trackers import TrackerFile, text
from shapefit.io.hdf5_file import DAMAGED

SLEAP_ORDER = ("track", "xy", "node", "frame")
FRAMES_FIRST = ("frame", "track", "node", "xy")

TRACKS, SCORES = "tracks", "point_scores"

Axes = tuple[str, ...]


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
        axes = _axes(file, len(nodes))
        sizes = dict(zip(axes, file.shape(TRACKS), strict=True))
        if sizes["node"] != len(nodes) or sizes["xy"] != 2:
            raise file.fault(TRACKS, f"has the shape {file.shape(TRACKS)} for {len(nodes)} nodes")
        scores = _score_axes(file, axes)
        edges = file.edges("edge_inds", len(nodes))
        individuals = _individuals(file, sizes["track"])
        points = file.arranged(TRACKS, axes, FRAMES_FIRST)
        confidence = None
        if scores is not None:
            confidence = file.arranged(SCORES, scores, FRAMES_FIRST[:3])
    fields = all_individuals(points, confidence, list(map(str, range(len(points)))))
    if sizes["track"] > 1:
        fields = take_instances(fields, np.isfinite(fields["points"]).any(axis=(1, 2)))
    return Recording(
        name=str(path),
        video=video_name(path),
        **fields,
        landmark_names=nodes,
        individual_names=individuals,
        frame_count=sizes["frame"],
        unit="px",
        edges=edges,
    )


def _individuals(file: TrackerFile, count: int) -> tuple[str, ...]:
    """Return the names of the tracks; none for a single one that has no name."""
    names = file.texts("track_names") if file.has("track_names") else ()
    if not names:
        return () if count == 1 else tuple(f"track_{number}" for number in range(count))
    if len(names) != count:
        raise file.fault("track_names", f"names {len(names)} tracks, and there are {count}")
    return numbered_repeats([name or f"track_{number}" for number, name in enumerate(names)])


def _axes(file: TrackerFile, nodes: int) -> Axes:
    """Return what the axes of the tracks are. Raises InputError where nothing says so."""
    shape = file.shape(TRACKS, "track, xy, node, frame")
    if stated := _stated(file, TRACKS, SLEAP_ORDER):
        return stated
    fitting = [
        order
        for order in (SLEAP_ORDER, FRAMES_FIRST)
        if shape[order.index("xy")] == 2 and shape[order.index("node")] == nodes
    ]
    if len(fitting) > 1 and file.is_dataset("track_occupancy"):
        occupied = file.shape("track_occupancy", "frame, track")
        agreeing = [
            order
            for order in fitting
            if (shape[order.index("frame")], shape[order.index("track")]) == occupied
        ]
        fitting = agreeing or fitting
    if not fitting:
        found = f"has the shape {shape} for {nodes} nodes, which is in no order of axes"
        raise file.fault(TRACKS, found)
    return fitting[0]


def _stated(file: TrackerFile, name: str, wanted: Axes) -> Axes | None:
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
        what = f"is {printable(stated)}"
        raise input_error(place, what, f"name the axes {', '.join(wanted)}")
    return found


def _score_axes(file: TrackerFile, axes: Axes) -> Axes | None:
    """Return the axes of the scores of points, which are those of the tracks without xy."""
    if not file.is_dataset(SCORES):
        return None
    wanted = tuple(axis for axis in axes if axis != "xy")
    found = _stated(file, SCORES, wanted) or wanted
    sizes = dict(zip(axes, file.shape(TRACKS), strict=True))
    file.check_shape(SCORES, [sizes[axis] for axis in found])
    return found


METADATA = "metadata"

BODY = 1
"""The type of a link between nodes that is part of the body; others are symmetries."""


@dataclass(frozen=True)
class Metadata:
    """What a file says of its instances.

    version of the format; skeletons, each the names of its nodes in order; edges between
    landmarks, by place in `landmarks`; names of tracks and videos.
    """

    version: float
    skeletons: tuple[tuple[str, ...], ...]
    edges: tuple[tuple[int, int], ...]
    tracks: tuple[str, ...]
    videos: tuple[str, ...]

    @property
    def landmarks(self) -> tuple[str, ...]:
        """Names of the nodes of all skeletons, in order of appearance."""
        return tuple(dict.fromkeys(name for skeleton in self.skeletons for name in skeleton))

    def columns(self) -> list[NDArray[np.intp]]:
        """Return the place of each node of each skeleton in `landmarks`."""
        place = {name: number for number, name in enumerate(self.landmarks)}
        return [
            np.array([place[name] for name in skeleton], np.intp) for skeleton in self.skeletons
        ]


def read_metadata(file: TrackerFile) -> Metadata:
    """Read the metadata of a file. Raises InputError where they are damaged."""
    version = file.attribute("format_id", METADATA)
    place = f"{file.place(METADATA)}@json"
    found = _parse(place, file.attribute("json", METADATA))
    try:
        nodes = [str(node["name"]) for node in found["nodes"]]
        skeletons, edges = _skeletons(found["skeletons"], nodes)
        tracks = [str(_parse("", text)[1]) for text in _texts(file, "tracks_json")]
        videos = [_video(_parse("", text)) for text in _texts(file, "videos_json")]
    except (KeyError, IndexError, TypeError, ValueError, AttributeError) as error:
        what = f"is not as SLEAP writes it ({type(error).__name__}: {printable(error)})"
        raise input_error(place, what, DAMAGED) from error
    if not any(skeletons):
        raise input_error(place, "has no skeleton with nodes", DAMAGED)
    for skeleton in skeletons:
        check_unique(place, skeleton, "node of a skeleton")
    number = {name: i for i, name in enumerate(dict.fromkeys(n for s in skeletons for n in s))}
    return Metadata(
        float(version) if isinstance(version, int | float) else 1.0,
        tuple(skeletons),
        tuple(dict.fromkeys((number[a], number[b]) for a, b in edges)),
        numbered_repeats(tracks),
        numbered_repeats(videos),
    )


def _texts(file: TrackerFile, name: str) -> tuple[str, ...]:
    return file.texts(name) if file.is_dataset(name) else ()


def _parse(place: str, text: Any) -> Any:
    try:
        return orjson.loads(text)
    except (orjson.JSONDecodeError, TypeError) as error:
        if not place:
            raise ValueError(str(error)) from error
        raise input_error(place, "is no JSON", DAMAGED) from error


def _skeletons(
    found: Sequence[Any], nodes: Sequence[str]
) -> tuple[list[tuple[str, ...]], list[tuple[str, str]]]:
    """Return the nodes of each skeleton in its order, and the edges of all, by name."""
    skeletons, edges = [], []
    for skeleton in found:
        graph = skeleton.get("nx_graph", skeleton)
        ids = [node["id"] for node in graph["nodes"]]
        if any(isinstance(number, int) and number < 0 for number in ids):
            raise ValueError("a node has a negative number")
        skeletons.append(tuple(nodes[number] for number in ids))
        types: list[int] = []
        for link in graph.get("links", ()):
            if _type(link.get("type"), types) == BODY:
                edges.append((nodes[link["source"]], nodes[link["target"]]))
    known = {name for skeleton in skeletons for name in skeleton}
    return skeletons, [pair for pair in edges if known.issuperset(pair)]


def _type(stated: Any, types: list[int]) -> int:
    """Return the type of a link: stated in full the first time, later by its place among those."""
    if not isinstance(stated, dict):
        return BODY
    if "py/reduce" in stated:
        types.append(stated["py/reduce"][1]["py/tuple"][0])
        return types[-1]
    number = stated.get("py/id", BODY)
    return types[number - 1] if 0 < number <= len(types) else number


def _video(found: Any) -> str:
    """Return what a video is called: its name without suffix, or the folder of its images."""
    backend = found.get("backend") or {}
    name = found.get("filename") or backend.get("filename") or backend.get("filenames") or "video"
    if isinstance(name, list):
        name = str(PurePosixPath(str(name[0]).replace("\\", "/")).parent)
    last = name_of(str(name))
    return PurePosixPath(last).stem or "video"


USER, PREDICTED = 0, 1

TABLES = {USER: "points", PREDICTED: "pred_points"}

REPLACED = "predicted instances replaced by those that a user placed"

PIXEL_MIDDLES = 1.1
"""The version from which on the middle of the first pixel is at 0."""


def read_labels(paths: tuple[Path, ...]) -> Recording:
    """Read a .slp file: tables of labelled frames, of their instances, and of their points.

    An instance that a user placed takes the place of the predicted one from which it was made, or
    which has its track in the same frame. Before version 1.1 of the format the middle of the first
    pixel was at 0.5.
    """
    path = paths[0]
    with TrackerFile(path) as file:
        metadata = read_metadata(file)
        found, labelled, replaced = _read_instances(file, metadata)
        points, confidence = _read_points(file, metadata, found)
    frames, videos = found["frames"], found["videos"].tolist()
    several = len(metadata.videos) > 1
    return Recording(
        name=str(path),
        video=video_name(path),
        points=points,
        confidence=None if np.isnan(confidence).all() else confidence,
        frames=frames,
        labels=list(map(str, frames.tolist())),
        individuals=found["track"],
        videos=[metadata.videos[video] for video in videos] if several else None,
        landmark_names=metadata.landmarks,
        individual_names=metadata.tracks,
        frame_count=labelled,
        unit="px",
        edges=metadata.edges,
        notes=(f"{replaced} {REPLACED}",) if replaced else (),
    )


def _read_instances(file: TrackerFile, metadata: Metadata) -> tuple[dict[str, Integers], int, int]:
    """Return columns of all instances that count, sorted by video and frame.

    Beside them stand the number of labelled frames, and that of predicted instances replaced.
    """
    frames = _columns(file, "frames", "video frame_idx instance_id_start instance_id_end")
    wanted = "instance_id instance_type skeleton track from_predicted point_id_start point_id_end"
    table = _columns(file, "instances", wanted)
    start, end = frames["instance_id_start"], frames["instance_id_end"]
    if ((start < 0) | (end < start) | (end > len(table["track"]))).any():
        raise file.fault("frames", "points at instances that are not there")
    order = np.lexsort((frames["frame_idx"], frames["video"]))
    rows, owner = _spread(start[order], end[order])
    found = {name: values[rows] for name, values in table.items()}
    found["frames"], found["videos"] = (
        frames[name][order][owner] for name in ("frame_idx", "video")
    )
    _check(file, found, metadata)
    kept = ~_replaced(found)
    whole = {name: values[kept] for name, values in found.items()}
    return whole, len(start), int((~kept).sum())


def _columns(file: TrackerFile, name: str, wanted: str) -> dict[str, Integers]:
    """Return columns of a table as integers."""
    known = file.fields(name)
    if lost := [column for column in wanted.split() if column not in known]:
        raise file.fault(name, f"has no column {lost[0]}")
    file.shape(name, "rows")
    table = file.rows(name)
    return {column: table[column].astype(np.int64) for column in wanted.split()}


def _spread(start: Integers, end: Integers) -> tuple[Integers, Integers]:
    """Return the rows of the ranges, one after the other, and the range of each."""
    counts = end - start
    owner = np.repeat(np.arange(len(start)), counts)
    rows = np.arange(len(owner)) - np.repeat(np.cumsum(counts) - counts, counts)
    return rows + start[owner], owner


def _check(file: TrackerFile, found: dict[str, Integers], metadata: Metadata) -> None:
    """Raise InputError for instances of tracks, skeletons, videos or points that are not there."""
    place = file.place("instances")
    for column, count, lowest in (
        ("instance_type", 2, 0),
        ("track", len(metadata.tracks), -1),
        ("skeleton", len(metadata.skeletons), 0),
        ("videos", max(len(metadata.videos), 1), 0),
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
        if not own.any():
            continue
        wanted = {"x", "y", "visible", *(("score",) if kind == PREDICTED else ())}
        if lost := sorted(wanted - set(file.fields(table))):
            raise file.fault(table, f"has no column {lost[0]}")
        if end[own].max() > file.shape(table, "points")[0]:
            raise file.fault(table, "ends before the points of instances")


def _replaced(found: dict[str, Integers]) -> NDArray[np.bool_]:
    """Whether each instance is a predicted one for which a user placed another."""
    user = found["instance_type"] == USER
    if not user.any():
        return user
    origins = found["from_predicted"][user & (found["from_predicted"] >= 0)]
    tracked = found["track"] != ANYBODY
    keys = np.stack([found["videos"], found["frames"], found["track"]], axis=1)
    _, key = np.unique(keys, axis=0, return_inverse=True)
    key = key.ravel()
    same_track = tracked & np.isin(key, key[user & tracked])
    return ~user & (same_track | np.isin(found["instance_id"], origins))


def _read_points(
    file: TrackerFile, metadata: Metadata, found: dict[str, Integers]
) -> tuple[Floats, Floats]:
    """Return the points (N, p, 2) of the instances and their scores (N, p), NaN without one."""
    shift = 0.0 if metadata.version >= PIXEL_MIDDLES else 0.5
    n, p = len(found["track"]), len(metadata.landmarks)
    points, confidence = np.full((n, p, 2), np.nan), np.full((n, p), np.nan)
    for kind, name in TABLES.items():
        if not (found["instance_type"] == kind).any():
            continue
        table = file.rows(name)
        for number, places in enumerate(metadata.columns()):
            own = (found["instance_type"] == kind) & (found["skeleton"] == number)
            if not own.any() or not len(places):
                continue
            rows = table[found["point_id_start"][own][:, None] + np.arange(len(places))]
            xy = np.stack([rows["x"], rows["y"]], axis=-1).astype(np.float64) - shift
            seen = rows["visible"].astype(bool)
            points[np.ix_(own, places)] = np.where(seen[..., None], xy, np.nan)
            if kind == PREDICTED:
                confidence[np.ix_(own, places)] = rows["score"]
    return points, confidence

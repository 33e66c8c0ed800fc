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
from shapefit.io.hdf5_file import DAMAGED
from shapefit.io.readers.poses import (
    Edges,
    Poses,
    check_names,
    file_name,
    make_unique,
    of_frames,
    parsing,
    require,
    video_name,
)
from shapefit.io.readers.trackers import TrackerFile, text

# The analysis file.

SLEAP_ORDER = ("track", "xy", "node", "frame")
FRAMES_FIRST = ("frame", "track", "node", "xy")

Axes = tuple[str, ...]

REPEATED = "{} ({})"
"""What a name that is there already is called."""


def read_analysis(paths: tuple[Path, ...]) -> Poses:
    """Read an analysis file, whose array `tracks` has one of two orders of its axes.

    SLEAP writes (track, xy, node, frame), others (frame, track, node, xy). Newer files name the
    axes in the attribute `dims`; in older ones the lengths decide: of `node_names`, and of
    `track_occupancy`, which is (frame, track) in both. Of several tracks, those that are in a frame
    are its instances.
    """
    path = paths[0]
    with TrackerFile(path) as file:
        nodes = file.texts("node_names")
        tracks = file.numbers("tracks", None, None, None, None)
        axes = _stated_axes(file, "tracks", SLEAP_ORDER) or _fitting_axes(file, len(nodes))
        points = tracks.transpose([axes.index(axis) for axis in FRAMES_FIRST])
        count = points.shape[1]
        fits = points.shape[2:] == (len(nodes), 2)
        require(fits, f"has the shape {tracks.shape} for {len(nodes)} nodes")
        confidence = None
        if file.is_dataset("point_scores"):
            wanted = tuple(axis for axis in axes if axis != "xy")
            own = _stated_axes(file, "point_scores", wanted) or wanted
            sizes = [tracks.shape[axes.index(axis)] for axis in own]
            scores = file.numbers("point_scores", *sizes)
            confidence = scores.transpose([own.index(axis) for axis in FRAMES_FIRST[:3]])
        edges = file.edges("edge_inds", len(nodes))
        names = file.texts("track_names") if file.has("track_names") else ()
        require(len(names) in (0, count), f"names {len(names)} tracks, and there are {count}")
    if not names and count > 1:
        names = ("",) * count
    names = tuple(name or f"track_{n}" for n, name in enumerate(names))
    return of_frames(
        path,
        points,
        confidence,
        present=np.asarray(np.isfinite(points).any(axis=(2, 3))) if count > 1 else None,
        landmark_names=nodes,
        individuals=make_unique(names, REPEATED)[0] or None,
        edges=edges,
    )


def _stated_axes(file: TrackerFile, name: str, wanted: Axes) -> Axes | None:
    """Return the axes that the attribute `dims` of a dataset names; None without it."""
    stated = file.attribute("dims", name)
    if stated is None:
        return None
    with parsing(f"{file.place(name)}@dims", f"name the axes {', '.join(wanted)}"):
        axes = stated if isinstance(stated, list) else json.loads(text(stated))
        found = tuple(map(text, axes))
        require(sorted(found) == sorted(wanted), f"is {stated}")
        return found


def _fitting_axes(file: TrackerFile, nodes: int) -> Axes:
    """Return the order of axes that the lengths of the tracks fit."""
    shape = file.shape("tracks")
    orders = [dict(zip(order, shape, strict=True)) for order in (SLEAP_ORDER, FRAMES_FIRST)]
    fitting = [sizes for sizes in orders if (sizes["xy"], sizes["node"]) == (2, nodes)]
    if len(fitting) > 1 and file.is_dataset("track_occupancy"):
        occupied = file.shape("track_occupancy")
        agreeing = [sizes for sizes in fitting if (sizes["frame"], sizes["track"]) == occupied]
        fitting = agreeing or fitting
    require(fitting, f"has the shape {shape} for {nodes} nodes, which is in no order of axes")
    return tuple(fitting[0])


# Labels and predictions, .slp.

USER, PREDICTED = 0, 1
TABLES = {USER: "points", PREDICTED: "pred_points"}
FRAME_COLUMNS = ("video", "frame_idx", "instance_id_start", "instance_id_end")
INSTANCE_COLUMNS = (
    *("instance_id", "instance_type", "skeleton", "track", "from_predicted"),
    *("point_id_start", "point_id_end"),
)

REPLACED = "predicted instances replaced by those that a user placed"

PIXEL_MIDDLES = 1.1
"""The version from which on the middle of the first pixel is at 0."""

NO_TRACK = -1

BODY = 1
"""The type of a link between nodes that is part of the body; others are symmetries."""


def read_labels(paths: tuple[Path, ...]) -> Poses:
    """Read a .slp file: tables of labelled frames, of their instances, and of their points.

    An instance that a user placed takes the place of the predicted one from which it was made, or
    which has its track in the same frame. Before version 1.1 of the format the middle of the first
    pixel was at 0.5.
    """
    path = paths[0]
    with TrackerFile(path) as file:
        metadata = _read_metadata(file)
        found, labelled = _read_instances(file, metadata)
        replaced = _replaced(found)
        found = {name: values[~replaced] for name, values in found.items()}
        points, confidence = _read_points(file, metadata, found)
    several, video = len(metadata.videos) > 1, video_name(path)
    tracks = (*metadata.tracks, "")  # the last is that of number -1
    lost = int(replaced.sum())
    return Poses(
        name=str(path),
        video=[metadata.videos[row] for row in found["video"].tolist()] if several else video,
        points=points,
        confidence=None if np.isnan(confidence).all() else confidence,
        frame=found["frame_idx"],
        label=list(map(str, found["frame_idx"].tolist())),
        individual=[tracks[number] for number in found["track"].tolist()],
        landmark_names=metadata.landmarks,
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
    """Read the metadata of a file."""
    version = file.attribute("format_id", "metadata")
    lists = [
        file.texts(name) if file.is_dataset(name) else () for name in ("tracks_json", "videos_json")
    ]
    with parsing(f"{file.place('metadata')}@json", DAMAGED):
        found = orjson.loads(file.attribute("json", "metadata"))
        nodes = [str(node["name"]) for node in found["nodes"]]
        skeletons, pairs = _skeletons(found["skeletons"], nodes)
        tracks = [str(orjson.loads(each)[1]) for each in lists[0]]
        videos = [_video(orjson.loads(each)) for each in lists[1]]
        require(any(skeletons), "has no skeleton with nodes")
        for skeleton in skeletons:
            check_names(skeleton, "node of a skeleton")
    number = {name: i for i, name in enumerate(dict.fromkeys(n for s in skeletons for n in s))}
    return Metadata(
        tuple(number),
        [np.array([number[name] for name in skeleton], np.intp) for skeleton in skeletons],
        tuple(dict.fromkeys((number[a], number[b]) for a, b in pairs if {a, b} <= number.keys())),
        make_unique(tracks, REPEATED)[0],
        make_unique(videos, REPEATED)[0],
        0.0 if isinstance(version, int | float) and version >= PIXEL_MIDDLES else 0.5,
    )


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
        require(all(number >= 0 for number in ids), "a node has a negative number")
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
    return PurePosixPath(file_name(str(name))).stem or "video"


def _read_instances(file: TrackerFile, metadata: Metadata) -> tuple[dict[str, Integers], int]:
    """Return columns of all instances, sorted by video and frame, and the number of frames.

    They are of tracks, skeletons and videos that are there, with the points of their skeletons.
    """
    tables = []
    for name, columns in (("frames", FRAME_COLUMNS), ("instances", INSTANCE_COLUMNS)):
        table = file.table(name, *columns)
        tables.append({column: table[column].astype(np.int64) for column in columns})
    frames, table = tables
    start, end = frames["instance_id_start"], frames["instance_id_end"]
    there = (start >= 0) & (end >= start) & (end <= len(table["track"]))
    require(there.all(), "has other instances than those that `frames` points at")
    order = np.lexsort((frames["frame_idx"], frames["video"]))
    counts = (end - start)[order]
    owner = np.repeat(order, counts)
    rows = np.arange(len(owner)) - np.repeat(np.cumsum(counts) - counts, counts) + start[owner]
    found = {name: values[rows] for name, values in table.items()}
    found |= {name: frames[name][owner] for name in ("frame_idx", "video")}
    for column, count, lowest in (
        ("instance_type", 2, 0),
        ("track", len(metadata.tracks), -1),
        ("skeleton", len(metadata.skeletons), 0),
        ("video", max(len(metadata.videos), 1), 0),
    ):
        own = found[column]
        wrong = own[(own < lowest) | (own >= count)]
        require(not len(wrong), f"has the {column} {wrong[:1].sum()} of {count}")
    sizes = np.array([len(skeleton) for skeleton in metadata.skeletons])[found["skeleton"]]
    start, end = found["point_id_start"], found["point_id_end"]
    fits = (end - start == sizes).all() and (start >= 0).all()
    require(fits, "has another number of points than its skeleton")
    return found, len(counts)


def _replaced(found: Mapping[str, Integers]) -> Flags:
    """Whether each instance is a predicted one for which a user placed another."""
    user = found["instance_type"] == USER
    if not user.any():
        return user
    origins = found["from_predicted"][user & (found["from_predicted"] >= 0)]
    tracked = found["track"] != NO_TRACK
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
        if not of_kind.any():
            continue
        scored = kind == PREDICTED
        table = file.table(name, *["score"] * scored, "visible", "x", "y")
        for number, places in enumerate(metadata.skeletons):
            own = of_kind & (found["skeleton"] == number)
            rows = table[found["point_id_start"][own][:, None] + np.arange(len(places))]
            xy = np.stack([rows["x"], rows["y"]], axis=-1).astype(np.float64) - metadata.shift
            seen = rows["visible"].astype(bool)
            points[np.ix_(own, places)] = np.where(seen[..., None], xy, np.nan)
            if scored:
                confidence[np.ix_(own, places)] = rows["score"]
    return points, confidence

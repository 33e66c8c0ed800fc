"""SLEAP: the analysis HDF5, an array of all tracks, and .slp, tables of frames and instances."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import orjson
from numpy.typing import NDArray

from shapefit.arrays import Flags, Floats, Integers
from shapefit.io.readers.poses import (
    Edges,
    Poses,
    check_names,
    file_name,
    make_unique,
    of_frames,
    require,
    video_name,
)
from shapefit.io.readers.trackers import TrackerFile, text

# The analysis file.

SLEAP_ORDER = ("track", "xy", "node", "frame")
FRAMES_FIRST = ("frame", "track", "node", "xy")

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
        occupied = file.shape("track_occupancy") if file.is_dataset("track_occupancy") else ()
        tracks = file.numbers("tracks", None, None, None, None)

        def agreement(order: tuple[str, ...]) -> tuple[bool, bool]:
            size = dict(zip(order, tracks.shape, strict=True))
            named = (size["xy"], size["node"]) == (2, len(nodes))
            return named, (size["frame"], size["track"]) == occupied

        axes = _axes(file, "tracks", max(SLEAP_ORDER, FRAMES_FIRST, key=agreement))
        points = tracks.transpose([axes.index(axis) for axis in FRAMES_FIRST])
        fits = points.shape[2:] == (len(nodes), 2)
        require(fits, f"has the shape {tracks.shape} for {len(nodes)} nodes")
        confidence = None
        if file.is_dataset("point_scores"):
            own = _axes(file, "point_scores", tuple(axis for axis in axes if axis != "xy"))
            sizes = [tracks.shape[axes.index(axis)] for axis in own]
            confidence = file.numbers("point_scores", *sizes).transpose(
                [own.index(axis) for axis in FRAMES_FIRST[:3]]
            )
        edges = file.edges("edge_inds", len(nodes))
        names = file.texts("track_names") if file.is_dataset("track_names") else ()
    several = points.shape[1] > 1
    names = tuple(name or f"track_{n}" for n, name in enumerate(names or ("",) * points.shape[1]))
    return of_frames(
        path,
        points,
        confidence,
        present=np.asarray(np.isfinite(points).any(axis=(2, 3))) if several else None,
        landmark_names=nodes,
        individuals=make_unique(names, REPEATED)[0] or None,
        edges=edges,
    )


def _axes(file: TrackerFile, name: str, default: tuple[str, ...]) -> tuple[str, ...]:
    """Return the axes that the attribute `dims` of a dataset names, or else the default."""
    stated = file.attribute("dims", name)
    if stated is None:
        return default
    axes = tuple(map(text, stated if isinstance(stated, list) else json.loads(text(stated))))
    require(sorted(axes) == sorted(default), f"has `dims` {axes}, not {', '.join(default)}")
    return axes


# Labels and predictions, .slp.

USER, PREDICTED = 0, 1
FRAME_COLUMNS = ("video", "frame_idx", "instance_id_start", "instance_id_end")
INSTANCE_COLUMNS = (
    *("instance_id", "instance_type", "skeleton", "track", "from_predicted"),
    *("point_id_start", "point_id_end"),
)

PIXEL_MIDDLES = 1.1
"""The version from which on the middle of the first pixel is at 0."""

BODY = 1
"""The type of a link between nodes that is part of the body; others are symmetries."""

Skeletons = list[NDArray[np.intp]]


def read_labels(paths: tuple[Path, ...]) -> Poses:
    """Read a .slp file: tables of labelled frames, of their instances, and of their points.

    An instance that a user placed takes the place of the predicted one from which it was made, or
    which has its track in the same frame. Before version 1.1 of the format the middle of the first
    pixel was at 0.5.
    """
    path = paths[0]
    with TrackerFile(path) as file:
        tracks, videos = (
            [orjson.loads(each) for each in file.texts(name)] if file.is_dataset(name) else []
            for name in ("tracks_json", "videos_json")
        )
        names, skeletons, edges = _read_skeletons(file)
        sizes = np.array([len(places) for places in skeletons])
        counts = {"instance_type": 2, "skeleton": len(sizes), "video": max(len(videos), 1)}
        found, labelled = _read_instances(file, counts | {"track": len(tracks)})
        fits = found["point_id_end"] - found["point_id_start"] == sizes[found["skeleton"]]
        require(fits.all(), "has another number of points than its skeleton")
        replaced = _replaced(found)
        found = {column: values[~replaced] for column, values in found.items()}
        points, confidence = _read_points(file, len(names), skeletons, found)
    track_names, _ = make_unique([str(each[1]) for each in tracks], REPEATED)
    individuals = (*track_names, "")  # the last is that of number -1
    video_names, _ = make_unique([_video(each) for each in videos], REPEATED)
    numbers, lost = found["frame_idx"].tolist(), int(replaced.sum())
    several = len(videos) > 1
    return Poses(
        name=str(path),
        video=[video_names[n] for n in found["video"].tolist()] if several else video_name(path),
        points=points,
        confidence=None if np.isnan(confidence).all() else confidence,
        frame=found["frame_idx"],
        label=[*map(str, numbers)],
        individual=[individuals[number] for number in found["track"].tolist()],
        landmark_names=names,
        frame_count=labelled,
        unit="px",
        edges=edges,
        notes=(f"{lost} predicted instances replaced by those that a user placed",) * bool(lost),
    )


def _read_skeletons(file: TrackerFile) -> tuple[tuple[str, ...], Skeletons, Edges]:
    """Return the landmarks of all skeletons, the places of the nodes of each, and all edges.

    The type of a link is stated in full the first time, later by its place among those.
    """
    found = orjson.loads(file.attribute("json", "metadata") or "{}")
    nodes = [str(node["name"]) for node in found["nodes"]]
    skeletons, pairs = [], []
    for skeleton in found["skeletons"]:
        graph = skeleton.get("nx_graph", skeleton)
        skeletons.append([nodes[node["id"]] for node in graph["nodes"]])
        check_names(skeletons[-1], "node of a skeleton")
        types: list[int] = []
        for link in graph.get("links", ()):
            kind = link.get("type") or {}
            if "py/reduce" in kind:
                types.append(kind["py/reduce"][1]["py/tuple"][0])
                number = types[-1]
            else:
                number = kind.get("py/id", BODY)
                number = dict(enumerate(types, 1)).get(number, number)
            if number == BODY:
                pairs.append((nodes[link["source"]], nodes[link["target"]]))
    place = {n: i for i, n in enumerate(dict.fromkeys(n for own in skeletons for n in own))}
    require(place, "has no skeleton with nodes")
    edges = dict.fromkeys((place[a], place[b]) for a, b in pairs if {a, b} <= place.keys())
    places = [np.array([place[name] for name in own], np.intp) for own in skeletons]
    return tuple(place), places, tuple(edges)


def _video(found: Any) -> str:
    """Return what a video is called: its name without suffix, or the folder of its images."""
    backend = found.get("backend") or {}
    name = found.get("filename") or backend.get("filename") or backend.get("filenames") or "video"
    if isinstance(name, list):
        name = str(name[0]).replace("\\", "/").rpartition("/")[0]
    return Path(file_name(str(name))).stem or "video"


def _read_instances(
    file: TrackerFile, counts: Mapping[str, int]
) -> tuple[dict[str, Integers], int]:
    """Return columns of all instances, sorted by video and frame, and the number of frames.

    counts: how many there are of what a column numbers.
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
    found = {name: table[name][rows].astype(np.int64) for name in INSTANCE_COLUMNS}
    found |= {name: frames[name][owner].astype(np.int64) for name in ("frame_idx", "video")}
    for column, count in counts.items():
        lowest = -1 if column == "track" else 0
        wrong = found[column][(found[column] < lowest) | (found[column] >= count)]
        require(not wrong.size, f"has the {column} {wrong[:1].sum()} of {count}")
    return found, len(frames)


def _replaced(found: Mapping[str, Integers]) -> Flags:
    """Whether each instance is a predicted one for which a user placed another."""
    user: Flags = found["instance_type"] == USER
    columns = (found[name].tolist() for name in ("video", "frame_idx", "track"))
    keys = list(zip(*columns, strict=True))
    placed = {key for key, own in zip(keys, user.tolist(), strict=True) if own and key[2] >= 0}
    origins = found["from_predicted"][user & (found["from_predicted"] >= 0)]
    same_track = np.array([key in placed for key in keys], bool)
    return ~user & (same_track | np.isin(found["instance_id"], origins))


def _read_points(
    file: TrackerFile, landmarks: int, skeletons: Skeletons, found: Mapping[str, Integers]
) -> tuple[Floats, Floats]:
    """Return the points (N, p, 2) of the instances and their scores (N, p), NaN without one."""
    version = file.attribute("format_id", "metadata")
    shift = 0.0 if isinstance(version, int | float) and version >= PIXEL_MIDDLES else 0.5
    points = np.full((len(found["track"]), landmarks, 2), np.nan)
    confidence = np.full(points.shape[:2], np.nan)
    for kind, name in ((USER, "points"), (PREDICTED, "pred_points")):
        for number, places in enumerate(skeletons):
            own = (found["instance_type"] == kind) & (found["skeleton"] == number)
            if not own.any():
                continue
            table = file.table(name, "visible", "x", "y", *["score"] * kind)
            first = found["point_id_start"][own]
            require(first.min() >= 0, "has other points than those that `instances` points at")
            rows = table[first[:, None] + np.arange(len(places))]
            xy = np.stack([rows["x"], rows["y"]], axis=-1).astype(np.float64) - shift
            seen = rows["visible"].astype(bool)[..., None]
            points[np.ix_(own, places)] = np.where(seen, xy, np.nan)
            if kind == PREDICTED:
                confidence[np.ix_(own, places)] = rows["score"]
    return points, confidence

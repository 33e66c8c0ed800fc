"""SLEAP .slp: tables of labelled frames, of their instances, and of the points of those.

An instance that a user placed takes the place of the predicted one from which it was made, or
which has its track in the same frame. Before version 1.1 of the format the middle of the first
pixel was at 0.5.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
import orjson
from numpy.typing import NDArray

from shapefit.arrays import Integers
from shapefit.errors import input_error, printable
from shapefit.io.foreign.recording import ANYBODY, Instances, Recording, video_name
from shapefit.io.hdf5.file import DAMAGED
from shapefit.io.trackers.frame_names import apart, name_of
from shapefit.io.trackers.reading import (
    BLOCK_FRAMES,
    TrackerFile,
    check_unique,
    frame_ranges,
)

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
        apart(tracks),
        apart(videos),
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


@dataclass(frozen=True)
class _Index:
    """Instances in the order of their frames: kind, track, skeleton, and where points begin.

    frames are numbers in the video, videos places in the list of videos; replaced counts the
    predicted instances that are not among them.
    """

    kind: Integers
    track: Integers
    skeleton: Integers
    start: Integers
    frames: Integers
    videos: Integers
    replaced: int
    labelled: int

    def __len__(self) -> int:
        return len(self.kind)


def record(paths: tuple[Path, ...]) -> Recording:
    """Open a file; its points are read when its blocks are."""
    path = paths[0]
    with TrackerFile(path) as file:
        metadata = read_metadata(file)
        index = _read_index(file, metadata)
    names = metadata.landmarks
    return Recording(
        name=str(path),
        video=video_name(path),
        dimensions=2,
        landmark_names=names,
        blocks=lambda: _read(path, metadata, index),
        individuals=metadata.tracks,
        frames=index.labelled,
        unit="px",
        edges=metadata.edges,
    )


def _read_index(file: TrackerFile, metadata: Metadata) -> _Index:
    """Return all instances that count, sorted by video and frame."""
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
    return _Index(
        found["instance_type"][kept],
        found["track"][kept],
        found["skeleton"][kept],
        found["point_id_start"][kept],
        found["frames"][kept],
        found["videos"][kept],
        int((~kept).sum()),
        len(start),
    )


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


def _read(path: Path, metadata: Metadata, index: _Index) -> Iterator[Instances]:
    """Read the points, some thousand instances at a time."""
    columns = metadata.columns()
    shift = 0.0 if metadata.version >= PIXEL_MIDDLES else 0.5
    several = len(metadata.videos) > 1
    with TrackerFile(path) as file:
        ordered = {
            kind: bool((np.diff(index.start[index.kind == kind]) >= 0).all()) for kind in TABLES
        }
        whole = {
            kind: file.rows(table)
            for kind, table in TABLES.items()
            if not ordered[kind] and (index.kind == kind).any()
        }
        for rows in frame_ranges(len(index), BLOCK_FRAMES):
            n, p = len(index.kind[rows]), len(metadata.landmarks)
            points = np.full((n, p, 2), np.nan)
            confidence = np.full((n, p), np.nan)
            for kind in TABLES:
                for number, places in enumerate(columns):
                    own = (index.kind[rows] == kind) & (index.skeleton[rows] == number)
                    if not own.any() or not len(places):
                        continue
                    found = _points(file, kind, index.start[rows][own], len(places), whole)
                    seen = found["visible"].astype(bool)
                    xy = np.stack([found["x"], found["y"]], axis=-1).astype(np.float64) - shift
                    points[np.ix_(own, places)] = np.where(seen[..., None], xy, np.nan)
                    if kind == PREDICTED:
                        confidence[np.ix_(own, places)] = found["score"]
            videos = index.videos[rows].tolist()
            yield Instances(
                points=points,
                confidence=None if np.isnan(confidence).all() else confidence,
                frames=index.frames[rows],
                labels=list(map(str, index.frames[rows].tolist())),
                individuals=index.track[rows],
                videos=[metadata.videos[video] for video in videos] if several else None,
                counts={REPLACED: index.replaced} if rows.start == 0 and index.replaced else {},
            )


def _points(
    file: TrackerFile, kind: int, start: Integers, count: int, whole: dict[int, Any]
) -> Any:
    """Return the points (n, count) of instances, whose points begin at `start`."""
    rows = start[:, None] + np.arange(count)
    if kind in whole:
        return whole[kind][rows]
    first = int(rows.min())
    return file.rows(TABLES[kind], slice(first, int(rows.max()) + 1))[rows - first]

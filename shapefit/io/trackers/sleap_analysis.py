"""SLEAP analysis HDF5: an array of all tracks, in one of two orders of its axes.

SLEAP writes (track, xy, node, frame), others (frame, track, node, xy). Newer files name the axes in
the attribute `dims`; in older ones the lengths decide: of `node_names`, and of `track_occupancy`,
which is (frame, track) in both.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from shapefit.errors import input_error, printable
from shapefit.io.foreign.recording import Instances, Recording, video_name
from shapefit.io.trackers.frame_names import apart
from shapefit.io.trackers.reading import TrackerFile, check_unique, read_edges, text

SLEAP_ORDER = ("track", "xy", "node", "frame")
FRAMES_FIRST = ("frame", "track", "node", "xy")

TRACKS, SCORES = "tracks", "point_scores"

Axes = tuple[str, ...]


def record(paths: tuple[Path, ...]) -> Recording:
    """Open a file; its tracks are read when its blocks are."""
    path = paths[0]
    with TrackerFile(path) as file:
        nodes = file.texts("node_names")
        check_unique(file.place("node_names"), nodes, "node")
        axes = _axes(file, len(nodes))
        sizes = dict(zip(axes, file.shape(TRACKS), strict=True))
        if sizes["node"] != len(nodes) or sizes["xy"] != 2:
            raise file.fault(TRACKS, f"has the shape {file.shape(TRACKS)} for {len(nodes)} nodes")
        scores = _score_axes(file, axes)
        edges = read_edges(file, "edge_inds", len(nodes))
        individuals = _individuals(file, sizes["track"])
    return Recording(
        name=str(path),
        video=video_name(path),
        dimensions=2,
        landmark_names=nodes,
        blocks=lambda: _read(path, axes, scores),
        individuals=individuals,
        frames=sizes["frame"],
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
    return apart([name or f"track_{number}" for number, name in enumerate(names)])


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


def _read(path: Path, axes: Axes, scores: Axes | None) -> Iterator[Instances]:
    """Read the tracks, some thousand frames at a time; of several, those that are in a frame."""
    with TrackerFile(path) as file:
        for rows in file.ranges(TRACKS, axes.index("frame")):
            points = file.arranged(TRACKS, axes, FRAMES_FIRST, rows)
            confidence = None
            if scores is not None:
                confidence = file.arranged(SCORES, scores, FRAMES_FIRST, rows)[..., 0]
            labels = list(map(str, range(rows.start, rows.stop)))
            every = Instances.of_all(points, confidence, rows.start, labels)
            some = np.isfinite(every.points).any(axis=(1, 2))
            yield every if points.shape[1] == 1 else every.take(np.flatnonzero(some))

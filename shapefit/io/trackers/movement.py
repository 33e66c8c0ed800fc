"""movement's netCDF (which is HDF5): `position` over time, space, keypoints and individuals.

The axes are named by dimension scales, in any order. Newer versions say `keypoint` and
`individual`; one individual or keypoint that was picked out has no axis.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from shapefit.errors import input_error, printable
from shapefit.io.foreign.recording import Instances, Recording, video_name
from shapefit.io.trackers.frame_names import number_labels
from shapefit.io.trackers.reading import TrackerFile, check_unique, text

POSITION, CONFIDENCE = "position", "confidence"

SINGULAR = {"keypoints": "keypoint", "individuals": "individual"}

WANTED = ("time", "individual", "keypoint", "space")
"""The axes, in the order in which they are given out."""

Axes = tuple[str, ...]


def record(paths: tuple[Path, ...]) -> Recording:
    """Open a file; its positions are read when its blocks are."""
    path = paths[0]
    with TrackerFile(path) as file:
        kind = text(file.attribute("ds_type") or "")
        if kind != "poses":
            found = f"holds {printable(kind) or 'data of no stated type'}, not poses"
            fix = "give a data set of poses; bounding boxes have no landmarks"
            raise input_error(path, found, fix)
        axes = _axes(file, POSITION)
        sizes = dict(zip(axes, file.shape(POSITION), strict=True))
        for axis in ("time", "space"):
            if axis not in sizes:
                raise file.fault(POSITION, f"has no axis {axis}")
        names = _names(file, "keypoint", sizes.get("keypoint", 1))
        individuals = _names(file, "individual", sizes.get("individual", 1))
        space = _names(file, "space", sizes["space"])
        if space not in (("x", "y"), ("x", "y", "z")):
            found = f"names the coordinates {printable(', '.join(space))}"
            raise file.fault("space", found, "name them x, y and z")
        rate = file.attribute("fps")
        frames = sizes["time"]
    flat = len(space) == 2
    return Recording(
        name=str(path),
        video=video_name(path),
        dimensions=2 if flat else 3,
        landmark_names=names,
        blocks=lambda: _read(path, axes),
        individuals=individuals,
        frames=frames,
        frame_rate=float(rate) if isinstance(rate, int | float) and 0 < rate < np.inf else None,
        unit="px" if flat else "unknown",
    )


def _axes(file: TrackerFile, name: str) -> Axes:
    """Return the names of the axes of a dataset, as its dimension scales say."""
    found = [SINGULAR.get(axis, axis) for axis in file.scales(name)]
    if len(found) != len(file.shape(name)):
        raise file.fault(name, f"has the shape {file.shape(name)}, and names {len(found)} axes")
    if len(set(found)) != len(found) or not set(found) <= set(WANTED):
        what = f"has the axes {printable(', '.join(found))}"
        raise file.fault(name, what, f"name them {', '.join(WANTED)}")
    return tuple(found)


def _names(file: TrackerFile, axis: str, size: int) -> tuple[str, ...]:
    """Return the names along an axis; its numbers where it has none."""
    place = next((name for name in (axis, f"{axis}s") if file.is_dataset(name)), None)
    if place is None or not file.is_text(place):
        return tuple(f"{axis}_{number}" for number in range(size))
    names = file.texts(place)
    if len(names) != size:
        raise file.fault(place, f"names {len(names)}, and there are {size}")
    check_unique(file.place(place), names, axis)
    return names


def _read(path: Path, axes: Axes) -> Iterator[Instances]:
    """Read the positions, some thousand frames at a time."""
    with TrackerFile(path) as file:
        scores = _axes(file, CONFIDENCE) if file.is_dataset(CONFIDENCE) else None
        if scores is not None:
            sizes = dict(zip(axes, file.shape(POSITION), strict=True))
            if {*scores, "space"} != set(axes):
                found = f"has the axes {', '.join(scores)}, and position {', '.join(axes)}"
                raise file.fault(CONFIDENCE, found)
            file.check_shape(CONFIDENCE, [sizes[axis] for axis in scores])
        times = file.numbers("time") if file.is_dataset("time") else None
        if times is not None:
            file.check_shape("time", (file.shape(POSITION)[axes.index("time")],))
        for rows in file.ranges(POSITION, axes.index("time")):
            points = file.arranged(POSITION, axes, WANTED, rows)
            confidence = None
            if scores is not None:
                confidence = file.arranged(CONFIDENCE, scores, WANTED, rows)[..., 0]
            numbers = np.arange(rows.start, rows.stop) if times is None else times[rows]
            labels = number_labels(file.place("time"), numbers)
            yield Instances.of_all(points, confidence, rows.start, labels)

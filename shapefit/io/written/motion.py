"""The motion of one individual, frame by frame, as files in metres hold it."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats, Integers
from shapefit.errors import counted, input_error
from shapefit.geometry.joint_rotations import Rig
from shapefit.io.options import OutputOptions
from shapefit.io.records import Names
from shapefit.io.written.metres import in_metres
from shapefit.io.written.morphs import Morph, find_morph
from shapefit.io.written.tracks import Track
from shapefit.io.written.verdicts import Verdicts, find_verdicts

MOST_GAPS = 100
"""Frames without an item, for each with one; with more it is no sequence."""

NO_RATE = (
    "the frame rate is unknown, so times are numbers of frames; set `frame_rate` "
    "(`sequences.frame_rate` of `fit`)"
)


@dataclass(frozen=True, kw_only=True)
class Motion:
    """Every frame of a sequence from its first to its last.

    points (f, 3, p) in metres, nan where there is nothing; first, the number of the first frame;
    rate in Hz, 1 where it is not known; edges (e, 2) between landmarks; axes and size in words;
    warnings about the sequence; start (3,) as in `Placed`; verdicts where the records say which
    shapes are to be trusted; for files that hold more than points rig and morph.
    """

    name: str
    landmark_names: Names
    points: Floats
    first: int
    rate: float
    axes: str
    size: str
    warnings: tuple[str, ...]
    edges: Integers = field(default_factory=lambda: np.empty((0, 2), np.int64))
    start: Floats = field(default_factory=lambda: np.zeros(3))
    verdicts: Verdicts | None = None
    rig: Rig | None = None
    morph: Morph | None = None

    @property
    def frames(self) -> NDArray[np.int64]:
        """Return the number of each frame (f,)."""
        return self.first + np.arange(len(self.points), dtype=np.int64)


def find_motion(track: Track, options: OutputOptions, place: str) -> Motion:
    """Return a track in metres, with gaps for the frames that it lacks.

    Raises InputError as `in_metres` does, and for frames too far apart.
    """
    records, frames = track.records, track.frames
    placed = in_metres(records, options, place)
    n, first = len(frames), int(frames[0]) if len(frames) else 0
    length = int(frames[-1]) - first + 1 if n else 0
    if length > MOST_GAPS * n:
        found = f"there are {counted(n, 'item')} in {length:,} frames{_of(track.name)}"
        raise input_error(place, found, "write items that are so far apart to HDF5 or CSV")
    points = np.full((length, 3, len(records.landmark_names)), np.nan)
    points[frames - first] = placed.points
    failed = int((~np.isfinite(placed.points).any(axis=(1, 2))).sum())
    warnings = list(placed.warnings)
    if failed:
        warnings.append(f"{counted(failed, 'item')} without a shape{_of(track.name)}: gaps")
    if length > n:
        warnings.append(f"{counted(length - n, 'frame')} without an item{_of(track.name)}: gaps")
    if not records.frame_rate:
        warnings.append(NO_RATE)
    return Motion(
        name=track.name,
        landmark_names=records.landmark_names,
        points=points,
        first=first,
        rate=records.frame_rate or 1.0,
        edges=track.edges,
        axes=placed.axes,
        size=placed.size,
        warnings=tuple(warnings),
        start=placed.start,
        morph=find_morph(records, placed.points, frames - first, options.meshes),
        verdicts=find_verdicts(track, placed.factor, records.frame_rate or 1.0),
    )


def _of(name: str) -> str:
    return f" of {name}" if name else ""

"""Records parted into sequences, and each sequence as a motion in metres, gaps and verdicts."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats, Integers
from shapefit.errors import abbreviate, counted, input_error
from shapefit.geometry.joint_rotations import Rig
from shapefit.io.foreign.items import FRAME
from shapefit.io.layout import EDGES, METRES_PER_UNIT
from shapefit.io.options import OutputOptions
from shapefit.io.records import Names, ResultSet, ShapeSet, concatenate
from shapefit.io.skeletons import edges_of
from shapefit.io.written.metres import (
    CAMERA_TRANSLATION,
    EXTRINSIC_ROTATION,
    EXTRINSIC_TRANSLATION,
    Solid,
    in_metres,
)
from shapefit.lifting.verdict import DOUBT, PLAUSIBILITY

KEPT = (
    *(EDGES, METRES_PER_UNIT, CAMERA_TRANSLATION, EXTRINSIC_ROTATION, EXTRINSIC_TRANSLATION),
    *(FRAME, DOUBT, PLAUSIBILITY),
)


@dataclass(frozen=True)
class Track:
    """One sequence: name, "" where the records name none; frames (n,) rise."""

    name: str
    records: Solid
    frames: Integers

    @property
    def edges(self) -> Integers:
        """Return pairs of landmarks (e, 2): those stated, or else those of a known skeleton."""
        stated = self.records.lines
        known = edges_of(self.records.landmark_names) if stated is None else stated
        return np.asarray(known, np.int64).reshape(-1, 2)


def points_of(record: Solid) -> Solid:
    """Return a record with nothing but what files of motion are made of."""
    kept = {name: values for name, values in record.further.items() if name in KEPT}
    if isinstance(record, ShapeSet):
        return record.replaced(mesh_vertices=None, mesh_faces=None, further=kept)
    return ResultSet(
        shapes=record.shapes,
        translation=record.translation,
        scale=record.scale,
        landmark_names=record.landmark_names,
        items=record.items,
        sequences=record.sequences,
        shape_sd=record.shape_sd,
        columns=kept,
        of_file=record.of_file,
        unit=record.unit,
        y_axis=record.y_axis,
        frame_rate=record.frame_rate,
        attributes=record.attributes,
    )


def find_tracks(parts: list[Solid], place: str) -> list[Track]:
    """Join records and part them by sequence, each in the order of its frames.

    Frames are those of the dataset `frame`, or, without one, the order of the items. Raises
    InputError where two items of a sequence are of one frame, and for items of no sequence whose
    places in a video are known: nobody says that they are of one body.
    """
    records: Solid = concatenate(parts)  # type: ignore[type-var]
    names = np.array(records.sequences or ("",) * len(records), dtype=object)
    frames = _frames(records)
    tracks = []
    loose = [item for item, name in zip(records.items, names, strict=True) if not name]
    if frames is not None and len(loose) > 1:
        found = f"{abbreviate(loose)} belong to no sequence: they are no motion"
        fix = "read them with `track: nearest`, which joins detections over frames"
        raise input_error(place, found, fix)
    for name in dict.fromkeys(names.tolist()) or ("",):
        rows = np.flatnonzero(names == name)
        own = np.arange(len(rows)) if frames is None else frames[rows]
        order = np.argsort(own, kind="stable")
        own, rows = own[order], rows[order]
        _check_apart(own, [records.items[row] for row in rows], place)
        tracks.append(Track(name, records.take(rows), own))
    return tracks


def _frames(records: Solid) -> Integers | None:
    frames = records.columns.get(FRAME)
    if frames is None or frames.shape != (len(records),) or frames.dtype.kind not in "iu":
        return None
    return frames.astype(np.int64)


def _check_apart(frames: Integers, items: list[str], place: str) -> None:
    """Raise InputError where two items are of one frame."""
    same = np.flatnonzero(np.diff(frames) == 0)
    if len(same):
        first, second = items[same[0]], items[same[0] + 1]
        found = f"'{first}' and '{second}' are of one frame of one sequence"
        fix = "read detections with `track: nearest`, which joins them, or one `individual`"
        raise input_error(place, found, fix)


COLUMNS = ("item", "frame", "time", "trusted", "reason", "plausibility", "mean_error_bar_m")


@dataclass(frozen=True)
class Verdicts:
    """Of the n items of a motion: frames (n,), times in s, and why not to trust one, or "".

    plausibility (n,); bar (n,), mean over landmarks of sqrt(sd_x^2 + sd_y^2 + sd_z^2), in metres.
    """

    items: Names
    frames: Integers
    times: Floats
    doubts: Names
    plausibility: Floats
    bar: Floats


def find_verdicts(track: Track, factor: Floats, rate: float) -> Verdicts | None:
    """Return what the records say of each item, None where they say nothing.

    factor (n,): metres in a unit of each shape.
    """
    records = track.records
    doubts, sd = records.columns.get(DOUBT), getattr(records, "shape_sd", None)
    if doubts is None or sd is None:
        return None
    n = len(records)
    return Verdicts(
        items=records.items,
        frames=track.frames,
        times=track.frames / rate,
        doubts=tuple(map(str, doubts)),
        plausibility=np.asarray(records.columns.get(PLAUSIBILITY, np.full(n, np.nan)), np.float64),
        bar=factor * np.sqrt((sd**2).sum(axis=1)).mean(axis=1),
    )


def write_verdicts(verdicts: Sequence[Verdicts], path: Path) -> None:
    """Write a row per item; an empty cell is not known."""
    with path.open("w", encoding="utf-8", newline="") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(COLUMNS)
        for each in verdicts:
            numbers = zip(each.times, each.plausibility, each.bar, strict=True)
            for item, frame, doubt, (time, plausibility, bar) in zip(
                each.items, each.frames.tolist(), each.doubts, numbers, strict=True
            ):
                trusted = "false" if doubt else "true"
                cells = [_cell(plausibility), _cell(bar)]
                table.writerow([item, frame, f"{time:.10g}", trusted, doubt, *cells])


def _cell(value: float) -> str:
    return f"{value:.4g}" if np.isfinite(value) else ""


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
    shapes are to be trusted; rig for files that hold turning bones.
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
        verdicts=find_verdicts(track, placed.factor, records.frame_rate or 1.0),
    )


def _of(name: str) -> str:
    return f" of {name}" if name else ""

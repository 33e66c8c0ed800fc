"""Records parted into sequences, each a motion in metres with gaps and verdicts; their writer."""

from __future__ import annotations

import csv
import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path, PurePosixPath

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats, Integers
from shapefit.errors import abbreviate, counted, input_error
from shapefit.geometry.joint_rotations import Rig
from shapefit.io.atomic import atomic_path, check_output, file_stem, staged_files, write_and_sync
from shapefit.io.foreign.items import FRAME
from shapefit.io.formats import RecordWriter
from shapefit.io.layout import EDGES, METRES_PER_UNIT, Layout
from shapefit.io.options import AS_KNOWN, OutputOptions, Summary
from shapefit.io.records import Names, ResultSet, ShapeSet, concatenate
from shapefit.io.skeletons import edges_of
from shapefit.io.written.angles import ANGLE_SD, ANGLES, angle_columns, angle_names
from shapefit.io.written.metres import (
    CAMERA_TRANSLATION,
    EXTRINSIC_ROTATION,
    EXTRINSIC_TRANSLATION,
    Solid,
    in_metres,
)
from shapefit.lifting.verdict import DOUBT, PLAUSIBILITY
from shapefit.stores import UrlPath

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


def points_of(record: Solid, options: OutputOptions = AS_KNOWN) -> Solid:
    """Return a record with nothing but what files of motion are made of."""
    kept = {name: values for name, values in record.further.items() if name in KEPT}
    kept |= angle_columns(record, options.up)
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
    shapes are to be trusted; rig for files that hold turning bones. deviations (f, p) of points in
    metres, angles and their deviations (f, a) in degrees; nan where they are not known.
    """

    name: str
    landmark_names: Names
    points: Floats
    first: int
    rate: float
    axes: str
    size: str
    warnings: tuple[str, ...]
    deviations: Floats
    angles: Floats
    angle_deviations: Floats
    edges: Integers = field(default_factory=lambda: np.empty((0, 2), np.int64))
    start: Floats = field(default_factory=lambda: np.zeros(3))
    verdicts: Verdicts | None = None
    rig: Rig | None = None

    @property
    def frames(self) -> NDArray[np.int64]:
        """Return the number of each frame (f,)."""
        return self.first + np.arange(len(self.points), dtype=np.int64)

    @property
    def angle_names(self) -> Names:
        """Return the names of the joint angles (a,)."""
        return angle_names(self.landmark_names)

    @property
    def trusted(self) -> list[str]:
        """Return for each frame whether its shape is to be trusted, "" where that is not known."""
        said = self.verdicts
        known = {} if said is None else dict(zip(said.frames.tolist(), said.doubts, strict=True))
        return [
            ("false" if known[frame] else "true") if frame in known else ""
            for frame in self.frames.tolist()
        ]


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

    def by_frame(values: Floats) -> Floats:
        """Return values of the items (n, ...) for each frame (f, ...), nan in gaps."""
        spread = np.full((length, *values.shape[1:]), np.nan)
        spread[frames - first] = values
        return spread

    sd = getattr(records, "shape_sd", None)
    sd = np.full_like(records.shapes, np.nan) if sd is None else sd
    none = np.empty((n, 0))
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
        points=by_frame(placed.points),
        deviations=by_frame(placed.factor[:, None] * np.sqrt((sd**2).sum(axis=1))),
        angles=by_frame(records.further.get(ANGLES, none)),
        angle_deviations=by_frame(records.further.get(ANGLE_SD, none)),
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


Write = Callable[[Path, Sequence[Motion]], None]
"""Fills a new file with motions that belong in one."""

Prepare = Callable[[Sequence[Motion], str], tuple[list[Motion], str]]
"""Makes of motions what a format holds, with a note; raises InputError at a place if it cannot."""

Group = Callable[[Sequence[Motion]], dict[str, list[Motion]]]
"""Parts motions by file: what its name ends with -> those that it holds."""

Output = Callable[[Path, Layout, OutputOptions], AbstractContextManager["MotionWriter"]]


class MotionWriter(RecordWriter[Solid]):
    """Takes shapes or results; keeps their points, as the scale of a sequence takes all of it."""

    def __init__(self, options: OutputOptions) -> None:
        super().__init__()
        self._parts: list[Solid] = []
        self._options = options

    def append(self, record: Solid) -> None:
        """Take the items of a record after those that are there."""
        self.begun = True
        self._parts.append(points_of(record, self._options))

    def motions(self, place: str) -> list[Motion]:
        """Return all sequences in metres. Raises ValueError where nothing was appended."""
        self.check_begun()
        tracks = find_tracks(self._parts, place)
        self._parts.clear()
        return [find_motion(track, self._options, place) for track in tracks]


def motion_output(
    write: Write,
    group: Group,
    unit: str = "m",
    prepare: Prepare | None = None,
    angles: Write | None = None,
) -> Output:
    """Return what gives a writer to files that appear on a clean exit: `target`, or one per group.

    Several are named after the target: man.trc becomes man_NAME.trc. What is returned raises
    InputError where they cannot be written; those of an earlier run then stay as they were.
    """

    @contextmanager
    def output(target: Path, form: Layout, options: OutputOptions) -> Iterator[MotionWriter]:
        if isinstance(target, UrlPath):
            found = "motion can be several files, which do not appear together in an object store"
            raise input_error(target, found, "write it to this machine, and copy it there")
        check_output(target)
        writer = MotionWriter(options)
        yield writer
        motions, note = writer.motions(str(target)), ""
        if prepare is not None:
            motions, note = prepare(motions, str(target))
        files = _files(target, group(motions), write, angles)
        if len(files) == 1:
            with atomic_path(target) as path:
                write(path, motions)
        else:
            _write_staged(target, files)
        paths = [target] if len(files) == 1 else [target.parent / name for name in files]
        writer.summary = _summary(motions, paths, unit, note)

    return output


def by_individual(motions: Sequence[Motion]) -> dict[str, list[Motion]]:
    """Give each motion a file of its own, named by its sequence without what all begin with."""
    return dict(
        zip(_own_names([each.name for each in motions]), ([m] for m in motions), strict=True)
    )


def by_video(motions: Sequence[Motion]) -> dict[str, list[Motion]]:
    """Put the individuals of a video in one file; a sequence is `video/individual`, or a video."""
    groups: dict[str, list[Motion]] = {}
    for motion in motions:
        groups.setdefault(motion.name.rpartition("/")[0] or motion.name, []).append(motion)
    return groups


def _files(
    target: Path, groups: dict[str, list[Motion]], write: Write, angles: Write | None
) -> dict[PurePosixPath, Callable[[Path], None]]:
    """Return the files to write, by name: one per group, with angles and verdicts beside it."""
    resolved = Path(os.path.realpath(target))
    files: dict[PurePosixPath, Callable[[Path], None]] = {}
    for name, motions in zip(_plain_names(groups), groups.values(), strict=True):
        stem = file_stem(f"{resolved.stem}_{name}") if len(groups) > 1 else resolved.stem
        files[PurePosixPath(f"{stem}{resolved.suffix}")] = partial(_write_group, write, motions)
        if angles is not None and motions[0].angle_names:
            files[PurePosixPath(f"{stem}_angles.csv")] = partial(_write_group, angles, motions)
        if verdicts := [each.verdicts for each in motions if each.verdicts]:
            files[PurePosixPath(f"{stem}_frames.csv")] = partial(write_verdicts, verdicts)
    return files


def _write_group(write: Write, motions: Sequence[Motion], path: Path) -> None:
    write(path, motions)


def _write_staged(target: Path, files: dict[PurePosixPath, Callable[[Path], None]]) -> None:
    """Write files that appear together."""
    with staged_files(Path(os.path.realpath(target)).parent) as staged:
        for name, write in files.items():
            staged.write(name, partial(write_and_sync, write), name.stem)


def _plain_names(endings: Iterable[str]) -> list[str]:
    """Return endings without / and spaces; those that become the same get a number."""
    names: dict[str, None] = {}
    for ending in endings:
        plain = name = ending.replace("/", "_").replace(" ", "_")
        number = 1
        while name in names:
            number += 1
            name = f"{plain}_{number}"
        names[name] = None
    return list(names)


def _own_names(names: Sequence[str]) -> list[str]:
    """Return names without the folders that all begin with: cam01/a, cam01/b -> a, b."""
    parts = [name.split("/") for name in names]
    shared = 0
    while all(len(part) > shared + 1 and part[shared] == parts[0][shared] for part in parts):
        shared += 1
    return ["/".join(part[shared:]) for part in parts]


def _summary(motions: Sequence[Motion], paths: Sequence[Path], unit: str, note: str) -> Summary:
    said = dict.fromkeys(f"in {unit} by {each.size}, {each.axes}" for each in motions)
    said |= {note: None} if note else {}
    warnings = dict.fromkeys(text for each in motions for text in each.warnings)
    return Summary(note="; ".join(said), warnings=tuple(warnings), written=tuple(paths))

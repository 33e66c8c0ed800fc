"""Records parted into sequences, each a motion in metres with gaps and verdicts; their writer."""

from __future__ import annotations

import csv
import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field
from functools import partial
from itertools import chain, count
from pathlib import Path, PurePosixPath

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats, Integers
from shapefit.errors import abbreviate, counted, input_error
from shapefit.geometry.joint_rotations import Rig
from shapefit.io.atomic import atomic_path, check_output, file_stem, staged_files
from shapefit.io.foreign.items import FRAME
from shapefit.io.formats import RecordWriter
from shapefit.io.layout import EDGES, METRES_PER_UNIT, Layout
from shapefit.io.options import OutputOptions, Summary
from shapefit.io.records import Names, concatenate
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

KEPT = {
    *("shapes", "translation", "scale", "shape_sd"),
    *(EDGES, METRES_PER_UNIT, CAMERA_TRANSLATION, EXTRINSIC_ROTATION, EXTRINSIC_TRANSLATION),
    *(FRAME, DOUBT, PLAUSIBILITY, ANGLES, ANGLE_SD),
}
"""Columns that files of motion are made of."""

MOST_GAPS = 100
"""Frames without an item, for each with one; with more it is no sequence."""

NO_RATE = "the frame rate is unknown, so times are numbers of frames; set `frame_rate`"

COLUMNS = ("item", "frame", "time", "trusted", "reason", "plausibility", "mean_error_bar_m")
"""Of the verdicts on the items of a motion, whose cells are empty where something is not known."""


@dataclass(frozen=True, kw_only=True)
class Motion:
    """Every frame of a sequence from its first to its last.

    points (f, 3, p) in metres, nan where there is nothing; first, the number of the first frame;
    rate in Hz, 1 where it is not known; edges (e, 2) between landmarks; axes and size in words;
    warnings about the sequence; start (3,) as in `Placed`; verdicts, rows of COLUMNS where the
    records say which shapes are to be trusted; rig for files that hold turning bones. deviations
    (f, p) of points in metres, angles and their deviations (f, a) in degrees; nan where they are
    not known.
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
    verdicts: Sequence[tuple[object, ...]] = ()
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
        known = {row[1]: str(row[3]) for row in self.verdicts}
        return [known.get(frame, "") for frame in self.frames.tolist()]


def find_motions(records: Solid, options: OutputOptions, place: str) -> list[Motion]:
    """Part records by sequence, each in the order of its frames.

    Frames are those of the dataset `frame`, or, without one, the order of the items. Raises
    InputError where two items of a sequence are of one frame, for frames too far apart, and for
    items of no sequence whose places in a video are known: nobody says that they are of one body.
    """
    names = np.array(records.sequences or ("",) * len(records), dtype=object)
    frames = records.columns.get(FRAME)
    if frames is None or frames.shape != (len(records),) or frames.dtype.kind not in "iu":
        frames = None
    loose = [item for item, name in zip(records.items, names, strict=True) if not name]
    if frames is not None and len(loose) > 1:
        found = f"{abbreviate(loose)} belong to no sequence: they are no motion"
        fix = "read them with `track: nearest`, which joins detections over frames"
        raise input_error(place, found, fix)
    motions = []
    for name in dict.fromkeys(names.tolist()) or ("",):
        rows = np.flatnonzero(names == name)
        own = np.arange(len(rows)) if frames is None else frames[rows].astype(np.int64)
        order = np.argsort(own, kind="stable")
        own, track = own[order], records.take(rows[order])
        same = np.flatnonzero(np.diff(own) == 0)
        if len(same):
            one, other = track.items[same[0]], track.items[same[0] + 1]
            found = f"'{one}' and '{other}' are of one frame of one sequence"
            fix = "read detections with `track: nearest`, which joins them, or one `individual`"
            raise input_error(place, found, fix)
        motions.append(_motion(name, track, own, options, place))
    return motions


def _motion(
    name: str, records: Solid, frames: Integers, options: OutputOptions, place: str
) -> Motion:
    """Return one sequence in metres, its frames (n,) in order, with gaps for those it lacks."""
    placed = in_metres(records, options, place)
    n, first = len(frames), int(frames[0]) if len(frames) else 0
    length = int(frames[-1]) - first + 1 if n else 0
    of = f" of {name}" if name else ""
    if length > MOST_GAPS * n:
        found = f"there are {counted(n, 'item')} in {length:,} frames{of}"
        raise input_error(place, found, "write items that are so far apart to HDF5 or CSV")

    def by_frame(values: Floats) -> Floats:
        """Return values of the items (n, ...) for each frame (f, ...), nan in gaps."""
        spread = np.full((length, *values.shape[1:]), np.nan)
        spread[frames - first] = values
        return spread

    sd = records.columns.get("shape_sd", np.full_like(records.shapes, np.nan))
    none = np.empty((n, 0))
    failed = int((~np.isfinite(placed.points).any(axis=(1, 2))).sum())
    warnings = list(placed.warnings)
    if failed:
        warnings.append(f"{counted(failed, 'item')} without a shape{of}: gaps")
    if length > n:
        warnings.append(f"{counted(length - n, 'frame')} without an item{of}: gaps")
    if not records.frame_rate:
        warnings.append(NO_RATE)
    rate, stated = records.frame_rate or 1.0, records.lines
    edges = edges_of(records.landmark_names) if stated is None else stated
    return Motion(
        name=name,
        landmark_names=records.landmark_names,
        points=by_frame(placed.points),
        deviations=by_frame(placed.factor[:, None] * np.sqrt((sd**2).sum(axis=1))),
        angles=by_frame(records.columns.get(ANGLES, none)),
        angle_deviations=by_frame(records.columns.get(ANGLE_SD, none)),
        first=first,
        rate=rate,
        edges=np.asarray(edges, np.int64).reshape(-1, 2),
        axes=placed.axes,
        size=placed.size,
        warnings=tuple(warnings),
        start=placed.start,
        verdicts=_verdicts(records, frames, rate, placed.factor),
    )


def _verdicts(
    records: Solid, frames: Integers, rate: float, factor: Floats
) -> list[tuple[object, ...]]:
    """Return a row of COLUMNS for each item; none where the records say nothing.

    The error bar is the mean over landmarks of sqrt(sd_x^2 + sd_y^2 + sd_z^2), in metres; factor
    (n,) are the metres in a unit of each shape.
    """
    doubts, sd = records.columns.get(DOUBT), records.columns.get("shape_sd")
    if doubts is None or sd is None:
        return []
    bars = factor * np.sqrt((sd**2).sum(axis=1)).mean(axis=1)
    plausible = records.columns.get(PLAUSIBILITY, np.full(len(records), np.nan))
    cells = ([f"{v:.4g}" if np.isfinite(v) else "" for v in each] for each in (plausible, bars))
    times = [f"{time:.10g}" for time in frames / rate]
    trusted = ["false" if doubt else "true" for doubt in doubts]
    columns = (records.items, frames.tolist(), times, trusted, map(str, doubts), *cells)
    return list(zip(*columns, strict=True))


def _write_verdicts(rows: Iterable[Sequence[object]], path: Path) -> None:
    with path.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows([COLUMNS, *rows])


Write = Callable[[Path, Sequence[Motion]], None]
"""Fills a new file with motions that belong in one."""

Prepare = Callable[[Sequence[Motion], str], tuple[list[Motion], str]]
"""Makes of motions what a format holds, with a note; raises InputError at a place if it cannot."""

Group = Callable[[Sequence[Motion]], dict[str, list[Motion]]]
"""Parts motions by file: what its name ends with -> those that it holds."""

Output = Callable[[Path, Layout, OutputOptions], AbstractContextManager["MotionWriter"]]


class MotionWriter(RecordWriter[Solid]):
    """Takes shapes or results; keeps their points, as the scale of a sequence takes all of it."""

    def __init__(self, options: OutputOptions, *, angles: bool) -> None:
        """Take records for files in metres; `angles`, whether joint angles are written of them."""
        super().__init__()
        self.parts: list[Solid] = []
        self._up, self._angles = options.up, angles

    def append(self, record: Solid) -> None:
        """Take the items of a record after those that are there."""
        self.begun = True
        measured = angle_columns(record, self._up) if self._angles else {}
        columns = {**record.columns, **measured}
        kept = {name: values for name, values in columns.items() if name in KEPT}
        self.parts.append(record.replaced(columns=kept))  # type: ignore[arg-type]


def motion_output(
    write: Write,
    group: Group,
    unit: str = "m",
    prepare: Prepare | None = None,
    angles: Write | None = None,
    measured: bool = False,
) -> Output:
    """Return what gives a writer to files that appear on a clean exit: `target`, or one per group.

    Several are named after the target: man.trc becomes man_NAME.trc. `angles` writes joint angles
    beside each, and `measured` ones are part of the format. What is returned raises InputError
    where they cannot be written; those of an earlier run then stay as they were.
    """

    @contextmanager
    def output(target: Path, form: Layout, options: OutputOptions) -> Iterator[MotionWriter]:
        if isinstance(target, UrlPath):
            found = "motion can be several files, which do not appear together in an object store"
            raise input_error(target, found, "write it to this machine, and copy it there")
        check_output(target)
        writer = MotionWriter(options, angles=measured or angles is not None)
        yield writer
        writer.check_begun()
        records: Solid = concatenate(writer.parts)  # type: ignore[type-var]
        writer.parts.clear()
        motions, note = find_motions(records, options, str(target)), ""
        if prepare is not None:
            motions, note = prepare(motions, str(target))
        files = _files(target, group(motions), write, angles)
        if len(files) == 1:
            with atomic_path(target) as path:
                write(path, motions)
        else:
            with staged_files(Path(os.path.realpath(target)).parent) as staged:
                for name, fill in files.items():
                    staged.write(name, fill, name.stem, sync=True)
        said = dict.fromkeys(f"in {unit} by {each.size}, {each.axes}" for each in motions)
        warnings = dict.fromkeys(text for each in motions for text in each.warnings)
        paths = [target] if len(files) == 1 else [target.parent / name for name in files]
        note = "; ".join([*said, *([note] if note else ())])
        writer.summary = Summary(note=note, warnings=tuple(warnings), written=tuple(paths))

    return output


def by_individual(motions: Sequence[Motion]) -> dict[str, list[Motion]]:
    """Give each motion a file of its own, named by its sequence without what all begin with.

    Folders that all are in are left out: cam01/a, cam01/b -> a, b.
    """
    parts = [each.name.split("/") for each in motions]
    shared = 0
    while all(len(part) > shared + 1 and part[shared] == parts[0][shared] for part in parts):
        shared += 1
    names = ("/".join(part[shared:]) for part in parts)
    return {name: [motion] for name, motion in zip(names, motions, strict=True)}


def by_video(motions: Sequence[Motion]) -> dict[str, list[Motion]]:
    """Put the individuals of a video in one file; a sequence is `video/individual`, or a video."""
    groups: dict[str, list[Motion]] = {}
    for motion in motions:
        groups.setdefault(motion.name.rpartition("/")[0] or motion.name, []).append(motion)
    return groups


def _files(
    target: Path, groups: dict[str, list[Motion]], write: Write, angles: Write | None
) -> dict[PurePosixPath, Callable[[Path], None]]:
    """Return the files to write, by name: one per group, with angles and verdicts beside it.

    Names have no / and no spaces; those that become the same get a number.
    """
    resolved = Path(os.path.realpath(target))
    files: dict[PurePosixPath, Callable[[Path], None]] = {}
    stems: set[str] = set()
    for ending, motions in groups.items():
        plain = ending.replace("/", "_").replace(" ", "_")
        numbered = (f"{plain}_{number}" for number in count(2))
        name = next(each for each in chain([plain], numbered) if each not in stems)
        stems.add(name)
        stem = file_stem(f"{resolved.stem}_{name}") if len(groups) > 1 else resolved.stem
        files[PurePosixPath(f"{stem}{resolved.suffix}")] = partial(_write_group, write, motions)
        if angles is not None and motions[0].angle_names:
            files[PurePosixPath(f"{stem}_angles.csv")] = partial(_write_group, angles, motions)
        if verdicts := [row for each in motions for row in each.verdicts]:
            files[PurePosixPath(f"{stem}_frames.csv")] = partial(_write_verdicts, verdicts)
    return files


def _write_group(write: Write, motions: Sequence[Motion], path: Path) -> None:
    write(path, motions)

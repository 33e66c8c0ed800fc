"""Records parted into sequences, each a motion in metres with gaps; their writer."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats, Integers
from shapefit.errors import abbreviate, counted, input_error
from shapefit.geometry.floor import Body, Floor, find_floor
from shapefit.geometry.joint_angles import measure_angles
from shapefit.geometry.joint_rotations import Rig
from shapefit.geometry.pinhole import ASSUMED_FOCAL
from shapefit.io.atomic import check_output, file_stem, staged_files
from shapefit.io.layout import (
    EDGES,
    FRAME,
    INPUT_NAMES,
    INPUT_SD,
    INPUT_SHAPES,
    METRES_PER_UNIT,
    Layout,
)
from shapefit.io.options import OutputOptions, RecordWriter, Summary
from shapefit.io.readers.poses import make_unique
from shapefit.io.records import Names, ShapeSet, concatenate
from shapefit.io.skeletons import (
    edges_of,
    installed_skeletons,
    joint_columns,
    model_names,
    people_joints,
)
from shapefit.io.writers.angles import ANGLE_SD, ANGLES, angle_columns, angle_names
from shapefit.io.writers.metres import (
    CAMERA_TRANSLATION,
    EXTRINSIC_ROTATION,
    EXTRINSIC_TRANSLATION,
    Shapes3D,
    find_stature,
    in_metres,
)
from shapefit.lifting.verdict import P_VALUE, REASONS

RETAINED = {
    *("shapes", "translation", "scale", "shape_sd"),
    *(EDGES, METRES_PER_UNIT, CAMERA_TRANSLATION, EXTRINSIC_ROTATION, EXTRINSIC_TRANSLATION),
    *(FRAME, REASONS, P_VALUE, ANGLES, ANGLE_SD, "focal", "principal_point", "landmarks"),
    *(INPUT_SHAPES, INPUT_SD, INPUT_NAMES),
}
"""Columns that files of motion are made of."""

MOST_GAPS = 100
"""Frames without an item, for each with one; with more it is no sequence."""

MOST_DESCRIBED = 3
"""Floors of different videos that the note of a command describes."""

NO_RATE = "the frame rate is unknown, so times are numbers of frames; set `frame_rate`"


@dataclass(frozen=True, kw_only=True)
class Motion:
    """Every frame of a sequence from its first to its last.

    points (f, 3, p) in metres, nan where there is nothing; first, the number of the first frame;
    rate in Hz, 1 where it is not known; edges (e, 2) between landmarks; axes and size in words;
    warnings about the sequence; trusted (f,), true, false, or "" where
    the records do not say; rig for files that hold turning bones. deviations
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
    angle_names: Names = ()
    trusted: Sequence[str] = ()
    edges: Integers = field(default_factory=lambda: np.empty((0, 2), np.int64))
    rig: Rig | None = None

    @property
    def frames(self) -> NDArray[np.int64]:
        """Return the number of each frame (f,)."""
        return self.first + np.arange(len(self.points), dtype=np.int64)


def find_motions(records: Shapes3D, options: OutputOptions, place: str) -> list[Motion]:
    """Part records by sequence, each in the order of its frames, on the floor of its video.

    Raises InputError as `_tracks`, and for frames too far apart.
    """
    tracks = _tracks(records, place)
    floors = find_floors(records, options, place)
    return [
        _motion(name, track, frames, options, place, floors.get(video_of(name)))
        for name, track, frames in tracks
    ]


def _tracks(records: Shapes3D, place: str) -> list[tuple[str, Shapes3D, Integers]]:
    """Part records by sequence: name, items and their frames (n,), in the order of these.

    Frames are those of the dataset `frame`, or, without one, the order of the items. Raises
    InputError where two items of a sequence are of one frame, and for items of no sequence whose
    places in a video are known: nobody says that they are of one body.
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
    tracks = []
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
        tracks.append((name, track, own))
    return tracks


def video_of(sequence: str) -> str:
    """Return the video of a sequence, which is `video/individual` or a video."""
    return sequence.rpartition("/")[0] or sequence


FOCAL_SD, SCALE_SD = 0.18, 0.05
"""Of the logarithm of the distance to a body: by a focal length that is assumed (lenses have .8 to
1.5 widths), and by a known one."""

USUAL_RATE = 25.0
"""Frames a second where nobody says."""


def find_floors(records: Shapes3D, options: OutputOptions, place: str) -> dict[str, Floor]:
    """Return the floor that the bodies of each video stand on, by its name, where it is known.

    It takes results under perspective, in the frame of their camera, and what is to be trusted of
    them. Raises InputError as `in_metres`.
    """
    columns, names = records.columns, records.landmark_names
    if isinstance(records, ShapeSet) or CAMERA_TRANSLATION not in columns:
        return {}
    if EXTRINSIC_ROTATION in columns or find_stature(records.shapes[:0], names) is None:
        return {}
    size = 2 * np.max(columns.get("principal_point", 0.0))
    assumed = bool(np.isclose(np.max(columns.get("focal", 0.0)), ASSUMED_FOCAL * size))
    bodies: dict[str, list[Body]] = {}
    for name, track, _ in _tracks(records, place):
        placed = in_metres(track, options, place)
        points, sd = placed.points, track.columns.get("shape_sd", np.full_like(track.shapes, 0.1))
        points, rate = points.copy(), track.frame_rate or USUAL_RATE
        if (reasons := track.columns.get(REASONS)) is not None:
            points[reasons != ""] = np.nan
        for ankle in (joint_columns(names)[f"{side}ankle"] for side in "lr"):
            points[~_visible_around(track, ankle, rate), :, ankle] = np.nan
        stature = find_stature(points, names)
        assert stature is not None
        if np.isfinite(stature).any():
            tall = float(np.nanmedian(stature))
            body = Body(points, placed.factor[:, None, None] * sd, joint_columns(names), tall, rate)
            bodies.setdefault(video_of(name), []).append(body)
    found = {name: find_floor(of, FOCAL_SD if assumed else SCALE_SD) for name, of in bodies.items()}
    return {name: floor for name, floor in found.items() if floor is not None}


def _visible_around(records: Shapes3D, column: int, rate: float) -> NDArray[np.bool_]:
    """Whether a landmark (n,) was seen in the image or in one within a quarter of a second.

    Feet that the model gives where an image ends at the hips stand nowhere.
    """
    landmarks = records.columns.get("landmarks")
    if landmarks is None or landmarks.shape[:2] != (len(records), len(records.landmark_names)):
        return np.ones(len(records), dtype=np.bool_)
    visible = np.isfinite(landmarks[:, column]).all(axis=-1)
    near = min(round(rate / 4), len(visible) - 1)
    return np.asarray(np.convolve(visible, np.ones(2 * near + 1))[near : near + len(visible)] > 0)


def _motion(
    name: str,
    records: Shapes3D,
    frames: Integers,
    options: OutputOptions,
    place: str,
    floor: Floor | None,
) -> Motion:
    """Return one sequence in metres, its frames (n,) in order, with gaps for those it lacks."""
    names, angles = angle_names(records.landmark_names), records.columns.get(ANGLES)
    if floor is not None and angles is not None:  # tilts of trunk and head to the true vertical
        up = floor.up * (np.array([1.0, -1.0, -1.0]) if records.y_axis == "down" else 1.0)
        angles = measure_angles(records.shapes, up, joint_columns(records.landmark_names))[0]
    if options.markers == "input":
        records = _as_markers(records)
    placed = in_metres(records, options, place, floor)
    n, first = len(frames), int(frames[0]) if len(frames) else 0
    length = int(frames[-1]) - first + 1 if n else 0
    of = f" of {name}" if name else ""
    if length > MOST_GAPS * n:
        found = f"there are {counted(n, 'item')} in {length:,} frames{of}"
        raise input_error(place, found, "write items that are so far apart to HDF5 or CSV")

    def by_frame(values: Floats) -> Floats:
        """Return values of the items (n, ...) for each frame (f, ...), nan in gaps."""
        per_frame = np.full((length, *values.shape[1:]), np.nan)
        per_frame[frames - first] = values
        return per_frame

    trusted, reasons = [""] * length, records.columns.get(REASONS)
    for frame, reason in zip(frames.tolist(), () if reasons is None else reasons, strict=False):
        trusted[frame - first] = "false" if reason else "true"
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
        angles=by_frame(none if angles is None else angles),
        angle_deviations=by_frame(records.columns.get(ANGLE_SD, none)),
        angle_names=names,
        first=first,
        rate=rate,
        edges=np.asarray(edges, np.int64).reshape(-1, 2),
        axes=placed.axes,
        size=placed.size,
        warnings=tuple(warnings),
        trusted=trusted,
    )


def _as_markers(records: Shapes3D) -> Shapes3D:
    """Return the landmarks of the files, by the names that models know, in place of the joints."""
    columns = records.columns
    sd, given = columns.get(INPUT_SD), tuple(map(str, columns[INPUT_NAMES]))
    retained = records.without((INPUT_SHAPES, INPUT_SD, INPUT_NAMES))
    return retained.replaced(
        shapes=columns[INPUT_SHAPES].swapaxes(1, 2),
        shape_sd=None if sd is None else sd.swapaxes(1, 2),
        landmark_names=model_names(given),
        further={**retained.further, EDGES: np.array(edges_of(given), np.int64).reshape(-1, 2)},
    )


def _describe_markers(records: Shapes3D) -> str:
    """Say which markers were fitted where they were seen, and which follow from the others."""
    own = tuple(map(str, records.columns[INPUT_NAMES]))
    fitted = people_joints(own)
    following = [name for name in own if name not in fitted]
    skeletons = (set(each.landmark_names) for each in installed_skeletons().values())
    whole = next((each for each in skeletons if set(own) <= each), set(own))
    note = f"{counted(len(own), 'marker')} of the files"
    note += f"; {abbreviate(following)} estimated by the model alone" if following else ""
    missing = sorted(whole - set(own))
    return note + (f"; {abbreviate(missing)} not marked, or not determined" if missing else "")


Write = Callable[[Path, Motion], None]
"""Fills a new file with a motion."""

Prepare = Callable[[Sequence[Motion], str], tuple[list[Motion], str]]
"""Makes of motions what a format holds, with a note; raises InputError at a place if it cannot."""

Output = Callable[[Path, Layout, OutputOptions], AbstractContextManager["MotionWriter"]]


class MotionWriter(RecordWriter[Shapes3D]):
    """Takes shapes or results; keeps their points, as the scale of a sequence takes all of it."""

    def __init__(self, options: OutputOptions, *, angles: bool) -> None:
        """Take records for files in metres; `angles`, whether joint angles are written of them."""
        super().__init__()
        self.parts: list[Shapes3D] = []
        self._options, self._angles = options, angles

    def append(self, record: Shapes3D) -> None:
        """Take the items of a record after those that are there."""
        if self._options.markers == "input" and INPUT_SHAPES not in record.columns:
            found = "`--markers input`: there are no landmarks of a detector beside the joints"
            fix = "leave it out, or lift them with `posterior` or `sequences`"
            raise input_error("markers", found, fix)
        self.begun = True
        measured = angle_columns(record, self._options.up) if self._angles else {}
        own = record.with_columns(measured)
        self.parts.append(own.without(own.columns.keys() - RETAINED))  # type: ignore[arg-type]


def motion_output(
    write: Write,
    unit: str = "m",
    prepare: Prepare | None = None,
    angles: Write | None = None,
    measured: bool = False,
) -> Output:
    """Return what gives a writer to a file per sequence; all appear on a clean exit.

    One sequence goes to `target`; several are named after it: man.trc becomes man_NAME.trc.
    `angles` writes joint angles beside each; `measured`, whether they are part of the format. What
    is returned raises InputError where the files cannot be written; earlier ones then stay.
    """

    @contextmanager
    def output(target: Path, form: Layout, options: OutputOptions) -> Iterator[MotionWriter]:
        check_output(target)
        writer = MotionWriter(options, angles=measured or angles is not None)
        yield writer
        writer.check_begun()
        records: Shapes3D = concatenate(writer.parts)  # type: ignore[type-var]
        writer.parts.clear()
        motions, note = find_motions(records, options, str(target)), ""
        if prepare is not None:
            motions, note = prepare(motions, str(target))
        if options.markers == "input":
            note = "; ".join(filter(None, (note, _describe_markers(records))))
        files = _files(target, motions, write, angles)
        with staged_files(Path(os.path.realpath(target)).parent) as staged:
            for name, fill, motion in files:
                (staged / name).parent.mkdir(parents=True, exist_ok=True)
                fill(staged / name, motion)
        placed = [*dict.fromkeys(f"in {unit} by {each.size}, {each.axes}" for each in motions)]
        if len(placed) > MOST_DESCRIBED:
            others = len(placed) - MOST_DESCRIBED
            placed[MOST_DESCRIBED:] = [f"and {others} others, as their files say"]
        warnings = dict.fromkeys(text for each in motions for text in each.warnings)
        paths = [target.parent / name for name, *_ in files] if len(files) > 1 else [target]
        note = "; ".join(filter(None, [*placed, note]))
        writer.summary = Summary(note=note, warnings=tuple(warnings), written=tuple(paths))

    return output


def _files(
    target: Path, motions: Sequence[Motion], write: Write, angles: Write | None
) -> list[tuple[PurePosixPath, Write, Motion]]:
    """Return the names of the files to write, with what fills them: one per motion, and its angles.

    Names are those of the sequences, without the folders that all are in, / and spaces; those
    that become the same get a number.
    """
    resolved = Path(os.path.realpath(target))
    parts = [motion.name.split("/") for motion in motions]
    shared = 0
    while all(len(part) > shared + 1 and part[shared] == parts[0][shared] for part in parts):
        shared += 1
    names, _ = make_unique(["_".join(p[shared:]).replace(" ", "_") or "motion" for p in parts])
    files: list[tuple[PurePosixPath, Write, Motion]] = []
    for name, motion in zip(names, motions, strict=True):
        stem = file_stem(f"{resolved.stem}_{name}") if len(motions) > 1 else resolved.stem
        files.append((PurePosixPath(f"{stem}{resolved.suffix}"), write, motion))
        if angles is not None and motion.angle_names:
            files.append((PurePosixPath(f"{stem}_angles.csv"), angles, motion))
    return files

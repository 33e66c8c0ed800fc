"""Motion in metres: records parted into sequences, with joint angles, on a floor; their
writer.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats, Integers
from shapefit.errors import counted, input_error
from shapefit.geometry.cameras import IMAGE_UP, TO_Y_UP, Up, nearest_axis_up
from shapefit.geometry.floor import FilmedBody, Floor, find_floor
from shapefit.geometry.joint_angles import measurable_angles, measure_angles
from shapefit.geometry.pinhole import is_assumed_focal
from shapefit.io.atomic import check_output, file_stem, staged_files
from shapefit.io.options import OutputOptions, RecordWriter, Summary
from shapefit.io.readers.poses import number_repeats
from shapefit.io.skeletons import edges_of, joint_columns, model_names
from shapefit.io.writers.metres import (
    EXTRINSIC_ROTATION,
    EXTRINSIC_TRANSLATION,
    MetricShapes,
    Shapes3D,
    convert_to_metres,
    find_stature,
    image_axis_signs,
)
from shapefit.records import Fit, Record, concatenate
from shapefit.records.columns import Array, in_columns
from shapefit.timeline import (
    ASSUMED_RATE,
    JITTER,
    MAX_GAP_SECONDS,
    UNKNOWN_RATE,
    find_rate,
)

ANGLES = "joint_angles"
"""Column (n, a) of records on their way to a file of motion, in degrees."""

ANGLE_SD = "joint_angle_sd"
"""Column (n, a) of their standard deviations."""

RETAINED = {
    "landmark_names",
    "item",
    "sequence",
    "frame",
    "time",
    "edges",
    "shapes",
    "shape_sd",
    "reasons",
    "landmarks",
    "translation",
    "scale",
    "focal",
    "principal_point",
    "camera_translation",
    "metres_per_unit",
    "stated_height",
    "input_landmark_names",
    "input_shapes",
    "input_shape_sd",
    "image_size",
    "removed_distortion",
    EXTRINSIC_ROTATION,
    EXTRINSIC_TRANSLATION,
    ANGLES,
    ANGLE_SD,
}
"""Columns of which files of motion are made."""

ASSUMED_DISTANCE_SD = 0.18
"""Of the logarithm of the distance to a body, by a focal length that is assumed: lenses
have 0.8 to 1.5 widths.
"""

KNOWN_DISTANCE_SD = 0.05
"""Of that logarithm, by a known focal length."""

UNKNOWN_SD = 0.1
"""Standard deviation of a coordinate in the unit of the shapes, where none is known."""

MAX_MISSING_PER_FRAME = 1000
"""Missing frames for each that is there, up to which they become empty rows."""

NO_RATE = "the frame rate is unknown, so times are numbers of frames; set `frame_rate`"


@dataclass(frozen=True, kw_only=True, eq=False)
class FileMotion:
    """Every frame of a sequence, from the number `first` on, missing ones too.

    points (f, 3, p) and deviations (f, p) in metres, angles and deviations (f, a) in
    degrees, nan where unknown; rate in Hz, UNKNOWN_RATE where none is known; times (f,)
    in seconds, of the rate or as they are stated; edges (e, 2); trusted (f,): true,
    false, or "".
    """

    name: str
    landmark_names: Sequence[str]
    points: Floats
    first: int
    rate: float
    times: Floats
    edges: Integers
    axes: str
    size: str
    warnings: tuple[str, ...]
    trusted: Sequence[str]
    deviations: Floats
    angle_names: Sequence[str]
    angles: Floats
    angle_deviations: Floats

    @property
    def is_rate_known(self) -> bool:
        """Whether the frame rate is known, so that times are seconds."""
        return NO_RATE not in self.warnings

    @property
    def frames(self) -> NDArray[np.int64]:
        """The number of each frame (f,)."""
        return self.first + np.arange(len(self.points), dtype=np.int64)

    @property
    def timing_note(self) -> str:
        """A note on how far times are off a constant frame rate, "" if they are not."""
        off = self.times - self.frames / self.rate
        away = float(np.ptp(off)) if len(off) else 0.0
        if away * self.rate <= JITTER:
            return ""
        return f"times are off the steady {self.rate:g} Hz by up to {away:.3g} s"


NamedSequence = tuple[str, Shapes3D, Integers]
"""A sequence: its name, and items by their frames (n,)."""

Write = Callable[
    [Path, FileMotion], str | None
]  # fills a new file; may return a note for the summary
JudgeAngles = Callable[[Sequence[FileMotion]], str]


class MotionWriter(RecordWriter[Shapes3D]):
    """Collects shapes or results in memory, as the scale of a sequence depends on all
    of it.
    """

    def __init__(self, options: OutputOptions, *, angles: bool) -> None:
        """Take the options of files in metres; with `angles` compute joint angles."""
        super().__init__()
        self._parts: list[Shapes3D] = []
        self._options, self._angles = options, angles

    def append(self, record: Shapes3D) -> None:
        """Add the items of a record after those already added.

        Raises InputError where landmarks of a detector are wanted (`markers`), and it
        has none.
        """
        if self._options.markers == "input" and _detector_landmarks(record) is None:
            problem = (
                "`--markers input`: there are no landmarks of a detector beside the"
                " joints"
            )
            fix = "leave it out, or lift them with `posterior` or `sequences`"
            raise input_error("markers", problem, fix)
        self.begun = True
        if self._angles:
            record = record.with_extras(angle_columns(record, self._options.up))
        self._parts.append(record.without(record.column_names() - RETAINED))

    def take_all(self) -> Shapes3D:
        """Remove and return all that was appended, as one record.

        Raises ValueError where nothing was appended.
        """
        self.check_begun()
        records: Shapes3D = concatenate(self._parts)
        self._parts.clear()
        return records


def _detector_landmarks(record: Shapes3D) -> Floats | None:
    """Return the 3D shapes (n, p, 3) of a detector's landmarks, None without them."""
    return record.input_shapes if isinstance(record, Fit) else None


@contextmanager
def motion_output(
    target: Path,
    options: OutputOptions,
    write: Write,
    *,
    suffix: str,
    unit: str = "m",
    angles: bool = False,
    judge_angles: JudgeAngles | None = None,
) -> Iterator[MotionWriter]:
    """Yield a writer; on a clean exit write a file for each sequence, by `write`.

    `judge_angles` says in the summary how certain the angles of all sequences are.

    One sequence goes to `target`; several are named after it: man.trc becomes
    man_NAME.trc. `suffix` is that of the format. Raises InputError where the files
    cannot be written; earlier ones then stay.
    """
    check_output(target)
    writer = MotionWriter(options, angles=angles)
    yield writer
    motions = find_motions(writer.take_all(), options, str(target))
    resolved = Path(os.path.realpath(target))
    ending = _find_suffix(resolved, suffix)
    whole = resolved.name.removesuffix(ending)
    stems = _file_stems(whole, [motion.name for motion in motions])
    with staged_files(resolved.parent) as staged:
        paths = [staged / f"{stem}{ending}" for stem in stems]
        notes = [
            write(path, motion) for path, motion in zip(paths, motions, strict=True)
        ]
        names = sorted(path.name for path in staged.iterdir())
    placed = [f"in {unit} by {motion.size}, {motion.axes}" for motion in motions]
    writer.summary = Summary(
        note="; ".join(dict.fromkeys(filter(None, (*placed, *notes)))),
        warnings=warnings_of(motions),
        written=(
            tuple(target.parent / name for name in names)
            if len(names) > 1
            else (target,)
        ),
        angles=judge_angles(motions) if judge_angles else "",
    )


def warnings_of(motions: Sequence[FileMotion]) -> tuple[str, ...]:
    """Return the warnings of all motions, without duplicates."""
    return tuple(dict.fromkeys(text for motion in motions for text in motion.warnings))


def _find_suffix(target: Path, suffix: str) -> str:
    """Return the suffix of a file's name as written: the format's, else the last one.

    `suffix` is that of the format, such as .metres.csv.
    """
    if target.name.lower().endswith(suffix):
        return target.name[-len(suffix) :]
    return target.suffix


def _file_stems(stem: str, names: Sequence[str]) -> list[str]:
    """Return the file stem of each sequence: `stem_name`, or `stem` for one sequence.

    Folders that all names share are left out; those that are then the same get a
    number.
    """
    parts, shared = [name.split("/") for name in names], 0
    while all(
        len(part) > shared + 1 and part[shared] == parts[0][shared] for part in parts
    ):
        shared += 1
    short = number_repeats(
        ["_".join(part[shared:]).replace(" ", "_") for part in parts]
    )
    return [
        str(file_stem(f"{stem}_{name}")) if len(names) > 1 else stem for name in short
    ]


def find_motions(
    records: Shapes3D, options: OutputOptions, place: str
) -> list[FileMotion]:
    """Make the motion of each sequence: in metres, by frame, on its video's floor.

    Raises InputError at `place` as `_split_sequences` and `convert_to_metres`.
    """
    floors = find_floors(records, options, place)
    named_sequences = _split_sequences(records, place)
    return [
        _make_motion(sequence, options, place, floors.get(video_of(sequence[0])))
        for sequence in named_sequences
    ]


def find_floors(
    records: Shapes3D, options: OutputOptions, place: str
) -> dict[str, Floor]:
    """Return video -> the floor that its people stand on, where it can be estimated.

    It is that of trusted results under perspective. Raises InputError at `place` as
    `convert_to_metres`.
    """
    names = records.landmark_names
    if not isinstance(records, Fit) or records.camera_translation is None:
        return {}
    if records.column(EXTRINSIC_ROTATION) is not None:
        return {}
    if find_stature(records.as_columns()[:0], names) is None:
        return {}
    centre = 0.0 if records.principal_point is None else records.principal_point
    focal = 0.0 if records.focal is None else records.focal
    is_assumed = is_assumed_focal(focal, 2 * np.asarray(centre))
    bodies: dict[str, list[FilmedBody]] = {}
    for name, sequence, frames in _split_sequences(records, place):
        metric = convert_to_metres(sequence, options, place)
        body = _filmed_body(sequence, frames, metric)
        if body is not None:
            bodies.setdefault(video_of(name), []).append(body)
    floors = {
        name: find_floor(of, ASSUMED_DISTANCE_SD if is_assumed else KNOWN_DISTANCE_SD)
        for name, of in bodies.items()
    }
    return {name: floor for name, floor in floors.items() if floor is not None}


def _filmed_body(
    track: Fit, frames: Integers, metric: MetricShapes
) -> FilmedBody | None:
    """Make a FilmedBody of one track, for `find_floor`; None if its height is unknown.

    frames (n,) are those of items. Doubtful shapes, and ankles that were not seen, are
    gaps; short ones are bridged.
    """
    names = track.landmark_names
    rate = track.frame_rate or ASSUMED_RATE
    points = metric.points.copy()
    if track.reasons is not None:
        points[track.reasons != ""] = np.nan
    for ankle in (joint_columns(names)[f"{side}ankle"] for side in "lr"):
        points[~_visible_around(track, ankle, rate, frames), :, ankle] = np.nan
    stature = find_stature(points, names)
    if stature is None or not np.isfinite(stature).any():
        return None
    sd = np.full(1, UNKNOWN_SD)
    if track.shape_sd is not None:
        sd = in_columns(track.shape_sd)
    deviations = metric.factor[:, None, None] * np.broadcast_to(sd, points.shape)
    return FilmedBody(
        bridge_gaps(points, frames, rate),
        bridge_gaps(deviations, frames, rate),
        joint_columns(names),
        float(np.nanmedian(stature)),
        rate,
    )


def bridge_gaps(values: Floats, frames: Integers, rate: float) -> Floats:
    """Interpolate values (n, ...) of frames (n,) at all frames from first to last.

    They are linear in gaps, or nan in gaps of more than `MAX_GAP_SECONDS` seconds. rate
    in Hz.
    """
    every = np.arange(frames[0], frames[-1] + 1) if len(frames) else frames
    if len(every) == len(frames):
        return values
    row = np.searchsorted(frames, every, "right") - 1
    after = np.minimum(row + 1, len(frames) - 1)
    gap = np.maximum(frames[after] - frames[row], 1)
    share = ((every - frames[row]) / gap).reshape(-1, *(1,) * (values.ndim - 1))
    between = np.where(share > 0, share * (values[after] - values[row]), 0.0)
    bridged: Floats = values[row] + between
    bridged[(gap - 1 > MAX_GAP_SECONDS * rate) & (share.ravel() > 0)] = np.nan
    return bridged


def video_of(sequence: str) -> str:
    """Return the video in a sequence's name, `video/individual` or `video`."""
    return sequence.rpartition("/")[0] or sequence


def angle_names(names: Sequence[str]) -> tuple[str, ...]:
    """Return the names of joint angles that these landmarks determine; () for none."""
    return tuple(angle.name for angle in measurable_angles(joint_columns(names)))


def angle_columns(record: Shapes3D, up: Up | None) -> dict[str, Floats]:
    """Compute columns of joint angles and their deviations (n, a) in degrees, or {}.

    Results are upright as their camera is, or by the axis `up` of its world; shapes by
    their axis `up`, y by default. Without `shape_covariance` deviations are two to
    three times as large.
    """
    joints = joint_columns(record.landmark_names)
    if not measurable_angles(joints):
        return {}
    upward: Floats = TO_Y_UP[up or "y"][1]
    covariance = None
    if isinstance(record, Fit):
        rotation = record.column(EXTRINSIC_ROTATION)
        upward = TO_Y_UP[IMAGE_UP][1]
        if rotation is not None:
            turn = np.asarray(rotation, np.float64)
            upward = turn @ TO_Y_UP[up or nearest_axis_up(turn)][1]
        upward = upward * image_axis_signs(record)
        covariance = _covariance(record)
    values, sd = measure_angles(record.as_columns(), upward, joints, covariance)
    return {ANGLES: values, ANGLE_SD: sd}


def _covariance(record: Fit) -> Floats | None:
    """Return the covariance of all landmarks, else of each, or None if it is unknown.

    That of all is the field `shape_covariance`; those of each are (n, p, 3, 3).
    """
    sd = record.shape_sd
    if record.shape_covariance is not None or sd is None:
        return record.shape_covariance
    covariance = np.eye(3) * sd[..., None] ** 2
    correlation = record.shape_correlation
    if correlation is not None:
        for number, (i, j) in enumerate(((0, 1), (0, 2), (1, 2))):
            product = correlation[..., number] * sd[..., i] * sd[..., j]
            covariance[..., i, j] = covariance[..., j, i] = product
    return covariance


def _split_sequences(records: Record, place: str) -> list[tuple[str, Record, Integers]]:
    """Split a record by sequence: name, items sorted by frame, and frames (n,) of each.

    Records without frames are in the order of their items. Raises InputError at `place`
    where two items of a sequence are of one frame, and where so many are missing that
    gaps cannot be filled.
    """
    names = np.array(records.sequences or ("",) * len(records), dtype=object)
    stated = records.frames
    sequences = []
    for name in dict.fromkeys(names.tolist()) or ("",):
        rows = np.flatnonzero(names == name)
        frames = np.arange(len(rows)) if stated is None else stated[rows]
        order = np.argsort(frames, kind="stable")
        frames, sequence = frames[order], records.take(rows[order])
        same = np.flatnonzero(np.diff(frames) == 0)
        if len(same):
            one, other = sequence.items[same[0]], sequence.items[same[0] + 1]
            problem = f"'{one}' and '{other}' are of one frame of one sequence"
            fix = "give each individual a sequence of its own"
            raise input_error(place, problem, fix)
        if len(rows) and frames[-1] - frames[0] > MAX_MISSING_PER_FRAME * len(rows):
            one = int(frames[0])
            other = int(frames[-1])
            problem = f"{counted(len(rows), 'item')} are of the frames {one} to {other}"
            fix = "number the frames of a video, not the time; or write .h5 or .csv"
            raise input_error(place, problem, fix)
        sequences.append((name, sequence, frames))
    return sequences


def _visible_around(
    records: Fit, landmark: int, rate: float, frames: Integers
) -> NDArray[np.bool_]:
    """Return a mask (n,) of frames with a landmark seen within a quarter of a second.

    landmark: its index; frames (n,): those of items; rate in Hz.
    """
    if records.landmarks is None:
        return np.ones(len(records), dtype=np.bool_)
    visible = np.isfinite(records.landmarks[:, landmark]).all(axis=-1)
    seen = np.concatenate([[0], np.cumsum(visible)])
    near = round(rate / 4)
    first = np.searchsorted(frames, frames - near, "left")
    last = np.searchsorted(frames, frames + near, "right")
    return np.asarray(seen[last] > seen[first])


def _make_motion(
    sequence: NamedSequence, options: OutputOptions, place: str, floor: Floor | None
) -> FileMotion:
    """Convert one sequence to metres, on a floor, with nan in frames that it lacks.

    Raises InputError at `place` as `convert_to_metres`.
    """
    name, records, frames = sequence
    angles = _angles_on(floor, records)
    angle_sd = records.extras.get(ANGLE_SD, np.empty((len(records), 0)))
    names = angle_names(records.landmark_names)
    if options.markers == "input" and isinstance(records, Fit):
        records = _with_detector_landmarks(records)
    metric = convert_to_metres(records, options, place, floor)
    first = int(frames[0]) if len(frames) else 0
    length = int(frames[-1]) - first + 1 if len(frames) else 0
    points = _spread_over_frames(metric.points, frames, length)
    warnings = list(metric.warnings)
    gaps = length - int(np.isfinite(points).any(axis=(1, 2)).sum())
    if gaps:
        of_sequence = f" of {name}" if name else ""
        warnings.append(f"{counted(gaps, 'frame')} without a shape{of_sequence}")
    known_rate = records.frame_rate or find_rate(frames, records.times)
    if not known_rate:
        warnings.append(NO_RATE)
    rate = known_rate or UNKNOWN_RATE
    stated = records.lines
    edges = edges_of(records.landmark_names) if stated is None else stated
    distance_sd = metric.factor[:, None] * _distance_sd(records)
    return FileMotion(
        name=name,
        landmark_names=records.landmark_names,
        points=points,
        first=first,
        rate=rate,
        times=find_times(frames, length, records.times, rate),
        edges=np.asarray(edges, np.int64).reshape(-1, 2),
        axes=metric.axes,
        size=metric.size,
        warnings=tuple(warnings),
        trusted=_trusted_frames(records, frames, length),
        deviations=_spread_over_frames(distance_sd, frames, length),
        angle_names=names,
        angles=_spread_over_frames(angles, frames, length),
        angle_deviations=_spread_over_frames(angle_sd, frames, length),
    )


def _angles_on(floor: Floor | None, records: Shapes3D) -> Array:
    """Return joint angles (n, a) in degrees; (n, 0) where they are not known.

    On a floor, trunk and head are measured from its vertical.
    """
    angles = records.extras.get(ANGLES)
    if angles is None:
        return np.empty((len(records), 0))
    if floor is None:
        return angles
    up = floor.up * np.array([1.0, -1.0, -1.0]) * image_axis_signs(records)
    joints = joint_columns(records.landmark_names)
    values, _ = measure_angles(records.as_columns(), up, joints)
    return values


def _spread_over_frames(values: Array, frames: Integers, length: int) -> Floats:
    """Return values (n, ...) of frames (n,) as (length, ...), nan at missing frames."""
    per_frame = np.full((length, *values.shape[1:]), np.nan)
    per_frame[_from_first(frames)] = values
    return per_frame


def _from_first(frames: Integers) -> Integers:
    """Return sorted frames (n,) minus the first of them."""
    return frames - frames[:1]


def _trusted_frames(records: Shapes3D, frames: Integers, length: int) -> list[str]:
    """Return "true" or "false" for each of `length` frames, trusted or not, or "".

    It is "" for frames without an item, and in results without reasons.
    """
    trusted = np.full(length, "", dtype=object)
    if isinstance(records, Fit) and records.reasons is not None:
        trusted[_from_first(frames)] = np.where(records.reasons == "", "true", "false")
    return trusted.tolist()


def _distance_sd(records: Shapes3D) -> Floats:
    """Return sqrt(sd_x^2 + sd_y^2 + sd_z^2) (n, p) in the shapes' unit, or NaN."""
    if not isinstance(records, Fit) or records.shape_sd is None:
        return np.full(records.shapes.shape[:2], np.nan)
    sd = in_columns(records.shape_sd)
    distance: Floats = np.sqrt((sd**2).sum(axis=1))
    return distance


def find_times(
    frames: Integers, length: int, stated: Floats | None, rate: float
) -> Floats:
    """Return the times (length,) in seconds of all frames from the first on.

    They are frame / rate, unless one of the stated times (n,) of frames (n,) is off by
    more than JITTER: then as stated, and between these as the rate goes on.
    """
    if not length:
        return np.empty(0)
    every = frames[0] + np.arange(length)
    times: Floats = every / rate
    if stated is None:
        return times
    known = np.isfinite(stated)
    off = stated[known] - frames[known] / rate
    if not known.any() or np.abs(off).max() * rate <= JITTER:
        return times
    stated_times: Floats = times + np.interp(every, frames[known], off)
    return stated_times


def _with_detector_landmarks(records: Fit) -> Fit:
    """Return results with the detector's landmarks in place of the joints.

    They have the names of OpenSim's models.
    """
    names = tuple(records.input_landmark_names or ())
    assert records.input_shapes is not None, "the writer refuses results without"
    return replace(
        records,
        landmark_names=model_names(names),
        shapes=records.input_shapes,
        shape_sd=records.input_shape_sd,
        edges=np.array(edges_of(names), np.int64).reshape(-1, 2),
        landmarks=None,
        input_landmark_names=None,
        input_shapes=None,
        input_shape_sd=None,
    )

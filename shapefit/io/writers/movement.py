"""Joints in metres as movement has poses: netCDF, which is HDF5 with named axes.

One file holds all sequences, each as an individual.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import h5py
import numpy as np

from shapefit.arrays import Floats
from shapefit.errors import input_error
from shapefit.io.atomic import atomic_path, check_output
from shapefit.io.options import OutputOptions, Summary
from shapefit.io.readers.poses import number_repeats
from shapefit.io.writers.motion import (
    FileMotion,
    MotionWriter,
    find_motions,
    warnings_of,
)

MOVEMENT_AXES = ("time", "space", "keypoints", "individuals")
"""Axes of positions.

Every version of movement reads these names; from 0.17 on it renames the last two to
`keypoint` and `individual` where it loads a file.
"""

TRUST = {"true": 1.0, "false": 0.0}
"""Confidence of a frame by whether it is trusted; NaN where that is not known."""


AXES_WITHOUT_SPACE = ("time", "keypoints", "individuals")
"""Axes of what a keypoint has one number of."""


class MovementPoses(NamedTuple):
    """The arrays of movement's file, of f frames, p keypoints and i individuals.

    position (f, 3, p, i) in metres, shape_sd (f, p, i) the standard deviation of the
    distance to it, confidence (f, p, i), each NaN where it is unknown.
    """

    position: Floats
    confidence: Floats
    shape_sd: Floats


@contextmanager
def movement_output(target: Path, options: OutputOptions) -> Iterator[MotionWriter]:
    """Yield a writer; on a clean exit write all its records to one netCDF file.

    Raises InputError where it cannot be written; an earlier one then stays.
    """
    check_output(target)
    writer = MotionWriter(options, angles=False)
    yield writer
    motions = find_motions(writer.take_all(), options, str(target))
    check_one_rate(motions, target)
    with atomic_path(target) as temporary:
        write_movement(temporary, motions)
    placed = [f"in m by {motion.size}, {motion.axes}" for motion in motions]
    notes = [*placed, *(motion.timing_note for motion in motions)]
    writer.summary = Summary(
        note="; ".join(dict.fromkeys(filter(None, notes))),
        warnings=warnings_of(motions),
        written=(target,),
    )


def check_one_rate(motions: Sequence[FileMotion], target: Path) -> None:
    """Raise InputError where sequences differ in frame rate, as a file has one rate."""
    rates = sorted({motion.rate for motion in motions})
    if len(rates) > 1:
        found = " and ".join(f"{rate:g}" for rate in rates)
        fix = "convert one sequence at a time (`individual`), or set `frame_rate`"
        raise input_error(target, f"sequences have {found} frames per second", fix)


def write_movement(path: Path, motions: Sequence[FileMotion]) -> None:
    """Write motions as netCDF of movement: positions, confidence and named axes."""
    first = min((motion.first for motion in motions), default=0)
    last = max((motion.first + len(motion.points) for motion in motions), default=0)
    frames = np.arange(first, last)
    motion = motions[0]
    poses = gather_poses(motions, first, len(frames))
    names = [one.name.replace("/", "_") or "individual_0" for one in motions]
    labels = (
        frames / motion.rate,
        ("x", "y", "z"),
        motion.landmark_names,
        number_repeats(names),
    )
    # HDF5 that meets a full disk cannot be closed, and crashes: the file is made first.
    in_memory = {"driver": "core", "backing_store": False}
    with h5py.File(path, "w", track_order=True, **in_memory) as file:
        file.attrs["ds_type"] = "poses"
        file.attrs["source_software"] = "shapefit"
        file.attrs["time_unit"] = "seconds" if motion.is_rate_known else "frames"
        if motion.is_rate_known:
            file.attrs["fps"] = motion.rate
        file.attrs["axes"] = "; ".join(dict.fromkeys(one.axes for one in motions))
        for axis, values in zip(MOVEMENT_AXES, labels, strict=True):
            kind = np.float64 if axis == "time" else h5py.string_dtype()
            scale = file.create_dataset(axis, data=np.asarray(values, kind))
            scale.make_scale(axis)
        for name, array in poses._asdict().items():
            dataset = file.create_dataset(
                name, data=array, compression="gzip", shuffle=True
            )
            axes = MOVEMENT_AXES if name == "position" else AXES_WITHOUT_SPACE
            for number, axis in enumerate(axes):
                dataset.dims[number].attach_scale(file[axis])
            if name != "confidence":
                dataset.attrs["units"] = "m"
        file.flush()
        content = file.id.get_file_image()
    path.write_bytes(content)


def gather_poses(motions: Sequence[FileMotion], first: int, f: int) -> MovementPoses:
    """Stack motions, an individual each, over the frames `first` to `first + f - 1`."""
    p = len(motions[0].landmark_names)
    poses = MovementPoses(
        np.full((f, 3, p, len(motions)), np.nan),
        np.full((f, p, len(motions)), np.nan),
        np.full((f, p, len(motions)), np.nan),
    )
    for number, motion in enumerate(motions):
        rows = slice(motion.first - first, motion.first - first + len(motion.points))
        poses.position[rows, ..., number] = motion.points
        trust = [TRUST.get(answer, np.nan) for answer in motion.trusted]
        poses.confidence[rows, :, number] = np.array(trust)[:, None]
        poses.shape_sd[rows, :, number] = motion.deviations
    return poses

"""JABS pose files: one mouse (version 2), or several, each with the track or identity it has.

`poseest/points` is (frame, [instance,] point, [y, x]): y comes first. A confidence of 0 is a point
that was not found. Version 3 counts the instances of a frame and gives them tracks; from version 4
on they have identities, from 1, and 0 where there is none.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from re import sub

import numpy as np

from shapefit.arrays import Integers
from shapefit.io.foreign.recording import Instances, Recording, video_name
from shapefit.io.trackers.reading import TrackerFile

POINTS, CONFIDENCE = "poseest/points", "poseest/confidence"
COUNT, TRACK, IDENTITY = (
    "poseest/instance_count",
    "poseest/instance_track_id",
    "poseest/instance_embed_id",
)

MOUSE = (
    "NOSE LEFT_EAR RIGHT_EAR BASE_NECK LEFT_FRONT_PAW RIGHT_FRONT_PAW CENTER_SPINE "
    "LEFT_REAR_PAW RIGHT_REAR_PAW BASE_TAIL MID_TAIL TIP_TAIL"
)
"""The landmarks of the format, which its files do not name."""

LINES = ((0, 1), (0, 2), (0, 3), (3, 6), (6, 9), (9, 10), (10, 11), (6, 4), (6, 5), (9, 7), (9, 8))


@dataclass(frozen=True)
class _Who:
    """Identities (frame, instance) that are in the file; and those that are nobody."""

    ids: Integers
    absent: np.ndarray
    known: Integers


def record(paths: tuple[Path, ...]) -> Recording:
    """Open a file; its points are read when its blocks are."""
    path = paths[0]
    names = tuple(MOUSE.split())
    with TrackerFile(path) as file:
        shape = file.shape(POINTS)
        if len(shape) not in (3, 4) or shape[-1] != 2:
            found = f"has the shape {shape}"
            raise file.fault(POINTS, found, "its axes are (frame, [mouse,] point, 2)")
        if file.is_dataset(CONFIDENCE):
            file.check_shape(CONFIDENCE, shape[:-1])
        who = None if len(shape) == 3 else _identities(file, shape[0], shape[1])
    named = shape[-2] == len(names)
    return Recording(
        name=str(path),
        video=sub(r"_pose_est(_v\d+)?$", "", video_name(path)),
        dimensions=2,
        landmark_count=shape[-2],
        landmark_names=names if named else None,
        blocks=lambda: _read(path, who),
        individuals=() if who is None else tuple(map(str, who.known.tolist())),
        frames=shape[0],
        unit="px",
        edges=LINES if named else (),
    )


def _identities(file: TrackerFile, frames: int, many: int) -> _Who:
    """Return who is where in a file of several mice."""
    stated = file.attribute("version", "poseest")
    version = stated[0] if isinstance(stated, list) and stated else stated
    by_identity = version > 3 if isinstance(version, int) else file.is_dataset(IDENTITY)
    name = IDENTITY if by_identity else TRACK
    file.check_shape(name, (frames, many))
    ids = file.numbers(name).astype(np.int64)
    if by_identity:
        absent = ids <= 0
    else:
        file.check_shape(COUNT, (frames,))
        absent = np.arange(many) >= file.numbers(COUNT)[:, None]
    return _Who(ids, absent, np.unique(ids[~absent]))


def _read(path: Path, who: _Who | None) -> Iterator[Instances]:
    """Read the points, some thousand frames at a time."""
    with TrackerFile(path) as file:
        for rows in file.ranges(POINTS, 0):
            points = file.numbers(POINTS, rows)[..., ::-1]
            n = len(points)
            many, p = (1 if points.ndim == 3 else points.shape[1]), points.shape[-2]
            confidence = np.ones((n * many, p))
            if file.is_dataset(CONFIDENCE):
                confidence = file.numbers(CONFIDENCE, rows).reshape(n * many, p)
            seen = confidence > 0
            kept = np.ones(n * many, bool)
            individuals = np.zeros(n * many, np.int64)
            if who is not None:
                ids, kept = who.ids[rows].ravel(), ~who.absent[rows].ravel()
                individuals = np.searchsorted(who.known, ids)
            frames = np.repeat(np.arange(rows.start, rows.start + n), many)[kept]
            yield Instances(
                points=np.where(seen[..., None], points.reshape(n * many, p, 2), np.nan)[kept],
                confidence=confidence[kept],
                frames=frames,
                labels=list(map(str, frames.tolist())),
                individuals=individuals[kept],
                counts=_lost(seen.any(axis=1) & ~kept),
            )


def _lost(found: np.ndarray) -> dict[str, int]:
    count = int(found.sum())
    return {"instances without an identity left out": count} if count else {}

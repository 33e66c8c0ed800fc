"""Records on their way to files that hold one sequence each, in the order of time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shapefit.arrays import Integers
from shapefit.errors import abbreviate, input_error
from shapefit.io.foreign.sources import FRAME
from shapefit.io.layout import EDGES, METRES_PER_UNIT
from shapefit.io.records import ResultSet, ShapeSet, concatenate
from shapefit.io.skeletons import edges_of
from shapefit.lifting.verdict import DOUBT, PLAUSIBILITY

Solid = ShapeSet | ResultSet

CAMERA_TRANSLATION = "camera_translation"
EXTRINSIC_ROTATION, EXTRINSIC_TRANSLATION = "extrinsic_rotation", "extrinsic_translation"
"""Datasets of the file or of each image: X_camera = R X_world + t, in metres; z away from it."""

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


def points_of(record: Solid, meshes: bool = False) -> Solid:
    """Return a record with nothing but what files of points, or of meshes too, are made of."""
    kept = {name: values for name, values in record.further.items() if name in KEPT}
    if isinstance(record, ShapeSet):
        return record.replaced(mesh_vertices=None, mesh_faces=None, further=kept)
    return ResultSet(
        shapes=record.shapes,
        coefficients=record.coefficients if meshes else None,
        rotation=record.rotation if meshes else None,
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

"""The joint angles of bodies whose motion is written, upright as their camera is."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from shapefit.arrays import Floats
from shapefit.geometry.cameras import IMAGE_UP, TO_Y_UP, Up, nearest_axis_up
from shapefit.geometry.joint_angles import known_angles, measure_angles
from shapefit.io.records import Names, ResultSet, ShapeSet
from shapefit.io.skeletons import joint_columns
from shapefit.io.writers.metres import EXTRINSIC_ROTATION
from shapefit.lifting.estimate import CORRELATION

COVARIANCE = "shape_covariance"
ANGLES, ANGLE_SD = "joint_angles", "joint_angle_sd"
"""Columns (n, a) of records on their way to a file of motion, in degrees."""


def angle_names(names: Sequence[str]) -> Names:
    """Return the names of the joint angles that landmarks determine; none unless it is a body."""
    return tuple(angle.name for angle in known_angles(joint_columns(names)))


def angle_columns(record: ShapeSet | ResultSet, up: Up | None) -> dict[str, Floats]:
    """Return the joint angles of records and their deviations (n, a), {} if there are none.

    Results are upright as their camera is, or by the axis `up` of its world; shapes by their axis
    `up`, y by default. Deviations take into account how the errors of landmarks go together where
    the record has `shape_covariance`; without, they are two to three times as large.
    """
    joints = joint_columns(record.landmark_names)
    if not known_angles(joints):
        return {}
    if isinstance(record, ShapeSet):
        upward: Floats = TO_Y_UP[up or "y"][1]
        values, sd = measure_angles(record.shapes, upward, joints)
    else:
        values, sd = measure_angles(record.shapes, _upward(record, up), joints, _covariance(record))
    return {ANGLES: values, ANGLE_SD: sd}


def _upward(record: ResultSet, up: Up | None) -> Floats:
    """Return the direction that is up in the frame of the shapes, (3,) or (n, 3)."""
    rotation = record.columns.get(EXTRINSIC_ROTATION)
    upward: Floats = TO_Y_UP[IMAGE_UP][1]
    if rotation is not None:
        upward = rotation @ TO_Y_UP[up or nearest_axis_up(rotation)][1]
    return upward * (np.array([1.0, -1.0, -1.0]) if record.y_axis == "up" else 1.0)


def _covariance(record: ResultSet) -> Floats | None:
    """Return the covariance of the landmarks together, or else that of each (n, p, 3, 3)."""
    whole = record.columns.get(COVARIANCE)
    if whole is not None or record.shape_sd is None:
        return whole
    sd = record.shape_sd.swapaxes(1, 2)
    covariance = np.eye(3) * sd[..., None] ** 2
    correlation = record.columns.get(CORRELATION)
    if correlation is not None:
        for number, (i, j) in enumerate(((0, 1), (0, 2), (1, 2))):
            product = correlation[..., number] * sd[..., i] * sd[..., j]
            covariance[..., i, j] = covariance[..., j, i] = product
    return covariance

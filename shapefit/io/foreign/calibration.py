"""Calibrations of cameras in TOML, as anipose, Pose2Sim, caliscope and FreeMoCap write them."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from shapefit.arrays import Floats
from shapefit.errors import input_error, listed
from shapefit.geometry.pinhole import COEFFICIENTS, complete
from shapefit.geometry.rotations import rotation_about
from shapefit.io.inputs import require_file

MATRIX, DISTORTION = ("matrix", "camera_matrix"), ("distortions", "distortion")

OF_TOOLS = "give the calibration of anipose, Pose2Sim or caliscope"
UNDISTORT = "remove the distortion of the landmarks first"


@dataclass(frozen=True, kw_only=True)
class CalibratedCamera:
    """A camera of a calibration.

    matrix (3, 3) and size (2,), width and height, in pixels; distortion (8,) as `geometry.pinhole`
    has it; rotation (3, 3) and translation (3,) from the world to the camera, in the unit of the
    file.
    """

    section: str
    names: tuple[str, ...]
    matrix: Floats
    distortion: Floats
    size: Floats | None
    rotation: Floats | None
    translation: Floats | None


def read_camera(path: Path, name: str | None) -> CalibratedCamera:
    """Return the camera of this name: its section, its `name` or its `port`; or the only one.

    Raises InputError for a file that is no calibration, a name that it does not have, with those
    that it has, and for cameras that cannot be.
    """
    require_file(path)
    try:
        content = tomllib.loads(path.read_bytes().decode())
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise input_error(path, f"is no TOML ({error})", OF_TOOLS) from error
    cameras = list(_sections(content))
    if not cameras:
        raise input_error(path, "has no section with the `matrix` of a camera", OF_TOOLS)
    there = []
    for section, table in cameras:
        others = [other for other in _names(table) if other != section]
        there.append(f"{section} ({', '.join(others)})" if others else section)
    if name is None and len(cameras) == 1:
        return _camera(path, *cameras[0])
    if name is None:
        fix = f"set `camera.name`: {listed(there, 'and')}"
        raise input_error(path, f"has {len(cameras)} cameras", fix)
    for key in ("", "name", "port"):
        found = [each for each in cameras if (str(each[1].get(key)) if key else each[0]) == name]
        if len(found) == 1:
            return _camera(path, *found[0])
    raise input_error(path, f"has no camera {name!r}", f"there are {listed(there, 'and')}")


def _sections(content: Mapping[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield the sections that have a camera matrix, with their names."""
    for name, value in content.items():
        if isinstance(value, dict) and any(key in value for key in MATRIX):
            yield name, value
        elif isinstance(value, dict):
            yield from _sections(value)


def _names(table: Mapping[str, Any]) -> tuple[str, ...]:
    return tuple(str(table[key]) for key in ("name", "port") if key in table)


def _camera(path: Path, section: str, table: Mapping[str, Any]) -> CalibratedCamera:
    place = f"{path}: {section}"
    if table.get("fisheye") is True:
        raise input_error(place, "is a fisheye lens, whose model is another one", UNDISTORT)
    matrix = _array(table, MATRIX, (3, 3), place)
    assert matrix is not None
    rest = matrix - np.diag(np.diag(matrix))
    rest[:2, 2] = 0.0
    proper = matrix[0, 0] > 0 and matrix[1, 1] > 0 and np.allclose(matrix[2], [0, 0, 1])
    if not proper or np.abs(rest).max() > 1e-6 * np.abs(matrix).max():
        rows = ", ".join(" ".join(f"{x:g}" for x in row) for row in matrix)
        fix = "give a matrix with rows fx 0 cx, 0 fy cy, 0 0 1 (no skew)"
        raise input_error(place, f"an impossible camera matrix, {rows}", fix)
    return CalibratedCamera(
        section=section,
        names=_names(table),
        matrix=matrix,
        distortion=_distortion(_array(table, DISTORTION, None, place), place),
        size=_array(table, ("size",), (2,), place),
        rotation=_rotation(_array(table, ("rotation",), None, place), place),
        translation=_array(table, ("translation",), (3,), place),
    )


def _distortion(given: Floats | None, place: str) -> Floats:
    if given is None:
        return np.zeros(COEFFICIENTS)
    given = given.ravel()
    if given[COEFFICIENTS:].any():
        found = f"has {len(given)} coefficients of distortion, of a thin prism or a tilted sensor"
        raise input_error(place, found, UNDISTORT)
    given = given[:COEFFICIENTS]
    if len(given) < 4:  # k1, or k1 k2, or k1 k2 p1
        given = np.concatenate([given, np.zeros(4 - len(given))])
    try:
        return complete(given)
    except ValueError as error:
        fix = "give 4, 5 or 8 of OpenCV's, k1 k2 p1 p2 k3 k4 k5 k6"
        raise input_error(place, f"has {error}", fix) from error


def _rotation(given: Floats | None, place: str) -> Floats | None:
    """Return a rotation (3, 3) given as a matrix or as a vector, its axis times its angle."""
    if given is None:
        return None
    if given.size == 3:
        angle = float(np.linalg.norm(given))
        return rotation_about(given.ravel(), np.array([angle]))[0] if angle > 0 else np.eye(3)
    if given.shape != (3, 3) or np.linalg.norm(given @ given.T - np.eye(3)) > 1e-3:
        found = f"the rotation is none (shape {given.shape})"
        raise input_error(place, found, "give a vector of 3 or a 3x3 rotation matrix")
    if np.linalg.det(given) < 0:
        raise input_error(place, "the rotation is a reflection", "give one with determinant 1")
    return given


def _array(
    table: Mapping[str, Any], keys: tuple[str, ...], shape: tuple[int, ...] | None, place: str
) -> Floats | None:
    """Return the numbers under the first of these keys that is there; None for none."""
    key = next((key for key in keys if key in table), None)
    if key is None:
        return None
    try:
        values = np.array(table[key], dtype=np.float64)
    except (ValueError, TypeError):
        values = np.array(np.nan)
    if not values.size:
        return None
    if not np.isfinite(values).all() or (shape is not None and values.shape != shape):
        wanted = f"{' x '.join(map(str, shape))} numbers" if shape else "numbers"
        raise input_error(place, f"{key} is {str(table[key])[:60]}", f"give {wanted}")
    return values

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
        with path.open("rb") as file:
            content = tomllib.load(file)
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        fix = "give the calibration of anipose, Pose2Sim or caliscope"
        raise input_error(path, f"is no TOML ({error})", fix) from error
    cameras = list(_cameras(content))
    if not cameras:
        fix = "give the calibration of anipose, Pose2Sim or caliscope"
        raise input_error(path, "has no section with the `matrix` of a camera", fix)
    there = listed([_described(section, table) for section, table in cameras], "and")
    if name is None:
        if len(cameras) > 1:
            raise input_error(path, f"has {len(cameras)} cameras", f"set `camera.name`: {there}")
        return _camera(path, *cameras[0])
    for found in (
        [camera for camera in cameras if camera[0] == name],
        [camera for camera in cameras if str(camera[1].get("name")) == name],
        [camera for camera in cameras if str(camera[1].get("port")) == name],
    ):
        if len(found) == 1:
            return _camera(path, *found[0])
    raise input_error(path, f"has no camera {name!r}", f"there are {there}")


def _cameras(content: Mapping[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield the sections that have a camera matrix, with their names."""
    for name, value in content.items():
        if not isinstance(value, dict):
            continue
        if any(key in value for key in MATRIX):
            yield name, value
        else:
            yield from _cameras(value)


def _described(section: str, table: Mapping[str, Any]) -> str:
    others = [str(table[key]) for key in ("name", "port") if key in table]
    others = [other for other in others if other != section]
    return f"{section} ({', '.join(others)})" if others else section


def _camera(path: Path, section: str, table: Mapping[str, Any]) -> CalibratedCamera:
    place = f"{path}: {section}"
    if table.get("fisheye") is True:
        found = "is a fisheye lens, whose model is another one"
        raise input_error(place, found, "remove the distortion of the landmarks first")
    matrix = _array(table, MATRIX, (3, 3), place)
    assert matrix is not None
    _check_matrix(matrix, place)
    rotation = _array(table, ("rotation",), None, place)
    if rotation is not None:
        rotation = _rotation(rotation, place)
    return CalibratedCamera(
        section=section,
        names=tuple(str(table[key]) for key in ("name", "port") if key in table),
        matrix=matrix,
        distortion=_distortion(table, place),
        size=_array(table, ("size",), (2,), place),
        rotation=rotation,
        translation=_array(table, ("translation",), (3,), place),
    )


def _distortion(table: Mapping[str, Any], place: str) -> Floats:
    given = _array(table, DISTORTION, None, place)
    if given is None:
        return np.zeros(COEFFICIENTS)
    given = given.ravel()
    if given[COEFFICIENTS:].any():
        found = f"has {len(given)} coefficients of distortion, of a thin prism or a tilted sensor"
        raise input_error(place, found, "remove the distortion of the landmarks first")
    if len(given) > COEFFICIENTS:
        given = given[:COEFFICIENTS]
    if len(given) in (1, 2, 3):  # k1, or k1 k2, or k1 k2 p1
        given = np.concatenate([given, np.zeros(4 - len(given))])
    try:
        return complete(given)
    except ValueError as error:
        fix = "give 4, 5 or 8 of OpenCV's, k1 k2 p1 p2 k3 k4 k5 k6"
        raise input_error(place, f"has {error}", fix) from error


def _check_matrix(matrix: Floats, place: str) -> None:
    """Raise InputError for a matrix that no camera without skew has."""
    rest = matrix - np.diag(np.diag(matrix))
    rest[:2, 2] = 0.0
    proper = matrix[0, 0] > 0 and matrix[1, 1] > 0 and np.allclose(matrix[2], [0, 0, 1])
    if not proper or np.abs(rest).max() > 1e-6 * np.abs(matrix).max():
        rows = ", ".join(" ".join(f"{x:g}" for x in row) for row in matrix)
        fix = "give a matrix with rows fx 0 cx, 0 fy cy, 0 0 1 (no skew)"
        raise input_error(place, f"an impossible camera matrix, {rows}", fix)


def _rotation(given: Floats, place: str) -> Floats:
    """Return a rotation (3, 3) given as a matrix or as a vector, its axis times its angle."""
    if given.size == 3:
        vector = given.ravel()
        angle = float(np.linalg.norm(vector))
        return rotation_about(vector, np.array([angle]))[0] if angle > 0 else np.eye(3)
    if given.shape != (3, 3) or np.linalg.norm(given @ given.T - np.eye(3)) > 1e-3:
        found = f"the rotation is none (shape {given.shape})"
        raise input_error(place, found, "give a vector of 3 or a 3x3 rotation matrix")
    if np.linalg.det(given) < 0:
        raise input_error(place, "the rotation is a reflection", "give one with determinant 1")
    return given


def _array(
    table: Mapping[str, Any], keys: tuple[str, ...], shape: tuple[int, ...] | None, place: str
) -> Floats | None:
    """Return the numbers under the first of these keys that is there."""
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

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
from shapefit.io.readers.poses import parsing, require

MATRIX, DISTORTION = ("matrix", "camera_matrix"), ("distortions", "distortion")

OF_TOOLS = "give the calibration of anipose, Pose2Sim or caliscope"
UNDISTORT = "remove the distortion of the landmarks first"
CORRECT = (
    "give a matrix without skew, 4, 5 or 8 of OpenCV's k1 k2 p1 p2 k3 k4 k5 k6, and the rotation "
    "as a vector or a matrix; of other lenses remove the distortion of the landmarks first"
)


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
    with parsing(path, OF_TOOLS):
        cameras = list(_sections(tomllib.loads(path.read_bytes().decode())))
        require(cameras, "has no section with the `matrix` of a camera")
    there = []
    for section, table in cameras:
        others = [other for other in _names(table) if other != section]
        there.append(f"{section} ({', '.join(others)})" if others else section)
    found = cameras
    for key in ("", "name", "port") if name is not None else ():
        found = [each for each in cameras if (str(each[1].get(key)) if key else each[0]) == name]
        if len(found) == 1:
            break
    if len(found) != 1:
        what = f"has {len(cameras)} cameras" if name is None else f"has no camera {name!r}"
        raise input_error(path, what, f"set `camera.name`: there are {listed(there, 'and')}")
    section, table = found[0]
    with parsing(f"{path}: {section}", UNDISTORT if table.get("fisheye") is True else CORRECT):
        return _camera(section, table)


def _sections(content: Mapping[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield the sections that have a camera matrix, with their names."""
    for name, value in content.items():
        if isinstance(value, dict) and any(key in value for key in MATRIX):
            yield name, value
        elif isinstance(value, dict):
            yield from _sections(value)


def _names(table: Mapping[str, Any]) -> tuple[str, ...]:
    return tuple(str(table[key]) for key in ("name", "port") if key in table)


def _camera(section: str, table: Mapping[str, Any]) -> CalibratedCamera:
    require(table.get("fisheye") is not True, "is a fisheye lens, whose model is another one")
    matrix = _array(table, MATRIX, (3, 3))
    require(matrix is not None, "has no camera matrix")
    assert matrix is not None
    rest = matrix - np.diag(np.diag(matrix))
    rest[:2, 2] = 0.0
    proper = matrix[0, 0] > 0 and matrix[1, 1] > 0 and np.allclose(matrix[2], [0, 0, 1])
    rows = ", ".join(" ".join(f"{x:g}" for x in row) for row in matrix)
    unskewed = proper and np.abs(rest).max() <= 1e-6 * np.abs(matrix).max()
    require(unskewed, f"an impossible camera matrix, {rows}, not fx 0 cx, 0 fy cy, 0 0 1")
    return CalibratedCamera(
        section=section,
        names=_names(table),
        matrix=matrix,
        distortion=_distortion(_array(table, DISTORTION)),
        size=_array(table, ("size",), (2,)),
        rotation=_rotation(_array(table, ("rotation",))),
        translation=_array(table, ("translation",), (3,)),
    )


def _distortion(given: Floats | None) -> Floats:
    given = np.zeros(COEFFICIENTS) if given is None else given.ravel()
    beyond = f"has {len(given)} coefficients of distortion, of a thin prism or a tilted sensor"
    require(not given[COEFFICIENTS:].any(), beyond)
    given = given[:COEFFICIENTS]
    if len(given) < 4:  # k1, or k1 k2, or k1 k2 p1
        given = np.concatenate([given, np.zeros(4 - len(given))])
    return complete(given)


def _rotation(given: Floats | None) -> Floats | None:
    """Return a rotation (3, 3) given as a matrix or as a vector, its axis times its angle."""
    if given is None:
        return None
    if given.size == 3:
        angle = float(np.linalg.norm(given))
        return rotation_about(given.ravel(), np.array([angle]))[0] if angle > 0 else np.eye(3)
    square = given.shape == (3, 3) and np.linalg.norm(given @ given.T - np.eye(3)) <= 1e-3
    require(square, f"the rotation is none (shape {given.shape})")
    require(np.linalg.det(given) > 0, "the rotation is a reflection")
    return given


def _array(
    table: Mapping[str, Any], keys: tuple[str, ...], shape: tuple[int, ...] | None = None
) -> Floats | None:
    """Return the numbers under the first of these keys that is there; None for none."""
    key = next((key for key in keys if key in table), None)
    if key is None or table[key] in ([], ""):
        return None
    wanted = f"{' x '.join(map(str, shape))} numbers" if shape else "numbers"
    found = f"{key} is {str(table[key])[:60]}, not {wanted}"
    try:
        values = np.array(table[key], dtype=np.float64)
    except (ValueError, TypeError):
        values = np.array(np.nan)
    require(np.isfinite(values).all() and shape in (None, values.shape), found)
    return values

"""Calibrations of cameras, in TOML, YAML or JSON.

TOML is what anipose, Pose2Sim, caliscope and FreeMoCap write, the others are OpenCV's
and ROS's.
"""

from __future__ import annotations

import math
import re
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from shapefit.arrays import Floats
from shapefit.errors import input_error, listed
from shapefit.geometry.pinhole import COEFFICIENTS, complete_coefficients
from shapefit.geometry.rotations import rotation_about
from shapefit.io.inputs import require_file
from shapefit.io.readers.poses import as_numbers, library_reads, parsing, require
from shapefit.io.readers.text import read_json

CALIBRATION_KEYS = {
    "matrix": "matrix camera_matrix cameramatrix intrinsic_matrix mtx k",
    "distortion": (
        "distortions distortion distortion_coefficients distcoeffs dist_coeffs dist "
        "distcoef d"
    ),
    "size": "size image_size resolution",
    "rotation": "rotation rvec r",
    "translation": "translation tvec t",
}
"""A field of `CalibratedCamera` -> what tools call it, in small letters."""

OF_TOOLS = (
    "give the calibration of anipose, Pose2Sim, caliscope or OpenCV (TOML, YAML, JSON)"
)
CORRECT = (
    "give a matrix without skew, 4, 5 or 8 of OpenCV's k1 k2 p1 p2 k3 k4 k5 k6, and the"
    " rotation as a vector or a matrix; of other lenses remove the distortion of the"
    " landmarks first"
)


@dataclass(frozen=True, kw_only=True, eq=False)
class CalibratedCamera:
    """A pinhole camera: matrix (3, 3) and size (2,) in pixels, distortion (8,).

    The distortion is as `geometry.pinhole` has it. rotation (3, 3) and translation (3,)
    lead from the world to the camera, in the file's unit.
    """

    matrix: Floats
    distortion: Floats
    size: Floats | None
    rotation: Floats | None
    translation: Floats | None


def read_camera(path: Path, name: str | None) -> CalibratedCamera:
    """Read the camera called `name` in a calibration file; without a name the only one.

    A name is that of the section, its `name` or its `port`. Raises InputError for a
    file that is no calibration, for a name that it does not have, and without a name
    for several cameras.
    """
    require_file(path)
    with parsing(path, "a calibration", OF_TOOLS):
        cameras = [*_camera_sections(path.stem, _read_content(path))]
        require(cameras, "no section with the `matrix` of a camera")
    names = [
        [section, *(str(table[key]) for key in ("name", "port") if key in table)]
        for section, table in cameras
    ]
    chosen = [
        number for number, some in enumerate(names) if name is None or name in some
    ]
    if len(chosen) != 1:
        problem = (
            f"has {len(cameras)} cameras" if name is None else f"has no camera {name!r}"
        )
        labels = listed((" or ".join(dict.fromkeys(some)) for some in names), "and")
        raise input_error(path, problem, f"set `camera.name`: there are {labels}")
    section, table = cameras[chosen[0]]
    with parsing(f"{path}: {section}", "a camera", CORRECT):
        return _parse_camera(table)


def _read_content(path: Path) -> object:
    """Parse a file of JSON, YAML or else TOML into mappings and lists.

    Its name tells which it is. Raises FormatError for what is none.
    """
    if path.suffix.lower() == ".json":
        return read_json(path)
    if path.suffix.lower() not in (".yaml", ".yml"):
        with library_reads("it is no TOML"):
            return tomllib.loads(path.read_bytes().decode())
    from ruamel.yaml import YAML

    with library_reads("it is no UTF-8"):
        text = path.read_text("utf-8")
    # OpenCV writes a directive and tags that YAML does not have
    text = re.sub(r"\A%YAML.*|!!opencv-[\w-]+", "", text)
    # ruamel.yaml takes minutes to read these two
    require(re.search(r"(?:[\[{]\s*){20}", text) is None, "lists nested too deeply")
    require(re.search(r"[:\[,-]\s*[&*]\w", text) is None, "an anchor or an alias")
    with library_reads("it is no YAML"):
        return YAML(typ="safe", pure=True).load(text)


def _camera_sections(
    name: str, value: object
) -> Iterator[tuple[str, dict[str, object]]]:
    """Yield name and mapping of each section with a camera matrix, at any depth.

    The name is its key, or its number in a list; `name` is that of `value` itself.
    """
    if isinstance(value, dict) and _find_field(value, "matrix") is not None:
        yield name, value
    elif isinstance(value, dict | list):
        for key, within in (
            value.items() if isinstance(value, dict) else enumerate(value)
        ):
            yield from _camera_sections(str(key), within)


def _find_field(table: Mapping[str, object], field: str) -> object:
    """Return the value of a field under any of its CALIBRATION_KEYS; None if absent."""
    small = {str(key).lower(): value for key, value in table.items()}
    values = (small.get(key) for key in CALIBRATION_KEYS[field].split())
    return next(
        (value for value in values if value is not None and value not in ([], "")), None
    )


def _parse_camera(table: Mapping[str, object]) -> CalibratedCamera:
    """Make a camera of a section's fields; FormatError for an impossible camera."""
    model = str(table.get("distortion_model", "")).lower()
    fisheye = table.get("fisheye") is True or model in ("fisheye", "equidistant")
    require(not fisheye, "a fisheye lens, whose model is another one")
    matrix = _parse_array(table, "matrix", (3, 3))
    assert matrix is not None
    proper = np.diag([matrix[0, 0], matrix[1, 1], 1.0])
    proper[:2, 2] = matrix[:2, 2]
    rows = ", ".join(" ".join(f"{x:g}" for x in row) for row in matrix)
    unskewed = np.abs(matrix - proper).max() <= 1e-6 * np.abs(matrix).max()
    require(
        unskewed and (proper.diagonal() > 0).all(),
        f"an impossible camera matrix, {rows}, not fx 0 cx, 0 fy cy, 0 0 1",
    )
    if {"image_width", "image_height"} <= table.keys():
        table = {"size": [table["image_width"], table["image_height"]], **table}
    given = _parse_array(table, "distortion")
    given = np.zeros(4) if given is None else given.ravel()
    beyond = (
        f"{len(given)} coefficients of distortion, of a thin prism or a tilted sensor"
    )
    require(not given[COEFFICIENTS:].any(), beyond)
    given = np.pad(given, (0, max(4 - len(given), 0)))  # k1, or k1 k2, or k1 k2 p1
    counted = len(given[:COEFFICIENTS]) in (4, 5, COEFFICIENTS)
    require(counted, f"{len(given)} coefficients of distortion, not 4, 5 or 8")
    return CalibratedCamera(
        matrix=matrix,
        distortion=complete_coefficients(given[:COEFFICIENTS]),
        size=_parse_array(table, "size", (2,)),
        rotation=_as_rotation_matrix(_parse_array(table, "rotation")),
        translation=_parse_array(table, "translation", (3,)),
    )


def _as_rotation_matrix(rotation: Floats | None) -> Floats | None:
    """Convert a rotation vector (axis times angle in radians) or matrix to (3, 3).

    None stays None. Raises FormatError for what is no rotation.
    """
    if rotation is None:
        return None
    if rotation.size == 3:
        angle = float(np.linalg.norm(rotation))
        return (
            rotation_about(rotation.ravel(), np.array([angle]))[0]
            if angle > 0
            else np.eye(3)
        )
    square = (
        rotation.shape == (3, 3)
        and np.linalg.norm(rotation @ rotation.T - np.eye(3)) <= 1e-3
    )
    require(
        square and np.linalg.det(rotation) > 0,
        f"a rotation that is none (shape {rotation.shape})",
    )
    return rotation


def _parse_array(
    table: Mapping[str, object], field: str, shape: tuple[int, ...] = ()
) -> Floats | None:
    """Return a field as an array of `shape`, of any for (); None if it is absent.

    OpenCV gives a matrix by its `data`. Raises FormatError for another shape.
    """
    given = _find_field(table, field)
    if given is None:
        return None
    numbers = given.get("data") if isinstance(given, dict) else given
    values = as_numbers(numbers, f"the numbers of {field}")
    if isinstance(given, dict):
        sizes: list[Any] = [given.get(key) for key in ("rows", "cols")]
        whole = all(isinstance(size, int) and size >= 0 for size in sizes)
        require(
            whole and math.prod(sizes) == values.size,
            f"{field} has {values.size} numbers, not {sizes[0]} rows of {sizes[1]}",
        )
        values = values.reshape(sizes)
    values = values.ravel() if len(shape) == 1 else values
    fits = np.isfinite(values).all() and shape in ((), values.shape)
    require(
        fits, f"{field} is {str(given)[:60]}, not {' x '.join(map(str, shape))} numbers"
    )
    return values

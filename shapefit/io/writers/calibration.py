"""The camera of a result as a calibration in TOML, as Pose2Sim and anipose write it.

Its world is that of the files in metres (TRC, C3D, BVH, tables, netCDF) of the same
result, so that their points, seen by it, lie on the landmarks. `fit --calibration`
reads it.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import numpy as np

from shapefit.arrays import Floats, finite_median
from shapefit.errors import counted, input_error, printable
from shapefit.geometry.cameras import IMAGE_UP, TO_Y_UP, nearest_axis_up
from shapefit.geometry.floor import Floor
from shapefit.geometry.pinhole import is_assumed_focal
from shapefit.io.atomic import atomic_path, check_output
from shapefit.io.options import OutputOptions, Summary
from shapefit.io.writers.metres import (
    EXTRINSIC_ROTATION,
    EXTRINSIC_TRANSLATION,
    Shapes3D,
)
from shapefit.io.writers.motion import MotionWriter, find_floors, video_of
from shapefit.records import Fit
from shapefit.records.items import Attribute

MAX_CHANGE = 1e-6
"""Of a number of a camera at rest between its images, as a share of the largest."""

WHOLE_LENS = 8
"""Coefficients of distortion that OpenCV's rational model has."""


class CameraPose(NamedTuple):
    """The pose of a camera: X_camera = rotation X_world + translation, in metres.

    rotation (3, 3), translation (3,); axes describes those of the world.
    """

    rotation: Floats
    translation: Floats
    axes: str


class WorldCamera(NamedTuple):
    """The camera of a video: size (2,), focal (2,) and centre (2,) in pixels,
    distortion (m,) as OpenCV has it, and its pose.
    """

    name: str
    size: Floats
    focal: Floats
    centre: Floats
    distortion: Floats
    pose: CameraPose


@contextmanager
def calibration_output(target: Path, options: OutputOptions) -> Iterator[MotionWriter]:
    """Yield a writer of results; on a clean exit write the camera of each video.

    All cameras go to one TOML file, `target`. Raises InputError for results without a
    perspective camera, and where it cannot be written; an earlier file then stays.
    """
    check_output(target)
    writer = MotionWriter(options, angles=False)
    yield writer
    records = writer.take_all()
    stated = {**records.attributes, **writer.attributes}
    cameras = find_cameras(records, options, stated, str(target))
    with atomic_path(target) as temporary:
        temporary.write_text(as_toml(cameras), encoding="utf-8")
    axes = "; ".join(dict.fromkeys(camera.pose.axes for camera in cameras))
    writer.summary = Summary(
        note=f"{counted(len(cameras), 'camera')}, in m, {axes}",
        warnings=(ASSUMED,) if any(map(is_assumed, cameras)) else (),
        written=(target,),
    )


ASSUMED = (
    "the focal length was assumed, not measured, and who reads the calibration does not"
    " know that: error bars of a fit with it are too small"
)
"""What to beware of in a calibration with the usual focal length."""


def is_assumed(camera: WorldCamera) -> bool:
    """Whether a camera's focal length is the one assumed where none is known."""
    return is_assumed_focal(camera.focal, camera.size)


def find_cameras(
    records: Shapes3D,
    options: OutputOptions,
    attributes: Mapping[str, Attribute],
    place: str,
) -> list[WorldCamera]:
    """Find the camera of each video of a result, at rest in the world of its files.

    attributes: those of the result's file, with its config. Raises InputError at
    `place` where there is no camera, or one that moves or zooms.
    """
    if not isinstance(records, Fit) or records.focal is None:
        problem = "there is no perspective camera to write"
        fix = "lift landmarks with the size of the images, --image-size WxH"
        raise input_error(place, problem, fix)
    if records.y_axis == "up":
        problem = "y of the landmarks points up, and a calibration counts from the top"
        raise input_error(place, problem, "lift landmarks whose y points down")
    floors = find_floors(records, options, place)
    sequences = records.sequences or ("",) * len(records)
    videos = np.array([video_of(name) for name in sequences], dtype=object)
    cameras = []
    for name in dict.fromkeys(videos.tolist()):
        of_video = records.take(np.flatnonzero(videos == name))
        pose = _find_pose(of_video, floors.get(name), options, place)
        cameras.append(_find_camera(name, of_video, pose, attributes, place))
    return cameras


def _find_pose(
    records: Fit, floor: Floor | None, options: OutputOptions, place: str
) -> CameraPose:
    """Return the pose of a video's camera, by its extrinsics, its floor or the image.

    The world is that of the files in metres: y is up. Raises InputError at `place` as
    `_constant_value`.
    """
    rotation = _constant_value(records, EXTRINSIC_ROTATION, 2, place)
    if rotation is not None:
        up = options.up or nearest_axis_up(rotation)
        translation = _constant_value(records, EXTRINSIC_TRANSLATION, 1, place)
        axes = f"y up, the axis {up} of the extrinsics"
        still = np.zeros(3) if translation is None else translation
        return CameraPose(rotation @ TO_Y_UP[up].T, still, axes)
    level = TO_Y_UP[IMAGE_UP]
    if floor is None:
        return CameraPose(level.T, np.zeros(3), "y up as in the image, from the camera")
    turn = floor._replace(height=0.0).in_floor_frame(np.eye(3))
    to_camera = (turn @ level).T
    below = np.array([0.0, floor.height, 0.0])
    return CameraPose(to_camera, -to_camera @ below, f"y up from the floor; {floor}")


def _find_camera(
    name: str,
    records: Fit,
    pose: CameraPose,
    attributes: Mapping[str, Attribute],
    place: str,
) -> WorldCamera:
    """Return the camera of a video: its pose, and lens and image size by its result.

    Raises InputError at `place` where there is none, and as `_constant_value`.
    """
    focal = _constant_value(records, "focal", 1, place)
    centre = _constant_value(records, "principal_point", 1, place)
    if focal is None or centre is None:
        raise input_error(place, "no image has a camera", "lift images that have one")
    size = _constant_value(records, "image_size", 1, place)
    if size is None:
        size = _stated_size(attributes)
    distortion = _constant_value(records, "removed_distortion", 1, place)
    return WorldCamera(
        name=name,
        size=2 * centre if size is None else size,
        focal=focal,
        centre=centre,
        distortion=np.zeros(4) if distortion is None else distortion,
        pose=pose,
    )


def _stated_size(attributes: Mapping[str, Attribute]) -> Floats | None:
    """Return the size (2,) of images, in pixels, in the config of a fit, or None."""
    size = json.loads(str(attributes.get("config", "{}"))).get("image_size")
    return None if size is None else np.array(size, np.float64)


def _constant_value(records: Fit, name: str, axes: int, place: str) -> Floats | None:
    """Return the one value that a column has for all images; None if it is absent.

    axes: the number of axes of one value. Raises InputError at `place` where images
    differ.
    """
    values = records.column(name)
    if values is None:
        return None
    numbers = np.asarray(values, np.float64)
    if numbers.ndim == axes:
        return numbers
    flat = numbers.reshape(len(numbers), -1)
    known = flat[np.isfinite(flat).all(axis=1)]
    if not len(known):
        return None
    if np.ptp(known, axis=0).max() > MAX_CHANGE * np.abs(known).max():
        problem = f"`{name}` changes from image to image: the camera is not at rest"
        raise input_error(place, problem, "write the result in .h5, which holds each")
    middle = [finite_median(column) for column in known.T]
    return np.array(middle).reshape(numbers.shape[1:])


def as_toml(cameras: Sequence[WorldCamera]) -> str:
    """Format cameras as TOML, a section each."""
    return "\n".join(
        _format_section(f"cam{number:02d}", camera)
        for number, camera in enumerate(cameras, start=1)
    )


def _format_section(key: str, camera: WorldCamera) -> str:
    """Format the section `key` of TOML with a camera's size, lens and pose."""
    from scipy.spatial.transform import Rotation

    fx, fy = camera.focal
    cx, cy = camera.centre
    lens = camera.distortion
    if len(lens) == WHOLE_LENS and not lens[4:].any():
        lens = lens[:4]
    turn = Rotation.from_matrix(camera.pose.rotation).as_rotvec()
    rows = ([fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0])
    lines = [
        f"# The world: {printable(camera.pose.axes)}; metres.",
        *([f"# Beware: {ASSUMED}."] if is_assumed(camera) else []),
        f"[{key}]",
        f"name = {json.dumps(printable(camera.name) or key)}",
        f"size = {_toml_numbers(camera.size)}",
        f"matrix = [{', '.join(map(_toml_numbers, rows))}]",
        f"distortions = {_toml_numbers(lens)}",
        f"rotation = {_toml_numbers(turn)}",
        f"translation = {_toml_numbers(camera.pose.translation)}",
        "fisheye = false",
    ]
    return "\n".join(lines) + "\n"


def _toml_numbers(values: Sequence[float] | Floats) -> str:
    """Format numbers as a list of floats in TOML, `[1.0, 2.5]`."""
    return f"[{', '.join(repr(float(value)) for value in values)}]"

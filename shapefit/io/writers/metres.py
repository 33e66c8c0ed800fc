"""Shapes and results in metres and upright: never what was measured in pixels as if it were not."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from shapefit.arrays import Floats
from shapefit.errors import input_error
from shapefit.geometry.cameras import IMAGE_UP, TO_Y_UP, nearest_axis_up
from shapefit.geometry.floor import Floor
from shapefit.geometry.normalisation import metres_in
from shapefit.io.layout import METRES_FROM, METRES_PER_UNIT, UNKNOWN_UNIT
from shapefit.io.options import OutputOptions
from shapefit.io.records import ResultSet, ShapeSet
from shapefit.io.skeletons import joint_columns

Shapes3D = ShapeSet | ResultSet

CAMERA_TRANSLATION = "camera_translation"
EXTRINSIC_ROTATION, EXTRINSIC_TRANSLATION = "extrinsic_rotation", "extrinsic_translation"
"""Datasets of the file or of each image: X_camera = R X_world + t, in metres; z away from it."""

ANKLE_TO_SHOULDER = 0.818 - 0.039
"""Share of the height of a person between the heights of ankles and shoulders (R. Drillis and R.
Contini, Body segment parameters, 1966)."""

_JOINTS = [f"{side}{joint}" for side in "lr" for joint in ("hip", "knee", "ankle", "shoulder")]

EXTENT_PERCENTILE = 95.0
"""Of the frames of a sequence: a few that went wrong do not count."""


def find_stature(shapes: Floats, names: Sequence[str]) -> Floats | None:
    """(|ankle knee| + |knee hip| + |hips shoulders|) / 0.779 along the body: (n,).

    shapes (n, 3, p); legs are the mean of both, hips and shoulders the middles of theirs. None
    where the landmarks are not those of a person with hips, knees, ankles and shoulders.
    """
    column = joint_columns(names)
    if not set(_JOINTS) <= column.keys():
        return None
    at = {joint: shapes[:, :, column[joint]] for joint in _JOINTS}
    trunk = at["lhip"] + at["rhip"] - at["lshoulder"] - at["rshoulder"]
    bones = [at[f"{s}ankle"] - at[f"{s}knee"] for s in "lr"]
    bones += [at[f"{s}knee"] - at[f"{s}hip"] for s in "lr"]
    lengths = np.linalg.norm([*bones, trunk], axis=2)
    return np.asarray(lengths.sum(axis=0) / 2 / ANKLE_TO_SHOULDER)


FARTHEST = 100.0
"""Metres from a camera to the origin of its world in any room or arena."""


class MetricShapes(NamedTuple):
    """points (n, 3, p) in metres, and where their `axes` and their `size` come from, in words.

    factor (n,): metres in a unit of each shape.
    """

    points: Floats
    factor: Floats
    axes: str
    size: str
    warnings: tuple[str, ...] = ()


def in_metres(
    records: Shapes3D, options: OutputOptions, place: str, floor: Floor | None = None
) -> MetricShapes:
    """Return one sequence in metres.

    Results have y up, shapes keep their axes unless `up` turns them. On a floor y = 0 is the floor,
    and x = z = 0 the camera. Raises InputError at `place` where nothing says how large they are.
    """
    if isinstance(records, ShapeSet):
        shapes, axes = records.shapes, "axes as in the shapes"
        if options.up is not None:
            shapes, axes = TO_Y_UP[options.up] @ shapes, f"y up, which was {options.up}"
        factor, size = _factor(records, shapes, options, place)
        return MetricShapes(factor[:, None, None] * shapes, factor, axes, size)
    turn, axes = _turn(records, options, place)
    upright = turn @ records.shapes
    factor, size = _factor(records, upright, options, place)
    columns = records.columns
    if CAMERA_TRANSLATION not in columns or records.translation is None or records.scale is None:
        points, axes = _in_the_image(upright, factor), f"{axes}; lowest landmark at height 0"
        return MetricShapes(points, factor, axes, size)
    points, world = _from_the_camera(records, factor, place)
    points = turn @ points
    axes_of = f"{axes}; position from the camera"
    warnings: tuple[str, ...] = ()
    if world is not None and (far := np.linalg.norm(world, axis=1).max(initial=0)) > FARTHEST:
        text = f"the camera is {far:.0f} m from the origin of its world: are the extrinsics in"
        warnings = (f"{text} millimetres? Divide their translation by 1000",)
    if floor is not None:
        points, axes_of = floor.stand(points), f"y up from the floor; {floor}"
    elif (
        EXTRINSIC_ROTATION not in columns
        and find_stature(upright, records.landmark_names) is not None
    ):
        axes_of = f"{axes}; the feet do not show the floor; position from the camera"
    return MetricShapes(points, factor, axes_of, size, warnings)


def _turn(records: ResultSet, options: OutputOptions, place: str) -> tuple[Floats, str]:
    """Return the rotations (n, 3, 3) that turn results so that y is up, and where up comes from."""
    level = np.diag([1.0, -1.0, -1.0]) if records.y_axis == "up" else np.eye(3)
    rotation = _per_item(records, EXTRINSIC_ROTATION, (3, 3), place)
    if rotation is not None:
        up = options.up or nearest_axis_up(rotation)
        turn = TO_Y_UP[up] @ rotation.swapaxes(1, 2) @ level
        return turn, f"y up, the axis {up} of the extrinsics"
    if options.up is not None:
        problem = "the result has no extrinsics, so its world has no axes"
        raise input_error("up", problem, "leave it out: y is then up as in the image")
    return np.tile(TO_Y_UP[IMAGE_UP] @ level, (len(records), 1, 1)), "y up as in the image"


def _factor(
    records: Shapes3D, upright: Floats, options: OutputOptions, place: str
) -> tuple[Floats, str]:
    """Return the metres (n,) in a unit of each shape, and by what.

    They are those of the unit; of results without one, those of the training shapes, constant
    unless lengths of edges say them. The height goes over both.
    """
    n, unit = len(records), _unit(records, options, place)
    known: Floats | None = None
    size = ""
    if unit is not None:
        known, size = np.full(n, unit), "the unit as given"
    elif isinstance(records, ResultSet):
        known = _per_item(records, METRES_PER_UNIT, (), place)
        size = "the size of the training shapes"
        if known is not None and records.attributes.get(METRES_FROM) != "edges":
            known = np.full(n, _median(known))
    if options.height is None:
        if known is None:
            raise _unknown_size(records, place)
        return known, size
    stature = find_stature(upright, records.landmark_names)
    whole = np.ones(n) if known is None else known
    if stature is None:
        tall = _extent(whole[:, None, None] * upright)
    elif known is None and isinstance(records, ResultSet):
        whole, tall = 1 / np.where(stature > 0, stature, np.nan), 1.0
    else:
        tall = _median(whole * stature)
    if not tall > 0:
        whole, tall = np.full(n, np.nan), 1.0
    return whole * (options.height / tall), f"height {options.height:g} m"


def _unit(records: Shapes3D, options: OutputOptions, place: str) -> float | None:
    """Return the metres in the unit of the records, None where it is no length."""
    stated = None if records.unit == UNKNOWN_UNIT else records.unit
    if options.unit is None:
        return None if stated is None else metres_in(stated)
    if metres_in(options.unit) is None:
        raise input_error("unit", f"{options.unit!r} is no unit of length", "use m, cm or mm")
    if stated is not None and metres_in(stated) != metres_in(options.unit):
        problem = f"they are in {stated}, not in {options.unit}"
        fix = "leave out `unit`; `height` sets how large they are in metres"
        raise input_error(place, problem, fix)
    return metres_in(options.unit)


def _unknown_size(records: Shapes3D, place: str) -> Exception:
    if isinstance(records, ShapeSet):
        known = records.unit != UNKNOWN_UNIT
        named = f"is {records.unit}, which is no length" if known else "is not known"
        problem = f"the unit of the shapes {named}"
        return input_error(place, problem, "give it, e.g. `unit=m`, or `height=1.78`")
    problem = f"the shapes are in {records.unit}, and their size in metres is not known"
    fix = "give it, e.g. `height=1.78`, or lift with a dictionary learned from shapes in m"
    return input_error(place, problem, fix)


def _extent(shapes: Floats) -> float:
    """Return the height of shapes (n, 3, p) with y up, that of the tallest frames; nan for none."""
    y = shapes[np.isfinite(shapes).any(axis=(1, 2)), 1]
    if not len(y):
        return float("nan")
    return float(np.percentile(np.nanmax(y, axis=1) - np.nanmin(y, axis=1), EXTENT_PERCENTILE))


def _in_the_image(upright: Floats, factor: Floats) -> Floats:
    """Place shapes of unknown depth: they move in the plane of the image, on one scale.

    Each is as large as its factor says; the first is at x = z = 0, the lowest landmark at y = 0.
    """
    middle = upright.mean(axis=2, keepdims=True)
    placed = np.flatnonzero(np.isfinite(middle).all(axis=(1, 2)))
    if not len(placed):
        return upright
    points = factor[:, None, None] * (upright - middle)
    points += _median(factor) * (middle - middle[placed[0]])
    points[:, 1] -= np.nanmin(points[:, 1])
    return points


def _from_the_camera(
    records: ResultSet, factor: Floats, place: str
) -> tuple[Floats, Floats | None]:
    """X = factor (shape - its origin in the image + scale t), from the world's origin if known.

    Returns X in the frame of the shapes, and the translation (n, 3) of the world, or None.
    """
    translation, scale = records.translation, records.scale
    t = _per_item(records, CAMERA_TRANSLATION, (3,), place)
    assert translation is not None
    assert scale is not None
    assert t is not None
    shapes = records.shapes.copy()
    shapes[:, :2] -= translation[..., None]
    X = factor[:, None, None] * (shapes + (scale[:, None] * t)[..., None])
    world = _per_item(records, EXTRINSIC_TRANSLATION, (3,), place)
    if world is None or EXTRINSIC_ROTATION not in records.columns:
        return X, None
    level = np.array([1.0, -1.0, -1.0]) if records.y_axis == "up" else np.ones(3)
    return X - (world * level)[..., None], world


def _per_item(records: ResultSet, name: str, shape: tuple[int, ...], place: str) -> Floats | None:
    """Return a dataset of the file or of each item for each item (n, ...); None without it."""
    values = records.columns.get(name)
    if values is None:
        return None
    n = len(records)
    if values.shape not in (shape, (n, *shape)) or values.dtype.kind not in "fiu":
        fix = f"give numbers of the shape {shape}, or one such for each image"
        raise input_error(place, f"its dataset {name} has the shape {values.shape}", fix)
    return np.broadcast_to(np.asarray(values, np.float64), (n, *shape))


def _median(values: Floats) -> float:
    """Return the median of the finite values, nan without any."""
    finite = values[np.isfinite(values)]
    return float(np.median(finite)) if len(finite) else float("nan")

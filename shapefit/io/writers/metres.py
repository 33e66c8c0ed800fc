"""Shapes and results in metres and upright: what was measured in pixels never passes
for metres.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from shapefit.arrays import Floats, finite_median
from shapefit.errors import input_error
from shapefit.geometry.cameras import IMAGE_UP, TO_Y_UP, nearest_axis_up
from shapefit.geometry.floor import Floor
from shapefit.geometry.normalisation import metres_in
from shapefit.io.layout import METRES_FROM, UNKNOWN_UNIT
from shapefit.io.options import BY_DEFAULT, OutputOptions
from shapefit.io.skeletons import joint_columns
from shapefit.records import Fit, Shapes

Shapes3D = Shapes | Fit

EXTRINSIC_ROTATION = "extrinsic_rotation"
EXTRINSIC_TRANSLATION = "extrinsic_translation"
"""Datasets of the file or of each image: X_camera = R X_world + t, in metres; z away
from it.
"""

ANKLE_TO_SHOULDER = 0.818 - 0.039
"""Share of the height of a person between the heights of ankles and shoulders (R.
Drillis and R. Contini, Body segment parameters, 1966).
"""

EXTENT_PERCENTILE = (
    95.0  # of the frames of a sequence: a few that went wrong do not count
)
MAX_METRES_FROM_ORIGIN = 100.0
"""From a camera to the origin of its world, in any room or arena."""


class MetricShapes(NamedTuple):
    """Shapes of one sequence in metres, and how they were converted.

    points (n, 3, p) in metres; factor (n,), metres per unit of the shapes; axes and
    size, texts on where these come from.
    """

    points: Floats
    factor: Floats
    axes: str
    size: str
    warnings: tuple[str, ...] = ()


def convert_to_metres(
    records: Shapes3D, options: OutputOptions, place: str, floor: Floor | None = None
) -> MetricShapes:
    """Convert the points of one sequence to metres; say where axes and size come from.

    Results have y up, shapes keep their axes unless `up` turns them. On a floor y = 0
    is the floor, and x = z = 0 the camera. Raises InputError at `place` where the size
    is unknown.
    """
    turn, axes = _find_upright_rotation(records, options, place)
    upright = turn @ records.as_columns()
    factor, size = _find_metres_per_unit(records, upright, options, place)
    if isinstance(records, Shapes):
        return MetricShapes(factor[:, None, None] * upright, factor, axes, size)
    t, T, scale = records.camera_translation, records.translation, records.scale
    if t is None or T is None or scale is None:
        points = _place_in_image(upright, factor)
        return MetricShapes(
            points, factor, f"{axes}; lowest landmark at height 0", size
        )
    shapes = records.as_columns().copy()
    shapes[:, :2] -= T[..., None]
    points = factor[:, None, None] * (shapes + (scale[:, None] * t)[..., None])
    points, far = _move_to_world(records, points, place)
    points = turn @ points
    axes = f"{axes}; position from the camera"
    if floor is not None:
        points, axes = floor.in_floor_frame(points), f"y up from the floor; {floor}"
    warning = (
        f"the camera is {far:.0f} m from the origin of its world: if its extrinsics"
        " are in "
    )
    warning += "millimetres, divide their translation by 1000"
    return MetricShapes(
        points, factor, axes, size, (warning,) if far > MAX_METRES_FROM_ORIGIN else ()
    )


def with_stated_height(records: Fit, place: str) -> Fit:
    """Set `metres_per_unit` of a result so that bodies have its `stated_height`.

    For each sequence; without a stated height the result stays as it is. Raises
    InputError at `place` as `_find_upright_rotation`.
    """
    if records.stated_height is None:
        return records
    sequences = np.array(records.sequences or ("",) * len(records), dtype=object)
    factors = np.full(len(records), np.nan)
    for name in dict.fromkeys(sequences.tolist()):
        rows = np.flatnonzero(sequences == name)
        of_sequence = records.take(rows)
        turn, _ = _find_upright_rotation(of_sequence, BY_DEFAULT, place)
        upright = turn @ of_sequence.as_columns()
        factors[rows], _ = _find_metres_per_unit(
            of_sequence, upright, BY_DEFAULT, place
        )
    return replace(records, metres_per_unit=factors)


def find_stature(shapes: Floats, names: Sequence[str]) -> Floats | None:
    """Estimate heights (n,) of people from their bones, in the unit of the shapes.

    None for other landmarks. It is

    (|ankle knee| + |knee hip| + |hips shoulders|) / 0.779 along the body, of shapes (n,
    3, p): legs are the mean of both, hips and shoulders the middles of theirs.
    Landmarks must have hips, knees, ankles and shoulders.
    """
    column = joint_columns(names)
    joints = [
        f"{side}{joint}"
        for side in "lr"
        for joint in ("hip", "knee", "ankle", "shoulder")
    ]
    if not set(joints) <= column.keys():
        return None
    at = {joint: shapes[:, :, column[joint]] for joint in joints}
    trunk = at["lhip"] + at["rhip"] - at["lshoulder"] - at["rshoulder"]
    bones = [at[f"{s}ankle"] - at[f"{s}knee"] for s in "lr"]
    bones += [at[f"{s}knee"] - at[f"{s}hip"] for s in "lr"]
    lengths = np.linalg.norm([*bones, trunk], axis=2)
    return np.asarray(lengths.sum(axis=0) / 2 / ANKLE_TO_SHOULDER)


def image_axis_signs(records: Shapes3D) -> Floats:
    """Return the signs (3,) that turn a record's axes to x right, y down, z away."""
    return np.array([1.0, -1.0, -1.0]) if records.y_axis == "up" else np.ones(3)


def _find_upright_rotation(
    records: Shapes3D, options: OutputOptions, place: str
) -> tuple[Floats, str]:
    """Return rotations (3, 3) or (n, 3, 3) that make y point up, and describe the axes.

    Raises InputError for `up` of results that have no extrinsics, and at `place` for
    extrinsics of another shape.
    """
    up = options.up
    if isinstance(records, Shapes):
        axes = "axes as in the shapes" if up is None else f"y up, which was {up}"
        return TO_Y_UP[up or "y"], axes
    rotation = _values_per_item(records, EXTRINSIC_ROTATION, (3, 3), place)
    if rotation is not None:
        up = up or nearest_axis_up(rotation)
        turn = (
            TO_Y_UP[up] @ rotation.swapaxes(1, 2) @ np.diag(image_axis_signs(records))
        )
        return turn, f"y up, the axis {up} of the extrinsics"
    if up is not None:
        problem = "the result has no extrinsics, so its world has no axes"
        raise input_error("up", problem, "leave it out: y is then up as in the image")
    return TO_Y_UP[IMAGE_UP] @ np.diag(
        image_axis_signs(records)
    ), "y up as in the image"


def _find_metres_per_unit(
    records: Shapes3D, upright: Floats, options: OutputOptions, place: str
) -> tuple[Floats, str]:
    """Return metres (n,) per unit of each shape (n, 3, p), and a text on their source.

    That is the height that is given or that the result states, the unit, or the
    training shapes, for all shapes the same unless edges say their lengths. Raises
    InputError at `place` where there is none of these, and for another unit than that
    of the shapes.
    """
    n, unit = len(records), records.unit
    if options.unit and metres_in(unit) not in (None, metres_in(options.unit)):
        problem = f"the shapes are in {unit}, not in {options.unit}"
        raise input_error("unit", problem, "leave it out")
    unit = options.unit if options.unit and unit == UNKNOWN_UNIT else unit
    metres = metres_in(unit)
    factor, size = (None if metres is None else np.full(n, metres)), "the unit as given"
    if metres is None and isinstance(records, Fit):
        factor = records.metres_per_unit
        size = "the size of the training shapes"
        if factor is not None and records.attributes.get(METRES_FROM) != "edges":
            factor = np.full(n, finite_median(factor))
    height = options.height
    stated = records.stated_height if isinstance(records, Fit) else None
    if height is None and stated is not None:
        height = finite_median(stated)
    if height is None or not height > 0:
        if factor is None:
            fix = "give it, e.g. `height=1.78`"
            fix += ", or `unit=m`" if isinstance(records, Shapes) else ""
            problem = f"the size in metres is not known (the unit is {unit})"
            raise input_error(place, problem, fix)
        return factor, size
    stature = find_stature(upright, records.landmark_names)
    whole = np.ones(n) if factor is None else factor
    if stature is None:
        y = whole[:, None] * upright[:, 1]
        extents = np.fmax.reduce(y, axis=1) - np.fmin.reduce(y, axis=1)
        extents = extents[np.isfinite(extents)]
        tall = (
            float(np.percentile(extents, EXTENT_PERCENTILE)) if len(extents) else np.nan
        )
    elif factor is None and isinstance(records, Fit):
        whole, tall = 1 / np.where(stature > 0, stature, np.nan), 1.0
    else:
        tall = finite_median(whole * stature)
    return (
        whole * (height / tall if tall > 0 else np.nan),
        f"height {height:g} m",
    )


def _place_in_image(upright: Floats, factor: Floats) -> Floats:
    """Convert upright shapes (n, 3, p) of unknown depth to metres, in the image plane.

    factor (n,) is metres per unit. The first shape's centre is at 0, the lowest y is 0.
    """
    middle = upright.mean(axis=2, keepdims=True)
    placed = np.flatnonzero(np.isfinite(middle).all(axis=(1, 2)))
    if not len(placed):
        return upright
    points: Floats = factor[:, None, None] * (upright - middle)
    points += finite_median(factor) * (middle - middle[placed[0]])
    points[:, 1] -= np.nanmin(points[:, 1])
    return points


def _move_to_world(records: Fit, points: Floats, place: str) -> tuple[Floats, float]:
    """Move points (n, 3, p) from the camera's origin to the world's, in metres.

    Returns them, and the largest distance of the camera. Without extrinsics they stay,
    and the distance is 0. Raises InputError at `place` as `_values_per_item`.
    """
    world = _values_per_item(records, EXTRINSIC_TRANSLATION, (3,), place)
    if world is None or records.column(EXTRINSIC_ROTATION) is None:
        return points, 0.0
    far = float(np.linalg.norm(world, axis=1).max(initial=0))
    return points - (world * image_axis_signs(records))[..., None], far


def _values_per_item(
    records: Fit, name: str, shape: tuple[int, ...], place: str
) -> Floats | None:
    """Return a column as an array (n, *shape); None if it is absent.

    A column of the file, not per item, is repeated. Raises InputError at `place` for
    another shape.
    """
    values = records.column(name)
    if values is None:
        return None
    whole = (len(records), *shape)
    if values.shape not in (shape, whole) or values.dtype.kind not in "fiu":
        fix = f"give numbers of the shape {shape}, or one such for each image"
        raise input_error(
            place, f"its dataset {name} has the shape {values.shape}", fix
        )
    return np.broadcast_to(np.asarray(values, np.float64), whole)

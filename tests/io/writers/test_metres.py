"""Results come back in metres and upright, where a planted person walked."""

import numpy as np
import pytest

from shapefit.errors import InputError
from shapefit.io.layout import METRES_FROM, METRES_PER_UNIT
from shapefit.io.options import OutputOptions
from shapefit.io.writers.metres import find_stature, in_metres

NOTHING = OutputOptions()
EXTRINSICS = ("extrinsic_rotation", "extrinsic_translation")


def facing(result, y_axis):
    """Return the same result as it is found in landmarks whose y points this way."""
    if y_axis == "down":
        return result
    turn = np.array([1.0, -1.0, -1.0])
    t = result.columns["camera_translation"] * turn
    return result.replaced(
        shapes=turn[:, None] * result.shapes,
        translation=result.translation * turn[:2],
        further=result.further | {"camera_translation": t},
        y_axis="up",
    )


def lengths(points):
    return np.linalg.norm(points[:, :, 1:] - points[:, :, :1], axis=1)


@pytest.mark.parametrize("y_axis", ["down", "up"])
@pytest.mark.parametrize("per_image", [False, True])
def test_with_a_calibrated_camera_the_world_comes_back(scene, y_axis, per_image):
    result = facing(scene.result, y_axis)
    if per_image:
        columns = {name: np.stack([result.columns[name]] * len(result)) for name in EXTRINSICS}
        result = result.with_columns(columns)
    placed = in_metres(result, NOTHING, "man.trc")
    np.testing.assert_allclose(placed.points, scene.y_up, atol=1e-12)
    assert placed.axes == "y up, the axis z of the extrinsics; position from the camera"
    tilted = in_metres(result, OutputOptions(up="y"), "man.trc")
    np.testing.assert_allclose(tilted.points, scene.world, atol=1e-12)


@pytest.mark.parametrize("y_axis", ["down", "up"])
def test_without_extrinsics_the_camera_is_the_origin(scene, y_axis):
    result = facing(scene.result, y_axis).without(EXTRINSICS)
    R, t = (scene.result.columns[name] for name in EXTRINSICS)
    expected = np.diag([1, -1, -1]) @ (R @ scene.world + t[:, None])
    points = in_metres(result, NOTHING, "man.trc").points
    np.testing.assert_allclose(points, expected, atol=1e-12)
    with pytest.raises(InputError, match=r"^up: the result has no extrinsics"):
        in_metres(result, OutputOptions(up="z"), "man.trc")


@pytest.mark.parametrize("y_axis", ["down", "up"])
def test_weak_perspective_keeps_the_body_and_stands_it_on_the_ground(scene, y_axis):
    result = facing(scene.result, y_axis).without(["camera_translation"])
    placed = in_metres(result, NOTHING, "man.trc")
    body = placed.points - placed.points.mean(axis=2, keepdims=True)
    truth = scene.y_up - scene.y_up.mean(axis=2, keepdims=True)
    np.testing.assert_allclose(body, truth, atol=1e-12)
    assert placed.points[:, 1].min() == pytest.approx(0)
    np.testing.assert_allclose(placed.points[0].mean(axis=1)[[0, 2]], 0, atol=1e-12)
    assert placed.axes.endswith("lowest landmark at height 0")
    middle = in_metres(result.without(EXTRINSICS), NOTHING, "man.trc").points.mean(axis=2)
    np.testing.assert_allclose(middle[:, 2], 0, atol=1e-12)  # in the plane of the image
    factor = np.median(result.columns[METRES_PER_UNIT])
    way = factor * result.shapes.mean(axis=2)[:, 0]
    np.testing.assert_allclose(middle[:, 0] - middle[0, 0], way - way[0], atol=1e-12)


def test_a_size_by_spread_is_one_for_the_sequence(scene):
    result = scene.result.replaced(attributes={METRES_FROM: "spread"})
    result = result.without(["camera_translation", *EXTRINSICS])
    points = in_metres(result, NOTHING, "man.trc").points
    factor = np.median(result.columns[METRES_PER_UNIT])
    np.testing.assert_allclose(lengths(points), factor * lengths(result.shapes), atol=1e-12)


@pytest.mark.parametrize("missing", [[], [METRES_PER_UNIT]])
def test_height_sets_the_size(scene, missing):
    result = scene.result.without(missing)
    placed = in_metres(result, OutputOptions(height=1.5), "man.trc")
    stature = find_stature(placed.points, result.landmark_names)
    np.testing.assert_allclose(stature, 1.5, rtol=1e-9)
    assert placed.size == "height 1.5 m"


def test_height_of_other_objects_is_their_largest_extent_upright(scene):
    names = tuple(f"point {i}" for i in range(15))
    shapes = scene.result.shapes[:1].repeat(4, axis=0)
    result = scene.result.replaced(landmark_names=names, shapes=shapes)
    result = result.without([METRES_PER_UNIT, "camera_translation"])
    points = in_metres(result, OutputOptions(height=0.3), "car.trc").points
    assert np.ptp(points[0, 1]) == pytest.approx(0.3)


@pytest.mark.parametrize("missing", [[], ["camera_translation"]])
def test_failed_items_stay_gaps(scene, missing):
    shapes = scene.result.shapes.copy()
    shapes[1] = np.nan
    result = scene.result.without(missing).replaced(shapes=shapes)
    points = in_metres(result, NOTHING, "man.trc").points
    assert np.isfinite(points).all(axis=(1, 2)).tolist() == [True, False, True, True]
    nothing = result.replaced(shapes=np.full_like(shapes, np.nan))
    for options in (NOTHING, OutputOptions(height=1.7)):
        assert np.isnan(in_metres(nothing, options, "man.trc").points).all()


def test_shapes_are_converted_and_keep_their_axes(scene, shapes):
    placed = in_metres(shapes, NOTHING, "walk.trc")
    np.testing.assert_allclose(placed.points, scene.world, atol=1e-12)
    assert placed.axes == "axes as in the shapes"
    turned = in_metres(shapes, OutputOptions(up="z"), "walk.trc")
    np.testing.assert_allclose(turned.points, scene.y_up, atol=1e-12)


def test_shapes_of_unknown_unit(scene, shapes):
    unknown = shapes.replaced(unit="unknown")
    with pytest.raises(InputError, match=r"walk\.trc: .*not known .*; give it, .* or `unit=m`"):
        in_metres(unknown, NOTHING, "walk.trc")
    with pytest.raises(InputError, match=r"the unit is elephant"):
        in_metres(unknown, OutputOptions(unit="elephant"), "walk.trc")
    points = in_metres(unknown, OutputOptions(unit="cm"), "walk.trc").points
    np.testing.assert_allclose(points, scene.world, atol=1e-12)
    tall = in_metres(unknown, OutputOptions(height=2.0), "walk.trc").points
    assert np.median(find_stature(tall, shapes.landmark_names)) == pytest.approx(2.0)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (NOTHING, r"size in metres is not known \(the unit is px\); .*`height=1\.78`"),
        (OutputOptions(unit="mm"), r"size in metres is not known \(the unit is px\)"),
    ],
)
def test_pixels_are_never_written_as_lengths(scene, options, message):
    with pytest.raises(InputError, match=message):
        in_metres(scene.result.without([METRES_PER_UNIT]), options, "man.trc")


def test_another_unit_than_the_file_states_is_refused(scene):
    records = scene.result.replaced(unit="mm")
    with pytest.raises(InputError, match="the shapes are in mm, not in m; leave it out"):
        in_metres(records, OutputOptions(unit="m"), "man.trc")
    in_metres(records, OutputOptions(unit="mm"), "man.trc")


def test_a_world_in_millimetres_is_suspected(scene):
    far = 1000 * scene.result.columns["extrinsic_translation"]
    result = scene.result.replaced(extrinsic_translation=far)
    (warning,) = in_metres(result, NOTHING, "man.trc").warnings
    assert warning.startswith("the camera is 4006 m from the origin of its world")
    damaged = scene.result.without(EXTRINSICS).with_columns({EXTRINSICS[0]: np.eye(4)})
    with pytest.raises(InputError, match=r"extrinsic_rotation has the shape \(4, 4\)"):
        in_metres(damaged, NOTHING, "man.trc")

"""Results come back in metres and upright."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from shapefit.errors import InputError
from shapefit.io.layout import METRES_FROM
from shapefit.io.options import OutputOptions
from shapefit.io.writers.metres import convert_to_metres, find_stature
from shapefit.records import Fit
from tests.columns import put

NOTHING = OutputOptions()
EXTRINSICS = ("extrinsic_rotation", "extrinsic_translation")


def points_in_metres(record, options=NOTHING):
    """Return the points (n, 3, p) that are written of a record."""
    return convert_to_metres(record, options, "man.trc").points


def assert_near(points, expected):
    assert_allclose(points, expected, atol=1e-12)


def facing(result, y_axis):
    """Return the same result as it is found in landmarks whose y points this way."""
    if y_axis == "down":
        return result
    turn = np.array([1.0, -1.0, -1.0])
    camera_translation = result.column("camera_translation") * turn
    return result.replaced(
        shapes=result.shapes * turn,
        translation=result.translation * turn[:2],
        camera_translation=camera_translation,
        y_axis="up",
    )


def lengths(points):
    """Return how far all landmarks are from the first (n, p - 1)."""
    from_first = points[:, :, 1:] - points[:, :, :1]
    return np.linalg.norm(from_first, axis=1)


def extrinsics_of_each_image(result):
    columns = {}
    for name in EXTRINSICS:
        columns[name] = np.stack([result.column(name)] * len(result))
    return put(result, columns)


@pytest.mark.parametrize("y_axis", ["down", "up"])
@pytest.mark.parametrize("per_image", [False, True])
def test_with_a_calibrated_camera_the_world_comes_back(scene, y_axis, per_image):
    result = facing(scene.result, y_axis)
    if per_image:
        result = extrinsics_of_each_image(result)
    placed = convert_to_metres(result, NOTHING, "man.trc")
    tilted = points_in_metres(result, OutputOptions(up="y"))
    assert_near(placed.points, scene.y_up)
    assert placed.axes == "y up, the axis z of the extrinsics; position from the camera"
    assert_near(tilted, scene.world)


@pytest.mark.parametrize("y_axis", ["down", "up"])
def test_without_extrinsics_the_camera_is_the_origin(scene, y_axis):
    result = facing(scene.result, y_axis).without(EXTRINSICS)
    R = scene.result.column("extrinsic_rotation")
    t = scene.result.column("extrinsic_translation")
    from_camera = R @ scene.world + t[:, None]
    expected = np.diag([1, -1, -1]) @ from_camera
    assert_near(points_in_metres(result), expected)


def test_the_axis_that_is_up_needs_extrinsics(scene):
    result = scene.result.without(EXTRINSICS)
    with pytest.raises(InputError, match=r"^up: the result has no extrinsics"):
        convert_to_metres(result, OutputOptions(up="z"), "man.trc")


def centred(points):
    return points - points.mean(axis=2, keepdims=True)


@pytest.mark.parametrize("y_axis", ["down", "up"])
def test_weak_perspective_keeps_the_body_and_stands_it_on_the_ground(scene, y_axis):
    result = facing(scene.result, y_axis).without(["camera_translation"])
    placed = convert_to_metres(result, NOTHING, "man.trc")
    lowest = placed.points[:, 1].min()
    first_middle = placed.points[0].mean(axis=1)
    assert_near(centred(placed.points), centred(scene.y_up))
    assert lowest == pytest.approx(0)
    assert_near(first_middle[[0, 2]], 0)
    assert placed.axes.endswith("lowest landmark at height 0")


@pytest.mark.parametrize("y_axis", ["down", "up"])
def test_under_weak_perspective_the_body_moves_in_the_plane_of_the_image(scene, y_axis):
    result = facing(scene.result, y_axis).without(["camera_translation", *EXTRINSICS])
    middle = points_in_metres(result).mean(axis=2)
    metres_per_unit = np.median(result.column("metres_per_unit"))
    x_in_image = metres_per_unit * result.shapes.mean(axis=1)[:, 0]
    assert_near(middle[:, 2], 0)
    assert_near(middle[:, 0] - middle[0, 0], x_in_image - x_in_image[0])


def test_a_size_by_spread_is_one_for_the_sequence(scene):
    result = scene.result.replaced(attributes={METRES_FROM: "spread"})
    result = result.without(["camera_translation", *EXTRINSICS])
    metres_per_unit = np.median(result.column("metres_per_unit"))
    expected = metres_per_unit * lengths(result.as_columns())
    assert_near(lengths(points_in_metres(result)), expected)


@pytest.mark.parametrize("missing", [[], ["metres_per_unit"]])
def test_height_sets_the_size(scene, missing):
    result = scene.result.without(missing)
    placed = convert_to_metres(result, OutputOptions(height=1.5), "man.trc")
    stature = find_stature(placed.points, result.landmark_names)
    assert_allclose(stature, 1.5, rtol=1e-9)
    assert placed.size == "height 1.5 m"


def test_height_of_other_objects_is_their_largest_extent_upright(scene):
    names = tuple(f"point {i}" for i in range(15))
    shapes = scene.result.shapes[:1].repeat(4, axis=0)
    result = scene.result.replaced(landmark_names=names, shapes=shapes)
    result = result.without(["metres_per_unit", "camera_translation"])
    points = points_in_metres(result, OutputOptions(height=0.3))
    extent = np.ptp(points[0, 1])
    assert extent == pytest.approx(0.3)


def test_one_image_with_a_landmark_far_off_does_not_set_the_height(scene):
    names = tuple(f"point {i}" for i in range(15))
    shapes = scene.result.shapes[:1].repeat(200, axis=0)
    shapes[7, 0, 1] += 100 * np.ptp(shapes[0, :, 1])
    result = Fit(shapes, landmark_names=names, unit="px", y_axis="down")
    points = points_in_metres(result, OutputOptions(height=0.3))
    assert np.ptp(points[0, 1]) == pytest.approx(0.3)


def state_heights(result, heights):
    return result.replaced(stated_height=np.array(heights))


def test_the_height_that_a_result_states_sets_the_size(scene):
    """Failed images have none."""
    result = state_heights(scene.result, [1.5, np.nan, 1.5, 1.5])
    placed = convert_to_metres(result, NOTHING, "man.trc")
    stature = find_stature(placed.points, result.landmark_names)
    assert_allclose(stature, 1.5, rtol=1e-9)
    assert placed.size == "height 1.5 m"


def test_a_height_that_is_given_goes_before_the_stated_one(scene):
    result = state_heights(scene.result, [1.5] * 4)
    placed = convert_to_metres(result, OutputOptions(height=1.9), "man.trc")
    assert placed.size == "height 1.9 m"


def test_without_any_stated_height_the_size_is_that_of_the_training_shapes(scene):
    result = state_heights(scene.result, [np.nan] * 4)
    placed = convert_to_metres(result, NOTHING, "man.trc")
    assert_near(placed.points, scene.y_up)
    assert placed.size == "the size of the training shapes"


def test_a_body_that_is_wider_than_high_stands_on_the_ground_too(scene):
    wide = scene.result.shapes * np.array([9.0, 1.0, 9.0])
    result = scene.result.replaced(shapes=wide)
    points = points_in_metres(result.without(["camera_translation", *EXTRINSICS]))
    assert points[:, 1].min() == pytest.approx(0)
    assert points[:, 0].min() < -1


@pytest.mark.parametrize("missing", [[], ["camera_translation"]])
@pytest.mark.parametrize("failed", range(4))
def test_failed_items_stay_gaps(scene, missing, failed):
    shapes = scene.result.shapes.copy()
    shapes[failed] = np.nan
    result = scene.result.without(missing).replaced(shapes=shapes)
    points = points_in_metres(result)
    finite = np.isfinite(points).all(axis=(1, 2))
    assert finite.tolist() == [image != failed for image in range(4)]


@pytest.mark.parametrize("failed", range(2))
def test_under_weak_perspective_the_first_shape_is_at_0(scene, failed):
    """The first that there is, where images before it have failed."""
    shapes = scene.result.shapes.copy()
    shapes[:failed] = np.nan
    result = scene.result.without(["camera_translation"]).replaced(shapes=shapes)
    first_middle = points_in_metres(result)[failed].mean(axis=1)
    assert_near(first_middle[[0, 2]], 0)


@pytest.mark.parametrize("missing", [[], ["camera_translation"]])
@pytest.mark.parametrize("options", [NOTHING, OutputOptions(height=1.7)])
def test_of_failed_items_alone_nothing_is_known(scene, missing, options):
    failed = np.full_like(scene.result.shapes, np.nan)
    result = scene.result.without(missing).replaced(shapes=failed)
    points = points_in_metres(result, options)
    assert np.isnan(points).all()


def test_shapes_are_converted_and_keep_their_axes(scene, shapes):
    placed = convert_to_metres(shapes, NOTHING, "walk.trc")
    assert_near(placed.points, scene.world)
    assert placed.axes == "axes as in the shapes"


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (NOTHING, r"size in metres is not known \(the unit is px\); .*`height=1\.78`"),
        (OutputOptions(unit="mm"), r"size in metres is not known \(the unit is px\)"),
    ],
)
def test_pixels_are_never_written_as_lengths(scene, options, message):
    with pytest.raises(InputError, match=message):
        convert_to_metres(scene.result.without(["metres_per_unit"]), options, "man.trc")


def test_shapes_are_turned_where_the_axis_that_is_up_is_given(scene, shapes):
    turned = points_in_metres(shapes, OutputOptions(up="z"))
    assert_near(turned, scene.y_up)


def test_shapes_of_unknown_unit_are_refused(shapes):
    unknown = shapes.replaced(unit="unknown")
    fix = r"walk\.trc: .*not known .*; give it, .* or `unit=m`"
    with pytest.raises(InputError, match=fix):
        convert_to_metres(unknown, NOTHING, "walk.trc")
    with pytest.raises(InputError, match=r"the unit is elephant"):
        convert_to_metres(unknown, OutputOptions(unit="elephant"), "walk.trc")


def test_a_given_unit_is_that_of_shapes_without_one(scene, shapes):
    unknown = shapes.replaced(unit="unknown")
    points = points_in_metres(unknown, OutputOptions(unit="cm"))
    assert_near(points, scene.world)


def test_a_given_height_does_without_a_unit(shapes):
    unknown = shapes.replaced(unit="unknown")
    points = points_in_metres(unknown, OutputOptions(height=2.0))
    stature = find_stature(points, shapes.landmark_names)
    assert np.median(stature) == pytest.approx(2.0)


def test_a_unit_that_contradicts_the_file_is_refused(scene):
    millimetres = scene.result.replaced(unit="mm")
    fault = "the shapes are in mm, not in m; leave it out"
    with pytest.raises(InputError, match=fault):
        convert_to_metres(millimetres, OutputOptions(unit="m"), "man.trc")


def test_the_unit_that_the_file_states_may_be_given(scene):
    millimetres = scene.result.replaced(unit="mm")
    convert_to_metres(millimetres, OutputOptions(unit="mm"), "man.trc")


def test_a_world_in_millimetres_is_suspected(scene):
    far = 1000 * scene.result.column("extrinsic_translation")
    result = put(scene.result, {}, {"extrinsic_translation": far})
    (warning,) = convert_to_metres(result, NOTHING, "man.trc").warnings
    assert warning.startswith("the camera is 4006 m from the origin of its world")


def test_extrinsics_of_another_shape_are_refused(scene):
    wrong = {"extrinsic_rotation": np.eye(4)}
    damaged = put(scene.result.without(EXTRINSICS), {}, wrong)
    with pytest.raises(InputError, match=r"extrinsic_rotation has the shape \(4, 4\)"):
        convert_to_metres(damaged, NOTHING, "man.trc")

"""Results come back in metres and upright; sequences of files, all or none; floor;
markers.
"""

import csv
import errno
import os
import re

import numpy as np
import pytest

from shapefit.errors import InputError
from shapefit.geometry.floor import ABOVE_FLOOR
from shapefit.geometry.pinhole import ASSUMED_FOCAL
from shapefit.io.formats import record_writer
from shapefit.io.layout import METRES_FROM, RESULTS
from shapefit.io.options import BY_DEFAULT, OutputOptions
from shapefit.io.writers import tables
from shapefit.io.writers.metres import find_stature, in_metres
from shapefit.io.writers.motion import find_floors
from shapefit.records import Fit, concatenate
from tests.columns import put
from tests.geometry import filmed_bodies as planted
from tests.io.files import load_shapes, save
from tests.io.writers.conftest import parse_trc, trc_points, visible

NOTHING = OutputOptions()
EXTRINSICS = ("extrinsic_rotation", "extrinsic_translation")


def facing(result, y_axis):
    """Return the same result as it is found in landmarks whose y points this way."""
    if y_axis == "down":
        return result
    turn = np.array([1.0, -1.0, -1.0])
    t = result.column("camera_translation") * turn
    return result.replaced(
        shapes=(turn[:, None] * result.as_columns()).swapaxes(1, 2),
        translation=result.translation * turn[:2],
        camera_translation=t,
        y_axis="up",
    )


def lengths(points):
    return np.linalg.norm(points[:, :, 1:] - points[:, :, :1], axis=1)


@pytest.mark.parametrize("y_axis", ["down", "up"])
@pytest.mark.parametrize("per_image", [False, True])
def test_with_a_calibrated_camera_the_world_comes_back(scene, y_axis, per_image):
    result = facing(scene.result, y_axis)
    if per_image:
        columns = {
            name: np.stack([result.column(name)] * len(result)) for name in EXTRINSICS
        }
        result = put(result, columns)
    placed = in_metres(result, NOTHING, "man.trc")
    np.testing.assert_allclose(placed.points, scene.y_up, atol=1e-12)
    assert placed.axes == "y up, the axis z of the extrinsics; position from the camera"
    tilted = in_metres(result, OutputOptions(up="y"), "man.trc")
    np.testing.assert_allclose(tilted.points, scene.world, atol=1e-12)


@pytest.mark.parametrize("y_axis", ["down", "up"])
def test_without_extrinsics_the_camera_is_the_origin(scene, y_axis):
    result = facing(scene.result, y_axis).without(EXTRINSICS)
    R, t = (scene.result.column(name) for name in EXTRINSICS)
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
    middle = in_metres(result.without(EXTRINSICS), NOTHING, "man.trc").points.mean(
        axis=2
    )
    np.testing.assert_allclose(middle[:, 2], 0, atol=1e-12)  # in the plane of the image
    factor = np.median(result.column("metres_per_unit"))
    way = factor * result.as_columns().mean(axis=2)[:, 0]
    np.testing.assert_allclose(middle[:, 0] - middle[0, 0], way - way[0], atol=1e-12)


def test_a_size_by_spread_is_one_for_the_sequence(scene):
    result = scene.result.replaced(attributes={METRES_FROM: "spread"})
    result = result.without(["camera_translation", *EXTRINSICS])
    points = in_metres(result, NOTHING, "man.trc").points
    factor = np.median(result.column("metres_per_unit"))
    np.testing.assert_allclose(
        lengths(points), factor * lengths(result.as_columns()), atol=1e-12
    )


@pytest.mark.parametrize("missing", [[], ["metres_per_unit"]])
def test_height_sets_the_size(scene, missing):
    result = scene.result.without(missing)
    placed = in_metres(result, OutputOptions(height=1.5), "man.trc")
    stature = find_stature(placed.points, result.landmark_names)
    np.testing.assert_allclose(stature, 1.5, rtol=1e-9)
    assert placed.size == "height 1.5 m"


def test_height_of_other_objects_is_their_largest_extent_upright(scene):
    names = tuple(f"point {i}" for i in range(15))
    shapes = scene.result.as_columns()[:1].repeat(4, axis=0)
    result = scene.result.replaced(landmark_names=names, shapes=shapes.swapaxes(1, 2))
    result = result.without(["metres_per_unit", "camera_translation"])
    points = in_metres(result, OutputOptions(height=0.3), "car.trc").points
    assert np.ptp(points[0, 1]) == pytest.approx(0.3)


@pytest.mark.parametrize("missing", [[], ["camera_translation"]])
def test_failed_items_stay_gaps(scene, missing):
    shapes = scene.result.as_columns().copy()
    shapes[1] = np.nan
    result = scene.result.without(missing).replaced(shapes=shapes.swapaxes(1, 2))
    points = in_metres(result, NOTHING, "man.trc").points
    assert np.isfinite(points).all(axis=(1, 2)).tolist() == [True, False, True, True]
    nothing = result.replaced(shapes=np.full_like(shapes, np.nan).swapaxes(1, 2))
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
    with pytest.raises(
        InputError, match=r"walk\.trc: .*not known .*; give it, .* or `unit=m`"
    ):
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
        in_metres(scene.result.without(["metres_per_unit"]), options, "man.trc")


def test_another_unit_than_the_file_states_is_refused(scene):
    records = scene.result.replaced(unit="mm")
    with pytest.raises(
        InputError, match="the shapes are in mm, not in m; leave it out"
    ):
        in_metres(records, OutputOptions(unit="m"), "man.trc")
    in_metres(records, OutputOptions(unit="mm"), "man.trc")


def test_a_world_in_millimetres_is_suspected(scene):
    far = 1000 * scene.result.column("extrinsic_translation")
    result = put(scene.result, {}, {"extrinsic_translation": far})
    (warning,) = in_metres(result, NOTHING, "man.trc").warnings
    assert warning.startswith("the camera is 4006 m from the origin of its world")
    damaged = put(scene.result.without(EXTRINSICS), {}, {EXTRINSICS[0]: np.eye(4)})
    with pytest.raises(InputError, match=r"extrinsic_rotation has the shape \(4, 4\)"):
        in_metres(damaged, NOTHING, "man.trc")


# Sequences


@pytest.fixture
def several(scene) -> Fit:
    """A result of two individuals, two frames each."""
    return scene.result.replaced(
        items=("a/0", "a/1", "b/0", "b/1"),
        sequences=("a", "a", "b", "b"),
        frames=np.array([0, 1, 0, 1]),
    )


# Files


def test_nothing_appears_before_all_is_written(tmp_path, several):
    with record_writer(tmp_path / "man.trc", RESULTS) as writer:
        writer.append(several)
        assert not list(tmp_path.iterdir())
    files = [f"man_{name}{end}" for name in "ab" for end in (".trc", "_angles.csv")]
    assert sorted(os.listdir(tmp_path)) == files
    np.testing.assert_array_equal(parse_trc(tmp_path / "man_b.trc")[3][:, 0], [0, 1])


@pytest.mark.parametrize("rows", [[0, 1], [0, 1, 2, 3]])
@pytest.mark.parametrize("number", [errno.ENOSPC, None])
def test_after_an_error_earlier_files_stand_alone(
    tmp_path, several, rows, number, monkeypatch
):
    earlier = {"man.trc": "old", "man_a.trc": "old"}
    for name, text in earlier.items():
        (tmp_path / name).write_text(text)
    original = tables.write_trc

    def fill(path, motion):
        original(path, motion)
        if len(rows) == 2 or motion.name == "b":
            raise (
                OSError(number, "No space left on device")
                if number
                else ZeroDivisionError
            )

    monkeypatch.setattr(tables, "write_trc", fill)
    with pytest.raises(InputError if number else ZeroDivisionError) as caught:
        save(tmp_path / "man.trc", several.take(rows))
    assert (
        "cannot be written: No space left on device; free" in str(caught.value)
        or not number
    )
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == earlier


def test_a_folder_in_the_way(tmp_path, several, problems):
    (tmp_path / "man_b.trc").mkdir()
    (line,) = problems(save, tmp_path / "man.trc", several)
    assert line.startswith(f"{tmp_path / 'man_b.trc'}: it is a folder")
    assert os.listdir(tmp_path) == ["man_b.trc"]


@pytest.mark.parametrize(
    ("one", "other", "names"),
    [
        ("film/anna", "film/person 2", ["man_anna.trc", "man_person_2.trc"]),
        ("film", "film/b", ["man_film.trc", "man_film_b.trc"]),
        ("a:b", "../c", ["man_a%3Ab.trc", "man_.._c.trc"]),
        ("a b", "a_b", ["man_a_b.trc", "man_a_b_2.trc"]),
    ],
)
def test_files_are_named_after_sequences(tmp_path, several, one, other, names):
    record = several.replaced(sequences=(one, one, other, other))
    written = save(tmp_path / "man.trc", record).written
    assert [path.name for path in written if path.suffix == ".trc"] == sorted(names)
    assert sorted(tmp_path.iterdir()) == sorted(written)


def test_options_for_metres_need_such_a_format(tmp_path, scene):
    with pytest.raises(
        InputError, match="height: an HDF5 file keeps the unit and the axes"
    ):
        record_writer(tmp_path / "man.h5", RESULTS, options=OutputOptions(height=1.8))


def test_two_items_of_one_frame(tmp_path, several, problems):
    for record in (
        several.replaced(sequences=("a",) * 4),
        several.replaced(sequences=None),
    ):
        (line,) = problems(save, tmp_path / "man.trc", record)
        assert "man.trc: 'a/0' and 'b/0' are of one frame" in line
        assert line.endswith("give each individual a sequence of its own")
    assert not list(tmp_path.iterdir())


# The floor

SOLE = ABOVE_FLOOR["ankle"] * planted.TALL
ANKLES = [planted.JOINTS["lankle"], planted.JOINTS["rankle"]]


def seen(points, name="film/anna", **camera) -> Fit:
    """Return what a fit of these bodies finds through a tilted camera."""
    points, _ = planted.visible(points, **camera)
    turned = np.diag([1.0, -1.0, -1.0]) @ points
    result = visible(turned, np.eye(3), np.zeros(3), tuple(planted.JOINTS))
    n = len(points)
    sd = (
        np.full_like(result.as_columns(), 0.05)
        / result.column("metres_per_unit")[:, None, None]
    )
    return result.without(["extrinsic_rotation", "extrinsic_translation"]).replaced(
        items=tuple(f"{name}/{i}" for i in range(n)),
        sequences=(name,) * n,
        shape_sd=sd.swapaxes(1, 2),
    )


@pytest.fixture
def walk() -> Fit:
    return seen(planted.walk())


def test_feet_are_on_the_floor_in_every_format(tmp_path, walk):
    summary = save(tmp_path / "man.trc", walk)
    line = (
        r"y up from the floor; camera 1\.\d\d m \(\+- 0\.\d\d\) above the floor, tilted"
        r" 1\d degr"
    )
    assert re.search(line, summary.note)
    assert re.search(line, parse_trc(tmp_path / "man.trc")[0][4])
    points = trc_points(tmp_path / "man.trc")
    lower = points[:, 1][:, ANKLES].min(axis=1)
    assert np.nanmedian(lower) == pytest.approx(SOLE, abs=0.02)
    save(tmp_path / "man.metres.csv", walk)
    with (tmp_path / "man.metres.csv").open() as file:
        rows = [[float(row[axis]) for axis in "xyz"] for row in csv.DictReader(file)]
    table = np.reshape(rows, (len(points), -1, 3)).swapaxes(1, 2)
    np.testing.assert_allclose(table, points, atol=1e-6)
    with (tmp_path / "man_angles.csv").open() as file:
        tilts = [float(row["trunk_tilt"]) for row in csv.DictReader(file)]
    assert np.max(tilts) < 2  # to the true vertical, of a camera that is tilted by 12


@pytest.mark.parametrize(
    ("change", "axes"),
    [
        (
            lambda r: put(
                r,
                {},
                {"extrinsic_rotation": np.eye(3), "extrinsic_translation": np.zeros(3)},
            ),
            "y up, the axis -y of the extrinsics; position from the camera",
        ),
        (
            lambda r: r.without(["camera_translation"]),
            "y up as in the image; lowest landmark at",
        ),
        (
            lambda _: seen(planted.sitting()),
            "y up as in the image; position from the camera",
        ),
        (
            lambda _: seen(planted.lying()),
            "y up as in the image; position from the camera",
        ),
    ],
)
def test_other_cameras_keep_their_axes(tmp_path, walk, change, axes):
    assert axes in save(tmp_path / "man.trc", change(walk)).note


@pytest.mark.parametrize("height", [0.4, 6.0])
def test_a_given_height_does_not_decide_whether_there_is_a_floor(walk, height):
    stated, given = (
        find_floors(walk, options, "")["film"]
        for options in (BY_DEFAULT, OutputOptions(height=height))
    )
    assert (given.pitch, given.pitch_sd) == pytest.approx(
        (stated.pitch, stated.pitch_sd), abs=1e-6
    )


def test_what_is_not_trusted_or_not_visible_shows_no_floor(walk):
    reasons = np.array(["wide error bars"] * len(walk), dtype=object)
    assert list(find_floors(walk, BY_DEFAULT, "")) == ["film"]
    assert find_floors(put(walk, {"reasons": reasons}), BY_DEFAULT, "") == {}
    landmarks = np.zeros((len(walk), len(planted.JOINTS), 2))
    landmarks[5:8, ANKLES] = np.nan  # a gap
    gap = find_floors(put(walk, {"landmarks": landmarks}), BY_DEFAULT, "")["film"]
    np.testing.assert_array_equal(gap.up, find_floors(walk, BY_DEFAULT, "")["film"].up)
    landmarks[:, ANKLES] = np.nan
    assert find_floors(put(walk, {"landmarks": landmarks}), BY_DEFAULT, "") == {}


def test_individuals_of_a_video_share_the_floor_and_videos_do_not(walk):
    other = seen(planted.walk(heading=1.0), "film/bert", away=8.0)
    level = seen(planted.walk(), "other/anna", height=0.5, pitch=-5.0)
    alone, both = (
        find_floors(one, BY_DEFAULT, "")
        for one in (walk, concatenate([walk, other, level]))
    )
    assert list(both) == ["film", "other"]
    assert both["film"].height_sd < alone["film"].height_sd
    assert both["other"].height == pytest.approx(0.5, abs=0.1)


def test_an_assumed_focal_length_widens_the_bars(walk):
    n = len(walk)
    centre = np.tile([960.0, 540.0], (n, 1))

    def height_sd(focal):
        columns = {"focal": np.full((n, 2), focal), "principal_point": centre}
        return find_floors(put(walk, columns), BY_DEFAULT, "")["film"].height_sd

    assert height_sd(ASSUMED_FOCAL * 1920) > 1.04 * height_sd(1800.0)


# Markers


@pytest.fixture
def lifted(walk) -> Fit:
    """Return the walk with four landmarks of a detector, 1 cm above joints."""
    columns = [planted.JOINTS[joint] for joint in ("rhip", "lhip", "rhip", "rshoulder")]
    points = walk.as_columns()[..., columns].swapaxes(1, 2).copy()
    points[..., 1] -= 0.01 / walk.column("metres_per_unit")[:, None]
    names = np.array(("RHip", "LHip", "MidHip", "Nose"), dtype=object)
    markers = {
        "input_shapes": points,
        "input_shape_sd": np.full_like(points, 2.0),
        "input_landmark_names": names,
    }
    return put(walk, {**markers, "landmarks_fitted": walk.shapes[..., :2]})


def test_markers_of_the_detector(tmp_path, lifted):
    """A second reader finds them by the names that models of Pose2Sim know, in the same
    place.
    """
    save(tmp_path / "joints.trc", lifted)
    save(tmp_path / "man.trc", lifted, markers="input")
    assert parse_trc(tmp_path / "man.trc")[2] == ["RHip", "LHip", "CHip", "Nose"]
    markers, joints = (
        trc_points(tmp_path / f"{name}.trc") for name in ("man", "joints")
    )
    difference = markers[..., 0] - joints[..., planted.JOINTS["rhip"]]
    np.testing.assert_allclose(np.linalg.norm(difference, axis=1), 0.01, atol=1e-6)
    np.testing.assert_allclose(
        load_shapes(tmp_path / "man.trc")[0].as_columns(), markers, atol=1e-12
    )
    one, other = (tmp_path / f"{name}_angles.csv" for name in ("man", "joints"))
    assert one.read_bytes() == other.read_bytes()
    save(tmp_path / "man.bvh", lifted, markers="input")
    assert {"CHip", "RHip"} <= set(load_shapes(tmp_path / "man.bvh")[0].landmark_names)


def test_markers_of_coco_have_the_names_of_models(tmp_path, lifted):
    names = np.array(["right_hip", "left_hip", "nose", "left_ear"], dtype=object)
    save(
        tmp_path / "man.trc",
        put(lifted, {"input_landmark_names": names}),
        markers="input",
    )
    assert parse_trc(tmp_path / "man.trc")[2] == ["RHip", "LHip", "Nose", "LEar"]


def test_without_landmarks_of_a_detector_there_are_no_markers(tmp_path, walk):
    with pytest.raises(InputError, match="lift them with `posterior` or `sequences`"):
        save(tmp_path / "man.trc", walk, markers="input")

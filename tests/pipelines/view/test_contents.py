"""What is on a page: numbers come back, frames are thinned, measures and pictures are
there.
"""

from base64 import b64decode

import numpy as np
import pytest

from shapefit.evaluation import metrics
from shapefit.geometry.floor import Floor
from shapefit.geometry.rotations import rotation_about_axis
from shapefit.io import (
    read_results,
    read_shapes,
    write_dictionary,
    write_shapes,
)
from shapefit.pipelines.view.layers import change_metres_to_cm_or_mm
from shapefit.pipelines.view.run import fitted_image
from shapefit.records import Shapes
from shapefit.viewer.page import as_json, block_of_points, viewer_page


def decoded(block):
    """Undo a block as blocks.js does."""
    codes = np.frombuffer(b64decode(block["data"]), "<" + block["type"]).reshape(
        block["shape"]
    )
    if "places" not in block:
        return codes
    places = decoded(block["places"]).astype(float)
    values = places[:, None, :-1] + places[:, None, -1:] * codes
    return np.where(codes == -32768, np.nan, values).swapaxes(1, 2)


def test_points_come_back_within_half_a_step_and_far_ones_do_not_spoil_the_others(rng):
    points = rng.normal(size=(50, 3, 4)) * np.array([1, 100, 5])[:, None] + 1000
    points[0] *= 1e9
    points[3, :, 2] = np.nan
    points[7, 0, 1] = np.inf
    back = decoded(block_of_points(points))
    known = np.isfinite(points).all(axis=1)
    steps = np.ptp(np.where(known[:, None], points, 1000), axis=2).max(axis=1) / 65534
    away = np.abs(back - points).max(axis=1)
    assert (away <= 0.6 * steps[:, None] + 1e-7 * np.abs(points).max(axis=1))[
        known
    ].all()
    assert np.isnan(back.swapaxes(1, 2)[~known]).all()


@pytest.mark.parametrize(
    ("largest", "kind"), [(255, "u1"), (256, "u2"), (65535, "u2"), (65536, "u4")]
)
def test_integers_take_as_few_bytes_as_they_need(largest, kind):
    assert as_json(np.array([largest]))["type"] == kind


def test_many_frames_are_thinned_by_sequence_and_the_page_says_so(desk, monkeypatch):
    monkeypatch.setattr("shapefit.pipelines.view.reading.MAX_MEGABYTES", 1)
    n = 20_000
    sequences = tuple("long" if i < n - 60 else f"short{i % 20}" for i in range(n))
    result = desk.result(n=n, sequences=sequences, frame_rate=60.0)
    scene = desk.scene(result)
    assert 100_000 < len(viewer_page(scene)) <= 1_000_000
    step = round(n / len(scene["items"]))
    assert step > 1
    assert scene["notes"][0].startswith(f"One of {step} frames is shown")
    assert scene["frame_rate"] == 60 / step
    assert scene["items"][:2] == ("i0", f"i{step}")
    assert len(scene["sequences"]) == 21
    expected = read_results(result).as_columns()[2 * step]
    np.testing.assert_allclose(scene["layers"][0]["points"][2], expected)
    few = desk.scene(result, items=("i19???",))
    assert len(few["items"]) == 1000
    assert few["frame_rate"] == 60
    some = desk.scene(result, items=("i*[0-2]",))
    assert some["items"][:3] == ("i0", "i10", "i20")  # every third of the chosen ones


def test_sequences_are_put_together_and_single_ones_are_none(desk):
    made = desk.view(desk.result(n=4, sequences=("x", "y", "x", "y")))
    assert made.data["items"] == ["i0", "i2", "i1", "i3"]
    assert made.data["sequences"] == [["x", 0], ["y", 2]]
    made = desk.view(desk.result(n=4, sequences=("x", "y", "z", "w")))
    assert made.data["sequences"] == [["", 0]]


def test_errors_and_trust_stand_in_the_chart_and_the_header(desk, rng):
    landmarks = desk.shapes(6)[:, :2]
    reasons = np.array(
        ["", "", "", "wide error bars", "", "implausible landmarks"], object
    )
    extras = {
        "landmarks": landmarks.swapaxes(1, 2),
        "p_value": np.linspace(0, 1, 6),
        "expected_error": np.array([1.0, 3, 5, 90, 7, 90]),
        "outliers": np.eye(6, 5, dtype=bool),
        "reasons": reasons,
    }
    status = np.array(
        ["optimal", "converged", "iteration limit", "degenerate", "x", "optimal"]
    )
    sd = np.full((6, 3, 5), 2.0)
    sd[1, :, 2] = np.nan
    result = desk.result(extras=extras, status=status, shape_sd=sd)
    made = desk.view(result, truth=(desk.truth(unit="mm"),))
    layer = made.data["layers"][0]
    measures = {measure["name"]: measure for measure in layer["measures"]}
    found = read_results(result)
    truth = read_shapes([desk.folder / "truth.h5"])
    error = metrics.similarity(found.as_columns(), truth.as_columns())
    in_mm = metrics.expected(
        found.as_columns(), truth.as_columns(), extras["expected_error"]
    )
    expected = {
        "error against the truth": ("mm", error),
        "expected error": ("mm", in_mm),  # in px in the file: units never mix
        "p-value": ("", extras["p_value"]),
        "reprojection": (
            "px",
            metrics.reprojection(found.as_columns()[:, :2], landmarks),
        ),
    }
    assert list(measures) == list(expected)
    for name, (unit, values) in expected.items():
        assert measures[name]["unit"] == unit
        np.testing.assert_allclose(
            decoded(measures[name]["values"]), values, rtol=0.004
        )
    words = [
        layer["status"]["words"][code] for code in decoded(layer["status"]["codes"])
    ]
    assert words == ["", "", "iteration limit", "degenerate", "x", ""]
    np.testing.assert_array_equal(decoded(made.data["outliers"]), extras["outliers"])
    typical = np.median(in_mm[reasons == ""])
    assert [fact["text"] for fact in made.data["facts"]] == [
        "6 images",
        "4 of 6 trusted",
        f"error against the truth {np.median(error):.2g} mm",
        f"typical error {typical:.2g} mm",
    ]


@pytest.mark.parametrize(
    ("lengths", "shown", "name"),
    [([0.06, 0.2], [6, 20], "cm"), ([0.002, 0.2], [2, 200], "mm")],
)
def test_lengths_of_a_page_have_one_unit(lengths, shown, name):
    measures = [
        {"name": "error", "values": np.full(3, x), "unit": "m"} for x in lengths
    ]
    pixels = {"name": "p", "values": np.ones(3), "unit": "px"}
    unit, many = change_metres_to_cm_or_mm(
        [{"measures": [one, pixels]} for one in measures]
    )
    assert [measure["values"][0] for measure in measures] == pytest.approx(shown)
    assert {measure["unit"] for measure in measures} == {unit} == {name}
    assert pixels["unit"] == "px"
    assert many == shown[0] / lengths[0]


def camera(n=4):
    """Columns of a result under a camera that was assumed, in which a unit is two
    metres.
    """
    return {
        "camera_translation": np.tile([0.5, -0.2, 8.0], (n, 1)),
        "focal": np.full((n, 2), 1400.0),
        "principal_point": np.tile([640.0, 360.0], (n, 1)),
        "metres_per_unit": np.full(n, 2 / 50),
    }


def test_shapes_stand_in_metres_where_the_camera_has_them(desk):
    n, scale, middle = 4, 50.0, np.array([700.0, 300.0])
    own = np.random.default_rng(1).normal(size=(n, 3, 5))
    own -= own.mean(axis=2, keepdims=True)
    shapes = scale * own + np.append(middle, 0.0)[:, None]
    place = {
        "rotation": np.tile(np.eye(3), (n, 1, 1)),
        "scale": np.full(n, scale),
        "translation": np.tile(middle, (n, 1)),
        "shapes": shapes,
    }
    sd = np.full((n, 3, 5), 5.0)
    result = desk.result(
        n=n, extras=camera(), shape_sd=sd, sequences=("s",) * n, **place
    )
    flat = desk.result("flat.h5", n=n, shapes=shapes, sequences=("s",) * n)
    page = desk.scene(result, flat)
    deep, beside = page["layers"]
    assert page["unit"] == "px"
    assert page["space_unit"] == "m"
    there = 2 * (own + camera()["camera_translation"][0][:, None])
    np.testing.assert_allclose(deep["points"], there)
    np.testing.assert_allclose(
        beside["points"], there
    )  # the same shapes, put where they are seen
    np.testing.assert_allclose(deep["sd"], 0.2)
    seen = 1400 * there[:, :2] / there[:, 2:] + [[640.0], [360.0]]
    f, c = deep["camera"][:, :2, None], deep["camera"][:, 2:, None]
    np.testing.assert_allclose(
        f * deep["points"][:, :2] / np.abs(deep["points"][:, 2:]) + c, seen
    )
    assert deep["perspective"]
    assert not beside["perspective"]
    np.testing.assert_allclose(beside["fitted"], shapes[:, :2])
    assert page["image"] == [1280, 720]


@pytest.mark.parametrize(
    ("unit", "shown"), [("m", ("cm", 200)), ("unknown", ("", None))]
)
def test_errors_are_in_metres_or_else_in_the_unit_of_the_truth(desk, unit, shown):
    extras = {"metres_per_unit": np.full(6, 2.0), "expected_error": np.ones(6)}
    page = desk.scene(desk.result(extras=extras), truth=(desk.truth(unit=unit),))
    error, expected = page["layers"][0]["measures"][:2]
    assert {error["unit"], expected["unit"]} == {shown[0]}
    if shown[1]:
        np.testing.assert_allclose(expected["values"], shown[1])


def test_without_a_camera_all_frames_have_one_scale(desk):
    shapes = desk.shapes(4)
    metres = np.array([0.01, 0.02, np.nan, 0.03])
    result = desk.result(n=4, shapes=shapes, extras={"metres_per_unit": metres})
    page = desk.scene(result)
    (layer,) = page["layers"]
    np.testing.assert_allclose(layer["points"], 0.02 * shapes)
    np.testing.assert_allclose(layer["camera"], np.tile([50.0, 50, 0, 0], (4, 1)))
    np.testing.assert_allclose(layer["fitted"], shapes[:, :2])
    assert page["space_unit"] == "m"
    assert not layer["perspective"]


def test_individuals_and_their_frames_are_counted(desk):
    extras = {
        "frame": np.r_[0:20, 0:20, 3],
        "reasons": np.array([""] * 20 + ["wide error bars"] * 20 + [""], object),
    }
    items = tuple(f"v/{'abc'[i // 20]}/{i}" for i in range(41))
    sequences = tuple(item[:3] for item in items)
    page = desk.scene(
        desk.result(n=41, items=items, sequences=sequences, extras=extras)
    )
    assert page["recordings"] == [[0, 1, 2]]
    assert [fact["text"] for fact in page["facts"]] == [
        "3 individuals",
        "20 frames",
        "24 Hz assumed",
        "21 of 41 trusted",
    ]


@pytest.mark.parametrize("y_axis", ["down", "up"])
def test_up_is_that_of_the_image_whatever_the_extrinsics(desk, y_axis):
    """Nobody says that an axis of a calibration is up."""
    names = ("lhip", "rhip", "lshoulder", "rshoulder", "nose")
    fields = {"shapes": desk.shapes(6), "y_axis": y_axis, "landmark_names": names}
    tilts = []
    for extras in ({"extrinsic_rotation": rotation_about_axis(0, np.array(0.3))}, {}):
        page = desk.scene(desk.result(extras=extras, **fields))
        tilts += [
            m["values"]
            for m in page["layers"][0]["measures"]
            if m["name"] == "trunk tilt"
        ]
    np.testing.assert_array_equal(*tilts)
    expected = np.diag([1.0, -1, -1] if y_axis == "down" else [1.0, 1, 1])
    np.testing.assert_array_equal(
        np.reshape(page["grounds"][0]["upright"], (3, 3)), expected
    )


def test_people_stand_on_the_floor_that_was_found(desk, monkeypatch):
    """A camera two metres up that looks down by 30 degrees; the other video has no
    floor.
    """
    n, tilt = 4, np.radians(30)
    up = np.array(
        [0.0, np.cos(tilt), np.sin(tilt)]
    )  # x right, y up, z towards the viewer
    floor = Floor(up, 2.0, 30.0, 0.0, 0.1, 3.0, 3.0)
    monkeypatch.setattr(
        "shapefit.pipelines.view.scene.find_floors", lambda *_: {"v": floor}
    )
    sequences = ("v/a", "v/a", "w/a", "w/a")
    place = {
        "rotation": np.tile(np.eye(3), (n, 1, 1)),
        "scale": np.full(n, 50.0),
        "translation": np.zeros((n, 2)),
        "sequences": sequences,
        "items": tuple(f"{name}/{i}" for i, name in enumerate(sequences)),
    }
    result = desk.result(n=n, extras=camera(), **place)
    page = desk.scene(result)
    on, without = page["grounds"]
    turned = np.reshape(on["upright"], (3, 3))
    np.testing.assert_allclose(turned @ (up * [1, -1, -1]), [0, 1, 0], atol=1e-12)
    np.testing.assert_allclose(turned @ [1, 0, 0], [1, 0, 0], atol=1e-12)
    assert on["floor"] == -2
    assert "floor" not in without
    np.testing.assert_array_equal(
        np.reshape(without["upright"], (3, 3)), np.diag([1, -1, -1])
    )
    assert page["assumed"][-1] == f"Floor from resting feet: {floor}."
    monkeypatch.setattr("shapefit.pipelines.view.scene.find_floors", lambda *_: {})
    page = desk.scene(result)
    assert "floor" not in page["grounds"][0]
    assert any("floor is not known" in line for line in page["assumed"])


def test_meshes_follow_the_coefficients(desk, made_dictionary, rng):
    write_dictionary(desk.folder / "dict.h5", made_dictionary)
    c = np.array([[1.0, 0, 0.5], [0, 2.0, 0], [np.nan] * 3])
    R = np.linalg.qr(rng.normal(size=(3, 3, 3)))[0]
    s = np.array([2.0, 3.0, 1.0])
    T = rng.normal(size=(3, 2))
    result = desk.result(n=3, coefficients=c, rotation=R, scale=s, translation=T)
    scene = desk.scene(result, dictionary=desk.folder / "dict.h5")
    assert not scene["video"]
    assert scene["rigid"]
    for i in range(2):
        expected = (
            s[i] * R[i] @ np.tensordot(c[i], made_dictionary.mesh_vertices, axes=1)
        )
        expected[:2] += T[i][:, None]
        np.testing.assert_allclose(fitted_image(scene, i).mesh, expected)
    assert fitted_image(scene, 2).mesh is None


@pytest.mark.parametrize(
    ("attributes", "fields"),
    [
        ({"method": "pmp"}, {}),
        ({}, {"coefficients": np.ones((6, 2))}),
        ({}, {"rotation": None}),
    ],
)
def test_meshes_that_cannot_follow(desk, made_dictionary, attributes, fields):
    write_dictionary(desk.folder / "dict.h5", made_dictionary)
    pose = {
        "coefficients": np.ones((6, 3)),
        "rotation": np.tile(np.eye(3), (6, 1, 1)),
        "scale": np.ones(6),
        "translation": np.zeros((6, 2)),
    }
    result = desk.result(attributes=attributes, **(pose | fields))
    made = desk.view(result, dictionary=desk.folder / "dict.h5")
    assert "mixes no atoms of this dictionary" in made.notes
    assert "blend" not in made.data["layers"][0]


def test_pictures_lie_under_their_frames(desk):
    from PIL import Image

    images = desk.folder / "images"
    (images / "deep").mkdir(parents=True)
    Image.new("RGB", (2000, 1000), "red").save(images / "i1.jpg")
    Image.new("L", (20, 10)).save(images / "deep" / "i3.png")
    Image.new("L", (20, 10)).save(desk.folder / "secret.png")
    result = desk.result(
        items=("i0", "x/i1", "i2", "deep/i3", "../secret", "/etc/hosts")
    )
    made = desk.view(result, images=images)
    assert {k: v["size"] for k, v in made.data["pictures"].items()} == {
        "1": [2000, 1000],
        "3": [20, 10],
    }
    assert made.data["pictures"]["1"]["data"].startswith("data:image/jpeg;base64,")


def test_pictures_of_a_video_are_numbered(desk):
    from PIL import Image

    images = desk.folder / "frames"
    images.mkdir()
    for number in (8, 9, 10):  # programs count from any number
        Image.new("L", (10 * number, 10)).save(images / f"film_{number}.png")
    (images / "notes.txt").write_text("nothing")
    result = desk.result(items=("v/a/0", "v/a/2", "v/b/2", "v/b/3", "v/c", "v/b/1"))
    found = desk.view(result, images=images).data["pictures"]
    assert {frame: each["size"][0] for frame, each in found.items()} == {
        "0": 80,
        "1": 100,
        "2": 100,
        "5": 90,
    }


def test_what_is_wrong_with_photographs_is_said(desk, rng):
    """The page is made with those that are right."""
    from PIL import Image

    images = desk.folder / "photos"
    images.mkdir()
    for name, size in (("i0", (640, 360)), ("i1", (1280, 720)), ("i2", (300, 400))):
        Image.new("RGB", size).save(images / f"{name}.png")
    (images / "i3.jpg").write_bytes(rng.bytes(300))
    turned = Image.Exif()
    turned[0x0112] = 6  # held upright: a quarter turn
    Image.new("RGB", (720, 1280)).save(images / "i4.jpg", exif=turned)
    size = {"image_size": np.tile([1280.0, 720.0], (6, 1))}
    shapes = desk.shapes(6)
    seen = {"landmarks": shapes[:, :2].swapaxes(1, 2)} | size
    made = desk.view(desk.result(shapes=shapes, extras=seen), images=images)
    assert {k: v["size"] for k, v in made.data["pictures"].items()} == {
        "0": [1280, 720],  # a smaller copy
        "1": [1280, 720],
        "2": [300, 400],
        "4": [1280, 720],
    }
    assert "1 frame of 6 without a photograph in photos." in made.notes
    assert "1 photograph cannot be read, such as i3.jpg (" in made.notes
    shape = "1 photograph not of the shape of the images, which are 1280 x 720: "
    assert shape in made.notes
    assert "such as on i2.png, 300 x 400." in made.notes


def test_what_metres_rest_on_is_said(desk):
    sides = ("hip", "knee", "ankle", "shoulder")
    names = tuple(f"{side}{joint}" for joint in sides for side in "rl")
    how = {"extras": camera(), "landmark_names": names, "shapes": desk.shapes(4, 8)}
    for attributes, height, about, said in (
        ({}, False, "", ["Sizes are those of the training shapes: `fit --height`"]),
        ({}, True, "", []),
        ({"assumed_focal": 900.0}, True, "about ", ["Focal length assumed (900 px)"]),
    ):
        stated = {"stated_height": np.full(4, 1.8)} if height else {}
        page = desk.scene(desk.result(attributes=attributes, **how, **stated))
        assert page["about"] == about
        assert len(page["assumed"]) == len(said) + 1
        for sentence, beginning in zip(page["assumed"], said, strict=False):
            assert sentence.startswith(beginning)


def test_frame_rates_come_from_the_config_the_result_or_the_truth(desk):
    result = desk.result(sequences=("s",) * 6, frame_rate=30.0)
    assert desk.view(result).data["frame_rate"] == 30
    assert desk.view(result, frame_rate=12.5).data["frame_rate"] == 12.5
    plain = desk.view(desk.result(sequences=("s",) * 6)).data
    assert plain["frame_rate"] == 24
    assert not plain["rate_known"]


def test_what_was_seen_of_joints_is_seen_of_the_landmarks_that_stand_for_them(desk):
    """Where the landmarks of the detector are shown, for the truth has their names."""
    seen = desk.shapes(6)[:, :2].swapaxes(1, 2)
    names = ["RKnee", "Nose", "LHip", "RHip"]
    columns = {
        "landmarks": seen,
        "input_shapes": desk.shapes(6, 4).swapaxes(1, 2),
        "input_landmark_names": np.array(names, dtype=object),
    }
    result = desk.result(
        landmark_names=("pelvis", "rhip", "rknee", "lhip", "lknee"), extras=columns
    )
    truth = desk.folder / "of_names.h5"
    write_shapes(
        truth,
        Shapes(
            desk.shapes(6, 4).swapaxes(1, 2),
            landmark_names=tuple(names),
            items=tuple(f"i{i}" for i in range(6)),
        ),
    )
    page = desk.scene(result, truth=(truth,))
    assert page["landmarks"] == tuple(names)
    expected = seen[:, [2, 0, 3, 1]].swapaxes(1, 2)
    expected[:, :, 1] = np.nan
    np.testing.assert_allclose(page["observed"], expected)


def test_joint_angles_have_bands_from_the_error_bars(desk):
    names = ("rhip", "rknee", "rankle", "neck", "head")
    bent = np.array([[0.0, 0, 0], [0, 10, 0], [10, 10, 0], [0, -10, 0], [0, -12, 0]]).T
    shapes = np.tile(bent, (6, 1, 1))
    sd = np.full((6, 3, 5), 0.1)
    made = desk.view(desk.result(shapes=shapes, shape_sd=sd, landmark_names=names))
    measures = {
        measure["name"]: measure for measure in made.data["layers"][0]["measures"]
    }
    knee = measures["knee angle r"]
    assert knee["unit"] == "°"
    np.testing.assert_allclose(decoded(knee["values"]), 90, atol=1e-4)
    np.testing.assert_allclose(decoded(knee["sd"]), np.degrees(0.01 * 2), rtol=0.01)

"""Shapes of a page stand in metres, upright and on the floor."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from shapefit.geometry.floor import Floor
from shapefit.geometry.rotations import rotation_about_axis

FOCAL = 1400.0


CENTRE = np.array([640.0, 360.0])


FROM_CAMERA = np.array([0.5, -0.2, 8.0])
"""Where bodies are, in units of the dictionary."""


def camera(n=4):
    """Columns of a result under a camera that was assumed, in which a unit is two
    metres.
    """
    return {
        "camera_translation": np.tile(FROM_CAMERA, (n, 1)),
        "focal": np.full((n, 2), FOCAL),
        "principal_point": np.tile(CENTRE, (n, 1)),
        "metres_per_unit": np.full(n, 2 / 50),
    }


@pytest.fixture
def two_layers(desk):
    """The page of the same four shapes under a camera and without one; the shapes
    (4, 3, 5) in pixels, and in metres from the camera.
    """
    n = 4
    scale = 50.0
    place = np.array([700.0, 300.0])
    bodies = np.random.default_rng(1).normal(size=(n, 3, 5))
    bodies -= bodies.mean(axis=2, keepdims=True)
    shapes = scale * bodies + np.append(place, 0.0)[:, None]
    in_metres = 2 * (bodies + FROM_CAMERA[:, None])
    fields = {"n": n, "shapes": shapes, "sequences": ("s",) * n}
    deep = desk.result(
        extras=camera(),
        shape_sd=np.full((n, 3, 5), 5.0),
        rotation=np.tile(np.eye(3), (n, 1, 1)),
        scale=np.full(n, scale),
        translation=np.tile(place, (n, 1)),
        **fields,
    )
    flat = desk.result("flat.h5", **fields)
    return desk.scene(deep, flat), shapes, in_metres


def test_shapes_stand_in_metres_where_the_camera_has_them(two_layers):
    page, _, in_metres = two_layers
    deep, _ = page["layers"]
    assert page["unit"] == "px"
    assert page["space_unit"] == "m"
    assert_allclose(deep["points"], in_metres)
    assert_allclose(deep["sd"], 0.2)


def test_the_camera_of_a_page_sees_shapes_where_they_were_seen(two_layers):
    page, _, in_metres = two_layers
    deep, _ = page["layers"]
    seen = FOCAL * in_metres[:, :2] / in_metres[:, 2:] + CENTRE[:, None]
    focal = deep["camera"][:, :2, None]
    centre = deep["camera"][:, 2:, None]
    depth = np.abs(deep["points"][:, 2:])
    projected = focal * deep["points"][:, :2] / depth + centre
    assert deep["perspective"]
    assert_allclose(projected, seen)
    assert page["image"] == [1280, 720]


def test_shapes_without_a_camera_are_put_where_they_are_seen(two_layers):
    page, shapes, in_metres = two_layers
    _, beside = page["layers"]
    assert not beside["perspective"]
    assert_allclose(beside["points"], in_metres)
    assert_allclose(beside["fitted"], shapes[:, :2])


def test_without_a_camera_all_frames_have_one_scale(desk):
    shapes = desk.shapes(4)
    metres = np.array([0.01, 0.02, np.nan, 0.03])
    result = desk.result(n=4, shapes=shapes, extras={"metres_per_unit": metres})
    page = desk.scene(result)
    (layer,) = page["layers"]
    expected_camera = np.tile([50.0, 50, 0, 0], (4, 1))
    assert_allclose(layer["points"], 0.02 * shapes)
    assert_allclose(layer["camera"], expected_camera)
    assert_allclose(layer["fitted"], shapes[:, :2])
    assert page["space_unit"] == "m"
    assert not layer["perspective"]


def upright(ground):
    """Return the rotation (3, 3) that makes a ground level."""
    return np.reshape(ground["upright"], (3, 3))


HALF_TURN = np.diag([1.0, -1, -1])
"""From y down to y up."""


BODY = ("lhip", "rhip", "lshoulder", "rshoulder", "nose")


UP_OF_IMAGES = [("down", HALF_TURN), ("up", np.eye(3))]


@pytest.mark.parametrize(("y_axis", "expected"), UP_OF_IMAGES)
def test_up_is_that_of_the_image_whatever_the_extrinsics(desk, y_axis, expected):
    """Nobody says that an axis of a calibration is up."""
    fields = {"shapes": desk.shapes(6), "y_axis": y_axis, "landmark_names": BODY}
    extrinsics = {"extrinsic_rotation": rotation_about_axis(0, np.array(0.3))}
    tilts = []
    for extras in (extrinsics, {}):
        page = desk.scene(desk.result(extras=extras, **fields))
        measures = {each["name"]: each for each in page["layers"][0]["measures"]}
        tilts.append(measures["trunk tilt"]["values"])
        assert_array_equal(upright(page["grounds"][0]), expected)
    with_extrinsics, without = tilts
    assert_array_equal(with_extrinsics, without)


TILT = np.radians(30)


UP = np.array([0.0, np.cos(TILT), np.sin(TILT)])
"""x right, y up, z towards the viewer."""


FLOOR = Floor(UP, 2.0, 30.0, 0.0, 0.1, 3.0, 3.0)
"""Of a camera two metres up that looks down by 30 degrees."""


@pytest.fixture
def two_videos(desk):
    """A result of the videos v and w, of two frames each."""
    n = 4
    sequences = ("v/a", "v/a", "w/a", "w/a")
    return desk.result(
        n=n,
        extras=camera(),
        rotation=np.tile(np.eye(3), (n, 1, 1)),
        scale=np.full(n, 50.0),
        translation=np.zeros((n, 2)),
        sequences=sequences,
        items=tuple(f"{name}/{i}" for i, name in enumerate(sequences)),
    )


@pytest.fixture
def find_floors(monkeypatch):
    """Let these be the floors of videos."""

    def patch(floors):
        name = "shapefit.pipelines.view.scene.find_floors"
        monkeypatch.setattr(name, lambda *_: floors)

    return patch


def test_people_stand_on_the_floor_that_was_found(desk, two_videos, find_floors):
    find_floors({"v": FLOOR})
    page = desk.scene(two_videos)
    ground, _ = page["grounds"]
    turn = upright(ground)
    assert_allclose(turn @ HALF_TURN @ UP, [0, 1, 0], atol=1e-12)
    assert_allclose(turn @ [1, 0, 0], [1, 0, 0], atol=1e-12)
    assert ground["floor"] == -2
    assert page["assumed"][-1] == f"Floor from resting feet: {FLOOR}."


def test_a_video_beside_it_may_have_no_floor(desk, two_videos, find_floors):
    find_floors({"v": FLOOR})
    _, ground = desk.scene(two_videos)["grounds"]
    assert "floor" not in ground
    assert_array_equal(upright(ground), HALF_TURN)


def test_a_floor_that_is_not_known_is_said(desk, two_videos, find_floors):
    find_floors({})
    page = desk.scene(two_videos)
    assert "floor" not in page["grounds"][0]
    assert any("floor is not known" in line for line in page["assumed"])


JOINTS = ("hip", "knee", "ankle", "shoulder")


BOTH_SIDES = tuple(f"{side}{joint}" for joint in JOINTS for side in "rl")


STATED_HEIGHT = {"stated_height": np.full(4, 1.8)}


METRES_REST_ON = {
    "the dictionary": (
        {},
        "",
        ["Sizes are those of the training shapes: `fit --height`"],
    ),
    "a height": (STATED_HEIGHT, "", []),
    "an assumed camera": (
        {**STATED_HEIGHT, "attributes": {"assumed_focal": 900.0}},
        "about ",
        ["Focal length assumed (900 px)"],
    ),
}
"""Fields of a result, the word before its lengths, and how what is assumed begins."""


@pytest.mark.parametrize(
    ("fields", "about", "beginnings"), METRES_REST_ON.values(), ids=METRES_REST_ON
)
def test_what_metres_rest_on_is_said(desk, fields, about, beginnings):
    result = desk.result(
        shapes=desk.shapes(4, 8), extras=camera(), landmark_names=BOTH_SIDES, **fields
    )
    page = desk.scene(result)
    *sentences, _about_the_floor = page["assumed"]
    assert page["about"] == about
    for sentence, beginning in zip(sentences, beginnings, strict=True):
        assert sentence.startswith(beginning)

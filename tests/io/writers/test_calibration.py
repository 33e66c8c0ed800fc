"""Cameras of results as TOML: they see the files in metres where the landmarks are."""

import json
import tomllib
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from shapefit.errors import InputError
from shapefit.geometry.floor import Floor
from shapefit.geometry.pinhole import ASSUMED_FOCAL
from shapefit.io.readers.calibration import read_camera
from shapefit.io.writers import calibration, motion
from shapefit.records import concatenate
from tests.columns import put
from tests.io.files import save
from tests.io.writers.conftest import CENTRE, FOCAL, trc_points


@pytest.fixture
def target(tmp_path):
    return tmp_path / "walk.toml"


@pytest.fixture
def filmed(scene):
    """The result of the scene with its camera, as a fit stores it."""
    count = len(scene.result)
    focal = np.full((count, 2), FOCAL)
    centre = np.tile(CENTRE, (count, 1))
    return replace(scene.result, focal=focal, principal_point=centre)


@pytest.fixture
def filmed_alone(filmed):
    """The result without the place of its camera in the world."""
    return filmed.without({"extrinsic_rotation", "extrinsic_translation"})


def project(camera, points):
    """Return where a camera sees points (f, 3, p) of its world, in pixels."""
    from_camera = camera.rotation @ points + camera.translation[:, None]
    image = camera.matrix @ from_camera
    return image[:, :2] / image[:, 2:]


def landmarks_of(record):
    """Return where the shapes of a record lie in the image, (n, 2, p)."""
    shapes = record.as_columns().copy()
    shapes[:, :2] -= record.translation[..., None]
    scaled = shapes / record.scale[:, None, None]
    from_camera = scaled + record.camera_translation[..., None]
    return CENTRE[:, None] + FOCAL * from_camera[:, :2] / from_camera[:, 2:]


FLOOR = Floor(np.array([0.1, 0.9, 0.2]) / 0.86**0.5, 1.5, -12.0, 6.0, 0.1, 2.0, 2.0)


def check_camera(folder, record):
    """Assert that the camera sees the points in metres on the landmarks; return it."""
    save(folder / "walk.trc", record)
    save(folder / "walk.toml", record)
    points = trc_points(folder / "walk.trc")
    camera = read_camera(folder / "walk.toml", None)
    image = project(camera, points)
    assert_allclose(image, landmarks_of(record), atol=1e-3)
    return camera


def test_points_in_the_world_of_extrinsics_lie_on_the_landmarks(tmp_path, filmed):
    check_camera(tmp_path, filmed)


def test_points_before_the_camera_lie_on_the_landmarks(tmp_path, filmed_alone):
    check_camera(tmp_path, filmed_alone)


def test_points_on_the_floor_lie_on_the_landmarks(tmp_path, filmed_alone, monkeypatch):
    floors = {"film": FLOOR}
    for module in (motion, calibration):
        monkeypatch.setattr(module, "find_floors", lambda *_: floors)
    camera = check_camera(tmp_path, filmed_alone)
    position = -camera.rotation.T @ camera.translation
    assert position[1] == pytest.approx(1.5)


LENS = np.array([-0.1, 0.01, 0.001, 0.002, 0, 0, 0, 0])


@pytest.fixture
def with_lens(filmed):
    return filmed.with_file_extras(
        {"removed_distortion": LENS, "image_size": np.array([1280, 960])}
    )


def test_a_section_has_what_pose2sim_and_anipose_read(target, with_lens):
    save(target, with_lens)
    content = tomllib.loads(target.read_text(encoding="utf-8"))
    ((key, section),) = content.items()
    assert key == "cam01"
    assert section["name"] == "film"
    assert section["size"] == [1280.0, 960.0]
    assert section["matrix"] == [[1000.0, 0.0, 640.0], [0.0, 1000.0, 480.0], [0, 0, 1]]
    assert section["distortions"] == [-0.1, 0.01, 0.001, 0.002]
    assert len(section["rotation"]) == 3
    assert len(section["translation"]) == 3
    assert section["fisheye"] is False


def size_in(path):
    """Return the size of the images of the one camera in a file."""
    ((_, section),) = tomllib.loads(path.read_text(encoding="utf-8")).items()
    return section["size"]


def test_the_size_of_images_is_that_of_the_file(target, filmed):
    of_file = put(filmed, {}, {"image_size": np.array([1920, 1080])})
    save(target, of_file)
    assert size_in(target) == [1920, 1080]


def test_else_it_is_the_one_that_the_fit_was_told(target, filmed):
    config = {"config": json.dumps({"image_size": [1920, 1080]})}
    save(target, replace(filmed, attributes={**filmed.attributes, **config}))
    assert size_in(target) == [1920, 1080]


def test_else_the_principal_point_is_taken_for_the_middle(target, filmed):
    save(target, filmed)
    assert size_in(target) == (2 * CENTRE).tolist()


def test_the_lens_comes_back(target, with_lens):
    save(target, with_lens)
    camera = read_camera(target, "film")
    assert_array_equal(camera.distortion, LENS)


def test_each_video_has_its_camera(target, filmed_alone):
    other = replace(
        filmed_alone,
        items=tuple("abcd"),
        sequences=('day "2"/ben',) * 4,
        focal=2 * filmed_alone.focal,
    )
    summary = save(target, concatenate([filmed_alone, other]))
    first = read_camera(target, "film")
    second = read_camera(target, 'day "2"')
    assert summary.note.startswith("2 cameras, in m, y up as in the image")
    assert first.matrix[0, 0] == FOCAL
    assert second.matrix[0, 0] == 2 * FOCAL


def test_a_known_focal_length_is_not_warned_of(target, filmed):
    assert not save(target, filmed).warnings


def test_an_assumed_focal_length_is_warned_of(target, filmed):
    focal = np.full((4, 2), ASSUMED_FOCAL * 1280)
    assumed = replace(filmed, focal=focal)
    (warning,) = save(target, assumed).warnings
    assert warning.startswith("the focal length was assumed, not measured")
    assert f"# Beware: {warning}" in target.read_text("utf-8")


def with_changing_focal(record):
    factors = np.arange(1, 5)[:, None]
    return replace(record, focal=record.focal * factors)


REFUSED = {
    "there is no perspective camera": lambda one: replace(one, focal=None),
    "y of the landmarks points up": lambda one: replace(one, y_axis="up"),
    "no image has a camera": lambda one: replace(one, focal=np.nan * one.focal),
    "`focal` changes from image to image": with_changing_focal,
}
"""What is wrong, and what makes it so."""


@pytest.mark.parametrize("message", REFUSED)
def test_what_is_no_camera_at_rest_is_refused(tmp_path, target, filmed, message):
    changed = REFUSED[message](filmed)
    with pytest.raises(InputError, match=f"walk.toml: {message}"):
        save(target, changed)
    assert not [*tmp_path.iterdir()]

"""Cameras of results as TOML: they see the files in metres where the landmarks are."""

import tomllib
from dataclasses import replace

import numpy as np
import pytest

from shapefit.errors import InputError
from shapefit.geometry.floor import Floor
from shapefit.geometry.pinhole import ASSUMED_FOCAL
from shapefit.io.readers.calibration import read_camera
from shapefit.io.writers import motion
from shapefit.records import concatenate
from tests.io.files import save
from tests.io.writers.conftest import CENTRE, FOCAL, trc_points


@pytest.fixture
def filmed(scene):
    """The result of the scene with its camera, as a fit stores it."""
    n = len(scene.result)
    return replace(
        scene.result,
        focal=np.full((n, 2), FOCAL),
        principal_point=np.tile(CENTRE, (n, 1)),
    )


def without_extrinsics(record):
    return record.without({"extrinsic_rotation", "extrinsic_translation"})


def project(camera, points):
    """Return where a camera sees points (f, 3, p) of its world, in pixels."""
    there = camera.rotation @ points + camera.translation[:, None]
    seen = camera.matrix @ there
    return seen[:, :2] / seen[:, 2:]


def landmarks_of(record):
    """Return where the shapes of a record lie in the image, (n, 2, p)."""
    shapes = record.as_columns().copy()
    shapes[:, :2] -= record.translation[..., None]
    there = shapes / record.scale[:, None, None] + record.camera_translation[..., None]
    return CENTRE[:, None] + FOCAL * there[:, :2] / there[:, 2:]


FLOOR = Floor(np.array([0.1, 0.9, 0.2]) / 0.86**0.5, 1.5, -12.0, 6.0, 0.1, 2.0, 2.0)


@pytest.mark.parametrize("world", ["extrinsics", "camera", "floor"])
def test_points_in_metres_lie_on_the_landmarks(tmp_path, filmed, monkeypatch, world):
    if world != "extrinsics":
        filmed = without_extrinsics(filmed)
    if world == "floor":
        floors = {"film": FLOOR}
        for module in (motion, calibration_writer()):
            monkeypatch.setattr(module, "find_floors", lambda *_: floors)
    save(tmp_path / "walk.trc", filmed)
    save(tmp_path / "walk.toml", filmed)
    points = trc_points(tmp_path / "walk.trc")
    camera = read_camera(tmp_path / "walk.toml", None)
    np.testing.assert_allclose(project(camera, points), landmarks_of(filmed), atol=1e-3)
    if world == "floor":
        assert (-camera.rotation.T @ camera.translation)[1] == pytest.approx(1.5)


def calibration_writer():
    from shapefit.io.writers import calibration

    return calibration


def test_a_section_has_what_pose2sim_and_anipose_read(tmp_path, filmed):
    lens = np.array([-0.1, 0.01, 0.001, 0.002, 0, 0, 0, 0])
    filmed = filmed.with_file_extras(
        {"removed_distortion": lens, "image_size": np.array([1280, 960])}
    )
    save(tmp_path / "walk.toml", filmed)
    content = tomllib.loads((tmp_path / "walk.toml").read_text(encoding="utf-8"))
    assert [*content] == ["cam01"]
    section = content["cam01"]
    assert section["name"] == "film"
    assert section["size"] == [1280.0, 960.0]
    assert section["matrix"] == [[1000.0, 0.0, 640.0], [0.0, 1000.0, 480.0], [0, 0, 1]]
    assert section["distortions"] == [-0.1, 0.01, 0.001, 0.002]
    assert [len(section[key]) for key in ("rotation", "translation")] == [3, 3]
    assert section["fisheye"] is False
    camera = read_camera(tmp_path / "walk.toml", "film")
    np.testing.assert_array_equal(camera.distortion, lens)


def test_each_video_has_its_camera(tmp_path, filmed):
    filmed = without_extrinsics(filmed)
    other = replace(
        filmed,
        items=tuple("abcd"),
        sequences=('day "2"/ben',) * 4,
        focal=2 * filmed.focal,
    )
    summary = save(tmp_path / "walk.toml", concatenate([filmed, other]))
    assert summary.note.startswith("2 cameras, in m, y up as in the image")
    focals = [
        read_camera(tmp_path / "walk.toml", name).matrix[0, 0]
        for name in ("film", 'day "2"')
    ]
    assert focals == [FOCAL, 2 * FOCAL]


def test_an_assumed_focal_length_is_warned_of(tmp_path, filmed):
    assert not save(tmp_path / "walk.toml", filmed).warnings
    assumed = np.full((4, 2), ASSUMED_FOCAL * 1280)
    (warning,) = save(tmp_path / "walk.toml", replace(filmed, focal=assumed)).warnings
    assert warning.startswith("the focal length was assumed, not measured")
    assert f"# Beware: {warning}" in (tmp_path / "walk.toml").read_text("utf-8")


REFUSED = {
    "there is no perspective camera": lambda one: replace(one, focal=None),
    "y of the landmarks points up": lambda one: replace(one, y_axis="up"),
    "no image has a camera": lambda one: replace(one, focal=np.nan * one.focal),
    "`focal` changes from image to image": lambda one: replace(
        one, focal=one.focal * np.arange(1, 5)[:, None]
    ),
}


@pytest.mark.parametrize("message", REFUSED)
def test_what_is_no_camera_at_rest_is_refused(tmp_path, filmed, message):
    with pytest.raises(InputError, match=f"walk.toml: {message}"):
        save(tmp_path / "walk.toml", REFUSED[message](filmed))
    assert not [*tmp_path.iterdir()]

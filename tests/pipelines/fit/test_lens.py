"""Lens distortion is removed before a fit, once, and the result says so."""

import numpy as np
import pytest

from shapefit.geometry.pinhole import complete, distort
from shapefit.io import write_dictionary
from shapefit.io.records import LandmarkSet
from shapefit.pipelines.fit.camera import undistorted
from shapefit.pipelines.verify import Request
from shapefit.pipelines.verify import run as run_verify
from tests.io.files import save
from tests.pipelines.told import failures

MATRIX = np.array([[800.0, 0, 640], [0, 820, 360], [0, 0, 1]])
LENS = np.array([-0.25, 0.08, 0.002, -0.001, 0.0])
SIZE = np.array([1280, 720])
FOCAL, CENTRE = np.diag(MATRIX)[:2, None], MATRIX[:2, 2, None]


@pytest.fixture
def views(made_cars, rng):
    """Cars before a camera, as a lens without and with distortion shows them, in pixels."""
    names = made_cars.landmark_names
    shapes = made_cars.atoms[:4] + np.array([[0.2], [0.1], [7.0]])
    plane = shapes[:, :2] / shapes[:, 2:]

    def images(points, **datasets):
        return LandmarkSet(
            landmarks=CENTRE + FOCAL * points,
            landmark_names=names,
            items=tuple("abcd"),
            unit="px",
            y_axis="down",
            columns=datasets,
        )

    straight = images(plane, camera_matrix=MATRIX)
    bent = images(distort(plane, complete(LENS)), camera_matrix=MATRIX, distortion=LENS)
    return straight, bent


@pytest.fixture
def fit(fit, tmp_path, made_cars):
    """Return what fits images with the cars: the result and the warnings."""

    def fitted(images, **settings):
        write_dictionary(tmp_path / "cars.h5", made_cars)
        result, outcomes = fit(tmp_path / "cars.h5", images, **settings)
        return result, [text for outcome in outcomes for text in outcome.warnings]

    return fitted


def toml(tmp_path, lens):
    path = tmp_path / "calibration.toml"
    rows = ", ".join(str(row.tolist()) for row in MATRIX)
    path.write_text(
        f"[cam_0]\nname = 'left'\nsize = [1280, 720]\nmatrix = [{rows}]\n"
        f"distortions = {lens.tolist()}\nrotation = [0.1, 0.2, 0.3]\n"
        "translation = [1.0, 2.0, 3.0]\n"
    )
    return path


def test_a_distorted_image_fits_like_a_straight_one(views, fit):
    straight, bent = views
    want, _ = fit(straight)
    found, _ = fit(bent)
    np.testing.assert_allclose(found.shapes, want.shapes, atol=1e-4 * np.ptp(want.shapes))
    np.testing.assert_allclose(
        found.columns["landmarks"], straight.landmarks.swapaxes(1, 2), atol=1e-8
    )


def test_the_result_says_so_and_nothing_removes_it_twice(views, fit):
    _, bent = views
    result, _ = fit(bent)
    np.testing.assert_array_equal(result.columns["removed_distortion"], LENS)
    assert "distortion" not in result.columns
    once = undistorted(bent, None)
    assert undistorted(once, None).landmarks is not None
    np.testing.assert_array_equal(undistorted(once, None).landmarks, once.landmarks)


def test_verify_knows_what_was_removed(views, fit, tmp_path):
    _, bent = views
    fit(bent)

    def verify(name):
        request = Request(tmp_path / "result.h5", tmp_path / "cars.h5", (tmp_path / name,))
        return list(failures(run_verify(request)))

    assert verify("views.h5") == []
    shifted = bent.landmarks + 1e-3 * (np.arange(4) == 2)[:, None, None]
    save(tmp_path / "shifted.h5", bent.replaced(landmarks=shifted))
    assert "c" in verify("shifted.h5")


def test_a_calibration_gives_camera_lens_and_place(views, fit, tmp_path):
    straight, bent = views
    camera = {"calibration": toml(tmp_path, LENS), "name": "left"}
    want, _ = fit(straight, camera={"focal": "files"},
                  method="convex+refine")  # fmt: skip
    found, _ = fit(bent.replaced(further={}), camera=camera, method="convex+refine")
    np.testing.assert_allclose(found.shapes, want.shapes, atol=1e-4 * np.ptp(want.shapes))
    np.testing.assert_array_equal(found.columns["extrinsic_translation"], [1, 2, 3])
    assert found.columns["extrinsic_rotation"].shape == (3, 3)
    np.testing.assert_array_equal(found.columns["image_size"], SIZE)
    np.testing.assert_allclose(found.columns["focal"], np.tile([800, 820], (4, 1)))


def test_cameras_of_single_images_and_y_that_points_up(views):
    straight, bent = views
    turned = np.diag([1.0, -1.0, 1.0]) @ MATRIX @ np.diag([1.0, -1.0, 1.0])
    up = bent.replaced(
        landmarks=bent.landmarks * np.array([[1.0], [-1.0]]),
        y_axis="up",
        further={"camera_matrix": np.tile(turned, (4, 1, 1)), "distortion": np.tile(LENS, (4, 1))},
    )
    found = undistorted(up, None)
    np.testing.assert_allclose(
        found.landmarks * np.array([[1.0], [-1.0]]), straight.landmarks, atol=1e-8
    )
    assert found.columns["removed_distortion"].shape == (4, 5)

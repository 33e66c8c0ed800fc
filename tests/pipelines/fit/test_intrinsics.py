"""Cameras from configs and landmark files, what no camera is, and refinement through them."""

import numpy as np
import pytest

from shapefit.convex.solver import Status
from shapefit.errors import InputError
from shapefit.geometry.rotations import rotation_angle
from shapefit.io import LandmarkSet, read_shapes, write_dictionary
from shapefit.pipelines.fit.camera import Intrinsics, find_camera
from tests.io.files import load
from tests.pipelines.told import failures, warnings

N = 4
MATRIX = np.array([[800.0, 0, 320], [0, 810, 240], [0, 0, 1]])


def images(y_axis="down", **extras):
    return LandmarkSet(
        landmarks=np.zeros((N, 2, 5)),
        landmark_names=tuple("abcde"),
        items=tuple("wxyz"),
        y_axis=y_axis,
        columns={name: values for name, values in extras.items() if np.shape(values)[:1] == (N,)},
        whole={name: values for name, values in extras.items() if np.shape(values)[:1] != (N,)},
    )


def camera(images, focal=None, centre=None):
    dataset = "camera_matrix" if focal is None else None
    return find_camera(images, Intrinsics(focal or 0.0, centre, dataset))


EACH = MATRIX * np.array([1, 2, 3, 4])[:, None, None]
EACH[:, 2, 2] = 1

SKEWED = MATRIX + np.array([[0, 3.0, 0], [0, 0, 0], [0, 0, 0]])


@pytest.mark.parametrize(
    ("values", "keys", "focal", "centre"),
    [
        (None, {"focal": 700.0}, [700, 700], [0, 0]),
        (np.float64(700), {}, [700, 700], [0, 0]),
        (np.array([700.0]), {}, [700, 700], [0, 0]),
        (np.full(N, 700.0), {}, [700, 700], [0, 0]),
        (MATRIX, {}, [800, 810], [320, 240]),
        (MATRIX, {"centre": (1.0, 2.0)}, [800, 810], [1, 2]),
        (EACH, {}, EACH[:, [0, 1], [0, 1]], EACH[:, :2, 2]),
        (SKEWED, {}, [800, 810], [320, 240]),
    ],
    ids=["config", "file", "one", "each", "matrix", "principal point", "matrix of each", "skewed"],
)
def test_cameras_of_the_config_the_file_or_each_image(values, keys, focal, centre):
    given = {} if values is None else {"camera_matrix": values}
    found = camera(images(**given), **keys)
    np.testing.assert_array_equal(found.focal, np.broadcast_to(focal, (N, 2)))
    np.testing.assert_array_equal(found.centre, np.broadcast_to(centre, (N, 2)))


@pytest.mark.parametrize(
    ("values", "words"),
    [
        (None, ["no such dataset", "CSV holds no datasets"]),
        (np.zeros((N, 2)), ["shape (4, 2)", "4 of them"]),
        (np.array(["a"] * N), ["holds no numbers"]),
        (MATRIX.T, ["800 0 0, 0 810 0, 320 240 1", "fx 0 cx"]),
        (2 * MATRIX, ["0 0 2", "fx 0 cx"]),
        (-MATRIX + np.diag([0, 0, 2]), ["<= 0, -810"]),
        (np.array([1.0, 0.0, 1.0, 1.0]), ["a focal length <= 0, 0", "> 0"]),
        (np.array([1.0, np.nan, 1.0, 1.0]), ["not finite"]),
        (MATRIX * np.array([[1, 1, np.inf]] * 3), ["not finite"]),
        (MATRIX + 0j, ["holds no numbers"]),
    ],
)
def test_what_is_no_camera_is_refused(values, words):
    extras = {"true_model": np.array(["m"] * N)}
    extras |= {} if values is None else {"camera_matrix": values}
    with pytest.raises(InputError) as error:
        camera(images(**extras))
    for word in ["camera.focal: camera_matrix", *words]:
        assert word in str(error.value)


PERSPECTIVE = {"focal": "files"}


@pytest.fixture(scope="module")
def cars(project):
    return read_shapes([project / "sample_data" / "cars.h5"])


@pytest.fixture(scope="module")
def views(project):
    return load(project / "sample_data" / "cars_views.h5")


@pytest.fixture
def dictionary(tmp_path, made_cars):
    path = tmp_path / "dictionary.h5"
    write_dictionary(path, made_cars)
    return path


@pytest.fixture
def fit(fit, project, dictionary):
    """Return what fits the views through a camera: the result and the warnings."""

    def fitted(**camera):
        views = project / "sample_data" / "cars_views.h5"
        keys = {"method": "convex+refine", "lam": 1.0, "camera": camera}
        found, outcomes = fit(dictionary, views, **keys)
        assert not failures(outcomes)
        return found, warnings(outcomes)

    return fitted


def test_perspective_finds_cars_better_than_weak_perspective(fit, views):
    truth = np.asarray(views.columns["true_rotation"], float)
    weak, full = (fit(**camera)[0] for camera in ({}, PERSPECTIVE))
    errors = [np.median(rotation_angle(found.rotation, truth)) for found in (weak, full)]
    assert errors[1] < 0.5 * errors[0]
    residual_variance = [
        np.sqrt(np.nanmean((fitted - views.landmarks) ** 2, axis=(1, 2)))
        for fitted in (weak.shapes[:, :2], full.landmarks_fitted)
    ]
    assert np.median(residual_variance[1]) < 0.5 * np.median(residual_variance[0])
    assert set(full.status) == {Status.CONVERGED.value}


def test_the_position_is_metric(fit, views, cars):
    """The distance to the middle of the car's landmarks, whose size the dictionary knows."""
    found, _ = fit(**PERSPECTIVE)
    middle = cars.shapes.mean(axis=2)[[cars.items.index(m) for m in views.columns["true_model"]]]
    R = np.asarray(views.columns["true_rotation"], float)
    truth = np.einsum("nij,nj->ni", R, middle) + views.columns["true_translation"]
    error = np.linalg.norm(found.columns["position"] - truth, axis=1)
    assert np.median(error / truth[:, 2]) < 0.05

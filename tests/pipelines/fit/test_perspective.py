"""`fit` under perspective, from the made car models to a result file."""

from __future__ import annotations

import h5py
import numpy as np
import pytest

from shapefit.convex.solution import Status
from shapefit.errors import InputError
from shapefit.geometry.rotations import rotation_angle
from shapefit.io import open_landmarks, read_shapes, write_dictionary

PERSPECTIVE = {"model": "perspective", "intrinsics": "camera_matrix"}


@pytest.fixture(scope="module")
def cars(project):
    return read_shapes([project / "sample_data" / "cars.h5"])


@pytest.fixture(scope="module")
def views(project):
    with open_landmarks([project / "sample_data" / "cars_views.h5"]) as source:
        (chunk,) = source.chunks(1000)
    return chunk


@pytest.fixture
def dictionary(tmp_path, made_cars):
    path = tmp_path / "dictionary.h5"
    write_dictionary(path, made_cars)
    return path


@pytest.fixture
def fit(fit, failures, project, dictionary, tmp_path):
    """Return what fits the views through a camera: the result and the warnings."""

    def fitted(**camera):
        views = project / "sample_data" / "cars_views.h5"
        keys = {"method": "convex+refine", "lam": 1.0, "camera": camera}
        found, outcomes = fit(tmp_path, dictionary, views, **keys)
        assert not failures(outcomes)
        return found, [warning for outcome in outcomes for warning in outcome.warnings]

    return fitted


def test_a_wrong_principal_point_is_told(fit):
    _, told = fit(**PERSPECTIVE, principal_point=(-800.0, -800.0))
    assert [word for word in told if "camera.principal_point" in word]
    assert not fit(**PERSPECTIVE, principal_point=(640.0, 480.0))[1]


def test_perspective_finds_cars_better_than_weak_perspective(fit, views):
    truth = np.asarray(views.extras["true_rotation"], float)
    weak, full = (fit(**camera)[0] for camera in ({}, PERSPECTIVE))
    errors = [np.median(rotation_angle(found.rotation, truth)) for found in (weak, full)]
    assert errors[1] < 0.5 * errors[0]
    misfit = [
        np.sqrt(np.nanmean((found.landmarks_fitted - views.landmarks) ** 2, axis=(1, 2)))
        for found in (weak, full)
    ]
    assert np.median(misfit[1]) < 0.5 * np.median(misfit[0])
    assert set(full.status) == {Status.CONVERGED.value}


def test_the_position_is_metric(fit, views, cars):
    """The distance to the middle of the car's landmarks, whose size the dictionary knows."""
    found, _ = fit(**PERSPECTIVE)
    middle = cars.shapes.mean(axis=2)[[cars.items.index(m) for m in views.extras["true_model"]]]
    R = np.asarray(views.extras["true_rotation"], float)
    truth = np.einsum("nij,nj->ni", R, middle) + views.extras["true_translation"]
    error = np.linalg.norm(found.extras["position"] - truth, axis=1)
    assert np.median(error / truth[:, 2]) < 0.05


def test_the_result_tells_the_camera(fit):
    found, _ = fit(**PERSPECTIVE, principal_point=(640.0, 480.0))
    n = len(found)
    np.testing.assert_array_equal(found.extras["focal"], np.full((n, 2), 1600))
    np.testing.assert_array_equal(found.extras["principal_point"], np.tile([640, 480], (n, 1)))
    t = found.extras["camera_translation"]
    np.testing.assert_allclose(found.scale, 1600 / t[:, 2])
    assert found.relative_gap is None


def test_without_sizes_there_is_no_position(fit, dictionary):
    with h5py.File(dictionary, "a") as file:
        del file["atom_scale"]
    found, _ = fit(**PERSPECTIVE)
    assert "position" not in found.extras
    assert np.isfinite(found.extras["camera_translation"]).all()


def test_a_dataset_that_is_not_there_is_refused_before_anything_is_written(fit, tmp_path):
    with pytest.raises(InputError, match=r"camera\.intrinsics: cameras: .* camera_matrix"):
        fit(model="perspective", intrinsics="cameras")
    assert not (tmp_path / "result.h5").exists()

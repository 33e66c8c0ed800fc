"""The sample data are what their page says."""

import numpy as np
import pytest
import trimesh

from shapefit.io import read_shapes
from tests.io.files import load

ROUNDING = 1e-5
FOCAL_LENGTH, PRINCIPAL_POINT = 1600.0, np.array([640.0, 480.0])


@pytest.fixture(scope="module")
def folder(project):
    return project / "sample_data"


@pytest.fixture(scope="module")
def cars(folder):
    return read_shapes([folder / "cars.h5"])


def test_every_mesh_is_closed_and_wound_outward(cars):
    assert cars.mesh_vertices.shape[2] >= 1000
    for vertices in cars.mesh_vertices:
        mesh = trimesh.Trimesh(vertices.T, cars.mesh_faces, process=False)
        assert np.isfinite(mesh.vertices).all()
        assert mesh.is_watertight
        assert mesh.is_winding_consistent
        assert mesh.area_faces.min() > 1e-7
        parts = mesh.split(only_watertight=False)
        assert len(parts) == 9  # the body, four wheels, two mirrors, two plates
        assert all(part.volume > 0 for part in parts)
        assert 5 < mesh.volume < 15


def test_views_are_pictures_of_the_cars_under_their_true_rotation(folder, cars):
    views = load(folder / "cars_views.h5")
    assert (len(views), views.unit, views.y_axis) == (108, "px", "down")
    assert views.landmark_names == cars.landmark_names
    centre = np.append(PRINCIPAL_POINT, 1)
    expected = np.diag([FOCAL_LENGTH, FOCAL_LENGTH, 0]) + np.outer(centre, [0, 0, 1])
    np.testing.assert_allclose(views.columns["camera_matrix"], expected)
    R = views.columns["true_rotation"].astype(float)
    np.testing.assert_allclose(np.linalg.det(R), 1, atol=1e-5)
    for view, model in enumerate(views.columns["true_model"]):
        x, y, z = R[view] @ cars.shapes[cars.items.index(model)]
        u, v = (views.landmarks[view] - PRINCIPAL_POINT[:, None]) / FOCAL_LENGTH
        visible = np.isfinite(u)
        # u (z + tz) = x + tx and v (z + tz) = y + ty, linear in the translation (tx, ty, tz).
        one, zero = np.ones(visible.sum()), np.zeros(visible.sum())
        A = np.concatenate(
            [np.stack([one, zero, -u[visible]], axis=1), np.stack([zero, one, -v[visible]], axis=1)]
        )
        b = np.concatenate([(u * z - x)[visible], (v * z - y)[visible]])
        translation = np.linalg.lstsq(A, b, rcond=None)[0]
        assert 8.5 < translation[2] < 15.5
        told = views.columns["true_translation"][view]
        np.testing.assert_allclose(translation, told, atol=0.01 * translation[2])
        pixels = FOCAL_LENGTH * (A @ translation - b) / translation[2]
        assert np.sqrt((pixels**2).mean()) < 1

"""The sample data: cars whose meshes are closed, and their views."""

import numpy as np
import pytest
import trimesh
from numpy.testing import assert_allclose

from shapefit.io import read_shapes
from tests.io.files import load as load_records

FOCAL_LENGTH = 1600.0


PRINCIPAL_POINT = np.array([640.0, 480.0])


@pytest.fixture(scope="module")
def cars(project):
    return read_shapes([project / "sample_data/cars.h5"])


@pytest.fixture(scope="module")
def views(project):
    return load_records(project / "sample_data/cars_views.h5")


def test_every_mesh_is_closed_and_wound_outward(cars):
    """Its parts are the body, four wheels, two mirrors and two plates."""
    assert cars.mesh_vertices.shape[1] >= 1000
    for vertices in cars.mesh_vertices:
        mesh = trimesh.Trimesh(vertices, cars.mesh_faces, process=False)
        parts = mesh.split(only_watertight=False)
        assert np.isfinite(mesh.vertices).all()
        assert mesh.is_watertight
        assert mesh.is_winding_consistent
        assert mesh.area_faces.min() > 1e-7
        assert len(parts) == 9
        assert all(part.volume > 0 for part in parts)
        assert 5 < mesh.volume < 15


def test_views_say_their_unit_camera_and_landmarks(views, cars):
    camera = [
        [FOCAL_LENGTH, 0, PRINCIPAL_POINT[0]],
        [0, FOCAL_LENGTH, PRINCIPAL_POINT[1]],
        [0, 0, 1],
    ]
    assert len(views) == 108
    assert views.unit == "px"
    assert views.y_axis == "down"
    assert views.landmark_names == cars.landmark_names
    assert_allclose(views.column("camera_matrix"), camera)


def find_translation(turned, image):
    """Return the translation by which a turned shape (3, p) is seen in an image (2, p)
    of the plane at depth 1, and the residuals there.

    u (z + tz) = x + tx and v (z + tz) = y + ty are linear in the translation (tx, ty,
    tz).
    """
    x, y, z = turned
    u, v = image
    one = np.ones_like(u)
    zero = np.zeros_like(u)
    of_u = np.stack([one, zero, -u], axis=1)
    of_v = np.stack([zero, one, -v], axis=1)
    A = np.concatenate([of_u, of_v])
    b = np.concatenate([u * z - x, v * z - y])
    translation, *_ = np.linalg.lstsq(A, b, rcond=None)
    residuals = (A @ translation - b) / translation[2]
    return translation, residuals


def test_views_are_pictures_of_the_cars_under_their_true_rotation(views, cars):
    R = views.column("true_rotation").astype(float)
    models = [cars.items.index(model) for model in views.column("true_model")]
    images = (views.landmarks - PRINCIPAL_POINT) / FOCAL_LENGTH
    assert_allclose(np.linalg.det(R), 1, atol=1e-5)
    for view, model in enumerate(models):
        visible = np.isfinite(images[view, :, 0])
        turned = R[view] @ cars.shapes[model, visible].T
        translation, residuals = find_translation(turned, images[view, visible].T)
        pixels = FOCAL_LENGTH * residuals
        distance = translation[2]
        stated = views.column("true_translation")[view]
        assert 8.5 < distance < 15.5
        assert_allclose(translation, stated, atol=0.01 * distance)
        assert np.sqrt((pixels**2).mean()) < 1

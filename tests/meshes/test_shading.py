import numpy as np
import pytest

from shapefit.meshes.shading import AMBIENT, FROM_LAMP, FROM_VIEWER, LAMP, paint
from shapefit.meshes.views import View

WHITE = (1.0, 1.0, 1.0)


def areas(triangles):
    first, second = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    return (first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]) / 2


def test_a_box_seen_from_the_front_is_its_front(box, box_faces):
    painted = paint(box(4, 3, 2), box_faces, (1.0, 0.5, 0.0))
    assert areas(painted.triangles).sum() == pytest.approx(12)
    light = AMBIENT + FROM_LAMP * LAMP[2] + FROM_VIEWER
    np.testing.assert_allclose(painted.colours, np.tile([light, light / 2, 0], (2, 1)))
    length = np.linalg.norm(painted.outline[:, 0] - painted.outline[:, 1], axis=1)
    assert sorted(length) == pytest.approx([3, 3, 4, 4])


def test_the_side_away_from_the_lamp_is_darker_and_none_is_black_or_overlit(box, box_faces):
    vertices = View(-40, 30).rotation() @ box(1, 1, 1)
    painted = paint(vertices, box_faces, WHITE)
    assert len(painted.triangles) == 6
    assert len(painted.outline) == 6  # the hexagon around a corner
    light = sorted(set(np.round(painted.colours[:, 0], 9)))
    # turned by -40 and tilted by 30 degrees, the box shows its top, its right and its front
    normals = View(-40, 30).rotation().T[[1, 0, 2]]
    normals = normals * np.sign(normals[:, 2:])
    expected = AMBIENT + FROM_LAMP * np.maximum(normals @ LAMP, 0) + FROM_VIEWER * normals[:, 2]
    assert light == pytest.approx(sorted(expected))
    assert light[0] >= AMBIENT
    assert light[-1] <= 1


def test_every_face_keeps_its_colour_in_whatever_order_it_is_given(box, box_faces):
    vertices = View(-40, 30).rotation() @ box(4, 3, 2)

    def colours(faces):
        painted = paint(vertices, faces, WHITE)
        pairs = zip(painted.triangles, painted.colours[:, 0], strict=True)
        return {tuple(triangle.ravel()): colour for triangle, colour in pairs}

    assert colours(box_faces) == pytest.approx(
        colours(box_faces[[3, 9, 0, 5, 11, 7, 1, 8, 4, 2, 10, 6]])
    )


def test_what_is_nearer_is_painted_later(box, box_faces):
    near, far = box(1, 1, 1) + np.array([[0.2], [0.2], [3.0]]), box(1, 1, 1)
    for vertices, shift in ((np.hstack([near, far]), 0), (np.hstack([far, near]), 8)):
        faces = np.concatenate([box_faces, box_faces + 8])
        painted = paint(vertices, faces, WHITE)
        assert len(painted.triangles) == 4
        middle = painted.triangles[2:].reshape(-1, 2)
        np.testing.assert_allclose(middle.max(axis=0), vertices[:2, shift : shift + 8].max(axis=1))
        np.testing.assert_allclose(middle.min(axis=0), vertices[:2, shift : shift + 8].min(axis=1))


def test_faces_without_area_are_left_out():
    vertices = np.array([[0.0, 1, 2, 0], [0, 0, 0, 1], [0, 0, 0, 0]])
    painted = paint(vertices, np.array([[0, 1, 2], [0, 1, 3], [0, 3, 3]]), WHITE)
    assert len(painted.triangles) == 1


@pytest.mark.real_data
def test_no_part_of_a_real_car_seen_from_anywhere_turns_its_back(cars):
    vertices = cars.mesh_vertices[4]
    for turn in range(0, 360, 60):
        painted = paint(View(turn, 15).rotation() @ vertices, cars.mesh_faces, WHITE)
        assert (areas(painted.triangles) > 0).all()
        assert np.isfinite(painted.colours).all()
        # an even number of its edges meets in each corner of the outline: it has no gaps
        _, count = np.unique(painted.outline.reshape(-1, 2), axis=0, return_counts=True)
        assert (count % 2 == 0).all()

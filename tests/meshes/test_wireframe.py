import numpy as np
import pytest
import trimesh

from shapefit.meshes.wireframe import SIDES, balls, tubes

# Area of a regular polygon with SIDES corners on the unit circle
AREA = SIDES / 2 * np.sin(2 * np.pi / SIDES)


def opened(vertices, faces, process=True):
    return trimesh.Trimesh(vertices.T, faces, process=process)


def frustum(height, low, high):
    return height / 3 * AREA * (low**2 + low * high + high**2)


def round_end(radius):
    half = np.sqrt(0.5)
    return radius**3 * (frustum(half, 1, half) + frustum(1 - half, half, 0))


def test_a_tube_has_the_volume_of_its_prism_and_ends():
    points = np.array([[0.0, 10, 3], [0, 0, 0], [0, 0, 0]])
    vertices, faces = tubes(points, np.array([[0, 1]]), thickness=0.1)  # radius 0.5
    mesh = opened(vertices, faces)
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(10 * AREA * 0.25 + 2 * round_end(0.5))
    np.testing.assert_allclose(mesh.bounds, [[-0.5, -0.5, -0.5], [10.5, 0.5, 0.5]])


def test_a_ball_has_its_volume_around_its_point():
    points = np.array([[0.0, 4], [1, 1], [2, 2]])
    vertices, faces = balls(points, diameter=0.5)  # radius 1
    mesh = opened(vertices, faces)
    assert mesh.volume == pytest.approx(2 * 2 * round_end(1))
    centres = [part.vertices.mean(axis=0) for part in mesh.split()]
    np.testing.assert_allclose(sorted(map(tuple, centres)), points.T, atol=1e-12)
    np.testing.assert_allclose(vertices.reshape(3, 2, -1).mean(axis=-1), points, atol=1e-12)


def test_each_tube_is_closed_and_wound_outwards_whatever_its_direction(rng):
    points = rng.normal(size=(3, 12))
    points[:, 1] = points[:, 0] + (0, 0, 1)  # along an axis, and against it
    edges = np.array([[0, 1], *([i + 1, i] for i in range(2, 11))])
    parts = opened(*tubes(points, edges)).split(only_watertight=False)
    assert len(parts) == len(edges)
    for part in parts:
        assert part.is_watertight
        assert part.is_winding_consistent
        assert part.volume > 0


@pytest.mark.parametrize("edges", [[[0, 1], [1, 2]], [[0, 1], [2, 1]], [[1, 0], [1, 2]]])
def test_tubes_in_one_line_stay_apart_when_a_reader_merges_vertices(edges):
    points = np.array([[0.0, 1, 2], [0, 0, 0], [0, 0, 0]])
    mesh = opened(*tubes(points, np.array(edges)))
    assert mesh.is_watertight
    assert mesh.body_count == 2


def test_an_edge_given_twice_has_one_tube(rng):
    points = rng.normal(size=(3, 4))
    once, faces = tubes(points, np.array([[0, 1], [2, 3]]))
    twice, same = tubes(points, np.array([[3, 2], [0, 1], [2, 3], [1, 0]]))
    np.testing.assert_array_equal(twice, once)
    np.testing.assert_array_equal(same, faces)


def test_an_edge_of_no_length_is_closed_too():
    points = np.array([[0.0, 0, 5], [0, 0, 0], [0, 0, 0]])
    mesh = opened(*tubes(points, np.array([[0, 1]])))
    assert mesh.is_watertight
    assert mesh.volume > 0


def test_a_batch_has_the_tubes_of_its_shapes(rng):
    points, edges = rng.normal(size=(4, 2, 3, 5)), np.array([[0, 1], [3, 2], [4, 0]])
    vertices, faces = tubes(points, edges)
    assert vertices.shape[:3] == (4, 2, 3)
    alone, same = tubes(points[2, 1], edges)
    np.testing.assert_allclose(vertices[2, 1], alone, atol=1e-15)
    np.testing.assert_array_equal(faces, same)
    np.testing.assert_allclose(balls(points)[0][2, 1], balls(points[2, 1])[0], atol=1e-15)


@pytest.mark.real_data
def test_every_real_wireframe_is_closed_tube_by_tube(wires):
    vertices, faces = tubes(wires.shapes, wires.edges)
    different = {frozenset(edge) for edge in wires.edges.tolist()}
    assert len(different) < len(wires.edges)
    for shape in vertices:
        mesh = opened(shape, faces)
        assert mesh.is_watertight
        assert mesh.is_winding_consistent
        assert mesh.volume > 0
        assert mesh.body_count == len(different)

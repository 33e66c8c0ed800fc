import io
import json
import struct

import numpy as np
import pytest
import trimesh

from shapefit.meshes.export import MeshFormat, line_files, mesh_files
from shapefit.meshes.wireframe import balls, tubes

EVERY = pytest.mark.parametrize("file_format", list(MeshFormat))
# OBJ: 8 decimals. PLY and GLB: single precision.
PRECISION = {"obj": (0, 5.1e-9), "ply": (6e-8, 0), "ply-ascii": (1.2e-7, 5.1e-9), "glb": (6e-8, 0)}


def opened(files, suffix):
    """Open a file with trimesh as it stands in the file; give its objects by name."""
    kind = suffix.split(".")[-1]
    scene = trimesh.load_scene(
        io.BytesIO(files[suffix]), file_type=kind, process=False, split_objects=True
    )
    assert all(np.allclose(scene.graph[node][0], np.eye(4)) for node in scene.graph.nodes_geometry)
    return dict(scene.geometry)


def header(glb):
    (length,) = struct.unpack("<I", glb[12:16])
    return json.loads(glb[20 : 20 + length])


def main_suffix(file_format):
    return "." + file_format.value.split("-")[0]


def assert_same(mesh, vertices, faces, file_format):
    relative, absolute = PRECISION[file_format]
    np.testing.assert_allclose(mesh.vertices, vertices.T, rtol=relative, atol=absolute)
    np.testing.assert_array_equal(mesh.faces, faces)


@EVERY
def test_a_box_comes_back(file_format, box, box_faces):
    vertices = box(4, 3, 2) + np.array([[1000.0], [-20], [1 / 3]])
    files = mesh_files(vertices, box_faces, file_format)
    assert list(files) == [main_suffix(file_format)]
    (mesh,) = opened(files, main_suffix(file_format)).values()
    assert_same(mesh, vertices, box_faces, file_format)
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.volume == pytest.approx(24, rel=1e-4)


@EVERY
def test_vertices_that_coincide_stay_apart(file_format, box, box_faces):
    vertices = np.hstack([box(4, 3, 2), box(4, 3, 2)])
    faces = np.concatenate([box_faces, box_faces + 8])
    (mesh,) = opened(mesh_files(vertices, faces, file_format), main_suffix(file_format)).values()
    assert_same(mesh, vertices, faces, file_format)


@EVERY
@pytest.mark.real_data
def test_a_real_car_comes_back_watertight_as_a_viewer_opens_it(file_format, cars):
    for vertices in cars.mesh_vertices[::11]:
        files = mesh_files(vertices, cars.mesh_faces, file_format)
        suffix = main_suffix(file_format)
        # the usual way, with vertices that coincide merged
        mesh = trimesh.load_mesh(io.BytesIO(files[suffix]), file_type=suffix[1:])
        assert len(mesh.faces) == 2700
        assert np.isfinite(mesh.vertices).all()
        assert mesh.is_watertight
        assert mesh.is_winding_consistent
        expected = trimesh.Trimesh(vertices.T, cars.mesh_faces, process=False).volume
        assert expected > 5
        assert mesh.volume == pytest.approx(expected, rel=1e-6)
        (exact,) = opened(files, suffix).values()
        assert_same(exact, vertices, cars.mesh_faces, file_format)


@pytest.mark.parametrize("file_format", [MeshFormat.OBJ, MeshFormat.GLB])
def test_landmarks_are_a_second_object_of_balls(file_format, box, box_faces, rng):
    vertices, landmarks = box(4, 3, 2), rng.normal(size=(3, 5))
    files = mesh_files(vertices, box_faces, file_format, landmarks)
    assert list(files) == [main_suffix(file_format)]
    objects = opened(files, main_suffix(file_format))
    assert set(objects) == {"mesh", "landmarks"}
    assert_same(objects["mesh"], vertices, box_faces, file_format)
    assert_same(objects["landmarks"], *balls(landmarks), file_format)
    assert objects["landmarks"].body_count == 5


@pytest.mark.parametrize("file_format", [MeshFormat.PLY, MeshFormat.PLY_ASCII])
def test_landmarks_of_ply_are_points_in_a_file_of_their_own(file_format, box, box_faces, rng):
    vertices, landmarks = box(4, 3, 2), rng.normal(size=(3, 5))
    files = mesh_files(vertices, box_faces, file_format, landmarks)
    assert list(files) == [".ply", "-landmarks.ply"]
    (mesh,) = opened(files, ".ply").values()
    assert_same(mesh, vertices, box_faces, file_format)
    (points,) = opened(files, "-landmarks.ply").values()
    assert isinstance(points, trimesh.PointCloud)
    np.testing.assert_allclose(points.vertices, landmarks.T, rtol=6e-8, atol=5.1e-9)


@pytest.mark.parametrize(
    ("file_format", "start"),
    [
        (MeshFormat.PLY, b"ply\nformat binary_little_endian 1.0\n"),
        (MeshFormat.PLY_ASCII, b"ply\nformat ascii 1.0\n"),
    ],
)
def test_ply_is_binary_unless_ascii_is_asked_for(file_format, start, box, box_faces):
    files = mesh_files(box(1, 1, 1), box_faces, file_format, box(1, 1, 1))
    assert all(data.startswith(start) for data in files.values())


def test_obj_names_its_objects_and_needs_no_other_file(box, box_faces):
    text = mesh_files(box(1, 1, 1), box_faces, MeshFormat.OBJ, box(1, 1, 1))[".obj"].decode()
    lines = text.splitlines()
    assert [line for line in lines if line.startswith("o ")] == ["o mesh", "o landmarks"]
    assert {line.split()[0] for line in lines if line} == {"o", "v", "f"}
    assert text.endswith("\n")


def test_glb_has_matt_colours(box, box_faces):
    files = mesh_files(box(1, 1, 1), box_faces, MeshFormat.GLB, box(1, 1, 1))
    materials = header(files[".glb"])["materials"]
    assert len(materials) == 2
    for material in materials:
        assert material["pbrMetallicRoughness"]["metallicFactor"] == 0


@EVERY
@pytest.mark.real_data
def test_a_real_wireframe_comes_back_as_closed_tubes(file_format, wires):
    vertices, faces = tubes(wires.shapes[0], wires.edges)
    files = mesh_files(vertices, faces, file_format)
    (mesh,) = opened(files, main_suffix(file_format)).values()
    assert_same(mesh, vertices, faces, file_format)
    assert mesh.is_watertight


@pytest.mark.parametrize("file_format", [MeshFormat.PLY, MeshFormat.PLY_ASCII, MeshFormat.GLB])
@pytest.mark.real_data
def test_real_edges_come_back_as_lines(file_format, wires):
    points = wires.shapes[0]
    (path,) = opened(
        line_files(points, wires.edges, file_format), main_suffix(file_format)
    ).values()
    assert isinstance(path, trimesh.path.Path3D)
    # the two ends of each edge one after the other, as the modes of PLY and GLB want them
    ends = path.vertices.reshape(-1, 2, 3)
    np.testing.assert_allclose(ends, points.T[wires.edges], rtol=1.2e-7, atol=5.1e-9)
    if file_format is not MeshFormat.GLB:  # trimesh reads the lines of GLB as one long line
        nodes = np.concatenate([entity.nodes for entity in path.entities])
        np.testing.assert_array_equal(nodes, np.arange(len(nodes) * 2).reshape(-1, 2))


def test_lines_of_glb_are_pairs_of_points(box):
    files = line_files(box(1, 1, 1), np.array([[0, 1], [5, 4]]), MeshFormat.GLB)
    (mesh,) = header(files[".glb"])["meshes"]
    assert mesh["primitives"][0]["mode"] == 1  # LINES


def test_obj_lines_keep_all_points():
    points = np.array([[0.0, 1, 2, 3], [0, 10, 20, 30], [0, 0, 0, 1 / 3]])
    text = line_files(points, np.array([[0, 3], [3, 1]]), MeshFormat.OBJ)[".obj"].decode()
    assert text.splitlines() == [
        "o edges",
        "v 0.00000000 0.00000000 0.00000000",
        "v 1.00000000 10.00000000 0.00000000",
        "v 2.00000000 20.00000000 0.00000000",
        "v 3.00000000 30.00000000 0.33333333",
        "l 1 4",
        "l 4 2",
    ]


@pytest.mark.parametrize("file_format", [MeshFormat.PLY, MeshFormat.PLY_ASCII])
def test_landmarks_of_ply_lines_are_points_in_a_file_of_their_own(file_format, box, rng):
    landmarks = rng.normal(size=(3, 5))
    files = line_files(box(1, 1, 1), np.array([[0, 1]]), file_format, landmarks)
    assert list(files) == [".ply", "-landmarks.ply"]
    (points,) = opened(files, "-landmarks.ply").values()
    np.testing.assert_allclose(points.vertices, landmarks.T, rtol=6e-8, atol=5.1e-9)


def test_landmarks_of_glb_lines_are_a_second_object(box, rng):
    landmarks = rng.normal(size=(3, 5))
    files = line_files(box(1, 1, 1), np.array([[0, 1]]), MeshFormat.GLB, landmarks)
    assert list(files) == [".glb"]
    objects = opened(files, ".glb")
    assert set(objects) == {"edges", "landmarks"}
    assert_same(objects["landmarks"], *balls(landmarks), MeshFormat.GLB)


def test_landmarks_of_obj_lines_count_their_vertices_on(box, rng):
    points, landmarks = box(1, 1, 1), rng.normal(size=(3, 5))
    files = line_files(points, np.array([[0, 1]]), MeshFormat.OBJ, landmarks)
    text = files[".obj"].decode()
    assert [line for line in text.splitlines() if line[0] == "o"] == ["o edges", "o landmarks"]
    # trimesh drops lines where there are faces; the vertices keep their numbers in the file
    (mesh,) = opened(files, ".obj").values()
    vertices, faces = balls(landmarks)
    np.testing.assert_allclose(mesh.triangles, vertices.T[faces], atol=5.1e-9)


@EVERY
@pytest.mark.parametrize("wrong", [np.nan, np.inf])
def test_what_is_not_finite_is_refused(file_format, wrong, box, box_faces):
    fine, bad = box(1, 1, 1), box(1, 1, 1)
    bad[1, 2] = wrong
    with pytest.raises(ValueError, match="not finite"):
        mesh_files(bad, box_faces, file_format)
    with pytest.raises(ValueError, match="not finite"):
        mesh_files(fine, box_faces, file_format, bad)
    with pytest.raises(ValueError, match="not finite"):
        line_files(bad, np.array([[0, 1]]), file_format)


@EVERY
@pytest.mark.parametrize("wrong", [-1, 8])
def test_a_vertex_that_does_not_exist_is_refused(file_format, wrong, box, box_faces):
    box_faces[3, 1] = wrong
    with pytest.raises(ValueError, match=r"not within 0\.\.7"):
        mesh_files(box(1, 1, 1), box_faces, file_format)
    with pytest.raises(ValueError, match=r"not within 0\.\.7"):
        line_files(box(1, 1, 1), np.array([[0, wrong]]), file_format)


def test_the_same_mesh_gives_the_same_bytes(box, box_faces):
    for file_format in MeshFormat:
        first, second = (
            mesh_files(box(4, 3, 2), box_faces, file_format, box(1, 2, 3)) for _ in range(2)
        )
        assert first == second

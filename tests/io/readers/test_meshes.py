"""Meshes with landmarks beside them as training shapes."""

import json

import numpy as np
import pytest
import trimesh

from shapefit.errors import InputError
from shapefit.io import open_shapes

VERTICES = np.array([[0, 0, 0], [1, 0, 0], [0, 2, 0], [0, 0, 3]], dtype=float)
FACES = [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]


def read(*paths):
    with open_shapes(paths) as source:
        (shapes,) = source.batches(max(source.count, 1))
        return shapes, source.notes


def save(path, factor=1.0, faces=FACES):
    trimesh.Trimesh(factor * VERTICES, faces, process=False).export(path)
    return path


@pytest.mark.parametrize("kind", ["obj", "ply", "glb"])
def test_numbers_of_vertices_for_all_meshes_of_a_folder(tmp_path, kind):
    paths = [save(tmp_path / f"{name}.{kind}", size) for name, size in (("a", 1), ("b", 2))]
    (tmp_path / "landmarks.csv").write_text("landmark,vertex\ntip,3\nroot,0\nside,1\n")
    shapes, notes = read(*paths)
    assert shapes.items == ("a", "b")
    assert shapes.landmark_names == ("tip", "root", "side")
    assert shapes.unit == ("m" if kind == "glb" else "unknown")
    np.testing.assert_allclose(shapes.shapes[1].T, 2 * VERTICES[[3, 0, 1]])
    np.testing.assert_allclose(shapes.mesh_vertices[1].T, 2 * VERTICES)
    assert shapes.mesh_faces.tolist() == FACES
    assert notes == ()


def test_points_of_one_mesh_go_over_those_of_the_folder(tmp_path):
    path = save(tmp_path / "a.ply")
    (tmp_path / "landmarks.csv").write_text("landmark,vertex\ntip,1\n")
    own = {"tip": [0, 0, 3], "root": 0}
    (tmp_path / "a.landmarks.json").write_text(json.dumps(own))
    shapes, _ = read(path)
    np.testing.assert_allclose(shapes.shapes[0].T, [[0, 0, 3], [0, 0, 0]])


def test_meshes_of_different_faces_keep_their_landmarks(tmp_path):
    paths = [save(tmp_path / "a.obj"), save(tmp_path / "b.obj", faces=FACES[:3])]
    (tmp_path / "landmarks.json").write_text('{"tip": 3, "root": 0}')
    shapes, notes = read(*paths)
    assert len(shapes) == 2
    assert shapes.mesh_vertices is None
    assert any("different faces" in note for note in notes)


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("other.csv", "", ["a.obj", "a.landmarks.csv", "landmarks.csv"]),
        ("landmarks.csv", "landmark,vertex\ntip,4\n", ["a.obj", "vertex 4 of 4 vertices"]),
        ("landmarks.csv", "landmark,vertex\ntip,one\n", ["landmarks.csv:2", "'one'"]),
        ("landmarks.csv", "name,vertex\ntip,1\n", ["landmarks.csv", "'name,vertex'"]),
        (
            "landmarks.csv",
            "landmark,vertex\ntip,1\ntip,2\n",
            ["landmarks.csv", "'tip' is there twice"],
        ),
        ("landmarks.csv", "landmark,x,y,z\ntip,1,2\n", ["landmarks.csv:2", "3 cells"]),
        ("landmarks.csv", "landmark,vertex\n", ["landmarks.csv", "no landmarks"]),
        ("landmarks.json", "{", ["landmarks.json:1", "is not whole JSON"]),
        ("landmarks.json", '{"tip": 1.5}', ["landmarks.json", "'tip' is at 1.5"]),
        ("landmarks.json", '{"tip": [1, 2, NaN]}', ["landmarks.json"]),
        ("landmarks.json", '{"tip": true}', ["landmarks.json", "'tip' is at True"]),
    ],
)
def test_errors_name_what_is_wrong(tmp_path, name, text, words):
    path = save(tmp_path / "a.obj")
    (tmp_path / name).write_text(text)
    with pytest.raises(InputError) as error:
        read(path)
    assert all(word in str(error.value) for word in words), error.value


@pytest.mark.parametrize("content", [b"ply\nformat ascii 1.0\nelement vertex 9", b"glTF\0\0\0\0"])
def test_a_damaged_mesh(tmp_path, content):
    path = tmp_path / ("a.ply" if content.startswith(b"ply") else "a.glb")
    path.write_bytes(content)
    (tmp_path / "landmarks.json").write_text('{"tip": 3}')
    with pytest.raises(InputError, match=path.name):
        read(path)


def test_a_mesh_without_vertices(tmp_path):
    path = tmp_path / "a.ply"
    axes = "".join(f"property float {axis}\n" for axis in "xyz")
    path.write_text(f"ply\nformat ascii 1.0\nelement vertex 0\n{axes}end_header\n")
    (tmp_path / "landmarks.json").write_text("{}")
    with pytest.raises(InputError, match=r"a.ply: (has no vertices|cannot be read as a mesh)"):
        read(path)


def test_a_mesh_in_the_plane(tmp_path):
    path = tmp_path / "a.obj"
    path.write_text("v 0 0\nf 1 1 1\n")
    (tmp_path / "landmarks.json").write_text('{"tip": 0}')
    with pytest.raises(InputError, match=r"a.obj: has vertices of 2 coordinates"):
        read(path)

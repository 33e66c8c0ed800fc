"""Mesh files, opened again by trimesh."""

import io
import json
import struct

import numpy as np
import pytest
import trimesh

from shapefit.meshes.export import mesh_file

# OBJ: 8 decimals. PLY and GLB: single precision.
PRECISION = {"obj": (0, 5.1e-9), "ply": (6e-8, 0), "glb": (6e-8, 0)}
EVERY = pytest.mark.parametrize("file_format", list(PRECISION))


def opened(content, file_format):
    """Open a file with trimesh as it stands in the file; give its objects by name."""
    scene = trimesh.load_scene(
        io.BytesIO(content),
        file_type=file_format.split("-")[0],
        process=False,
        split_objects=True,
    )
    assert all(np.allclose(scene.graph[node][0], np.eye(4)) for node in scene.graph.nodes_geometry)
    return dict(scene.geometry)


def assert_same(mesh, vertices, faces, file_format):
    relative, absolute = PRECISION[file_format]
    np.testing.assert_allclose(mesh.vertices, vertices.T, rtol=relative, atol=absolute)
    np.testing.assert_array_equal(mesh.faces, faces)


@EVERY
def test_a_box_comes_back_and_vertices_that_coincide_stay_apart(file_format, box, box_faces):
    vertices = box(4, 3, 2) + np.array([[1000.0], [-20], [1 / 3]])
    content = mesh_file(vertices, box_faces, file_format)
    assert content == mesh_file(vertices, box_faces, file_format)
    (mesh,) = opened(content, file_format).values()
    assert_same(mesh, vertices, box_faces, file_format)
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.volume == pytest.approx(24, rel=1e-4)
    twice = np.hstack([vertices, vertices])
    faces = np.concatenate([box_faces, box_faces + 8])
    (mesh,) = opened(mesh_file(twice, faces, file_format), file_format).values()
    assert_same(mesh, twice, faces, file_format)


def test_what_the_formats_say_of_themselves(box, box_faces):
    files = {name: mesh_file(box(1, 1, 1), box_faces, name) for name in PRECISION}
    assert files["ply"].startswith(b"ply\nformat binary_little_endian 1.0\n")
    lines = files["obj"].decode().splitlines()
    assert [line for line in lines if line.startswith("o ")] == ["o mesh"]
    assert {line.split()[0] for line in lines if line} == {"o", "v", "f"}  # and no other file
    assert files["obj"].endswith(b"\n")
    magic, version, length, size = struct.unpack("<4sIII", files["glb"][:16])
    assert (magic, version, length) == (b"glTF", 2, len(files["glb"]))
    head = json.loads(files["glb"][20 : 20 + size])
    assert [node["name"] for node in head["nodes"] if "mesh" in node] == ["mesh"]
    (material,) = head["materials"]
    assert material["pbrMetallicRoughness"]["metallicFactor"] == 0  # else it is black in viewers
    for accessor in head["accessors"]:  # of positions: viewers frame by the bounds
        if accessor["type"] == "VEC3":
            assert (accessor["min"], accessor["max"]) == ([-0.5] * 3, [0.5] * 3)

"""Meshes of results: what `convert` and `export` of `fit` write is opened again by
trimesh.
"""

import json
import struct
from dataclasses import replace
from io import BytesIO

import numpy as np
import pytest
import trimesh
from shapefit.cli.main import run as run_command

from shapefit.config import CONFIGS
from shapefit.errors import InputError
from shapefit.io import read_dictionary, read_results, write_dictionary
from shapefit.pipelines.convert import convert_files as run
from shapefit.pipelines.meshes import has_shape, mesh_file
from tests.io.files import load
from tests.pipelines.fitted import fit_images

# OBJ: 8 decimals. PLY and GLB: single precision.
PRECISION = {"obj": 5.1e-9, "ply": 4e-7, "glb": 4e-7}


def convert(result, dictionary, folder, to="ply"):
    arguments = {"files": [str(result)], "output": str(folder), "to": to}
    named = {} if dictionary is None else {"dictionary": str(dictionary)}
    return list(run(CONFIGS["convert"](**arguments, **named)))


def only_mesh(path):
    """The one object of a file as it stands; frames of viewers do not matter."""
    (mesh,) = trimesh.load_scene(
        path, process=False, split_objects=True
    ).geometry.values()
    return mesh


@pytest.fixture(scope="session")
def cars(world):
    return world.dictionary("cars"), world.fit("cars", method="convex+refine")


def metres(dictionary, c):
    """The length of a normalised unit: the sizes of the atoms, by their shares."""
    norm = np.linalg.norm(dictionary.atoms, axis=(1, 2))
    size = (c * norm) @ (dictionary.atom_scale * norm) / (c * norm).sum()
    return size / np.linalg.norm(np.tensordot(c, dictionary.atoms, axes=1))


@pytest.mark.parametrize("to", PRECISION)
def test_the_mesh_is_that_of_the_coefficients(tmp_path, cars, to):
    path, result = cars
    dictionary = read_dictionary(path)
    fit = read_results(result)
    outcomes = convert(result, path, tmp_path / "meshes", to)
    assert sum(outcome.done for outcome in outcomes) == len(fit) == 108
    assert outcomes[-1].note == "108 meshes"
    assert outcomes[-1].written == (tmp_path / "meshes",)
    assert len(list((tmp_path / "meshes").rglob(f"*.{to}"))) == 108
    for image in range(0, 108, 20):
        c = fit.coefficients[image]
        placed = dictionary.mesh_vertices - dictionary.atom_origin[:, :, None]
        vertices = metres(dictionary, c) * np.tensordot(c, placed, axes=1)
        mesh = only_mesh(tmp_path / "meshes" / f"{fit.items[image]}.{to}")
        np.testing.assert_allclose(mesh.vertices.T, vertices, atol=PRECISION[to])
        np.testing.assert_array_equal(mesh.faces, dictionary.mesh_faces)
        assert mesh.is_watertight
        assert mesh.volume > 0
        width, height, length = mesh.extents
        assert 1.5 < width < 2.5
        assert 1.2 < height < 2.3
        assert 3.3 < length < 5.6
        assert mesh.bounds[0, 1] == pytest.approx(0, abs=1e-6)  # on the ground


def test_fit_writes_what_convert_writes(tmp_path, cars, world):
    path, _ = cars
    images = load(world.images("cars")).take(slice(0, 108, 40))
    landmarks = images.as_columns().copy()
    landmarks[1, :, 2:] = np.nan
    images = images.replaced(
        landmarks=landmarks.swapaxes(1, 2), items=("../up", "gone", "a:b/c")
    )
    keys = {"method": "convex+refine", "export": {"folder": str(tmp_path / "of_fit")}}
    _, outcomes = fit_images(tmp_path, images, path, **keys)
    missing = "1 image without a shape and a mesh"
    assert missing in [str(text) for outcome in outcomes for text in outcome.warnings]
    assert len([each for outcome in outcomes for each in outcome.failures]) == 1
    outcomes = convert(tmp_path / "result.h5", path, tmp_path / "converted")
    failures = [each for outcome in outcomes for each in outcome.failures]
    assert failures == [("gone", "has no shape, and so no mesh")]
    files = sorted((tmp_path / "converted").rglob("*.ply"))
    assert [str(each.relative_to(tmp_path / "converted")) for each in files] == [
        "%2E%2E/up.ply",
        "a%3Ab/c.ply",
    ]
    for each in files:
        same = tmp_path / "of_fit" / each.relative_to(tmp_path / "converted")
        assert same.read_bytes() == each.read_bytes()


def test_the_command_names_images_without_a_mesh_and_ends_with_1(
    tmp_path, cars, world, capsys
):
    path, _ = cars
    images = load(world.images("cars")).take(slice(0, 108, 40))
    landmarks = images.as_columns().copy()
    landmarks[1, :, 2:] = np.nan
    images = images.replaced(
        landmarks=landmarks.swapaxes(1, 2), items=("first", "gone", "last")
    )
    fit_images(tmp_path, images, path, method="convex+refine")
    line = ["convert", tmp_path / "result.h5", "-d", path, "-o", tmp_path / "meshes"]
    assert run_command([*map(str, line), "--to", "ply"]) == 1
    assert "gone: has no shape, and so no mesh" in capsys.readouterr().err
    written = {each.name for each in (tmp_path / "meshes").iterdir()}
    assert written == {"first.ply", "last.ply"}


@pytest.mark.parametrize(
    ("change", "keys", "message"),
    [
        ({"mesh_vertices": None, "mesh_faces": None}, {}, "has no mesh to export"),
        ({}, {"method": "pmp"}, "no coefficients to combine the meshes of the atoms"),
        ({}, {"export": {"folder": "-"}}, "give the name of a folder"),
        ({}, {"export": {"folder": "views.h5"}}, "it is not a folder"),
    ],
)
def test_fit_refuses_before_an_image_is_lifted(
    tmp_path, cars, world, monkeypatch, change, keys, message
):
    changed = tmp_path / "changed.h5"
    write_dictionary(changed, replace(read_dictionary(cars[0]), **change))
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(
        "shapefit.pipelines.fit.fit.lift_batch",
        lambda *_: pytest.fail("an image was lifted"),
    )
    images = load(world.images("cars")).take(slice(3))
    keys = {"export": {"folder": str(tmp_path / "meshes")}} | keys
    with pytest.raises(InputError, match=message):
        fit_images(tmp_path, images, changed, **keys)
    assert not (tmp_path / "result.h5").exists()


def test_convert_names_what_is_missing(tmp_path, cars, world):
    _, result = cars
    with pytest.raises(
        InputError, match=r"dictionary: .*name the dictionary of the fit"
    ):
        convert(result, None, tmp_path / "meshes")
    with pytest.raises(InputError, match="its landmarks are not those of"):
        convert(result, world.dictionary("people"), tmp_path / "meshes")
    assert not (tmp_path / "meshes").exists()


def test_a_shape_without_extent_has_no_mesh(cars):
    fit = read_results(cars[1]).take(slice(3))
    shapes = fit.as_columns().copy()
    shapes[0], shapes[2] = 1.0, np.nan
    assert has_shape(fit.replaced(shapes=shapes.swapaxes(1, 2))).tolist() == [
        False,
        True,
        False,
    ]


@pytest.mark.parametrize("to", PRECISION)
def test_vertices_that_coincide_stay_apart_in_one_object(to):
    corners = (
        np.array([[i >> 2 & 1, i >> 1 & 1, i & 1] for i in range(8)], float).T + 1 / 3
    )
    vertices = np.hstack([corners, corners])
    around = np.arange(8)
    faces = np.stack([around, (around + 1) % 8, (around + 3) % 8], axis=1)
    faces = np.concatenate([faces, faces + 8])
    content = mesh_file(vertices, faces, to)
    assert content == mesh_file(vertices, faces, to)
    scene = trimesh.load_scene(
        BytesIO(content), file_type=to, process=False, split_objects=True
    )
    (mesh,) = scene.geometry.values()
    np.testing.assert_allclose(mesh.vertices, vertices.T, atol=PRECISION[to])
    np.testing.assert_array_equal(mesh.faces, faces)
    if to == "ply":
        assert content.startswith(b"ply\nformat binary_little_endian 1.0\n")
    elif to == "obj":
        assert {line.split()[0] for line in content.decode().splitlines()} == {
            "o",
            "v",
            "f",
        }
    else:
        magic, version, length, size = struct.unpack("<4sIII", content[:16])
        assert magic == b"glTF"
        assert version == 2
        assert length == len(content)
        (material,) = json.loads(content[20 : 20 + size])["materials"]
        assert (
            material["pbrMetallicRoughness"]["metallicFactor"] == 0
        )  # else it is black

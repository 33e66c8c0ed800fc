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
from numpy.testing import assert_allclose, assert_array_equal
from shapefit.cli.main import run as run_command

from shapefit.config import CONFIGS
from shapefit.errors import InputError
from shapefit.io import read_dictionary, read_results, write_dictionary
from shapefit.pipelines.convert import convert_files as run
from shapefit.pipelines.meshes import encode_mesh, has_shape
from tests.io.files import load
from tests.pipelines.fitted import fit_images, texts

# OBJ: 8 decimals. PLY and GLB: single precision.
PRECISION = {"obj": 5.1e-9, "ply": 4e-7, "glb": 4e-7}


def convert(result, dictionary, folder, to="ply"):
    """Write meshes of a result by a dictionary, or by none; return the outcomes."""
    arguments = {"files": [str(result)], "output": str(folder), "to": to}
    if dictionary is not None:
        arguments["dictionary"] = str(dictionary)
    return list(run(CONFIGS["convert"](**arguments)))


def only_mesh(file, **options):
    """The one object of a file as it stands; frames of viewers do not matter."""
    scene = trimesh.load_scene(file, process=False, split_objects=True, **options)
    (mesh,) = scene.geometry.values()
    return mesh


@pytest.fixture(scope="session")
def cars(world):
    return world.dictionary("cars"), world.fit("cars", method="convex+refine")


def metres(dictionary, c):
    """The length of a normalised unit: the sizes of the atoms, by their shares."""
    norms = np.linalg.norm(dictionary.atoms, axis=(1, 2))
    shares = c * norms / (c * norms).sum()
    size = shares @ (dictionary.atom_scale * norms)
    mixed = np.tensordot(c, dictionary.atoms, axes=1)
    return size / np.linalg.norm(mixed)


def mesh_in_metres(dictionary, c):
    """Return the vertices (3, q) of the meshes of atoms, mixed by coefficients."""
    placed = dictionary.mesh_vertices - dictionary.atom_origin[:, :, None]
    return metres(dictionary, c) * np.tensordot(c, placed, axes=1)


SOME_IMAGES = range(0, 108, 20)


@pytest.mark.parametrize("to", PRECISION)
def test_every_image_has_a_mesh(tmp_path, cars, to):
    dictionary, result = cars
    folder = tmp_path / "meshes"
    outcomes = convert(result, dictionary, folder, to)
    assert sum(outcome.done for outcome in outcomes) == 108
    assert outcomes[-1].note == "108 meshes"
    assert outcomes[-1].written == (folder,)
    assert len(list(folder.rglob(f"*.{to}"))) == 108


@pytest.mark.parametrize("to", PRECISION)
def test_the_mesh_is_that_of_the_coefficients(tmp_path, cars, to):
    path, result = cars
    dictionary = read_dictionary(path)
    fit = read_results(result)
    convert(result, path, tmp_path, to)
    for image in SOME_IMAGES:
        mesh = only_mesh(tmp_path / f"{fit.items[image]}.{to}")
        vertices = mesh_in_metres(dictionary, fit.coefficients[image])
        assert_allclose(mesh.vertices.T, vertices, atol=PRECISION[to])
        assert_array_equal(mesh.faces, dictionary.mesh_faces)


@pytest.mark.parametrize("to", PRECISION)
def test_meshes_of_cars_are_closed_and_as_large_as_cars(tmp_path, cars, to):
    path, result = cars
    items = read_results(result).items
    convert(result, path, tmp_path, to)
    for image in SOME_IMAGES:
        mesh = only_mesh(tmp_path / f"{items[image]}.{to}")
        width, height, length = mesh.extents
        ground = mesh.bounds[0, 1]
        assert mesh.is_watertight
        assert mesh.volume > 0
        assert 1.5 < width < 2.5
        assert 1.2 < height < 2.3
        assert 3.3 < length < 5.6
        assert ground == pytest.approx(0, abs=1e-6)


@pytest.fixture
def few_images(world):
    """Three images, of which the second has two landmarks; `items` are their names."""
    images = load(world.images("cars")).take(slice(0, 108, 40))
    images.landmarks[1, 2:] = np.nan

    def named(*items):
        return images.replaced(items=items)

    return named


ODD_ITEMS = ("../up", "gone", "a:b/c")


ODD_FILES = ["%2E%2E/up.ply", "a%3Ab/c.ply"]
"""Files of the items that have a shape."""


@pytest.fixture
def exported(tmp_path, cars, few_images):
    """Fit the images, with an export of meshes; return the folder and the outcomes."""
    folder = tmp_path / "of_fit"
    keys = {"method": "convex+refine", "export": {"folder": str(folder)}}
    dictionary, _ = cars
    _, outcomes = fit_images(tmp_path, few_images(*ODD_ITEMS), dictionary, **keys)
    return folder, outcomes


def relative_files(folder):
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*.ply"))


def test_a_fit_writes_meshes_of_the_images_that_have_a_shape(exported):
    folder, outcomes = exported
    failed = [failure for outcome in outcomes for failure in outcome.failures]
    assert "1 image without a shape and a mesh" in texts(outcomes)
    assert len(failed) == 1
    assert relative_files(folder) == ODD_FILES


@pytest.fixture
def one_at_a_time(monkeypatch):
    monkeypatch.setattr("shapefit.pipelines.meshes.MESHES_AT_ONCE", 1)


def test_a_fit_says_how_far_it_is_with_meshes_and_how_many_it_has(
    one_at_a_time, exported
):
    _, outcomes = exported
    notes = [outcome.note for outcome in outcomes if "meshes" in outcome.note]
    progress = [f"meshes of {done} of 3 images" for done in (1, 2, 3)]
    assert notes == [*progress, f"{len(ODD_FILES)} meshes"]


def test_fit_writes_what_convert_writes(tmp_path, cars, exported):
    folder, _ = exported
    dictionary, _ = cars
    converted = tmp_path / "converted"
    outcomes = convert(tmp_path / "result.h5", dictionary, converted)
    failed = [failure for outcome in outcomes for failure in outcome.failures]
    assert failed == [("gone", "has no shape, and so no mesh")]
    assert relative_files(converted) == ODD_FILES
    for name in ODD_FILES:
        assert (folder / name).read_bytes() == (converted / name).read_bytes()


def test_the_command_names_images_without_a_mesh_and_ends_with_1(
    tmp_path, cars, few_images, capsys
):
    dictionary, _ = cars
    meshes = tmp_path / "meshes"
    images = few_images("first", "gone", "last")
    fit_images(tmp_path, images, dictionary, method="convex+refine")
    command = ["convert", tmp_path / "result.h5", "-d", dictionary, "-o", meshes]
    code = run_command([*map(str, command), "--to", "ply"])
    assert code == 1
    assert "gone: has no shape, and so no mesh" in capsys.readouterr().err
    assert {path.name for path in meshes.iterdir()} == {"first.ply", "last.ply"}


WITHOUT_MESH = {"mesh_vertices": None, "mesh_faces": None}


REFUSED = [
    (WITHOUT_MESH, {}, "has no mesh to export"),
    ({}, {"method": "pmp"}, "no coefficients to combine the meshes of the atoms"),
    ({}, {"export": {"folder": "-"}}, "give the name of a folder"),
    ({}, {"export": {"folder": "views.h5"}}, "it is not a folder"),
]
"""Fields of the dictionary, keys, and what is said."""


@pytest.mark.parametrize(("fields", "keys", "message"), REFUSED)
def test_fit_refuses_before_an_image_is_lifted(
    tmp_path, cars, few_images, monkeypatch, fields, keys, message
):
    def fail(*_):
        pytest.fail("an image was lifted")

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("shapefit.pipelines.fit.fit.lift_batch", fail)
    path, _ = cars
    changed = tmp_path / "changed.h5"
    write_dictionary(changed, replace(read_dictionary(path), **fields))
    keys = {"export": {"folder": str(tmp_path / "meshes")}} | keys
    with pytest.raises(InputError, match=message):
        fit_images(tmp_path, few_images("a", "b", "c"), changed, **keys)
    assert not (tmp_path / "result.h5").exists()


def test_convert_asks_for_the_dictionary(tmp_path, cars):
    _, result = cars
    fault = r"dictionary: .*name the dictionary of the fit"
    with pytest.raises(InputError, match=fault):
        convert(result, None, tmp_path / "meshes")
    assert not (tmp_path / "meshes").exists()


def test_convert_refuses_the_dictionary_of_another_class(tmp_path, cars, world):
    _, result = cars
    people = world.dictionary("people")
    with pytest.raises(InputError, match="its landmarks are not those of"):
        convert(result, people, tmp_path / "meshes")
    assert not (tmp_path / "meshes").exists()


def test_a_shape_without_extent_has_no_mesh(cars):
    _, result = cars
    fit = read_results(result).take(slice(3))
    shapes = fit.shapes.copy()
    shapes[0] = 1.0
    shapes[2] = np.nan
    found = has_shape(fit.replaced(shapes=shapes))
    assert found.tolist() == [False, True, False]


@pytest.fixture
def two_cubes():
    """Vertices (3, 16) of two cubes in one place, and their faces."""
    bits = [[i >> 2 & 1, i >> 1 & 1, i & 1] for i in range(8)]
    corners = np.array(bits, float).T + 1 / 3
    around = np.arange(8)
    faces = np.stack([around, (around + 1) % 8, (around + 3) % 8], axis=1)
    vertices = np.hstack([corners, corners])
    return vertices, np.concatenate([faces, faces + 8])


@pytest.mark.parametrize("to", PRECISION)
def test_vertices_that_coincide_stay_apart_in_one_object(two_cubes, to):
    vertices, faces = two_cubes
    content = encode_mesh(vertices, faces, to)
    mesh = only_mesh(BytesIO(content), file_type=to)
    assert content == encode_mesh(vertices, faces, to)
    assert_allclose(mesh.vertices, vertices.T, atol=PRECISION[to])
    assert_array_equal(mesh.faces, faces)


def test_ply_is_binary(two_cubes):
    content = encode_mesh(*two_cubes, "ply")
    assert content.startswith(b"ply\nformat binary_little_endian 1.0\n")


def test_obj_has_an_object_vertices_and_faces(two_cubes):
    lines = encode_mesh(*two_cubes, "obj").decode().splitlines()
    assert {line.split()[0] for line in lines} == {"o", "v", "f"}


def test_glb_says_its_length_and_is_no_metal(two_cubes):
    """Which would be black."""
    content = encode_mesh(*two_cubes, "glb")
    magic, version, length, size = struct.unpack("<4sIII", content[:16])
    (material,) = json.loads(content[20 : 20 + size])["materials"]
    assert magic == b"glTF"
    assert version == 2
    assert length == len(content)
    assert material["pbrMetallicRoughness"]["metallicFactor"] == 0

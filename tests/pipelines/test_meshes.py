"""Meshes of results: what `convert` and `export` of `fit` write is opened again by trimesh."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from shapefit.config import CONFIGS
from shapefit.errors import InputError
from shapefit.io import read_dictionary, read_results, write_dictionary
from shapefit.pipelines.convert import run
from shapefit.pipelines.meshes import has_shape
from tests.io.files import load, save
from tests.pipelines.fitted import fit_images

# OBJ: 8 decimals. PLY and GLB: single precision.
PRECISION = {"obj": 5.1e-9, "ply": 4e-7, "glb": 4e-7}


def convert(result, dictionary, folder, to="ply"):
    arguments = {"files": [str(result)], "output": str(folder), "to": to}
    named = {} if dictionary is None else {"dictionary": str(dictionary)}
    return list(run(CONFIGS["convert"](**arguments, **named)))


def only_mesh(path):
    """The one object of a file as it stands; frames of viewers do not matter."""
    (mesh,) = trimesh.load_scene(path, process=False, split_objects=True).geometry.values()
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
    dictionary, fit = read_dictionary(path), read_results(result)
    outcomes = convert(result, path, tmp_path / "meshes", to)
    assert sum(outcome.done for outcome in outcomes) == len(fit) == 108
    assert (outcomes[-1].note, outcomes[-1].written) == ("108 meshes", (tmp_path / "meshes",))
    assert len(list((tmp_path / "meshes").rglob(f"*.{to}"))) == 108
    for image in range(0, 108, 20):
        c = fit.coefficients[image]
        vertices = metres(dictionary, c) * np.tensordot(c, dictionary.mesh_vertices, axes=1)
        mesh = only_mesh(tmp_path / "meshes" / f"{fit.items[image]}.{to}")
        np.testing.assert_allclose(mesh.vertices.T, vertices, atol=PRECISION[to])
        np.testing.assert_array_equal(mesh.faces, dictionary.mesh_faces)
        assert mesh.is_watertight
        assert mesh.volume > 0
        width, height, length = mesh.extents
        assert 1.5 < width < 2.5
        assert 1.2 < height < 2.3
        assert 3.3 < length < 5.6


def test_fit_writes_what_convert_writes(tmp_path, cars, world):
    path, _ = cars
    images = load(world.images("cars")).take(slice(0, 108, 40))
    landmarks = images.landmarks.copy()
    landmarks[1, :, 2:] = np.nan
    images = images.replaced(landmarks=landmarks, items=("../up", "gone", "a:b/c"))
    keys = {"method": "convex+refine", "export": {"folder": str(tmp_path / "of_fit")}}
    _, outcomes = fit_images(tmp_path, images, path, **keys)
    missing = "images without a shape (failed, or with all coefficients 0): 1; they have no mesh"
    assert missing in [text for outcome in outcomes for text in outcome.warnings]
    outcomes = convert(tmp_path / "result.h5", path, tmp_path / "converted")
    assert outcomes[-1].warnings == (missing,)
    files = sorted((tmp_path / "converted").rglob("*.ply"))
    assert [str(each.relative_to(tmp_path / "converted")) for each in files] == [
        "%2E%2E/up.ply",
        "a%3Ab/c.ply",
    ]
    for each in files:
        same = tmp_path / "of_fit" / each.relative_to(tmp_path / "converted")
        assert same.read_bytes() == each.read_bytes()


def test_people_are_a_closed_tube_a_bone(tmp_path, world):
    path = world.dictionary("exemplars of people")
    result = world.fit("people", "exemplars of people", method="convex+refine")
    dictionary, fit = read_dictionary(path), read_results(result)
    convert(result, path, tmp_path / "meshes")
    for image, item in enumerate(fit.items[:3]):
        points = fit.shapes[image] - np.array([*fit.translation[image], 0])[:, None]
        size = metres(dictionary, fit.coefficients[image]) / fit.scale[image]
        points = size * fit.rotation[image].T @ points
        mesh = only_mesh(tmp_path / "meshes" / f"{item}.ply")
        parts = mesh.split()
        assert mesh.is_watertight
        assert len(parts) == len(dictionary.edges)
        middles = np.array([part.vertices.mean(axis=0) for part in parts])
        expected = points[:, dictionary.edges].mean(axis=2).T
        apart = np.linalg.norm(middles[:, None] - expected[None], axis=2)
        assert apart.min(axis=0).max() < 1e-6 * np.ptp(points, axis=1).max()


@pytest.mark.parametrize(
    ("change", "keys", "message"),
    [
        (
            {"edges": None, "mesh_vertices": None, "mesh_faces": None},
            {},
            "neither a mesh nor edges",
        ),
        ({}, {"method": "pmp"}, "no coefficients to combine the meshes of the atoms"),
        ({}, {"export": {"folder": "-"}}, "standard output; give the name of a folder"),
        ({}, {"export": {"folder": "views.h5"}}, "it is not a folder"),
        ({}, {"export": {"folder": "result.h5"}}, "is also the output; give it a different name"),
    ],
)
def test_fit_refuses_before_an_image_is_lifted(
    tmp_path, cars, world, monkeypatch, change, keys, message
):
    changed = tmp_path / "changed.h5"
    write_dictionary(changed, replace(read_dictionary(cars[0]), **change))
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(
        "shapefit.pipelines.fit.run.lift_batch", lambda *_: pytest.fail("an image was lifted")
    )
    images = load(world.images("cars")).take(slice(3))
    keys = {"export": {"folder": str(tmp_path / "meshes")}} | keys
    with pytest.raises(InputError, match=message):
        fit_images(tmp_path, images, changed, **keys)
    assert not (tmp_path / "result.h5").exists()


def test_convert_names_what_is_missing(tmp_path, cars, world):
    _, result = cars
    with pytest.raises(InputError, match=r"dictionary: .*name the dictionary of the fit"):
        convert(result, None, tmp_path / "meshes")
    with pytest.raises(InputError, match="its landmarks are not those of"):
        convert(result, world.dictionary("people"), tmp_path / "meshes")
    assert not (tmp_path / "meshes").exists()


def test_what_is_too_large_for_single_precision_has_no_mesh(tmp_path, cars, world):
    dictionary = replace(read_dictionary(cars[0]), atom_scale=None)
    write_dictionary(tmp_path / "pixels.h5", dictionary)
    fit = read_results(cars[1]).take(slice(3))
    scale = fit.scale * np.array([1, 1e45, 1])
    save(tmp_path / "large.h5", fit.replaced(scale=scale))
    for to, meshes in (("ply", 2), ("obj", 3)):
        outcomes = convert(tmp_path / "large.h5", tmp_path / "pixels.h5", tmp_path / to, to)
        assert outcomes[-1].note == f"{meshes} meshes"
        assert len(outcomes[-1].warnings) == 3 - meshes


def test_a_shape_without_extent_has_no_mesh(cars):
    fit = read_results(cars[1]).take(slice(3))
    shapes = fit.shapes.copy()
    shapes[0], shapes[2] = 1.0, np.nan
    assert has_shape(fit.replaced(shapes=shapes)).tolist() == [False, True, False]

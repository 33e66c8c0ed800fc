"""Meshes of cars in GLB: vertices that are landmarks lie where TRC has the landmarks."""

import numpy as np
import pytest
import trimesh
from shapefit.cli.main import run

from shapefit.io import read_shapes
from tests.io.written.test_glb import MILLIMETRE, File


@pytest.fixture(scope="module")
def fitted(project, tmp_path_factory):
    """A folder with a dictionary of cars, a result with it, and GLB and TRC of the result."""
    folder, samples = tmp_path_factory.mktemp("cars"), project / "sample_data"
    cars, result = str(folder / "cars.h5"), str(folder / "result.h5")
    learned = ["--set", "method=exemplars", "--set", "align=none"]
    keys = ["--set", "method=convex+refine", "--set", "lambda=0.01"]
    for command in (
        ["learn-dict", str(samples / "cars.h5"), "-o", cars, *learned],
        ["fit", str(samples / "cars_views.h5"), "-d", cars, "-o", result, *keys],
        ["convert", result, "-o", str(folder / "cars.glb")],
        ["convert", result, "-o", str(folder / "cars.trc")],
        [
            "fit",
            str(samples / "cars_views.h5"),
            "-d",
            cars,
            "-o",
            str(folder / "at_once.glb"),
            *keys,
        ],
    ):
        assert run(command) == 0
    return folder


def test_vertices_are_where_the_landmarks_are(project, fitted, tmp_path):
    cars = read_shapes([project / "sample_data/cars.h5"])
    apart = cars.mesh_vertices[0, :, None, :] - cars.shapes[0, :, :, None]
    vertex = (apart**2).sum(axis=0).argmin(axis=1)  # of each landmark
    truth = read_shapes([fitted / "cars.trc"]).shapes
    file = File(fitted / "cars.glb")
    (mesh,) = file.parts["meshes"]
    (solid,) = mesh["primitives"]
    base = file.array(solid["attributes"]["POSITION"])
    targets = np.array([file.array(target["POSITION"]) for target in solid["targets"]])
    (weights,) = (
        file.array(file.parts["animations"][0]["samplers"][channel["sampler"]]["output"])
        for channel in file.parts["animations"][0]["channels"]
        if channel["target"]["path"] == "weights"
    )
    weights = weights.reshape(len(truth), len(targets))
    np.testing.assert_allclose(weights.sum(axis=1), 1, atol=1e-6)
    assert (np.count_nonzero(weights > 1e-6, axis=1) > 1).any()
    for frame in (0, 50, 107):
        posed = file.posed(tmp_path / "posed.glb", frame)
        move = posed.graph.get(file.parts["nodes"][0]["name"])[0]
        mixed = base + np.tensordot(weights[frame], targets, axes=1)
        moved = mixed[vertex] @ move[:3, :3].T + move[:3, 3]
        np.testing.assert_allclose(moved, truth[frame].T, atol=MILLIMETRE)


def test_trimesh_shows_a_car_of_the_size_of_one(fitted):
    extent = np.ptp(trimesh.load(fitted / "cars.glb").bounds, axis=0)
    assert 3 < np.linalg.norm(extent) < 7


def test_fit_writes_the_same_at_once(fitted):
    assert (fitted / "at_once.glb").read_bytes() == (fitted / "cars.glb").read_bytes()


def test_without_the_dictionary_there_are_bones(fitted, tmp_path):
    content = (fitted / "cars.h5").read_bytes()
    (fitted / "cars.h5").unlink()
    assert run(["convert", str(fitted / "result.h5"), "-o", str(tmp_path / "cars.glb")]) == 0
    (fitted / "cars.h5").write_bytes(content)
    assert "skins" in File(tmp_path / "cars.glb").parts

"""Meshes that the browser blends are those that `fit` exports."""

import numpy as np
import pytest
import trimesh

from shapefit.geometry.procrustes import similarity_transform
from shapefit.io import read_results
from tests.pipelines.fitted import fit_file

ITEMS = ("sedan_2/view_1", "pickup_1/view_4")
MESH = "return Array.from(shapefit.layer(arguments[0]).mesh(shapefit.view.frame))"
POINTS = "return Array.from(shapefit.layer(arguments[0]).points(shapefit.view.frame))"
IN_IMAGE = """
  const layer = shapefit.layer(arguments[0]);
  return Array.from(layer.inImage(shapefit.view.frame, layer.points(shapefit.view.frame)));
"""


@pytest.fixture(scope="module")
def cars(world, tmp_path_factory):
    """Made cars, fitted in weak perspective and under a camera, with the meshes of two of them."""
    folder = tmp_path_factory.mktemp("cars")
    cameras = {"weak": {}, "perspective": {"focal": "files"}}
    for name, camera in cameras.items():
        export = {"folder": folder / name}
        keys = {"method": "convex+refine", "camera": camera, "export": export, "lambda": 1.0}
        fit_file(world.images("cars"), world.dictionary("cars"), folder / f"{name}.h5", **keys)
    return folder


@pytest.fixture(scope="module")
def made(cars, view, project, world):
    files = {name: (cars / f"{name}.h5",) for name in ("weak", "perspective")}
    truth = (project / "sample_data/cars.h5",)
    return view(files, truth=truth, match="true_model", dictionary=world.dictionary("cars"))


@pytest.mark.parametrize("method", ["weak", "perspective"])
@pytest.mark.parametrize("item", ITEMS)
def test_a_blended_mesh_is_the_exported_one(made, cars, open_page, method, item):
    """In the space of the page, which differs by a similarity."""
    results = read_results(cars / f"{method}.h5")
    row = results.items.index(item)
    page = open_page(made.path, f"#item={item}")
    mesh, points = (np.array(page.run(each, method)).reshape(-1, 3).T for each in (MESH, POINTS))
    shape = results.shapes[row]
    exported = trimesh.load(cars / method / f"{item}.ply", process=False).vertices.T
    turned = results.rotation[row] @ exported
    for shown, expected in ((points, shape), (mesh, turned)):
        away = similarity_transform(expected, shown).apply(expected) - shown
        assert np.abs(away).max() < 1e-4 * np.ptp(shown)
    spans = np.ptp(mesh, axis=1), np.ptp(turned, axis=1)
    assert 1 < spans[0][1] < 3  # metres
    if method == "perspective":  # this one is where the camera has it: not turned
        np.testing.assert_allclose(spans[0] / spans[0][0], spans[1] / spans[1][0], rtol=1e-3)


def test_landmarks_are_seen_where_the_camera_sees_them(made, cars, open_page):
    results = read_results(cars / "perspective.h5")
    row = results.items.index(ITEMS[0])
    page = open_page(made.path, f"#item={ITEMS[0]}")
    seen = np.array(page.run(IN_IMAGE, "perspective")).reshape(-1, 2)
    size = np.ptp(results.landmarks_fitted[row])
    np.testing.assert_allclose(seen, results.landmarks_fitted[row].T, atol=1e-3 * size)
    flat = results.shapes[row, :2].T
    assert np.abs(flat - results.landmarks_fitted[row].T).max() > 1e-2 * size


def test_the_mesh_of_the_truth_lies_on_the_result(made, open_page):
    page = open_page(made.path, f"#item={ITEMS[0]}")
    fitted = np.array(page.run(MESH, "weak")).reshape(-1, 3)
    true = np.array(page.run(MESH, "truth")).reshape(-1, 3)
    assert np.abs(fitted.mean(axis=0) - true.mean(axis=0)).max() < 0.05 * np.ptp(fitted)
    assert page.complaints() == []

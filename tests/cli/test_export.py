"""Meshes and pictures through the command line: from models to files that open."""

import shutil
import subprocess
import sys

import numpy as np
import pytest
import trimesh
from matplotlib.image import imread

from shapefit.io import read_results
from tests.cli.conftest import run_in

FEW = "item,landmark,x,y\nlorry,left_front_wheel,1,2\nlorry,left_rear_wheel,3,4\n"


@pytest.fixture(scope="module")
def folder(world, tmp_path_factory):
    """A folder with the dictionary of the sample cars."""
    folder = tmp_path_factory.mktemp("cars")
    shutil.copy(world.dictionary("cars"), folder / "cars.h5")
    return folder


@pytest.fixture(scope="module")
def fit(project, folder):
    """Return the function that fits sample views, or other landmarks, with a config of its own."""
    (folder / "fit.yaml").write_text(
        "dictionary: cars.h5\n"
        "output: result.h5\n"
        "method: convex+refine\n"
        "export: {folder: meshes, format: glb, unit: dictionary}\n"
        "pictures: {folder: pictures, items: [van_*/view_1], sheet: 6}\n"
    )

    def run(*options, landmarks=project / "sample_data/cars_views.h5"):
        settings = [word for option in options for word in ("--set", option)]
        return run_in(folder, "fit", "-c", "fit.yaml", landmarks, *settings)

    return run


def below(folder):
    return sorted(path for path in folder.rglob("*") if path.is_file())


def test_cars_come_out_as_meshes_and_pictures(folder, fit):
    told = fit()
    assert told.returncode == 0, told.stderr
    assert told.stderr.rstrip().endswith(
        "; 108 meshes, 2 pictures, contact sheet of 6; "
        "wrote result.h5, meshes, pictures, pictures/contact_sheet.png"
    )
    items = read_results(folder / "result.h5").items
    files = below(folder / "meshes")
    assert files == sorted(folder / "meshes" / f"{item}.glb" for item in items)
    for path in files[::20]:
        objects = trimesh.load_scene(path).geometry
        assert set(objects) == {"mesh"}
        assert objects["mesh"].is_watertight
        np.testing.assert_array_less(objects["mesh"].extents, [2.5, 2.3, 5.6])
        np.testing.assert_array_less([1.5, 1.2, 3.3], objects["mesh"].extents)
    drawn = below(folder / "pictures")
    assert [path.name for path in drawn] == ["contact_sheet.png", "view_1.png", "view_1.png"]
    assert all(imread(path).ndim == 3 for path in drawn)


def test_what_cannot_be_exported_is_bad_usage(fit):
    told = fit("export.format=stl")
    assert told.returncode == 2
    assert "--set export.format=stl: " in told.stderr
    told = fit("method=mean-shape")
    assert told.returncode == 2
    assert told.stderr.startswith("Error: export: `method: mean-shape` gives no coefficients")


def test_an_image_that_fails_is_counted_among_the_meshes_too(folder, fit):
    (folder / "few.csv").write_text(FEW)
    told = fit("export.folder=few", "pictures.sheet=0", landmarks="few.csv")
    assert told.returncode == 1
    assert "Failed: lorry: only 2 visible landmarks" in told.stderr
    assert "Warning: images without a shape (failed, or with all coefficients 0): 1" in told.stderr
    assert "; 0 meshes, 0 pictures; wrote" in told.stderr
    assert below(folder / "few") == []


def test_without_export_neither_trimesh_nor_matplotlib_is_imported(project, folder):
    script = """
import sys
from shapefit.config import FitConfig
from shapefit.pipelines.fit.run import run

views, export = sys.argv[1:]
asked = {"export": {"folder": export}} if export else {}
for _ in run(FitConfig(landmarks=views, dictionary="cars.h5", output="shapes.h5", **asked)):
    pass
print(*sorted({"trimesh", "matplotlib"} & set(sys.modules)))
"""
    views = str(project / "sample_data/cars_views.h5")
    for export, imported in (("", "\n"), ("lazy", "trimesh\n")):
        told = subprocess.run(
            [sys.executable, "-c", script, views, export],
            cwd=folder, capture_output=True, text=True, check=True,
        )  # fmt: skip
        assert told.stdout == imported

"""The command line gives one answer: whatever the format, the level, the files or the threads."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from shapefit.cli.main import run

from shapefit import core
from shapefit.io import read_dictionary, read_results, read_shapes, write_shapes

LOSSES = ("squared", "exact", "l1", "sparse-error")
COMMAND = Path(sys.executable).with_name("shapefit")
FINE = "--set=solver.tolerance=1e-9"


def term(loss: str) -> str:
    """Return the setting that chooses a data term."""
    key = "loss" if loss in ("squared", "exact") else "outliers.method"
    return f"--set={key}={loss}"


def shapefit(*words: object) -> None:
    assert run([str(word) for word in words]) == 0


@pytest.fixture(scope="module")
def files(project, tmp_path_factory):
    """Shapes as HDF5 and as CSV, views of them in both, and a dictionary."""
    folder = tmp_path_factory.mktemp("files")
    shapes = read_shapes([project / "sample_data/people_test.h5"])
    shapes = shapes.take(np.arange(0, len(shapes), 7))
    write_shapes(folder / "shapes.h5", shapes)
    write_shapes(folder / "shapes.csv", shapes)
    noisy = ("--set=camera.view=random", "--set=noise=0.02", "--set=hidden=0.1")
    for ending in ("h5", "csv"):
        shapefit("project", folder / f"shapes.{ending}", "-o", folder / f"views.{ending}", *noisy)
    training = project / "sample_data/people_train.h5"
    shapefit("learn-dict", training, "-o", folder / "d.h5", "--set=k=12", "--set=iterations=1")
    return folder


def fit(files: Path, output: Path, *settings: object, views: str = "views.h5"):
    shapefit("fit", files / views, "-d", files / "d.h5", "-o", output, *settings)
    return read_results(output)


@pytest.mark.parametrize(
    "settings",
    [
        ("--set=k=6", "--set=iterations=2"),
        ("--set=method=exemplars",),
        ("--set=method=pca-bases",),
    ],
)
def test_a_dictionary_has_the_same_bits_from_both_formats(files, tmp_path, settings):
    for ending in ("h5", "csv"):
        shapefit(
            "learn-dict",
            files / f"shapes.{ending}",
            "-o",
            tmp_path / f"from-{ending}.h5",
            *settings,
        )
    one, other = (read_dictionary(tmp_path / f"from-{ending}.h5") for ending in ("h5", "csv"))
    np.testing.assert_array_equal(one.atoms, other.atoms)
    np.testing.assert_array_equal(one.mean_shape, other.mean_shape)
    assert one.landmark_names == other.landmark_names


@pytest.mark.parametrize("loss", LOSSES)
def test_one_file_or_several_have_one_optimum(files, tmp_path, loss):
    lines = (files / "views.csv").read_text().splitlines()
    items = list(dict.fromkeys(line.split(",")[0] for line in lines[1:]))
    late = set(items[len(items) // 3 :])
    for name, part in (("a", items[: len(items) // 3]), ("b", late)):
        rows = [line for line in lines[1:] if line.split(",")[0] in part]
        (tmp_path / f"{name}.csv").write_text("\n".join([lines[0], *rows]) + "\n")
    paths = (tmp_path / "b.csv", tmp_path / "a.csv")
    settings = (term(loss), FINE)
    shapefit("fit", *paths, "-d", files / "d.h5", "-o", tmp_path / "parts.h5", *settings)
    parts = read_results(tmp_path / "parts.h5")
    whole = fit(files, tmp_path / "whole.h5", *settings, views="views.csv")
    order = [parts.items.index(item) for item in whole.items]
    np.testing.assert_allclose(parts.objective[order], whole.objective, rtol=1e-7)
    if loss in ("squared", "l1"):
        size = np.abs(whole.shapes).max()
        np.testing.assert_allclose(parts.shapes[order], whole.shapes, atol=1e-3 * size)


@pytest.mark.parametrize("loss", LOSSES)
def test_levels_of_the_processor_have_one_optimum_and_a_proof(files, tmp_path, loss):
    expected = fit(files, tmp_path / "here.h5", term(loss), FINE)
    for level in core.LEVELS:
        output = tmp_path / f"{level}.h5"
        words = ["fit", files / "views.h5", "-d", files / "d.h5", "-o", output]
        command = [COMMAND, *words, term(loss), FINE]
        environment = os.environ | {"SHAPEFIT_LEVEL": str(level)}
        subprocess.run(command, env=environment, check=True, capture_output=True, timeout=120)
        found = read_results(output)
        np.testing.assert_array_equal(found.status, expected.status)
        np.testing.assert_allclose(found.objective, expected.objective, rtol=1e-7)
        shapefit("verify", output, "-d", files / "d.h5", "--landmarks", files / "views.h5")

"""The commands one after the other: sample data, and shapes drawn from a prior."""

import csv
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from shapefit.dictionary.mixture import Mixture
from shapefit.dictionary.model import Dictionary
from shapefit.geometry.rotations import random_rotations
from shapefit.io import LandmarkSet, write_dictionary, write_shapes
from shapefit.io.records import ShapeSet
from tests.cli.conftest import run_in
from tests.io.files import save

SMALL = ("--set", "k=16", "--set", "iterations=2")


def shapefit(*arguments: object, folder: Path, text: str = "") -> SimpleNamespace:
    """Run a command in `folder`; fail with what it says unless it exits with 0."""
    result = run_in(folder, *arguments, text=text)
    assert result.returncode == 0, result.stderr
    return result


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


RESIDUAL_VARIANCE, SIZE, N, P = 0.005, 30.0, 400, 9
NAMES = tuple(f"point{j}" for j in range(P))
ITEMS = tuple(f"image{i}" for i in range(N))
FIT = f"""
landmarks: views.h5
dictionary: dictionary.h5
output: result.h5
method: posterior
lambda: 0.1
tolerance: 0.001
prior: {{residual_variance: {RESIDUAL_VARIANCE}, scale: 1}}
"""


@pytest.fixture
def drawn(tmp_path, rng):
    """A folder with a dictionary, and the shapes and views drawn from its prior."""
    means = rng.standard_normal((1, 3, P)) + 0.4 * rng.standard_normal((3, 3, P))
    means -= means.mean(axis=2, keepdims=True)
    B = 0.08 * rng.standard_normal((3, 3 * P, 3 * P))
    C = B @ B.swapaxes(1, 2) / (3 * P) * 4 + 0.01 * np.eye(3 * P)
    prior = Mixture(np.array([0.5, 0.3, 0.2]), means, C)
    k = rng.choice(3, size=N, p=prior.weights)
    roots = np.linalg.cholesky(C)[k]
    x = means[k] + (roots @ rng.standard_normal((N, 3 * P, 1))).reshape(N, 3, P)
    R = random_rotations(N, rng)
    w = (R @ x)[:, :2] + np.sqrt(RESIDUAL_VARIANCE) * rng.standard_normal((N, 2, P))
    atoms = means / 5
    write_dictionary(
        tmp_path / "dictionary.h5", Dictionary(atoms, NAMES, means.mean(axis=0), prior=prior)
    )
    write_shapes(tmp_path / "truth.h5", ShapeSet(shapes=x, landmark_names=NAMES, items=ITEMS))
    images = LandmarkSet(
        landmarks=SIZE * w + 100, landmark_names=NAMES, items=ITEMS, columns={"true_rotation": R}
    )
    save(tmp_path / "views.h5", images)
    (tmp_path / "fit.yaml").write_text(FIT)
    text = "results: {posterior: result.h5}\ntruth: truth.h5\noutput: report\nplots: false\n"
    (tmp_path / "eval.yaml").write_text(text)
    return tmp_path


def test_regions_of_shapes_drawn_from_the_prior_hold_what_they_say(drawn):
    shapefit("fit", "-c", "fit.yaml", folder=drawn)
    shown = shapefit("eval", "-c", "eval.yaml", folder=drawn)
    assert "90% bars hold" in shown.stdout
    found = {row["metric"]: row for row in rows(drawn / "report/report.csv")}
    for share in (0.5, 0.9):
        row = found[f"inside_{100 * share:.0f}"]
        assert int(row["images"]) == N * P
        # Landmarks of an image go together: at worst they count as one.
        error = np.sqrt(share * (1 - share) / N)
        assert float(row["mean"]) == pytest.approx(share, abs=4 * error)

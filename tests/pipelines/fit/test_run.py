"""`fit` from files to files: shapes that come back, what is stored."""

import json
import re
from functools import partial
from pathlib import Path

import h5py
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from shapefit.convex.solver import solve_newton
from shapefit.dictionary.model import Dictionary
from shapefit.geometry.rotations import rotation_angle
from shapefit.io import (
    read_dictionary,
    write_dictionary,
)
from shapefit.lifting.methods import METHODS
from shapefit.records import Landmarks
from tests.columns import in_rows
from tests.pipelines.fitted import failures, texts

PRIORLESS = [
    name for name, m in METHODS.items() if "prior" not in {n.name for n in m.needs}
]
"""Methods that the plain dictionary of these tests serves; the others have tests of
their own.
"""

NAMES = tuple(f"point{j}" for j in range(10))


@pytest.fixture
def truth(atoms, rotations):
    """The shapes (8, 10, 3) of the images."""
    shapes = 20 * rotations @ atoms[np.arange(8) % 6]
    shapes[:, :2] += np.array([100.0, 50.0])[:, None]
    return in_rows(shapes)


def test_an_exact_image_gives_its_shape_rotation_and_place(
    fit, dictionary, images, truth, rotations
):
    result, outcomes = fit(dictionary, images, **{"lambda": 1e-4})
    errors_of_rotation = rotation_angle(result.rotation, rotations)
    assert failures(outcomes) == {}
    assert_allclose(result.shapes, truth, atol=0.02)
    assert errors_of_rotation.max() < 0.1
    assert list(result.status) == ["optimal"] * 8
    assert (result.relative_gap <= 1e-4).all()
    assert result.unit == "px"
    assert result.y_axis == "down"


def test_what_proves_the_objective_is_stored(fit, dictionary, images, tmp_path):
    fit(dictionary, images)
    with h5py.File(tmp_path / "result.h5") as file:
        assert "dual" in file
        assert "convex_objective" not in file  # which is `objective`


def test_hidden_landmarks_are_filled_in_without_bias(fit, dictionary, images, truth):
    visible = images.landmarks.copy()
    rows = np.arange(8)
    images.landmarks[rows, rows] = np.nan
    images.landmarks[rows, rows - 1] = np.nan
    result, _ = fit(dictionary, images, **{"lambda": 1e-5})
    depths = result.shapes[..., 2]
    assert_allclose(result.shapes[..., :2], visible, atol=0.02)
    assert_allclose(depths, truth[..., 2], atol=0.1)


def test_a_landmark_counts_by_its_confidence(fit, dictionary, images):
    """The wrong landmark 3 is followed where it is sure, and hardly where it is
    not.
    """
    images.landmarks[:, 3] += 6.0
    distances = []
    for sure in (0.1, 1.0, 10.0):
        confidence = np.ones((8, 10))
        confidence[:, 3] = sure
        result, _ = fit(dictionary, images.replaced(confidence=confidence))
        residual = result.shapes[:, 3, :2] - images.landmarks[:, 3]
        distances.append(np.linalg.norm(residual, axis=1))
    unsure, usual, certain = distances
    assert (unsure > 1.5 * usual).all()
    assert (usual > 1.5 * certain).all()


@pytest.mark.parametrize("method", PRIORLESS)
def test_zero_images_give_zero_results(fit, dictionary, atoms, method):
    edges = np.array([[0, 1], [1, 2]])
    prior = read_dictionary(dictionary).prior
    with_edges = Dictionary(atoms, NAMES, atoms[0], edges=edges, prior=prior)
    write_dictionary(dictionary, with_edges)
    empty = Landmarks(np.empty((0, 10, 2)), landmark_names=NAMES, items=())
    result, outcomes = fit(dictionary, empty, method=method)
    assert result.shapes.shape == (0, 10, 3)
    assert failures(outcomes) == {}


@pytest.fixture
def two_iterations(monkeypatch):
    """Let the solver end before the optimum."""
    two = partial(solve_newton, max_iterations=2)
    monkeypatch.setattr("shapefit.pipelines.fit.atoms.solve_newton", two)


def result_line(outcomes):
    return dict(outcomes[-1].rows)["Result"]


def test_what_is_not_optimal_is_counted(fit, dictionary, images, two_iterations):
    _, outcomes = fit(dictionary, images, tolerance=1e-9)
    assert failures(outcomes) == {}
    assert texts(outcomes) == ["8 images not optimal"]


def test_a_search_that_gives_up_names_its_limit(fit, dictionary, images, monkeypatch):
    limit_cells = "shapefit.lifting.global_optimum.limit_cells"
    monkeypatch.setattr(limit_cells, lambda k, p: 1_000)
    _, outcomes = fit(dictionary, images, method="global", tolerance=1e-9)
    limit = "the search ended after 1,000 cells (docs/global.md)"
    assert f"8 images not optimal: {limit}" in texts(outcomes)


@pytest.mark.parametrize("method", ["convex", "global"])
def test_the_gap_of_methods_with_a_proof_is_seen(fit, dictionary, images, method):
    result, outcomes = fit(dictionary, images, method=method)
    numbers = outcomes[-1].numbers
    line = r"8 images, all optimal, largest gap (\S+) \("
    (shown_gap,) = re.match(line, result_line(outcomes)).groups()
    gap = result.relative_gap.max()
    assert numbers.images == 8
    assert numbers.optimal == 8
    assert numbers.largest_gap == gap
    assert float(shown_gap) == pytest.approx(gap, rel=0.06)


def test_the_gap_of_refined_images_is_to_the_convex_bound(fit, dictionary, images):
    result, outcomes = fit(dictionary, images, method="convex+refine")
    numbers = outcomes[-1].numbers
    line = r"8 images, within (\S+) of the convex bound \("
    (shown_gap,) = re.match(line, result_line(outcomes)).groups()
    gap = result.relative_gap.max()
    assert numbers.images == 8
    assert numbers.optimal is None
    assert numbers.largest_gap == gap
    assert float(shown_gap) == pytest.approx(gap, rel=0.06)


def test_a_method_without_a_bound_has_no_gap(fit, dictionary, images):
    result, outcomes = fit(dictionary, images, method="alternate")
    numbers = outcomes[-1].numbers
    assert result_line(outcomes).startswith("8 images (")
    assert result.relative_gap is None
    assert numbers.images == 8
    assert numbers.optimal is None
    assert numbers.largest_gap is None


def test_images_that_are_not_optimal_are_in_the_result_line(
    fit, dictionary, images, two_iterations
):
    images.landmarks[2] = 0.0  # fails: it has no gap
    result, outcomes = fit(dictionary, images, tolerance=1e-9)
    gap = np.nanmax(result.relative_gap)
    line = f"8 images, 7 not optimal, largest gap {gap:.1e}"
    assert result_line(outcomes).startswith(line)
    assert outcomes[-1].numbers.optimal == 0
    assert outcomes[-1].numbers.not_optimal == 7


def test_a_refined_view_says_the_gap_of_its_convex_program(
    fit, dictionary, images, tmp_path
):
    camera = {"focal": 900.0, "principal_point": [100.0, 50.0]}
    result, outcomes = fit(dictionary, images, camera=camera)
    with h5py.File(tmp_path / "result.h5") as file:
        largest = file["convex_relative_gap"][()].max()
    line = f"8 images, convex programs within {largest:.1e} ("
    assert result.relative_gap is None
    assert result_line(outcomes).startswith(line)
    assert outcomes[-1].numbers.largest_gap is None


def test_further_datasets_are_carried(fit, dictionary, images):
    subjects = np.full(8, -7.0)
    result, _ = fit(dictionary, images.with_extras({"subject": subjects}))
    assert_array_equal(result.column("subject"), subjects)


def test_what_landmarks_came_with_is_carried(fit, dictionary, images):
    result, _ = fit(dictionary, images)
    for name in ("true_rotation", "camera_matrix"):
        assert_array_equal(result.column(name), images.column(name))
    assert result.sequences == images.sequences


def test_carried_datasets_are_not_taken_for_those_of_the_fit(fit, dictionary, images):
    mine = {name: np.full(8, -7.0) for name in ("status", "lambda", "outliers")}
    result, _ = fit(dictionary, images.with_extras(mine))
    assert list(result.status) == ["optimal"] * 8
    assert_array_equal(result.column("lambda"), 0.1)
    assert result.outliers is None
    for name in mine:
        assert_array_equal(result.column(f"input_{name}"), -7.0)


def test_a_result_says_its_config_and_inputs(fit, dictionary, images):
    result, _ = fit(dictionary, images)
    config = json.loads(result.attributes["config"])
    inputs = json.loads(result.attributes["inputs"])
    assert config["method"] == "convex"
    assert {Path(name).name for name in inputs} == {"views.h5", "dictionary.h5"}

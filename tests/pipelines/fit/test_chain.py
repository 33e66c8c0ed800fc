"""Every option of the config of `fit` arrives where it counts; none stands for another."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from shapefit.config import FitConfig
from shapefit.convex.admm import solve_admm
from shapefit.convex.newton import solve_newton
from shapefit.convex.problem import Loss
from shapefit.convex.solution import Status
from shapefit.dictionary.model import Dictionary
from shapefit.io import LandmarkSet
from shapefit.lifting.lift import Program, lift
from shapefit.lifting.methods import AlternationOptions, Settings, choose_method
from shapefit.lifting.perspective.refinement import PerspectiveOptions
from shapefit.lifting.temporal import Sequencing
from shapefit.pipelines.fit.chain import (
    choose_newton,
    choose_options,
    choose_program,
    choose_refinement,
    choose_settings,
    choose_solver,
    refine,
)


@pytest.fixture
def config(tmp_path):
    for name in ("views.h5", "dict.h5"):
        (tmp_path / name).touch()
    paths = {"landmarks": "views.h5", "dictionary": "dict.h5", "output": "result.h5"}
    paths = {key: str(tmp_path / name) for key, name in paths.items()}
    return lambda **keys: FitConfig(**paths, threads=3, **keys)


@pytest.fixture
def dictionary(rng):
    atoms = rng.standard_normal((4, 3, 5))
    return Dictionary(atoms, tuple("abcde"), atoms[1], edges=np.array([[0, 1], [3, 4]]))


def test_settings_of_the_methods(config, dictionary):
    alternation = {
        "signed": True, "views": 9, "multi_start": True, "tolerance": 1e-3, "max_rounds": 17
    }  # fmt: skip
    given = config(alternation=alternation, orthogonal=True, method="alternate+")
    found = choose_settings(given, dictionary, choose_newton(given))
    assert found.options == AlternationOptions(**alternation)
    assert found.solve.func is solve_newton
    assert (found.orthogonal, found.threads) == (True, 3)
    assert found.mean_shape is dictionary.mean_shape
    assert found.needs == {}
    pursuing = choose_settings(config(method="pmp"), dictionary, solve_newton)
    assert pursuing.needs["edges"] is dictionary.edges
    assert pursuing.options is None


def test_options_of_the_solvers(config):
    told = {"tolerance": 1e-7, "max_iterations": 23}
    newton = choose_newton(config(solver=told))
    assert (newton.func, newton.keywords) == (solve_newton, told | {"threads": 3})
    told |= {"stop": "change"}
    admm = choose_solver(config(solver=told | {"name": "admm"}))
    assert (admm.func, admm.keywords) == (solve_admm, told)


def test_the_program(config):
    given = config(**{"lambda": "auto", "noise": 2.5, "loss": "sparse-error", "beta": 0.7})
    assert choose_program(given) == Program(None, Loss.SPARSE_ERROR, beta=0.7, noise=2.5)
    assert choose_program(config(**{"lambda": 0.4})) == Program(0.4)


def test_options_of_the_perspective_camera(config):
    told = {"ridge": 0.7, "softness": 0.3, "max_rounds": 29}
    camera = {"model": "perspective", "focal": 500.0, **told}
    assert choose_options(config(camera=camera)) == PerspectiveOptions(**told, threads=3)


def test_options_of_the_depths_along_a_sequence(config, dictionary):
    told = {"smoothness": 3.0, "rigidity": 40.0, "tolerance": 0.2, "max_rounds": 31}
    refinement = choose_refinement(config(temporal={"depths": True, **told}), dictionary)
    assert refinement.keywords["settings"] == Sequencing(**told)
    assert refinement.keywords["bones"] is dictionary.edges


def test_an_image_that_failed_gets_no_observed_landmarks(dictionary, rng):
    """Without depths, x and y would be half a shape."""

    def solve(problem):
        solution = solve_newton(problem)
        return replace(solution, status=(Status.NUMERICAL_FAILURE, *solution.status[1:]))

    estimator = choose_method("convex", Settings(solve=solve, mean_shape=dictionary.mean_shape))
    names = dictionary.landmark_names
    images = LandmarkSet(
        landmarks=rng.standard_normal((4, 2, 5)), landmark_names=names, items=tuple("1234"),
        sequences=("walk",) * 4,
    )  # fmt: skip
    lifting = lift(images.landmarks, np.ones((4, 5)), dictionary.atoms, Program(0.1), estimator)
    refined = refine(lifting, images, dictionary.edges, Sequencing())
    assert np.isnan(refined.shapes[0]).all()
    np.testing.assert_allclose(refined.shapes[1:, :2], images.landmarks[1:])

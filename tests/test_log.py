"""What developers hear of a fit, by `logging`, and that nobody else pays for it."""

import logging
import subprocess
import sys

import numpy as np
import pytest

from shapefit import log
from shapefit.convex.problem import build_problem
from shapefit.convex.solver import solve_newton


@pytest.fixture
def problem(rng):
    atoms = rng.normal(size=(6, 3, 12))
    return build_problem(rng.normal(size=(1, 2, 12)), atoms, np.array([0.1]))


def test_the_solver_states_its_iterations_and_its_gap(problem, caplog):
    with caplog.at_level(logging.DEBUG, "shapefit"):
        solution = solve_newton(problem, tolerance=1e-8)
    (message,) = caplog.messages
    assert f"at most {solution.iterations[0]};" in message
    assert f"largest relative gap {solution.relative_gap[0]:.1e}" in message


def test_a_trace_ends_at_the_gap_of_the_solution(problem, caplog):
    with caplog.at_level(log.TRACE, "shapefit"):
        solution = solve_newton(problem, tolerance=1e-8)
    traced = [text for text in caplog.messages if text.startswith("image 0")]
    gaps = [float(text.rpartition(" ")[2]) for text in traced]
    assert len(gaps) == solution.iterations[0]
    assert gaps[-1] == pytest.approx(solution.relative_gap[0], rel=0.06)
    assert gaps[0] > 1e3 * gaps[-1]


def test_the_environment_asks_for_messages_on_standard_error(project, tmp_path):
    run = [sys.executable, "-m", "shapefit", "fit"]
    run += [str(project / "sample_data" / "one_person.csv"), "-o", "out.csv"]
    quiet = subprocess.run(run, cwd=tmp_path, capture_output=True, text=True)
    loud = subprocess.run(
        run,
        cwd=tmp_path,
        capture_output=True,
        text=True,
        env={"SHAPEFIT_LOG": "debug", "PATH": ""},
    )
    assert loud.returncode == quiet.returncode == 0, loud.stderr
    assert "shapefit.fit: camera: " in loud.stderr
    assert "shapefit.convex.solver: 1 images" in loud.stderr
    assert "shapefit." not in quiet.stderr

"""The core: what its door refuses, its stub, and the solver's tests at each instruction
set.
"""

import os
import subprocess
import sys

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from shapefit import core
from shapefit.convex.transforms import Transforms
from tools.generate import stub

N = 3
K = 2


@pytest.fixture
def arguments():
    """Arguments of `synchronise` that fit."""
    M = Transforms.of(np.ones((N, K, 2, 3)))
    return {**M.arrays, "rotation": np.zeros((N, 3, 3)), "threads": 1}


def test_the_stub_is_that_of_the_core(project):
    path = project / "shapefit/core/_core.pyi"
    assert path.read_text(encoding="utf-8") == stub()


MORE_ROWS = np.zeros((N + 1, 3, 3))
WRONG_ARGUMENTS = [
    ("rotation", MORE_ROWS, r"\(n 3 3\) with n = 3, a = 6, not float64 \(4,"),
    ("rotation", np.zeros((N, 3, 4)), "rotation must be"),
    ("rotation", np.zeros((N, 9)), "rotation must be"),
    ("rotation", np.zeros((N, 3, 3), np.float32), "not float32"),
    ("rotation", np.zeros((N, 3, 6))[..., ::2], "C-contiguous"),
    ("rotation", np.broadcast_to(0.0, (N, 3, 3)), "writable"),
    ("rotation", None, "not NoneType"),
    ("threads", "all", "threads must be an integer"),
    ("threads", 1.5, "threads must be an integer"),
    ("further", 1, "7 arguments, 6 are known"),
]
"""An argument of `synchronise`, a value that does not fit, and what the error says."""


@pytest.mark.parametrize(("name", "value", "message"), WRONG_ARGUMENTS)
def test_what_does_not_fit_is_refused(arguments, name, value, message):
    with pytest.raises((TypeError, ValueError), match=message):
        core.synchronise(**arguments | {name: value})
    assert not arguments["rotation"].any()


def test_what_lacks_is_named(arguments):
    del arguments["rotation"]
    with pytest.raises(TypeError, match="synchronise: no rotation"):
        core.synchronise(**arguments)


def test_what_is_only_read_may_be_of_another_layout(arguments):
    core.synchronise(**arguments)
    single_precision = arguments["blocks"].astype(np.float32)
    blocks = np.asfortranarray(single_precision)
    found = np.zeros((N, 3, 3))

    core.synchronise(**arguments | {"blocks": blocks, "rotation": found})

    assert_array_equal(found, arguments["rotation"])


def test_sizes_that_are_named_with_others_hold_too():
    """3p and 1+k: a size is that of the argument which named it first."""
    smooth = {
        "landmarks": np.zeros((4, 6)),
        "weight": np.zeros((4, 6)),
        "log_share": np.zeros((4, 1)),
        "means": np.zeros((4, 1, 10)),
    }
    message = r"means must be .* \(t K 3p\) with t = 4, p = 3, K = 1"
    with pytest.raises(ValueError, match=message):
        core.smooth_sequence(**smooth)


SHOW_LEVEL = "from shapefit import core; print(core.LEVEL)"

QUICK = [
    "tests/convex/test_solver.py",
    "tests/dictionary/test_learning.py",
    "tests/lifting/shared_rotation",
]
"""Certificates, planted problems and many starts, which judge every level alike; `make
test-levels` runs more than these.
"""


def run_at_level(
    level: str, arguments: list[str], **options
) -> subprocess.CompletedProcess[str]:
    """Run Python with the environment that asks for a level."""
    return subprocess.run(
        [sys.executable, "-P", *arguments],
        env={**os.environ, "SHAPEFIT_LEVEL": level},
        capture_output=True,
        text=True,
        **options,
    )


@pytest.mark.parametrize("level", core.LEVELS)
def test_the_environment_forces_a_level(level):
    shown = run_at_level(level, ["-c", SHOW_LEVEL], check=True).stdout
    assert shown.strip() == level


def test_without_a_level_in_the_environment_the_best_is_taken():
    shown = run_at_level("", ["-c", SHOW_LEVEL], check=True).stdout
    assert shown.strip() == core.LEVELS[0]


def test_an_unknown_level_is_an_error_of_the_user(project):
    """A command that lifts ends with exit code 2, and one line."""
    landmarks = "sample_data/one_person.csv"
    dictionary = "sample_data/people_train.h5"
    fit = ["-m", "shapefit", "fit", landmarks, "-d", dictionary, "-o", "-"]

    refused = run_at_level("x86_64_v9", fit, cwd=project)

    levels = ", ".join(core.LEVELS)
    assert refused.returncode == 2
    assert refused.stderr == (
        "Error: SHAPEFIT_LEVEL is x86_64_v9; this build and processor have "
        f"{levels}; set it to one of these, or unset it\n"
    )


OTHER_LEVELS = [level for level in core.LEVELS if level != core.LEVEL]


@pytest.mark.slow
@pytest.mark.parametrize("level", OTHER_LEVELS)
def test_the_solvers_pass_at_every_other_level(level, project):
    run_tests = ["-m", "pytest", "-n", "0", "-q", "-p", "no:cacheprovider", *QUICK]
    done = run_at_level(level, run_tests, cwd=project, timeout=300)
    assert done.returncode == 0, done.stdout

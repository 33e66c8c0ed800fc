"""The instruction set: forced by the environment, and the solver's tests at each one."""

import os
import subprocess
import sys

import pytest

from shapefit import core

SHOW = "from shapefit import core; print(core.LEVEL)"

# Certificates, planted problems and many starts judge every level alike; `make test-levels` runs
# more than these.
QUICK = [
    "tests/convex/test_newton.py",
    "tests/convex/test_planted.py",
    "tests/dictionary/test_coding.py",
    "tests/lifting/test_shared_rotation.py",
]


def at_level(level: str, arguments: list[str], **options) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "SHAPEFIT_LEVEL": level}
    return subprocess.run(
        [sys.executable, *arguments], env=environment, capture_output=True, text=True, **options
    )


@pytest.mark.parametrize("level", ["", *core.LEVELS])
def test_the_environment_forces_a_level(level):
    """Without it the best is taken."""
    assert at_level(level, ["-c", SHOW], check=True).stdout.strip() == (level or core.LEVELS[0])


def test_an_unknown_level_is_an_error_of_the_user(project):
    """A command that lifts ends with exit code 2, and one line."""
    landmarks, dictionary = "sample_data/one_person.csv", "sample_data/people_train.h5"
    fit = ["-m", "shapefit", "fit", landmarks, "-d", dictionary, "-o", "-"]
    refused = at_level("x86_64_v9", fit, cwd=project)
    assert refused.returncode == 2
    assert refused.stderr == (
        "Error: SHAPEFIT_LEVEL is x86_64_v9; this build and processor have "
        f"{', '.join(core.LEVELS)}; set it to one of these, or unset it\n"
    )


@pytest.mark.slow
@pytest.mark.parametrize("level", [level for level in core.LEVELS if level != core.LEVEL])
def test_the_solvers_pass_at_every_other_level(level, project):
    options = ["-n", "0", "-q", "-p", "no:cacheprovider"]
    done = at_level(level, ["-m", "pytest", *options, *QUICK], cwd=project, timeout=300)
    assert done.returncode == 0, done.stdout

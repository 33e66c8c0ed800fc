"""The mathematics of the page runs without a browser."""

import subprocess

from .conftest import require


def test_the_scripts_pass_their_own_tests(project):
    tests = project / "tests/viewer/geometry.test.mjs"
    done = subprocess.run(
        [require("node"), "--test", str(tests)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout

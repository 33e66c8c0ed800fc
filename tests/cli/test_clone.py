"""A clone of the project that stands before the installed package, or in the place of it."""

import subprocess
import sys
from pathlib import Path

UNCOMPILED = """
import sys
sys.meta_path = [finder for finder in sys.meta_path if "Redirecting" not in type(finder).__name__]
sys.path.insert(0, "")
import shapefit
shapefit.fit
"""
"""Python in a clone, into whose environment `pip install .` has put the package."""


def test_sources_that_hide_the_installed_package_say_what_to_do(project: Path):
    done = subprocess.run(
        [sys.executable, "-c", UNCOMPILED], cwd=project, capture_output=True, text=True, check=False
    )
    assert "No module named" not in done.stderr
    assert f"InputError: {project / 'shapefit'}: " in done.stderr
    assert "pip install -e '.[plots]'" in done.stderr
    assert "another folder" in done.stderr

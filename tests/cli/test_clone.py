"""A clone of the project that stands before the installed package, or in the place of it."""

import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest

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


@pytest.mark.skipif(shutil.which("make") is None, reason="needs make")
@pytest.mark.parametrize(
    ("installed", "again"), [("_editable_skbc_shapefit.py", 0), ("shapefit", 1)]
)
def test_make_installs_again_what_pip_has_replaced(project: Path, tmp_path, installed, again):
    for name in ("Makefile", "pyproject.toml", "constraints.txt"):
        shutil.copy(project / name, tmp_path)
    packages = tmp_path / ".venv/lib/python3.12/site-packages"
    packages.mkdir(parents=True)
    (packages / installed).touch()
    for number, stamp in enumerate(("tools", "runs", "ready", "all-ready")):
        path = tmp_path / ".venv" / stamp
        path.touch()
        os.utime(path, times=(time.time() + number + 1,) * 2)
    done = subprocess.run(
        ["make", "-n", "demo"], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    assert done.stdout.count("pip install") == again

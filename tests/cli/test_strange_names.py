"""Names that are not UTF-8."""

import os
import shutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

COMMAND = Path(sys.executable).with_name("shapefit")


@pytest.mark.slow
def test_every_command_works_in_a_folder_that_is_not_utf8(tmp_path, project):
    folder = Path(os.fsdecode(os.fsencode(tmp_path) + b"/caf\xe9"))
    folder.mkdir()
    for name in ("people_test.h5", "people_frames.csv"):
        shutil.copy(project / "sample_data" / name, folder)
    shutil.copy(folder / "people_test.h5", folder / os.fsdecode(b"caf\xe9.h5"))
    commands = (
        ["learn-dict", "people_frames.csv", "-o", "d.h5", "--set", "k=3", "--set", "iterations=1"],
        ["project", os.fsdecode(b"caf\xe9.h5"), "-o", os.fsdecode(b"views\xe9.h5")],
        ["fit", os.fsdecode(b"views\xe9.h5"), "-d", "d.h5", "-o", os.fsdecode(b"r\xe9.h5")],
        ["fit", "views*.h5", "-d", "d.h5", "-o", "r.h5", "--print-config"],
    )
    report = ["eval", os.fsdecode(b"r\xe9.h5"), "--truth", "people_test.h5", "-o", "report"]
    if find_spec("polars") is None:  # which cannot write to such a path
        commands = (*commands, report)
    for command in commands:
        done = subprocess.run([COMMAND, *command], cwd=folder, capture_output=True, check=False)
        assert (done.returncode, b"Error" in done.stderr) == (0, False), done.stderr


def test_a_name_that_the_locale_does_not_have_is_refused(tmp_path, project):
    views = project / "sample_data/one_person.csv"
    locale = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    command = [sys.executable, "-m", "shapefit", "fit", str(views), "-o", "\u00f6.h5", "-q"]
    done = subprocess.run(
        command, cwd=tmp_path, env=os.environ | locale, capture_output=True, text=True, check=False
    )
    assert done.returncode == 2, done.stderr
    assert "is no name of a file in this locale; set LC_ALL=C.UTF-8" in done.stderr
    assert not list(tmp_path.iterdir())

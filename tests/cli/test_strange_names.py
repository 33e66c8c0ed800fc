"""Names that are not UTF-8, or that would speak to the terminal."""

import os
import shutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

from shapefit.errors import path_text, printable
from shapefit.pipelines.outcome import Failure, Outcome

COMMAND = Path(sys.executable).with_name("shapefit")


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("plain text, mañana", "plain text, mañana"),
        ("x\x1b[31mRED\nfit: wrote all", "x\\x1b[31mRED\\nfit: wrote all"),
        ("caf\udce9", "caf\\xe9"),
        ("half \ud800", "half \\ud800"),
        ("right\u202eleft", "right\\u202eleft"),
    ],
)
def test_what_a_terminal_would_obey_is_shown_as_an_escape(text, shown):
    assert printable(text) == shown


def test_a_path_that_is_not_utf8_is_text_with_escapes():
    assert path_text(os.fsdecode(b"a/caf\xe9")) == "a/caf\\xe9"
    assert path_text("a/café") == "a/café"


def test_an_item_cannot_forge_a_line_of_the_report(shapefit, fake_pipeline):
    forged = "x\x1b[31mRED\nfit: 8 images in 0.0 s; wrote all"
    failure = Failure(forged, "bad")
    fake_pipeline("fit.run", [Outcome(done=1, failures=(failure,), warnings=(forged,))])
    lines = shapefit("fit", "-c", "fit.yaml").err.splitlines()
    assert len(lines) == 3
    assert not any("\x1b" in line for line in lines)


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

"""Pipes where a file must be, a million strange names, no memory, and heads of large files."""

import os
import subprocess
import sys
import time

import numpy as np
import pytest
from shapefit.cli.main import run

from shapefit.dictionary.model import Dictionary
from shapefit.io import LandmarkSet, landmark_writer, write_dictionary

NAMES = ("a", "b", "c", "d")


@pytest.fixture
def folder(tmp_path, rng, monkeypatch):
    """A working folder with a dictionary and landmarks."""
    atoms = rng.normal(size=(3, 3, 4))
    model = Dictionary(atoms=atoms, landmark_names=NAMES, mean_shape=atoms[0])
    write_dictionary(tmp_path / "dict.h5", model)
    views = LandmarkSet(
        landmarks=rng.normal(size=(3, 2, 4)), landmark_names=NAMES, items=("x", "y", "z")
    )
    with landmark_writer(tmp_path / "views.h5") as writer:
        writer.append(views)
    os.mkfifo(tmp_path / "pipe")
    os.mkfifo(tmp_path / "pipe.h5")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def shapefit(*arguments: str, seconds: float = 20) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "shapefit", *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=seconds, check=False)


@pytest.mark.parametrize(
    "command",
    [
        "fit -c pipe views.h5 -d dict.h5 -o out.h5",
        "fit views.h5 -d pipe -o out.h5",
        "fit views.h5 -d pipe.h5 -o out.h5",
        "eval -c pipe views.h5 --truth views.h5 -o out",
        "verify views.h5 -d pipe.h5",
    ],
)
def test_a_pipe_as_config_or_dictionary_is_refused_at_once(folder, command):
    done = shapefit(*command.split())
    assert done.returncode == 2
    assert "pipe" in done.stderr
    assert not (folder / "out.h5").exists()


def test_a_config_may_come_from_a_pipe_of_the_shell(folder, capsys):
    read, write = os.pipe()
    os.write(write, b"{}\n")
    os.close(write)
    assert run(["info", "-c", f"/dev/fd/{read}", "views.h5"]) == 0


def test_a_message_about_very_many_names_is_short_and_quick(folder, capsys):
    p = 100_000
    names = tuple(f"point {i}" for i in range(p))
    with landmark_writer(folder / "wide.h5") as writer:
        writer.append(
            LandmarkSet(
                landmarks=np.zeros((1, 2, p)) + np.arange(p), landmark_names=names, items=("x",)
            )
        )
    before = time.process_time()
    assert run(["fit", "wide.h5", "-d", "dict.h5", "-o", "out.h5"]) == 2
    told = capsys.readouterr().err
    assert len(told) < 4000
    assert "none of the 100000 landmarks" in told
    assert time.process_time() - before < 10

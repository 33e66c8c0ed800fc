"""Files on which libhdf5 hangs, crashes or fills the memory are named, and nothing else happens."""

import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import h5py
import numpy as np
import pytest

from shapefit.errors import InputError
from shapefit.io import read_shapes, write_shapes
from shapefit.io.hdf5 import trial
from shapefit.io.hdf5.trial import INSTALLED, try_opening
from shapefit.io.records import ShapeSet


@pytest.fixture
def file(tmp_path, rng) -> Path:
    """A sound file of many datasets."""
    path = tmp_path / "sound.h5"
    with h5py.File(path, "w") as file:
        for key in ("format", "unit", "y_axis", "config", "inputs"):
            file.attrs[key] = "text of " + key * 5
        for number in range(12):
            data = rng.normal(size=(64, 3))
            file.create_dataset(f"numbers_{number}", data=data, chunks=(16, 3), compression=1)
        file["item"] = np.array([f"i{number}" for number in range(64)], dtype=object)
    return path


def spoil(path: Path, first: int, last: int, byte: int = 0) -> Path:
    """Write one byte over a range of a file."""
    data = bytearray(path.read_bytes())
    data[first:last] = bytes([byte]) * len(data[first:last])
    path.write_bytes(data)
    return path


def walked(code: str, monkeypatch) -> None:
    """Let the child do something else than walk."""
    monkeypatch.setattr(trial, "_walk", lambda _path: eval(code))


def test_a_file_that_hangs_libhdf5_is_named(file, monkeypatch):
    monkeypatch.setattr(trial, "SECONDS", 1)
    spoil(file, 2400, 12400)
    with pytest.raises(InputError, match=r"sound\.h5: cannot be read \(libhdf5 does not come to"):
        read_shapes([file])


def test_a_file_that_fills_the_memory_is_named(file):
    spoil(file, file.stat().st_size - 2000, file.stat().st_size, 255)
    with pytest.raises(InputError, match="libhdf5 asks for more than 1"):
        try_opening(file)


@pytest.mark.parametrize(
    ("code", "said"),
    [
        ("os.kill(os.getpid(), signal.SIGSEGV)", "libhdf5 crashes: SIGSEGV"),
        ("os._exit(trial.NOT_LISTED)", "what it holds cannot be listed"),
        ("[0 for _ in iter(int, 1)]", "does not come to an end within 1 s"),
    ],
)
def test_what_becomes_of_the_child_is_said(file, monkeypatch, code, said):
    monkeypatch.setattr(trial, "SECONDS", 1)
    walked(code, monkeypatch)
    with pytest.raises(InputError, match=said):
        try_opening(file)


def test_sound_files_and_those_of_the_package_are_left_alone(file, monkeypatch):
    try_opening(file)
    walked("os.abort()", monkeypatch)
    try_opening(file)
    try_opening(INSTALLED / "dictionaries" / "people.h5")
    os.utime(file)
    with pytest.raises(InputError, match="SIGABRT"):
        try_opening(file)


@pytest.mark.parametrize("damaged", [False, True])
def test_files_that_are_tried_together_are_tried_once(file, tmp_path, monkeypatch, damaged):
    """Where the child does not come to its end, each is tried when it is opened."""
    paths = [Path(shutil.copy(file, tmp_path / f"{number}.h5")) for number in range(3)]
    if damaged:
        spoil(paths[1], file.stat().st_size - 2000, file.stat().st_size, 255)
    trial.try_together(paths)
    tried = []
    monkeypatch.setattr(trial, "_tried", lambda path, *_: tried.append(path))
    for path in paths:
        try_opening(path)
    assert tried == (paths if damaged else [])


def test_a_file_of_this_program_is_trusted_until_it_is_touched(tmp_path, monkeypatch):
    path = tmp_path / "shapes.h5"
    write_shapes(path, ShapeSet(np.zeros((1, 3, 4)), tuple("abcd"), ("one",)))
    if "user.shapefit.written" not in os.listxattr(path):
        pytest.skip("this file system has no extended attributes")
    walked("os.abort()", monkeypatch)
    try_opening(path)
    os.utime(path)
    with pytest.raises(InputError, match="SIGABRT"):
        try_opening(path)


def test_what_libhdf5_reports_is_left_to_the_reader(file):
    try_opening(spoil(file, 0, 8))
    with pytest.raises(InputError, match=r"sound\.h5: is not an HDF5 file"):
        read_shapes([file])


def test_a_command_ends_when_it_is_told_to(file):
    spoil(file, 2400, 12400)
    command = [sys.executable, "-m", "shapefit", "info", str(file)]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        child = _first_child(process.pid)
        process.terminate()
        _, said = process.communicate(timeout=4)
    assert process.returncode == 128 + signal.SIGTERM
    assert "Ended by SIGTERM" in said
    assert _has_ended(child)


def _has_ended(pid: int) -> bool:
    """Whether a process is gone within two seconds, or waits for its parent to take note."""
    stat = Path(f"/proc/{pid}/stat")
    for _ in range(20):
        if not stat.exists() or stat.read_text().rpartition(")")[2].split()[0] == "Z":
            return True
        time.sleep(0.1)
    return False


def _first_child(pid: int) -> int:
    children = Path(f"/proc/{pid}/task/{pid}/children")
    while not (found := children.read_text().split()):
        time.sleep(0.01)
    return int(found[0])

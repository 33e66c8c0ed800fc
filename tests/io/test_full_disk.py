"""A disk that fills while files are written, and memory that stays flat."""

import errno
import os
from unittest.mock import Mock

import pytest

from shapefit.errors import InputError
from shapefit.io import (
    write_shapes,
)

MAKE = """
import os, resource, signal, sys
from pathlib import Path
import numpy as np
from shapefit.errors import InputError
from shapefit.io import *
from shapefit.records import Fit, Landmarks

def views(start, size):
    return Landmarks(
        landmarks=np.random.default_rng(start).normal(size=(size, 15, 2)),
        landmark_names=[f"landmark {i}" for i in range(15)],
        items=[f"sequence/{i:09}" for i in range(start, start + size)],
        extras={"true_rotation": np.zeros((size, 3, 3))},
    )

def results(chunk):
    n = len(chunk)
    return Fit(
        np.ones((n, 15, 3)),
        landmarks_fitted=chunk.landmarks,
        coefficients=np.ones((n, 64)),
        status=np.full(n, "solved"),
        landmark_names=chunk.landmark_names,
        items=chunk.items,
        extras=chunk.extras,
    )
"""

FULL = """
sys.dont_write_bytecode = True  # or modules that are cut off stay on the disk
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[2]), int(sys.argv[2])))
try:
    with result_writer(Path(sys.argv[1])) as writer:
        for start in range(0, 8000, 1000):
            writer.append(results(views(start, 1000)))
    print("written")
except InputError as error:
    print(error)
"""


def test_a_full_disk_is_told(shapes, tmp_path, monkeypatch):
    target = tmp_path / "shapes.h5"
    full = OSError(errno.ENOSPC, "refused")
    monkeypatch.setattr(os, "posix_fallocate", Mock(side_effect=full))
    with pytest.raises(InputError, match="No space"):
        write_shapes(target, shapes)
    assert not target.exists()


@pytest.mark.parametrize("number", [errno.EINVAL, errno.EOPNOTSUPP])
def test_a_disk_that_cannot_reserve_space_is_written_to(
    shapes, tmp_path, monkeypatch, number
):
    target = tmp_path / "shapes.h5"
    unsupported = OSError(number, "refused")
    monkeypatch.setattr(os, "posix_fallocate", Mock(side_effect=unsupported))
    write_shapes(target, shapes)
    assert target.exists()


@pytest.mark.parametrize("limit", [0, 1_000, 300_000, 2_500_000])
@pytest.mark.parametrize("name", ["result.h5", "result.csv"])
def test_a_disk_that_fills_while_writing(tmp_path, run_python, name, limit):
    target = tmp_path / name
    target.write_text("old")
    done = run_python(MAKE + FULL, target, str(limit))
    fault = "cannot be written: File too large; free some space"
    assert done.stdout.startswith(f"{target}: {fault}")
    assert done.returncode == 0
    assert done.stderr == ""
    assert target.read_text() == "old"
    assert os.listdir(tmp_path) == [name]


MEMORY = """
def peak():
    # That of getrusage begins with the peak of the process that started this one.
    (line,) = [line for line in open("/proc/self/status") if line.startswith("VmHWM")]
    return int(line.split()[1]) * 1024

def run(count):
    with landmark_writer(Path(sys.argv[1]) / "views.h5") as writer:
        for start in range(0, count, 2000):
            writer.append(views(start, 2000))
    with open_landmarks([Path(sys.argv[1]) / "views.h5"]) as source:
        with result_writer(Path(sys.argv[1]) / "result.h5") as writer:
            for chunk in source.batches(2000):
                writer.append(results(chunk))

run(20_000)
before = peak()
run(90_000)
print(peak() - before)
"""


def test_memory_is_flat_in_the_number_of_images(tmp_path, run_python):
    # 70,000 images more hold 22 MB of landmarks and rotations, and 91 MB of results.
    done = run_python(MAKE + MEMORY, tmp_path)
    assert done.stderr == ""
    assert int(done.stdout) < 12e6

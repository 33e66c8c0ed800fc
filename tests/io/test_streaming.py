"""Long streams: flat memory, full disks, killed writers, and quick starts."""

import os

import pytest

from shapefit.io import landmark_writer

MAKE = """
import os, resource, signal, sys
from pathlib import Path
import numpy as np
from shapefit.errors import InputError
from shapefit.io import *

def views(start, size):
    return LandmarkSet(
        landmarks=np.random.default_rng(start).normal(size=(size, 2, 15)),
        landmark_names=[f"landmark {i}" for i in range(15)],
        items=[f"sequence/{i:09}" for i in range(start, start + size)],
        columns={"true_rotation": np.zeros((size, 3, 3))},
    )

def results(chunk):
    n = len(chunk)
    return ResultSet(
        shapes=np.ones((n, 3, 15)),
        landmarks_fitted=chunk.landmarks,
        coefficients=np.ones((n, 64)),
        status=np.full(n, "solved"),
        landmark_names=chunk.landmark_names,
        items=chunk.items,
        columns=chunk.further,
    )
"""

FULL = """
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[2]), int(sys.argv[2])))
try:
    with result_writer(Path(sys.argv[1])) as writer:
        for start in range(0, 8000, 1000):
            writer.append(results(views(start, 1000)))
    print("written")
except InputError as error:
    print(error)
"""


@pytest.mark.parametrize("limit", [0, 1_000, 300_000, 2_500_000])
@pytest.mark.parametrize("name", ["result.h5", "result.csv"])
def test_a_disk_that_fills_while_writing(tmp_path, run_python, name, limit):
    target = tmp_path / name
    target.write_text("old")
    done = run_python(MAKE + FULL, target, str(limit))
    assert done.stdout.startswith(f"{target}: cannot be written: File too large; free some space")
    assert (done.returncode, done.stderr) == (0, "")
    assert target.read_text() == "old"
    assert os.listdir(tmp_path) == [name]


MEMORY = """
def peak():  # that of getrusage begins with the peak of the process that started this one
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

run(60_000)
before = peak()
run(160_000)
print(peak() - before)
"""


def test_memory_is_flat_in_the_number_of_images(tmp_path, run_python):
    # 100,000 images more hold 31 MB of landmarks and rotations, and 130 MB of results.
    done = run_python(MAKE + MEMORY, tmp_path)
    assert done.stderr == ""
    assert int(done.stdout) < 12e6


@pytest.mark.parametrize(("name", "library"), [("views.h5", "h5py"), ("views.csv", "orjson")])
def test_only_the_library_of_the_file_is_imported(tmp_path, run_python, landmarks, name, library):
    with landmark_writer(tmp_path / name) as writer:
        writer.append(landmarks)
    script = """
import sys
from pathlib import Path
from shapefit.io import *
heavy = {"h5py", "orjson", "scipy", "numba", "trimesh", "matplotlib"}
assert not heavy & set(sys.modules)
path = Path(sys.argv[1])
with open_landmarks([path]) as source, landmark_writer(path.with_stem("again")) as writer:
    for chunk in source.batches(10):
        writer.append(chunk)
print(*heavy & set(sys.modules))
"""
    done = run_python(script, tmp_path / name)
    assert done.stderr == ""
    assert done.stdout.split() == [library]

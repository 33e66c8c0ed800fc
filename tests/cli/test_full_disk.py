"""Every size at which a disk can be full."""

import subprocess
import sys

import pytest

EACH_SIZE = """
import os, resource, sys
from pathlib import Path
import numpy as np
from shapefit.cli.main import run

target, sizes = Path(sys.argv[1]), int(sys.argv[2])

def write():
    return run([*sys.argv[3:], "-o", str(target)])

def code(limit):
    if os.fork() == 0:
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
        sys.exit(write())
    return os.waitstatus_to_exitcode(os.wait()[1])

assert write() == 0  # and what the children need is imported
whole = target.stat().st_size
for limit in np.linspace(0, whole - 1, sizes).astype(int).tolist():
    target.write_text("old")
    kept = lambda: target.read_text() == "old" and os.listdir(target.parent) == [target.name]
    print(code(limit), kept())
"""


CASES = {
    "a dictionary with meshes": ("dict.h5", 30, ["learn-dict", "--set", "method=exemplars"]),
}


@pytest.mark.parametrize("case", CASES)
def test_many_sizes_of_the_disk(tmp_path, project, case):
    name, sizes, arguments = CASES[case]
    cars = project / "sample_data" / "cars.h5"
    command = [sys.executable, "-c", EACH_SIZE, tmp_path / name, str(sizes), *arguments, cars]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert done.stdout.splitlines() == sizes * ["2 True"], done.stderr
    assert done.stderr.count("free some space") == sizes

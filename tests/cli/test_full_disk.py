"""Every size at which a disk can be full."""

from __future__ import annotations

import subprocess
import sys

EACH_SIZE = """
import os, resource, sys
from pathlib import Path
import numpy as np
from shapefit_cli.main import run

shapes, target = sys.argv[1], Path(sys.argv[2])

def learn():
    return run(["learn-dict", shapes, "-o", str(target), "--set", "method=exemplars"])

def code(limit):
    if os.fork() == 0:
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
        sys.exit(learn())
    return os.waitstatus_to_exitcode(os.wait()[1])

assert learn() == 0  # and what the children need is imported
whole = target.stat().st_size
for limit in np.linspace(0, whole - 1, 30).astype(int).tolist():
    target.write_text("old")
    kept = lambda: target.read_text() == "old" and os.listdir(target.parent) == [target.name]
    print(code(limit), kept())
"""


def test_a_dictionary_with_meshes_at_thirty_sizes_of_the_disk(tmp_path, project):
    cars = project / "sample_data" / "cars.h5"
    command = [sys.executable, "-c", EACH_SIZE, cars, tmp_path / "dictionary.h5"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert done.stdout.splitlines() == 30 * ["2 True"], done.stderr
    assert done.stderr.count("free some space") == 30

"""4,000 spoiled inputs, and every call that writes failing once; `make fuzz` runs many more."""

from __future__ import annotations

import subprocess
import sys

import pytest

KINDS = ("csv", "detectors", "hdf5", "motion", "parquet", "trackers", "yaml", "set")


@pytest.mark.parametrize("kind", KINDS)
def test_five_hundred_spoiled_inputs(project, kind):
    done = python(project, "fuzz", "--jobs", "2", "--kinds", kind, "--cases", "500")
    assert done.returncode == 0, done.stdout[-4000:] + done.stderr[-2000:]


def test_what_once_failed_stays_mended(project):
    done = python(project, "fuzz", "--past")
    assert done.returncode == 0, done.stdout[-4000:] + done.stderr[-2000:]
    assert int(done.stdout.split()[0]) > 25


def test_every_kind_is_run(project):
    table = (project / "fuzz" / "kinds.py").read_text()
    assert all(f'"{kind}"' in table for kind in KINDS)
    assert table.count(".make") == len(KINDS)


def test_outputs_are_old_or_new_whichever_call_fails(project):
    done = python(project, "fuzz.faults", "--quick")
    assert done.returncode == 0, done.stdout[-4000:] + done.stderr[-2000:]


def python(project, module, *arguments):
    command = [sys.executable, "-m", module, *arguments]
    return subprocess.run(
        command, cwd=project, capture_output=True, text=True, timeout=600, check=False
    )

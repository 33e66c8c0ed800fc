"""Spoiled inputs, and calls that write and fail; `make fuzz` and `make faults` run many more."""

import subprocess
import sys

import pytest

from tests.fuzz.kinds import FINDINGS, KINDS

QUICK_CASES = 15
"""Cases of each kind in `make test`; `make test-all` has thirty times as many, after these."""


def test_spoiled_inputs(project):
    python(project, "tests.fuzz", "--jobs", "1", "--cases", str(QUICK_CASES * len(KINDS)))


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_many_spoiled_inputs(project, kind):
    cases, first = str(30 * QUICK_CASES), str(QUICK_CASES)
    python(
        project, "tests.fuzz", "--jobs", "1", "--kinds", kind, "--cases", cases, "--first", first
    )


def test_what_once_failed_stays_mended(project):
    assert int(python(project, "tests.fuzz", "--past").split()[0]) == len(FINDINGS)


def test_outputs_are_old_or_new_whichever_call_fails(project):
    python(project, "tests.fuzz.faults", "--quick", "--commands", "fit to CSV")


@pytest.mark.slow
def test_outputs_of_all_commands_are_old_or_new_whichever_call_fails(project):
    python(project, "tests.fuzz.faults", "--quick")


def python(project, module, *arguments):
    """Run a module, which must succeed, and return what it prints."""
    command = [sys.executable, "-m", module, *arguments]
    done = subprocess.run(
        command, cwd=project, capture_output=True, text=True, timeout=600, check=False
    )
    assert done.returncode == 0, done.stdout[-4000:] + done.stderr[-2000:]
    return done.stdout

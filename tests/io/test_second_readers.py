"""What our readers find in files of other tools, independent readers find, too."""

import subprocess
import sys

import pytest

pytestmark = [
    pytest.mark.slow,
    pytest.mark.real_data,
    pytest.mark.filterwarnings("ignore"),
]

CASES = 400
"""Spoiled files; `python -m fuzz.second_readers` reads 20,000."""


def test_good_files_hold_the_same_numbers(real_data, tmp_path):
    from fuzz.second_readers import cases

    cases.write_made(tmp_path)
    found = {
        path.name: cases.compare(known, path)
        for known in cases.FORMATS.values()
        for path in cases.good_files(known, real_data / "formats", tmp_path)
    }
    assert len(found) > 40
    assert {name: what for name, what in found.items() if what != "equal"} == {}


def test_spoiled_files_hold_the_same_numbers_or_are_refused(project, real_data):
    command = [
        "-m",
        "fuzz.second_readers",
        "--cases",
        str(CASES),
        "--first",
        "1000",
        "--data",
        str(real_data),
    ]
    done = subprocess.run(
        [sys.executable, *command],
        cwd=project,
        capture_output=True,
        text=True,
        timeout=900,
        check=False,
    )
    assert done.returncode == 0, done.stdout[-4000:] + done.stderr[-2000:]

"""Standard streams that the shell closed, or sent to a full disk, of the installed command."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

SHAPEFIT = Path(sys.executable).with_name("shapefit")
SAMPLES = Path(__file__).resolve().parents[2] / "sample_data"
FULL = pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full here")

FIT = "fit one_person.csv -d dictionary.h5 -o"
EVAL = "eval result.h5 --truth people_test.h5 -o report --set plots=false"


@pytest.fixture(scope="module")
def fitted(world, tmp_path_factory):
    """A folder with landmarks, a dictionary, a result and its truth."""
    folder = tmp_path_factory.mktemp("streams")
    for name in ("people_test.h5", "one_person.csv"):
        shutil.copy(SAMPLES / name, folder)
    shutil.copy(world.dictionary("people"), folder / "dictionary.h5")
    shutil.copy(world.fit("people", images=world.views("people")), folder / "result.h5")
    return folder


def shell(command: str, folder: Path, unbuffered: str = "") -> tuple[int, str, str]:
    """Return the exit code of a command of shapefit, its output, and what it told."""
    line = f"'{SHAPEFIT}' {command}"
    done = subprocess.run(
        ["sh", "-c", line],
        cwd=folder,
        env={**os.environ, "PYTHONUNBUFFERED": unbuffered},
        capture_output=True,
        text=True,
        check=False,
    )
    return done.returncode, done.stdout, done.stderr


@FULL
@pytest.mark.parametrize("unbuffered", ["", "1"])
@pytest.mark.parametrize("command", ["fit --help", f"{FIT} r.csv --print-config", EVAL, f"{FIT} -"])
def test_a_full_disk_behind_standard_output_is_no_internal_error(fitted, command, unbuffered):
    code, out, told = shell(f"{command} >/dev/full", fitted, unbuffered)
    assert (code, out) == (2, "")
    assert told.startswith("Error: standard output: cannot be written: No space left on device; ")
    assert told.count("\n") == 1


def test_what_has_nothing_to_print_needs_no_standard_output(fitted):
    code, _, told = shell(f"{FIT} closed.csv >&-", fitted)
    assert (code, told.count("Wrote   closed.csv")) == (0, 1)
    assert (fitted / "closed.csv").read_text("utf-8").startswith("item,landmark,x,y,z\n")


def test_a_table_that_nobody_wants_is_not_printed(fitted):
    code, _, told = shell(f"{EVAL} >&-", fitted)
    assert (code, told.count("Wrote   ")) == (0, 1)


def test_data_cannot_go_to_a_closed_standard_output(fitted):
    code, _, told = shell(f"{FIT} - >&-", fitted)
    assert code == 2
    assert told == "Error: standard output: is closed; name a file to write instead\n"


def test_data_cannot_come_from_a_closed_standard_input(fitted):
    code, _, told = shell("fit - -d dictionary.h5 -o r.csv <&-", fitted)
    assert code == 2
    assert told == "Error: standard input: is closed; send data there, or name a file\n"
    assert not (fitted / "r.csv").exists()


@pytest.mark.parametrize(
    "where", ["2>&-", ">&- 2>&-", "<&- >&- 2>&-", pytest.param("2>/dev/full", marks=FULL)]
)
@pytest.mark.parametrize(("landmarks", "expected"), [("one_person.csv", 0), ("none.csv", 2)])
def test_nobody_need_read_what_is_told(fitted, where, landmarks, expected):
    output = fitted / "unread.csv"
    output.unlink(missing_ok=True)
    code, _, told = shell(f"fit {landmarks} -d dictionary.h5 -o unread.csv {where}", fitted)
    assert (code, told) == (expected, "")
    assert output.exists() == (expected == 0)


def test_wrong_usage_needs_no_reader_either(fitted):
    assert shell("fit --nonsense 2>&-", fitted)[0] == 2

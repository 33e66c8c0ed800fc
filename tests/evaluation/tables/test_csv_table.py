"""Tables of an evaluation as CSV."""

import csv
import errno
from pathlib import Path

import pytest

from shapefit.evaluation.tables.csv_table import write_table


def test_every_cell_comes_back(tmp_path):
    cells = ["a,b", 'c"d', "e\nf", "g\rh", " i ", ""]
    write_table(tmp_path / "table.csv", ["x", *"yzuvw"], [cells])
    with (tmp_path / "table.csv").open(newline="") as file:
        assert list(csv.reader(file)) == [["x", *"yzuvw"], cells]


def test_numbers_have_all_their_digits_and_nan_is_empty(tmp_path):
    write_table(tmp_path / "table.csv", "abcd", [(0.1 + 0.2, float("nan"), None, 7)])
    assert (tmp_path / "table.csv").read_bytes() == b"a,b,c,d\n0.30000000000000004,,,7\n"


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="this system has no /dev/full")
def test_a_full_disk_is_named_by_its_number():
    with pytest.raises(OSError, match="No space left") as caught:
        write_table(Path("/dev/full"), "a", [("cell",)])
    assert caught.value.errno == errno.ENOSPC

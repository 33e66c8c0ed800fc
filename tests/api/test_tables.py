"""Tables of pandas are CSV that every command reads."""

import csv

import numpy as np
import pytest
from numpy.testing import assert_array_equal

import shapefit
from tests.cli.conftest import run_in

COMMANDS = (
    ("info", "fit.csv"),
    ("convert", "fit.csv", "-o", "again.h5"),
    ("view", "fit.csv", "-o", "fit.html"),
    ("eval", "fit.csv", "--truth", "truth.h5", "-o", "report"),
    ("eval", "fit.h5", "--truth", "fit.csv", "-o", "other"),
)


def check_commands(folder, shapes, items):
    """Fail unless the commands read fit.csv, and find these shapes (n, p, 3) in it."""
    for command in COMMANDS:
        done = run_in(folder, *command)
        assert done.returncode == 0, done.stderr
    read = shapefit.read_shapes(folder / "again.h5")
    report = (folder / "report/report.csv").read_text(encoding="utf-8")
    first, *_ = csv.DictReader(report.splitlines())
    assert_array_equal(read.shapes, shapes)
    assert read.items == items
    assert first["images"] == str(len(items))


def write_truth(folder, fit):
    """Write the fit, and its shapes as the truth."""
    names = {"landmark_names": fit.landmark_names, "items": fit.items}
    truth = shapefit.Shapes(fit.shapes, **names)
    shapefit.write_results(folder / "fit.h5", fit)
    shapefit.write_shapes(folder / "truth.h5", truth)


@pytest.fixture
def fit(rng):
    n, p = 4, 6
    reasons = np.array(["", "", 'far, and "alone"', ""], object)
    return shapefit.Fit(
        rng.normal(size=(n, p, 3)),
        landmark_names=tuple("abcdef"),
        items=tuple(f"walk/{i}" for i in range(n)),
        sequences=("walk",) * n,
        frames=np.arange(n),
        frame_rate=50.0,
        shape_sd=np.ones((n, p, 3)),
        trusted=reasons == "",
        reasons=reasons,
    )


HEADER = ["", "item", "landmark", "x", "y", "z", "frame", "time", "sequence"]


def write_as_pandas(path, fit):
    """Write a fit as `to_csv` does, where pandas is not installed."""
    with path.open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        table.writerow([*HEADER, "trusted", "reasons"])
        for number, (row, column) in enumerate(np.ndindex(fit.shapes.shape[:2])):
            names = [number, fit.items[row], fit.landmark_names[column]]
            point = fit.shapes[row, column].tolist()
            of_item = [row, row / 50, "walk", fit.trusted[row], fit.reasons[row]]
            table.writerow([*names, *point, *of_item])


def test_row_numbers_and_reasons_are_passed_over(tmp_path, fit):
    write_as_pandas(tmp_path / "fit.csv", fit)
    write_truth(tmp_path, fit)
    check_commands(tmp_path, fit.shapes, fit.items)


@pytest.mark.slow
@pytest.mark.parametrize("index", [True, False])
def test_what_to_csv_writes_every_command_reads(tmp_path, fit, index):
    pytest.importorskip("pandas")
    path = tmp_path / "fit.csv"
    table = fit.to_pandas()
    table.to_csv(path, index=index)
    write_truth(tmp_path, fit)
    check_commands(tmp_path, fit.shapes, fit.items)
    read = shapefit.read_results(path)
    assert table.attrs == {"unit": "unknown", "y_axis": "down", "frame_rate": 50.0}
    assert read.frame_rate == 50.0
    assert read.frames.tolist() == [0, 1, 2, 3]


@pytest.mark.parametrize("height", [178, -1.78, 0, float("nan"), "1.78"])
def test_a_height_that_no_body_has_is_refused(fit, height):
    with pytest.raises(shapefit.InputError, match=r"to_metres\.height: .* up to 3"):
        fit.to_metres(height=height)

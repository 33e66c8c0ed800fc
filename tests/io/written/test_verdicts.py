"""Beside a file of motion: which of its frames are to be trusted."""

import csv

import numpy as np
import pytest

from shapefit.io.layout import METRES_PER_UNIT
from shapefit.io.records import ResultSet
from tests.io.files import save

DOUBTS = np.array(["", "implausible landmarks", "", ""], dtype=object)


@pytest.fixture
def record(rng):
    """Two frames of each of two people, 100 px in a metre."""
    extras = {
        METRES_PER_UNIT: np.full(4, 0.01),
        "frame": np.array([3, 4, 3, 4]),
        "reasons": DOUBTS,
        "trusted": DOUBTS == "",
        "p_value": np.array([0.5, 0.01, 0.25, np.nan]),
    }
    return ResultSet(
        shapes=rng.normal(size=(4, 3, 5)),
        shape_sd=np.full((4, 3, 5), 2.0),
        landmark_names=tuple("abcde"),
        items=("a/3", "a/4", "b/3", "b/4"),
        sequences=("a", "a", "b", "b"),
        frame_rate=50.0,
        unit="px",
        attributes={"metres_from": "edges"},
        columns=extras,
    )


@pytest.fixture
def written(tmp_path):
    def write(record, name):
        return [path.name for path in save(tmp_path / name, record).written]

    return write


@pytest.mark.parametrize("ending", ["trc", "c3d"])
def test_each_motion_has_its_table(record, written, tmp_path, ending):
    if ending == "c3d":
        pytest.importorskip("ezc3d")
    names = written(record, f"walk.{ending}")
    assert names == [
        f"walk_a.{ending}",
        "walk_a_frames.csv",
        f"walk_b.{ending}",
        "walk_b_frames.csv",
    ]
    with (tmp_path / "walk_a_frames.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["item"] for row in rows] == ["a/3", "a/4"]
    assert [float(row["time"]) for row in rows] == [0.06, 0.08]
    assert [row["trusted"] for row in rows] == ["true", "false"]
    assert rows[1]["reason"] == "implausible landmarks"
    assert float(rows[0]["mean_error_bar_m"]) == pytest.approx(0.02 * np.sqrt(3), rel=1e-3)
    with (tmp_path / "walk_b_frames.csv").open() as file:
        assert [row["p_value"] for row in csv.DictReader(file)] == ["0.25", ""]


def test_csv_has_a_column(record, written, tmp_path):
    written(record, "walk.csv")
    lines = (tmp_path / "walk.csv").read_text().splitlines()
    assert lines[0].endswith(",sequence,trusted")
    assert [line.split(",")[-1] for line in lines[1::5]] == ["true", "false", "true", "true"]

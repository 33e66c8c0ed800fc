"""Motion as tables: joints in metres and joint angles, with their deviations."""

import csv

import numpy as np
import pytest

from shapefit.errors import InputError
from shapefit.io.layout import METRES_PER_UNIT
from shapefit.io.records import ResultSet
from tests.io.files import save

JOINTS = ("rhip", "rknee", "rankle")
BENT = np.array([[0.0, 0.0, 0.3], [0.0, 4.0, 8.0], [0.0, 0.0, 0.0]])
"""A leg that hangs down in an image, almost straight."""


@pytest.fixture
def record():
    """Three items in frames 3, 4 and 6 of 50 a second, 100 px in a metre."""
    extras = {
        METRES_PER_UNIT: np.full(3, 0.01),
        "frame": np.array([3, 4, 6]),
        "reasons": np.array(["", "wide error bars", ""], dtype=object),
        "trusted": np.array([True, False, True]),
    }
    return ResultSet(
        shapes=np.stack([BENT, BENT, np.full((3, 3), np.nan)]),
        shape_sd=np.full((3, 3, 3), 0.1),
        landmark_names=JOINTS,
        items=("3", "4", "6"),
        sequences=("a", "a", "a"),
        frame_rate=50.0,
        unit="px",
        attributes={"metres_from": "edges"},
        columns=extras,
    )


def rows_of(path):
    with path.open() as file:
        return list(csv.DictReader(file))


def test_joints_in_metres(record, tmp_path):
    save(tmp_path / "leg.metres.csv", record)
    rows = rows_of(tmp_path / "leg.metres.csv")
    assert [row["frame"] for row in rows] == [str(f) for f in (3, 4, 5, 6) for _ in JOINTS]
    assert [row["landmark"] for row in rows] == list(JOINTS) * 4
    assert [float(row["time"]) for row in rows[::3]] == pytest.approx([0.06, 0.08, 0.1, 0.12])
    assert [row["trusted"] for row in rows[::3]] == ["true", "false", "", "true"]
    leg = np.array([[float(row[axis]) for axis in "xyz"] for row in rows[:3]])
    np.testing.assert_allclose(np.diff(leg, axis=0), [[0, -0.04, 0], [0.003, -0.04, 0]], atol=1e-7)
    assert float(rows[0]["sd"]) == pytest.approx(0.001 * np.sqrt(3))
    assert {rows[6][name] for name in ("x", "y", "z", "sd")} == {""}


def test_angles_beside_and_alone(record, tmp_path):
    written = [path.name for path in save(tmp_path / "leg.trc", record).written]
    assert written == ["leg.trc", "leg_angles.csv"]
    save(tmp_path / "leg.angles.csv", record)
    assert (tmp_path / "leg.angles.csv").read_bytes() == (tmp_path / "leg_angles.csv").read_bytes()
    rows = rows_of(tmp_path / "leg_angles.csv")
    angle = ["knee_angle_r", "knee_angle_r_sd"]
    assert list(rows[0]) == ["frame", "time", "trusted", *angle, "uncertain"]
    assert {row["uncertain"] for row in rows} == {""}
    knee = np.degrees(np.arctan2(0.3, 4))
    assert float(rows[0]["knee_angle_r"]) == pytest.approx(knee, rel=1e-3)
    # Across the bones, of 4 px each: the knee counts twice, which moves both.
    assert float(rows[0]["knee_angle_r_sd"]) == pytest.approx(
        np.degrees(0.1 / 4 * np.sqrt(1 + 4 + 1)), rel=0.01
    )
    assert [row["knee_angle_r"] for row in rows[2:]] == ["", ""]


def test_bars_that_move_together_move_no_angle(record, tmp_path):
    together = np.tile(0.01 * np.eye(3), (3, 3, 3))
    save(
        tmp_path / "leg.angles.csv",
        record.replaced(further=record.further | {"shape_covariance": together}),
    )
    assert float(rows_of(tmp_path / "leg.angles.csv")[0]["knee_angle_r_sd"]) < 1e-6


def test_opensim_reads_the_angles(record, tmp_path):
    save(tmp_path / "leg.mot", record)
    lines = (tmp_path / "leg.mot").read_text().splitlines()
    assert lines[:6] == ["a", "version=1", "nRows=4", "nColumns=2", "inDegrees=yes", "endheader"]
    assert lines[6].split("\t") == ["time", "knee_angle_r"]
    assert [line.split("\t")[0] for line in lines[7:]] == ["0.06", "0.08", "0.1", "0.12"]
    assert lines[9].endswith("\tNaN")


def test_angles_that_say_next_to_nothing_are_marked_and_left_out(record, tmp_path):
    wide = record.replaced(shape_sd=10 * record.shape_sd)
    save(tmp_path / "leg.angles.csv", wide)
    rows = rows_of(tmp_path / "leg.angles.csv")
    assert float(rows[0]["knee_angle_r_sd"]) > 15
    assert rows[0]["uncertain"] == "knee_angle_r"
    save(tmp_path / "leg.mot", wide)
    assert (tmp_path / "leg.mot").read_text().splitlines()[7].endswith("\tNaN")


def test_what_is_no_body_has_no_angles(record, tmp_path):
    chair = record.replaced(landmark_names=("leg", "seat", "back"))
    with pytest.raises(InputError, match="no joint angle follows"):
        save(tmp_path / "chair.mot", chair)
    assert [path.name for path in save(tmp_path / "chair.trc", chair).written] == ["chair.trc"]

"""TRC, C3D, and tables of joints and joint angles, read back by other parsers."""

import csv
import sys

import ezc3d
import numpy as np
import pytest
from scipy.linalg import block_diag

from shapefit.errors import InputError
from shapefit.io import read_shapes
from shapefit.io.writers.tables import MAX_FRAMES
from shapefit.records import Fit, Shapes
from tests.columns import put
from tests.io.files import save
from tests.io.writers.conftest import parse_trc, trc_points


def test_trc_has_points_and_times(tmp_path, scene):
    target = tmp_path / "man.trc"
    summary = save(target, scene.result.take(slice(0, 3)), scene.result.take([3]))
    first, header, names, rows = parse_trc(target)
    assert first[:3] == ["PathFileType", "4", "(X/Y/Z)"]
    assert first[4].startswith(
        "y up, the axis z of the extrinsics; position from the camera"
    )
    stated = [header[key] for key in ("Units", "DataRate", "NumFrames", "NumMarkers")]
    assert (*stated, header["OrigDataStartFrame"]) == ("m", "25", "4", "15", "7")
    assert names == list(scene.result.landmark_names)
    np.testing.assert_array_equal(rows[:, 0], [7, 8, 9, 10])
    np.testing.assert_allclose(rows[:, 1], np.array([7, 8, 9, 10]) / 25)
    np.testing.assert_allclose(trc_points(target), scene.y_up, atol=1e-12)
    assert summary.written == (target, tmp_path / "man_angles.csv")
    assert "in m by the size of the training shapes, y up, the axis z" in summary.note
    assert summary.warnings == ()
    back = read_shapes([target])
    assert back.unit == "m"
    assert back.frame_rate == 25
    assert back.items == tuple(f"man/{frame}" for frame in range(7, 11))


def test_frames_are_sorted_and_those_missing_are_gaps(tmp_path, scene):
    result = scene.result.take([3, 0, 2])
    shapes = result.as_columns().copy()
    shapes[2] = np.nan  # frame 9 failed
    summary = save(
        tmp_path / "man.trc",
        result.replaced(shapes=shapes.swapaxes(1, 2), frame_rate=None),
    )
    _, header, _, rows = parse_trc(tmp_path / "man.trc")
    np.testing.assert_array_equal(rows[:, :2].T, [[7, 8, 9, 10], [7, 8, 9, 10]])
    np.testing.assert_array_equal(
        np.isnan(rows[:, 2:]).all(axis=1), [False, True, True, False]
    )
    assert header["NumFrames"] == "4"
    gaps, rate = summary.warnings
    assert gaps == "2 frames without a shape of film/anna"
    assert rate.startswith("the frame rate is unknown")


def test_an_unknown_landmark_is_an_empty_cell(tmp_path, shapes, scene):
    shapes.shapes[1, 4] = np.nan
    save(tmp_path / "walk.trc", shapes, up="z")
    expected = scene.y_up.copy()
    expected[1, :, 4] = np.nan
    np.testing.assert_allclose(trc_points(tmp_path / "walk.trc"), expected, atol=1e-12)


def test_names_with_tabs_do_not_shift_columns(tmp_path, shapes):
    odd = shapes.replaced(landmark_names=("a\tb", "c\nd", *shapes.landmark_names[2:]))
    save(tmp_path / "odd.trc", odd)
    assert parse_trc(tmp_path / "odd.trc")[2][:2] == ["a\\tb", "c\\nd"]


def test_times_of_a_rate_that_is_nearly_25_are_short(tmp_path, scene):
    """Other tools state rates such as 1 / 0.04: 99 frames end at 3.96 s, not
    3.9599...95.
    """
    result = scene.result.replaced(
        frame_rate=25.000000000000004, frames=np.arange(96, 100)
    )
    save(tmp_path / "man.trc", result)
    cells = [
        line.split("\t")[1]
        for line in (tmp_path / "man.trc").read_text().splitlines()[5:]
    ]
    assert cells == ["3.84", "3.88", "3.92", "3.96"]


# C3D


def test_c3d_has_points_in_millimetres(tmp_path, scene):
    target = tmp_path / "man.c3d"
    shapes = scene.result.as_columns().copy()
    shapes[2] = np.nan
    save(target, scene.result.replaced(shapes=shapes.swapaxes(1, 2)))
    file = ezc3d.c3d(str(target))
    point = file["parameters"]["POINT"]
    stated = [point[key]["value"] for key in ("UNITS", "RATE", "Y_SCREEN")]
    assert stated == [["mm"], [25], ["+Y"]]
    assert point["LABELS"]["value"] == list(scene.result.landmark_names)
    assert file["header"]["points"]["first_frame"] == 7
    points = file["data"]["points"][:3].transpose(2, 0, 1)
    np.testing.assert_allclose(
        points[[0, 1, 3]], 1000 * scene.y_up[[0, 1, 3]], atol=1e-3
    )
    assert np.isnan(points[2]).all()
    residuals = file["data"]["meta_points"]["residuals"][0]
    np.testing.assert_array_equal(residuals, np.tile([0, 0, -1, 0], (15, 1)))
    back = read_shapes([target])
    assert back.landmark_names == scene.result.landmark_names
    assert back.frame_rate == 25


def test_shapes_keep_their_axes_and_promise_none(tmp_path, scene, shapes):
    save(tmp_path / "walk.c3d", shapes)
    file = ezc3d.c3d(str(tmp_path / "walk.c3d"))
    points = file["data"]["points"][:3].transpose(2, 0, 1)
    np.testing.assert_allclose(points, 1000 * scene.world, atol=1e-3)
    assert "Y_SCREEN" not in file["parameters"]["POINT"]
    assert file["parameters"]["SHAPEFIT"]["AXES"]["value"] == ["axes as in the shapes"]


def still(names, first=0, frames=2) -> Shapes:
    """Frames of points at the origin."""
    items = tuple(map(str, range(frames)))
    points = np.zeros((frames, 3, len(names)))
    return Shapes(
        points.swapaxes(1, 2),
        landmark_names=names,
        items=items,
        sequences=("a",) * frames,
        unit="m",
        frame_rate=30.0,
        frames=first + np.arange(frames),
    )


LONG, MANY = ("x" * 256,), tuple(map(str, range(256)))


@pytest.mark.parametrize(
    "shapes",
    [still(("a",), MAX_FRAMES - 1), still(("a",), frames=0), still(LONG), still(MANY)],
)
def test_more_than_a_c3d_file_can_hold_is_refused(tmp_path, problems, shapes):
    (line,) = problems(save, tmp_path / "man.c3d", shapes)
    assert (
        "C3D holds 255 landmarks at most, with names of 255 bytes, and the frames 1"
        " to 65" in line
    )
    assert not list(tmp_path.iterdir())


def test_as_much_as_a_c3d_file_can_hold_is_written(tmp_path):
    save(tmp_path / "man.c3d", still((*MANY[:254], "x" * 255), MAX_FRAMES - 2))
    assert (tmp_path / "man.c3d").is_file()


def test_without_the_library_the_error_says_how_to_get_it(
    tmp_path, scene, problems, monkeypatch
):
    monkeypatch.setitem(sys.modules, "ezc3d", None)
    (line,) = problems(save, tmp_path / "man.c3d", scene.result)
    assert line.endswith("need the library ezc3d; run `pip install ezc3d`")


def test_a_disk_that_fills_up_unseen(tmp_path, scene, problems, monkeypatch):
    target = tmp_path / "man.c3d"
    target.write_bytes(b"old")
    original = ezc3d.c3d.write

    def cut(self, path):
        original(self, path)
        with open(path, "r+b") as file:
            file.truncate(600)

    monkeypatch.setattr(ezc3d.c3d, "write", cut)
    (line,) = problems(save, target, scene.result)
    assert "cannot be written: No space left" in line
    assert target.read_bytes() == b"old"


# Joints and joint angles

JOINTS = ("rhip", "rknee", "rankle")
BENT = np.array([[0.0, 0.0, 0.3], [0.0, 4.0, 8.0], [0.0, 0.0, 0.0]])
"""A leg that hangs down in an image, almost straight."""


@pytest.fixture
def leg() -> Fit:
    """Three items in frames 3, 4 and 6 of 50 a second, 100 px in a metre."""
    return Fit(
        np.stack([BENT, BENT, np.full((3, 3), np.nan)]).swapaxes(1, 2),
        shape_sd=np.full((3, 3, 3), 0.1).swapaxes(1, 2),
        landmark_names=JOINTS,
        items=("3", "4", "6"),
        sequences=("a", "a", "a"),
        frame_rate=50.0,
        unit="px",
        attributes={"metres_from": "edges"},
        metres_per_unit=np.full(3, 0.01),
        frames=np.array([3, 4, 6]),
        reasons=np.array(["", "wide error bars", ""], dtype=object),
        trusted=np.array([True, False, True]),
    )


def rows_of(path):
    with path.open() as file:
        return list(csv.DictReader(file))


def test_joints_in_metres(leg, tmp_path):
    save(tmp_path / "leg.metres.csv", leg)
    rows = rows_of(tmp_path / "leg.metres.csv")
    assert [row["frame"] for row in rows] == [
        str(f) for f in (3, 4, 5, 6) for _ in JOINTS
    ]
    assert [row["landmark"] for row in rows] == list(JOINTS) * 4
    assert [row["time"] for row in rows[::3]] == ["0.06", "0.08", "0.1", "0.12"]
    assert [row["trusted"] for row in rows[::3]] == ["true", "false", "", "true"]
    bones = np.diff([[float(row[axis]) for axis in "xyz"] for row in rows[:3]], axis=0)
    np.testing.assert_allclose(bones, [[0, -0.04, 0], [0.003, -0.04, 0]], atol=1e-7)
    assert float(rows[0]["sd"]) == pytest.approx(0.001 * np.sqrt(3))
    assert {rows[6][name] for name in ("x", "y", "z", "sd")} == {""}


def test_angles_beside_and_alone(leg, tmp_path):
    written = [path.name for path in save(tmp_path / "leg.trc", leg).written]
    assert written == ["leg.trc", "leg_angles.csv"]
    save(tmp_path / "leg.angles.csv", leg)
    assert (tmp_path / "leg.angles.csv").read_bytes() == (
        tmp_path / "leg_angles.csv"
    ).read_bytes()
    rows = rows_of(tmp_path / "leg_angles.csv")
    angle = ["knee_angle_r", "knee_angle_r_sd"]
    assert list(rows[0]) == ["frame", "time", "trusted", *angle, "uncertain"]
    assert {row["uncertain"] for row in rows} == {""}
    knee = np.degrees(np.arctan2(0.3, 4))
    assert float(rows[0]["knee_angle_r"]) == pytest.approx(knee, rel=1e-3)
    # Across the bones, of 4 px each: the knee counts twice, which moves both.
    sd = np.degrees(0.1 / 4 * np.sqrt(1 + 4 + 1))
    assert float(rows[0]["knee_angle_r_sd"]) == pytest.approx(sd, rel=0.01)
    assert [row["knee_angle_r"] for row in rows[2:]] == ["", ""]
    save(
        tmp_path / "leg.angles.csv",
        leg.replaced(shape_sd=6 * leg.shape_sd),
    )  # of 21 degrees
    assert rows_of(tmp_path / "leg.angles.csv")[0]["uncertain"] == "knee_angle_r"


def test_deviations_know_how_errors_go_together(leg, tmp_path, rng):
    """Landmarks alone, by deviations and correlations, are as by the covariance of all
    of them.
    """

    def deviation(record):
        save(tmp_path / "leg.angles.csv", record)
        return float(rows_of(tmp_path / "leg.angles.csv")[0]["knee_angle_r_sd"])

    factors = 0.1 * rng.normal(size=(3, 3, 3))
    blocks = factors @ factors.swapaxes(1, 2)
    sd = np.sqrt(np.diagonal(blocks, axis1=1, axis2=2))
    pairs = [
        blocks[:, i, j] / (sd[:, i] * sd[:, j]) for i, j in ((0, 1), (0, 2), (1, 2))
    ]
    alone = leg.replaced(shape_sd=np.stack([sd] * 3))
    alone = put(alone, {"shape_correlation": np.stack([np.transpose(pairs)] * 3)})
    whole = put(leg, {"shape_covariance": np.stack([block_diag(*blocks)] * 3)})
    assert deviation(alone) == pytest.approx(deviation(whole), rel=1e-3)
    together = np.tile(0.01 * np.eye(3), (3, 3, 3))
    assert deviation(put(leg, {"shape_covariance": together})) < 1e-6


def read_storage(path):
    """Return the header of a storage of OpenSim, its labels, and its rows."""
    head, _, body = path.read_text().partition("endheader\n")
    title, *lines = head.splitlines()
    labels, *rows = body.splitlines()
    cells = [[float(cell) for cell in row.split("\t")] for row in rows]
    stated = dict(line.split("=") for line in lines)
    table = np.array(cells).reshape(len(rows), len(labels.split("\t")))
    return {"title": title, **stated}, labels.split("\t"), table


def check_storage(path, title):
    """What OpenSim's readers need: its header, and finite numbers in all rows."""
    header, labels, table = read_storage(path)
    assert header == {
        "title": title,
        "version": "1",
        "nRows": str(len(table)),
        "nColumns": str(len(labels)),
        "inDegrees": "yes",
    }
    assert table.shape == (len(table), len(labels))
    assert labels[0] == "time"
    assert np.isfinite(table).all()
    assert (np.diff(table[:, 0]) > 0).all()
    return labels[1:], table[:, 0], table[:, 1:]


def test_a_mot_file_has_numbers_alone_and_deviations_beside_it(leg, tmp_path):
    summary = save(tmp_path / "leg.mot", leg.replaced(shape_sd=10 * leg.shape_sd))
    assert summary.written == (tmp_path / "leg.mot", tmp_path / "leg_sd.sto")
    names, times, angles = check_storage(tmp_path / "leg.mot", "Coordinates of a")
    assert names == ["knee_angle_r"]
    assert times.tolist() == [0.06, 0.08]  # frame 5 is missing, frame 6 has no shape
    knee = np.degrees(np.arctan2(0.3, 4))
    np.testing.assert_allclose(angles, [[knee], [knee]], rtol=1e-6)
    of_sd = check_storage(tmp_path / "leg_sd.sto", "Standard deviations of a")
    assert of_sd[0] == names
    np.testing.assert_array_equal(of_sd[1], times)
    sd = np.degrees(1.0 / 4 * np.sqrt(1 + 4 + 1))
    np.testing.assert_allclose(of_sd[2], [[sd], [sd]], rtol=0.01)
    assert summary.angles == (
        "2 of 2 joint angles have a standard deviation above 15 degrees (knee_angle_r"
        " 100%); for inverse kinematics write TRC"
    )


def test_angles_that_are_certain_are_said_to_be(leg, tmp_path):
    summary = save(tmp_path / "leg.mot", leg)
    assert summary.angles == (
        "all 2 joint angles have a standard deviation of at most 15 degrees; for"
        " inverse kinematics write TRC"
    )
    summary = save(tmp_path / "leg.angles.csv", leg)
    assert "at most 15 degrees" in summary.angles


def test_an_angle_of_a_joint_that_is_missing_is_that_of_the_nearest_frame(
    leg, tmp_path
):
    both = leg.replaced(landmark_names=JOINTS).take([0, 0, 0, 0])
    other = BENT + np.array([[0, 0, 1.0], [0, 0, 0], [0, 0, 0]])
    shapes = np.concatenate(
        [np.stack([BENT, BENT, other, other]), np.stack([BENT, BENT, other, other])],
        axis=2,
    )
    shapes[1:3, :, 2] = np.nan  # the right ankle, between frames that have it
    record = both.replaced(
        shapes=shapes.swapaxes(1, 2),
        shape_sd=np.full((4, 3, 6), 0.1).swapaxes(1, 2),
        landmark_names=(*JOINTS, "lhip", "lknee", "lankle"),
        frames=np.arange(4),
        items=("0", "1", "2", "3"),
        sequences=("a",) * 4,
    )
    summary = save(tmp_path / "legs.mot", record)
    names, _, angles = check_storage(tmp_path / "legs.mot", "Coordinates of a")
    right, left = angles[:, [names.index(f"knee_angle_{side}") for side in "rl"]].T
    np.testing.assert_allclose(right, left, rtol=1e-6)
    sd = check_storage(tmp_path / "legs_sd.sto", "Standard deviations of a")[2]
    assert sd[1:3, names.index("knee_angle_r")].tolist() == [180, 180]
    assert sd[[0, 3]].max() < 15
    assert summary.angles.startswith("2 of 8 joint angles have")


def test_angles_without_deviations_stand_alone(leg, tmp_path):
    summary = save(tmp_path / "leg.mot", leg.replaced(shape_sd=None))
    assert summary.written == (tmp_path / "leg.mot",)
    assert len(check_storage(tmp_path / "leg.mot", "Coordinates of a")[1]) == 2
    assert summary.angles == (
        "2 joint angles without standard deviations; for inverse kinematics write TRC"
    )


def test_a_recording_without_shapes_gives_no_rows(leg, tmp_path):
    summary = save(tmp_path / "leg.mot", leg.take([2]))
    header, labels, table = read_storage(tmp_path / "leg.mot")
    assert header["nRows"] == "0"
    assert len(table) == 0
    assert labels == ["time", "knee_angle_r"]
    assert "1 frame without a shape" in summary.warnings[0]


def test_angles_of_several_people_are_counted_together(leg, tmp_path):
    other = leg.replaced(sequences=("b",) * 3, shape_sd=10 * leg.shape_sd)
    summary = save(tmp_path / "leg.mot", leg, other)
    names = ["leg_a.mot", "leg_a_sd.sto", "leg_b.mot", "leg_b_sd.sto"]
    assert [path.name for path in summary.written] == names
    assert summary.angles.startswith("2 of 4 joint angles have")


def test_angles_that_say_next_to_nothing_are_marked(leg, tmp_path):
    wide = leg.replaced(shape_sd=10 * leg.shape_sd)
    save(tmp_path / "leg.angles.csv", wide)
    row = rows_of(tmp_path / "leg.angles.csv")[0]
    assert float(row["knee_angle_r_sd"]) > 15
    assert row["uncertain"] == "knee_angle_r"


def test_what_is_no_body_has_no_angles(leg, tmp_path):
    chair = leg.replaced(landmark_names=("leg", "seat", "back"))
    for name in ("chair.mot", "chair.angles.csv"):
        with pytest.raises(InputError, match=f"{name}: no joint angle follows"):
            save(tmp_path / name, chair)
    assert [path.name for path in save(tmp_path / "chair.trc", chair).written] == [
        "chair.trc"
    ]

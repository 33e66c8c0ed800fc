"""Tables of joints and of joint angles, and what OpenSim reads."""

import csv
from typing import NamedTuple

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.linalg import block_diag

from shapefit.errors import InputError
from shapefit.records import Fit
from tests.columns import put
from tests.io.files import save

JOINTS = ("rhip", "rknee", "rankle")
BENT = np.array([[0.0, 0.0, 0.0], [0.0, 4.0, 0.0], [0.3, 8.0, 0.0]])
"""A leg that hangs down in an image, almost straight, one joint a row."""


KNEE = np.degrees(np.arctan2(0.3, 4))
"""Its angle of the knee."""


def knee_deviation(sd):
    """Return the standard deviation of the angle, in degrees.

    It comes from errors across the bones, of 4 px each: the knee counts twice, which
    moves both.
    """
    return np.degrees(sd / 4 * np.sqrt(1 + 4 + 1))


@pytest.fixture
def leg() -> Fit:
    """Three items in frames 3, 4 and 6 of 50 a second, 100 px in a metre."""
    failed = np.full((3, 3), np.nan)
    return Fit(
        np.stack([BENT, BENT, failed]),
        shape_sd=np.full((3, 3, 3), 0.1),
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


@pytest.fixture
def deviation(angle_rows):
    """Return the standard deviation of the knee, as it is written of a leg."""

    def find(record):
        first, *_ = angle_rows(record)
        return float(first["knee_angle_r_sd"])

    return find


def test_deviations_know_how_errors_go_together(leg, deviation, rng):
    """Landmarks alone, by deviations and correlations, are as by the covariance of all
    of them.
    """
    factors = 0.1 * rng.normal(size=(3, 3, 3))
    blocks = factors @ np.matrix_transpose(factors)
    sd = np.sqrt(np.diagonal(blocks, axis1=1, axis2=2))
    correlations = []
    for i, j in ((0, 1), (0, 2), (1, 2)):
        correlations.append(blocks[:, i, j] / (sd[:, i] * sd[:, j]))
    of_landmarks = np.stack([np.transpose(correlations)] * 3)
    of_shapes = np.stack([block_diag(*blocks)] * 3)
    alone = leg.replaced(shape_sd=np.stack([sd] * 3))
    alone = put(alone, {"shape_correlation": of_landmarks})
    whole = put(leg, {"shape_covariance": of_shapes})
    assert deviation(alone) == pytest.approx(deviation(whole), rel=1e-3)


def test_a_leg_that_moves_as_one_has_a_certain_angle(leg, deviation):
    together = np.tile(0.01 * np.eye(3), (3, 3, 3))
    moving = put(leg, {"shape_covariance": together})
    assert deviation(moving) < 1e-6


class Storage(NamedTuple):
    """What a storage of OpenSim holds."""

    header: dict[str, str]
    labels: list[str]
    table: np.ndarray

    @property
    def times(self) -> np.ndarray:
        return self.table[:, 0]

    def column(self, name: str) -> np.ndarray:
        return self.table[:, self.labels.index(name)]


def read_storage(path) -> Storage:
    head, _, body = path.read_text().partition("endheader\n")
    title, *lines = head.splitlines()
    header = {"title": title, **dict(line.split("=") for line in lines)}
    first, *rows = body.splitlines()
    labels = first.split("\t")
    cells = [[float(cell) for cell in row.split("\t")] for row in rows]
    table = np.array(cells).reshape(len(rows), len(labels))
    return Storage(header, labels, table)


def check_storage(path, title) -> Storage:
    """What OpenSim's readers need: its header, and finite numbers in all rows."""
    storage = read_storage(path)
    assert storage.header == {
        "title": title,
        "version": "1",
        "nRows": str(len(storage.table)),
        "nColumns": str(len(storage.labels)),
        "inDegrees": "yes",
    }
    assert storage.labels[0] == "time"
    assert np.isfinite(storage.table).all()
    assert (np.diff(storage.times) > 0).all()
    return storage


ANGLES_TITLE = "Coordinates of a"


DEVIATIONS_TITLE = "Standard deviations of a"


@pytest.fixture
def target(tmp_path):
    return tmp_path / "leg.mot"


def test_a_mot_file_has_numbers_alone(uncertain_leg, target):
    save(target, uncertain_leg)
    storage = check_storage(target, ANGLES_TITLE)
    angles = storage.column("knee_angle_r")
    assert storage.labels == ["time", "knee_angle_r"]
    assert storage.times.tolist() == [0.06, 0.08]  # frame 5 is missing, 6 has no shape
    assert_allclose(angles, [KNEE, KNEE], rtol=1e-6)


def test_deviations_stand_beside_a_mot_file(uncertain_leg, target, tmp_path):
    beside = tmp_path / "leg_sd.sto"
    summary = save(target, uncertain_leg)
    angles = read_storage(target)
    deviations = check_storage(beside, DEVIATIONS_TITLE)
    sd = knee_deviation(1.0)
    assert summary.written == (target, beside)
    assert deviations.labels == angles.labels
    assert_array_equal(deviations.times, angles.times)
    assert_allclose(deviations.column("knee_angle_r"), [sd, sd], rtol=0.01)


def test_uncertain_angles_are_counted(uncertain_leg, target):
    summary = save(target, uncertain_leg)
    assert summary.angles == (
        "2 of 2 joint angles have a standard deviation above 15 degrees (knee_angle_r"
        " 100%); for inverse kinematics write TRC"
    )


def test_angles_that_are_certain_are_said_to_be(leg, target):
    summary = save(target, leg)
    assert summary.angles == (
        "all 2 joint angles have a standard deviation of at most 15 degrees; for"
        " inverse kinematics write TRC"
    )


def test_of_a_table_too_angles_are_said_to_be_certain(leg, tmp_path):
    summary = save(tmp_path / "leg.angles.csv", leg)
    assert "at most 15 degrees" in summary.angles


@pytest.fixture
def legs(leg) -> Fit:
    """Two legs that bend in four frames, without the right ankle in those between."""
    more_bent = BENT.copy()
    more_bent[0, 2] = 1.0
    one_leg = np.stack([BENT, BENT, more_bent, more_bent])
    shapes = np.concatenate([one_leg, one_leg], axis=1)
    shapes[1:3, JOINTS.index("rankle")] = np.nan
    return leg.take([0, 0, 0, 0]).replaced(
        shapes=shapes,
        shape_sd=np.full((4, 6, 3), 0.1),
        landmark_names=(*JOINTS, "lhip", "lknee", "lankle"),
        frames=np.arange(4),
        items=("0", "1", "2", "3"),
        sequences=("a",) * 4,
    )


def test_an_angle_of_a_joint_that_is_missing_is_that_of_the_nearest_frame(legs, target):
    save(target, legs)
    angles = check_storage(target, ANGLES_TITLE)
    right = angles.column("knee_angle_r")
    left = angles.column("knee_angle_l")
    assert_allclose(right, left, rtol=1e-6)


def test_nothing_is_known_of_an_angle_of_the_nearest_frame(legs, target, tmp_path):
    summary = save(target, legs)
    deviations = check_storage(tmp_path / "leg_sd.sto", DEVIATIONS_TITLE)
    sd = deviations.column("knee_angle_r")
    of_whole_legs = deviations.table[[0, 3]]
    assert sd[1:3].tolist() == [180, 180]
    assert of_whole_legs.max() < 15
    assert summary.angles.startswith("2 of 8 joint angles have")


def test_angles_without_deviations_stand_alone(leg, target):
    summary = save(target, leg.replaced(shape_sd=None))
    storage = check_storage(target, ANGLES_TITLE)
    assert summary.written == (target,)
    assert len(storage.times) == 2
    assert summary.angles == (
        "2 joint angles without standard deviations; for inverse kinematics write TRC"
    )


def test_a_recording_without_shapes_gives_no_rows(leg, target):
    summary = save(target, leg.take([2]))
    storage = read_storage(target)
    assert storage.header["nRows"] == "0"
    assert len(storage.table) == 0
    assert storage.labels == ["time", "knee_angle_r"]
    assert "1 frame without a shape" in summary.warnings[0]


def test_angles_of_several_people_are_counted_together(leg, uncertain_leg, target):
    other = uncertain_leg.replaced(sequences=("b",) * 3)
    summary = save(target, leg, other)
    names = ["leg_a.mot", "leg_a_sd.sto", "leg_b.mot", "leg_b_sd.sto"]
    assert [path.name for path in summary.written] == names
    assert summary.angles.startswith("2 of 4 joint angles have")


@pytest.fixture
def uncertain_leg(leg) -> Fit:
    """The leg with error bars of 1 px, so that the angle says next to nothing."""
    return leg.replaced(shape_sd=10 * leg.shape_sd)


@pytest.fixture
def joint_rows(leg, tmp_path):
    """The rows of the joints in metres."""
    path = tmp_path / "leg.metres.csv"
    save(path, leg)
    return rows_of(path)


@pytest.fixture
def angle_rows(tmp_path):
    """Write the angles of a leg, and return the rows of the table."""

    def write(record):
        path = tmp_path / "leg.angles.csv"
        save(path, record)
        return rows_of(path)

    return write


def test_joints_have_a_row_in_every_frame(joint_rows):
    frames = [row["frame"] for row in joint_rows]
    landmarks = [row["landmark"] for row in joint_rows]
    assert frames == [str(frame) for frame in (3, 4, 5, 6) for _ in JOINTS]
    assert landmarks == list(JOINTS) * 4


def test_times_and_trust_of_joints(joint_rows):
    rows_of_hip = joint_rows[::3]
    times = [row["time"] for row in rows_of_hip]
    trusted = [row["trusted"] for row in rows_of_hip]
    assert times == ["0.06", "0.08", "0.1", "0.12"]
    assert trusted == ["true", "false", "", "true"]


def test_joints_are_in_metres(joint_rows):
    points = [[float(row[axis]) for axis in "xyz"] for row in joint_rows[:3]]
    bones = np.diff(points, axis=0)
    sd = float(joint_rows[0]["sd"])
    assert_allclose(bones, [[0, -0.04, 0], [0.003, -0.04, 0]], atol=1e-7)
    assert sd == pytest.approx(0.001 * np.sqrt(3))


def test_joints_of_a_missing_frame_are_empty(joint_rows):
    hip_in_frame_5 = joint_rows[6]
    cells = {hip_in_frame_5[name] for name in ("x", "y", "z", "sd")}
    assert cells == {""}


def test_angles_beside_points_are_those_alone(leg, tmp_path):
    beside = tmp_path / "leg_angles.csv"
    alone = tmp_path / "leg.angles.csv"
    written = save(tmp_path / "leg.trc", leg).written
    save(alone, leg)
    assert written == (tmp_path / "leg.trc", beside)
    assert alone.read_bytes() == beside.read_bytes()


def test_angles_have_their_deviation(leg, angle_rows):
    rows = angle_rows(leg)
    angle = float(rows[0]["knee_angle_r"])
    sd = float(rows[0]["knee_angle_r_sd"])
    names = ["knee_angle_r", "knee_angle_r_sd"]
    assert list(rows[0]) == ["frame", "time", "trusted", *names, "uncertain"]
    assert angle == pytest.approx(KNEE, rel=1e-3)
    assert sd == pytest.approx(knee_deviation(0.1), rel=0.01)


def test_angles_of_missing_frames_are_empty(leg, angle_rows):
    rows = angle_rows(leg)
    assert [row["knee_angle_r"] for row in rows[2:]] == ["", ""]


def test_angles_that_are_certain_are_not_marked(leg, angle_rows):
    marks = {row["uncertain"] for row in angle_rows(leg)}
    assert marks == {""}


@pytest.mark.parametrize("factor", [6, 10])
def test_angles_that_say_next_to_nothing_are_marked(leg, angle_rows, factor):
    """Of 21 degrees and more."""
    first, *_ = angle_rows(leg.replaced(shape_sd=factor * leg.shape_sd))
    assert float(first["knee_angle_r_sd"]) > 15
    assert first["uncertain"] == "knee_angle_r"


@pytest.fixture
def chair(leg) -> Fit:
    return leg.replaced(landmark_names=("leg", "seat", "back"))


@pytest.mark.parametrize("name", ["chair.mot", "chair.angles.csv"])
def test_what_is_no_body_has_no_angles(chair, tmp_path, name):
    with pytest.raises(InputError, match=f"{name}: no joint angle follows"):
        save(tmp_path / name, chair)


def test_what_is_no_body_has_no_angles_beside_its_points(chair, tmp_path):
    path = tmp_path / "chair.trc"
    assert save(path, chair).written == (path,)

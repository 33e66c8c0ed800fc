"""Files in metres stand on the floor where feet show it, and markers are the detector's own."""

import csv
import re

import ezc3d
import numpy as np
import pytest

from shapefit.errors import InputError
from shapefit.geometry.floor import ABOVE_FLOOR
from shapefit.geometry.pinhole import ASSUMED_FOCAL
from shapefit.io.layout import INPUT_NAMES, INPUT_SD, INPUT_SHAPES
from shapefit.io.options import AS_KNOWN
from shapefit.io.records import ResultSet, concatenate
from shapefit.io.writers.motion import find_floors
from tests.geometry import test_floor as planted
from tests.io.files import load_shapes, save
from tests.io.writers.conftest import visible
from tests.io.writers.test_trc import parse

SOLE = ABOVE_FLOOR["ankle"] * planted.TALL
ANKLES = [planted.JOINTS["lankle"], planted.JOINTS["rankle"]]
Y_DOWN = np.diag([1.0, -1.0, -1.0])
ROOT = ("extrinsic_rotation", "extrinsic_translation")


def result(points, name="film/anna", **camera) -> ResultSet:
    """Return what a fit of these bodies finds through a tilted camera."""
    points, _ = planted.visible(points, **camera)
    found = visible(Y_DOWN @ points, np.eye(3), np.zeros(3), tuple(planted.JOINTS))
    n = len(points)
    sd = np.full_like(found.shapes, 0.05) / found.columns["metres_per_unit"][:, None, None]
    return found.without(ROOT).replaced(
        items=tuple(f"{name}/{i}" for i in range(n)),
        sequences=(name,) * n,
        shape_sd=sd,
    )


@pytest.fixture
def walk() -> ResultSet:
    return result(planted.walk())


def lowest(points):
    """Return how high the lower ankle is in the median frame (f, 3, p)."""
    return np.nanmedian(points[:, 1][:, ANKLES].min(axis=1))


def points_of(path):
    rows = parse(path)[3][:, 2:]
    return rows.reshape(len(rows), -1, 3).swapaxes(1, 2)


def test_feet_are_on_the_floor_in_every_format(tmp_path, walk):
    summary = save(tmp_path / "man.trc", walk)
    line = r"y up from the floor; camera 1\.\d\d m \(\+- 0\.\d\d\) above the floor, tilted 1\d degr"
    assert re.search(line, summary.note)
    points = points_of(tmp_path / "man.trc")
    assert lowest(points) == pytest.approx(SOLE, abs=0.02)
    assert "above the floor" in parse(tmp_path / "man.trc")[0][4]
    save(tmp_path / "man.c3d", walk)
    marks = ezc3d.c3d(str(tmp_path / "man.c3d"))["data"]["points"][:3].transpose(2, 0, 1)
    np.testing.assert_allclose(marks / 1000, points, atol=1e-5)
    save(tmp_path / "man.metres.csv", walk)
    with (tmp_path / "man.metres.csv").open() as file:
        rows = [[float(row[axis]) for axis in "xyz"] for row in csv.DictReader(file)]
    table = np.reshape(rows, (len(points), -1, 3)).swapaxes(1, 2)
    np.testing.assert_allclose(table, points, atol=1e-6)
    save(tmp_path / "man.bvh", walk)
    text = (tmp_path / "man.bvh").read_text(encoding="utf-8").split("Frame Time")[1]
    root = np.array([line.split()[:3] for line in text.splitlines()[1:]], dtype=float)
    high = points[:, :, [planted.JOINTS["lhip"], planted.JOINTS["rhip"]]].mean(axis=2)
    assert np.abs(root[:, 1] - high[:, 1]).max() < 0.3


def test_tilts_of_trunk_and_head_are_to_the_true_vertical(tmp_path, walk):
    save(tmp_path / "man.trc", walk)
    with (tmp_path / "man_angles.csv").open() as file:
        tilts = [float(row["trunk_tilt"]) for row in csv.DictReader(file)]
    assert np.max(tilts) < 2  # of a camera that is tilted by 12


def test_a_camera_with_extrinsics_keeps_its_world(tmp_path, walk):
    known = walk.with_columns(
        {"extrinsic_rotation": np.eye(3), "extrinsic_translation": np.zeros(3)}
    )
    summary = save(tmp_path / "man.trc", known)
    assert "y up, the axis -y of the extrinsics; position from the camera" in summary.note


def test_weak_perspective_stays_as_it_is(tmp_path, walk):
    summary = save(tmp_path / "man.trc", walk.without(("camera_translation",)))
    assert "y up as in the image; lowest landmark at height 0" in summary.note


@pytest.mark.parametrize("posture", [planted.sitting, planted.running])
def test_where_nobody_stands_the_camera_is_taken_as_level(tmp_path, posture):
    summary = save(tmp_path / "man.trc", result(posture()))
    line = "y up as in the image; the feet do not show the floor; position from the camera"
    assert line in summary.note


@pytest.mark.parametrize("height", [0.4, 1.7, 6.0])
def test_a_given_height_does_not_decide_whether_there_is_a_floor(tmp_path, walk, height):
    notes = [
        save(tmp_path / f"{name}.trc", walk, **given).note
        for name, given in (("known", {}), ("given", {"height": height}))
    ]
    tilts = [re.search(r"above the floor, (tilted .*\(\+- \d+\))", note) for note in notes]
    assert tilts[0] is not None
    assert tilts[1] is not None
    assert tilts[0][1] == tilts[1][1]


def test_what_is_not_to_be_trusted_says_nothing(walk):
    reasons = np.array(["wide error bars"] * len(walk), dtype=object)
    assert list(find_floors(walk, AS_KNOWN, "")) == ["film"]
    assert find_floors(walk.with_columns({"reasons": reasons}), AS_KNOWN, "") == {}


def test_feet_that_no_image_shows_stand_nowhere(walk):
    landmarks = np.zeros((len(walk), len(planted.JOINTS), 2))
    landmarks[5:8, ANKLES] = np.nan  # a gap
    whole = find_floors(walk, AS_KNOWN, "")["film"]
    gap = find_floors(walk.with_columns({"landmarks": landmarks}), AS_KNOWN, "")["film"]
    np.testing.assert_array_equal(gap.up, whole.up)
    landmarks[:, ANKLES] = np.nan
    assert find_floors(walk.with_columns({"landmarks": landmarks}), AS_KNOWN, "") == {}


def test_individuals_of_a_video_share_the_floor_and_videos_do_not(walk):
    other = result(planted.walk(heading=1.0), "film/bert", away=8.0)
    level = result(planted.walk(), "other/anna", height=0.5, pitch=-5.0)
    alone, both = (
        find_floors(each, AS_KNOWN, "") for each in (walk, concatenate([walk, other, level]))
    )
    assert list(both) == ["film", "other"]
    assert both["film"].height_sd < alone["film"].height_sd
    assert both["other"].height == pytest.approx(0.5, abs=0.1)


def test_an_assumed_focal_length_widens_the_bars(walk):
    n = len(walk)
    centre = np.tile([960.0, 540.0], (n, 1))

    def height_sd(focal):
        columns = {"focal": np.full((n, 2), focal), "principal_point": centre}
        return find_floors(walk.with_columns(columns), AS_KNOWN, "")["film"].height_sd

    assert height_sd(ASSUMED_FOCAL * 1920) > 1.04 * height_sd(1800.0)


MARKERS = ("RHip", "LHip", "MidHip", "Nose")


@pytest.fixture
def lifted(walk) -> ResultSet:
    """Return the walk with four landmarks of a detector, 1 cm above joints."""
    columns = [planted.JOINTS[joint] for joint in ("rhip", "lhip", "rhip", "rshoulder")]
    points = walk.shapes[..., columns].swapaxes(1, 2).copy()
    points[..., 1] -= 0.01 / walk.columns["metres_per_unit"][:, None]
    return walk.with_columns(
        {
            INPUT_SHAPES: points,
            INPUT_SD: np.full_like(points, 2.0),
            INPUT_NAMES: np.array(MARKERS, dtype=object),
        }
    )


def test_markers_of_the_detector(tmp_path, lifted):
    """A second reader finds them by the names that models of Pose2Sim know, in the same place."""
    save(tmp_path / "joints.trc", lifted)
    summary = save(tmp_path / "man.trc", lifted, markers="input")
    assert "4 markers of the files; MidHip, Nose estimated by the model alone; " in summary.note
    names = parse(tmp_path / "man.trc")[2]
    assert names == ["RHip", "LHip", "CHip", "Nose"]
    marks, joints = points_of(tmp_path / "man.trc"), points_of(tmp_path / "joints.trc")
    apart = marks[..., 0] - joints[..., planted.JOINTS["rhip"]]
    np.testing.assert_allclose(np.linalg.norm(apart, axis=1), 0.01, atol=1e-6)
    read, _ = load_shapes(tmp_path / "man.trc")
    assert read.landmark_names == tuple(names)
    np.testing.assert_allclose(read.shapes, marks, atol=1e-12)
    angles = [(tmp_path / f"{name}_angles.csv").read_bytes() for name in ("man", "joints")]
    assert angles[0] == angles[1]


def test_bones_join_markers_that_are_renamed(tmp_path, lifted):
    save(tmp_path / "man.bvh", lifted, markers="input")
    bones = (tmp_path / "man.bvh").read_text(encoding="utf-8")
    assert "CHip" in bones
    assert "RHip" in bones


def test_markers_of_coco_have_the_names_of_models(tmp_path, lifted):
    names = np.array(["right_hip", "left_hip", "nose", "left_ear"], dtype=object)
    save(tmp_path / "man.trc", lifted.with_columns({INPUT_NAMES: names}), markers="input")
    assert parse(tmp_path / "man.trc")[2] == ["RHip", "LHip", "Nose", "LEar"]


def test_without_landmarks_of_a_detector_there_are_no_markers(tmp_path, walk):
    with pytest.raises(InputError, match="lift them with `posterior` or `sequences`"):
        save(tmp_path / "man.trc", walk, markers="input")
    with pytest.raises(InputError, match="leave it out"):
        save(tmp_path / "man.h5", walk, markers="input")

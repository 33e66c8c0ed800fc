"""BVH is read back by our reader: joints are where the landmarks of the result were."""

import re

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from shapefit.errors import InputError
from shapefit.geometry.rotations import random_rotations
from shapefit.io import read_shapes
from shapefit.io.skeletons import PEOPLE
from shapefit.io.writers.bvh import find_angles
from shapefit.records import Shapes
from tests.columns import in_rows
from tests.io.files import save

MILLIMETRE = 1e-3

LIMBS = ["UpLeg", "Leg", "Foot", "Arm", "ForeArm", "Hand"]
RIGHT = [f"Right{limb}" for limb in LIMBS]
LEFT = [f"Left{limb}" for limb in LIMBS]
NAMES = ["Hips", *RIGHT[:3], *LEFT[:3], "Spine2", "Head", *RIGHT[3:], *LEFT[3:]]
"""Of the joints of PEOPLE."""


@pytest.fixture
def target(tmp_path):
    return tmp_path / "man.bvh"


def read_joints(path, names):
    """Return the joints (f, 3, p) of these names in a file."""
    back = read_shapes([path])
    columns = [back.landmark_names.index(name) for name in names]
    return back.as_columns()[:, :, columns]


def assert_joints_near(joints, expected):
    assert_allclose(joints, expected, atol=0.02 * MILLIMETRE)


def test_rigid_bones_come_back_to_a_millimetre(target, project):
    shapes = read_shapes([project / "sample_data/people_test.h5"])
    summary = save(target, shapes)
    sequences = np.array(shapes.sequences)
    note = r"joints of \w+ 0\.0 mm from the landmarks on average"
    assert re.search(note, summary.note)
    assert len(summary.written) == 8
    for path in summary.written:
        sequence = path.stem.removeprefix("man_")
        expected = shapes.as_columns()[sequences == sequence]
        assert_joints_near(read_joints(path, NAMES), expected)
        assert read_shapes([path]).frame_rate == 24


def test_a_result_is_in_metres(target, scene):
    summary = save(target, scene.result)
    assert_joints_near(read_joints(target, NAMES), scene.y_up)
    assert read_shapes([target]).frame_rate == 25
    assert "in m by the size of the training shapes, y up, the axis z" in summary.note


REST_DIRECTIONS = {
    (1, 0, 0): ("LeftArm", "LeftForeArm", "LeftHand"),
    (-1, 0, 0): ("RightArm", "RightForeArm", "RightHand"),
    (0, -1, 0): ("LeftLeg", "LeftFoot", "RightLeg", "RightFoot"),
    (2**-0.5, -(2**-0.5), 0): ("LeftUpLeg",),
    (0, 1, 0): ("Spine2", "Head"),
}
"""Direction -> bones. Arms point to the sides, the left one to +x; legs down, head
up.
"""


JOINTS_BETWEEN = {"Spine", "Neck", "LeftShoulder", "RightShoulder", "LeftHipJoint"}
"""Joints that are no landmark."""


def test_a_result_rests_in_a_t(target, scene):
    save(target, scene.result)
    text = target.read_text(encoding="utf-8")
    rest = re.findall(r"(?:JOINT|ROOT) (\S+)\s*\{\s*OFFSET (\S+) (\S+) (\S+)", text)
    bones = {name: np.array(offset, float) for name, *offset in rest}
    assert bones.keys() >= JOINTS_BETWEEN
    for direction, names in REST_DIRECTIONS.items():
        for name in names:
            length = np.linalg.norm(bones[name])
            expected = length * np.array(direction)
            assert_allclose(bones[name], expected, atol=1e-5)


def test_twelve_joints_of_limbs_are_a_person(target, shapes):
    """Shoulders, elbows and wrists, hips, knees and ankles."""
    middle = {"pelvis", "neck", "head"}
    is_limb = np.array([name not in middle for name in shapes.landmark_names])
    assert is_limb.sum() == 12
    limbs = tuple(np.array(shapes.landmark_names)[is_limb].tolist())

    save(
        target, shapes.replaced(shapes=shapes.shapes[:, is_limb], landmark_names=limbs)
    )

    names = set(re.findall(r"JOINT (\S+)", target.read_text()))
    assert names >= {"LeftForeArm", "RightHand", "LeftLeg", "RightFoot"}


@pytest.mark.parametrize("rate", [24.7, 59.94, 119.88])
def test_the_time_of_a_frame_is_exact_to_ten_digits(target, shapes, rate):
    save(target, shapes.replaced(frame_rate=rate))
    (time,) = re.findall(r"Frame Time: (\S+)", target.read_text())
    assert 1 / float(time) == pytest.approx(rate, rel=1e-9)


def test_the_note_says_how_far_bones_that_stretch_are_from_the_landmarks(
    target, scene, shapes
):
    wrist = PEOPLE.index("lwrist")
    stretch = 0.1
    shapes.shapes[2, wrist, 2] += 100 * stretch  # in cm
    summary = save(target, shapes, up="z")
    expected = scene.y_up[..., wrist]
    expected[2, 1] += stretch
    hand = read_joints(target, ["LeftHand"])[..., 0]
    largest = np.linalg.norm(hand - expected, axis=1).max()
    assert largest > 20 * MILLIMETRE
    assert f"{1000 * largest:.1f} at most" in summary.note


def test_gaps_are_bridged(target, shapes):
    ankle = 3
    ends = shapes.shapes[:, ankle] / 100
    middle = (ends[0] + ends[2]) / 2
    shapes.shapes[1, ankle] = np.nan
    save(target, shapes)
    foot = read_joints(target, ["RightFoot"])[1, :, 0]
    assert_allclose(foot, middle, atol=20 * MILLIMETRE)


@pytest.mark.parametrize(("missing", "nearest"), [(0, 1), (-1, -2)])
def test_before_and_after_what_is_known_a_landmark_stays(
    target, shapes, missing, nearest
):
    wrist = shapes.landmark_names.index("lwrist")
    others = np.arange(len(shapes.landmark_names)) != wrist
    shapes.shapes[:] = shapes.shapes[nearest]
    held = shapes.shapes.copy()
    shapes.shapes[missing, wrist] = np.nan
    assert np.isfinite(shapes.shapes[missing, others]).all()

    save(target, shapes)

    hand = read_joints(target, ["LeftHand"])[missing, :, 0]
    assert_joints_near(hand, held[missing, wrist] / 100)


OFFSET = r"OFFSET (\S+) (\S+) (\S+)"
TIP = OFFSET + r"\s+CHANNELS[^\n]*\s+End Site\s*\{\s*" + OFFSET
"""Offsets of a last joint and of its end."""


def test_limbs_go_on_beyond_their_last_joints(target, scene):
    save(target, scene.result)
    limbs = np.array(re.findall(TIP, target.read_text()), float).reshape(-1, 2, 3)
    bones, ends = limbs[:, 0], limbs[:, 1]
    share = np.linalg.norm(ends, axis=1) / np.linalg.norm(bones, axis=1)
    assert len(limbs) == 5  # head, hands and feet
    assert (share > 0).all()
    assert_allclose(ends, share[:, None] * bones, atol=1e-5)


def test_without_a_frame_it_is_refused(target, shapes):
    with pytest.raises(InputError, match="there is no frame to write"):
        save(target, shapes.take(slice(0)))


def test_what_has_no_place_is_left_out(target, shapes):
    shapes.shapes[:, 8] = np.nan
    save(target, shapes)
    assert "Head" not in read_shapes([target]).landmark_names


@pytest.fixture
def animal(rng) -> Shapes:
    body = np.array([[0, 0, 0.0], [-1, 0, 0], [1, 0.2, 0], [1, -0.2, 0]]).T / 10
    turned = random_rotations(6, rng) @ body
    return Shapes(
        in_rows(turned),
        landmark_names=("the back", "tail", "left {ear}", "nose{}"),
        items=tuple("012345"),
        sequences=("rat",) * 6,
        edges=np.array([[0, 1], [0, 2], [0, 3]]),
        unit="m",
        frame_rate=30.0,
    )


def test_other_classes_keep_their_names(target, animal):
    save(target, animal)
    joints = read_joints(target, ["the_back", "tail", "left_ear_", "nose_"])
    assert_joints_near(joints, animal.as_columns())


def test_names_that_bvh_would_confuse_differ(target, animal):
    named = animal.replaced(landmark_names=("back", "the tail", "the_tail", "nose"))
    save(target, named)
    joints = read_joints(target, ["back", "the_tail", "the_tail_", "nose"])
    assert_joints_near(joints, named.as_columns())


@pytest.mark.parametrize("change", ["no edges", "no places"])
def test_without_edges_or_shapes_it_is_refused(tmp_path, animal, problems, change):
    changed = {
        "no edges": animal.replaced(edges=None),
        "no places": animal.replaced(shapes=np.full_like(animal.shapes, np.nan)),
    }
    (line,) = problems(save, tmp_path / "rat.bvh", changed[change])
    assert line.startswith("rat.bvh: no edge joins two landmarks that have a place")
    assert "write TRC or C3D" in line
    assert not list(tmp_path.iterdir())


def rotations_of(angles):
    return Rotation.from_euler("ZXY", angles).as_matrix()


def test_angles_are_those_of_the_rotations(rng):
    R = random_rotations(50, rng)
    (angles,) = find_angles(R[None])
    assert_allclose(rotations_of(angles), R, atol=1e-12)


def test_angles_of_slow_turns_change_little():
    turn = np.radians(np.linspace(0, 1000, 400))
    smooth = np.stack([0.3 * np.sin(turn), turn, turn / 3], axis=1)
    (angles,) = find_angles(rotations_of(smooth)[None])
    steps = np.abs(np.diff(angles, axis=0))
    assert steps.max() < np.radians(6)


@pytest.mark.parametrize("middle", [-np.pi / 2, np.pi / 2])
@pytest.mark.parametrize("off", [0.0, 1e-12, 1e-9, 1e-7, 1e-5])
def test_near_a_quarter_turn_about_the_middle_axis_angles_are_right(rng, middle, off):
    """There the other two are of one axis, and rounding alone tells them apart."""
    others = rng.uniform(-np.pi, np.pi, (20, 2))
    away = off * rng.choice([-1, 1], 20)
    angles = np.column_stack([others[:, 0], middle + away, others[:, 1]])
    R = rotations_of(angles)
    (found,) = find_angles(R[:, None].swapaxes(0, 1))
    assert_allclose(rotations_of(found), R, atol=3e-8)


@pytest.mark.parametrize("sign", [-1, 1])
def test_a_quarter_turn_that_is_rounded_up_has_angles(sign):
    """Its sine is a little more than 1."""
    (R,) = rotations_of(np.array([[0.3, sign * np.pi / 2, 0.0]]))
    R[2, 1] = sign * np.nextafter(1.0, 2.0)
    (angles,) = find_angles(R[None, None])
    assert_allclose(rotations_of(angles)[0], R, atol=1e-7)

"""Joint angles and rotations: planted poses, deviations of a simulation, bones with
known turns.
"""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from shapefit.geometry.joint_angles import (
    JOINT_ANGLES,
    measurable_angles,
    measure_angles,
)
from shapefit.geometry.joint_rotations import (
    find_bones,
    find_rig,
    find_tree,
    place_nodes,
)
from shapefit.geometry.rotations import exponential, rotation_about_axis
from tests.points import chain

UP = np.array([0.0, 1.0, 0.0])
OPPOSITE = {"r": "l", "l": "r"}

TRUTH = {
    "hip_flexion_r": 40.0,
    "hip_flexion_l": -15.0,
    "knee_angle_r": 70.0,
    "knee_angle_l": 5.0,
    "ankle_angle_r": 12.0,
    "ankle_angle_l": -30.0,
    "arm_flex_r": 95.0,
    "arm_flex_l": -20.0,
    "elbow_flex_r": 110.0,
    "elbow_flex_l": 30.0,
    "trunk_tilt": 0.0,
    "head_tilt": 25.0,
}
"""Angles of a body in degrees."""


DOWN = -UP
FORWARD = np.array([1.0, 0.0, 0.0])


def turned(vector, degrees):
    """Turn a vector about z, which points to the right of a body that looks along x."""
    return Rotation.from_euler("z", degrees, degrees=True).apply(vector)


def person(angles=TRUTH):
    """Return the joints of a body, x forward, y up and z to the right, in metres."""
    neck = np.array([0, 1.45, 0])
    head = neck + 0.2 * turned(UP, -angles["head_tilt"])
    return {"head": head} | person_s_side(angles, "r") | person_s_side(angles, "l")


def person_s_side(angles, side):
    """Return the joints of the right or the left side."""
    to_the_right = 1.0 if side == "r" else -1.0
    arm = angles[f"arm_flex_{side}"]
    shoulder = np.array([0, 1.45, 0.2 * to_the_right])
    elbow = shoulder + 0.3 * turned(DOWN, arm)
    wrist = elbow + 0.25 * turned(DOWN, arm + angles[f"elbow_flex_{side}"])

    thigh = angles[f"hip_flexion_{side}"]
    shank = thigh - angles[f"knee_angle_{side}"]
    hip = np.array([0, 0.95, 0.1 * to_the_right])
    knee = hip + 0.45 * turned(DOWN, thigh)
    ankle = knee + 0.4 * turned(DOWN, shank)
    foot = turned(FORWARD, shank + angles[f"ankle_angle_{side}"])
    return {
        f"{side}shoulder": shoulder,
        f"{side}elbow": elbow,
        f"{side}wrist": wrist,
        f"{side}hip": hip,
        f"{side}knee": knee,
        f"{side}ankle": ankle,
        f"{side}heel": ankle - 0.05 * foot,
        f"{side}toe": ankle + 0.2 * foot,
    }


def measure(joints, up=UP, covariance=None):
    """Return the angles of each shape, and their deviations, by their names."""
    columns = {name: number for number, name in enumerate(joints)}
    shapes = np.stack([np.atleast_2d(points) for points in joints.values()], axis=-1)
    values, deviations = measure_angles(shapes, up, columns, covariance)
    names = [angle.name for angle in measurable_angles(columns)]
    named_values = dict(zip(names, values.T, strict=True))
    named_deviations = dict(zip(names, deviations.T, strict=True))
    return named_values, named_deviations


def assert_angles(found, expected, tolerance=1e-9):
    """The angles of one shape are those expected, in degrees."""
    assert found.keys() == expected.keys()
    for name, degrees in expected.items():
        assert found[name][0] == pytest.approx(degrees, abs=tolerance), name


def test_planted_angles_are_found():
    found, _ = measure(person())
    assert_angles(found, TRUTH)


def test_all_angles_are_planted():
    assert TRUTH.keys() == {angle.name for angle in JOINT_ANGLES}


def test_without_covariance_no_deviation_is_known():
    _, deviations = measure(person())
    assert np.isnan([*deviations.values()]).all()


def test_angles_do_not_depend_on_frame_and_size(rng):
    turn = Rotation.random(rng=7).as_matrix()
    shift = rng.normal(size=3)
    moved = {name: 3.7 * turn @ point + shift for name, point in person().items()}

    found, _ = measure(moved, turn @ UP)

    assert_angles(found, TRUTH, tolerance=1e-6)


def opposite_joint(name):
    return name if name == "head" else OPPOSITE[name[0]] + name[1:]


def opposite_angle(name):
    """Return the angle of the other side, or that of head or trunk itself."""
    body_part, _, side = name.rpartition("_")
    return f"{body_part}_{OPPOSITE[side]}" if side in OPPOSITE else name


def test_left_and_right_exchange_in_a_mirror():
    mirror = np.array([1, 1, -1])
    mirrored = {
        opposite_joint(name): point * mirror for name, point in person().items()
    }

    found, _ = measure(mirrored)

    assert_angles(
        found, {opposite_angle(name): degrees for name, degrees in TRUTH.items()}
    )


def test_a_body_in_part_has_some_angles():
    joints = person()
    del joints["rankle"]
    del joints["head"]

    found, _ = measure(joints)

    missing = TRUTH.keys() - found.keys()
    assert missing == {"knee_angle_r", "ankle_angle_r", "head_tilt"}


class TestDeviations:
    """Deviations are those of 20,000 bodies whose joints err by about a centimetre."""

    @pytest.fixture
    def joints(self):
        """A body with no straight line, which has no derivative."""
        joints = person(TRUTH | {"knee_angle_l": 40.0, "head_tilt": 80.0})
        for shoulder in ("rshoulder", "lshoulder"):
            joints[shoulder] = joints[shoulder] + [0.1, 0, 0]
        return joints

    def simulate(self, joints, root, rng):
        """Return the deviations of angles of bodies with errors of the covariance root
        root^T.
        """
        p = len(joints)
        errors = rng.normal(size=(20_000, 3 * p)) @ root.T
        errors = errors.reshape(-1, p, 3)
        drawn = {name: joints[name] + errors[:, k] for k, name in enumerate(joints)}
        angles, _ = measure(drawn)
        return {name: values.std() for name, values in angles.items()}

    def assert_deviations(self, deviations, simulated):
        for name, expected in simulated.items():
            assert deviations[name][0] == pytest.approx(expected, rel=0.05), name

    def test_where_each_joint_errs_by_itself(self, joints, rng):
        p = len(joints)
        root = 0.01 * np.eye(3 * p)
        covariance_of_each_joint = np.tile(1e-4 * np.eye(3), (1, p, 1, 1))

        _, deviations = measure(joints, covariance=covariance_of_each_joint)

        self.assert_deviations(deviations, self.simulate(joints, root, rng))

    def test_where_joints_err_together(self, joints, rng):
        p = len(joints)
        root = 0.01 * rng.normal(size=(3 * p, 3 * p)) / np.sqrt(p)
        joint_covariance = (root @ root.T)[None]

        _, deviations = measure(joints, covariance=joint_covariance)

        self.assert_deviations(deviations, self.simulate(joints, root, rng))


PARENTS = (-1, 0, 1, 2, 0, 4, 5, 0, 7)
"""A trunk from whose foot three limbs leave."""
EDGES = np.array([(parent, j) for j, parent in enumerate(PARENTS) if parent >= 0])


@pytest.fixture
def moved(rng):
    """Joints (f, 3, p) of bones of one length, each turning smoothly against the one
    before.
    """
    phase = np.linspace(0, 2 * np.pi, 80)
    swing = np.stack([np.sin(phase), np.cos(phase)], axis=1)
    frames, places = [], []
    for parent in PARENTS:
        axes = 0.25 * rng.normal(size=(2, 3))
        length = rng.uniform(0.5, 1.0)
        direction = np.eye(3)[rng.integers(3)]
        frame = exponential(swing @ axes)
        place = np.zeros(3)
        if parent >= 0:
            frame = frames[parent] @ frame
            place = places[parent]
        frames.append(frame)
        places.append(place + frame @ (length * direction))
    return np.stack(places, axis=2)


def joints_of_nodes(rig, points):
    """Return the landmark (f, 3) of each node of a rig."""
    return [points[:, :, node.joint] for node in rig.tree]


def test_rigid_bones_end_at_their_landmarks(moved):
    rig = find_rig(moved, EDGES)
    assert_allclose(place_nodes(rig), joints_of_nodes(rig, moved), atol=1e-12)


def test_the_root_is_where_bones_branch(moved):
    rig = find_rig(moved, EDGES)
    assert rig.tree[0].joint == 0


def test_no_rotation_of_a_rig_mirrors(moved):
    rig = find_rig(moved, EDGES)
    assert_allclose(np.linalg.det(rig.rotations), 1)


def test_at_rest_nothing_is_turned(moved):
    rig = find_rig(moved, EDGES)
    deviation = rig.rotations[:, rig.rest] - np.eye(3)
    assert_allclose(deviation, 0, atol=1e-12)


def test_a_body_that_turns_as_a_whole_bends_no_joint(moved):
    turns = exponential(np.linspace([0, 0, 0], [0.5, 1.0, -1.5], 80))
    stiff = turns @ moved[:1]

    rig = find_rig(stiff, EDGES)

    joint_turns = rig.rotations[1:]
    assert_allclose(joint_turns - np.eye(3), 0, atol=0.03)


def test_of_loops_the_rigid_bones_are_taken_and_what_is_apart_is_joined(rng):
    """What leads to landmark 3 stretches; no edge leads to 4, which moves with 3."""
    points = np.tile(rng.normal(size=(3, 5)), (50, 1, 1))
    points[:, 0, 3] += np.linspace(0, 1, 50)
    points[:, :, 4] = points[:, :, 3] + 0.1
    loop = {(0, 1), (1, 2), (0, 2)}
    edges = np.array([[0, 1], [1, 2], [2, 0], [2, 3]])

    tree = find_tree(points, edges, root=0)

    bones = {tuple(sorted(bone)) for bone in find_bones(tree).items()}
    assert bones - loop == {(2, 3), (3, 4)}
    assert len(bones) == 4


def test_of_two_landmarks_in_the_middle_the_first_is_the_root(rng):
    for points in rng.normal(size=(10, 50, 3, 8)):
        root, *_ = find_tree(points, chain(8))
        assert root.joint == 3


HIPS_AND_TRUNK = np.array([[0.2, 0, 0], [-0.2, 0, 0], [0, 1.0, 0]])
LEG = np.array([[0, 1], [0, 2], [0, 3], [0, 4], [4, 5]])
"""Edges from the root to hips, trunk and knee, and from the knee to the ankle."""

KNEE = 4


def leg(twist, bend):
    """Return a thigh along -y from the root, turned about itself, and a shank bent by
    angles (n,), as landmarks (n, 3, 6).
    """
    n = len(twist)
    turn = rotation_about_axis(1, twist) @ rotation_about_axis(0, bend)
    root = np.zeros((n, 3))
    hips_and_trunk = [np.tile(place, (n, 1)) for place in HIPS_AND_TRUNK]
    knee = np.tile(DOWN, (n, 1))
    ankle = knee + turn @ DOWN
    return np.stack([root, *hips_and_trunk, knee, ankle], axis=2)


def turn_about_thigh(rig):
    """Return the angle (n,) in degrees by which a thigh turns about itself."""
    (thigh,) = [i for i, node in enumerate(rig.tree) if node.aims == (KNEE,)]
    turns = rig.rotations[thigh]
    angle = np.arctan2(turns[:, 0, 2], turns[:, 0, 0])
    return np.degrees(angle)


def test_a_thigh_turns_with_the_knee():
    twist = 30 * np.sin(np.linspace(0, 6, 60))
    bend = np.full(60, 1.0)

    rig = find_rig(leg(np.radians(twist), bend), LEG, root=0)

    found = turn_about_thigh(rig)
    expected = twist - twist[rig.rest]
    assert_allclose(found, expected, atol=0.3 * np.ptp(expected))
    assert np.corrcoef(found, expected)[0, 1] > 0.99


def test_a_joint_that_bends_both_ways_does_not_turn_its_bone():
    bend = np.sin(np.linspace(0, 4 * np.pi, 61))
    rig = find_rig(leg(np.zeros(61), bend), LEG, root=0)
    assert_allclose(turn_about_thigh(rig), 0, atol=1e-9)


def test_at_rest_joints_are_bent_as_the_median_however_far_a_few_frames_go():
    usual = np.full(20, 0.5)
    nearly = np.linspace(0.45, 0.55, 21)
    far = np.full(15, 2.5)
    bend = np.concatenate([usual, nearly, far])

    rig = find_rig(leg(np.zeros(56), bend), LEG, root=0)

    assert bend[rig.rest] == pytest.approx(0.5, abs=0.01)


def test_a_bone_that_points_straight_back_is_still_reached():
    """The shortest turn between opposite directions is any half turn."""
    points = np.zeros((3, 3, 3))
    points[:, :, 1] = [UP, UP, DOWN]
    points[:, :, 2] = 2 * points[:, :, 1]

    rig = find_rig(points, chain(3), root=0)

    assert_allclose(place_nodes(rig), joints_of_nodes(rig, points), atol=1e-9)
    assert_allclose(np.linalg.det(rig.rotations), 1)


def test_without_edges_the_tree_joins_what_keeps_its_distance(moved):
    no_edges = np.empty((0, 2), int)

    tree = find_tree(moved, no_edges)

    bones = {frozenset(bone) for bone in find_bones(tree).items()}
    assert bones == {frozenset(edge) for edge in EDGES.tolist()}

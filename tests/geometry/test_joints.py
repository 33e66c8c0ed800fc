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
from shapefit.geometry.rotations import exponential, rotation_about

UP = np.array([0.0, 1.0, 0.0])
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


def turned(vector, degrees):
    """Turn a vector about z, which points to the right of a body that looks along x."""
    return Rotation.from_euler("z", degrees, degrees=True).apply(vector)


def person(truth=TRUTH):
    """Return the joints of a body, x forward, y up and z to the right, in metres."""
    down, forward = np.array([0, -1.0, 0]), np.array([1.0, 0, 0])
    joints = {"head": np.array([0, 1.45, 0]) + 0.2 * turned(UP, -truth["head_tilt"])}
    for side, z in (("r", 1.0), ("l", -1.0)):
        shoulder, hip = np.array([0, 1.45, 0.2 * z]), np.array([0, 0.95, 0.1 * z])
        arm, leg = truth[f"arm_flex_{side}"], truth[f"hip_flexion_{side}"]
        elbow, knee = shoulder + 0.3 * turned(down, arm), hip + 0.45 * turned(down, leg)
        shank = leg - truth[f"knee_angle_{side}"]
        ankle = knee + 0.4 * turned(down, shank)
        foot = turned(forward, shank + truth[f"ankle_angle_{side}"])
        joints |= {
            f"{side}shoulder": shoulder,
            f"{side}elbow": elbow,
            f"{side}wrist": (
                elbow + 0.25 * turned(down, arm + truth[f"elbow_flex_{side}"])
            ),
            f"{side}hip": hip,
            f"{side}knee": knee,
            f"{side}ankle": ankle,
            f"{side}heel": ankle - 0.05 * foot,
            f"{side}toe": ankle + 0.2 * foot,
        }
    return joints


def measured(joints, up=UP, covariance=None):
    shapes = np.stack([np.atleast_2d(points) for points in joints.values()], axis=-1)
    columns = {name: number for number, name in enumerate(joints)}
    values, sd = measure_angles(shapes, up, columns, covariance)
    names = [angle.name for angle in measurable_angles(columns)]
    return dict(zip(names, values.T, strict=True)), dict(zip(names, sd.T, strict=True))


def test_planted_angles_are_found():
    found, deviations = measured(person())
    assert found.keys() == TRUTH.keys() == {angle.name for angle in JOINT_ANGLES}
    for name, degrees in TRUTH.items():
        assert found[name][0] == pytest.approx(degrees, abs=1e-9), name
        assert np.isnan(deviations[name][0])


def test_angles_do_not_depend_on_frame_and_size(rng):
    turn = Rotation.random(rng=7).as_matrix()
    shift = rng.normal(size=3)
    moved = {name: 3.7 * turn @ point + shift for name, point in person().items()}
    found, _ = measured(moved, turn @ UP)
    for name, degrees in TRUTH.items():
        assert found[name][0] == pytest.approx(degrees, abs=1e-6), name


def test_left_and_right_exchange_in_a_mirror():
    swapped = {
        "rl"["lr".index(n[0])] + n[1:] if n != "head" else n: p
        for n, p in person().items()
    }
    mirrored = {name: point * [1, 1, -1] for name, point in swapped.items()}
    found, _ = measured(mirrored)
    for name, degrees in TRUTH.items():
        other = name[:-1] + "rl"["lr".index(name[-1])] if name[-2] == "_" else name
        assert found[other][0] == pytest.approx(degrees, abs=1e-9), name


def test_a_body_in_part_has_some_angles():
    joints = person()
    del joints["rankle"], joints["head"]
    found, _ = measured(joints)
    assert TRUTH.keys() - found.keys() == {"knee_angle_r", "ankle_angle_r", "head_tilt"}


@pytest.mark.parametrize("independent", [False, True])
def test_deviations_are_those_of_a_simulation(rng, independent):
    """Of 20,000 bodies whose joints err by a centimetre, together or each by itself."""
    joints = person(TRUTH | {"knee_angle_l": 40.0, "head_tilt": 80.0})
    for shoulder in ("rshoulder", "lshoulder"):  # a straight line has no derivative
        joints[shoulder] = joints[shoulder] + [0.1, 0, 0]
    p = len(joints)
    factor = 0.01 * (
        np.eye(3 * p) if independent else rng.normal(size=(3 * p, 3 * p)) / np.sqrt(p)
    )
    whole = factor @ factor.T
    blocks = whole.reshape(p, 3, p, 3)[np.arange(p), :, np.arange(p)]
    _, stated = measured(
        joints, covariance=blocks[None] if independent else whole[None]
    )
    errors = (rng.normal(size=(20_000, 3 * p)) @ factor.T).reshape(-1, p, 3)
    drawn = {name: joints[name] + errors[:, k] for k, name in enumerate(joints)}
    simulated, _ = measured(drawn)
    for name, values in simulated.items():
        assert stated[name][0] == pytest.approx(values.std(), rel=0.05), name


PARENTS = (-1, 0, 1, 2, 0, 4, 5, 0, 7)
"""A trunk from whose foot three limbs leave."""
EDGES = np.array([(parent, j) for j, parent in enumerate(PARENTS) if parent >= 0])


@pytest.fixture
def moved(rng):
    """Joints (f, 3, p) of bones of one length, each turning smoothly against the one
    before.
    """
    phase = np.linspace(0, 2 * np.pi, 80)
    G, places = [], []
    for parent in PARENTS:
        axes, offset = (
            rng.normal(size=(2, 3)),
            rng.uniform(0.5, 1.0) * np.eye(3)[rng.integers(3)],
        )
        L = exponential(
            np.stack([np.sin(phase), np.cos(phase)], axis=1) @ (0.25 * axes)
        )
        P = G[parent] if parent >= 0 else np.tile(np.eye(3), (80, 1, 1))
        G.append(P @ L)
        places.append(G[-1] @ offset + (places[parent] if parent >= 0 else 0))
    return np.stack(places, axis=2)


def joints(rig, points):
    return points[:, :, [node.joint for node in rig.tree]].transpose(2, 0, 1)


def test_rigid_bones_end_at_their_landmarks(moved):
    rig = find_rig(moved, EDGES)
    assert rig.tree[0].joint == 0  # the only landmark where bones branch
    assert_allclose(place_nodes(rig), joints(rig, moved), atol=1e-12)
    assert_allclose(np.linalg.det(rig.rotations), 1)
    at_rest = rig.rotations[:, rig.rest]
    assert_allclose(at_rest, np.broadcast_to(np.eye(3), at_rest.shape), atol=1e-12)


def test_a_body_that_turns_as_a_whole_bends_no_joint(moved):
    turns = exponential(np.linspace([0, 0, 0], [0.5, 1.0, -1.5], 80))
    rotations = find_rig(turns @ moved[:1], EDGES).rotations[1:]
    assert_allclose(rotations - np.eye(3), 0, atol=0.03)


def test_of_loops_the_rigid_bones_are_taken_and_what_is_apart_is_joined(rng):
    points = np.tile(rng.normal(size=(3, 5)), (50, 1, 1))
    points[:, 0, 3] += np.linspace(0, 1, 50)  # what leads to landmark 3 stretches,
    points[:, :, 4] = (
        points[:, :, 3] + 0.1
    )  # and no edge leads to 4, which moves with 3
    tree = find_tree(points, np.array([[0, 1], [1, 2], [2, 0], [2, 3]]), root=0)
    bones = {tuple(sorted(bone)) for bone in find_bones(tree).items()}
    assert bones - {(0, 1), (1, 2), (0, 2)} == {(2, 3), (3, 4)}
    assert len(bones) == 4


def test_of_two_landmarks_in_the_middle_the_first_is_the_root(rng):
    chain = np.array([[j, j + 1] for j in range(7)])
    for points in rng.normal(size=(10, 50, 3, 8)):
        assert find_tree(points, chain)[0].joint == 3


def leg(twist, bend):
    """A thigh along -y from the root, turned about itself, and a shank bent by angles
    (n,).
    """
    shank = rotation_about([0, 1, 0], twist) @ (
        rotation_about([1, 0, 0], bend) @ np.array([0, -1.0, 0])[:, None]
    )
    knee = np.tile([0, -1.0, 0], (len(twist), 1))
    hips = np.tile(
        np.array([[0.2, 0, 0], [-0.2, 0, 0], [0, 1.0, 0]]), (len(twist), 1, 1)
    )
    root = np.zeros((len(twist), 3))
    return np.stack([root, *hips.swapaxes(0, 1), knee, knee + shank[..., 0]], axis=2)


LEG = np.array([[0, 1], [0, 2], [0, 3], [0, 4], [4, 5]])


def turn_about_thigh(points):
    rig = find_rig(points, LEG, root=0)
    (number,) = [i for i, node in enumerate(rig.tree) if node.aims == (4,)]
    turns = rig.rotations[number]
    return np.degrees(np.arctan2(turns[:, 0, 2], turns[:, 0, 0])), rig.rest


def test_a_thigh_turns_with_the_knee():
    twist = np.radians(30) * np.sin(np.linspace(0, 6, 60))
    found, rest = turn_about_thigh(leg(twist, np.full(60, 1.0)))
    expected = np.degrees(twist - twist[rest])
    assert_allclose(found, expected, atol=0.3 * np.ptp(expected))
    assert np.corrcoef(found, expected)[0, 1] > 0.99


def test_a_joint_that_bends_both_ways_does_not_turn_its_bone():
    bend = np.sin(np.linspace(0, 4 * np.pi, 61))
    found, _ = turn_about_thigh(leg(np.zeros(61), bend))
    assert_allclose(found, 0, atol=1e-9)


def test_at_rest_joints_are_bent_as_the_median_however_far_a_few_frames_go():
    bend = np.concatenate(
        [np.full(20, 0.5), np.linspace(0.45, 0.55, 21), np.full(15, 2.5)]
    )
    points = leg(np.zeros(56), bend)
    rig = find_rig(points, LEG, root=0)
    assert bend[rig.rest] == pytest.approx(0.5, abs=0.01)


def test_a_bone_that_points_straight_back_is_still_reached():
    """The shortest turn between opposite directions is any half turn."""
    points = np.zeros((3, 3, 3))
    points[:, :, 1] = [[0, 1, 0], [0, 1, 0], [0, -1, 0]]
    points[:, :, 2] = 2 * points[:, :, 1]
    rig = find_rig(points, np.array([[0, 1], [1, 2]]), root=0)
    assert_allclose(place_nodes(rig), joints(rig, points), atol=1e-9)
    assert_allclose(np.linalg.det(rig.rotations), 1)


def test_without_edges_the_tree_joins_what_keeps_its_distance(moved):
    bones = find_bones(find_tree(moved, np.empty((0, 2), int)))
    found = {frozenset(bone) for bone in bones.items()}
    assert found == {frozenset(edge) for edge in EDGES.tolist()}

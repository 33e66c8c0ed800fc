"""Bones with known turns: what is found carries the pose at rest through all frames."""

import numpy as np
import pytest

from shapefit.geometry.joint_rotations import find_bones, find_rig, find_tree, forward_kinematics
from shapefit.geometry.rotations import exponential, rotation_about

PARENTS = (-1, 0, 1, 2, 0, 4, 5, 0, 7)
"""A trunk from whose foot three limbs leave."""
EDGES = np.array([(parent, j) for j, parent in enumerate(PARENTS) if parent >= 0])


@pytest.fixture
def moved(rng):
    """Joints (f, 3, p) of bones of one length, each turning smoothly against the one before."""
    phase = np.linspace(0, 2 * np.pi, 80)
    G, places = [], []
    for parent in PARENTS:
        axes, offset = rng.normal(size=(2, 3)), rng.uniform(0.5, 1.0) * np.eye(3)[rng.integers(3)]
        L = exponential(np.stack([np.sin(phase), np.cos(phase)], axis=1) @ (0.25 * axes))
        P = G[parent] if parent >= 0 else np.tile(np.eye(3), (80, 1, 1))
        G.append(P @ L)
        places.append(G[-1] @ offset + (places[parent] if parent >= 0 else 0))
    return np.stack(places, axis=2)


def joints(rig, points):
    return points[:, :, [node.joint for node in rig.tree]].transpose(2, 0, 1)


def test_rigid_bones_end_at_their_landmarks(moved):
    rig = find_rig(moved, EDGES)
    assert rig.tree[0].joint == 0  # the only landmark where bones branch
    np.testing.assert_allclose(forward_kinematics(rig), joints(rig, moved), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(rig.rotations), 1)
    at_rest = rig.rotations[:, rig.rest]
    np.testing.assert_allclose(at_rest, np.broadcast_to(np.eye(3), at_rest.shape), atol=1e-12)


def test_of_loops_the_rigid_bones_are_taken_and_what_is_apart_is_joined(rng):
    points = np.tile(rng.normal(size=(3, 5)), (50, 1, 1))
    points[:, 0, 3] += np.linspace(0, 1, 50)  # what leads to landmark 3 stretches,
    points[:, :, 4] = points[:, :, 3] + 0.1  # and no edge leads to 4, which moves with 3
    tree = find_tree(points, np.array([[0, 1], [1, 2], [2, 0], [2, 3]]), root=0)
    bones = {tuple(sorted(bone)) for bone in find_bones(tree).items()}
    assert bones - {(0, 1), (1, 2), (0, 2)} == {(2, 3), (3, 4)}
    assert len(bones) == 4


def leg(twist, bend):
    """A thigh along -y from the root, turned about itself, and a shank bent by angles (n,)."""
    shank = rotation_about([0, 1, 0], twist) @ (
        rotation_about([1, 0, 0], bend) @ np.array([0, -1.0, 0])[:, None]
    )
    knee = np.tile([0, -1.0, 0], (len(twist), 1))
    hips = np.tile(np.array([[0.2, 0, 0], [-0.2, 0, 0], [0, 1.0, 0]]), (len(twist), 1, 1))
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
    np.testing.assert_allclose(found, expected, atol=0.3 * np.ptp(expected))
    assert np.corrcoef(found, expected)[0, 1] > 0.99


def test_a_joint_that_bends_both_ways_does_not_turn_its_bone():
    bend = np.sin(np.linspace(0, 4 * np.pi, 61))
    found, _ = turn_about_thigh(leg(np.zeros(61), bend))
    np.testing.assert_allclose(found, 0, atol=1e-9)


def test_at_rest_joints_are_bent_as_the_median_however_far_a_few_frames_go():
    bend = np.concatenate([np.full(20, 0.5), np.linspace(0.45, 0.55, 21), np.full(15, 2.5)])
    points = leg(np.zeros(56), bend)
    rig = find_rig(points, LEG, root=0)
    assert bend[rig.rest] == pytest.approx(0.5, abs=0.01)


def test_a_bone_that_points_straight_back_is_still_reached():
    """The shortest turn between opposite directions is any half turn."""
    points = np.zeros((3, 3, 3))
    points[:, :, 1] = [[0, 1, 0], [0, 1, 0], [0, -1, 0]]
    points[:, :, 2] = 2 * points[:, :, 1]
    rig = find_rig(points, np.array([[0, 1], [1, 2]]), root=0)
    np.testing.assert_allclose(forward_kinematics(rig), joints(rig, points), atol=1e-9)
    np.testing.assert_allclose(np.linalg.det(rig.rotations), 1)


def test_without_edges_the_tree_joins_what_keeps_its_distance(moved):
    bones = find_bones(find_tree(moved, np.empty((0, 2), int)))
    found = {frozenset(bone) for bone in bones.items()}
    assert found == {frozenset(edge) for edge in EDGES.tolist()}

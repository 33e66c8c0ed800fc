"""Skeletons of detectors: their order, their pairs, and the joints that they share with
people.
"""

import h5py
import pytest

from shapefit.io.skeletons import (
    FURTHER,
    PEOPLE,
    THETA,
    Skeleton,
    body_parts,
    installed_skeletons,
    part_names,
    people_joints,
    skeletons_of_size,
)
from tests.io.files import mirror_pairs

JOINTS = (*PEOPLE, *FURTHER)
SKELETONS = installed_skeletons()
PARTS = body_parts()
UNPAIRED = {"nose", "neck", "head", "midhip", "hip", "spine", "thorax"}
MEAN = {name: parameter.mean for name, parameter in THETA.items()}


@pytest.fixture(params=SKELETONS.values(), ids=list(SKELETONS))
def skeleton(request) -> Skeleton:
    return request.param


def test_landmarks_are_in_pairs_and_joined_by_bones(skeleton: Skeleton) -> None:
    names, pairs = skeleton.landmark_names, mirror_pairs(skeleton)
    assert len(set(names)) == len(names)
    paired = [i for pair in pairs for i in pair]
    assert len(set(paired)) == len(paired)
    unpaired = {name.lower() for i, name in enumerate(names) if i not in paired}
    assert {name for name in unpaired if not name.startswith("face_")} <= UNPAIRED
    bones = {frozenset(map(names.index, bone)) for bone in skeleton.bones}
    assert len(bones) == len(skeleton.bones)
    assert {i for bone in bones for i in bone} == set(range(len(names)))
    swap = dict(pairs) | {left: right for right, left in pairs}
    assert {frozenset(swap.get(i, i) for i in bone) for bone in bones} == bones


def test_joints_and_parts_mirror_as_the_landmarks_do(skeleton: Skeleton) -> None:
    joints = people_joints(skeleton.landmark_names)
    assert set(joints.values()) <= set(JOINTS)
    assert len(set(joints.values())) == len(joints) >= 12
    swap = {
        f"{a}{name[1:]}": f"{b}{name[1:]}" for name in JOINTS for a, b in ("rl", "lr")
    }
    for pair in mirror_pairs(skeleton):
        right, left = (skeleton.landmark_names[i] for i in pair)
        assert swap.get(joints.get(right)) == joints.get(left)
        parts = [
            part_names(skeleton.landmark_names).get(name) for name in (right, left)
        ]
        if None in parts:
            assert parts == [None, None]
            continue
        one, other = (PARTS[part].weights(MEAN) for part in parts)
        mirrored = {
            swap[name] if swap.get(name) in JOINTS else name: value
            for name, value in one.items()
        }
        assert other == pytest.approx(mirrored)


def test_the_usual_skeleton_of_a_size_is_first() -> None:
    assert skeletons_of_size(17) == ("coco_17", "h36m_17")
    assert skeletons_of_size(25) == ("body_25", "body_25b")
    assert skeletons_of_size(15) == ()


def test_no_name_stands_for_two_joints() -> None:
    meanings: dict[str, set[str]] = {}
    for skeleton in SKELETONS.values():
        for name, joint in people_joints(skeleton.landmark_names).items():
            meanings.setdefault(name, set()).add(joint)
    assert all(len(joints) == 1 for joints in meanings.values())


@pytest.mark.parametrize("factor", [0.5, 1.0, 2.0])
def test_weights_of_parts_add_up_to_one_whatever_theta(factor) -> None:
    for part in PARTS.values():
        weights = part.weights({name: factor * mean for name, mean in MEAN.items()})
        assert sum(weights.values()) == pytest.approx(1)
        assert set(weights) <= set(JOINTS)


@pytest.mark.real_data
def test_skeletons_have_the_order_of_detected_files(real_data) -> None:
    for name, path in (
        ("body_25b", "pose2sim_balancing/cam01.h5"),
        ("mediapipe_33", "pyxy3d_desk/port_1.h5"),
    ):
        with h5py.File(real_data / "detected" / path) as file:
            names = tuple(file["landmark_names"].asstr()[:])
        assert SKELETONS[name].landmark_names[: len(names)] == names
        assert len(names) == 25

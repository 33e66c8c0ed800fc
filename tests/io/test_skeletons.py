"""Skeletons of detectors: their order, their pairs, and the joints that they share with people."""

import pytest

from shapefit.io.skeletons import (
    FURTHER,
    PARTS,
    PEOPLE,
    SKELETONS,
    THETA,
    Skeleton,
    people_joints,
)

JOINTS = (*PEOPLE, *FURTHER)
EVERY_SKELETON = pytest.mark.parametrize("skeleton", SKELETONS.values(), ids=list(SKELETONS))


@EVERY_SKELETON
def test_pairs_are_right_then_left_and_disjoint(skeleton: Skeleton) -> None:
    names = skeleton.landmark_names
    assert len(set(names)) == len(names)
    for right, left in skeleton.mirror:
        assert names[right].replace("right", "left") == names[left] or (
            names[right][0] == "R" and f"L{names[right][1:]}" == names[left]
        )
    paired = [i for pair in skeleton.mirror for i in pair]
    assert len(set(paired)) == len(paired)
    unpaired = {name.lower() for i, name in enumerate(names) if i not in paired}
    assert unpaired <= {"nose", "neck", "head", "midhip", "hip", "spine", "thorax"}


@EVERY_SKELETON
def test_edges_are_unique_and_connect_what_they_name(skeleton: Skeleton) -> None:
    bones = {frozenset(edge) for edge in skeleton.edges}
    assert len(bones) == len(skeleton.edges)
    joined = {i for edge in skeleton.edges for i in edge}
    assert joined == set(range(len(skeleton.landmark_names)))
    swap = dict(skeleton.mirror) | {left: right for right, left in skeleton.mirror}
    assert {frozenset(swap.get(i, i) for i in bone) for bone in bones} == bones


@EVERY_SKELETON
def test_joints_of_people_mirror_as_the_landmarks_do(skeleton: Skeleton) -> None:
    assert set(skeleton.people) <= set(skeleton.landmark_names)
    assert set(skeleton.people.values()) <= set(JOINTS)
    assert len(set(skeleton.people.values())) == len(skeleton.people) >= 12
    for right, left in skeleton.mirror:
        joints = [skeleton.people.get(skeleton.landmark_names[i]) for i in (right, left)]
        assert joints == [None, None] or (joints[0][0], joints[0][1:]) == ("r", joints[1][1:])


def test_sizes_are_those_of_the_names() -> None:
    assert {name: len(skeleton.landmark_names) for name, skeleton in SKELETONS.items()} == {
        name: int("".join(letter for letter in name.split("_")[-1] if letter.isdigit()))
        for name in SKELETONS
    }


def test_no_name_stands_for_two_joints() -> None:
    meanings: dict[str, set[str]] = {}
    for skeleton in SKELETONS.values():
        for name, joint in skeleton.people.items():
            meanings.setdefault(name, set()).add(joint)
    assert all(len(joints) == 1 for joints in meanings.values())
    assert people_joints(["LHip", "left_hip", "Nose", "tail"]) == {
        "LHip": "lhip",
        "left_hip": "lhip",
    }


@pytest.mark.parametrize("part", PARTS.values(), ids=list(PARTS))
def test_weights_of_a_part_add_up_to_one_whatever_theta(part) -> None:
    for factor in (0.5, 1.0, 2.0):
        theta = {name: factor * parameter.mean for name, parameter in THETA.items()}
        assert sum(part.weights(theta).values()) == pytest.approx(1)
    assert set(part.weights(dict.fromkeys(THETA, 1.0))) <= set(JOINTS)


@EVERY_SKELETON
def test_parts_mirror_as_the_landmarks_do(skeleton: Skeleton) -> None:
    def mirrored(weights):
        swap = {"r": "l", "l": "r"}
        paired = {f"r{name[1:]}" for name in JOINTS if f"l{name[1:]}" in JOINTS}
        twins = paired | {f"l{name[1:]}" for name in paired}
        return {
            (swap[name[0]] + name[1:] if name in twins else name): pytest.approx(weight)
            for name, weight in weights.items()
        }

    theta = {name: parameter.mean for name, parameter in THETA.items()}
    for pair in skeleton.mirror:
        parts = [skeleton.parts.get(skeleton.landmark_names[i]) for i in pair]
        if None in parts:
            assert parts == [None, None]
            continue
        right, left = (PARTS[part].weights(theta) for part in parts)
        assert left == mirrored(right)


@pytest.mark.real_data
def test_presets_have_the_order_of_detected_files(real_data) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(real_data / "detected/pose2sim_balancing/cam01.h5") as file:
        names = tuple(file["landmark_names"].asstr()[:])
    assert SKELETONS["body_25b"].landmark_names == names
    with h5py.File(real_data / "detected/pyxy3d_desk/port_1.h5") as file:
        names = tuple(file["landmark_names"].asstr()[:])
    assert SKELETONS["mediapipe_33"].landmark_names[:25] == names

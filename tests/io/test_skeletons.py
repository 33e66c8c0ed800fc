"""Skeletons of detectors: their order, their pairs, and the joints that they share with people."""

import h5py
import pytest

from shapefit.io.skeletons import (
    FURTHER,
    PEOPLE,
    THETA,
    Skeleton,
    installed_skeletons,
    part_names,
    parts_of_the_body,
    people_joints,
    skeletons_of_size,
)
from tests.io.files import mirror_pairs

JOINTS = (*PEOPLE, *FURTHER)
SKELETONS, PARTS = installed_skeletons(), parts_of_the_body()
UNPAIRED = {"nose", "neck", "head", "midhip", "hip", "spine", "thorax"}


@pytest.fixture(params=SKELETONS.values(), ids=list(SKELETONS))
def skeleton(request) -> Skeleton:
    return request.param


def test_pairs_are_right_then_left_and_disjoint(skeleton: Skeleton) -> None:
    names = skeleton.landmark_names
    assert len(set(names)) == len(names)
    for right, left in mirror_pairs(skeleton):
        assert names[right].replace("right", "left") == names[left] or (
            names[right][0] == "R" and f"L{names[right][1:]}" == names[left]
        )
    paired = [i for pair in mirror_pairs(skeleton) for i in pair]
    assert len(set(paired)) == len(paired)
    unpaired = {name.lower() for i, name in enumerate(names) if i not in paired}
    assert {name for name in unpaired if not name.startswith("face_")} <= UNPAIRED


def test_edges_are_unique_and_connect_what_they_name(skeleton: Skeleton) -> None:
    bones = {frozenset(edge) for edge in skeleton.edges}
    assert len(bones) == len(skeleton.edges)
    joined = {i for edge in skeleton.edges for i in edge}
    assert joined == set(range(len(skeleton.landmark_names)))
    swap = dict(mirror_pairs(skeleton)) | {left: right for right, left in mirror_pairs(skeleton)}
    assert {frozenset(swap.get(i, i) for i in bone) for bone in bones} == bones


def test_joints_and_parts_mirror_as_the_landmarks_do(skeleton: Skeleton) -> None:
    joints = people_joints(skeleton.landmark_names)
    assert set(joints.values()) <= set(JOINTS)
    assert len(set(joints.values())) == len(joints) >= 12
    theta = {name: parameter.mean for name, parameter in THETA.items()}
    swap = {f"{a}{name[1:]}": f"{b}{name[1:]}" for name in JOINTS for a, b in ("rl", "lr")}
    for pair in mirror_pairs(skeleton):
        right, left = (skeleton.landmark_names[i] for i in pair)
        assert swap.get(joints.get(right)) == joints.get(left)
        parts = [part_names(skeleton.landmark_names).get(name) for name in (right, left)]
        if None in parts:
            assert parts == [None, None]
            continue
        weights = [PARTS[part].weights(theta) for part in parts]
        mirrored = {
            swap[name] if swap.get(name) in JOINTS else name: value
            for name, value in weights[0].items()
        }
        assert weights[1] == pytest.approx(mirrored)


@pytest.mark.parametrize(
    ("count", "names"),
    [
        (17, ("coco_17", "h36m_17")),
        (25, ("body_25", "body_25b")),
        (26, ("halpe_26",)),
        (33, ("mediapipe_33",)),
        (133, ("coco_133",)),
        (15, ()),
    ],
)
def test_the_usual_skeleton_of_a_size_is_first(count: int, names: tuple[str, ...]) -> None:
    assert skeletons_of_size(count) == names


def test_no_name_stands_for_two_joints() -> None:
    meanings: dict[str, set[str]] = {}
    for skeleton in SKELETONS.values():
        for name, joint in people_joints(skeleton.landmark_names).items():
            meanings.setdefault(name, set()).add(joint)
    assert all(len(joints) == 1 for joints in meanings.values())
    joints = {"LHip": "lhip", "left_hip": "lhip"}
    assert people_joints(["LHip", "left_hip", "Nose", "tail"]) == joints


@pytest.mark.parametrize("part", PARTS.values(), ids=list(PARTS))
def test_weights_of_a_part_add_up_to_one_whatever_theta(part) -> None:
    for factor in (0.5, 1.0, 2.0):
        theta = {name: factor * parameter.mean for name, parameter in THETA.items()}
        assert sum(part.weights(theta).values()) == pytest.approx(1)
    assert set(part.weights(dict.fromkeys(THETA, 1.0))) <= set(JOINTS)


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

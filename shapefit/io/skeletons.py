"""The landmarks of the usual detectors of people, and which joints of the dictionary they are.

A file without names says only how many landmarks it has; `keypoints: NAME` names them by one of
these skeletons.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import pairwise
from types import MappingProxyType

PEOPLE = (
    "pelvis",
    "rhip",
    "rknee",
    "rankle",
    "lhip",
    "lknee",
    "lankle",
    "neck",
    "head",
    "rshoulder",
    "relbow",
    "rwrist",
    "lshoulder",
    "lelbow",
    "lwrist",
)
"""The joints of the dictionary `people`."""

ELSEWHERE = 0.3
"""Factor of the confidence of a landmark some 60 to 100 mm away from its joint (docs/people.md)."""

_LIMBS = [joint for joint in PEOPLE if joint not in ("pelvis", "neck", "head")]


@dataclass(frozen=True)
class Skeleton:
    """The landmarks of one detector, in the order of its files."""

    name: str
    landmark_names: tuple[str, ...]
    edges: tuple[tuple[int, int], ...]
    """Pairs of landmarks that a bone or a line of the face joins."""
    mirror: tuple[tuple[int, int], ...]
    """Right and left landmarks that a reflection of the body exchanges, each pair once."""
    people: Mapping[str, str]
    """The joint of the dictionary `people` that a landmark is; those without one are not in it."""
    weights: Mapping[str, float]
    """Factors of the confidence of landmarks whose place differs from that of their joint."""


def _skeleton(name: str, landmarks: str, lines: str, people: Mapping[str, str]) -> Skeleton:
    """Return a skeleton from its landmarks and from lines such as `a-b-c`, separated by spaces."""
    names = tuple(landmarks.split())
    number = {landmark: i for i, landmark in enumerate(names)}
    chains = [[number[landmark] for landmark in line.split("-")] for line in lines.split()]
    edges = tuple(pair for chain in chains for pair in pairwise(chain))
    pairs = ((number.get(_left_of(landmark)), i) for i, landmark in enumerate(names))
    mirror = tuple((right, left) for left, right in pairs if left is not None)
    weights = {landmark: ELSEWHERE for landmark in people if landmark in ("Head", "Thorax")}
    return Skeleton(
        name, names, edges, mirror, MappingProxyType(dict(people)), MappingProxyType(weights)
    )


def _left_of(landmark: str) -> str:
    """Return the name of the left landmark that mirrors a right one, or one that does not exist."""
    if landmark[:1] == "R" and landmark[1:2].isupper():
        return f"L{landmark[1:]}"
    words = landmark.split("_")
    return (
        "_".join("left" if word == "right" else word for word in words) if "right" in words else ""
    )


def _initials(joints: Iterable[str]) -> dict[str, str]:
    """Return joints by names such as `RHip`."""
    return {f"{joint[0].upper()}{joint[1:].capitalize()}": joint for joint in joints}


def _words(joints: Iterable[str]) -> dict[str, str]:
    """Return joints by names such as `right_hip`."""
    sides = {"r": "right", "l": "left"}
    return {f"{sides[joint[0]]}_{joint[1:]}": joint for joint in joints}


# The dictionary's `pelvis` lies some 105 mm above the middle of the hips and its `neck` some 60 mm
# below the middle of the shoulders, so that no detector's root and only the thorax of Human3.6M,
# from which its shoulders hang too, is one of them. Its `head` is the end of a bone within the
# head; detectors with a `Head` mark the top.
_PRESETS = (
    _skeleton(
        "coco_17",
        "nose left_eye right_eye left_ear right_ear left_shoulder right_shoulder left_elbow "
        "right_elbow left_wrist right_wrist left_hip right_hip left_knee right_knee left_ankle "
        "right_ankle",
        "nose-left_eye-left_ear nose-right_eye-right_ear left_eye-right_eye "
        "left_ear-left_shoulder right_ear-right_shoulder "
        "left_shoulder-right_shoulder-right_hip-left_hip-left_shoulder "
        "left_shoulder-left_elbow-left_wrist right_shoulder-right_elbow-right_wrist "
        "left_hip-left_knee-left_ankle right_hip-right_knee-right_ankle",
        _words(_LIMBS),
    ),
    _skeleton(
        "body_25",
        "Nose Neck RShoulder RElbow RWrist LShoulder LElbow LWrist MidHip RHip RKnee RAnkle LHip "
        "LKnee LAnkle REye LEye REar LEar LBigToe LSmallToe LHeel RBigToe RSmallToe RHeel",
        "Neck-MidHip Neck-RShoulder-RElbow-RWrist Neck-LShoulder-LElbow-LWrist "
        "MidHip-RHip-RKnee-RAnkle MidHip-LHip-LKnee-LAnkle "
        "Neck-Nose-REye-REar Nose-LEye-LEar "
        "LAnkle-LBigToe-LSmallToe LAnkle-LHeel RAnkle-RBigToe-RSmallToe RAnkle-RHeel",
        _initials(_LIMBS),
    ),
    _skeleton(
        "body_25b",
        "Nose LEye REye LEar REar LShoulder RShoulder LElbow RElbow LWrist RWrist LHip RHip LKnee "
        "RKnee LAnkle RAnkle Neck Head LBigToe LSmallToe LHeel RBigToe RSmallToe RHeel",
        "Neck-Head Neck-Nose Nose-LEye-LEar Nose-REye-REar "
        "Neck-LShoulder-LElbow-LWrist Neck-RShoulder-RElbow-RWrist "
        "LShoulder-LHip-RHip-RShoulder LHip-LKnee-LAnkle RHip-RKnee-RAnkle "
        "LAnkle-LBigToe-LSmallToe LAnkle-LHeel RAnkle-RBigToe-RSmallToe RAnkle-RHeel",
        _initials(_LIMBS) | {"Head": "head"},
    ),
    _skeleton(
        "halpe_26",
        "Nose LEye REye LEar REar LShoulder RShoulder LElbow RElbow LWrist RWrist LHip RHip LKnee "
        "RKnee LAnkle RAnkle Head Neck Hip LBigToe RBigToe LSmallToe RSmallToe LHeel RHeel",
        "Head-Neck-Hip Neck-Nose Nose-LEye-LEar Nose-REye-REar "
        "Neck-LShoulder-LElbow-LWrist Neck-RShoulder-RElbow-RWrist "
        "Hip-LHip-LKnee-LAnkle Hip-RHip-RKnee-RAnkle "
        "LAnkle-LBigToe-LSmallToe LAnkle-LHeel RAnkle-RBigToe-RSmallToe RAnkle-RHeel",
        _initials(_LIMBS) | {"Head": "head"},
    ),
    _skeleton(
        "h36m_17",
        "Hip RHip RKnee RFoot LHip LKnee LFoot Spine Thorax Neck Head LShoulder LElbow LWrist "
        "RShoulder RElbow RWrist",
        "Hip-RHip-RKnee-RFoot Hip-LHip-LKnee-LFoot Hip-Spine-Thorax-Neck-Head "
        "Thorax-LShoulder-LElbow-LWrist Thorax-RShoulder-RElbow-RWrist",
        _initials(joint for joint in _LIMBS if not joint.endswith("ankle"))
        | {"RFoot": "rankle", "LFoot": "lankle", "Thorax": "neck", "Head": "head"},
    ),
    _skeleton(
        "mediapipe_33",
        "nose left_eye_inner left_eye left_eye_outer right_eye_inner right_eye right_eye_outer "
        "left_ear right_ear mouth_left mouth_right left_shoulder right_shoulder left_elbow "
        "right_elbow left_wrist right_wrist left_pinky right_pinky left_index right_index "
        "left_thumb right_thumb left_hip right_hip left_knee right_knee left_ankle right_ankle "
        "left_heel right_heel left_foot_index right_foot_index",
        "nose-left_eye_inner-left_eye-left_eye_outer-left_ear "
        "nose-right_eye_inner-right_eye-right_eye_outer-right_ear mouth_left-mouth_right "
        "left_shoulder-right_shoulder-right_hip-left_hip-left_shoulder "
        "left_shoulder-left_elbow-left_wrist-left_pinky-left_index-left_wrist-left_thumb "
        "right_shoulder-right_elbow-right_wrist-right_pinky-right_index-right_wrist-right_thumb "
        "left_hip-left_knee-left_ankle-left_heel-left_foot_index-left_ankle "
        "right_hip-right_knee-right_ankle-right_heel-right_foot_index-right_ankle",
        _words(_LIMBS),
    ),
)

SKELETONS: Mapping[str, Skeleton] = MappingProxyType({preset.name: preset for preset in _PRESETS})


def people_joints(names: Iterable[str]) -> dict[str, str]:
    """Return the joints of the dictionary `people` by those of the names that have one.

    All presets together: no name stands for two joints.
    """
    known = {name: joint for preset in _PRESETS for name, joint in preset.people.items()}
    return {name: known[name] for name in names if name in known}


def people_weights(names: Iterable[str]) -> dict[str, float]:
    """Return the factors of the confidence of those of the names that have one, as above."""
    known = {name: weight for preset in _PRESETS for name, weight in preset.weights.items()}
    return {name: known[name] for name in names if name in known}

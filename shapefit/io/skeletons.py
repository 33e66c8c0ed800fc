"""The landmarks of the usual detectors of people, and where they lie among the joints of `people`.

    w = (fixed + sum_k theta_k along_k) x + e,    e of standard deviation `apart`

for the joints x of the dictionary: each landmark is a row of weights, which move with a few
parameters theta. A file without names says only how many landmarks it has; `keypoints: NAME` names
them by one of these skeletons.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from types import MappingProxyType
from typing import NamedTuple

_JOINTS = (
    "pelvis rhip rknee rankle lhip lknee lankle neck head rshoulder relbow rwrist lshoulder lelbow "
    "lwrist"
)
PEOPLE = tuple(_JOINTS.split())
"""The joints of the dictionary `people`."""

FURTHER = ("rheel", "rball", "rtoe", "lheel", "lball", "ltoe", "rhand", "lhand", "spine")
"""Those that it has besides where files mark them."""

PEOPLE_BONES = (
    "pelvis-rhip-rknee-rankle pelvis-lhip-lknee-lankle pelvis-neck-head "
    "neck-rshoulder-relbow-rwrist neck-lshoulder-lelbow-lwrist "
    "rankle-rheel rankle-rball-rtoe lankle-lheel lankle-lball-ltoe rwrist-rhand lwrist-lhand "
    "pelvis-spine-neck"
)
_LIMBS = [joint for joint in PEOPLE if joint not in ("pelvis", "neck", "head")]


Weights = Mapping[str, float]
"""Of joints, by their names."""


class Parameter(NamedTuple):
    """A number in which skeletons and bodies differ: its mean, and the spread of its logarithm."""

    mean: float
    spread: float
    what: str


THETA: Mapping[str, Parameter] = MappingProxyType(
    {
        "head": Parameter(
            1.5, 0.15, "height of the top of the head above the shoulders, in that of the joint"
        ),
        "hips": Parameter(1.15, 0.15, "distance of the hips, in that of the joints"),
    }
)
"""What theta holds. Head and hips were chosen on a man on a beam seen by OpenPose (docs/people.md),
whose evidence finds 1.35 to 1.65 and 1.15 in each of four cameras, and their spread covers what
six other bodies asked for."""


@dataclass(frozen=True)
class Part:
    """A part of the body among the joints: w = (fixed + sum_k theta_k along_k) x + e.

    joint     that it stands for in a fit, if any
    fixed     weights, which add up to 1
    along     weights by parameter, which add up to 0
    apart     standard deviation of e, in the unit of normalised shapes
    alone     whether it stands for the joint alone, or the mean of all such parts does
    """

    joint: str | None
    fixed: Weights
    along: Mapping[str, Weights] = field(default_factory=dict)
    apart: float = 0.0
    alone: bool = True

    def weights(self, theta: Mapping[str, float]) -> dict[str, float]:
        """Return the weights of the joints at a theta."""
        found = dict(self.fixed)
        for name, along in self.along.items():
            for joint, weight in along.items():
                found[joint] = found.get(joint, 0.0) + theta[name] * weight
        return found


def _beside(joint: str, parameter: str) -> Part:
    """Return the part that lies on the line through a joint and its pair, about their middle."""
    pair = f"{'l' if joint[0] == 'r' else 'r'}{joint[1:]}"
    return Part(joint, {joint: 0.5, pair: 0.5}, {parameter: {joint: 0.5, pair: -0.5}})


def _on_head(
    height: float, aside: float = 0.0, joint: str | None = None, alone: bool = False
) -> Part:
    """Return a part of the head at a share of its height above the shoulders, and to its left."""
    fixed = {"lshoulder": 0.5 + aside, "rshoulder": 0.5 - aside}
    along = {"head": height, "lshoulder": -height / 2, "rshoulder": -height / 2}
    return Part(joint, fixed, {"head": along}, 0.03 if alone else 0.06, alone)


def _at(joint: str, apart: float) -> Part:
    """Return the part that lies at a joint, more or less; knuckles do together."""
    return Part(joint, {joint: 1.0}, apart=apart, alone=not joint.endswith("hand"))


_ENDS = (
    *(("heel", "heel", 0.06), ("big toe", "toe", 0.06), ("small toe", "ball", 0.12)),
    ("knuckle", "hand", 0.1),
)

# Of the height of a person shoulders are at 0.818, eyes at 0.936, the top of the head at 1, and
# shoulders 0.259 apart (R. Drillis and R. Contini, Body segment parameters, 1966); ears stand a
# third of that apart, a little below the eyes, and the nose below them.
PARTS: Mapping[str, Part] = MappingProxyType(
    {joint: Part(joint, {joint: 1.0}) for joint in (*PEOPLE, *FURTHER)}
    | {hip: _beside(hip, "hips") for hip in ("rhip", "lhip")}
    | {
        "crown": _on_head(1.0, joint="head", alone=True),
        "lear": _on_head(0.61, 0.16, joint="head"),
        "rear": _on_head(0.61, -0.16, joint="head"),
        "leye": _on_head(0.65, 0.07),
        "reye": _on_head(0.65, -0.07),
        "nose": _on_head(0.52),
        "throat": Part(None, {"lshoulder": 0.5, "rshoulder": 0.5}, apart=0.03),
        "middle of hips": Part(None, {"lhip": 0.5, "rhip": 0.5}),
        "middle of spine": Part("spine", {"spine": 1.0}, apart=0.1),
        "thorax": Part("neck", {"neck": 1.0}, apart=0.1),
    }
    | {f"{s}{part}": _at(f"{s}{joint}", apart) for s in "rl" for part, joint, apart in _ENDS}
    | {f"{s}thumb": Part(None, {f"{s}wrist": 0.3, f"{s}hand": 0.7}, apart=0.15) for s in "rl"}
)
"""The parts of the body that detectors mark."""


@dataclass(frozen=True)
class Skeleton:
    """The landmarks of one detector, in the order of its files."""

    name: str
    landmark_names: tuple[str, ...]
    edges: tuple[tuple[int, int], ...]
    """Pairs of landmarks that a bone or a line of the face joins."""
    mirror: tuple[tuple[int, int], ...]
    """Right and left landmarks that a reflection of the body exchanges, each pair once."""
    parts: Mapping[str, str]
    """The part of the body that a landmark marks, see `PARTS`; those of the face lack some."""

    @property
    def people(self) -> dict[str, str]:
        """The joint that each landmark stands for alone."""
        return _alone(self.parts)


def _alone(parts: Mapping[str, str]) -> dict[str, str]:
    """Return the joints of those parts, by landmark, that stand for one alone."""
    known = {name: PARTS[part] for name, part in parts.items()}
    return {name: part.joint for name, part in known.items() if part.joint and part.alone}


def _skeleton(name: str, landmarks: str, lines: str, parts: Mapping[str, str]) -> Skeleton:
    """Return a skeleton from its landmarks and from lines such as `a-b-c`, separated by spaces."""
    names = tuple(landmarks.split())
    number = {landmark: i for i, landmark in enumerate(names)}
    chains = [[number[landmark] for landmark in line.split("-")] for line in lines.split()]
    edges = tuple(pair for chain in chains for pair in pairwise(chain))
    pairs = ((number.get(_left_of(landmark)), i) for i, landmark in enumerate(names))
    mirror = tuple((right, left) for left, right in pairs if left is not None)
    return Skeleton(name, names, edges, mirror, MappingProxyType(dict(parts)))


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


_FEET = {
    f"{side}{mark}": f"{side.lower()}{part}"
    for side in "RL"
    for mark, part in (("BigToe", "big toe"), ("SmallToe", "small toe"), ("Heel", "heel"))
}
_FEET_AND_HANDS = {
    f"{side}_{mark}": side[0] + part
    for side in ("left", "right")
    for mark, part in (
        *(("foot_index", "big toe"), ("heel", "heel"), ("thumb", "thumb")),
        *(("index", "knuckle"), ("pinky", "knuckle")),
    )
}
_FACE = {"Nose": "nose", "LEye": "leye", "REye": "reye", "LEar": "lear", "REar": "rear"}
_SMALL_FACE = {
    "nose": "nose",
    **{f"{side}_{part}": side[0] + part for side in ("left", "right") for part in ("eye", "ear")},
}

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
        _words(_LIMBS) | _SMALL_FACE,
    ),
    _skeleton(
        "body_25",
        "Nose Neck RShoulder RElbow RWrist LShoulder LElbow LWrist MidHip RHip RKnee RAnkle LHip "
        "LKnee LAnkle REye LEye REar LEar LBigToe LSmallToe LHeel RBigToe RSmallToe RHeel",
        "Neck-MidHip Neck-RShoulder-RElbow-RWrist Neck-LShoulder-LElbow-LWrist "
        "MidHip-RHip-RKnee-RAnkle MidHip-LHip-LKnee-LAnkle "
        "Neck-Nose-REye-REar Nose-LEye-LEar "
        "LAnkle-LBigToe-LSmallToe LAnkle-LHeel RAnkle-RBigToe-RSmallToe RAnkle-RHeel",
        _initials(_LIMBS) | _FACE | _FEET | {"Neck": "throat", "MidHip": "middle of hips"},
    ),
    _skeleton(
        "body_25b",
        "Nose LEye REye LEar REar LShoulder RShoulder LElbow RElbow LWrist RWrist LHip RHip LKnee "
        "RKnee LAnkle RAnkle Neck Head LBigToe LSmallToe LHeel RBigToe RSmallToe RHeel",
        "Neck-Head Neck-Nose Nose-LEye-LEar Nose-REye-REar "
        "Neck-LShoulder-LElbow-LWrist Neck-RShoulder-RElbow-RWrist "
        "LShoulder-LHip-RHip-RShoulder LHip-LKnee-LAnkle RHip-RKnee-RAnkle "
        "LAnkle-LBigToe-LSmallToe LAnkle-LHeel RAnkle-RBigToe-RSmallToe RAnkle-RHeel",
        _initials(_LIMBS) | _FACE | _FEET | {"Neck": "throat", "Head": "crown"},
    ),
    _skeleton(
        "halpe_26",
        "Nose LEye REye LEar REar LShoulder RShoulder LElbow RElbow LWrist RWrist LHip RHip LKnee "
        "RKnee LAnkle RAnkle Head Neck Hip LBigToe RBigToe LSmallToe RSmallToe LHeel RHeel",
        "Head-Neck-Hip Neck-Nose Nose-LEye-LEar Nose-REye-REar "
        "Neck-LShoulder-LElbow-LWrist Neck-RShoulder-RElbow-RWrist "
        "Hip-LHip-LKnee-LAnkle Hip-RHip-RKnee-RAnkle "
        "LAnkle-LBigToe-LSmallToe LAnkle-LHeel RAnkle-RBigToe-RSmallToe RAnkle-RHeel",
        _initials(_LIMBS)
        | _FACE
        | _FEET
        | {"Neck": "throat", "Head": "crown", "Hip": "middle of hips"},
    ),
    _skeleton(
        "h36m_17",
        "Hip RHip RKnee RFoot LHip LKnee LFoot Spine Thorax Neck Head LShoulder LElbow LWrist "
        "RShoulder RElbow RWrist",
        "Hip-RHip-RKnee-RFoot Hip-LHip-LKnee-LFoot Hip-Spine-Thorax-Neck-Head "
        "Thorax-LShoulder-LElbow-LWrist Thorax-RShoulder-RElbow-RWrist",
        _initials(joint for joint in _LIMBS if not joint.endswith("ankle"))
        | {"RFoot": "rankle", "LFoot": "lankle", "Thorax": "thorax", "Head": "crown"}
        | {"Hip": "middle of hips", "Spine": "middle of spine"},
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
        _words(_LIMBS) | _SMALL_FACE | _FEET_AND_HANDS,
    ),
)

SKELETONS: Mapping[str, Skeleton] = MappingProxyType({preset.name: preset for preset in _PRESETS})


_MARKED = {name: part for preset in _PRESETS for name, part in preset.parts.items()}
"""The part of the body, a name in `PARTS`, that a landmark of any preset marks."""


def people_joints(names: Iterable[str]) -> dict[str, str]:
    """Return the joints of the dictionary `people` by those of the names that have one.

    All presets together: no name stands for two joints.
    """
    return _alone({name: _MARKED[name] for name in names if name in _MARKED})


def joint_columns(names: Sequence[str]) -> dict[str, int]:
    """Return the joints of a body that landmarks stand for, by any skeleton -> their columns."""
    joints = {name: name for name in names if name in (*PEOPLE, *FURTHER)} | people_joints(names)
    return {joints[name]: column for column, name in enumerate(names) if name in joints}


def people_parts(names: Iterable[str]) -> dict[str, Part]:
    """Return the parts of the body that those of the names mark which mark one."""
    return {name: PARTS[_MARKED[name]] for name in names if name in _MARKED}


def part_names(names: Iterable[str]) -> dict[str, str]:
    """Return the part of the body, a name in `PARTS`, of those of the names that mark one."""
    known = _MARKED | {joint: joint for joint in (*PEOPLE, *FURTHER)}
    return {name: known[name] for name in names if name in known}


ANIMAL_BONES = (
    "SpineF-HeadB SpineF-HeadF SpineF-HeadL SpineF-ShoulderL-ElbowL-ArmL "
    "SpineF-ShoulderR-ElbowR-ArmR SpineF-SpineM-SpineL SpineL-HipL-KneeL-ShinL "
    "SpineL-HipR-KneeR-ShinR",
    "L_Eye-Nose R_Eye-Nose L_Eye-R_Eye Nose-Neck-Root_of_tail Neck-L_Shoulder-L_Elbow-L_F_Paw "
    "Neck-R_Shoulder-R_Elbow-R_F_Paw Root_of_tail-L_Hip-L_Knee-L_B_Paw "
    "Root_of_tail-R_Hip-R_Knee-R_B_Paw",
)
"""Bones of the markers of Rat 7M, and of the landmarks of AP-10K."""


def model_names(names: Sequence[str]) -> tuple[str, ...]:
    """Return landmarks by the names that markers have in the OpenSim models of Pose2Sim.

    These know the detectors' own, but for the middle of the hips of `body_25` and for `coco_17`.
    """
    known = {"MidHip": "CHip"}
    if set(names) <= set(SKELETONS["coco_17"].landmark_names):
        for name in names:
            side, _, part = name.rpartition("_")
            known[name] = f"{side[:1].upper()}{part.capitalize()}"
    return tuple(known.get(name, name) for name in names)


def edges_of(names: Sequence[str]) -> tuple[tuple[int, int], ...]:
    """Return the bones between landmarks most of which have names of one skeleton.

    It is the one that has most of the names; none where that is no more than half of them.
    """
    place = {name: number for number, name in enumerate(names)}
    joints = _skeleton("people", " ".join((*PEOPLE, *FURTHER)), PEOPLE_BONES, {})
    bones = [
        [(one.landmark_names[a], one.landmark_names[b]) for a, b in one.edges]
        for one in (joints, *_PRESETS)
    ]
    bones += [
        [pair for chain in text.split() for pair in pairwise(chain.split("-"))]
        for text in ANIMAL_BONES
    ]
    known = [{name for pair in pairs for name in pair} & place.keys() for pairs in bones]
    best = max(range(len(bones)), key=lambda number: len(known[number]))
    if 2 * len(known[best]) <= len(place):
        return ()
    return tuple((place[a], place[b]) for a, b in bones[best] if a in place and b in place)

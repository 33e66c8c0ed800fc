"""The landmarks of the usual detectors of people, and where they lie among the joints of `people`.

    w = (fixed + sum_k theta_k along_k) x + e,    e of standard deviation `std`

for the joints x of the dictionary: each landmark is a row of weights, which depend on a few
parameters theta. A file without names gives only the number of its landmarks; `keypoints: NAME`
names them by one of the skeletons in `data/skeletons.yaml`.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from itertools import pairwise
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

_JOINTS = (
    "pelvis rhip rknee rankle lhip lknee lankle neck head rshoulder relbow rwrist lshoulder lelbow "
    "lwrist"
)
PEOPLE = tuple(_JOINTS.split())
"""The joints of the dictionary `people`."""

FURTHER = ("rheel", "rball", "rtoe", "lheel", "lball", "ltoe", "rhand", "lhand", "spine")
"""Its further joints, which only some training files mark."""

Weights = Mapping[str, float]
"""Weights of joints, by their names."""


class Parameter(NamedTuple):
    """A number in which skeletons and bodies differ: its mean, and the std of its logarithm."""

    mean: float
    std: float


THETA: Mapping[str, Parameter] = MappingProxyType(
    {"head": Parameter(1.5, 0.15), "hips": Parameter(1.15, 0.15)}
)
"""The components of theta: the height of the top of the head above the shoulders, and the distance
of the hips, in those of the joints. Their means were chosen on a man on a beam seen by OpenPose
(docs/people.md), where the evidence of four cameras gives 1.35 to 1.65 and 1.15; the standard
deviations cover six other bodies."""


@dataclass(frozen=True)
class Part:
    """A part of the body among the joints: w = (fixed + sum_k theta_k along_k) x + e.

    joint     that it stands for in a fit, if any
    fixed     weights, which add up to 1
    along     weights by parameter, which add up to 0
    std       standard deviation of e, in the unit of normalised shapes
    alone     whether it stands for the joint alone, or the mean of all such parts does
    """

    joint: str | None
    fixed: Weights
    along: Mapping[str, Weights] = field(default_factory=dict)
    std: float = 0.0
    alone: bool = True

    def weights(self, theta: Mapping[str, float]) -> dict[str, float]:
        """Return the weights of the joints at a theta."""
        total = dict(self.fixed)
        for name, along in self.along.items():
            for joint, weight in along.items():
                total[joint] = total.get(joint, 0.0) + theta[name] * weight
        return total


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


def _at(joint: str, std: float) -> Part:
    """Return the part that lies at a joint, more or less; knuckles do together."""
    return Part(joint, {joint: 1.0}, std=std, alone=not joint.endswith("hand"))


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
        "throat": Part(None, {"lshoulder": 0.5, "rshoulder": 0.5}, std=0.03),
        "middle of hips": Part(None, {"lhip": 0.5, "rhip": 0.5}),
        "middle of spine": Part("spine", {"spine": 1.0}, std=0.1),
        "thorax": Part("neck", {"neck": 1.0}, std=0.1),
    }
    | {f"{s}{part}": _at(f"{s}{joint}", std) for s in "rl" for part, joint, std in _ENDS}
    | {f"{s}thumb": Part(None, {f"{s}wrist": 0.3, f"{s}hand": 0.7}, std=0.15) for s in "rl"}
)
"""The parts of the body that detectors mark."""

_SAME = ("hip", "knee", "ankle", "shoulder", "elbow", "wrist", "eye", "ear", "heel")
_CAPITALS = {name.capitalize(): name for name in _SAME}
_CAPITALS |= {"Foot": "ankle", "BigToe": "big toe", "SmallToe": "small toe"}
_WORDS = {name: name for name in (*_SAME, "thumb")}
_WORDS |= {"big_toe": "big toe", "small_toe": "small toe", "foot_index": "big toe"}
_WORDS |= {"index": "knuckle", "pinky": "knuckle"}

# The dictionary's `pelvis` lies some 105 mm above the middle of the hips and its `neck` some 60 mm
# below the middle of the shoulders: no detector marks that pelvis, and only the thorax of Human3.6M
# is that neck. Its `head` is the end of a bone within the head; detectors with a Head mark the top.
MARKED: dict[str, str] = (
    {f"{side.upper()}{name}": f"{side}{part}" for side in "rl" for name, part in _CAPITALS.items()}
    | {
        f"{word}_{name}": f"{word[0]}{part}"
        for word in ("right", "left")
        for name, part in _WORDS.items()
    }
    | {"Nose": "nose", "nose": "nose", "Head": "crown", "Neck": "throat", "Thorax": "thorax"}
    | {"MidHip": "middle of hips", "Hip": "middle of hips", "Spine": "middle of spine"}
)
"""The part of the body, a name in `PARTS`, that a landmark of any detector marks."""


@dataclass(frozen=True)
class Skeleton:
    """The landmarks of one detector, in the order of its files.

    bones are pairs of names, lines of the face included; `edges` are pairs of their numbers.
    """

    name: str
    landmark_names: tuple[str, ...]
    bones: tuple[tuple[str, str], ...]

    @property
    def edges(self) -> tuple[tuple[int, int], ...]:
        """Pairs of landmarks that a bone or a line of the face joins."""
        place = {name: number for number, name in enumerate(self.landmark_names)}
        return tuple((place[a], place[b]) for a, b in self.bones)


@cache
def _data() -> Any:
    """Return the content of `data/skeletons.yaml`."""
    from ruamel.yaml import YAML

    path = Path(__file__).resolve().parents[1] / "data" / "skeletons.yaml"
    return YAML(typ="safe", pure=True).load(path)


@cache
def installed_skeletons() -> Mapping[str, Skeleton]:
    """Return the skeletons of detectors by their names."""
    found = {
        name: Skeleton(
            name, tuple(_expanded(rows["landmarks"], " ").split()), _bones(rows["bones"])
        )
        for name, rows in _data()["skeletons"].items()
    }
    return MappingProxyType(found)


def _bones(text: str) -> tuple[tuple[str, str], ...]:
    """Return the pairs of chains such as `a-b-c`, separated by spaces."""
    chains = (chain.split("-") for chain in _expanded(text, "-").split())
    return tuple(pair for chain in chains for pair in pairwise(chain))


def _expanded(text: str, delimiter: str) -> str:
    """Return a text in which ranges such as `face_0..67` are written out."""

    def names(match: re.Match[str]) -> str:
        stem, first, last = match.groups()
        return delimiter.join(f"{stem}{number}" for number in range(int(first), int(last) + 1))

    return re.sub(r"(\w*?)(\d+)\.\.(\d+)", names, text)


def skeletons_of_size(count: int) -> tuple[str, ...]:
    """Return the names of the skeletons of so many landmarks, the usual one first."""
    known = installed_skeletons().items()
    return tuple(name for name, one in known if len(one.landmark_names) == count)


def people_joints(names: Iterable[str]) -> dict[str, str]:
    """Return the joints of the dictionary `people` by those of the names that mark one alone.

    All skeletons together: no name stands for two joints.
    """
    parts = people_parts(names).items()
    return {name: part.joint for name, part in parts if part.joint and part.alone}


def joint_columns(names: Sequence[str]) -> dict[str, int]:
    """Return the joints of a body that landmarks stand for, by any skeleton -> their columns."""
    joints = {name: name for name in names if name in (*PEOPLE, *FURTHER)} | people_joints(names)
    return {joints[name]: column for column, name in enumerate(names) if name in joints}


def people_parts(names: Iterable[str]) -> dict[str, Part]:
    """Return the parts of the body by those of the names that mark one."""
    return {name: PARTS[MARKED[name]] for name in names if name in MARKED}


def part_names(names: Iterable[str]) -> dict[str, str]:
    """Return the part of the body, a name in `PARTS`, of those of the names that mark one."""
    known = {joint: joint for joint in (*PEOPLE, *FURTHER)} | MARKED
    return {name: known[name] for name in names if name in known}


def model_names(names: Sequence[str]) -> tuple[str, ...]:
    """Return landmarks by the names that markers have in the OpenSim models of Pose2Sim.

    They are the detectors' own, but for the middle of the hips of `body_25` and for `coco_17`.
    """
    known = {"MidHip": "CHip"}
    if set(names) <= set(installed_skeletons()["coco_17"].landmark_names):
        for name in names:
            side, _, part = name.rpartition("_")
            known[name] = f"{side[:1].upper()}{part.capitalize()}"
    return tuple(known.get(name, name) for name in names)


def edges_of(names: Sequence[str]) -> tuple[tuple[int, int], ...]:
    """Return the bones between landmarks most of which have names of one skeleton.

    It is the one that has most of the names; none where that is no more than half of them.
    """
    place = {name: number for number, name in enumerate(names)}
    bones = [_bones(text) for text in _data()["further_bones"].values()]
    bones[1:1] = [skeleton.bones for skeleton in installed_skeletons().values()]
    known = [{name for pair in pairs for name in pair} & place.keys() for pairs in bones]
    best = max(range(len(bones)), key=lambda number: len(known[number]))
    if 2 * len(known[best]) <= len(place):
        return ()
    return tuple((place[a], place[b]) for a, b in bones[best] if a in place and b in place)

"""The landmarks of the usual detectors of people, and where they lie among the joints
of `people`.

Skeletons, by which files without names are named, and parts of the body stand in
`data/skeletons.toml`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

PEOPLE = (
    *("pelvis", "rhip", "rknee", "rankle", "lhip", "lknee", "lankle", "neck", "head"),
    *("rshoulder", "relbow", "rwrist", "lshoulder", "lelbow", "lwrist"),
)
"""The joints of the dictionary `people`."""

FURTHER = (
    "rheel",
    "rball",
    "rtoe",
    "lheel",
    "lball",
    "ltoe",
    "rhand",
    "lhand",
    "spine",
)
"""Its further joints, which only some training files mark."""

JOINTS = (*PEOPLE, *FURTHER)


class Parameter(NamedTuple):
    """A number in which skeletons and bodies differ: its mean, and the std of its
    logarithm.
    """

    mean: float
    std: float


THETA: Mapping[str, Parameter] = {
    "head": Parameter(1.5, 0.15),
    "hips": Parameter(1.15, 0.15),
}
"""The components of theta: the height of the top of the head above the shoulders, and
the distance of the hips, in those of the joints. The means are those of one body seen
by OpenPose in four cameras; the standard deviations cover six others.
"""


class BodyPart(NamedTuple):
    """A part of the body placed by joints x: w = (fixed + sum_k theta_k along_k) x + e.

    It stands for a `joint` in a fit, if any: `alone`, or as the mean of all such parts.
    Weights in `fixed` add up to 1, those in `along`, by parameter, to 0; `std` is the
    standard deviation of e in the unit of normalised shapes.
    """

    joint: str | None = None
    fixed: Mapping[str, float] = {}
    along: Mapping[str, Mapping[str, float]] = {}
    std: float = 0.0
    alone: bool = True

    @property
    def joints(self) -> set[str]:
        """The names of the joints that place the part."""
        return set(self.fixed).union(*self.along.values())

    def weights(self, theta: Mapping[str, float]) -> dict[str, float]:
        """Return joint -> weight fixed + sum_k theta_k along_k, for body proportions.

        theta has the components of THETA.
        """
        total = dict(self.fixed)
        for name, along in self.along.items():
            for joint, weight in along.items():
                total[joint] = total.get(joint, 0.0) + theta[name] * weight
        return total


class Skeleton(NamedTuple):
    """The landmarks of one detector, in the order of its files; bones as pairs of
    names.
    """

    name: str
    landmark_names: tuple[str, ...]
    bones: tuple[tuple[str, str], ...]


@cache
def _skeleton_data() -> Any:
    """Return the content of `data/skeletons.toml`.

    It is read in 2 ms (YAML takes 35), and only where landmarks are not joints.
    """
    import tomllib

    path = Path(__file__).resolve().parents[1] / "data" / "skeletons.toml"
    return tomllib.loads(path.read_text())


@cache
def installed_skeletons() -> Mapping[str, Skeleton]:
    """Return the installed skeletons of detectors by their names."""
    skeletons = {}
    for name, rows in _skeleton_data()["skeletons"].items():
        names = tuple(rows["landmarks"].split())
        skeletons[name] = Skeleton(name, names, _parse_bones(rows["bones"]))
    return skeletons


def _parse_bones(text: str) -> tuple[tuple[str, str], ...]:
    """Parse chains of names, `a-b-c d-e`, into bones: (a, b), (b, c), (d, e)."""
    return tuple(pair for chain in text.split() for pair in pairwise(chain.split("-")))


def skeletons_of_size(count: int) -> tuple[str, ...]:
    """Return names of skeletons with `count` landmarks, the most usual one first."""
    skeletons = installed_skeletons().values()
    return tuple(one.name for one in skeletons if len(one.landmark_names) == count)


def edges_of(names: Sequence[str]) -> tuple[tuple[int, int], ...]:
    """Return the bones between landmarks as index pairs, () if no skeleton has them.

    They are those of the skeleton that names most of the landmarks, if more than half.
    """
    place = {name: number for number, name in enumerate(names)}
    bones = [_parse_bones(text) for text in _skeleton_data()["further_bones"].values()]
    bones[1:1] = [skeleton.bones for skeleton in installed_skeletons().values()]
    marked = [
        len({name for pair in pairs for name in pair} & place.keys()) for pairs in bones
    ]
    if 2 * max(marked) <= len(place):
        return ()
    best = bones[marked.index(max(marked))]
    return tuple((place[a], place[b]) for a, b in best if a in place and b in place)


@cache
def body_parts() -> Mapping[str, BodyPart]:
    """Return name -> BodyPart for joints, and other parts that detectors mark."""
    joints = {joint: BodyPart(joint, {joint: 1.0}) for joint in JOINTS}
    return joints | {
        name: BodyPart(**values) for name, values in _skeleton_data()["parts"].items()
    }


@cache
def _part_of_landmark() -> Mapping[str, str]:
    """Return landmark of a detector -> name of the part of the body that it marks."""
    return {
        name: part
        for part, names in _skeleton_data()["marked"].items()
        for name in names.split()
    }


def part_names(names: Iterable[str]) -> dict[str, str]:
    """Return landmark -> name of its part of the body, for landmarks that have one."""
    part_of = {**{joint: joint for joint in JOINTS}, **_part_of_landmark()}
    return {name: part_of[name] for name in names if name in part_of}


def people_parts(names: Iterable[str]) -> dict[str, BodyPart]:
    """Return landmark -> BodyPart for those detector landmarks that mark a part."""
    others = [name for name in names if name not in JOINTS]
    return {
        name: body_parts()[_part_of_landmark()[name]]
        for name in others
        if name in _part_of_landmark()
    }


def people_joints(names: Iterable[str]) -> dict[str, str]:
    """Return landmark -> joint of `people`, for landmarks that each mark one joint."""
    parts = people_parts(names).items()
    return {name: part.joint for name, part in parts if part.joint and part.alone}


def joint_columns(names: Sequence[str]) -> dict[str, int]:
    """Return joint -> index of its landmark in `names`, those of a known skeleton."""
    joints = {name: name for name in names if name in JOINTS} | people_joints(names)
    return {joints[name]: column for column, name in enumerate(names) if name in joints}


def model_names(names: Sequence[str]) -> tuple[str, ...]:
    """Return the names that landmarks have in the OpenSim models of Pose2Sim.

    They are the detectors' own, but for the middle of the hips of `body_25` and for
    `coco_17`.
    """
    if not set(names) <= set(installed_skeletons()["coco_17"].landmark_names):
        return tuple("CHip" if name == "MidHip" else name for name in names)
    parts = (name.rpartition("_") for name in names)
    return tuple(f"{side[:1].upper()}{part.capitalize()}" for side, _, part in parts)

"""BVH: a tree of joints and the angles of each, frame by frame."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from shapefit.arrays import Floats
from shapefit.errors import input_error, printable
from shapefit.geometry.rotations import turns
from shapefit.io.foreign.recording import Recording, one_individual
from shapefit.io.foreign.text import (
    read_blocks,
    read_plain,
    read_table,
    read_words,
    split_lines,
    unique_names,
)

TOO_FEW = "frames are announced, but not there"


@dataclass
class Joint:
    """A joint, or an End Site, at `offset` (3,) from its parent, -1 for none.

    channels are (is_rotation, axis, column of the motion), in the order of the file.
    """

    name: str
    parent: int
    is_end: bool = False
    offset: tuple[float, ...] = (0.0, 0.0, 0.0)
    channels: list[tuple[bool, int, int]] = field(default_factory=list)


@dataclass(frozen=True)
class Hierarchy:
    """All joints, parents first; `lines` stand before the motion."""

    joints: list[Joint]
    width: int
    lines: int
    frames: int
    frame_time: float


def read_bvh(paths: tuple[Path, ...]) -> Recording:
    """Return the joints of a BVH file, in its unit, and then the ends of the last bones.

    The end of joint J is `J_end`. Raises InputError for a tree or a motion that cannot be read.
    """
    path = paths[0]
    tree = read_hierarchy(path)
    order = sorted(range(len(tree.joints)), key=lambda number: tree.joints[number].is_end)
    names, notes = unique_names([tree.joints[number].name for number in order])
    place = {number: row for row, number in enumerate(order)}
    edges = [(place[j.parent], place[i]) for i, j in enumerate(tree.joints) if j.parent >= 0]
    motion = np.concatenate([np.empty((0, tree.width)), *read_motion(path, tree)])
    if len(motion) < tree.frames:
        notes += (f"{tree.frames - len(motion)} {TOO_FEW}",)
    return Recording(
        name=str(path),
        video=path.stem,
        **one_individual(find_places(tree, motion)[:, order]),
        landmark_names=names,
        frame_rate=_rate(tree.frame_time),
        edges=tuple(edges),
        notes=notes,
    )


def read_hierarchy(path: Path) -> Hierarchy:
    """Read the tree and the head of the motion. Raises InputError, naming the line."""
    joints: list[Joint] = []
    open_joints: list[int] = []
    width, frames = 0, -1
    for first, lines in read_blocks(path):
        for number, line in enumerate(lines, first):
            place = f"{path}:{number}"
            words = line.replace("{", " ").replace("}", " ").split()
            word = words[0].upper() if words else ""
            if word in ("ROOT", "JOINT", "END"):
                parent = open_joints[-1] if open_joints else -1
                if (parent < 0) != (word == "ROOT"):
                    raise input_error(place, f"{word} stands in the wrong place", "correct it")
                name = f"{joints[parent].name}_end" if word == "END" else " ".join(words[1:])
                joints.append(Joint(name, parent, word == "END"))
                open_joints.append(len(joints) - 1)
            elif word in ("OFFSET", "CHANNELS") and not open_joints:
                raise input_error(place, f"{word} belongs to no joint", "correct it")
            elif word == "OFFSET":
                joints[open_joints[-1]].offset = read_words(words[1:], 3, place)
            elif word == "CHANNELS":
                channels = [_channel(name, place) for name in words[2:]]
                if words[1:2] != [str(len(channels))]:
                    found = f"{' '.join(words[1:2])} channels, and {len(channels)} names"
                    raise input_error(place, found, "name as many as there are")
                joints[open_joints[-1]].channels = [
                    (kind, axis, width + i) for i, (kind, axis) in enumerate(channels)
                ]
                width += len(channels)
            elif word == "FRAMES:":
                frames = int(read_words(words[1:2], 1, place)[0])
            elif word == "FRAME" and words[1:2] == ["Time:"]:
                if not joints or open_joints:
                    raise input_error(place, "the tree of joints is not complete", "correct it")
                seconds = read_words(words[2:3], 1, place)[0]
                return Hierarchy(joints, width, number, frames, seconds)
            elif word not in ("", "HIERARCHY", "MOTION"):
                found = f"begins with {printable(words[0])!r}, which is no word of BVH"
                raise input_error(place, found, "correct it")
            if "}" in line and open_joints:
                del open_joints[-line.count("}") :]
    raise input_error(path, "has no motion, or is cut off before it", "give a complete BVH file")


def read_motion(path: Path, tree: Hierarchy) -> Iterator[Floats]:
    """Yield the numbers (n, width) of the frames, block by block."""
    for first, texts in read_blocks(path, tree.lines):
        separator = "\t" if "\t" in texts[0].strip() else " "
        plain = read_plain([text.strip() for text in texts], separator, tree.width)
        if plain is not None and np.isfinite(plain).all():
            yield plain
            continue
        rows, lines = split_lines(path, first, texts, None, tree.width, ("numbers", "channels"))
        if rows:
            yield read_table(rows, lines, path, finite=True)


def find_places(tree: Hierarchy, values: Floats) -> Floats:
    """Return the places (n, joints, 3) of all joints and ends.

    x = x_parent + R_parent (offset), R = R_parent R_1 R_2 ...: rotations in the order of the
    channels; a channel of position stands for the offset along its axis.
    """
    n = len(values)
    places = np.empty((n, len(tree.joints), 3))
    rotations: list[Floats] = []
    for number, joint in enumerate(tree.joints):
        offset = np.tile(np.array(joint.offset), (n, 1))
        for is_rotation, axis, column in joint.channels:
            if not is_rotation:
                offset[:, axis] = values[:, column]
        turned = [(axis, column) for is_rotation, axis, column in joint.channels if is_rotation]
        angles = np.radians(values[:, [column for _, column in turned]])
        local = turns([axis for axis, _ in turned], angles)
        if joint.parent < 0:
            places[:, number] = offset
            rotations.append(local)
            continue
        above = rotations[joint.parent]
        places[:, number] = places[:, joint.parent] + (above @ offset[..., None])[..., 0]
        rotations.append(above if joint.is_end else above @ local)
    return places


def _channel(name: str, place: str) -> tuple[bool, int]:
    axis = "xyz".find(name[:1].lower())
    kind = name[1:].lower()
    if axis < 0 or kind not in ("rotation", "position"):
        raise input_error(place, f"there is no channel {name!r}", "use Xrotation, Yposition, ...")
    return kind == "rotation", axis


def _rate(frame_time: float) -> float | None:
    """Return the frame rate in Hz: whole, where the time was rounded (0.033333 s is 30 Hz)."""
    if frame_time <= 0:
        return None
    rate = 1.0 / frame_time
    return float(round(rate)) if abs(rate - round(rate)) < 1e-3 * rate and rate > 1 else rate

"""BVH and ASF/AMC: trees of joints, and how they move and turn frame by frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from shapefit.arrays import Floats
from shapefit.errors import abbreviate, counted, input_error, listed
from shapefit.geometry.rotations import rotation_about_axes
from shapefit.io.layout import UNKNOWN_UNIT
from shapefit.io.readers.poses import (
    FormatError,
    Poses,
    check_names,
    make_unique,
    of_frames,
    parsing,
    require,
)
from shapefit.io.readers.text_table import Row, Table, read_text
from shapefit.io.tidy_table import read_numbers

Channel = tuple[bool, int]
"""Whether it turns, and the axis."""


@dataclass
class Joint:
    """A joint, or the end of a bone; all lengths in the unit of the file.

    before (3,) leads from the parent to where it turns, in the frame of the parent, and after (3,)
    from there to its place, in its own; axes (3, 3) is the frame in which it turns. Of its channels
    the last one turns first.
    """

    name: str
    parent: int
    before: Floats = field(default_factory=lambda: np.zeros(3))
    after: Floats = field(default_factory=lambda: np.zeros(3))
    axes: Floats = field(default_factory=lambda: np.eye(3))
    channels: Sequence[Channel] = ()


def find_places(joints: Sequence[Joint], values: Floats, *, degrees: bool) -> Floats:
    """Return the places (n, joints, 3) from the values (n, c) of all channels, joint by joint.

    R = R_parent C M C^T, x = x_parent + R_parent (before + shift) + R after: C is the frame of the
    joint, M turns by its channels, and shift moves by them.
    """
    n = len(values)
    starts = np.cumsum([0, *(len(joint.channels) for joint in joints)])
    places = np.zeros((n, len(joints), 3))
    rotations: dict[int, Floats] = {-1: np.eye(3)}
    for number in _parents_first([joint.parent for joint in joints]):
        joint = joints[number]
        moved = values[:, starts[number] : starts[number + 1]]
        turning = [column for column, (turns, _) in enumerate(joint.channels) if turns]
        angles = np.radians(moved[:, turning]) if degrees else moved[:, turning]
        motion = rotation_about_axes([joint.channels[column][1] for column in turning], angles)
        before = np.tile(joint.before, (n, 1))
        for column, (turns, axis) in enumerate(joint.channels):
            if not turns:
                before[:, axis] += moved[:, column]
        above = rotations[joint.parent]
        rotations[number] = above @ joint.axes @ motion @ joint.axes.T
        places[:, number] = (above @ before[..., None])[..., 0] + rotations[number] @ joint.after
        if joint.parent >= 0:
            places[:, number] += places[:, joint.parent]
    return places


def _parents_first(parents: Sequence[int]) -> list[int]:
    """Return the joints of a tree, or of a part of it, each after its parent, -1 for none."""
    walk = [number for number, parent in enumerate(parents) if parent < 0]
    for number in walk:
        walk += [child for child, parent in enumerate(parents) if parent == number]
    return walk


def _edges(joints: Sequence[Joint]) -> tuple[tuple[int, int], ...]:
    return tuple((joint.parent, i) for i, joint in enumerate(joints) if joint.parent >= 0)


# BVH


def read_bvh(paths: tuple[Path, ...]) -> Poses:
    """Return the joints of a BVH file, in its unit, and then the ends of the last bones.

    The end of joint J is `J_end`. Raises InputError for a tree or a motion that cannot be read.
    """
    path = paths[0]
    text = read_text(path)
    joints, ends, lines, frames, frame_time = _read_hierarchy(path, text)
    table = Table(path, None, text)
    table.skip(lines, [joint.name for joint in joints for _ in joint.channels])
    motion, _, _ = table.read(range(len(table.names)), finite=True, empty=False)
    order = sorted(range(len(joints)), key=lambda number: number in ends)
    names, notes = make_unique([joints[number].name for number in order])
    if len(motion) < frames:
        notes += (f"{frames - len(motion)} frames are announced, but not there",)
    return of_frames(
        path,
        find_places(joints, motion, degrees=True)[:, order],
        video=path.stem,
        landmark_names=names,
        frame_rate=_rate(frame_time),
        edges=tuple((order.index(a), order.index(b)) for a, b in _edges(joints)),
        notes=notes,
    )


def _read_hierarchy(path: Path, text: str) -> tuple[list[Joint], set[int], int, int, float]:
    """Return the joints, which of them are ends, the lines before the motion, frames, and seconds.

    Raises InputError, naming the line.
    """
    joints: list[Joint] = []
    open_joints: list[int] = []
    ends: set[int] = set()
    frames = -1
    for number, line in enumerate(text.split("\n"), 1):
        word, *rest = line.replace("{", " ").replace("}", " ").split() or [""]
        key = word.upper()
        parent = open_joints[-1] if open_joints else -1
        with parsing(f"{path}:{number}", "correct it"):
            if key in ("ROOT", "JOINT", "END"):
                require((parent < 0) == (key == "ROOT"), f"{key} stands in the wrong place")
                open_joints.append(len(joints))
                ends |= {len(joints)} if key == "END" else set()
                name = f"{joints[parent].name}_end" if key == "END" else " ".join(rest)
                joints.append(Joint(name, parent))
            elif key in ("OFFSET", "CHANNELS"):
                require(open_joints, f"{key} belongs to no joint")
                if key == "OFFSET":
                    joints[parent].before = np.array(read_words(rest, 3))
                else:
                    joints[parent].channels = channels = [_channel(name) for name in rest[1:]]
                    given = f"{' '.join(rest[:1])} channels, and {len(channels)} names"
                    require(rest[:1] == [str(len(channels))], given)
            elif key == "FRAMES:":
                frames = int(read_words(rest[:1], 1)[0])
            elif key == "FRAME" and rest[:1] == ["Time:"]:
                require(joints and not open_joints, "the tree of joints is not complete")
                for joint in joints:  # a channel of position stands for the offset along its axis
                    joint.before[[axis for turns, axis in joint.channels if not turns]] = 0
                return joints, ends, number, frames, read_words(rest[1:2], 1)[0]
            else:
                known = key in ("", "HIERARCHY", "MOTION")
                require(known, f"begins with {word!r}, which is no word of BVH")
        if "}" in line and open_joints:
            del open_joints[-line.count("}") :]
    raise input_error(path, "has no motion, or is cut off before it", "give a complete BVH file")


def _channel(name: str) -> Channel:
    axis, kind = "xyz".find(name[:1].lower()), name[1:].lower()
    known = axis >= 0 and kind in ("rotation", "position")
    require(known, f"there is no channel {name!r}, as Xrotation or Yposition")
    return kind == "rotation", axis


def _rate(frame_time: float) -> float | None:
    """Return the frame rate in Hz: whole, where the time was rounded (0.033333 s is 30 Hz)."""
    if frame_time <= 0:
        return None
    rate = 1.0 / frame_time
    return float(round(rate)) if abs(rate - round(rate)) < 1e-3 * rate and rate > 1 else rate


# ASF/AMC, of Acclaim

ROOT = "root"
INCH = 0.0254
SKELETON, MOTION = ".asf", ".amc"

HEAD_LINES = 100
"""Within which a motion says whether its angles are degrees."""

WHOLE = "give a whole ASF file"
SAME_BONES = "give a whole file, in which every frame lists the same bones, and its own ASF file"


@dataclass(frozen=True)
class Skeleton:
    """Bones, the root first, in the order of the file; scale of lengths; unit of angles."""

    bones: list[Joint]
    unit: str
    scale: float
    degrees: bool


def read_acclaim(paths: tuple[Path, ...]) -> Poses:
    """Return the ends of the bones of one or more motions: the root, then bones as ASF lists them.

    The skeleton is among the paths or in the folder of the motion, and named as the motion begins
    (86.asf, 86_01.amc), or the only one. A bone's end has the bone's name. Raises InputError where
    there is no skeleton, or another one.
    """
    motions = [path for path in paths if path.suffix.lower() == MOTION]
    if not motions:
        found = "is a skeleton without a motion"
        raise input_error(paths[0], found, "give the AMC file of the motion")
    given = [path for path in paths if path.suffix.lower() == SKELETON]
    skeletons = [_read_skeleton(_find_skeleton(path, given)) for path in motions]
    first = skeletons[0]
    names = [bone.name for bone in first.bones]
    labels: list[str] = []
    videos: list[str] = []
    parts, frames = [], []
    for path, skeleton in zip(motions, skeletons, strict=True):
        if [bone.name for bone in skeleton.bones] != names or skeleton.unit != first.unit:
            found = f"has another skeleton than {motions[0]}"
            raise input_error(path, found, "convert them one by one")
        own, ends = _read_motion(path, skeleton)
        labels += own
        videos += [path.stem] * len(own)
        parts.append(ends)
        frames.append(np.arange(len(own)))
    return of_frames(
        motions[0] if len(motions) == 1 else motions[0].parent,
        np.concatenate(parts),
        labels=labels,
        video=videos,
        frame=np.concatenate(frames),
        landmark_names=tuple(names),
        unit=first.unit,
        edges=_edges(first.bones),
    )


def _find_skeleton(motion: Path, given: list[Path]) -> Path:
    """Return the skeleton of a motion. Raises InputError where there is none, or several are."""
    beside = sorted(p for p in motion.parent.iterdir() if p.suffix.lower() == SKELETON)
    for paths in (given, beside):
        if named := [path for path in paths if motion.stem.startswith(path.stem)]:
            return max(named, key=lambda path: len(path.stem))
        if len(paths) == 1:
            return paths[0]
    if not beside:
        found = "there is no ASF file in its folder"
        raise input_error(motion, found, "put the skeleton beside the motion")
    found = f"none of the ASF files in its folder is named like it ({listed(map(str, beside))})"
    raise input_error(motion, found, "give the right one with it, or rename it")


def _read_skeleton(path: Path) -> Skeleton:
    """Read an ASF file. Raises InputError, naming the line, for what is no skeleton.

    Lengths are in inches / `length`, as the motion capture database of CMU has them (0.45), and
    given out in metres; with `length 1` their unit is unknown.
    """
    units: dict[str, str] = {}
    blocks: list[tuple[str, dict[str, list[str]]]] = [(f"{path}: root", ROOT_BLOCK.copy())]
    links: list[Row] = []
    section = ""
    for number, line in enumerate(read_text(path).split("\n"), 1):
        word, *rest = line.split("#")[0].split() or [""]
        key = word.lower()
        if key.startswith(":"):
            section = key
        elif key == "begin" and section == ":bonedata":
            blocks.append((f"{path}:{number}", {"dof": []}))
        elif key in ("begin", "end", ""):
            continue
        elif section == ":units":
            units[key] = (rest or [word])[-1].lower()
        elif section in (":root", ":bonedata"):
            own = blocks[0 if section == ":root" else -1][1]
            own["dof" if key == "order" else key] = rest
        elif section == ":hierarchy":
            links.append((number, [word, *rest]))
    degrees = not units.get("angle", "deg").startswith("rad")
    bones = []
    for place, block in blocks:
        with parsing(place, WHOLE):
            bones.append(_bone(block, degrees))
    _join(bones, links, path)
    with parsing(path, WHOLE):
        require(len(bones) > 1, "has no bones")
        (length,) = read_words([units.get("length", "1")], 1)
        require(length > 0, f"has the unit of length {length:g}")
    scale, unit = (1.0, UNKNOWN_UNIT) if length == 1 else (INCH / length, "m")
    return Skeleton(bones, unit, scale, degrees)


ROOT_BLOCK: dict[str, list[str]] = {
    "name": [ROOT],
    "dof": ["TX", "TY", "TZ", "RX", "RY", "RZ"],
    "axis": [],
    "position": ["0"] * 3,
    "orientation": ["0"] * 3,
}
"""The root, which has a place and not a length, where a file does not say other."""


def _bone(block: dict[str, list[str]], degrees: bool) -> Joint:
    """Return a bone, or the root, whose place is where it turns; its first angle turns first."""
    before, after, turn = np.zeros(3), np.zeros(3), block["axis"]
    if "orientation" in block:
        turn = [*block["orientation"], *turn]
        before = np.array(read_words(block["position"], 3))
    else:
        after = np.array(read_words(block["direction"], 3))
        after *= read_words(block["length"], 1)[0]
    angles, letters = read_words(turn[:3], 3), (turn[3:] or ["XYZ"])[0].lower()
    require(sorted(letters) == ["x", "y", "z"], f"the axes are {letters!r}, not XYZ in any order")
    turned = np.radians(angles[::-1]) if degrees else np.array(angles[::-1])
    axes = rotation_about_axes(["xyz".index(a) for a in reversed(letters)], turned)
    channels = []
    for name in map(str.lower, reversed(block["dof"])):
        known = len(name) == 2 and name[0] in "rt" and name[1] in "xyz"
        require(known, f"a degree of freedom {name!r}, not tx ty tz rx ry rz")
        channels.append((name[0] == "r", "xyz".index(name[1])))
    return Joint(block["name"][0], -1, before, after, axes, channels)


def _join(bones: list[Joint], links: list[Row], path: Path) -> None:
    """Give each bone its parent. Raises InputError where they are no tree."""
    index = {bone.name: number for number, bone in enumerate(bones)}
    parents = [-1] + [len(bones)] * (len(bones) - 1)
    twice = []
    for line, words in links:
        with parsing(f"{path}:{line}", "name bones that are there"):
            above, *below = (index[word] for word in words)
        for number in below:
            if parents[number] != len(bones):
                twice.append(number)
            else:
                parents[number] = bones[number].parent = above
    reached = set(_parents_first(parents))
    lost = [b.name for i, b in enumerate(bones) if i not in reached or i in twice]
    with parsing(path, f"correct it, or {WHOLE}"):
        check_names([bone.name for bone in bones], "bone")
        require(not lost, f"the hierarchy does not reach every bone once ({abbreviate(lost)})")


def _read_motion(path: Path, skeleton: Skeleton) -> tuple[list[str], Floats]:
    """Return the labels of the frames of a motion, and the ends (n, bones, 3) of all bones.

    Raises InputError, naming the line, for frames that list other bones than the first.
    """
    lines = read_text(path).split("\n")
    settings = {line.strip().upper() for line in lines[:HEAD_LINES]}
    degrees = ":DEGREES" in settings or (":RADIANS" not in settings and skeleton.degrees)
    labels: list[str] = []
    rows: list[Row] = []
    size = 0
    for line, words in enumerate(map(str.split, lines), 1):
        if not words or words[0][0] in "#:":
            continue
        if len(words) == 1 and words[0].isdigit():
            size = len(rows) if len(labels) == 1 else size
            labels.append(words[0])
        elif not labels:
            found = f"{lines[line - 1].strip()[:40]!r} stands before the first frame"
            raise input_error(f"{path}:{line}", found, "number every frame")
        else:
            rows.append((line, words))
    if not rows:
        return [], np.empty((0, len(skeleton.bones), 3))
    bones, size = skeleton.bones, size or len(rows)
    count = {bone.name: len(bone.channels) for bone in bones}
    order = [words[0] for _, words in rows[:size]]
    for (line, (name, *cells)), wanted in zip(rows, order * len(labels), strict=False):
        if name != wanted or len(cells) != count.get(name):
            with parsing(f"{path}:{line}", SAME_BONES):
                require(name == wanted, f"{name!r} stands where other frames have {wanted!r}")
                require(name in count, f"the skeleton has no bone {name!r}")
                given = f"{counted(len(cells), 'number')} for the"
                raise FormatError(f"{given} {count[name]} degrees of freedom of {name}")
    if len(rows) != size * len(labels):
        raise input_error(path, "the last frame lacks bones, or has too many", SAME_BONES)
    place = {name: number for number, name in enumerate(order)}
    values = [
        read_cells([(line, words[:0:-1]) for line, words in rows[place[bone.name] :: size]], path)
        if bone.name in place and bone.channels
        else np.zeros((len(labels), len(bone.channels)))
        for bone in bones
    ]
    ends = find_places(bones, np.concatenate(values, axis=1), degrees=degrees)
    return labels, skeleton.scale * ends


def read_cells(rows: Sequence[Row], path: Path) -> Floats:
    """Return rows of as many cells each as finite numbers (n, cells).

    Raises InputError for the first cell that is none.
    """
    values, _ = read_numbers([cell for _, cells in rows for cell in cells])
    for place in np.flatnonzero(~np.isfinite(values))[:1].tolist():
        line, cells = rows[place // len(rows[0][1])]
        cell = cells[place % len(cells)]
        raise input_error(f"{path}:{line}", f"{cell[:40]!r} is no number", "correct it")
    return values.reshape(len(rows), -1)


def read_words(words: Sequence[str], count: int) -> tuple[float, ...]:
    """Return so many words as finite numbers. Raises ValueError where they are none."""
    given = f"expected {count} numbers, found {' '.join(words)[:40]!r}"
    try:
        numbers = tuple(map(float, words))
    except ValueError:
        numbers = ()
    require(len(numbers) == count and np.isfinite(numbers).all(), given)
    return numbers

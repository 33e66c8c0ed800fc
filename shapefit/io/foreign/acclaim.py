"""ASF and AMC, the motion of a skeleton in the format of Acclaim: the ends of all bones."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from shapefit.arrays import Floats
from shapefit.errors import abbreviate, counted, input_error, listed
from shapefit.geometry.rotations import rotation_about_axes
from shapefit.io.foreign.motion_text import read_lines, read_table, read_words
from shapefit.io.foreign.recording import Recording, one_individual
from shapefit.io.layout import UNKNOWN_UNIT

ROOT = "root"
INCH = 0.0254
AXES = {"x": 0, "y": 1, "z": 2}


@dataclass(frozen=True)
class Bone:
    """A bone; of the root the end is the root itself.

    offset (3,) from its beginning to its end in the pose at rest; axis (3, 3) the frame in which
    it turns; motion: its degrees of freedom, as (is_rotation, axis), in the order of the motion.
    """

    name: str
    offset: Floats
    axis: Floats
    motion: tuple[tuple[bool, int], ...]


@dataclass(frozen=True)
class Skeleton:
    """Bones, the root first, in the order of the file; parents of each; walk is parents first."""

    bones: tuple[Bone, ...]
    parents: tuple[int, ...]
    walk: tuple[int, ...]
    unit: str
    scale: float
    degrees: bool


def read_skeleton(path: Path) -> Skeleton:
    """Read an ASF file. Raises InputError, naming the line, for what is no skeleton.

    Lengths are in inches / `length`, as the motion capture database of CMU has them (0.45), and
    given out in metres; with `length 1` their unit is unknown.
    """
    units: dict[str, str] = {}
    blocks: list[tuple[int, dict[str, list[str]]]] = [(0, {"name": [ROOT]})]
    links: list[tuple[int, list[str]]] = []
    section = ""
    for number, line in enumerate(read_lines(path), 1):
        words = line.split("#")[0].split()
        if not words:
            continue
        if words[0].startswith(":"):
            section = words[0].lower()
        elif words[0].lower() == "begin":
            if section == ":bonedata":
                blocks.append((number, {}))
        elif words[0].lower() == "end":
            continue
        elif section == ":units":
            units[words[0].lower()] = words[-1].lower()
        elif section == ":root":
            blocks[0][1].setdefault(words[0].lower(), words[1:])
        elif section == ":bonedata":
            blocks[-1][1].setdefault(words[0].lower(), words[1:])
        elif section == ":hierarchy":
            links.append((number, words))
    degrees = not units.get("angle", "deg").startswith("rad")
    root, *others = blocks
    bones = (_root(root[1], path, degrees), *(_bone(b, path, n, degrees) for n, b in others))
    if not others:
        raise input_error(path, "has no bones", "give a whole ASF file")
    parents, walk = _tree(bones, links, path)
    (length,) = read_words([units.get("length", "1")], 1, f"{path}: length")
    if length <= 0:
        raise input_error(path, f"has the unit of length {length:g}", "give a number > 0")
    scale, unit = (1.0, UNKNOWN_UNIT) if length == 1 else (INCH / length, "m")
    return Skeleton(bones, parents, walk, unit, scale, degrees)


def _root(block: dict[str, list[str]], path: Path, degrees: bool) -> Bone:
    place = f"{path}: root"
    order = block.get("order", ["TX", "TY", "TZ", "RX", "RY", "RZ"])
    position = read_words(block.get("position", ["0"] * 3), 3, place)
    angles = read_words(block.get("orientation", ["0"] * 3), 3, place)
    axes = (block.get("axis") or ["XYZ"])[0]
    return Bone(
        ROOT, np.array(position), _frame(angles, axes, place, degrees), _freedom(order, place)
    )


def _bone(block: dict[str, list[str]], path: Path, line: int, degrees: bool) -> Bone:
    place = f"{path}:{line}"
    lacking = [key for key in ("name", "direction", "length", "axis") if not block.get(key)]
    if lacking:
        raise input_error(place, f"a bone without {', '.join(lacking)}", "give a whole ASF file")
    name = block["name"][0]
    direction = np.array(read_words(block["direction"], 3, place))
    (length,) = read_words(block["length"], 1, place)
    angles = read_words(block["axis"][:3], 3, place)
    axes = (block["axis"][3:] or ["XYZ"])[0]
    freedom = _freedom(block.get("dof", []), place)
    return Bone(name, length * direction, _frame(angles, axes, place, degrees), freedom)


def _frame(angles: tuple[float, ...], axes: str, place: str, degrees: bool) -> Floats:
    """Return the rotation about these axes, the first one first."""
    letters = axes.lower()
    if sorted(letters) != ["x", "y", "z"]:
        raise input_error(place, f"the axes are {axes!r}", "give XYZ in any order")
    found = np.array(angles[::-1])
    return rotation_about_axes(
        [AXES[a] for a in reversed(letters)], np.radians(found) if degrees else found
    )


def _freedom(names: list[str], place: str) -> tuple[tuple[bool, int], ...]:
    found = []
    for name in map(str.lower, names):
        if len(name) != 2 or name[0] not in "rt" or name[1] not in AXES:
            raise input_error(place, f"a degree of freedom {name!r}", "use tx ty tz rx ry rz")
        found.append((name[0] == "r", AXES[name[1]]))
    return tuple(found)


def _tree(
    bones: tuple[Bone, ...], links: list[tuple[int, list[str]]], path: Path
) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Return the parent of each bone, -1 for the root, and all bones, parents first."""
    index = {bone.name: number for number, bone in enumerate(bones)}
    if len(index) < len(bones):
        raise input_error(path, "two bones have one name", "give every bone a name of its own")
    parents = [-1] * len(bones)
    children: dict[int, list[int]] = {}
    for line, words in links:
        unknown = [word for word in words if word not in index]
        if unknown:
            found = f"there is no bone {abbreviate(unknown)}"
            raise input_error(f"{path}:{line}", found, "correct the hierarchy")
        parent, *below = (index[word] for word in words)
        children.setdefault(parent, []).extend(below)
        for child in below:
            parents[child] = parent
    walk, waiting = [0], list(children.get(0, []))
    while waiting and len(walk) <= len(bones):
        number = waiting.pop(0)
        walk.append(number)
        waiting += children.get(number, [])
    if sorted(walk) != list(range(len(bones))):
        lost = [bone.name for number, bone in enumerate(bones) if walk.count(number) != 1]
        found = f"the hierarchy does not reach every bone once ({abbreviate(lost)})"
        raise input_error(path, found, "correct it, or give a whole ASF file")
    return tuple(parents), tuple(walk)


SKELETON, MOTION = ".asf", ".amc"

HEAD_LINES = 100
"""Within which a motion says whether its angles are degrees."""


def read_acclaim(paths: tuple[Path, ...]) -> Recording:
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
    skeletons = {path: read_skeleton(find_skeleton(path, given)) for path in motions}
    first = skeletons[motions[0]]
    names = tuple(bone.name for bone in first.bones)
    for path, skeleton in skeletons.items():
        same = tuple(bone.name for bone in skeleton.bones) == names
        if not same or skeleton.unit != first.unit:
            found = f"has another skeleton than {motions[0]}"
            raise input_error(path, found, "convert them one by one")

    edges = tuple((parent, bone) for bone, parent in enumerate(first.parents) if parent >= 0)
    labels: list[str] = []
    videos: list[str] = []
    parts, frames = [np.empty((0, len(names), 3))], [np.empty(0, np.int64)]
    for path, skeleton in skeletons.items():
        own, ends = read_ends(path, skeleton)
        labels += own
        videos += [path.stem] * len(own)
        parts.append(ends)
        frames.append(np.arange(len(own)))
    fields = one_individual(np.concatenate(parts), labels)
    return Recording(
        name=str(motions[0]) if len(motions) == 1 else str(motions[0].parent),
        video=motions[0].stem,
        **fields | {"frames": np.concatenate(frames), "videos": videos},
        landmark_names=names,
        unit=first.unit,
        edges=edges,
    )


def find_skeleton(motion: Path, given: list[Path]) -> Path:
    """Return the skeleton of a motion. Raises InputError where there is none, or several are."""
    beside = sorted(p for p in motion.parent.iterdir() if p.suffix.lower() == SKELETON)
    for paths in (given, beside):
        named = [path for path in paths if motion.stem.startswith(path.stem)]
        if named:
            return max(named, key=lambda path: len(path.stem))
        if len(paths) == 1:
            return paths[0]
    if not beside:
        found = "there is no ASF file in its folder"
        raise input_error(motion, found, "put the skeleton beside the motion")
    found = f"none of the ASF files in its folder is named like it ({listed(map(str, beside))})"
    raise input_error(motion, found, "give the right one with it, or rename it")


SAME_BONES = "give a whole file; every frame must list the same bones"
OTHER_SKELETON = "give the ASF file of this motion"

Line = tuple[int, list[str]]
"""The number of a line, and its words."""


def read_ends(path: Path, skeleton: Skeleton) -> tuple[list[str], Floats]:
    """Return the labels of the frames of a motion, and the ends (n, bones, 3) of all bones.

    Raises InputError, naming the line, for frames that list other bones than the first.
    """
    texts = read_lines(path)
    settings = {line.strip().upper() for line in texts[:HEAD_LINES]}
    degrees = ":DEGREES" in settings or (":RADIANS" not in settings and skeleton.degrees)
    labels: list[str] = []
    rows: list[Line] = []
    size = 0
    for line, text in enumerate(texts, 1):
        words = text.split()
        if not words or words[0][0] in "#:":
            continue
        if len(words) > 1 or not words[0].isdigit():
            if not labels:
                found = f"{text.strip()[:40]!r} stands before the first frame"
                raise input_error(f"{path}:{line}", found, "number every frame")
            rows.append((line, words))
            continue
        if len(labels) == 1:
            size = len(rows)
        labels.append(words[0])
    if not rows:
        return [], np.empty((0, len(skeleton.bones), 3))
    size = size or len(rows)
    _check_bones(path, rows, size, len(labels))
    values = [np.zeros((len(labels), len(bone.motion))) for bone in skeleton.bones]
    index = {bone.name: number for number, bone in enumerate(skeleton.bones)}
    for place in range(size):
        own = rows[place::size]
        name = own[0][1][0]
        if name not in index:
            found = f"the skeleton has no bone {name!r} ({abbreviate([*index])})"
            raise input_error(f"{path}:{own[0][0]}", found, OTHER_SKELETON)
        values[index[name]] = _numbers(path, skeleton.bones[index[name]], degrees, own)
    return labels, find_ends(skeleton, values)


def _check_bones(path: Path, rows: list[Line], size: int, frames: int) -> None:
    """Raise InputError where a frame lists other bones than the first, which has `size`."""
    names = [words[0] for _, words in rows[:size]]
    for place, (line, words) in enumerate(rows):
        if words[0] != names[place % size]:
            found = f"{words[0]!r} stands where other frames have {names[place % size]!r}"
            raise input_error(f"{path}:{line}", found, SAME_BONES)
    if len(rows) != size * frames:
        found = "the last frame lacks bones, or has too many"
        raise input_error(f"{path}:{rows[-1][0]}", found, SAME_BONES)


def _numbers(path: Path, bone: Bone, degrees: bool, rows: list[Line]) -> Floats:
    """Return what moves a bone (n, m), angles in radians, from its line in every frame."""
    for line, words in rows:
        if len(words) - 1 != len(bone.motion):
            there = counted(len(words) - 1, "number")
            found = f"{there} for the {len(bone.motion)} degrees of freedom of {bone.name}"
            raise input_error(f"{path}:{line}", found, OTHER_SKELETON)
    if not bone.motion:
        return np.zeros((len(rows), 0))
    lines, cells = zip(*((line, words[1:]) for line, words in rows), strict=True)
    numbers = read_table(cells, lines, path, finite=True)
    return np.where(
        [is_turn and degrees for is_turn, _ in bone.motion], np.radians(numbers), numbers
    )


def find_ends(skeleton: Skeleton, values: list[Floats]) -> Floats:
    """Return the ends (n, bones, 3) of all bones in the unit of the skeleton.

    values has for each bone the numbers (n, m) of its degrees of freedom, angles in radians.

    R = R_parent C M C^T, x = x_parent + R offset: C is the frame of the bone, M its motion, whose
    first angle turns first.
    """
    n = len(values[0])
    ends = np.empty((n, len(skeleton.bones), 3))
    rotations: dict[int, Floats] = {}
    for number in skeleton.walk:
        bone, moved = skeleton.bones[number], values[number]
        turned = [(axis, column) for column, (is_turn, axis) in enumerate(bone.motion) if is_turn]
        angles = moved[:, [column for _, column in reversed(turned)]]
        motion = rotation_about_axes([axis for axis, _ in reversed(turned)], angles)
        local = bone.axis @ motion @ bone.axis.T
        shift = np.zeros((n, 3))
        for column, (is_turn, axis) in enumerate(bone.motion):
            if not is_turn:
                shift[:, axis] += moved[:, column]
        parent = skeleton.parents[number]
        if parent < 0:
            rotations[number] = local
            ends[:, number] = bone.offset + shift
            continue
        rotations[number] = rotations[parent] @ local
        reach = (rotations[number] @ bone.offset[:, None])[..., 0]
        ends[:, number] = ends[:, parent] + (rotations[parent] @ shift[..., None])[..., 0] + reach
    return skeleton.scale * ends

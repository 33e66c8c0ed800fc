"""ASF: the bones of a body in the format of Acclaim."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from shapefit.arrays import Floats
from shapefit.errors import abbreviate, input_error
from shapefit.geometry.rotations import turns
from shapefit.io.layout import UNKNOWN_UNIT
from shapefit.io.motion.text import read_blocks, read_words

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
    for first, lines in read_blocks(path):
        for number, line in enumerate(lines, first):
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
    return turns([AXES[a] for a in reversed(letters)], np.radians(found) if degrees else found)


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

"""Trees of joints that turn: BVH, and ASF/AMC of Acclaim."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from shapefit.arrays import Floats
from shapefit.errors import abbreviate, input_error
from shapefit.io.formats import Head
from shapefit.io.layout import UNKNOWN_UNIT
from shapefit.io.readers.poses import (
    FormatError,
    Poses,
    check_names,
    check_rate,
    frames_of_labels,
    number_repeats,
    parsing,
    poses_from_frames,
    require,
)
from shapefit.io.readers.text import parse_floats, read_table, read_text

Channel = tuple[bool, int]  # whether it is a rotation, and its axis


@dataclass(eq=False)
class Joint:
    """A joint, or the end of a bone, which turns about `axes` (3, 3), its last channel
    first.

    before (3,) leads from the parent to where it turns, in the frame of the parent, and
    after (3,) from there to its position, in its own.
    """

    name: str
    parent: int
    before: Floats = field(default_factory=lambda: np.zeros(3))
    after: Floats = field(default_factory=lambda: np.zeros(3))
    axes: Floats = field(default_factory=lambda: np.eye(3))
    channels: Sequence[Channel] = ()


def place_joints(joints: Sequence[Joint], values: Floats) -> Floats:
    """Compute the positions (n, joints, 3) of joints from values (n, c) of channels.

    x = x_parent + R_parent (before + shift) + R after, with R = R_parent C M C^T: C is
    the frame of the joint, M turns by its channels, and shift moves by them. values (n,
    c) are those of all channels, joint by joint, angles in degrees.
    """
    from scipy.spatial.transform import Rotation

    n = len(values)
    starts = np.cumsum([0, *(len(joint.channels) for joint in joints)])
    positions = np.zeros((n, len(joints), 3))
    rotations: dict[int, Floats] = {-1: np.eye(3)}
    for number in _parents_first([joint.parent for joint in joints]):
        joint = joints[number]
        before = np.tile(joint.before, (n, 1))
        motion = np.eye(3)
        columns = values[:, starts[number] : starts[number + 1]]
        for (turns, axis), value in zip(joint.channels, columns.T, strict=True):
            if turns:
                turn = Rotation.from_euler("xyz"[axis], value[:, None], degrees=True)
                motion = motion @ turn.as_matrix()
            else:
                before[:, axis] += value
        above = rotations[joint.parent]
        rotations[number] = above @ joint.axes @ motion @ joint.axes.T
        positions[:, number] = (above @ before[..., None])[..., 0] + rotations[
            number
        ] @ joint.after
        if joint.parent >= 0:
            positions[:, number] += positions[:, joint.parent]
    return positions


def _parents_first(parents: Sequence[int]) -> list[int]:
    """Return the indices of joints in an order where each follows its parent.

    A root has the parent -1; joints that no root leads to are left out.
    """
    order = [number for number, parent in enumerate(parents) if parent < 0]
    for number in order:
        order += [child for child, parent in enumerate(parents) if parent == number]
    return order


CHANNELS = {"rotation": True, "position": False, "r": True, "t": False}


def _parse_channel(axis: str, kind: str) -> Channel:
    """Convert axis and kind of a channel, Xrotation of BVH or rx of ASF, to a Channel.

    Raises FormatError for other axes and kinds.
    """
    exists = axis.lower() in tuple("xyz") and kind.lower() in CHANNELS
    require(exists, f"there is no channel {axis + kind!r}, as Xrotation or rx")
    return CHANNELS[kind.lower()], "xyz".index(axis.lower())


# BVH


def is_bvh(head: Head) -> bool:
    """Whether a text begins with HIERARCHY and ROOT, as files of BVH do."""
    return head.text.upper().split(maxsplit=2)[:2] == [b"HIERARCHY", b"ROOT"]


def read_bvh(paths: tuple[Path, ...]) -> Poses:
    """Read the joints of a BVH file as landmarks, in its unit, and the ends of bones.

    These come last, and are called `JOINT_end`.
    """
    path = paths[0]
    text = read_text(path)
    joints, lines, announced, seconds = _read_hierarchy(path, text)
    motion = _read_channels(path, text, joints, lines)
    rate = _frame_rate(seconds)
    is_known, notes = check_rate(rate)
    lost = announced - len(motion)
    if lost > 0:
        missing = f"{lost} frames are announced in the header, but not there"
        notes = (missing, *notes)
    order = sorted(range(len(joints)), key=lambda number: not joints[number].channels)
    place = {old: number for number, old in enumerate(order)}
    return poses_from_frames(
        path,
        place_joints(joints, motion)[:, order],
        video=path.stem,
        landmark_names=number_repeats([joints[number].name for number in order]),
        frame_rate=rate if is_known else None,
        notes=notes,
        edges=tuple(
            (place[j.parent], place[i]) for i, j in enumerate(joints) if j.parent >= 0
        ),
    )


def _read_hierarchy(path: Path, text: str) -> tuple[list[Joint], int, int, float]:
    """Read BVH up to its motion: joints, number of lines, of frames, seconds per frame.

    Ends of bones are joints without channels. Raises InputError, naming the line.
    """
    announced = 0
    joints: list[Joint] = []
    above: list[int] = []
    for number, line in enumerate(text.split("\n"), 1):
        word, *rest = line.replace("{", " ").replace("}", " ").split() or [""]
        key = word.upper()
        parent = above[-1] if above else -1
        with parsing(f"{path}:{number}", "BVH", "correct it"):
            if key in ("ROOT", "JOINT", "END"):
                fits = (parent < 0) == (key == "ROOT")
                require(fits, f"{key} stands in the wrong place")
                above.append(len(joints))
                name = f"{joints[parent].name}_end" if key == "END" else " ".join(rest)
                joints.append(Joint(name, parent))
            elif key in ("OFFSET", "CHANNELS") and not above:
                raise FormatError(f"{key} stands outside of a joint")
            elif key == "OFFSET":
                joints[above[-1]].before = np.array(parse_floats(rest, 3))
            elif key == "CHANNELS":
                channels = [_parse_channel(name[:1], name[1:]) for name in rest[1:]]
                count = f"{' '.join(rest[:1])} channels, and {len(channels)} names"
                require(rest[:1] == [str(len(channels))], count)
                joints[above[-1]].channels = channels
            elif key == "FRAME" and rest and rest[0].upper() == "TIME:":
                require(joints and not above, "the tree of joints is not complete")
                for joint in joints:
                    # a channel of position replaces the offset along its axis
                    moved = [axis for turns, axis in joint.channels if not turns]
                    joint.before[moved] = 0
                return joints, number, announced, parse_floats(rest[1:2], 1)[0]
            elif key == "FRAMES:":
                announced = int(max(parse_floats(rest[:1], 1)[0], 0))
            else:
                exists = key in ("", "HIERARCHY", "MOTION")
                require(exists, f"begins with {word!r}, which is no word of BVH")
        if "}" in line and above:
            del above[-line.count("}") :]
    raise input_error(
        path, "has no motion, or is cut off before it", "give a complete BVH file"
    )


def _read_channels(
    path: Path, text: str, joints: Sequence[Joint], lines: int
) -> Floats:
    """Read the values (n, c) of all joints' channels, which begin after `lines` lines.

    Raises InputError or FormatError for cells that are no numbers.
    """
    channels = [joint.name for joint in joints for _ in joint.channels]
    rows = "\n".join(" ".join(line.split()) for line in text.split("\n"))
    table = read_table(path, rows, channels, " ", after=lines)
    motion = table.numbers(range(len(channels)), finite=True)
    require(not np.isnan(motion).any(), "a channel is no number")
    return motion


def _frame_rate(seconds: float) -> float | None:
    """Return the frame rate in Hz for the seconds of a frame; None for 0 seconds."""
    if not seconds > 0:  # of nan neither
        return None
    rate = 1.0 / seconds
    if rate > 1 and abs(rate - round(rate)) < 1e-3 * rate:
        return float(round(rate))  # the time was rounded: 0.033333 s is 30 Hz
    return rate


# ASF/AMC, of Acclaim


def is_acclaim(head: Head) -> bool:
    """Whether a file named .asf or .amc begins with a section or a comment."""
    return head.has_suffix(".asf", ".amc") and head.text.lstrip()[:1] in (b":", b"#")


INCH = 0.0254

BoneBlock = dict[str, list[str]]
"""The words of each line of a bone, by the first."""

WHOLE_FILE = "give whole files, in which every frame lists the bones of the skeleton"


def read_acclaim(paths: tuple[Path, ...]) -> Poses:
    """Read an AMC motion; its landmarks are the root and the ends of the ASF's bones.

    The skeleton lies in its folder, and is named as the motion begins (86.asf,
    86_01.amc), or is the only one. Raises FormatError where there is none, or several
    are.
    """
    path = paths[0]
    require(
        path.suffix.lower() == ".amc", "a skeleton without a motion; give the AMC file"
    )
    skeletons = [
        file for file in path.parent.iterdir() if file.suffix.lower() == ".asf"
    ]
    named = [file for file in skeletons if path.stem.startswith(file.stem)]
    problem = f"none of the {len(skeletons)} skeletons beside it is named like it"
    require(named or len(skeletons) == 1, problem)
    bones, unit, scale = _read_asf_skeleton(
        max(named or skeletons, key=lambda file: len(file.stem))
    )
    labels, values = _read_motion(path, bones)
    return poses_from_frames(
        path,
        scale * place_joints(bones, values),
        labels=labels,
        frames=frames_of_labels(labels),
        video=path.stem,
        landmark_names=tuple(bone.name for bone in bones),
        unit=unit,
        edges=tuple(
            (bone.parent, i) for i, bone in enumerate(bones) if bone.parent >= 0
        ),
    )


def _read_asf_skeleton(path: Path) -> tuple[list[Joint], str, float]:
    """Read an ASF file: bones, root first, a unit, and the factor from lengths to it.

    Lengths are in inches / `length`, as in CMU's database (0.45): the factor turns them
    into metres. With `length 1` their unit is unknown. Raises InputError, naming the
    line.
    """
    units, blocks, links = _read_asf_sections(path)
    bones = []
    for number, block in blocks:
        with parsing(f"{path}:{number}", "a bone of ASF", WHOLE_FILE):
            bones.append(_parse_bone(block))
    with parsing(path, "ASF", WHOLE_FILE):
        require(units.get("angle", "deg").startswith("deg"), "angles in radians")
        check_names([bone.name for bone in bones], "bone")
        (length,) = parse_floats([units.get("length", "1")])
        require(length > 0, f"the unit of length {length:g}")
        _set_parents(bones, links)
    if length == 1:
        return bones, UNKNOWN_UNIT, 1.0
    return bones, "m", INCH / length


def _read_asf_sections(
    path: Path,
) -> tuple[dict[str, str], list[tuple[int, BoneBlock]], list[list[str]]]:
    """Split an ASF file into units, blocks of bones, and lines of its hierarchy.

    A block has the number of its line beside it, that of the root comes first; a line
    of the hierarchy names a bone and its children.
    """
    units: dict[str, str] = {}
    root: BoneBlock = {
        "name": ["root"],
        "dof": ["TX", "TY", "TZ", "RX", "RY", "RZ"],
        "axis": [],
        "position": ["0"] * 3,
        "orientation": ["0"] * 3,
    }
    blocks = [(1, root)]
    links: list[list[str]] = []
    section = ""
    for number, line in enumerate(read_text(path).split("\n"), 1):
        word, *rest = line.split("#")[0].split() or [""]
        key = word.lower()
        if key.startswith(":"):
            section = key
        elif key == "begin" and section == ":bonedata":
            blocks.append((number, {"dof": []}))
        elif key in ("begin", "end", ""):
            continue
        elif section == ":units":
            units[key] = (rest or [word])[-1].lower()
        elif section in (":root", ":bonedata"):
            block = blocks[0 if section == ":root" else -1][1]
            block["dof" if key == "order" else key] = rest
        elif section == ":hierarchy":
            links.append([word, *rest])
    return units, blocks, links


def _parse_bone(block: BoneBlock) -> Joint:
    """Make a Joint, without a parent yet, of the block of a bone or root in ASF.

    A root's place is where it turns; the first angle of a joint turns first. Raises
    FormatError for bones that are not whole.
    """
    from scipy.spatial.transform import Rotation

    lacking = {"name", "axis"} - {key for key, words in block.items() if words}
    lacking -= {"axis"} & block.keys()
    if "orientation" not in block:
        lacking |= {"direction", "length"} - block.keys()
    require(not lacking, f"there is no {abbreviate(sorted(lacking))}")
    before = np.zeros(3)
    after = np.zeros(3)
    turn = block["axis"]
    if "orientation" in block:
        turn = [*block["orientation"], *turn]
        before = np.array(parse_floats(block["position"], 3))
    else:
        direction = np.array(parse_floats(block["direction"], 3))
        after = direction * parse_floats(block["length"], 1)[0]
    angles = parse_floats(turn[:3], 3)
    letters = (turn[3:] or ["XYZ"])[0].lower()
    ordered = sorted(letters) == ["x", "y", "z"]
    require(
        ordered, f"the order of axes {letters!r}, not XYZ or another of these three"
    )
    axes = Rotation.from_euler(letters, angles, degrees=True).as_matrix()
    channels = [_parse_channel(name[1:], name[:1]) for name in reversed(block["dof"])]
    return Joint(block["name"][0], -1, before, after, axes, channels)


def _set_parents(bones: Sequence[Joint], links: Sequence[Sequence[str]]) -> None:
    """Set the parents of bones by `links`, each the names of a bone and its children.

    Raises FormatError where these do not reach every bone once.
    """
    index = {bone.name: number for number, bone in enumerate(bones)}
    unknown = [name for link in links for name in link if name not in index]
    require(not unknown, f"a hierarchy of unknown bones ({abbreviate(unknown)})")
    pairs = [(index[above], index[name]) for above, *below in links for name in below]
    for above, child in pairs:
        bones[child].parent = above
    reached = len(_parents_first([bone.parent for bone in bones])) == len(bones)
    whole = len(bones) > 1 and reached and len(pairs) == len(bones) - 1
    require(whole, "the hierarchy does not reach every bone once")


def _read_motion(path: Path, bones: Sequence[Joint]) -> tuple[list[str], Floats]:
    """Read an AMC file: labels of frames, and values (n, c) of all bones' channels.

    A bone that no frame lists does not move. Raises InputError, naming the line, for
    other bones or channels than the skeleton has.
    """
    labels: list[str] = []
    cells = {bone.name: list[str]() for bone in bones}
    count = {bone.name: len(bone.channels) for bone in bones}
    for line, words in enumerate(map(str.split, read_text(path).split("\n")), 1):
        require(words != [":RADIANS"], "angles in radians")
        name, *row = words or ["#"]
        if name.isascii() and name.isdecimal() and not row:
            labels.append(name)
        elif name[0] not in "#:":
            if len(row) != count.get(name) or len(cells[name]) != len(row) * (
                len(labels) - 1
            ):
                problem = (
                    f"{len(row)} numbers of {name!r}, not {count.get(name, 0)} in each"
                    " frame"
                )
                raise input_error(f"{path}:{line}", problem, WHOLE_FILE)
            cells[name] += reversed(row)
    require(labels, "no frames")
    sizes = [(bone.name, len(labels) * count[bone.name]) for bone in bones]
    values = [
        np.array(parse_floats(cells[name] or ["0"] * size, size))
        for name, size in sizes
    ]
    return labels, np.hstack([block.reshape(len(labels), -1) for block in values])

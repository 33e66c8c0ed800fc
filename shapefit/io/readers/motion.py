"""Motion capture: the trees of joints of BVH and ASF/AMC, and C3D, which ezc3d reads."""

from __future__ import annotations

import os
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from shapefit.arrays import Floats
from shapefit.errors import abbreviate, counted, input_error, listed
from shapefit.geometry.normalisation import as_metres
from shapefit.io.inputs import check_fits
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
    from there to its position, in its own; axes (3, 3) is the frame in which it turns. Of its
    channels the last one turns first.
    """

    name: str
    parent: int
    before: Floats = field(default_factory=lambda: np.zeros(3))
    after: Floats = field(default_factory=lambda: np.zeros(3))
    axes: Floats = field(default_factory=lambda: np.eye(3))
    channels: Sequence[Channel] = ()


def forward_kinematics(joints: Sequence[Joint], values: Floats, *, degrees: bool) -> Floats:
    """x = x_parent + R_parent (before + shift) + R after, with R = R_parent C M C^T.

    values (n, c) are those of all channels, joint by joint; returns positions (n, joints, 3). C is
    the frame of the joint, M turns by its channels, and shift moves by them.
    """
    from scipy.spatial.transform import Rotation

    n = len(values)
    starts = np.cumsum([0, *(len(joint.channels) for joint in joints)])
    positions = np.zeros((n, len(joints), 3))
    rotations: dict[int, Floats] = {-1: np.eye(3)}
    for number in _parents_first([joint.parent for joint in joints]):
        joint = joints[number]
        before, motion = np.tile(joint.before, (n, 1)), np.eye(3)
        columns = values[:, starts[number] : starts[number + 1]]
        for column, (turns, axis) in enumerate(joint.channels):
            value = columns[:, column]
            if turns:
                turn = Rotation.from_euler("xyz"[axis], value[:, None], degrees)
                motion = motion @ turn.as_matrix()
            else:
                before[:, axis] += value
        above = rotations[joint.parent]
        rotations[number] = above @ joint.axes @ motion @ joint.axes.T
        positions[:, number] = (above @ before[..., None])[..., 0] + rotations[number] @ joint.after
        if joint.parent >= 0:
            positions[:, number] += positions[:, joint.parent]
    return positions


def _parents_first(parents: Sequence[int]) -> list[int]:
    """Return the joints of a tree, or of a part of it, each after its parent, -1 for none."""
    order = [number for number, parent in enumerate(parents) if parent < 0]
    for number in order:
        order += [child for child, parent in enumerate(parents) if parent == number]
    return order


# BVH


def read_bvh(paths: tuple[Path, ...]) -> Poses:
    """Return the joints of a BVH file, in its unit, and then the ends of the last bones.

    The end of joint J is `J_end`. Raises InputError for a tree or a motion that cannot be read.
    """
    path = paths[0]
    text = read_text(path)
    joints, ends, lines, frames, seconds = _read_hierarchy(path, text)
    table = Table(path, None, text)
    table.skip(lines, [joint.name for joint in joints for _ in joint.channels])
    motion, _, _ = table.read(range(len(table.names)), finite=True, empty=False)
    order = sorted(range(len(joints)), key=lambda number: number in ends)
    names, notes = make_unique([joints[number].name for number in order])
    if len(motion) < frames:
        notes += (f"{frames - len(motion)} frames are announced, but not there",)
    rate = 1.0 / seconds if seconds > 0 else None
    if rate is not None and rate > 1 and abs(rate - round(rate)) < 1e-3 * rate:
        rate = float(round(rate))  # the time was rounded: 0.033333 s is 30 Hz
    new = {old: number for number, old in enumerate(order)}
    return of_frames(
        path,
        forward_kinematics(joints, motion, degrees=True)[:, order],
        video=path.stem,
        landmark_names=names,
        frame_rate=rate,
        edges=tuple((new[j.parent], new[i]) for i, j in enumerate(joints) if j.parent >= 0),
        notes=notes,
    )


def _read_hierarchy(path: Path, text: str) -> tuple[list[Joint], set[int], int, int, float]:
    """Return the joints, which of them are ends, the lines before the motion, frames, and seconds.

    Raises InputError, naming the line.
    """
    joints: list[Joint] = []
    above: list[int] = []
    ends: set[int] = set()
    frames = -1
    for number, line in enumerate(text.split("\n"), 1):
        word, *rest = line.replace("{", " ").replace("}", " ").split() or [""]
        key = word.upper()
        parent = above[-1] if above else -1
        with parsing(f"{path}:{number}", "correct it"):
            if key in ("ROOT", "JOINT", "END"):
                require((parent < 0) == (key == "ROOT"), f"{key} stands in the wrong place")
                above.append(len(joints))
                ends |= {len(joints)} if key == "END" else set()
                name = f"{joints[parent].name}_end" if key == "END" else " ".join(rest)
                joints.append(Joint(name, parent))
            elif key in ("OFFSET", "CHANNELS"):
                require(above, f"{key} belongs to no joint")
                if key == "OFFSET":
                    joints[parent].before = np.array(_words(rest, 3))
                else:
                    joints[parent].channels = channels = [_channel(name) for name in rest[1:]]
                    given = f"{' '.join(rest[:1])} channels, and {len(channels)} names"
                    require(rest[:1] == [str(len(channels))], given)
            elif key == "FRAMES:":
                frames = int(_words(rest[:1], 1)[0])
            elif key == "FRAME" and rest[:1] == ["Time:"]:
                require(joints and not above, "the tree of joints is not complete")
                for joint in joints:  # a channel of position replaces the offset along its axis
                    joint.before[[axis for turns, axis in joint.channels if not turns]] = 0
                return joints, ends, number, frames, _words(rest[1:2], 1)[0]
            else:
                known = key in ("", "HIERARCHY", "MOTION")
                require(known, f"begins with {word!r}, which is no word of BVH")
        if "}" in line and above:
            del above[-line.count("}") :]
    raise input_error(path, "has no motion, or is cut off before it", "give a complete BVH file")


def _channel(name: str) -> Channel:
    axis, kind = "xyz".find(name[:1].lower()), name[1:].lower()
    known = axis >= 0 and kind in ("rotation", "position")
    require(known, f"there is no channel {name!r}, as Xrotation or Yposition")
    return kind == "rotation", axis


# ASF/AMC, of Acclaim

INCH = 0.0254

HEAD_LINES = 100
"""Within which a motion says whether its angles are degrees."""

WHOLE_SKELETON = "give a whole ASF file"
SAME_BONES = "give a whole file, in which every frame lists the same bones, and its own ASF file"


class Skeleton(NamedTuple):
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
    motions = [path for path in paths if path.suffix.lower() == ".amc"]
    if not motions:
        found = "is a skeleton without a motion"
        raise input_error(paths[0], found, "give the AMC file of the motion")
    given = [path for path in paths if path.suffix.lower() == ".asf"]
    skeletons = [_read_skeleton(_find_skeleton(path, given)) for path in motions]
    first = skeletons[0]
    names = [bone.name for bone in first.bones]
    parts = []
    for path, skeleton in zip(motions, skeletons, strict=True):
        if [bone.name for bone in skeleton.bones] != names or skeleton.unit != first.unit:
            found = f"has another skeleton than {motions[0]}"
            raise input_error(path, found, "convert them one by one")
        parts.append(_read_motion(path, skeleton))
    return of_frames(
        motions[0] if len(motions) == 1 else motions[0].parent,
        np.concatenate([ends for _, ends in parts]),
        labels=[label for labels, _ in parts for label in labels],
        video=[path.stem for path, own in zip(motions, parts, strict=True) for _ in own[0]],
        frame=np.concatenate([np.arange(len(labels)) for labels, _ in parts]),
        landmark_names=tuple(names),
        unit=first.unit,
        edges=tuple((b.parent, i) for i, b in enumerate(first.bones) if b.parent >= 0),
    )


def _find_skeleton(motion: Path, given: list[Path]) -> Path:
    """Return the skeleton of a motion. Raises InputError where there is none, or several are."""
    beside = sorted(p for p in motion.parent.iterdir() if p.suffix.lower() == ".asf")
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
    root = {"name": ["root"], "dof": ["TX", "TY", "TZ", "RX", "RY", "RZ"], "axis": []}
    root |= {"position": ["0"] * 3, "orientation": ["0"] * 3}
    blocks: list[tuple[str, dict[str, list[str]]]] = [(f"{path}: root", root)]
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
            block = blocks[0 if section == ":root" else -1][1]
            block["dof" if key == "order" else key] = rest
        elif section == ":hierarchy":
            links.append((number, [word, *rest]))
    degrees = not units.get("angle", "deg").startswith("rad")
    bones = []
    for place, block in blocks:
        with parsing(place, WHOLE_SKELETON):
            bones.append(_bone(block, degrees))
    _join(bones, links, path)
    with parsing(path, WHOLE_SKELETON):
        require(len(bones) > 1, "has no bones")
        (length,) = _words([units.get("length", "1")], 1)
        require(length > 0, f"has the unit of length {length:g}")
    scale, unit = (1.0, UNKNOWN_UNIT) if length == 1 else (INCH / length, "m")
    return Skeleton(bones, unit, scale, degrees)


def _bone(block: dict[str, list[str]], degrees: bool) -> Joint:
    """Return a bone, or the root, whose place is where it turns; its first angle turns first."""
    from scipy.spatial.transform import Rotation

    before, after, turn = np.zeros(3), np.zeros(3), block["axis"]
    if "orientation" in block:
        turn = [*block["orientation"], *turn]
        before = np.array(_words(block["position"], 3))
    else:
        after = np.array(_words(block["direction"], 3)) * _words(block["length"], 1)[0]
    angles, letters = _words(turn[:3], 3), (turn[3:] or ["XYZ"])[0].lower()
    require(sorted(letters) == ["x", "y", "z"], f"the axes are {letters!r}, not XYZ in any order")
    axes = Rotation.from_euler(letters, angles, degrees=degrees).as_matrix()
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
    twice = set()
    for line, words in links:
        with parsing(f"{path}:{line}", "name bones that are there"):
            above, *below = (index[word] for word in words)
        for number in below:
            if parents[number] != len(bones):
                twice.add(number)
            else:
                parents[number] = bones[number].parent = above
    lost = {*range(len(bones))} - {*_parents_first(parents)} | twice
    with parsing(path, f"correct it, or {WHOLE_SKELETON}"):
        check_names([bone.name for bone in bones], "bone")
        names = abbreviate([bones[number].name for number in sorted(lost)])
        require(not lost, f"the hierarchy does not reach every bone once ({names})")


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
    values, _ = read_numbers([cell for _, words in rows for cell in words[:0:-1]])
    if (wrong := ~np.isfinite(values)).any():
        places = [(line, cell) for line, words in rows for cell in words[:0:-1]]
        line, cell = places[int(wrong.argmax())]
        raise input_error(f"{path}:{line}", f"{cell[:40]!r} is no number", "correct it")
    starts = dict(
        zip(order, np.cumsum([0, *(count[name] for name in order)]).tolist(), strict=False)
    )
    padded = np.column_stack([values.reshape(len(labels), -1), np.zeros(len(labels))])
    columns = [
        starts[bone.name] + number if bone.name in starts else -1  # a bone that does not move
        for bone in bones
        for number in range(count[bone.name])
    ]
    ends = forward_kinematics(bones, padded[:, columns], degrees=degrees)
    return labels, skeleton.scale * ends


def _words(words: Sequence[str], count: int) -> tuple[float, ...]:
    """Return so many words as finite numbers. Raises FormatError where they are none."""
    given = f"expected {count} numbers, found {' '.join(words)[:40]!r}"
    try:
        numbers = tuple(map(float, words))
    except ValueError:
        numbers = ()
    require(len(numbers) == count and np.isfinite(numbers).all(), given)
    return numbers


# Vicon


def read_vicon(paths: tuple[Path, ...]) -> Poses:
    """Read the section `Trajectories` of a CSV that Vicon Nexus exports.

    Below it stand the rate, a label above the X of each marker, `Frame,Sub Frame,X,Y,Z,...`, the
    units, and the frames up to an empty line. An empty cell is missing.
    """
    path, fix = paths[0], "export the trajectories from Nexus again"
    lines = read_text(path).split("\n")
    firsts = [line.strip(', "\t').lower() for line in lines]
    with parsing(path, fix):
        start = firsts.index("trajectories") + 1
        rate, labels, axes, units = (line.split(",") for line in lines[start : start + 4])
        labels = [label.strip() for label in labels[2::3]]
        count = sum(axis.strip() == "X" for axis in axes)
        wanted = ["Frame", "Sub Frame", *"XYZ" * count]
        require(count > 0 and [axis.strip() for axis in axes] == wanted, "has other columns")
        factor, unit = as_metres(units[2].strip())
    end = next((n for n in range(start + 4, len(lines)) if not firsts[n]), len(lines))
    table = Table(path, ",", "\n".join(lines[:end]))
    table.skip(start + 4, ["Frame", "Sub Frame", *(f"{n}/{a}" for n in labels for a in "XYZ")])
    table.padded = True
    values, (frames,), _ = table.read(range(2, 2 + 3 * count), [0])
    points = factor * values.reshape(len(values), count, 3)
    labels = (labels + [""] * count)[:count]
    with parsing(path, fix):
        hertz = float(rate[0])
    return _of_markers(path, points, labels, frames, hertz, unit=unit or UNKNOWN_UNIT)


# C3D

BLOCK = 512
"""Bytes of a block, in which C3D counts."""

INTEL = 84
"""The processor whose numbers are written little end first, as all of today's are."""

MOST_FRAMES = 65535

EXPANDS = 16
"""Times its size that a file takes in memory, at most, while ezc3d reads it."""

COMPUTED = ("ANGLES", "FORCES", "MOMENTS", "POWERS", "SCALARS")
"""Lists of labels under POINT that are no points: what a model computed is stored beside them."""

NOBODY = "unassigned"
"""The individual that has the points without a subject, where there are several subjects."""

WHOLE = "give a whole C3D file"


def read_c3d(paths: tuple[Path, ...]) -> Poses:
    """Return the markers of a C3D file, in metres where it names its unit.

    A point is missing where its residual is negative or its place NaN. Labels `subject:name` are
    landmarks of an individual. Frames have the numbers that ezc3d gives them, one less than those
    in the header. Raises InputError where ezc3d is not installed or cannot read the file.
    """
    path = paths[0]
    _check_whole(path)
    check_fits(str(path), EXPANDS * path.stat().st_size, "what it holds")
    file = _read_c3d(path)
    parameters: Mapping[str, Any] = file["parameters"].get("POINT", {})
    points = np.asarray(file["data"]["points"], dtype=np.float64)[:3].transpose(2, 1, 0)
    residual = np.asarray(file["data"]["meta_points"]["residuals"])[0].T
    factor, unit = as_metres((_texts(parameters, "UNITS") or [""])[0])
    points = factor * np.where((residual >= 0)[..., None], points, np.nan)
    n, count, _ = points.shape
    labels = _labels(parameters, count)
    computed = set().union(*(_texts(parameters, name) for name in COMPUTED))
    left = [label for label in labels if label in computed]
    notes: tuple[str, ...] = ()
    if left:
        text = f"left out, computed by a model, not seen ({abbreviate(left)})"
        notes = (f"{counted(len(left), 'point')} {text}",)
    markers = [place for place, label in enumerate(labels) if label not in computed]
    if n == MOST_FRAMES:
        notes += (f"has {MOST_FRAMES} frames, as many as its header can count; it may hold more",)
    (rate,) = np.ravel(parameters.get("RATE", {}).get("value", ()))[:1] or [0.0]
    start = int(file["header"]["points"]["first_frame"])
    return _of_markers(
        path,
        points[:, markers],
        [labels[place] for place in markers],
        [str(start + frame) for frame in range(n)],
        float(rate),
        unit=unit or UNKNOWN_UNIT,
        notes=notes,
    )


def _of_markers(
    path: Path,
    points: Floats,
    labels: Sequence[str],
    frames: Sequence[str],
    rate: float,
    *,
    unit: str,
    notes: tuple[str, ...] = (),
) -> Poses:
    """Return markers (n, m, 3) of these labels; `subject:name` is a landmark of an individual."""
    names, repeated = make_unique(labels)
    individuals, landmarks, places = _by_subject(names)
    spread = np.full((len(points), max(len(individuals), 1), len(landmarks), 3), np.nan)
    for marker, (subject, landmark) in enumerate(places):
        spread[:, subject, landmark] = points[:, marker]
    return of_frames(
        path,
        spread,
        labels=frames,
        video=path.stem,
        landmark_names=landmarks,
        individuals=individuals or None,
        frame_rate=rate if np.isfinite(rate) and rate > 0 else None,
        unit=unit,
        notes=notes + repeated,
    )


def _by_subject(
    names: tuple[str, ...],
) -> tuple[tuple[str, ...], tuple[str, ...], list[tuple[int, int]]]:
    """Return individuals, landmarks, and the (individual, landmark) of every name.

    Without a subject in any name there are no individuals; with one, it has all the points.
    """
    parts = [name.rpartition(":")[::2] for name in names]
    subjects = list(dict.fromkeys(subject for subject, _ in parts if subject))
    if len(subjects) > 1 and not all(subject for subject, _ in parts):
        subjects.append(NOBODY)
    pairs = [(subject or subjects[-1], name) for subject, name in parts] if subjects else []
    if len(set(pairs)) < len(names):
        return (), names, [(0, place) for place in range(len(names))]
    landmarks = tuple(dict.fromkeys(name for _, name in pairs))
    places = [(subjects.index(subject), landmarks.index(name)) for subject, name in pairs]
    return tuple(subjects), landmarks, places


def _check_whole(path: Path) -> None:
    """Raise InputError for a file shorter than its own header says, which ezc3d may not survive."""
    size = path.stat().st_size
    with parsing(path, WHOLE), path.open("rb") as file:
        head = file.read(BLOCK)
        points, analog, first, last = struct.unpack("<HHHH", head[2:10])
        scale, start = struct.unpack("<fH", head[12:18])
        file.seek(BLOCK * (head[0] - 1))
        section = file.read(4)
        require(len(section) == 4, "is cut off before its parameters")
        frames, number_bytes = max(last - first + 1, 0), 4 if scale < 0 else 2
        needed = BLOCK * max(start - 1, 0) + frames * (4 * points + analog) * number_bytes
        whole = section[3] != INTEL or size >= needed
        require(whole, f"has {size} bytes, and its header announces {needed}")


def _read_c3d(path: Path) -> Any:
    try:
        return import_module("ezc3d").c3d(os.fspath(path))
    except ImportError as error:
        found = "is a C3D file, which ezc3d reads, and that is not installed"
        raise input_error(path, found, "run `pip install ezc3d`") from error
    except MemoryError:
        raise
    except Exception as error:  # ezc3d has many kinds of error for damaged files
        raise input_error(path, f"cannot be read by ezc3d ({error})", WHOLE) from error


def _labels(parameters: Mapping[str, Any], count: int) -> list[str]:
    """Return the labels of all points; LABELS2 and so on continue LABELS beyond 255."""
    lists = ("LABELS", *(f"LABELS{number}" for number in range(2, len(parameters))))
    labels = [label for name in lists for label in _texts(parameters, name)]
    return (labels + [""] * count)[:count]


def _texts(parameters: Mapping[str, Any], name: str) -> list[str]:
    """Return texts; where they are not UTF-8, which ezc3d leaves as bytes, they are Latin-1."""
    found = []
    for text in parameters.get(name, {}).get("value", ()):
        data = str(text).encode("utf-8", "surrogateescape")
        try:
            found.append(data.decode().strip())
        except UnicodeDecodeError:
            found.append(data.decode("latin-1").strip())
    return found

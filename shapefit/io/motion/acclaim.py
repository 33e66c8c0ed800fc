"""ASF and AMC, the motion of a skeleton in the format of Acclaim: the ends of all bones."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from shapefit.arrays import Floats
from shapefit.errors import abbreviate, counted, input_error, listed
from shapefit.geometry.rotations import turns
from shapefit.io.foreign.recording import Instances, Recording
from shapefit.io.motion.acclaim_skeleton import Skeleton, read_skeleton
from shapefit.io.motion.text import read_blocks, read_head, read_table

SKELETON, MOTION = ".asf", ".amc"

HEAD_LINES = 100
"""Within which a motion says whether its angles are degrees."""


def record(paths: tuple[Path, ...]) -> Recording:
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

    def blocks() -> Iterator[Instances]:
        for path in motions:
            yield from read_instances(path, skeletons[path])

    edges = tuple((parent, bone) for bone, parent in enumerate(first.parents) if parent >= 0)
    return Recording(
        name=str(motions[0]) if len(motions) == 1 else str(motions[0].parent),
        video=motions[0].stem,
        dimensions=3,
        landmark_count=len(names),
        landmark_names=names,
        blocks=blocks,
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


def read_instances(path: Path, skeleton: Skeleton) -> Iterator[Instances]:
    """Read the frames of a motion, block by block."""
    settings = {line.strip().upper() for line in read_head(path, HEAD_LINES)}
    degrees = ":DEGREES" in settings or (":RADIANS" not in settings and skeleton.degrees)
    done = 0
    for labels, values in read_motion(path, skeleton, degrees):
        yield Instances(
            points=find_ends(skeleton, values),
            frames=np.arange(done, done + len(labels)),
            labels=labels,
            individuals=np.zeros(len(labels), np.int64),
            videos=[path.stem] * len(labels),
        )
        done += len(labels)


Values = list[Floats]
"""Per bone the numbers (n, m) of its degrees of freedom, angles in radians; 0 where not given."""


def read_motion(
    path: Path, skeleton: Skeleton, degrees: bool
) -> Iterator[tuple[list[str], Values]]:
    """Yield the labels of frames and what moves each bone, block by block."""
    labels: list[str] = []
    rows: list[tuple[int, list[str]]] = []  # the lines of the frames: bone, then numbers
    size = 0
    for first, texts in read_blocks(path):
        for line, text in enumerate(texts, first):
            words = text.split()
            if not words or words[0][0] in "#:":
                continue
            if len(words) == 1 and words[0].isdigit():
                if len(labels) == 1:
                    size = len(rows)
                labels.append(words[0])
            elif not labels:
                found = f"{text.strip()[:40]!r} stands before the first frame"
                raise input_error(f"{path}:{line}", found, "number every frame")
            else:
                rows.append((line, words))
        whole = len(labels) - 1
        if size and whole > 0:
            yield labels[:whole], _values(path, skeleton, degrees, rows[: whole * size], whole)
            labels, rows = labels[whole:], rows[whole * size :]
    if labels and rows:
        if size and len(rows) != size * len(labels):
            fix = "give a whole file; every frame must list the same bones"
            raise input_error(f"{path}:{rows[-1][0]}", "the last frame lacks bones", fix)
        yield labels, _values(path, skeleton, degrees, rows, len(labels))


def _values(
    path: Path, skeleton: Skeleton, degrees: bool, rows: list[tuple[int, list[str]]], frames: int
) -> Values:
    """Return the numbers of some frames, whose bones all come in the same order."""
    size, rest = divmod(len(rows), frames)
    index = {bone.name: number for number, bone in enumerate(skeleton.bones)}
    values = [np.zeros((frames, len(bone.motion))) for bone in skeleton.bones]
    for place in range(size):
        lines, cells = zip(*rows[place::size], strict=True)
        lines, cells = lines[:frames], cells[:frames]
        name = cells[0][0]
        for line, words in zip(lines, cells, strict=True):
            if words[0] != name:
                found = f"{words[0]!r} stands where other frames have {name!r}"
                fix = "give a whole file; every frame must list the same bones"
                raise input_error(f"{path}:{line}", found, fix)
        if name not in index:
            found = f"the skeleton has no bone {name!r} ({abbreviate([*index])})"
            raise input_error(f"{path}:{lines[0]}", found, "give the ASF file of this motion")
        bone = skeleton.bones[index[name]]
        for line, words in zip(lines, cells, strict=True):
            if len(words) - 1 != len(bone.motion):
                there = counted(len(words) - 1, "number")
                found = f"{there} for the {len(bone.motion)} degrees of freedom of {name}"
                raise input_error(f"{path}:{line}", found, "give the ASF file of this motion")
        if bone.motion:
            numbers = read_table([words[1:] for words in cells], lines, path, finite=True)
            angles = [is_rotation and degrees for is_rotation, _ in bone.motion]
            values[index[name]] = np.where(angles, np.radians(numbers), numbers)
    if rest:
        line = rows[-1][0]
        fix = "give a whole file; every frame must list the same bones"
        raise input_error(f"{path}:{line}", "the last frame lacks bones, or has too many", fix)
    return values


def find_ends(skeleton: Skeleton, values: Values) -> Floats:
    """Return the ends (n, bones, 3) of all bones in the unit of the skeleton.

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
        motion = turns([axis for axis, _ in reversed(turned)], angles)
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

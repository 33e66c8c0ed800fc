"""Write the bones of motions: turned so that they follow the landmarks, as BVH (metres, y up)."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import orjson
from numpy.typing import NDArray

from shapefit.arrays import Floats
from shapefit.errors import abbreviate, counted, input_error
from shapefit.geometry.joint_rotations import Rig, find_rig, forward_kinematics, in_pose
from shapefit.io.skeletons import part_names
from shapefit.io.writers.motion import Motion, motion_output

MILLIMETRES = 1000.0

_SIDES = (("l", "Left"), ("r", "Right"))
_LIMBS = (
    *(("shoulder", "Arm"), ("elbow", "ForeArm"), ("wrist", "Hand")),
    *(("hip", "UpLeg"), ("knee", "Leg"), ("ankle", "Foot")),
)
_CHEST, _HEAD = ("neck", "thorax", "throat"), ("head", "crown")
_SPINE = ("spine", "middle of spine")

JOINTS: Mapping[str, str] = {
    **dict.fromkeys(("pelvis", "middle of hips"), "Hips"),
    **dict.fromkeys(_SPINE, "Spine1"),
    **dict.fromkeys(_CHEST, "Spine2"),
    **dict.fromkeys(_HEAD, "Head"),
    **{f"{s}{part}": f"{side}{joint}" for s, side in _SIDES for part, joint in _LIMBS},
    **{f"{s}ball": f"{side}ToeBase" for s, side in _SIDES},
}
"""Parts of the body -> the names by which programs that move other bodies know their joints."""

BONES: Mapping[str, str] = {
    **dict.fromkeys((*_CHEST, *_SPINE), "Spine"),
    **dict.fromkeys(_HEAD, "Neck"),
    **{f"{s}shoulder": f"{side}Shoulder" for s, side in _SIDES},
    **{f"{s}hip": f"{side}HipJoint" for s, side in _SIDES},
}
"""Parts of the body -> the same for what turns at the landmark before and leads only there."""

_ACROSS = ("shoulder", "elbow", "wrist", "hand", "knuckle", "thumb")
_FORWARD = ("toe", "big toe", "ball", "small toe")

T_POSE: Mapping[str, tuple[float, float, float]] = {
    **dict.fromkeys((*_CHEST, *_HEAD, *_SPINE), (0, 1, 0)),
    **{f"{s}{part}": (x, 0, 0) for s, x in (("l", 1), ("r", -1)) for part in _ACROSS},
    **{f"{s}hip": (x, -1, 0) for s, x in (("l", 1), ("r", -1))},
    **{f"{s}{part}": (0, -1, 0) for s in "lr" for part in ("knee", "ankle")},
    **{f"{s}{part}": (0, -0.5, 1) for s in "lr" for part in _FORWARD},
    **{f"{s}heel": (0, -1, -1) for s in "lr"},
}
"""Parts of the body -> the directions of the bones that end there, y up, in the pose in which
programs expect a body at rest: upright, seen from the front, arms to the sides."""

NEEDED = frozenset(f"{s}{part}" for s, _ in _SIDES for part, _ in _LIMBS)
"""Without all of these it is no person."""


def fit_rigs(motions: Sequence[Motion], place: str) -> tuple[list[Motion], str]:
    """Return motions without gaps, with rigs, and say how far their joints are from the landmarks.

    Raises InputError at `place` where there are no edges, or no shapes.
    """
    found = [_fit_rig(motion, place) for motion in motions]
    away = [MILLIMETRES * _distances(motion) for motion in found]
    mean, most = np.mean([each.mean() for each in away]), max(each.max() for each in away)
    accuracy = f"joints {_number(mean)} mm from the landmarks on average, {_number(most)} at most"
    return found, f"bones of one length, {accuracy}"


def _fit_rig(motion: Motion, place: str) -> Motion:
    if not len(motion.edges):
        found = "the landmarks have no edges, so there are no bones to turn"
        fix = "write TRC or C3D, or lift with a dictionary that has `edges`"
        raise input_error(place, found, fix)
    whole = _interpolate_gaps(motion, place)
    hips = [j for j, part in enumerate(_parts(whole)) if JOINTS.get(part) == "Hips"]
    rig = find_rig(whole.points, whole.edges, hips[0] if hips else None)
    known = {j: T_POSE[part] for j, part in enumerate(_parts(whole)) if part in T_POSE}
    return replace(whole, rig=in_pose(rig, known) if known else rig)


def _distances(motion: Motion) -> Floats:
    """Return how far each node (m, f) is from its landmark."""
    assert motion.rig is not None
    joints = motion.points[:, :, [node.joint for node in motion.rig.tree]].transpose(2, 0, 1)
    distances: Floats = np.linalg.norm(forward_kinematics(motion.rig) - joints, axis=2)
    return distances


def node_names(motion: Motion) -> tuple[str, ...]:
    """Name each node of a rig by its landmark; one that only leads to another, by both."""
    assert motion.rig is not None
    parts, tree, names = _parts(motion), motion.rig.tree, dict[str, None]()
    for node in tree:
        landmark = motion.landmark_names[node.joint]
        name = JOINTS.get(parts[node.joint], landmark)
        if node.above >= 0 and tree[node.above].joint == node.joint:
            (end,) = node.aims
            name = BONES.get(parts[end], f"{name}_{motion.landmark_names[end]}")
        name = re.sub(r"[\s{}]+", "_", name)
        while name in names:
            name += "_"
        names[name] = None
    return tuple(names)


def _parts(motion: Motion) -> list[str]:
    """Return the part of the body that each landmark of a person marks; "" for all of others."""
    known = part_names(motion.landmark_names)
    person = set(known.values()) >= NEEDED
    return [known.get(name, "") if person else "" for name in motion.landmark_names]


def _number(millimetres: float) -> str:
    small = ".1g" if 1e-4 < millimetres < 0.1 else ".1f"  # a fly is .2 mm long
    return format(millimetres, ".0f" if millimetres >= 10 else small)


def _interpolate_gaps(motion: Motion, place: str) -> Motion:
    """Return a motion of what was placed at all, over gaps in a straight line."""
    visible: NDArray[np.bool_] = np.asarray(np.isfinite(motion.points).all(axis=1))
    ever: NDArray[np.bool_] = np.asarray(visible.any(axis=0))
    column = np.cumsum(ever) - 1
    edges = column[motion.edges[ever[motion.edges].all(axis=1)]]
    if not len(edges):
        found = "no two landmarks of an edge have a place in any frame"
        raise input_error(place, found, "give a sequence with shapes")
    points, frames = motion.points[:, :, ever], np.arange(len(motion.points))
    for j, own in enumerate(visible.T[ever]):
        for axis in range(3) if not own.all() else ():
            points[:, axis, j] = np.interp(frames, frames[own], points[own, axis, j])
    names = tuple(np.array(motion.landmark_names, dtype=object)[ever])
    absent = [name for name in motion.landmark_names if name not in names]
    gaps = int((~visible[:, ever]).any(axis=1).sum())
    warnings = (
        *((f"{abbreviate(absent)} never have a place: left out",) if absent else ()),
        *(
            (f"{counted(gaps, 'frame')} with gaps, which are bridged in straight lines",)
            if gaps
            else ()
        ),
    )
    return replace(
        motion,
        points=points,
        landmark_names=names,
        edges=edges,
        warnings=(*motion.warnings, *warnings),
    )


TIP = 0.25
"""Length of what follows the last joint of a limb, in bones before it: there has to be an end."""

DECIMALS = 6
"""Of metres and degrees."""

TURNS = "Zrotation Xrotation Yrotation"


def write_bvh(path: Path, motion: Motion) -> None:
    """Write one motion; the first frame of the file is the first of the motion."""
    assert motion.rig is not None
    angles = np.concatenate(np.degrees(find_angles(motion.rig.rotations)), axis=1)
    table = np.hstack([motion.rig.root, angles]).round(DECIMALS)
    text = orjson.dumps(table, option=orjson.OPT_SERIALIZE_NUMPY)[2:-2]
    with path.open("wb") as file:
        file.write("".join(f"{line}\n" for line in _header(motion, motion.rig)).encode())
        file.write(text.replace(b"],[", b"\n").replace(b",", b" ") + b"\n")


bvh_output = motion_output(write_bvh, prepare=fit_rigs)


def find_angles(rotations: Floats) -> Floats:
    """R = R_z(a) R_x(b) R_y(c): angles (m, f, 3), in radians, of rotations (m, f, 3, 3).

    They change as little as can be from frame to frame: a, b, c and a + pi, pi - b, c + pi are one
    rotation, and so are angles that differ by 2 pi.
    """
    R = rotations
    a, b, c = (
        np.arctan2(-R[..., 0, 1], R[..., 1, 1]),
        np.arcsin(np.clip(R[..., 2, 1], -1, 1)),
        np.arctan2(-R[..., 2, 0], R[..., 2, 2]),
    )
    one, other = np.stack([a, b, c], axis=-1), np.stack([a + np.pi, np.pi - b, c + np.pi], axis=-1)

    def way(start: Floats, end: Floats) -> Floats:
        turn = (end - start + np.pi) % (2 * np.pi) - np.pi
        return np.abs(turn).sum(axis=-1)

    nearer = way(one[:, :-1], other[:, 1:]) < way(one[:, :-1], one[:, 1:])
    changed = np.cumsum(nearer, axis=1) % 2 == 1
    one[:, 1:][changed] = other[:, 1:][changed]
    return np.unwrap(one, axis=1)


def _header(motion: Motion, rig: Rig) -> Iterator[str]:
    yield "HIERARCHY"
    depth = [0]
    for number, (node, name) in enumerate(zip(rig.tree, node_names(motion), strict=True)):
        if number:
            depth.append(depth[node.above] + 1)
        for level in range(depth[number - 1], depth[number] - 1, -1) if number else ():
            yield "\t" * level + "}"
        tabs, inner = "\t" * depth[number], "\t" * (depth[number] + 1)
        yield f"{tabs}JOINT {name}" if number else f"ROOT {name}"
        yield tabs + "{"
        yield f"{inner}OFFSET {_triple(rig.offsets[number])}"
        places = "" if number else "Xposition Yposition Zposition "
        yield f"{inner}CHANNELS {len(f'{places}{TURNS}'.split())} {places}{TURNS}"
        if not node.aims:
            yield f"{inner}End Site"
            yield inner + "{"
            yield f"{inner}\tOFFSET {_triple(TIP * rig.offsets[number])}"
            yield inner + "}"
    for level in range(depth[-1], -1, -1):
        yield "\t" * level + "}"
    yield "MOTION"
    yield f"Frames: {len(motion.points)}"
    yield f"Frame Time: {1 / motion.rate:.10g}"


def _triple(vector: Floats) -> str:
    return " ".join(f"{x:.{DECIMALS}f}" for x in vector)

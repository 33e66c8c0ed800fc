"""Write BVH, the tree of joints and their angles that programs of animation read: metres, y up."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import orjson

from shapefit.arrays import Floats
from shapefit.geometry.joint_rotations import Rig
from shapefit.io.written.motion import Motion
from shapefit.io.written.outputs import by_individual, motion_output
from shapefit.io.written.rig import node_names, rigged

TIP = 0.25
"""Length of what follows the last joint of a limb, in bones before it: there has to be an end."""

DECIMALS = 6
"""Of metres and degrees."""

TURNS = "Zrotation Xrotation Yrotation"


def write_bvh(path: Path, motions: Sequence[Motion]) -> None:
    """Write one motion; the first frame of the file is the first of the motion."""
    (motion,) = motions
    assert motion.rig is not None
    angles = np.concatenate(np.degrees(find_angles(motion.rig.rotations)), axis=1)
    table = np.hstack([motion.rig.root, angles]).round(DECIMALS)
    text = orjson.dumps(table, option=orjson.OPT_SERIALIZE_NUMPY)[2:-2]
    with path.open("wb") as file:
        file.write("".join(f"{line}\n" for line in _header(motion, motion.rig)).encode())
        file.write(text.replace(b"],[", b"\n").replace(b",", b" ") + b"\n")


bvh_output = motion_output(write_bvh, by_individual, prepare=rigged)


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

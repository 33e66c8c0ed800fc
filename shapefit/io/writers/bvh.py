"""Write motions as BVH (metres, y up): bones that turn so that they follow the
landmarks.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path
from typing import TypedDict

import numpy as np
import orjson

from shapefit.arrays import Flags, Floats, Integers
from shapefit.errors import input_error
from shapefit.geometry.joint_rotations import Rig, find_rig, place_nodes
from shapefit.io.skeletons import part_names
from shapefit.io.writers.motion import FileMotion

TIP = 0.25  # length of the end after the last joint of a limb, in bones before it
DECIMALS = 6  # of metres and degrees

ROTATIONS = "Zrotation Xrotation Yrotation"

LOCKED_BELOW = 1e-8
"""Cosine of the middle angle at which the other two turn about one axis."""

LIMBS = ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")
"""Without all of these, left and right, it is no person."""


class PartRow(TypedDict, total=False):
    """A part of a person in BVH: the names of its joint and of the bone that leads to
    it alone, and the direction at rest of the bone that ends there.
    """

    joint: str
    bone: str
    rest: Sequence[float]


def write_bvh(path: Path, motion: FileMotion) -> str:
    """Write one motion as BVH; return a text on how far joints are from the landmarks.

    Gaps are bridged in straight lines.

    Raises InputError where no edge joins two landmarks that have a place.
    """
    points = _bridge_gaps(motion.points)
    placed = np.asarray(np.isfinite(points).all(axis=(0, 1)))
    edges = _edges_between(motion, placed)
    if not len(edges):
        problem = (
            "no edge joins two landmarks that have a place, so there are no bones to"
            " turn"
        )
        fix = "write TRC or C3D, or lift with a dictionary that has `edges`"
        raise input_error(path.name, problem, fix)
    points = points[:, :, placed]
    landmarks = np.array(motion.landmark_names, dtype=object)[placed]
    parts = _parts(tuple(motion.landmark_names))
    rows = [parts.get(name, {}) for name in landmarks]
    hips = [j for j, row in enumerate(rows) if row.get("joint") == "Hips"]
    pose = {j: row["rest"] for j, row in enumerate(rows) if "rest" in row}
    rig = find_rig(points, edges, hips[0] if hips else None, pose)
    motion_lines = _motion_lines(rig)
    head = [
        "HIERARCHY",
        *_joint_lines(rig, _names(rig, landmarks, rows)),
        "MOTION",
        f"Frames: {len(points)}",
        f"Frame Time: {1 / motion.rate:.10g}",
        "",
    ]
    with path.open("wb") as file:
        file.write("\n".join(head).encode())
        file.write(motion_lines)
    return _describe_joint_errors(motion, rig, points)


def _bridge_gaps(points: Floats) -> Floats:
    """Return points (f, 3, p), unknown ones in straight lines; nan if never known.

    Before the first known one and after the last they stay where these are.
    """
    bridged = points.copy()
    frames = np.arange(len(points))
    for track in bridged.reshape(len(points), -1).T:
        finite = np.isfinite(track)
        if finite.any():
            track[:] = np.interp(frames, frames[finite], track[finite])
    return bridged


def _edges_between(motion: FileMotion, placed: Flags) -> Integers:
    """Return the edges (e, 2) of landmarks that have a place, counted among these."""
    column = np.cumsum(placed) - 1
    edges: Integers = column[motion.edges[placed[motion.edges].all(axis=1)]]
    return edges


def _parts(names: tuple[str, ...]) -> dict[str, PartRow]:
    """Return landmark -> row of `data/bvh.toml` for a person's; {} for others."""
    parts = part_names(names)
    person = set(parts.values()) >= {f"{side}{limb}" for side in "lr" for limb in LIMBS}
    return {name: _rows().get(part, {}) for name, part in parts.items() if person}


@cache
def _rows() -> dict[str, PartRow]:
    """Return the rows of `data/bvh.toml` by part, of both sides."""
    file = Path(__file__).resolve().parents[2] / "data" / "bvh.toml"
    data = tomllib.loads(file.read_text(encoding="utf-8"))
    rows: dict[str, PartRow] = data["middle"]
    for part, row in data["side"].items():
        x, y, z = row["rest"]
        for side, word, sign in (("l", "Left", 1), ("r", "Right", -1)):
            of_side: PartRow = {"rest": [sign * x, y, z]}
            if "joint" in row:
                of_side["joint"] = f"{word}{row['joint']}"
            if "bone" in row:
                of_side["bone"] = f"{word}{row['bone']}"
            rows[f"{side}{part}"] = of_side
    return rows


def _motion_lines(rig: Rig) -> bytes:
    """Return the lines of all frames: the place of the root, and angles in degrees."""
    angles = np.concatenate(np.degrees(find_angles(rig.rotations)), axis=1)
    table = np.hstack([rig.root, angles]).round(DECIMALS)
    text = orjson.dumps(table, option=orjson.OPT_SERIALIZE_NUMPY)[2:-2]
    return text.replace(b"],[", b"\n").replace(b",", b" ") + b"\n"


def find_angles(rotations: Floats) -> Floats:
    """Return angles a, b, c (m, f, 3) in radians of rotations R_z(a) R_x(b) R_y(c).

    They change as little as can be from frame to frame: a, b, c and a + pi, pi - b, c +
    pi are one rotation, and so are angles that differ by 2 pi. Where b is a quarter
    turn only a + c or a - c counts: c is 0.
    """
    R = rotations
    is_locked = np.hypot(R[..., 0, 1], R[..., 1, 1]) < LOCKED_BELOW
    a = np.arctan2(-R[..., 0, 1], R[..., 1, 1])
    a = np.where(is_locked, np.arctan2(R[..., 1, 0], R[..., 0, 0]), a)
    b = np.arcsin(np.clip(R[..., 2, 1], -1, 1))
    c = np.arctan2(-R[..., 2, 0], R[..., 2, 2])
    c = np.where(is_locked, 0.0, c)
    one = np.stack([a, b, c], axis=-1)
    other = np.stack([a + np.pi, np.pi - b, c + np.pi], axis=-1)

    def change(start: Floats, end: Floats) -> Floats:
        """Return the sum of three turns between angles (..., 3), each at most pi."""
        turn = (end - start + np.pi) % (2 * np.pi) - np.pi
        turned: Floats = np.abs(turn).sum(axis=-1)
        return turned

    nearer = change(one[:, :-1], other[:, 1:]) < change(one[:, :-1], one[:, 1:])
    changed = np.cumsum(nearer, axis=1) % 2 == 1
    one[:, 1:][changed] = other[:, 1:][changed]
    return np.unwrap(one, axis=1)


def _joint_lines(
    rig: Rig, names: list[str], number: int = 0, tabs: str = ""
) -> Iterator[str]:
    """Yield the lines of BVH for a node at rest and for all below it."""
    below = [k for k, node in enumerate(rig.tree) if node.above == number]
    yield f"{tabs}{'JOINT' if number else 'ROOT'} {names[number]}"
    yield f"{tabs}{{"
    yield f"{tabs}\tOFFSET {_triple(rig.offsets[number])}"
    channels = ROTATIONS if number else f"Xposition Yposition Zposition {ROTATIONS}"
    yield f"{tabs}\tCHANNELS {len(channels.split())} {channels}"
    for child in below:
        yield from _joint_lines(rig, names, child, f"{tabs}\t")
    if not below:
        tip = _triple(TIP * rig.offsets[number])
        yield f"{tabs}\tEnd Site\n{tabs}\t{{\n{tabs}\t\tOFFSET {tip}\n{tabs}\t}}"
    yield f"{tabs}}}"


def _triple(vector: Floats) -> str:
    """Return x, y and z as text, as BVH writes them."""
    return " ".join(f"{x:.{DECIMALS}f}" for x in vector)


def _names(rig: Rig, landmarks: Floats, rows: list[PartRow]) -> list[str]:
    """Return the names of the nodes of a rig, all different, by their landmarks.

    A node that only leads to another is named by its bone, or else by both landmarks.
    """
    names: list[str] = []
    for node in rig.tree:
        name = rows[node.joint].get("joint", landmarks[node.joint])
        if node.above >= 0 and rig.tree[node.above].joint == node.joint:
            (end,) = node.aims
            name = rows[end].get("bone", f"{name}_{landmarks[end]}")
        name = re.sub(r"[\s{}]+", "_", name)
        while name in names:
            name += "_"
        names.append(name)
    return names


def _describe_joint_errors(motion: FileMotion, rig: Rig, points: Floats) -> str:
    """Return a text on how far the joints of a rig are from landmarks (f, 3, p)."""
    truth = points[:, :, [node.joint for node in rig.tree]].transpose(2, 0, 1)
    far = 1000 * np.linalg.norm(place_nodes(rig) - truth, axis=2)
    joints = f"joints of {motion.name}" if motion.name else "joints"
    said = (
        f"{joints} {far.mean():.1f} mm from the landmarks on average,"
        f" {far.max():.1f} at most"
    )
    return f"{said}; {motion.timing_note}" if motion.timing_note else said

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
    """Write one motion as BVH; return a note on how far joints are from landmarks.

    Gaps are bridged in straight lines.

    Raises InputError where there is no frame, or no edge joins two landmarks that have
    a place.
    """
    if not len(motion.points):
        fix = "give a file with images, or write CSV or TRC"
        raise input_error(path.name, "there is no frame to write", fix)
    points = _bridge_gaps(motion.points)
    placed = np.asarray(np.isfinite(points).all(axis=(0, 1)))
    edges = _renumber_edges(motion.edges, placed)
    if not len(edges):
        problem = (
            "no edge joins two landmarks that have a place, so there are no bones to"
            " turn"
        )
        fix = "write TRC or C3D, or lift with a dictionary that has `edges`"
        raise input_error(path.name, problem, fix)
    points = points[:, :, placed]
    landmarks = np.array(motion.landmark_names, dtype=object)[placed].tolist()
    parts = _person_parts(tuple(motion.landmark_names))
    rows = [parts.get(name, {}) for name in landmarks]
    hips = [j for j, row in enumerate(rows) if row.get("joint") == "Hips"]
    pose = {j: row["rest"] for j, row in enumerate(rows) if "rest" in row}
    rig = find_rig(points, edges, hips[0] if hips else None, pose)
    motion_lines = _motion_lines(rig)
    head = [
        "HIERARCHY",
        *_joint_lines(rig, _name_nodes(rig, landmarks, rows)),
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
    """Interpolate unknown points (f, 3, p) linearly; nan if a landmark is never known.

    Before the first known one and after the last they are at these.
    """
    bridged = points.copy()
    frames = np.arange(len(points))
    for track in bridged.reshape(len(points), -1).T:
        finite = np.isfinite(track)
        if finite.any():
            track[:] = np.interp(frames, frames[finite], track[finite])
    return bridged


def _renumber_edges(edges: Integers, retained: Flags) -> Integers:
    """Return the edges between `retained` landmarks (p,), as indices of these alone."""
    column = np.cumsum(retained) - 1
    renumbered: Integers = column[edges[retained[edges].all(axis=1)]]
    return renumbered


def _person_parts(names: tuple[str, ...]) -> dict[str, PartRow]:
    """Return landmark -> its row of `data/bvh.toml`; {} if there is no whole person."""
    parts = part_names(names)
    person = set(parts.values()) >= {f"{side}{limb}" for side in "lr" for limb in LIMBS}
    return {name: _part_rows().get(part, {}) for name, part in parts.items() if person}


@cache
def _part_rows() -> dict[str, PartRow]:
    """Read `data/bvh.toml`: part of the body -> its row, for both sides."""
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
    """Format a line for each frame: the root's position, and angles in degrees."""
    angles = np.concatenate(np.degrees(find_angles(rig.rotations)), axis=1)
    table = np.hstack([rig.root, angles]).round(DECIMALS)
    text = orjson.dumps(table, option=orjson.OPT_SERIALIZE_NUMPY)[2:-2]
    return text.replace(b"],[", b"\n").replace(b",", b" ") + b"\n"


def find_angles(rotations: Floats) -> Floats:
    """Decompose rotations (m, f, 3, 3) as R_z(a) R_x(b) R_y(c): angles (m, f, 3), rad.

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
        """Return the sum of |end - start| over three angles (..., 3), modulo 2 pi."""
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
    """Yield lines of BVH's hierarchy for node `number` of a rig and its descendants."""
    below = [k for k, node in enumerate(rig.tree) if node.above == number]
    yield f"{tabs}{'JOINT' if number else 'ROOT'} {names[number]}"
    yield f"{tabs}{{"
    yield f"{tabs}\tOFFSET {_format_vector(rig.offsets[number])}"
    channels = ROTATIONS if number else f"Xposition Yposition Zposition {ROTATIONS}"
    yield f"{tabs}\tCHANNELS {len(channels.split())} {channels}"
    for child in below:
        yield from _joint_lines(rig, names, child, f"{tabs}\t")
    if not below:
        tip = _format_vector(TIP * rig.offsets[number])
        yield f"{tabs}\tEnd Site\n{tabs}\t{{\n{tabs}\t\tOFFSET {tip}\n{tabs}\t}}"
    yield f"{tabs}}}"


def _format_vector(vector: Floats) -> str:
    """Format x, y and z with DECIMALS decimals, and spaces between."""
    return " ".join(f"{x:.{DECIMALS}f}" for x in vector)


def _name_nodes(
    rig: Rig, landmarks: Sequence[str], rows: Sequence[PartRow]
) -> list[str]:
    """Return unique names for the nodes of a rig, from the names of landmarks (p,).

    rows (p,) are those of landmarks in `data/bvh.toml`.

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
    """Describe how far the joints of a rig are from landmarks (f, 3, p), in mm."""
    truth = points[:, :, [node.joint for node in rig.tree]].transpose(2, 0, 1)
    far = 1000 * np.linalg.norm(place_nodes(rig) - truth, axis=2)
    joints = f"joints of {motion.name}" if motion.name else "joints"
    said = (
        f"{joints} {far.mean():.1f} mm from the landmarks on average,"
        f" {far.max():.1f} at most"
    )
    return f"{said}; {motion.timing_note}" if motion.timing_note else said

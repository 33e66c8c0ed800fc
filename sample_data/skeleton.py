"""An articulated person: bone lengths, joint angles, and the 15 joints they put in space.

Frame: x to the person's left, y up, z forward; metres. With all angles 0 the person stands
upright with hanging arms. A motion is a mapping from channel to an array of angles in degrees, one
per frame; missing channels are 0. Limb channels carry the prefix `r` or `l`:

    root   yaw (to the left), lean (forward), roll (to the left)   of the pelvis
    trunk  bend (forward), twist (to the left), side (to the left) of the chest on the pelvis
    head   nod (forward), turn (to the left)
    leg    hip (forward), hip_out, hip_turn (inward), knee
    arm    arm (forward), arm_out, arm_turn (inward), elbow
    lift   height of the lowest foot above the ground, in metres
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

JOINTS = (
    *("pelvis", "rhip", "rknee", "rankle", "lhip", "lknee", "lankle", "neck", "head"),
    *("rshoulder", "relbow", "rwrist", "lshoulder", "lelbow", "lwrist"),
)
BONES = (
    *(("pelvis", "rhip"), ("rhip", "rknee"), ("rknee", "rankle")),
    *(("pelvis", "lhip"), ("lhip", "lknee"), ("lknee", "lankle")),
    *(("pelvis", "neck"), ("neck", "head")),
    *(("neck", "rshoulder"), ("rshoulder", "relbow"), ("relbow", "rwrist")),
    *(("neck", "lshoulder"), ("lshoulder", "lelbow"), ("lelbow", "lwrist")),
)
EDGES = np.array([[JOINTS.index(a), JOINTS.index(b)] for a, b in BONES])

ANKLE_HEIGHT = 0.08
SHRUG = 0.15  # share of the raising of an arm that the collar bone takes
CONTACT_SHARPNESS = 40.0  # per metre; how abruptly the weight goes from foot to foot


@dataclass(frozen=True)
class Proportions:
    """Bone lengths of one person in metres; a `half` is from the middle to one side."""

    hip_half: float = 0.095
    hip_drop: float = 0.075
    thigh: float = 0.430
    shank: float = 0.420
    torso: float = 0.510
    shoulder_half: float = 0.185
    shoulder_drop: float = 0.020
    upper_arm: float = 0.295
    forearm: float = 0.255
    head: float = 0.240


def turned(x: Floats, y: Floats, z: Floats) -> Floats:
    """R_y(y) R_z(z) R_x(x), angles (n,) in degrees -> (n, 3, 3)."""
    (cx, cy, cz), (sx, sy, sz) = (f(np.radians([x, y, z])) for f in (np.cos, np.sin))
    zero, one = np.zeros_like(cx), np.ones_like(cx)
    Rx = np.array([[one, zero, zero], [zero, cx, -sx], [zero, sx, cx]])
    Ry = np.array([[cy, zero, sy], [zero, one, zero], [-sy, zero, cy]])
    Rz = np.array([[cz, -sz, zero], [sz, cz, zero], [zero, zero, one]])
    return np.einsum("ijn,jkn,kln->nil", Ry, Rz, Rx)


def limb(swing: Floats, out: Floats, turn: Floats, side: int) -> Floats:
    """R_z(out) R_x(-swing) R_y(-turn) of a hanging limb; side +1 left, -1 right -> (n, 3, 3)."""
    zero = np.zeros_like(swing)
    raised = turned(-swing, zero, zero)
    return turned(zero, zero, side * out) @ raised @ turned(zero, -side * turn, zero)


def joints(motion: Mapping[str, Floats], body: Proportions) -> Floats:
    """Joint positions (n, 15, 3) of `motion`; the lowest ankle stands on the ground, y = 0.

    The pelvis stays above the origin: the person moves on the spot.
    """
    frames = len(next(iter(motion.values())))

    def angle(channel: str) -> Floats:
        return np.asarray(motion.get(channel, np.zeros(frames)), dtype=float)

    def knee_or_elbow(channel: str, sign: int) -> Floats:
        return turned(sign * angle(channel), np.zeros(frames), np.zeros(frames))

    place: dict[str, Floats] = {"pelvis": np.zeros((frames, 3))}
    pelvis = turned(angle("lean"), angle("yaw"), -angle("roll"))
    chest = pelvis @ turned(angle("bend"), angle("twist"), -angle("side"))
    skull = chest @ turned(angle("nod"), angle("turn"), np.zeros(frames))
    place["neck"] = chest @ np.array([0, body.torso, 0])
    place["head"] = place["neck"] + skull @ np.array([0, body.head, 0.02])
    for name, side in (("r", -1), ("l", 1)):
        thigh = pelvis @ limb(
            angle(f"{name}hip"), angle(f"{name}hip_out"), angle(f"{name}hip_turn"), side
        )
        shank = thigh @ knee_or_elbow(f"{name}knee", 1)
        place[f"{name}hip"] = pelvis @ np.array([side * body.hip_half, -body.hip_drop, 0])
        place[f"{name}knee"] = place[f"{name}hip"] + thigh @ np.array([0, -body.thigh, 0])
        place[f"{name}ankle"] = place[f"{name}knee"] + shank @ np.array([0, -body.shank, 0])

        upper = chest @ limb(
            angle(f"{name}arm"), angle(f"{name}arm_out"), angle(f"{name}arm_turn"), side
        )
        fore = upper @ knee_or_elbow(f"{name}elbow", -1)
        raised = np.hypot(angle(f"{name}arm"), angle(f"{name}arm_out"))
        collar = chest @ turned(np.zeros(frames), np.zeros(frames), side * SHRUG * raised)
        place[f"{name}shoulder"] = place["neck"] + collar @ np.array(
            [side * body.shoulder_half, -body.shoulder_drop, 0]
        )
        place[f"{name}elbow"] = place[f"{name}shoulder"] + upper @ np.array([0, -body.upper_arm, 0])
        place[f"{name}wrist"] = place[f"{name}elbow"] + fore @ np.array([0, -body.forearm, 0])

    points = np.stack([place[name] for name in JOINTS], axis=1)
    points[..., 1] += (ANKLE_HEIGHT + angle("lift") - _lowest(place))[:, None]
    return points


def _lowest(place: Mapping[str, Floats]) -> Floats:
    """Smooth minimum of the two ankle heights, so that the pelvis changes feet without a jerk."""
    right, left = place["rankle"][:, 1], place["lankle"][:, 1]
    blend = 1 / (1 + np.exp(-CONTACT_SHARPNESS * (left - right)))
    return blend * right + (1 - blend) * left

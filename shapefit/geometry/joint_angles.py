"""Joint angles of a body in degrees, as far as the points of joints determine them.

Flexion is positive, and 0 where a person stands upright with arms hanging. Bones that meet in a
hinge (knees, elbows) have the angle between them. Hips and shoulders turn about the line from left
to right of the trunk: with its axes (G. Wu et al., ISB recommendation, 2002 and 2005) x forward,
y along the trunk and z to the right, a limb in the direction d has the flexion atan2(d_x, -d_y).
What points do not show, turns of a bone about itself, has no angle here.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np

from shapefit.arrays import Floats

STEP = 1e-5
"""Of the derivatives, in units of the spread of the points: errors are 1e-10 of an angle."""


class JointAngle(NamedTuple):
    """An angle: its name as in OpenSim's models, the points that it takes, and the equation.

    measure takes points (m, 3, n) and the direction that is up (3, n); returns radians (n,).
    """

    name: str
    joints: tuple[str, ...]
    measure: Callable[[Floats, Floats], Floats]


def measure_angles(
    shapes: Floats, up: Floats, joints: Mapping[str, int], covariance: Floats | None = None
) -> tuple[Floats, Floats]:
    """Return the known angles (n, a) and their standard deviations (n, a), in degrees.

    The deviation of an angle g is that of its linearisation: sigma^2 = dg^T C dg.

    shapes (n, 3, p) in any unit and right-handed frame, up (3,) or (n, 3) in that frame, joints ->
    columns of the shapes, covariance (n, 3p, 3p) of x, y, z of one landmark after the other, or
    (n, p, 3, 3) of each landmark where those of different landmarks are taken for independent; nan
    deviations without one. Angles of points that are not known are nan.
    """
    angles = known_angles(joints)
    n, _, p = shapes.shape
    upward = np.broadcast_to(np.asarray(up, np.float64), (n, 3)).T
    values, deviations = np.full((2, n, len(angles)), np.nan)
    for number, angle in enumerate(angles):
        columns = [joints[joint] for joint in angle.joints]
        points = np.ascontiguousarray(shapes[:, :, columns].transpose(2, 1, 0), np.float64)
        with np.errstate(invalid="ignore", divide="ignore"):
            values[:, number] = angle.measure(points, upward)
            if covariance is None:
                continue
            slope = _slope(angle, points, upward)
        distinct = list(dict.fromkeys(columns))
        owner = np.equal.outer(distinct, columns) @ slope.reshape(len(columns), -1)
        slope = owner.reshape(len(distinct), 3, n)
        if covariance.ndim == 4:
            variance = np.einsum("min,nmij,mjn->n", slope, covariance[:, distinct], slope)
        else:
            blocks = covariance.reshape(n, p, 3, p, 3)[:, distinct][:, :, :, distinct]
            variance = np.einsum("min,nmikj,kjn->n", slope, blocks, slope)
        deviations[:, number] = np.sqrt(np.maximum(variance, 0.0))
    return np.degrees(values), np.degrees(deviations)


def known_angles(joints: Mapping[str, int] | Sequence[str]) -> tuple[JointAngle, ...]:
    """Return the angles whose points are all among the joints."""
    return tuple(angle for angle in ANGLES if set(angle.joints) <= set(joints))


def _slope(angle: JointAngle, points: Floats, up: Floats) -> Floats:
    """d angle / d points (m, 3, n), by central differences."""
    step = STEP * np.sqrt(((points - points.mean(axis=0)) ** 2).mean(axis=(0, 1)))
    slope = np.empty_like(points)
    for place in np.ndindex(points.shape[:2]):
        ahead, behind = points.copy(), points.copy()
        ahead[place] += step
        behind[place] -= step
        turn = angle.measure(ahead, up) - angle.measure(behind, up)
        slope[place] = ((turn + np.pi) % (2 * np.pi) - np.pi) / (2 * step)
    return slope


def _dot(a: Floats, b: Floats) -> Floats:
    product: Floats = (a * b).sum(axis=0)
    return product


def _between(a: Floats, b: Floats) -> Floats:
    """atan2(|a x b|, <a, b>) in [0, pi], of vectors (3, n)."""
    across = np.cross(a, b, axis=0)
    angle: Floats = np.arctan2(np.sqrt(_dot(across, across)), _dot(a, b))
    return angle


def _hinge(points: Floats, _: Floats) -> Floats:
    """Return the angle by which the second bone leaves the direction of the first."""
    above, joint, below = points
    return _between(joint - above, below - joint)


def _ankle(points: Floats, _: Floats) -> Floats:
    """Return how far the foot is raised above the right angle to the shank."""
    knee, ankle, heel, toe = points
    angle: Floats = np.pi / 2 - _between(knee - ankle, toe - heel)
    return angle


def _flexion(points: Floats, _: Floats, head: float) -> Floats:
    """atan2(d_x, -d_y) of the bone d from the fifth point to the sixth, in the axes of the trunk.

    The points before are left and right of the line that the limb turns about, and of the other end
    of the trunk. `head` is 1 where that line is the end towards the head, else -1. y is made
    orthogonal to z, and x = y x z is forward.
    """
    left, right, other_left, other_right, start, end = points
    z, limb = right - left, end - start
    x = np.cross(head * (left + right - other_left - other_right), z, axis=0)
    y = np.cross(z, x, axis=0)
    along = _dot(limb, y) / np.sqrt(_dot(y, y))
    forward = _dot(limb, x) / np.sqrt(_dot(x, x))
    angle: Floats = np.arctan2(forward, -along)
    return angle


def _tilt(points: Floats, up: Floats) -> Floats:
    """Return the angle to the vertical of the line from the middle of the first two points to that
    of the others.
    """
    return _between(2 * points[2:].mean(axis=0) - points[0] - points[1], up)


HIPS, SHOULDERS = ("lhip", "rhip"), ("lshoulder", "rshoulder")


def _of_side(side: str) -> tuple[JointAngle, ...]:
    hip, knee, ankle, heel, toe, shoulder, elbow, wrist = (
        f"{side}{joint}"
        for joint in ("hip", "knee", "ankle", "heel", "toe", "shoulder", "elbow", "wrist")
    )
    arm, leg = partial(_flexion, head=1.0), partial(_flexion, head=-1.0)
    return (
        JointAngle(f"hip_flexion_{side}", (*HIPS, *SHOULDERS, hip, knee), leg),
        JointAngle(f"knee_angle_{side}", (hip, knee, ankle), _hinge),
        JointAngle(f"ankle_angle_{side}", (knee, ankle, heel, toe), _ankle),
        JointAngle(f"arm_flex_{side}", (*SHOULDERS, *HIPS, shoulder, elbow), arm),
        JointAngle(f"elbow_flex_{side}", (shoulder, elbow, wrist), _hinge),
    )


ANGLES = (
    *_of_side("r"),
    *_of_side("l"),
    JointAngle("trunk_tilt", (*HIPS, *SHOULDERS), _tilt),
    JointAngle("head_tilt", (*SHOULDERS, "head"), _tilt),
)
"""The angles, named as the coordinates of OpenSim's full-body models where these have them."""

"""Joint angles of a body in degrees, as far as the points of joints determine them.

Flexion is positive, and 0 where a person stands upright with arms hanging. Bones that
meet in a hinge (knees, elbows) have the angle between them. Hips and shoulders turn
about the line from left to right of the trunk: with its axes (G. Wu et al., ISB
recommendation, 2002 and 2005) x forward, y along the trunk and z to the right, a limb
in the direction d has the flexion atan2(d_x, -d_y). Turns of a bone about itself do not
show in points and have no angle.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np

from shapefit.arrays import Floats

DIFFERENCE_STEP = 1e-5
"""Of derivatives, in spreads of the points: errors are 1e-10 of an angle."""


class JointAngle(NamedTuple):
    """An angle: its name in OpenSim's models, the joints it takes, and its equation.

    measure takes points (m, 3, n) and the direction that is up (3, n); returns radians
    (n,).
    """

    name: str
    joints: tuple[str, ...]
    measure: Callable[[Floats, Floats], Floats]

    @property
    def depends_on_up(self) -> bool:
        """Whether the angle depends on the direction up, not on the body alone."""
        return self.measure is _tilt


def measure_angles(
    shapes: Floats,
    up: Floats,
    joints: Mapping[str, int],
    covariance: Floats | None = None,
    angles: Sequence[JointAngle] | None = None,
) -> tuple[Floats, Floats]:
    """Return joint angles (n, a) and their standard deviations (n, a), in degrees.

    They are those of `measurable_angles(joints)`, in that order. The deviation of an
    angle g is linearised: sigma^2 = dg^T C dg.

    shapes (n, 3, p) in a right-handed frame, up (3,) or (n, 3) in that frame; joints:
    the column of each joint; covariance (n, 3p, 3p) of x, y, z of one landmark after
    the other, or (n, p, 3, 3) of independent landmarks; without one deviations are nan.
    Unknown points have nan angles. Angles are all that the joints determine, or those
    given.
    """
    if angles is None:
        angles = measurable_angles(joints)
    n, _, p = shapes.shape
    upward = np.broadcast_to(np.asarray(up, np.float64), (n, 3)).T
    values, deviations = np.full((2, n, len(angles)), np.nan)
    # Images last, so that an equation runs through memory in order.
    points_of_all = np.ascontiguousarray(shapes.transpose(2, 1, 0), np.float64)
    for number, angle in enumerate(angles):
        columns = [joints[joint] for joint in angle.joints]
        points = points_of_all[columns]
        with np.errstate(invalid="ignore", divide="ignore"):
            values[:, number] = angle.measure(points, upward)
            if covariance is None:
                continue
            slope = _slope(angle, points, upward)
        if covariance.ndim == 4:
            variance = np.einsum(
                "min,nmij,mjn->n", slope, covariance[:, columns], slope
            )
        else:
            blocks = covariance.reshape(n, p, 3, p, 3)
            blocks = blocks[:, columns][:, :, :, columns]
            variance = np.einsum("min,nmikj,kjn->n", slope, blocks, slope)
        deviations[:, number] = np.sqrt(np.maximum(variance, 0.0))
    return np.degrees(values), np.degrees(deviations)


def measurable_angles(joints: Iterable[str]) -> tuple[JointAngle, ...]:
    """Return the angles of `JOINT_ANGLES` whose joints are all among names `joints`."""
    known = {*joints}
    return tuple(angle for angle in JOINT_ANGLES if {*angle.joints} <= known)


def _slope(angle: JointAngle, points: Floats, up: Floats) -> Floats:
    """Return the derivatives (m, 3, n) of an angle in radians by its points (m, 3, n).

    By central differences; up (3, n).
    """
    squares = (points - points.mean(axis=0)) ** 2
    step = DIFFERENCE_STEP * np.sqrt(squares.mean(axis=(0, 1)))
    slope = np.empty_like(points)
    for place in np.ndindex(points.shape[:2]):
        ahead = points.copy()
        ahead[place] += step
        behind = points.copy()
        behind[place] -= step
        turn = angle.measure(ahead, up) - angle.measure(behind, up)
        # an angle may pass from pi to -pi on the way
        shortest = (turn + np.pi) % (2 * np.pi) - np.pi
        slope[place] = shortest / (2 * step)
    return slope


def _hinge(points: Floats, _: Floats) -> Floats:
    """Return the angle (n,) in radians between a bone and the next one; 0 if straight.

    points (3, 3, n): the three joints.
    """
    above, joint, below = points
    return _angle_between(joint - above, below - joint)


def _ankle(points: Floats, _: Floats) -> Floats:
    """Return the angle (n,) in radians by which a foot is raised: 0 at a right angle.

    Right to the shank, which runs from knee to ankle; the foot runs from heel to toe.
    """
    knee, ankle, heel, toe = points
    return np.asarray(np.pi / 2 - _angle_between(knee - ankle, toe - heel))


def _flexion(points: Floats, _: Floats, trunk_sign: float) -> Floats:
    """Return the flexion (n,) in radians of a hip or shoulder: 0 hanging, + forward.

    atan2(d_x, -d_y) of the bone d of a limb, which ends at the last point. The first
    two points are left and right of the line about which the limb turns, the next two
    of the other end of the trunk. trunk_sign is 1 at the shoulders and -1 at the hips.
    y is made orthogonal to z, and x = y x z is forward; so the bone may begin at either
    end of the line.
    """
    left, right, other_left, other_right, end = points
    z = right - left
    limb = end - left
    x = np.cross(trunk_sign * (left + right - other_left - other_right), z, axis=0)
    y = np.cross(z, x, axis=0)
    forward = _dot(limb, x) / np.sqrt(_dot(x, x))
    along = _dot(limb, y) / np.sqrt(_dot(y, y))
    return np.arctan2(forward, -along)


def _tilt(points: Floats, up: Floats) -> Floats:
    """Return the angle (n,) in radians between `up` and the line of two midpoints.

    The line leads from the middle of the first two points to that of the others.
    """
    line = 2 * points[2:].mean(axis=0) - points[0] - points[1]
    return _angle_between(line, up)


def _angle_between(a: Floats, b: Floats) -> Floats:
    """Return the angle (n,) between vectors (3, n), in radians from 0 to pi."""
    across = np.cross(a, b, axis=0)
    return np.arctan2(np.sqrt(_dot(across, across)), _dot(a, b))


def _dot(a: Floats, b: Floats) -> Floats:
    """Return the inner products (n,) of vectors (3, n)."""
    return np.asarray((a * b).sum(axis=0))


_HIPS = ("lhip", "rhip")
_SHOULDERS = ("lshoulder", "rshoulder")
_hip_flexion = partial(_flexion, trunk_sign=-1.0)
_shoulder_flexion = partial(_flexion, trunk_sign=1.0)


def _angles_of_side(side: str) -> tuple[JointAngle, ...]:
    """Return the angles of the limbs of one side, "l" or "r"."""
    shoulder, elbow, wrist, hip, knee, ankle, heel, toe = (
        side + joint
        for joint in (
            "shoulder",
            "elbow",
            "wrist",
            "hip",
            "knee",
            "ankle",
            "heel",
            "toe",
        )
    )
    thigh = (*_HIPS, *_SHOULDERS, knee)
    upper_arm = (*_SHOULDERS, *_HIPS, elbow)
    return (
        JointAngle(f"hip_flexion_{side}", thigh, _hip_flexion),
        JointAngle(f"knee_angle_{side}", (hip, knee, ankle), _hinge),
        JointAngle(f"ankle_angle_{side}", (knee, ankle, heel, toe), _ankle),
        JointAngle(f"arm_flex_{side}", upper_arm, _shoulder_flexion),
        JointAngle(f"elbow_flex_{side}", (shoulder, elbow, wrist), _hinge),
    )


JOINT_ANGLES = (
    *_angles_of_side("r"),
    *_angles_of_side("l"),
    JointAngle("trunk_tilt", (*_HIPS, *_SHOULDERS), _tilt),
    JointAngle("head_tilt", (*_SHOULDERS, "head"), _tilt),
)

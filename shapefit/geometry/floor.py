"""The floor that people stand on, as a camera at rest sees it.

It tells how high above the floor the camera is, and how tilted. The frame is that of
the camera: x right, y up in the image, z towards the viewer, metres. With the direction
n = (a, 1, b) / r that is up, r = sqrt(1 + a^2 + b^2), and the height h = g / r of the
camera, weighted least squares find a, b and g of

    a x + b z + g   = r k - y          feet at rest at (x, y, z), whose landmarks are k
                    above it
    a = d_x / d_y,  b = d_z / d_y      d to the centre of mass of a body from the feet
                    that support it
    a = 0,          b = 0              cameras are held about level

The error of a foot is mostly along its ray, and a distance that is wrong for all frames
(an assumed focal length) counts as one error of all of them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats
from shapefit.geometry.rotations import shortest_rotations

MASS = {
    "shoulder": 0.31,
    "hip": 0.39,
    "elbow": 0.04,
    "wrist": 0.03,
    "knee": 0.17,
    "ankle": 0.06,
}
"""Shares of the centre of mass that both joints of a kind bear: those of the segments
between them (P. de Leva, Adjustments to Zatsiorsky-Seluyanov's segment inertia
parameters, 1996).
"""

ABOVE_FLOOR = {"ankle": 0.042, "heel": 0.02, "toe": 0.014}
"""Heights of landmarks of a foot on the floor, in heights of the body (R. Drillis and
R. Contini, Body segment parameters, 1966, and the shapes of seven bodies).
"""

FORWARD = 0.045
"""How far before its ankle a foot supports a standing body, in heights of the body."""

# A foot is at rest where it is slow and low and its leg straight, for a while.

STRAIGHT_LEG_SHARE = 0.85
"""Distance of hip and ankle from which on a leg is straight, in lengths of the leg."""

MAX_FOOT_SPEED = 0.17
"""Speed of a foot at rest, in heights of the body a second."""

MAX_FOOT_HEIGHT = 0.07
"""Height of a foot at rest above the lower one, in heights of the body."""

MIN_REST_SECONDS = 0.3
"""How long a foot rests."""

LINE_OF_SIGHT_WEIGHT = 1 / 3
"""Weight of motion along the line of sight, which one camera hardly sees."""

# Deviations of tilt, chosen, as the others, on seven filmed bodies.

CAMERA_TILT_SD = np.tan(np.radians(15.0))
"""Deviation of the tilt of cameras."""

SWAY_SD = np.tan(np.radians(5.0))
"""Deviation of the tilt of a body from moment to moment."""

LEAN_SD = np.tan(np.radians(2.0))
"""Deviation of the tilt of a body in all moments alike."""

MIN_UPRIGHT_COSINE = np.cos(np.pi / 4)
"""Of the tilt of a body that stands: 45 degrees, nobody stands nearer to the level."""

LASTING_SHARE = 0.5
"""Share of the deviations of a fit that all frames have in common (docs/sequences.md).
"""

FOOT_SD = 0.03
"""Deviation of a foot across the line of sight, in heights of the body."""

DEPTH_SD = 0.12
"""Deviation of a foot along the line of sight, in distances."""

STATURE_SD = 0.04
"""Deviation of the size of a body, as a share of it."""

MAX_HEIGHT_SD = 0.29
"""Largest deviation of a height that counts as known, in heights of the body."""

ROBUST_STEPS = 10
"""Of least squares with weights 1 / (1 + u^2 / 4) of residuals u in deviations."""


class FilmedBody(NamedTuple):
    """A body in front of the camera, and what is known of it.

    points and their deviations (n, 3, p) in metres, nan in gaps; joints, the column of
    each joint; stature in metres; rate in Hz.
    """

    points: Floats
    deviations: Floats
    joints: Mapping[str, int]
    stature: float
    rate: float


class Floor(NamedTuple):
    """The floor below a camera, and standard deviations of what is known of it.

    up (3,), the direction in its frame; height of the camera in metres; its pitch
    (positive when it looks down) and roll (positive when it leans to the left, seen
    from behind) in degrees.
    """

    up: Floats
    height: float
    pitch: float
    roll: float
    height_sd: float
    pitch_sd: float
    roll_sd: float

    def in_floor_frame(self, points: Floats) -> Floats:
        """Map points (..., 3, p) from the camera's frame to the floor's, in metres.

        In the floor's frame y is up, and 0 on the floor: R x + (0, height, 0) with the
        shortest rotation R up = y.
        """
        turn = shortest_rotations(self.up, np.array([[0.0, 1.0, 0.0]]))[0]
        standing: Floats = turn @ points + np.array([[0.0], [self.height], [0.0]])
        return standing

    def __str__(self) -> str:
        high = f"camera {self.height:.2f} m (+- {self.height_sd:.2f}) above the floor"
        tilt = f"{abs(self.pitch):.0f} degrees {'down' if self.pitch > 0 else 'up'}"
        roll = f"{abs(self.roll):.0f} to the {'left' if self.roll > 0 else 'right'}"
        return (
            f"{high}, tilted {tilt} (+- {self.pitch_sd:.0f}), {roll} (+-"
            f" {self.roll_sd:.0f})"
        )


class Evidence(NamedTuple):
    """What bodies tell about the floor.

    places (m, 3) of feet at rest and how high (m,) above the floor these are; how the
    bodies lean (k, 2) at moments, a and b of the equations, and the variances (k, 2) of
    that.
    """

    places: Floats
    above: Floats
    leaning: Floats
    variances: Floats


def find_floor(bodies: Sequence[FilmedBody], distance_sd: float) -> Floor | None:
    """Fit the floor that bodies stand on; None if no foot rests or it is too uncertain.

    Too uncertain is a height with a standard deviation above `MAX_HEIGHT_SD`. Bodies
    without all joints of `MASS` do not count. distance_sd: standard deviation of the
    logarithm of the distance, the same for all frames.
    """
    needed = {f"{side}{joint}" for side in "lr" for joint in MASS}
    whole = [body for body in bodies if needed <= body.joints.keys()]
    found = [_find_evidence(body) for body in whole]
    if not any(len(evidence.places) for evidence in found):
        return None
    evidence = Evidence(*map(np.concatenate, zip(*found, strict=True)))
    stature = float(np.mean([body.stature for body in whole]))
    foot_sd = FOOT_SD * stature
    abg, covariance = _fit_plane(foot_sd, evidence)
    farther = evidence.places * np.array([1.0, 1.0, 1 + distance_sd])
    change = _fit_plane(foot_sd, evidence._replace(places=farther))[0] - abg
    covariance += np.outer(change, change)
    floor = make_floor(abg, covariance)
    return None if floor.height_sd > MAX_HEIGHT_SD * stature else floor


def make_floor(abg: Floats, covariance: Floats) -> Floor:
    """Make the floor a x + y + b z + g = 0 from (a, b, g) and their covariance (3, 3).

    abg (3,); x, y, z in metres in the camera's frame. Standard deviations are
    linearised.
    """
    a, b, g = abg
    r = np.sqrt(1 + a**2 + b**2)
    slope = np.array([-g * a / r**3, -g * b / r**3, 1 / r])
    height_sd = np.sqrt(slope @ covariance @ slope + (STATURE_SD * g / r) ** 2)
    roll, pitch = np.degrees(np.arctan(abg[:2]))
    tilt_sd = np.sqrt(np.diag(covariance)[:2]) / (1 + abg[:2] ** 2)
    roll_sd, pitch_sd = np.degrees(tilt_sd)
    return Floor(
        up=np.array([a, 1.0, b]) / r,
        height=float(g / r),
        pitch=float(pitch),
        roll=float(roll),
        height_sd=float(height_sd),
        pitch_sd=float(pitch_sd),
        roll_sd=float(roll_sd),
    )


def _find_evidence(body: FilmedBody) -> Evidence:
    """Return where the feet of one body rest, and how the body leans above them."""
    joints = {joint: body.points[..., column] for joint, column in body.joints.items()}
    centre = _centre_of_mass(joints)
    ahead = _offset_from_ankle(joints, body.stature)
    supports = np.stack([joints[f"{side}ankle"] + ahead for side in "lr"])
    marks = [mark for mark in ABOVE_FLOOR if {f"l{mark}", f"r{mark}"} <= joints.keys()]
    feet = np.stack(
        [np.mean([joints[f"{side}{mark}"] for mark in marks], axis=0) for side in "lr"]
    )
    rests = _find_rests(body, joints, feet, supports, centre)
    leaning, variances = _find_leaning(body, rests, supports, centre)
    places = []
    if leaning:
        min_frames = _min_rest_frames(body)
        for foot, rest in zip(feet, rests, strict=True):
            for begin, end in _runs(rest, min_frames):
                places.append(foot[begin:end].mean(axis=0))
    above = body.stature * float(np.mean([ABOVE_FLOOR[mark] for mark in marks]))
    return Evidence(
        np.reshape(places, (-1, 3)),
        np.full(len(places), above),
        np.reshape(leaning, (-1, 2)),
        np.reshape(variances, (-1, 2)),
    )


def _centre_of_mass(joints: Mapping[str, Floats]) -> Floats:
    """Return the centre of mass (n, 3) of a body, from its joints (n, 3) by name."""
    trunk = joints["lshoulder"] + joints["rshoulder"] - joints["lhip"] - joints["rhip"]
    parts = (
        share / 2 * (joints[f"l{joint}"] + joints[f"r{joint}"])
        for joint, share in MASS.items()
    )
    return sum(parts, 0 * trunk)


def _offset_from_ankle(joints: Mapping[str, Floats], stature: float) -> Floats:
    """Return the vector (n, 3) from an ankle to where its foot supports the body.

    In metres, the same for both feet: it points the way that the trunk faces.
    joints: joints (n, 3) by name.
    """
    trunk = joints["lshoulder"] + joints["rshoulder"] - joints["lhip"] - joints["rhip"]
    ahead = np.cross(joints["lhip"] - joints["rhip"], trunk)
    ahead *= FORWARD * stature / np.linalg.norm(ahead, axis=1, keepdims=True)
    return ahead


def _find_rests(
    body: FilmedBody,
    joints: Mapping[str, Floats],
    feet: Floats,
    supports: Floats,
    centre: Floats,
) -> NDArray[np.bool_]:
    """Return whether left and right foot rest on the floor, frame by frame (2, n).

    They are slow and low, and their legs straight. feet (2, n, 3); supports (2, n, 3),
    the points of the feet that support the body; centre (n, 3), its centre of mass. All
    in metres.
    """
    upright = centre - supports.mean(axis=0)
    length = np.linalg.norm(upright, axis=1, keepdims=True)
    height = (supports * upright / length).sum(axis=2)
    is_low = height < height.min(axis=0) + MAX_FOOT_HEIGHT * body.stature
    may_rest = [
        _may_rest(body, joints, side, foot)
        for side, foot in zip("lr", feet, strict=True)
    ]
    return np.asarray(np.stack(may_rest) & is_low)


def _may_rest(
    body: FilmedBody, joints: Mapping[str, Floats], side: str, foot: Floats
) -> NDArray[np.bool_]:
    """Return whether a foot may rest, frame by frame (n,): slow, and its leg straight.

    joints: joints (n, 3) by name; side: "l" or "r"; foot (n, 3). In metres.
    """
    hip, knee, ankle = (joints[f"{side}{joint}"] for joint in ("hip", "knee", "ankle"))
    thigh = np.linalg.norm(hip - knee, axis=1)
    leg = thigh + np.linalg.norm(knee - ankle, axis=1)
    step = max(round(body.rate * MIN_REST_SECONDS / 2), 1)
    frame = np.arange(len(foot))
    early = np.maximum(frame - step, 0)
    late = np.minimum(frame + step, len(foot) - 1)
    moved = (foot[late] - foot[early]) * body.rate
    velocity = moved / np.maximum(late - early, 1)[:, None]
    ray = foot / np.linalg.norm(foot, axis=1, keepdims=True)
    along = (velocity * ray).sum(axis=1, keepdims=True)
    velocity = velocity - (1 - LINE_OF_SIGHT_WEIGHT) * along * ray
    is_slow = np.linalg.norm(velocity, axis=1) < MAX_FOOT_SPEED * body.stature
    is_straight = np.linalg.norm(hip - ankle, axis=1) > STRAIGHT_LEG_SHARE * leg
    return np.asarray(is_slow & is_straight)


def _find_leaning(
    body: FilmedBody, rests: NDArray[np.bool_], supports: Floats, centre: Floats
) -> tuple[list[Floats], list[Floats]]:
    """Return the slopes (2,) of a body's lean in each second at rest, and variances.

    Leaning is (d_x, d_z) / d_y of the direction d to its centre of mass from where its
    feet at rest support it: rests (2, n), supports (2, n, 3), centre (n, 3). Each is
    the mean over about a second in which a foot rests.
    """
    ankles = [body.joints[f"{side}ankle"] for side in "lr"]
    leaning, variances = [], []
    for begin, end in _runs(np.asarray(rests.any(axis=0)), _min_rest_frames(body)):
        moments = max(round((end - begin) / body.rate), 1)
        for rows in np.array_split(np.arange(begin, end), moments):
            weights = rests[:, rows, None] / rests[:, rows].sum(axis=0)[:, None]
            support = (weights * supports[:, rows]).sum(axis=0)
            d = (centre[rows] - support).mean(axis=0)
            if d[1] > MIN_UPRIGHT_COSINE * np.linalg.norm(d):
                leaning.append(d[[0, 2]] / d[1])
                across = body.deviations[rows][:, ::2]
                sd = across[..., ankles].mean(axis=(0, 2))
                variances.append((sd / np.linalg.norm(d)) ** 2)
    return leaning, variances


def _min_rest_frames(body: FilmedBody) -> float:
    """Return for how many frames a foot must stay where it is to count as at rest."""
    return max(MIN_REST_SECONDS * body.rate, 2)


def _runs(rest: NDArray[np.bool_], min_frames: float) -> list[tuple[int, int]]:
    """Return begin and end of each run of at least `min_frames` frames at rest."""
    turns = np.flatnonzero(np.diff(np.concatenate([[False], rest, [False]])))
    runs = turns.reshape(-1, 2).tolist()
    return [(begin, end) for begin, end in runs if end - begin >= min_frames]


def _fit_plane(foot_sd: float, evidence: Evidence) -> tuple[Floats, Floats]:
    """Fit the floor a x + y + b z + g = 0; return (a, b, g) and its covariance (3, 3).

    By iteratively reweighted least squares, of the leaning and then of the feet. x, y,
    z are in metres in the camera's frame. foot_sd: standard deviation of a foot across
    the line of sight, in metres.
    """
    usual, lean_precision = _mean_leaning(evidence.leaning, evidence.variances)
    prior = np.diag([*(lean_precision + CAMERA_TILT_SD**-2), 0.0])
    x, y, z = evidence.places.T
    A = np.column_stack([x, z, np.ones(len(x))])
    height = -np.median(usual[0] * x + y + usual[1] * z)
    abg = np.array([*usual, height])
    precision = prior
    for _ in range(ROBUST_STEPS):
        r = np.sqrt(1 + abg[0] ** 2 + abg[1] ** 2)
        along = (abg[0] * x + y + abg[1] * z) / r
        target = r * evidence.above - y
        variance = r**2 * (foot_sd**2 + (DEPTH_SD * along) ** 2)
        w = 1 / (variance + (A @ abg - target) ** 2 / 4)
        precision = (A.T * w) @ A + prior
        linear = A.T @ (w * target) + np.array([*(lean_precision * usual), 0.0])
        abg = np.linalg.solve(precision, linear)
    return abg, np.linalg.inv(precision)


def _mean_leaning(leaning: Floats, variances: Floats) -> tuple[Floats, Floats]:
    """Return the robust mean (2,) of `leaning` (k, 2), and its precisions (2,).

    Leaning is a and b, the slopes of the direction up of a body to the right and to the
    viewer; leaning and its variances (k, 2), of k moments.
    """
    usual = np.median(leaning, axis=0)
    weights = np.ones(len(leaning))
    for _ in range(ROBUST_STEPS):
        squares = (((leaning - usual) / SWAY_SD) ** 2).sum(axis=1)
        weights = 1 / (1 + squares / 4)
        usual = weights @ leaning / weights.sum()
    shared = LASTING_SHARE**2 * variances.mean(axis=0)
    return usual, 1 / (SWAY_SD**2 / weights.sum() + LEAN_SD**2 + shared)

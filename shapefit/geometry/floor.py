"""The floor that people stand on, as a camera at rest sees it: how high above it, and
how tilted.

The frame is that of the camera: x right, y up in the image, z towards the viewer,
metres. With the direction n = (a, 1, b) / r that is up, r = sqrt(1 + a^2 + b^2), and
the height h = g / r of the camera, weighted least squares find a, b and g of

    a x + b z + g   = r k - y          feet at rest at (x, y, z), whose landmarks are k
                    above it
    a = d_x / d_y,  b = d_z / d_y      d from the feet that bear a body to its centre of
                    mass
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
"""Where a foot bears a standing body before its ankle, in heights of the body."""

STRAIGHT, SLOW, LOWER, SECONDS = 0.85, 0.17, 0.07, 0.3
"""A leg bears where hip and ankle are at least this share of its length apart, and its
foot moves by at most so many heights of the body a second and is at most so many above
the other, for so many seconds.
"""

ALONG = 1 / 3
"""Weight of motion along the line of sight, which one camera hardly sees."""

LEVEL, SWAY, LEAN = (np.tan(np.radians(degrees)) for degrees in (15.0, 5.0, 2.0))
"""Deviations of tilt: of cameras; of a body from moment to moment; of a body in all
moments alike. Chosen, as the others, on seven filmed bodies.
"""

LASTING = 0.5
"""Share of the deviations of a fit that all frames have in common (docs/sequences.md).
"""

FOOT, DEPTH, SIZE = 0.03, 0.12, 0.04
"""Deviations of a foot across the line of sight in heights of the body and along it in
distances, and of the size of a body.
"""

SURE = 0.29
"""Largest deviation of a height that counts as known, in heights of the body."""

STEPS = 10
"""Of least squares with weights 1 / (1 + u^2 / 4) of residuals u in deviations."""


Bearing = tuple[Floats, Floats, Floats, Floats]


class Body(NamedTuple):
    """A body before the camera: points and their deviations (n, 3, p) in metres, nan in
    gaps.

    joints: the column of each joint; stature in metres; rate in Hz.
    """

    points: Floats
    deviations: Floats
    joints: Mapping[str, int]
    stature: float
    rate: float


class Floor(NamedTuple):
    """The floor below a camera, and standard deviations.

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

    def stand(self, points: Floats) -> Floats:
        """R x + (0, height, 0) with the shortest rotation R up = y; points (..., 3,
        p).
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


def find_floor(bodies: Sequence[Body], distance_sd: float) -> Floor | None:
    """Return the floor; None where no body stands on feet that rest, or they leave it
    unsure.

    distance_sd: standard deviation of the logarithm of the distance, the same for all
    frames.
    """
    needed = {f"{side}{joint}" for side in "lr" for joint in MASS}
    whole = [body for body in bodies if needed <= body.joints.keys()]
    parts = [_bearing(body) for body in whole]
    if not any(len(place) for place, *_ in parts):
        return None
    place, *further = map(np.concatenate, zip(*parts, strict=True))
    stature = float(np.mean([body.stature for body in whole]))
    abg, covariance = _solve(FOOT * stature, place, *further)
    farther = place * np.array([1.0, 1.0, 1 + distance_sd])
    change = _solve(FOOT * stature, farther, *further)[0] - abg
    covariance += np.outer(change, change)
    a, b, g = abg
    r = np.sqrt(1 + a**2 + b**2)
    slope = np.array([-g * a / r**3, -g * b / r**3, 1 / r])
    height_sd = np.sqrt(slope @ covariance @ slope + (SIZE * g / r) ** 2)
    if height_sd > SURE * stature:
        return None
    roll, pitch = np.degrees(np.arctan(abg[:2]))
    roll_sd, pitch_sd = np.degrees(
        np.sqrt(np.diag(covariance)[:2]) / (1 + abg[:2] ** 2)
    )
    numbers = (g / r, pitch, roll, height_sd, pitch_sd, roll_sd)
    return Floor(np.array([a, 1.0, b]) / r, *map(float, numbers))


def _bearing(body: Body) -> Bearing:
    """Return places (m, 3) of feet at rest and how high (m,) above the floor they are;
    how the body leans (k, 2) at moments, and the variances (k, 2) of that.
    """
    X = {joint: body.points[..., column] for joint, column in body.joints.items()}
    trunk = X["lshoulder"] + X["rshoulder"] - X["lhip"] - X["rhip"]
    ahead = np.cross(X["lhip"] - X["rhip"], trunk)
    ahead *= FORWARD * body.stature / np.linalg.norm(ahead, axis=1, keepdims=True)
    parts = (m / 2 * (X[f"l{joint}"] + X[f"r{joint}"]) for joint, m in MASS.items())
    centre = sum(parts, 0 * trunk)
    marks = [mark for mark in ABOVE_FLOOR if {f"l{mark}", f"r{mark}"} <= X.keys()]
    feet = np.stack(
        [np.mean([X[f"{s}{mark}"] for mark in marks], axis=0) for s in "lr"]
    )
    under = np.stack([X[f"{s}ankle"] + ahead for s in "lr"])
    upright = centre - under.mean(axis=0)
    high = (under * upright / np.linalg.norm(upright, axis=1, keepdims=True)).sum(
        axis=2
    )
    rests = np.stack(
        [_rests(body, X, s, foot) for s, foot in zip("lr", feet, strict=True)]
    )
    rests = np.asarray(rests & (high < high.min(axis=0) + LOWER * body.stature))
    fewest = max(SECONDS * body.rate, 2)
    leaning, variances = [], []
    ankles = [body.joints[f"{s}ankle"] for s in "lr"]
    for begin, end in _runs(np.asarray(rests.any(axis=0)), fewest):
        for rows in np.array_split(
            np.arange(begin, end), max(round((end - begin) / body.rate), 1)
        ):
            weights = rests[:, rows, None] / rests[:, rows].sum(axis=0)[:, None]
            d = (centre[rows] - (weights * under[:, rows]).sum(axis=0)).mean(axis=0)
            if d[1] > np.cos(np.pi / 4) * np.linalg.norm(
                d
            ):  # nobody stands nearer to the level
                leaning.append(d[[0, 2]] / d[1])
                sd = body.deviations[rows][:, ::2][..., ankles].mean(axis=(0, 2))
                variances.append((sd / np.linalg.norm(d)) ** 2)
    places = [
        foot[begin:end].mean(axis=0)
        for foot, rest in zip(feet, rests if leaning else (), strict=False)
        for begin, end in _runs(rest, fewest)
    ]
    above = body.stature * float(np.mean([ABOVE_FLOOR[mark] for mark in marks]))
    shaped = (np.reshape(leaning, (-1, 2)), np.reshape(variances, (-1, 2)))
    return (np.reshape(places, (-1, 3)), np.full(len(places), above), *shaped)


def _rests(
    body: Body, X: Mapping[str, Floats], side: str, foot: Floats
) -> NDArray[np.bool_]:
    """Whether a foot (n, 3) is slow and below a leg that is straight."""
    hip, knee, ankle = (X[f"{side}{joint}"] for joint in ("hip", "knee", "ankle"))
    leg = np.linalg.norm(hip - knee, axis=1) + np.linalg.norm(knee - ankle, axis=1)
    step, frame = max(round(body.rate * SECONDS / 2), 1), np.arange(len(foot))
    early, late = np.maximum(frame - step, 0), np.minimum(frame + step, len(foot) - 1)
    moved = (
        (foot[late] - foot[early]) * body.rate / np.maximum(late - early, 1)[:, None]
    )
    ray = foot / np.linalg.norm(foot, axis=1, keepdims=True)
    moved = moved - (1 - ALONG) * (moved * ray).sum(axis=1, keepdims=True) * ray
    slow = np.linalg.norm(moved, axis=1) < SLOW * body.stature
    return np.asarray(slow & (np.linalg.norm(hip - ankle, axis=1) > STRAIGHT * leg))


def _runs(rest: NDArray[np.bool_], fewest: float) -> list[tuple[int, int]]:
    """Return begin and end of each run of at least so many frames."""
    turns = np.flatnonzero(np.diff(np.concatenate([[False], rest, [False]])))
    return [(b, e) for b, e in turns.reshape(-1, 2).tolist() if e - b >= fewest]


def _solve(
    foot_sd: float, place: Floats, above: Floats, leaning: Floats, variance: Floats
) -> tuple[Floats, Floats]:
    """Return a, b, g and their covariance; foot_sd of a foot across the line of
    sight.
    """
    shared = LASTING**2 * variance.mean(axis=0)
    usual, weights = np.median(leaning, axis=0), np.ones(len(leaning))
    for _ in range(STEPS):
        weights = 1 / (1 + (((leaning - usual) / SWAY) ** 2).sum(axis=1) / 4)
        usual = weights @ leaning / weights.sum()
    lean_precision = 1 / (SWAY**2 / weights.sum() + LEAN**2 + shared)
    prior = np.diag([*(lean_precision + LEVEL**-2), 0.0])
    x, y, z = place.T
    A = np.column_stack([x, z, np.ones(len(x))])
    abg = np.array([*usual, -np.median(usual[0] * x + y + usual[1] * z)])
    precision = prior
    for _ in range(STEPS):
        r = np.sqrt(1 + abg[0] ** 2 + abg[1] ** 2)
        along = (abg[0] * x + y + abg[1] * z) / r
        target = r * above - y
        foot = r**2 * (foot_sd**2 + (DEPTH * along) ** 2)
        w = 1 / (foot + (A @ abg - target) ** 2 / 4)
        precision = (A.T * w) @ A + prior
        linear = A.T @ (w * target) + np.array([*(lean_precision * usual), 0.0])
        abg = np.linalg.solve(precision, linear)
    return abg, np.linalg.inv(precision)

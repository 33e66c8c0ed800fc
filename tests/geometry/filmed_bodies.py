"""Bodies that walk, stand, sit or lie before a camera of known height and tilt."""

import numpy as np

from shapefit.geometry.floor import ABOVE_FLOOR, FORWARD
from shapefit.geometry.rotations import rotation_about_axis

RATE = 25.0
"""Frames a second."""

TALL = 1.7
"""Height of a body in metres."""

LEVELS = {
    "hip": (0.1, 0.93),
    "shoulder": (0.18, 1.4),
    "elbow": (0.25, 1.15),
    "wrist": (0.25, 0.9),
}
"""Joints of a body: how far to the side, and how high, in metres."""

JOINTS = {
    f"{side}{joint}": 6 * number + place
    for number, side in enumerate("lr")
    for place, joint in enumerate((*LEVELS, "knee", "ankle"))
}
"""Joint -> its column."""

ANKLES = [JOINTS["lankle"], JOINTS["rankle"]]
KNEES = [JOINTS["lknee"], JOINTS["rknee"]]


def walk(seconds=6.25, speed=0.8, step=0.5, heading=0.0):
    """Return a body (n, 3, 12) that walks on y = 0: one foot rests while the other
    passes it.
    """
    t = np.arange(round(seconds * RATE)) / RATE
    along = speed * t - 0.5 * step + FORWARD * TALL
    points = np.zeros((len(t), 3, len(JOINTS)))
    for side, sign, late in (("l", 1, 0.0), ("r", -1, 1.0)):
        for joint, (aside, high) in LEVELS.items():
            points[..., JOINTS[f"{side}{joint}"]] = _track(aside * sign, high, along)
        steps = (t * speed / step + late) / 2
        ankle = _walking_ankle(0.1 * sign, steps, step, late)
        hip = points[..., JOINTS[f"{side}hip"]]
        points[..., JOINTS[f"{side}ankle"]] = ankle
        points[..., JOINTS[f"{side}knee"]] = (ankle + hip) / 2
    return rotation_about_axis(1, np.float64(heading)) @ points


def _track(aside, high, along):
    """Return the places (n, 3) of a joint: to the side, up, and along the way."""
    return np.stack(np.broadcast_arrays(aside, high, along), axis=1)


def _walking_ankle(aside, steps, step, late):
    """Return an ankle (n, 3) that rests for the first half of each of its steps, and
    swings for the second.
    """
    swing = np.clip(2 * (steps % 1) - 1, 0, 1)
    high = ABOVE_FLOOR["ankle"] * TALL + 0.1 * np.sin(np.pi * swing)
    along = step * (2 * (np.floor(steps) + swing) - late)
    return _track(aside, high, along)


def still(seconds=3.0):
    """Return a body that stands."""
    points = np.repeat(walk(0.04), round(seconds * RATE), axis=0)
    points[:, 2, ANKLES] = 0.0
    points[:, 2] -= points[:, 2, [JOINTS["lhip"]]] - FORWARD * TALL
    points[:, 2, ANKLES] = 0.0
    return points


def sitting():
    points = still()
    above_knees = [JOINTS[f"{side}{joint}"] for side in "lr" for joint in LEVELS]
    points[:, 1, above_knees] -= 0.45
    points[:, 2, above_knees] -= 0.4
    points[:, :, KNEES] = np.array([0.1, 0.5, 0.05])[:, None]
    return points


def lying():
    return still()[:, [1, 2, 0]]


def visible(points, height=1.5, pitch=12.0, roll=-5.0, away=5.0):
    """Return points (n, 3, p) as a camera has them, and the direction that is up for
    it.
    """
    pitched = rotation_about_axis(0, np.radians(np.float64(pitch)))
    rolled = rotation_about_axis(2, np.radians(np.float64(-roll)))
    turn = rolled @ pitched
    middle = points.mean(axis=(0, 2)) * [1.0, 0.0, 1.0]
    camera = middle + np.array([0.0, height, away])
    return turn @ (points - camera[:, None]), turn[:, 1]

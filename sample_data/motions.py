"""Eight activities as key frames of joint angles over one cycle, and their variation.

A channel (see `skeleton`) is a list of (phase, value) over one period, phase in [0, 1), joined by a
periodic, monotone cubic. Angles in degrees, `lift` in metres.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

Floats = NDArray[np.float64]
Keys = tuple[tuple[float, float], ...]

FRAME_RATE = 24


@dataclass(frozen=True)
class Activity:
    """One cycle of `period` seconds: channel -> key frames."""

    period: float
    channels: Mapping[str, Keys]


def alternate(shift: float = 0.0, **limbs: Keys) -> dict[str, Keys]:
    """Both sides do the same half a cycle apart; the right one starts at `shift`."""
    return {
        side + channel: tuple(((phase + offset) % 1, value) for phase, value in keys)
        for channel, keys in limbs.items()
        for side, offset in (("r", shift), ("l", shift + 0.5))
    }


def both(**limbs: Keys) -> dict[str, Keys]:
    """Both sides do the same at the same time."""
    return {side + channel: keys for channel, keys in limbs.items() for side in "rl"}


def still(value: float) -> Keys:
    """A channel that keeps its value."""
    return ((0.0, value),)


ACTIVITIES: Mapping[str, Activity] = {
    "walk": Activity(
        1.10,
        alternate(
            hip=((0, 28), (0.30, 4), (0.52, -14), (0.62, -4), (0.84, 32)),
            knee=((0, 4), (0.14, 18), (0.40, 5), (0.60, 40), (0.73, 63), (0.94, 4)),
            hip_out=((0, 2), (0.5, 4)),
        )
        | alternate(0.5, arm=((0, 24), (0.5, -20)), elbow=((0, 36), (0.5, 14)))
        | both(arm_out=still(9), arm_turn=still(10))
        | {"twist": ((0, 9), (0.5, -9)), "yaw": ((0, -5), (0.5, 5)), "lean": still(3)},
    ),
    "run": Activity(
        0.72,
        alternate(
            hip=((0, 36), (0.33, -20), (0.45, -14), (0.78, 58)),
            knee=((0, 20), (0.14, 42), (0.33, 14), (0.60, 112), (0.90, 28)),
            hip_out=still(3),
        )
        | alternate(0.5, arm=((0, 34), (0.5, -46)), elbow=((0, 112), (0.5, 84)))
        | both(arm_out=still(14), arm_turn=still(25))
        | {
            "twist": ((0, 14), (0.5, -14)),
            "yaw": ((0, -7), (0.5, 7)),
            "lean": still(10),
            "lift": ((0.02, 0), (0.30, 0), (0.42, 0.09), (0.52, 0), (0.80, 0), (0.92, 0.09)),
        },
    ),
    "jump": Activity(
        1.90,
        both(
            hip=((0, 4), (0.26, 92), (0.42, 2), (0.55, 22), (0.68, 30), (0.80, 78), (0.95, 6)),
            knee=((0, 6), (0.26, 104), (0.42, 4), (0.55, 34), (0.68, 24), (0.80, 92), (0.95, 8)),
            arm=((0, 8), (0.24, -52), (0.45, 168), (0.62, 150), (0.80, 55), (0.95, 10)),
            elbow=((0, 12), (0.24, 20), (0.45, 14), (0.80, 40)),
            hip_out=((0, 5), (0.26, 16), (0.50, 6), (0.80, 16)),
            arm_out=((0, 8), (0.50, 18)),
        )
        | {
            "lean": ((0, 2), (0.26, 34), (0.45, -4), (0.80, 26)),
            "bend": ((0, 2), (0.26, 14), (0.45, -6), (0.80, 12)),
            "nod": ((0, 0), (0.26, -30), (0.50, -8), (0.80, -20)),
            "lift": ((0.42, 0), (0.48, 0.22), (0.55, 0.34), (0.62, 0.22), (0.69, 0), (0.99, 0)),
        },
    ),
    "box": Activity(
        1.40,
        {
            "rarm": ((0, 42), (0.13, 46), (0.24, 86), (0.36, 46), (0.80, 40)),
            "relbow": ((0, 132), (0.13, 136), (0.24, 12), (0.36, 130), (0.80, 134)),
            "rarm_turn": ((0, 20), (0.24, 55), (0.36, 20)),
            "rarm_out": ((0, 18), (0.24, 4), (0.36, 18)),
            "larm": ((0, 46), (0.55, 50), (0.66, 90), (0.78, 48)),
            "lelbow": ((0, 120), (0.55, 126), (0.66, 10), (0.78, 122)),
            "larm_turn": ((0, 20), (0.66, 50), (0.78, 20)),
            "larm_out": ((0, 20), (0.66, 2), (0.78, 20)),
            "twist": ((0, -16), (0.13, -26), (0.24, 44), (0.40, -12), (0.55, -8), (0.66, -36)),
            "yaw": ((0, -24), (0.24, -8), (0.45, -26), (0.66, -34)),
            "turn": ((0, 30), (0.24, -24), (0.45, 26), (0.66, 46)),
            "lean": still(8),
            "bend": ((0, 6), (0.24, 14), (0.45, 6), (0.66, 12)),
            "rhip": ((0, -2), (0.24, -10), (0.45, 0)),
            "rknee": ((0, 26), (0.24, 22), (0.45, 30)),
            "lhip": ((0, 42), (0.24, 48), (0.45, 40), (0.66, 50)),
            "lknee": ((0, 46), (0.24, 54), (0.45, 44), (0.66, 56)),
            "rhip_out": still(12),
            "lhip_out": still(8),
        },
    ),
    "wave": Activity(
        3.20,
        {
            "rarm_out": ((0, 8), (0.16, 96), (0.30, 104), (0.70, 100), (0.86, 60), (0.97, 8)),
            "rarm_turn": ((0, 0), (0.16, -70), (0.30, -92), (0.72, -92), (0.86, -40), (0.97, 0)),
            "relbow": (
                *((0, 12), (0.16, 70), (0.26, 112), (0.35, 42), (0.44, 108), (0.53, 42)),
                *((0.62, 108), (0.72, 50), (0.86, 70), (0.97, 12)),
            ),
            "larm": ((0, 4), (0.4, 14)),
            "larm_out": still(10),
            "lelbow": ((0, 16), (0.5, 26)),
            "side": ((0, 0), (0.35, 8), (0.7, 6)),
            "roll": ((0, 0), (0.4, -4)),
            "turn": ((0, 8), (0.4, -14)),
            "twist": ((0, 4), (0.45, -8)),
            "rhip": ((0, 3), (0.5, -3)),
            "lhip": ((0, 2), (0.5, 12)),
            "lknee": ((0, 4), (0.5, 22)),
            **both(hip_out=still(6)),
        },
    ),
    "squat": Activity(
        3.00,
        both(
            hip=((0, 3), (0.38, 98), (0.55, 102), (0.92, 4)),
            knee=((0, 4), (0.38, 108), (0.55, 112), (0.92, 5)),
            hip_out=((0, 7), (0.45, 22)),
            arm=((0, 4), (0.38, 84), (0.55, 80), (0.92, 6)),
            arm_out=((0, 8), (0.45, 12)),
            elbow=((0, 14), (0.45, 26)),
        )
        | {
            "lean": ((0, 1), (0.38, 26), (0.55, 24), (0.92, 2)),
            "bend": ((0, 0), (0.45, 10)),
            "nod": ((0, 0), (0.45, -22)),
        },
    ),
    "kick": Activity(
        1.80,
        {
            "rhip": ((0, -4), (0.22, -34), (0.42, 84), (0.52, 78), (0.75, 4)),
            "rknee": ((0, 8), (0.22, 88), (0.42, 12), (0.52, 24), (0.66, 62), (0.85, 12)),
            "rhip_out": ((0, 6), (0.22, 14), (0.42, 6)),
            "lhip": ((0, 4), (0.22, 22), (0.42, -12), (0.75, 6)),
            "lknee": ((0, 8), (0.22, 34), (0.42, 12), (0.75, 10)),
            "lean": ((0, 2), (0.22, 16), (0.42, -22), (0.75, 4)),
            "bend": ((0, 2), (0.22, 6), (0.42, 20), (0.75, 4)),
            "twist": ((0, 0), (0.22, -22), (0.42, 26), (0.75, 0)),
            "yaw": ((0, 0), (0.22, 14), (0.42, -16), (0.75, 0)),
            "larm": ((0, 6), (0.22, -30), (0.42, 62), (0.75, 10)),
            "larm_out": ((0, 12), (0.22, 66), (0.42, 22), (0.75, 14)),
            "lelbow": ((0, 16), (0.22, 12), (0.42, 34)),
            "rarm": ((0, 6), (0.22, 36), (0.42, -44), (0.75, 4)),
            "rarm_out": ((0, 12), (0.22, 24), (0.42, 48), (0.75, 14)),
            "relbow": ((0, 18), (0.22, 44), (0.42, 14)),
            "nod": ((0, 6), (0.3, 14)),
        },
    ),
    "throw": Activity(
        2.20,
        {
            "rarm": ((0, 10), (0.20, 6), (0.36, 4), (0.48, 70), (0.60, 62), (0.85, 12)),
            "rarm_out": ((0, 10), (0.20, 70), (0.36, 98), (0.46, 76), (0.60, 2), (0.85, 8)),
            "rarm_turn": ((0, 10), (0.20, -40), (0.36, -112), (0.48, -20), (0.60, 50), (0.85, 12)),
            "relbow": ((0, 20), (0.20, 80), (0.36, 98), (0.48, 14), (0.60, 26), (0.85, 22)),
            "larm": ((0, 10), (0.20, 44), (0.34, 84), (0.48, 18), (0.60, -24), (0.85, 6)),
            "larm_out": ((0, 10), (0.30, 34), (0.55, 24)),
            "lelbow": ((0, 20), (0.30, 16), (0.50, 74), (0.75, 30)),
            "twist": ((0, 0), (0.32, -42), (0.50, 36), (0.62, 40), (0.88, 2)),
            "yaw": ((0, 0), (0.30, -36), (0.52, 18), (0.88, 0)),
            "turn": ((0, 0), (0.32, 64), (0.52, -36), (0.88, 0)),
            "lean": ((0, 2), (0.30, -10), (0.54, 26), (0.88, 3)),
            "side": ((0, 0), (0.32, -10), (0.50, 16), (0.88, 0)),
            "lhip": ((0, 6), (0.20, 62), (0.40, 34), (0.56, 48), (0.88, 6)),
            "lknee": ((0, 8), (0.20, 78), (0.38, 12), (0.56, 38), (0.88, 8)),
            "rhip": ((0, 2), (0.25, 10), (0.40, -24), (0.56, -16), (0.80, 22)),
            "rknee": ((0, 6), (0.25, 24), (0.40, 22), (0.56, 46), (0.72, 58), (0.90, 8)),
            **both(hip_out=still(7)),
        },
    ),
}


def mirrored(activity: Activity) -> Activity:
    """Return the activity of a left-handed person."""
    swapped: dict[str, Keys] = {}
    for channel, keys in activity.channels.items():
        if channel in ("yaw", "roll", "twist", "side", "turn"):
            swapped[channel] = tuple((phase, -value) for phase, value in keys)
        elif channel[0] in "rl" and channel not in ("lean", "lift"):
            swapped[("l" if channel[0] == "r" else "r") + channel[1:]] = keys
        else:
            swapped[channel] = keys
    return Activity(activity.period, swapped)


def perform(activity: Activity, frames: int, rng: np.random.Generator) -> dict[str, Floats]:
    """Perform `activity` for `frames` frames at 24 fps as one person would on one day.

    Tempo, start and vigour differ from performance to performance, posture wanders slowly, and the
    person turns by some tens of degrees.
    """
    time = np.arange(frames) / FRAME_RATE
    tempo = rng.uniform(0.85, 1.15)
    phase = rng.uniform() + tempo * time / activity.period + 0.03 * _wander(time, rng)
    motion = {}
    for channel, keys in activity.channels.items():
        wave = _periodic(keys, phase)
        vigour = rng.uniform(0.85, 1.12)
        motion[channel] = wave.mean() + vigour * (wave - wave.mean()) if channel != "lift" else wave
    for channel in sorted(set(motion) | {"nod", "turn", "bend", "side", "twist"}):
        if channel == "lift":
            continue
        reach = 6.0 if "arm" in channel or "elbow" in channel else 3.0
        motion[channel] = motion.get(channel, 0.0) + reach * _wander(time, rng)
    for joint in ("rknee", "lknee", "relbow", "lelbow"):  # neither bends backwards
        motion[joint] = _above(motion.get(joint, np.zeros(frames)), 3.0)
    motion["yaw"] = motion.get("yaw", 0.0) + 15 * _wander(time, rng)
    return motion


def _periodic(keys: Keys, phase: Floats) -> Floats:
    """Value of the periodic cubic through `keys` at `phase`."""
    at, value = np.array(sorted(keys), dtype=float).T
    tiled = np.concatenate([at - 1, at, at + 1])
    if len(at) == 1:
        return np.full(phase.shape, value[0])
    return PchipInterpolator(tiled, np.tile(value, 3))(phase % 1)


def _wander(time: Floats, rng: np.random.Generator) -> Floats:
    """Sum three slow sinusoids plus an offset, about unit size."""
    frequency = rng.uniform(0.08, 0.5, size=3)
    start = rng.uniform(0, 2 * np.pi, size=3)
    waves = np.sin(2 * np.pi * frequency * time[:, None] + start) @ np.full(3, 0.4)
    return waves + rng.uniform(-0.6, 0.6)


def _above(angle: Floats, least: float) -> Floats:
    """max(angle, least) with a rounded corner, degrees."""
    return least + 0.5 * (angle - least + np.sqrt((angle - least) ** 2 + 16.0))

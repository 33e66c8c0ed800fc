"""Make openpose/: two people who walk past each other, as OpenPose's BODY_25 would find them.

Run from the project's folder: python -m sample_data.make_openpose [FOLDER]
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sample_data.make_people import (
    ACTIVITIES,
    FRAME_RATE,
    SEED,
    STATURES,
    perform,
    proportions,
)
from sample_data.skeleton import JOINTS, joints

Floats = NDArray[np.float64]

BODY_25 = (
    *("Nose", "Neck", "RShoulder", "RElbow", "RWrist", "LShoulder", "LElbow", "LWrist"),
    *("MidHip", "RHip", "RKnee", "RAnkle", "LHip", "LKnee", "LAnkle", "REye", "LEye", "REar"),
    *("LEar", "LBigToe", "LSmallToe", "LHeel", "RBigToe", "RSmallToe", "RHeel"),
)
FRAMES = 36
SPEED = 1.3  # metres per second
HEADING = np.radians(25)  # towards the camera, from straight across
FOCAL_LENGTH = 1100.0
IMAGE = (1280, 720)
CAMERA_HEIGHT = 1.1
NOISE = 1.5  # pixels
HIDDEN_WITHIN = 14.0  # pixels from the limbs of who is nearer


def main(folder: Path) -> None:
    """Write a file per frame; the order of people changes from frame to frame."""
    rng = np.random.default_rng(SEED)
    near = visible(walker("emil", 1, 4.6, rng))
    far = visible(walker("fatma", -1, 6.2, rng))
    target = folder / "openpose"
    target.mkdir(parents=True, exist_ok=True)
    for frame in range(FRAMES):
        covered = np.linalg.norm(far[frame, :, None] - near[frame], axis=2).min(axis=1)
        found = [
            detected(near[frame], np.zeros(len(BODY_25), dtype=bool), rng),
            detected(far[frame], covered < HIDDEN_WITHIN, rng),
        ]
        if rng.random() < 0.5:
            found.reverse()
        people = [{"person_id": [-1], "pose_keypoints_2d": person} for person in found]
        name = f"walk_{frame:012d}_keypoints.json"
        text = json.dumps({"version": 1.3, "people": people}, separators=(",", ":"))
        (target / name).write_text(text + "\n", encoding="utf-8")


def walker(name: str, direction: int, depth: float, rng: np.random.Generator) -> Floats:
    """Landmarks (frames, 25, 3) of a person who walks across the image; metres, y up, z away."""
    body = proportions(STATURES[name], rng)
    here = joints(perform(ACTIVITIES["walk"], FRAMES, rng), body)
    place = {joint: here[:, number] for number, joint in enumerate(JOINTS)}
    across = place["lshoulder"] - place["rshoulder"]
    left = across / np.linalg.norm(across, axis=1, keepdims=True)
    up = np.array([0.0, 1.0, 0.0])
    ahead = np.cross(left, up)
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    points = {
        side.upper() + joint.capitalize(): place[side + joint]
        for side in "rl"
        for joint in ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")
    }
    points["Neck"] = (points["RShoulder"] + points["LShoulder"]) / 2
    points["MidHip"] = (points["RHip"] + points["LHip"]) / 2
    face = place["head"] - 0.09 * up
    points["Nose"] = face + 0.11 * ahead
    for side, sign in (("R", -1), ("L", 1)):
        points[f"{side}Eye"] = face + 0.09 * ahead + 0.035 * up + sign * 0.035 * left
        points[f"{side}Ear"] = face + 0.02 * up + sign * 0.075 * left
        ankle = points[f"{side}Ankle"]
        points[f"{side}BigToe"] = ankle + 0.18 * ahead - 0.06 * up - sign * 0.03 * left
        points[f"{side}SmallToe"] = ankle + 0.15 * ahead - 0.06 * up + sign * 0.05 * left
        points[f"{side}Heel"] = ankle - 0.05 * ahead - 0.06 * up
    stacked = np.stack([points[landmark] for landmark in BODY_25], axis=1)
    c, s = np.cos(HEADING), np.sin(HEADING)
    left_of_body, ahead_of_body = np.array([s, 0, direction * c]), np.array([direction * c, 0, -s])
    turn = np.stack([left_of_body, up, ahead_of_body], axis=1)
    walked = SPEED * (np.arange(FRAMES) - FRAMES / 2) / FRAME_RATE
    way = walked[:, None] * ahead_of_body + [0, 0, depth]
    return np.asarray(stacked @ turn.T + way[:, None])


def visible(points: Floats) -> Floats:
    """Points (..., 3) -> pixels (..., 2), y down, of a camera that looks along z."""
    flat = points[..., :2] * [1, -1] + [0, CAMERA_HEIGHT]
    return np.asarray(FOCAL_LENGTH * flat / points[..., 2:] + np.array(IMAGE) / 2)


def detected(pixels: Floats, hidden: NDArray[np.bool_], rng: np.random.Generator) -> list[float]:
    """Return x, y and confidence of each landmark, 0 0 0 where it is hidden or missed."""
    noisy = pixels + NOISE * rng.standard_normal(pixels.shape)
    confidence = rng.uniform(0.55, 0.95, len(pixels))
    missed = hidden | (rng.random(len(pixels)) < 0.02)
    rows = np.column_stack([noisy.round(1), confidence.round(2)])
    rows[missed] = 0
    return [float(value) for value in rows.ravel()]


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)

"""People as a video shows them: a camera at rest, a detector's joints, noise that lasts.

`python -m benchmarks.footage --data FOLDER` shows clips of motion capture to a camera, lifts what a
detector would have found by each method, judges it, and writes results/footage/index.md. The
dictionary is that of subject 86, who is in no clip; the bodies scored are 13 and 14, `--bodies`
takes others to choose settings on.

A clip lasts 1.7 to 10 s. The camera stands 2 to 5 m for each metre of the body away, tilted and
rolled by 12 degrees (standard deviation), and sees 1920 x 1080 pixels through 0.8 to 1.5 times its
width. Landmarks are those of BODY_25B on legs, arms and head: hips wider and heads higher than the
joints by factors of each body. What is found is off by a constant of each landmark and clip, and by
noise whose correlation in time is that of OpenPose's residuals on the man on a beam
(`pose2sim_balancing`, cameras 1 and 3: constants of 1.8 cm a coordinate, hips included, and the
rest 1.6 and 2.2 cm with correlations of 0.78 and 0.85 from frame to frame at 60 Hz, 0.65 and 0.74
over two, 0.15 and 0.46 over five). A tenth is not found, some frames at a time.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.judged import (
    CONFIGS,
    DATA,
    cells,
    coverage,
    errors_and_bars,
    read_bodies,
    run,
    settings,
    write_images,
    write_page,
)
from shapefit.io import write_shapes
from shapefit.io.records import LandmarkSet, ShapeSet
from shapefit.io.skeletons import SKELETONS, THETA, people_parts

Floats = NDArray[np.float64]

FOLDER = Path("results/footage")
METHODS = ("convex", "posterior", "sequences")
FILES = ("subject13", "subject14", "other_subjects")
SCORED = ("13", "14")
SECONDS = (1.7, 10.0)
AWAY = (2.0, 5.0)
TILT = np.radians(12.0)
SIZE = (1920, 1080)
FOCAL = (0.8, 1.5)
CONSTANT, LASTING = 0.013, 0.02
"""Standard deviations in metres of a coordinate: the same over a clip, and with the memory."""

MEMORY = 0.11
"""Seconds in which the correlation of the noise falls to 1/e."""

UNSEEN, GAP = 0.1, 5.0
"""Share of the landmarks that are not found, and the mean length of a gap in frames."""

BODY_SPREAD = {"head": 0.1, "hips": 0.1}
"""Spread of the logarithms of the factors of a body, about the means of `THETA`."""


def choose_clips(
    shapes: ShapeSet, count: int, longest: float, rng: np.random.Generator
) -> list[NDArray[np.intp]]:
    """Return the rows of clips of random sequences, from a random frame on."""
    names = np.array(shapes.sequences)
    rate = shapes.frame_rate or 24.0
    lengths = {name: int((names == name).sum()) for name in dict.fromkeys(names.tolist())}
    fine = [name for name, length in lengths.items() if length >= SECONDS[0] * rate]
    chosen = rng.choice(fine, size=min(count, len(fine)), replace=False)
    clips = []
    for name in sorted(chosen):
        rows = np.flatnonzero(names == name)
        frames = min(int(rate * rng.uniform(SECONDS[0], longest)), len(rows))
        first = rng.integers(0, len(rows) - frames + 1)
        clips.append(rows[first : first + frames])
    return clips


def look(points: Floats, rng: np.random.Generator) -> tuple[Floats, float]:
    """Return a clip (t, 3, p), y up, as a camera at rest has it, and its focal length."""
    tall = float(np.ptp(points[:, 1], axis=1).max())
    yaw = rng.uniform(0, 2 * np.pi)
    tilt, roll = (TILT * rng.standard_normal(2)).tolist()
    middle = points.mean(axis=(0, 2))
    turned = turn(2, roll) @ turn(0, tilt) @ np.diag([1.0, -1.0, -1.0]) @ turn(1, yaw)
    seen = turned @ (points - middle[:, None])
    seen[:, 2] += tall * rng.uniform(*AWAY)
    seen[:, 2] += max(0.0, 0.5 - float(seen[:, 2].min()))
    return seen, SIZE[0] * rng.uniform(*FOCAL)


def turn(axis: int, angle: float) -> Floats:
    """Return the rotation about a coordinate axis."""
    i, j = (axis + 1) % 3, (axis + 2) % 3
    R = np.eye(3)
    R[[i, j], [i, j]] = np.cos(angle)
    R[i, j], R[j, i] = -np.sin(angle), np.sin(angle)
    return R


def lasting_noise(frames: int, landmarks: int, rate: float, rng: np.random.Generator) -> Floats:
    """Noise (t, 2, m) in metres: a constant, and what forgets itself in `MEMORY` seconds."""
    keep = np.exp(-1 / (rate * MEMORY))
    noise = rng.standard_normal((frames, 2, landmarks))
    for t in range(1, frames):
        noise[t] = keep * noise[t - 1] + np.sqrt(1 - keep**2) * noise[t]
    constant: Floats = CONSTANT * rng.standard_normal((2, landmarks))
    return constant + LASTING * noise


def gaps(frames: int, landmarks: int, rng: np.random.Generator) -> NDArray[np.bool_]:
    """Which landmarks (t, m) are not found: gaps begin and end by chance."""
    begins, ends = UNSEEN / (1 - UNSEEN) / GAP, 1 / GAP
    hidden = np.empty((frames, landmarks), dtype=bool)
    hidden[0] = rng.random(landmarks) < UNSEEN
    for t in range(1, frames):
        hidden[t] = rng.random(landmarks) < np.where(hidden[t - 1], 1 - ends, begins)
    return hidden


def landmark_rows(
    joints: Sequence[str], theta: Mapping[str, float]
) -> tuple[tuple[str, ...], Floats]:
    """Return the landmarks of the detector, and the weights (m, p) of the joints in them."""
    people = SKELETONS["body_25b"].people
    names = tuple(name for name, joint in people.items() if joint in joints)
    rows = np.zeros((len(names), len(joints)))
    for row, part in enumerate(people_parts(names).values()):
        for joint, weight in part.weights(theta).items():
            rows[row, list(joints).index(joint)] = weight
    return names, rows


def film(
    shapes: ShapeSet, clips: Sequence[NDArray[np.intp]], rng: np.random.Generator
) -> tuple[LandmarkSet, ShapeSet]:
    """Return what a detector finds in clips of a body, and the truth as the camera has it."""
    theta = {
        name: THETA[name].mean * np.exp(spread * rng.standard_normal())
        for name, spread in BODY_SPREAD.items()
    }
    names, rows = landmark_rows(shapes.landmark_names, theta)
    rate = shapes.frame_rate or 24.0
    found, truth, items, sequences, cameras = [], [], [], [], []
    for number, clip in enumerate(clips):
        seen, focal = look(shapes.shapes[clip], rng)
        marks = seen @ rows.T
        marks[:, :2] += lasting_noise(len(clip), len(names), rate, rng)
        pixels = focal * marks[:, :2] / marks[:, 2:] + np.array(SIZE)[:, None] / 2
        hidden = gaps(len(clip), len(names), rng)
        found.append(np.where(hidden[:, None], np.nan, pixels))
        truth.append(seen)
        items += [f"clip{number}/{t:04}" for t in range(len(clip))]
        sequences += [f"clip{number}"] * len(clip)
        cameras += [focal] * len(clip)
    images = LandmarkSet(
        landmarks=np.concatenate(found),
        landmark_names=names,
        items=tuple(items),
        sequences=tuple(sequences),
        unit="px",
        y_axis="down",
        frame_rate=rate,
        columns={"true_focal": np.array(cameras), "image_size": np.array(SIZE)},
    )
    known = ShapeSet(
        shapes=np.concatenate(truth),
        landmark_names=shapes.landmark_names,
        items=tuple(items),
        sequences=tuple(sequences),
        unit=shapes.unit,
        frame_rate=rate,
    )
    return images, known


def make(data: Path, body: str, shapes: ShapeSet, count: int, longest: float) -> tuple[Path, Path]:
    """Write the footage of a body: landmarks and truth. The same for the same body and clips."""
    rng = np.random.default_rng([int(body), count])
    images, truth = film(shapes, choose_clips(shapes, count, longest, rng), rng)
    paths = FOLDER / body / "landmarks.h5", FOLDER / body / "truth.h5"
    write_images(paths[0], images)
    write_shapes(paths[1], truth)
    return paths


def main() -> None:
    """Film, lift and judge all bodies, and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=DATA / "mocap")
    parser.add_argument("--bodies", nargs="*", default=SCORED)
    parser.add_argument("--methods", nargs="*", default=METHODS)
    parser.add_argument("--clips", type=int, default=24)
    parser.add_argument("--longest", type=float, default=SECONDS[1], help="seconds of a clip")
    parser.add_argument("--set", nargs="*", default=[], dest="settings", help="of fit")
    given = parser.parse_args()
    FOLDER.mkdir(parents=True, exist_ok=True)
    dictionary = FOLDER / "dictionary.h5"
    if not dictionary.exists():
        config = CONFIGS / "people/learn-dict.yaml"
        run("learn-dict", "-c", config, "-o", dictionary, "--set", f"data={given.data}")
    own = settings(given.settings)
    rows, regions = [], []
    for body, shapes in read_bodies(given.data, FILES, given.bodies).items():
        landmarks, truth = make(given.data, body, shapes, given.clips, given.longest)
        results = [landmarks.with_name(f"{method}.h5") for method in given.methods]
        for method, result in zip(given.methods, results, strict=True):
            config = CONFIGS / f"detected/fit-{method}.yaml"
            run("fit", "-c", config, landmarks, "-d", dictionary, "-o", result, *own)
        run("eval", "-c", CONFIGS / "detected/eval.yaml", *results, "--truth", truth,
            "-o", landmarks.with_name("report"), "--set", "plots=false", failures=True)  # fmt: skip
        report = landmarks.with_name("report") / "report.json"
        rows.append([f"subject {body}", *cells(report, given.methods)])
        regions.append([f"subject {body}", *coverage(report)])
        print(" | ".join(rows[-1] + regions[-1][1:]), flush=True)
    page = errors_and_bars("# Footage", ["body", *given.methods], rows, regions)
    write_page(FOLDER, page)


if __name__ == "__main__":
    main()

"""Make animal_train.h5, animal_walk.csv and animal_truth.h5: a class of one's own, start to end.

Run from the project's folder: python -m sample_data.make_animal [FOLDER]
"""

from __future__ import annotations

import sys
from dataclasses import astuple, replace
from pathlib import Path

import numpy as np

from sample_data.animal import EDGES, FRAME_RATE, LANDMARKS, MIRROR, Dog, Floats, perform, places
from sample_data.storage import write_shapes

SEED = 20150607
ACTIVITIES = {
    "walk": {"speed": 1.0, "rate": 1.3, "stride": 24},
    "trot": {"speed": 2.0, "rate": 2.1, "stride": 30, "trot": 1},
    "left": {"speed": 0.8, "rate": 1.2, "stride": 20, "turn": 55},
    "right": {"speed": 0.8, "rate": 1.2, "stride": 20, "turn": -55},
    "sniff": {"speed": 0.3, "rate": 0.7, "stride": 10, "head": 62},
}
DOGS = ("bello", "fina", "rex")
FRAMES, FILMED = 40, 100
DECIMALS = 4

FOCAL_LENGTH, CENTRE = 1100.0, np.array([640.0, 360.0])
CAMERA = np.array([0.0, 0.9, 4.2])  # where the middle of the walk is from it: left, down, away
NOISE = 1.5  # pixels
MISSED, SURE = 0.06, 0.9  # share of landmarks that are missed; least likelihood of the others


def main(folder: Path) -> None:
    rng = np.random.default_rng(SEED)
    clips = {
        f"{activity}_{name}": places(perform(does, FRAMES, rng), dog)
        for name, dog in ((name, dog_like(rng)) for name in DOGS)
        for activity, does in ACTIVITIES.items()
    }
    write_clips(folder / "animal_train.h5", clips)
    motion = perform(ACTIVITIES["left"] | {"turn": 42.0}, FILMED, rng)
    middle = (motion.way.max(axis=0) + motion.way.min(axis=0)) / 2
    truth = places(replace(motion, way=motion.way - middle), dog_like(rng))
    write_clips(folder / "animal_truth.h5", {"animal_walk": truth})
    write_deeplabcut(folder / "animal_walk.csv", seen(truth, rng), rng)


def dog_like(rng: np.random.Generator) -> Dog:
    """Return a dog that is larger or smaller as a whole and in every bone."""
    average = np.array(astuple(Dog()))
    return Dog(*(rng.uniform(0.8, 1.2) * average * (1 + 0.05 * rng.standard_normal(len(average)))))


def write_clips(path: Path, clips: dict[str, Floats]) -> None:
    write_shapes(
        path,
        attributes={"frame_rate": FRAME_RATE},
        texts={
            "landmark_names": LANDMARKS,
            "item": [
                f"{name}/{frame}" for name, clip in clips.items() for frame in range(len(clip))
            ],
            "sequence": [name for name, clip in clips.items() for _ in clip],
        },
        arrays={
            "shapes": np.concatenate([clip.round(DECIMALS) for clip in clips.values()]),
            "edges": EDGES,
            "mirror_index": MIRROR,
        },
    )


def seen(points: Floats, rng: np.random.Generator) -> Floats:
    """Landmarks (n, 20, 3), y up -> (n, 20, 2) in pixels, y down, by a pinhole that sees them."""
    away = points * np.array([1.0, -1.0, -1.0]) + CAMERA
    exact = CENTRE + FOCAL_LENGTH * away[..., :2] / away[..., 2:]
    return exact + NOISE * rng.standard_normal(exact.shape)


def write_deeplabcut(path: Path, points: Floats, rng: np.random.Generator) -> None:
    """Write x, y and likelihood of each landmark; those missed lie anywhere, and are unlikely."""
    missed = rng.random(points.shape[:2]) < MISSED
    anywhere = rng.uniform((0, 0), 2 * CENTRE, points.shape)
    found = np.where(missed[..., None], anywhere, points)
    likelihood = np.where(
        missed, rng.uniform(0, 0.3, missed.shape), rng.uniform(SURE, 1, missed.shape)
    )
    heads = [("scorer", ["shapefit"] * 3 * len(LANDMARKS))]
    heads += [("bodyparts", [name for name in LANDMARKS for _ in range(3)])]
    heads += [("coords", ["x", "y", "likelihood"] * len(LANDMARKS))]
    lines = [",".join([first, *cells]) for first, cells in heads]
    for frame, (rows, sure) in enumerate(zip(found, likelihood, strict=True)):
        cells = (f"{x:.1f},{y:.1f},{p:.2f}" for (x, y), p in zip(rows, sure, strict=True))
        lines.append(",".join([str(frame), *cells]))
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)

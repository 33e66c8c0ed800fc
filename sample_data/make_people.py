"""Make people_train.h5, people_test.h5, people_frames.csv, people_views.csv and one_person.csv.

Run from the project's folder: python -m sample_data.make_people [FOLDER]
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import astuple, dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sample_data.motions import ACTIVITIES, FRAME_RATE, mirrored, perform
from sample_data.skeleton import EDGES, JOINTS, Proportions, joints
from sample_data.storage import write_csv, write_shapes

Floats = NDArray[np.float64]

SEED = 20150607
STATURES = {"anna": 0.93, "ben": 1.04, "carla": 0.98, "david": 1.09, "emil": 1.01, "fatma": 0.95}
TRAINING = ("anna", "ben", "carla", "david")
TEST = ("emil", "fatma")
TRAINING_FRAMES = 120
TEST_FRAMES = 80
DECIMALS = 5
PIXELS_PER_METRE = 240.0
IMAGE_CENTRE = (320.0, 240.0)


@dataclass(frozen=True)
class Clip:
    """One sequence: `name`, who moves, and the joints (n, 15, 3) in metres."""

    name: str
    subject: str
    joints: Floats

    @property
    def items(self) -> list[str]:
        """Return the names of the frames."""
        return [f"{self.name}/{frame:03d}" for frame in range(len(self.joints))]


def main(folder: Path) -> None:
    rng = np.random.default_rng(SEED)
    bodies = {name: proportions(stature, rng) for name, stature in STATURES.items()}
    training = clips(TRAINING, 2, TRAINING_FRAMES, bodies, rng)
    test = clips(TEST, 1, TEST_FRAMES, bodies, rng)
    write_clips(folder / "people_train.h5", training)
    write_clips(folder / "people_test.h5", test)
    write_tables(folder, test, rng)


def proportions(stature: float, rng: np.random.Generator) -> Proportions:
    """Body of the given stature (1 is 1.74 m), each bone longer or shorter by some per cent."""
    average = np.array(astuple(Proportions()))
    return Proportions(*(stature * average * (1 + 0.04 * rng.standard_normal(len(average)))))


def clips(
    subjects: Sequence[str],
    each: int,
    frames: int,
    bodies: dict[str, Proportions],
    rng: np.random.Generator,
) -> list[Clip]:
    """`each` clips of every activity; the subjects take turns, every other clip left-handed."""
    made = []
    for place, (activity, cycle) in enumerate(ACTIVITIES.items()):
        for number in range(each):
            subject = subjects[(place + place // 2 + number) % len(subjects)]
            handed = mirrored(cycle) if (place + number) % 2 else cycle
            points = joints(perform(handed, frames, rng), bodies[subject])
            made.append(Clip(f"{activity}_{subject}", subject, points.round(DECIMALS)))
    return made


def write_clips(path: Path, made: Sequence[Clip]) -> None:
    write_shapes(
        path,
        attributes={"frame_rate": FRAME_RATE},
        texts={
            "landmark_names": JOINTS,
            "item": [item for clip in made for item in clip.items],
            "sequence": [clip.name for clip in made for _ in clip.items],
            "subject": [clip.subject for clip in made for _ in clip.items],
        },
        arrays={"shapes": np.concatenate([clip.joints for clip in made]), "edges": EDGES},
    )


def write_tables(folder: Path, test: Sequence[Clip], rng: np.random.Generator) -> None:
    """A few frames of one clip in 3D, a dozen frames of all clips as pictures, and one picture."""
    kick = next(clip for clip in test if clip.name.startswith("kick"))
    frames = range(0, TEST_FRAMES, TEST_FRAMES // 8)
    items = [kick.items[frame] for frame in frames]
    write_csv(folder / "people_frames.csv", JOINTS, items, kick.joints[frames], DECIMALS)

    chosen = [
        (clip, frame) for frame in (20, 52) for clip in test if frame == 20 or clip in test[::2]
    ]
    items = [clip.items[frame] for clip, frame in chosen]
    pictures = np.stack([picture(clip.joints[frame], rng) for clip, frame in chosen])
    hidden = rng.random(pictures.shape[:2]) < 0.1
    write_csv(
        folder / "people_views.csv",
        JOINTS,
        items,
        np.where(hidden[..., None], np.nan, pictures),
        decimals=1,
    )
    one = items.index(f"{kick.name}/020")
    write_csv(folder / "one_person.csv", JOINTS, [items[one]], pictures[[one]], decimals=1)


def picture(points: Floats, rng: np.random.Generator) -> Floats:
    """Joints (15, 3) -> (15, 2) in pixels, y down, seen from a random side by a distant camera."""
    angle = rng.uniform(0, 2 * np.pi)
    across = np.array([np.cos(angle), 0, np.sin(angle)])
    flat = np.stack([points @ across, -points[:, 1]], axis=-1)
    middle = np.array(IMAGE_CENTRE)
    exact = middle + PIXELS_PER_METRE * (flat - flat.mean(axis=0))
    return exact + rng.standard_normal(exact.shape)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)

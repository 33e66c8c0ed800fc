"""Make people_train.h5, people_test.h5, people_frames.csv, people_views.csv and one_person.csv.

Run from the project's folder: python -m sample_data.make_people [FOLDER]
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass
from pathlib import Path

import numpy as np
from ruamel.yaml import YAML
from scipy.interpolate import PchipInterpolator

from sample_data.skeleton import EDGES, JOINTS, Floats, Proportions, joints
from sample_data.storage import write_csv, write_shapes

Keys = tuple[tuple[float, float], ...]

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


FRAME_RATE = 24


@dataclass(frozen=True)
class Activity:
    """One cycle of `period` seconds: channel (see `skeleton`) -> (phase, value), phase in [0, 1).

    Key frames are joined by a periodic, monotone cubic. Angles in degrees, `lift` in metres.
    """

    period: float
    channels: Mapping[str, Keys]


ACTIVITIES = {
    name: Activity(**activity)
    for name, activity in YAML(typ="safe")
    .load(Path(__file__).with_name("motions.yaml").read_text(encoding="utf-8"))
    .items()
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


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)

"""Make animal_train.h5, animal_walk.csv and animal_truth.h5: a class of one's own, start to end.

A dog of 20 landmarks walks, trots, turns and sniffs. Frame: x to the animal's left, y up, z
forward; metres. Angles are in degrees, one per frame.

Run from the project's folder: python -m sample_data.make_animal [FOLDER]
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import astuple, dataclass, replace
from pathlib import Path

import numpy as np

from sample_data.skeleton import Floats, turned
from sample_data.storage import write_shapes

FRAME_RATE = 25
LEGS = {"left_hind": 0.0, "left_front": 0.25, "right_hind": 0.5, "right_front": 0.75}
"""When each foot is set down in a walk, in cycles; in a trot left front goes with right hind."""

BONES = (
    *("withers-rump", "withers-poll", "poll-nose", "poll-left_ear", "poll-right_ear"),
    *("rump-tail_mid", "tail_mid-tail_tip"),
    *(f"withers-{side}_shoulder" for side in ("left", "right")),
    *(f"rump-{side}_hip" for side in ("left", "right")),
    *(f"{side}_shoulder-{side}_elbow" for side in ("left", "right")),
    *(f"{side}_elbow-{side}_front_paw" for side in ("left", "right")),
    *(f"{side}_hip-{side}_knee" for side in ("left", "right")),
    *(f"{side}_knee-{side}_hind_paw" for side in ("left", "right")),
)
LANDMARKS = tuple(dict.fromkeys(name for bone in BONES for name in bone.split("-")))
EDGES = np.array([[LANDMARKS.index(name) for name in bone.split("-")] for bone in BONES])
SWAP = {"left": "right", "right": "left"}
MIRROR = np.array(
    [LANDMARKS.index("_".join(SWAP.get(w, w) for w in name.split("_"))) for name in LANDMARKS]
)


@dataclass(frozen=True)
class Dog:
    """Lengths in metres."""

    trunk: float = 0.48
    neck: float = 0.24
    muzzle: float = 0.17
    ear: float = 0.09
    tail: float = 0.17
    shoulder_half: float = 0.07
    hip_half: float = 0.06
    upper_leg: float = 0.22
    lower_leg: float = 0.24


@dataclass(frozen=True)
class Motion:
    """What a dog does, at each of n frames: angles in degrees.

    cycle of the gait; stride; trot, from 0 to 1; head, lowered; look, to the left; wag of the
    tail; bend of the trunk, to the left; heading, to the left of z, and the way from the start.
    """

    cycle: Floats
    stride: Floats
    trot: float
    head: Floats
    look: Floats
    wag: Floats
    bend: Floats
    heading: Floats
    way: Floats


def places(motion: Motion, dog: Dog) -> Floats:
    """Return the landmarks (n, 20, 3); the lowest paw stands at a height of 2 cm."""
    n, zero = len(motion.cycle), np.zeros(len(motion.cycle))
    hind = turned(zero, motion.heading - motion.bend / 2, zero)
    front = turned(zero, motion.heading + motion.bend / 2, zero)
    spine = turned(zero, motion.heading, zero)
    place: dict[str, Floats] = {"rump": np.zeros((n, 3))}
    place["withers"] = spine @ np.array([0, 0.02, dog.trunk])
    neck = front @ turned(motion.head - 40, 0.5 * motion.look, zero)
    head = front @ turned(0.5 * motion.head + 12, motion.look, zero)
    place["poll"] = place["withers"] + neck @ np.array([0, 0, dog.neck])
    place["nose"] = place["poll"] + head @ np.array([0, 0, dog.muzzle])
    for side, sign in (("left", 1.0), ("right", -1.0)):
        place[f"{side}_ear"] = place["poll"] + head @ (dog.ear * np.array([sign * 0.7, 0.6, -0.4]))
    tail = hind @ turned(zero + 25, motion.wag, zero)
    tip = hind @ turned(zero - 5, 2.2 * motion.wag, zero)
    place["tail_mid"] = place["rump"] + tail @ np.array([0, 0, -dog.tail])
    place["tail_tip"] = place["tail_mid"] + tip @ np.array([0, 0, -dog.tail])
    for leg, start in LEGS.items():
        side, end = leg.split("_")
        _put_leg(place, side, end, motion, start, front if end == "front" else hind, dog)
    points = np.stack([place[name] for name in LANDMARKS], axis=1)
    paws = np.stack([place[f"{leg}_paw"][:, 1] for leg in LEGS])
    points[..., 1] += 0.02 + (np.log(np.exp(-80 * paws).sum(axis=0)) / 80)[:, None]
    points[..., [0, 2]] += motion.way[:, None]
    return points


def _put_leg(
    place: dict[str, Floats],
    side: str,
    end: str,
    motion: Motion,
    start: float,
    body: Floats,
    dog: Dog,
) -> None:
    """Swing a leg from its girdle; its joint bends while the paw is in the air."""
    sign = 1.0 if side == "left" else -1.0
    diagonal = 0.0 if (side == "left") == (end == "front") else 0.5
    phase = 2 * np.pi * (motion.cycle - start + motion.trot * (start - diagonal))
    swing = motion.stride * np.cos(phase)
    lifted = motion.stride * np.maximum(-np.sin(phase), 0) ** 2
    names, half, girdle, upper, lower = {
        "front": (("shoulder", "elbow"), dog.shoulder_half, "withers", -18 + swing, 15 + swing),
        "hind": (("hip", "knee"), dog.hip_half, "rump", 20 + swing, -18 + swing),
    }[end]
    lower = lower + (1.2 if end == "front" else -1.0) * lifted
    upper = upper + (0.4 if end == "front" else 0.9) * lifted
    joint, middle = (f"{side}_{name}" for name in names)
    zero = np.zeros(len(swing))
    place[joint] = place[girdle] + body @ np.array([sign * half, -0.06, 0.0])
    for name, above, angle, length in (
        (middle, joint, upper, dog.upper_leg),
        (f"{side}_{end}_paw", middle, lower, dog.lower_leg),
    ):
        place[name] = place[above] + body @ turned(-angle, zero, zero) @ np.array([0, -length, 0])


def perform(activity: Mapping[str, float], frames: int, rng: np.random.Generator) -> Motion:
    """Perform an activity: speed, stride, trot, turn (degrees per second) and head, its height.

    Tempo, looks, wags and the pace of turning differ from performance to performance.
    """
    time = np.arange(frames) / FRAME_RATE
    tempo = rng.uniform(0.85, 1.15)

    def slowly(reach: float) -> Floats:
        rate, start = rng.uniform(0.15, 0.5, 3), rng.uniform(0, 2 * np.pi, 3)
        return reach * np.sin(2 * np.pi * rate * time[:, None] + start).mean(axis=1)

    turn = activity.get("turn", 0.0) + slowly(12)
    heading = rng.uniform(0, 360) + np.cumsum(turn) / FRAME_RATE
    angle = np.radians(heading)
    step = tempo * activity["speed"] / FRAME_RATE * np.stack([np.sin(angle), np.cos(angle)], axis=1)
    stride = activity["stride"] * rng.uniform(0.85, 1.1) * np.ones(frames)
    return Motion(
        cycle=rng.uniform() + tempo * activity["rate"] * time,
        stride=stride,
        trot=activity.get("trot", 0.0),
        head=activity.get("head", 0.0) + slowly(14),
        look=0.5 * turn + slowly(25),
        wag=22 * np.sin(2 * np.pi * rng.uniform(0.8, 1.6) * time) * (1 + slowly(0.5)),
        bend=0.35 * turn,
        heading=heading,
        way=np.cumsum(step, axis=0),
    )


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

"""People as a video shows them: a camera at rest, a detector's joints, noise that
lasts.

`python -m benchmarks.footage --data FOLDER` shows clips of motion capture to a camera,
lifts what a detector would have found by each method, judges it, and writes
results/footage/index.md and cells.csv. A cell is a way to be filmed that differs from
the first in one thing or two. Bodies 13 and 14, which are scored, are lifted by the
dictionary of subject 86; each of seven others, on which settings are chosen, by one of
subject 86 and the other six.

A clip lasts 1.7 to 5 s. The camera stands 2 to 5 m for each metre of the body away,
tilted and rolled by 12 degrees (standard deviation), and sees 1920 x 1080 pixels
through 0.8 to 1.5 times its width; fits take 1.1. Landmarks are those of BODY_25B on
legs, arms and head: hips wider and heads higher than the joints by factors of each
body. What is found is off by a constant of each landmark and clip, and by noise whose
correlation in time is that of OpenPose's residuals on the man on a beam
(`pose2sim_balancing`, cameras 1 and 3: constants of 1.8 cm a coordinate, hips included,
and the rest 1.6 and 2.2 cm with correlations of 0.78 and 0.85 from frame to frame at 60
Hz, 0.65 and 0.74 over two, 0.15 and 0.46 over five). A tenth is not found, some frames
at a time.
"""

from __future__ import annotations

import argparse
import csv
import warnings
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

import shapefit
from benchmarks.coverage import CONFIGS, DATA, read_bodies, run, write_page
from shapefit.config import EvalConfig
from shapefit.evaluation.calibration import WIDTH_SQUARED_RADIUS
from shapefit.evaluation.report import markdown_table
from shapefit.geometry.procrustes import rotation_onto
from shapefit.geometry.rotations import rotation_about_axis
from shapefit.io import write_shapes
from shapefit.io.atomic import atomic_path
from shapefit.io.options import BY_DEFAULT
from shapefit.io.skeletons import (
    PEOPLE,
    THETA,
    body_parts,
    installed_skeletons,
    part_names,
    people_joints,
)
from shapefit.io.writers.motion import find_floors
from shapefit.pipelines.evaluate.measure import measure as measure_file
from shapefit.records import Landmarks, Shapes

Floats = NDArray[np.float64]
Rows = NDArray[np.intp]

FOLDER = Path("results/footage")
METHODS = ("convex", "posterior", "sequences")
FILES = ("subject13", "subject14", "other_subjects")
SCORED = ("13", "14")
CHOSEN_ON = ("01", "02", "03", "10", "64", "118", "124")
ON_A_FLOOR = ("01", "02", "10", "64", "118", "124")
"""Bodies on an even floor at y = 0; 13 and 14 are without their way, and 03 walks
uneven ground.
"""

SECONDS = (1.7, 10.0)
TILT = np.radians(12.0)
SIZE = (1920, 1080)
CONSTANT, LASTING = 0.013, 0.02
"""Standard deviations in metres of a coordinate: the same over a clip, and with the
memory.
"""

UNSEEN, GAP = 0.1, 5 / 24
"""Share of the landmarks that are not found, and the mean length of a gap in seconds.
"""

DROPPED = (0.1, 0.2, 0.4)
"""Shares of the frames that are lost where those are measured alone."""

BODY_SPREAD = {"head": 0.1, "hips": 0.1}
"""Spread of the logarithms of the factors of a body, about the means of `THETA`."""

BODY_25B, COCO, HUMAN36M = (
    tuple(
        mark
        for mark, joint in people_joints(
            installed_skeletons()[name].landmark_names
        ).items()
        if joint in PEOPLE
    )
    for name in ("body_25b", "coco_17", "h36m_17")
)
FACE = ("nose", "left_eye", "right_eye", "left_ear", "right_ear")
SIDES = {"L": "R", "R": "L"}
TO_THE_HIPS = tuple(
    name for name in BODY_25B if name[1:] in ("Shoulder", "Elbow", "Wrist", "Hip")
)
ABOVE_THE_HIPS = tuple(
    name for name in BODY_25B if name[1:] not in ("Hip", "Knee", "Ankle")
)


@dataclass(frozen=True)
class Cell:
    """The conditions under which a body is filmed.

    landmarks that are seen, and whether their joints alone are judged; metres to the
    body, or heights of it where these are 0; focal length in widths; frames a second,
    those of the data if 0; speed of the motion; turn of the body in radians and steps
    away in metres, a second; memory, seconds in which the correlation of the noise
    falls to 1/e; landmarks in multiples of `pixel`; half of the landmarks hidden for a
    second; left and right swapped in a tenth of the frames.
    """

    name: str
    landmarks: tuple[str, ...] = BODY_25B
    seen_alone: bool = False
    metres: float = 0.0
    heights: tuple[float, float] = (2.0, 5.0)
    focal: tuple[float, float] = (0.8, 1.5)
    rate: float = 0.0
    speed: float = 1.0
    turn: float = 0.0
    leave: float = 0.0
    memory: float = 0.11
    pixel: float = 0.0
    hidden: bool = False
    swapped: bool = False


JUDGED = EvalConfig.model_construct(metrics=("similarity",), truth_frame="camera")
BASE = Cell("whole body")
HIPS = Cell("to the hips", TO_THE_HIPS, seen_alone=True)
ABOVE = Cell("above the hips", ABOVE_THE_HIPS, seen_alone=True)
NEAR = replace(HIPS, name="to the hips, 1 m", metres=1.0)
SHORT, LONG = (1.1 / 0.7,) * 2, (1.1 / 1.3,) * 2
CELLS = (
    BASE,
    replace(BASE, name="4 m away", metres=4.0),
    replace(BASE, name="1 m away", metres=1.0),
    HIPS,
    ABOVE,
    replace(HIPS, name="to the hips, 4 m", metres=4.0),
    NEAR,
    replace(NEAR, name="to the hips, 1 m, noise of 2 s", memory=2.0),
    replace(NEAR, name="to the hips, 1 m, focal length 30% short", focal=SHORT),
    replace(BASE, name="focal length right", focal=(1.1, 1.1)),
    replace(BASE, name="focal length 30% short", focal=SHORT),
    replace(BASE, name="focal length 30% long", focal=LONG),
    replace(BASE, name="10 frames a second", rate=10.0),
    replace(BASE, name="60 frames a second", rate=60.0),
    replace(BASE, name="120 frames a second", rate=120.0),
    replace(BASE, name="whole pixels of 480", pixel=4.0),
    replace(BASE, name="noise of .5 s", memory=0.5),
    replace(BASE, name="noise of 2 s", memory=2.0),
    replace(BASE, name="half hidden for a second", hidden=True),
    replace(BASE, name="left and right swapped", swapped=True),
    replace(BASE, name="stands", speed=0.05),
    replace(BASE, name="turns", turn=np.pi / 2),
    replace(BASE, name="walks off", leave=1.0),
    replace(BASE, name="joints of CMU", landmarks=PEOPLE),
    replace(BASE, name="COCO and MediaPipe", landmarks=(*COCO, *FACE)),
    replace(BASE, name="Human3.6M", landmarks=HUMAN36M),
)


def choose_clips(
    shapes: Shapes, count: int, longest: float, rng: np.random.Generator
) -> list[Rows]:
    """Return the rows of `count` clips of shapes, each of a random sequence and from a
    random frame on, of at most `longest` seconds.
    """
    names, rate = np.array(shapes.sequences), shapes.frame_rate or 24.0
    lengths = Counter(names.tolist())
    fine = [name for name, length in lengths.items() if length >= SECONDS[0] * rate]
    chosen = rng.choice(fine, size=min(count, len(fine)), replace=False)
    clips = []
    for name in sorted(chosen):
        rows = np.flatnonzero(names == name)
        frames = min(int(rate * rng.uniform(SECONDS[0], longest)), len(rows))
        first = rng.integers(0, len(rows) - frames + 1)
        clips.append(rows[first : first + frames])
    return clips


def change_motion(
    points: Floats, frame_rate: float, cell: Cell
) -> tuple[Floats, float]:
    """Return a clip (t, 3, p), of this frame rate, with the frame rate, speed and turn
    of a cell, and its new frame rate.
    """
    rate = cell.rate or frame_rate
    if rate != frame_rate or cell.speed != 1:
        last = (len(points) - 1) / frame_rate
        times = cell.speed * np.arange(int(last * rate) + 1) / rate
        points = CubicSpline(np.arange(len(points)) / frame_rate, points)(times)
    if cell.turn:
        middle = points.mean(axis=(0, 2))[:, None]
        turns = rotation_about_axis(
            1, np.float64(cell.turn / rate) * np.arange(len(points))
        )
        points = turns @ (points - middle) + middle
    return points, rate


def place_before_camera(
    points: Floats,
    rng: np.random.Generator,
    cell: Cell = BASE,
    aim: Sequence[int] | None = None,
) -> tuple[Floats, float]:
    """Return a clip (t, 3, p), y up, in the frame of a random camera that is aimed at
    some joints, all by default; and its focal length in pixels.
    """
    tall = float(np.ptp(points[:, 1], axis=1).max())
    yaw = rng.uniform(0, 2 * np.pi)
    tilt, roll = (TILT * rng.standard_normal(2)).tolist()
    middle = (points if aim is None else points[..., aim]).mean(axis=(0, 2))
    about = [
        rotation_about_axis(k, np.array(a, np.float64))
        for k, a in enumerate((tilt, yaw, roll))
    ]
    turned = about[2] @ about[0] @ np.diag([1.0, -1.0, -1.0]) @ about[1]
    visible = turned @ (points - middle[:, None])
    away = tall * rng.uniform(*cell.heights)
    visible[:, 2] += cell.metres or away
    visible[:, 2] += max(0.0, 0.5 - float(visible[:, 2].min()))
    return visible, SIZE[0] * rng.uniform(*cell.focal)


def lasting_noise(
    frames: int,
    landmarks: int,
    rate: float,
    rng: np.random.Generator,
    memory: float = BASE.memory,
) -> Floats:
    """Return noise (t, 2, m) in metres: a constant of each landmark, and a part whose
    correlation in time falls to 1/e in `memory` seconds.
    """
    keep = np.exp(-1 / (rate * memory))
    noise = rng.standard_normal((frames, 2, landmarks))
    for t in range(1, frames):
        noise[t] = keep * noise[t - 1] + np.sqrt(1 - keep**2) * noise[t]
    constant: Floats = CONSTANT * rng.standard_normal((2, landmarks))
    return constant + LASTING * noise


def random_gaps(
    frames: int, landmarks: int, rng: np.random.Generator, rate: float = 24.0
) -> NDArray[np.bool_]:
    """Return flags (t, m) of the landmarks that are hidden, in gaps that begin and end
    at random.
    """
    length = max(GAP * rate, 1.0)
    begins, ends = UNSEEN / (1 - UNSEEN) / length, 1 / length
    hidden = np.empty((frames, landmarks), dtype=bool)
    hidden[0] = rng.random(landmarks) < UNSEEN
    for t in range(1, frames):
        hidden[t] = rng.random(landmarks) < np.where(hidden[t - 1], 1 - ends, begins)
    return hidden


def joint_weights(
    names: Sequence[str], joints: Sequence[str], theta: Mapping[str, float]
) -> tuple[Floats, list[int]]:
    """Return the weights (m, p) of the joints whose weighted sums are the landmarks,
    and the indices of the joints that landmarks stand for.
    """
    parts = [body_parts()[part] for part in part_names(names).values()]
    if set(names) <= set(joints):  # the joints themselves
        theta = dict.fromkeys(theta, 1.0)
    rows = np.zeros((len(names), len(joints)))
    for row, part in zip(rows, parts, strict=True):
        for joint, weight in part.weights(theta).items():
            row[joints.index(joint)] = weight
    return rows, [joints.index(part.joint) for part in parts if part.joint]


def film(
    shapes: Shapes, clips: Sequence[Rows], rng: np.random.Generator, cell: Cell = BASE
) -> tuple[Landmarks, Shapes]:
    """Return the landmarks that a detector finds in clips of a body, in pixels, and the
    true shapes in the frame of the camera.
    """
    theta = {
        name: THETA[name].mean * np.exp(spread * rng.standard_normal())
        for name, spread in BODY_SPREAD.items()
    }
    joints, names = shapes.landmark_names, cell.landmarks
    rows, shown = joint_weights(names, joints, theta)
    aim = shown if cell.seen_alone else None
    other = [
        names.index(SIDES.get(name[0], name[0]) + name[1:])
        for name in names
        if cell.swapped
    ]
    besides = np.random.default_rng(len(clips))
    found, truth, sequences, rate = [], [], [], 0.0
    for number, clip in enumerate(clips):
        points, rate = change_motion(
            shapes.as_columns()[clip], shapes.frame_rate or 24.0, cell
        )
        t, m = len(points), len(names)
        visible, focal = place_before_camera(points, rng, cell, aim)
        visible[:, 2] += cell.leave * np.arange(t)[:, None] / rate
        marks = visible @ rows.T
        marks[:, :2] += lasting_noise(t, m, rate, rng, cell.memory)
        pixels = focal * marks[:, :2] / marks[:, 2:] + np.array(SIZE)[:, None] / 2
        if cell.pixel:
            pixels = cell.pixel * np.round(pixels / cell.pixel)
        hidden = random_gaps(t, m, rng, rate)
        if cell.hidden:
            start = int(besides.integers(0, max(t - int(rate), 1)))
            hidden[start : start + int(rate), besides.permutation(m)[: m // 2]] = True
        if cell.swapped:
            swapped = random_gaps(t, 1, besides, rate)[:, 0]
            pixels[swapped] = pixels[swapped][..., other]
        found.append(np.where(hidden[:, None], np.nan, pixels))
        truth.append(visible if aim is None else visible[..., aim])
        sequences += [f"clip{number}"] * t
    items = tuple(map(str, range(len(sequences))))
    images = Landmarks(
        np.concatenate(found).swapaxes(1, 2),
        landmark_names=names,
        items=items,
        sequences=tuple(sequences),
        unit="px",
        y_axis="down",
        frame_rate=rate,
        file_extras={"image_size": np.array(SIZE)},
    )
    known = Shapes(
        np.concatenate(truth).swapaxes(1, 2),
        landmark_names=joints if aim is None else tuple(joints[j] for j in aim),
        items=items,
        sequences=tuple(sequences),
        unit=shapes.unit,
        frame_rate=rate,
    )
    return images, known


def measure(
    cell: Cell,
    shapes: Shapes,
    dictionary: shapefit.Dictionary,
    count: int,
    longest: float,
) -> dict[str, Any]:
    """Simulate detections in `count` clips of a body, of at most `longest` seconds,
    lift them and compare with the truth; return column -> value of its row for a cell.

    These are the errors of the methods, means over the clips, and that of sequences
    over posterior; the shares of the truth inside the 90% ellipsoids of both; of
    sequences, the share of frames that are trusted, and the errors of trusted and other
    frames, where these are ten or more.
    """
    body = (shapes.sequences or ("",))[0].split("_")[0]
    rng = np.random.default_rng([int(body), count])
    images, truth = film(shapes, choose_clips(shapes, count, longest, rng), rng, cell)
    names = np.array(truth.sequences)
    row: dict[str, Any] = {"cell": cell.name, "body": body, "ratio": np.nan}
    by_clip: dict[str, list[float]] = {}
    for method in METHODS:
        config = CONFIGS / f"detected/fit-{method}.yaml"
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            fit = shapefit.fit(images, dictionary, config=config)
        judged = measure_file(Path(method), fit, truth, JUDGED)
        error = judged.errors["similarity", "normalised"]
        row[method] = np.mean(
            [np.nanmean(error[names == name]) for name in np.unique(names)]
        )
        if judged.bars is not None:
            square = judged.bars.square
            row[f"{method} holds"] = float(
                (square[~np.isnan(square)] <= WIDTH_SQUARED_RADIUS).mean()
            )
            size = np.sqrt(fit.shapes.var(axis=1)).mean(axis=1)
            assert fit.expected_error is not None, "it comes with error bars"
            expected = fit.expected_error / size
            row[f"{method} expected"] = np.nanmean(expected) / np.nanmean(error)
        by_clip[method] = [
            np.nanmean(error[names == name]) for name in np.unique(names)
        ]
    ratios = np.array(by_clip["sequences"]) / np.array(by_clip["posterior"])
    row |= {
        "clips": len(ratios),
        "lose": (ratios > 1.03).sum(),
        "lose 10%": (ratios > 1.1).sum(),
    }
    row["worst"] = ratios.max()
    row["ratio"] = row["sequences"] / row["posterior"]
    trusted = np.asarray(fit.trusted, bool)
    row["trusted"] = trusted.mean()
    for what, which in (("error trusted", trusted), ("distrusted", ~trusted)):
        row[what] = error[which].mean() if which.sum() >= 10 else np.nan
    for what, which in (("bad", error > 0.4), ("good", error < 0.25)):
        row[what], row[f"{what} doubted"] = which.sum(), (which & ~trusted).sum()
    return row


def measure_dropped(
    share: float,
    shapes: Shapes,
    dictionary: shapefit.Dictionary,
    count: int,
    longest: float,
) -> dict[str, Any]:
    """Simulate detections in `count` clips of a body, of at most `longest` seconds,
    drop a share of their frames at random, and lift the others; return column -> value.

    These are the errors of `sequences`, means over the clips, with the numbers of the
    frames and with the same images taken for consecutive ones, and how many frames it
    refines of all.
    """
    body = (shapes.sequences or ("",))[0].split("_")[0]
    rng = np.random.default_rng([int(body), count])
    images, truth = film(shapes, choose_clips(shapes, count, longest, rng), rng)
    names = np.array(images.sequences)
    frames = np.concatenate(
        [np.arange((names == name).sum()) for name in unique_in_order(names)]
    )
    order = np.random.default_rng(round(100 * share)).permutation(len(names))
    left = np.sort(order[: round(len(names) * (1 - share))])
    row: dict[str, Any] = {"body": body, "share": share, "images": len(left)}
    truth, names, joined = truth.take(left), names[left], images.take(left)
    for what, one in (
        ("numbered", joined.replaced(frames=frames[left])),
        ("joined", joined),
    ):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            config = CONFIGS / "detected/fit-sequences.yaml"
            fit = shapefit.fit(one, dictionary, config=config)
        judged = measure_file(Path(what), fit, truth, JUDGED)
        error = judged.errors["similarity", "normalised"]
        row[what] = np.mean(
            [np.nanmean(error[names == name]) for name in np.unique(names)]
        )
        noise = fit.sequence_noise
        assert noise is not None, "the method is `sequences`"
        row[f"{what} refined"] = int(np.isfinite(noise).sum())
    return row


def dropped_as_text(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return a line that sums up rows of `measure_dropped`: the errors with numbered
    frames over those with joined ones, and how many frames are refined.
    """
    total = {key: sum(row[key] for row in rows) for key in rows[0] if key != "body"}
    ratio = total["numbered"] / total["joined"]
    refined, joined = total["numbered refined"], total["joined refined"]
    return f"errors x {ratio:.3f}; {refined} of {total['images']} refined, not {joined}"


def unique_in_order(names: NDArray[np.str_]) -> list[str]:
    """Return the different names in the order in which they first occur."""
    return [*dict.fromkeys(names.tolist())]


def measure_floor(
    cell: Cell,
    shapes: Shapes,
    dictionary: shapefit.Dictionary,
    count: int,
    longest: float,
) -> tuple[Floats, Floats]:
    """Simulate clips of a body that moves on the floor y = 0, find the floor of each,
    and return its errors (count, 3) and their standard deviations (count, 3).

    The columns are the height of the camera in metres, its pitch and its roll in
    degrees; nan where no floor is found.
    """
    body = (shapes.sequences or ("",))[0].split("_")[0]
    rng = np.random.default_rng([int(body), count])
    clips = choose_clips(shapes, count, longest, rng)
    images, truth = film(shapes, clips, rng, cell)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        fit = shapefit.fit(images, dictionary, config="sequences")
    found = find_floors(fit, BY_DEFAULT, body)
    errors, deviations = np.full((2, len(clips), 3), np.nan)
    names = np.array(truth.sequences)
    for number, clip in enumerate(clips):
        floor = found.get(f"clip{number}")
        if floor is None:
            continue
        world, visible = (
            np.hstack([*one])
            for one in (
                shapes.as_columns()[clip],
                truth.as_columns()[names == f"clip{number}"],
            )
        )
        middles = world.mean(axis=1), visible.mean(axis=1)
        R = rotation_onto(world - middles[0][:, None], visible - middles[1][:, None])
        height = (middles[0] - R.T @ middles[1])[1]
        up = R[:, 1] * [1, -1, -1]
        pitch, roll = np.degrees(np.arctan([up[2] / up[1], up[0] / up[1]]))
        errors[number] = floor.height - height, floor.pitch - pitch, floor.roll - roll
        deviations[number] = floor.height_sd, floor.pitch_sd, floor.roll_sd
    return errors, deviations


def floor_as_text(errors: Floats, deviations: Floats) -> str:
    """Return a line of the means and medians of absolute errors (n, 3) of the floor,
    and of the shares inside the 90% intervals of their deviations (n, 3).
    """
    known = np.asarray(np.isfinite(errors).all(axis=1))
    away, z = np.abs(errors[known]), np.abs(errors / deviations)[known]
    each = zip(("height", "pitch", "roll"), away.T, z.T, strict=True)
    said = (
        f"{name} {np.mean(a):.2f} (median {np.median(a):.2f}, 90% holds"
        f" {(b < 1.645).mean():.2f})"
        for name, a, b in each
    )
    return f"{known.sum()} of {len(known)} clips: {', '.join(said)}"


def learn(body: str, data: Path) -> shapefit.Dictionary:
    """Return a dictionary of people learned, once, from other bodies than this one."""
    path = FOLDER / ("dictionary.h5" if body in SCORED else f"without-{body}.h5")
    if not path.exists():
        config, given = "learn-dict", ["--set", f"data={data}"]
        if body not in SCORED:
            others = read_bodies(data, ("subject86", "other_subjects"))
            files = [FOLDER / f"body-{name}.h5" for name in others if name != body]
            for file in files:
                write_shapes(file, others[file.stem.removeprefix("body-")])
            config, given = "learn-box", [*map(str, files), "--set", "iterations=2"]
        run("learn-dict", "-c", CONFIGS / f"people/{config}.yaml", "-o", path, *given)
    return shapefit.read_dictionary(path)


def table(rows: Sequence[Mapping[str, Any]], bodies: Sequence[str]) -> str:
    """Return a table in Markdown: the mean of each column over the rows of some bodies,
    for each cell.
    """
    columns = [name for name in rows[0] if name not in ("cell", "body")]
    lines = []
    for cell in dict.fromkeys(row["cell"] for row in rows):
        own = [row for row in rows if row["cell"] == cell and row["body"] in bodies]
        values = np.array([[row[name] for name in columns] for row in own])
        lines += (
            [[cell, *(f"{mean:.3f}" for mean in np.nanmean(values, axis=0))]]
            if own
            else []
        )
    return markdown_table(("cell", *columns), lines)


def main() -> None:
    """Simulate detections of bodies in cells, lift and judge them, and write tables; or
    measure floors, or the loss of frames, and print that.
    """
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=DATA / "mocap")
    parser.add_argument("--bodies", nargs="+", help="of these bodies alone")
    parser.add_argument("--cells", nargs="*", help="names of cells; all by default")
    parser.add_argument(
        "--clips", type=int, default=6, help="of bodies 13 and 14; half of others"
    )
    parser.add_argument("--longest", type=float, default=5.0, help="seconds of a clip")
    parser.add_argument(
        "--floor", action="store_true", help="height and tilt of the camera alone"
    )
    parser.add_argument(
        "--dropped", action="store_true", help="frames that are missing at random alone"
    )
    given = parser.parse_args()
    FOLDER.mkdir(parents=True, exist_ok=True)
    if given.dropped:
        for share in DROPPED:
            lost = []
            for body, shapes in read_bodies(
                given.data, FILES, given.bodies or CHOSEN_ON
            ).items():
                known = learn(body, given.data)
                count = -(-given.clips // 2)
                lost.append(measure_dropped(share, shapes, known, count, given.longest))
                print(body, share, dropped_as_text(lost[-1:]), flush=True)
            print("all", share, dropped_as_text(lost), flush=True)
        return
    if given.floor:
        for cell in (BASE, replace(BASE, name="focal length right", focal=(1.1, 1.1))):
            parts = []
            for body, shapes in read_bodies(
                given.data, FILES[2:], given.bodies or ON_A_FLOOR
            ).items():
                known = learn(body, given.data)
                parts.append(
                    measure_floor(cell, shapes, known, given.clips, given.longest)
                )
                print(body, cell.name, floor_as_text(*parts[-1]), flush=True)
            print(
                "all",
                cell.name,
                floor_as_text(*map(np.concatenate, zip(*parts, strict=True))),
            )
        return
    rows = []
    bodies = given.bodies or [*SCORED, *CHOSEN_ON]
    for body, shapes in read_bodies(given.data, FILES, bodies).items():
        dictionary = learn(body, given.data)
        clips = given.clips if body in SCORED else -(-given.clips // 2)
        for cell in CELLS:
            if not given.cells or cell.name in given.cells:
                rows.append(measure(cell, shapes, dictionary, clips, given.longest))
                print(body, cell.name, f"{rows[-1]['ratio']:.3f}", flush=True)
        write(rows)


def write(rows: Sequence[Mapping[str, Any]]) -> None:
    """Write the rows of all bodies and cells as CSV, and the means over bodies as a
    page.
    """
    with atomic_path(FOLDER / "cells.csv") as path, path.open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    parts = (("Bodies 13 and 14", SCORED), ("Seven others", CHOSEN_ON))
    tables = (f"## {name}\n\n{table(rows, bodies)}\n" for name, bodies in parts)
    write_page(FOLDER, "# Footage\n\n" + "\n".join(tables))


if __name__ == "__main__":
    main()

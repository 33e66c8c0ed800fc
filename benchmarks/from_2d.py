"""Classes learned from 2D landmarks alone, against published figures and goals, in one
table.

`python -m benchmarks.from_2d --data FOLDER [CASE ...]` learns, fits with the defaults
of both commands, judges by the truth, and writes results/from_2d/index.md, where other
cases keep their rows. e3D is the mean of ||X - X^|| / ||X|| over the frames, centroids
removed; `similarity` the normalised error of `eval`. One sign of depth is chosen per
class. Seconds are those of the processor, one thread.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.coverage import read_images, write_images
from shapefit.evaluation.metrics import similarity_error
from shapefit.evaluation.report import markdown_table
from shapefit.geometry.normalisation import std
from shapefit.geometry.rotations import rotation_about_axis
from shapefit.io import (
    read_results,
    read_shapes,
)
from shapefit.io.arrange import arrange
from shapefit.records import Landmarks, concatenate

Floats = NDArray[np.float64]
FOLDER = Path("results/from_2d")
ROW = "row.json"
FRAMES = 150
MISSING, NOISE = 0.1, 0.02
SIDES = ("hip", "knee", "ankle", "shoulder", "elbow", "wrist")
OTHER_BODIES = (
    *(
        "--set",
        "prior.bone_scale=0.15",
        "--set",
        "prior.exchange=0.5",
        "--set",
        "mirror=true",
    ),
    *("--set", f"mirror={json.dumps({f'r{side}': f'l{side}' for side in SIDES})}"),
)
LEFT_OUT = ("KneeL", "ArmR", "ElbowR")


@dataclass(frozen=True)
class Case:
    """Images to learn from, images to lift with their truth (n, 3, p) before the
    camera.

    judged: from shapes and truth to an error of each image; published, goal as in the
    table. source, of cases that learn from the same images; options of learn-dict.
    """

    name: str
    published: str
    goal: float
    judged: Callable[[Floats, Floats], Floats]
    learned: Callable[[Path], Landmarks]
    lifted: Callable[[Path], tuple[Landmarks, Floats]]
    method: str = "sequences"
    source: str = ""
    options: tuple[str, ...] = ()


def e3d(found: Floats, truth: Floats) -> Floats:
    """||found - truth||_F / ||truth||_F (n,) of shapes (n, 3, p), centroids removed."""
    apart = (
        found
        - found.mean(axis=2, keepdims=True)
        - truth
        + truth.mean(axis=2, keepdims=True)
    )
    size = np.linalg.norm(truth - truth.mean(axis=2, keepdims=True), axis=(1, 2))
    error: Floats = np.linalg.norm(apart, axis=(1, 2)) / size
    return error


def normalised_error(found: Floats, truth: Floats) -> Floats:
    """Return the similarity error (n,) of shapes (n, 3, p) over the size of the
    truth.
    """
    return similarity_error(found, truth) / std(truth)


def error_in_millimetres(found: Floats, truth: Floats) -> Floats:
    """Return the similarity error (n,) in mm of shapes (n, 3, p), for a truth in metres
    with gaps.
    """
    return 1000 * similarity_error(found, truth)


def read_files(paths: list[Path]) -> Landmarks:
    """Read the images of several files as one record; the names of items and sequences
    begin with that of their file.
    """
    parts = []
    for path in paths:
        part = read_images(path)
        names = tuple(f"{path.stem}/{name}" for name in part.items)
        sequences = tuple(
            f"{path.stem}/{name}" for name in part.sequences or ("",) * len(part)
        )
        renamed = replace(part, items=names, sequences=sequences)
        bare = replace(renamed, frames=None, times=None, edges=None)
        parts.append(replace(bare, extras={}, file_extras={}))
    return concatenate(parts)


def sequence_reader(
    name: str, damaged: bool
) -> Callable[[Path], tuple[Landmarks, Floats]]:
    """Return a function that reads images and truth (n, 3, p) of a published sequence
    from the folder of data, with hidden landmarks and noise where damaged.
    """

    def read(data: Path) -> tuple[Landmarks, Floats]:
        images = read_files([data / f"nrsfm/{name}.h5"])
        if damaged:
            rng = np.random.default_rng(1)
            w = images.as_columns()
            size = (w - w.mean(axis=2, keepdims=True)).std()
            w = w + NOISE * size * rng.standard_normal(w.shape)
            hidden = rng.random((len(w), 1, w.shape[2])) < MISSING
            images = images.with_points(np.where(hidden, np.nan, w).swapaxes(1, 2))
        return images, read_shapes([data / f"nrsfm/{name}_truth.h5"]).as_columns()

    return read


def turntable_reader(
    subject: int, every: int = 1, frames: int | None = FRAMES, *, edges: bool = False
) -> Callable[[Path], tuple[Landmarks, Floats]]:
    """Return a function that reads images and truth (n, 3, p) of a subject from the
    folder of data: every `every`-th of the first frames of each sequence, seen by a
    camera that goes round once.

    The landmarks have edges, the bones, where asked for.
    """

    def read(data: Path) -> tuple[Landmarks, Floats]:
        shapes = read_shapes([data / f"mocap/subject{subject}_24fps.h5"])
        names = np.array(shapes.sequences)
        rank = np.concatenate(
            [np.arange((names == name).sum()) for name in dict.fromkeys(names)]
        )
        shapes = shapes.take(rank < (frames or len(names)))
        names = np.array(shapes.sequences)
        lengths = [(names == name).sum() for name in dict.fromkeys(names)]
        turns = [
            np.linspace(0, 2 * np.pi, length, endpoint=False) for length in lengths
        ]
        X = rotation_about_axis(1, np.concatenate(turns)) @ shapes.as_columns()
        images = Landmarks(
            X[:, :2].swapaxes(1, 2),
            landmark_names=shapes.landmark_names,
            items=shapes.items,
            sequences=shapes.sequences,
            frame_rate=shapes.frame_rate,
            y_axis="up",
            edges=shapes.edges if edges else None,
        )
        return images.take(slice(None, None, every)), X[::every]

    return read


def read_rat(data: Path) -> tuple[Landmarks, Floats]:
    """Read the detections of a rat by three cameras, and the truth (n, 3, p) with its
    gaps, from the folder of data.
    """
    folder = data / "detected/rat7m"
    cameras = [folder / f"camera{n}" for n in (1, 3, 5)]
    images = read_files([camera.with_suffix(".h5") for camera in cameras])
    retained = [name for name in images.landmark_names if name not in LEFT_OUT]
    truth = []
    for camera in cameras:
        shapes = read_shapes([camera.with_name(f"{camera.name}_truth.h5")], gaps=True)
        truth.append(
            shapes.as_columns()[
                ..., [shapes.landmark_names.index(name) for name in retained]
            ]
        )
    return arrange(images, retained, omit=True), np.concatenate(truth)


def without_truth(
    read: Callable[[Path], tuple[Landmarks, Floats]],
) -> Callable[[Path], Landmarks]:
    """Return a function that reads the images alone, from one that reads their truth
    too.
    """
    return lambda data: read(data)[0]


def sequence_case(
    name: str, published: str, goal: float, damaged: bool = False
) -> Case:
    """Return the case of a published sequence, which is both learned from and
    lifted.
    """
    read = sequence_reader(name, damaged)
    label = f"{name}-damaged" if damaged else name
    return Case(label, published, goal, e3d, without_truth(read), read)


def body_case(
    name: str,
    published: str,
    goal: float,
    subjects: tuple[int, int],
    *,
    varied: bool = False,
) -> Case:
    """Return the case of a body: learned from the images of one subject, lifted on
    those of another or the same.

    varied: learned for other bodies, with the bones and sides of this one.
    """
    learned, lifted = subjects
    if learned == lifted:
        read = turntable_reader(learned)
        return Case(name, published, goal, normalised_error, without_truth(read), read)
    source = turntable_reader(learned, frames=None, edges=varied)
    target = turntable_reader(lifted, every=10, frames=None)
    of = f"subject-{learned}-{'varied' if varied else 'whole'}"
    options = OTHER_BODIES if varied else ()
    return Case(
        name,
        published,
        goal,
        normalised_error,
        without_truth(source),
        target,
        "posterior",
        of,
        options,
    )


CASES = (
    sequence_case("pickup", ".0133", 0.020),
    sequence_case("stretch", ".0150", 0.020),
    sequence_case("walking", ".0407", 0.0407),
    sequence_case("face", ".0150", 0.0150),
    sequence_case("pickup", "", 0.025, damaged=True),
    sequence_case("stretch", "", 0.027, damaged=True),
    body_case("subject-13", ".259 (convex, with 3D)", 0.215, (13, 13)),
    Case(
        "rat",
        "6-13 with 3D poses",
        12.0,
        error_in_millimetres,
        without_truth(read_rat),
        read_rat,
    ),
    body_case("86-to-13", "", 0.27, (86, 13)),
    body_case("86-to-14", "", 0.27, (86, 14)),
    body_case("86-to-13-varied", "", 0.27, (86, 13), varied=True),
    body_case("86-to-14-varied", "", 0.27, (86, 14), varied=True),
)


def measure(case: Case, data: Path, learned: dict[Path, float]) -> tuple[str, ...]:
    """Learn, fit and evaluate a case; return its row of the table.

    learned: dictionary -> seconds that learning took, of all learned so far; added to.
    """
    folder = FOLDER / case.name
    folder.mkdir(parents=True, exist_ok=True)
    dictionary = FOLDER / f"{case.source or case.name}.h5"
    if dictionary not in learned:
        given = write_images(folder / "learned.h5", case.learned(data))
        before = seconds_of_commands()
        run("learn-dict", given, "-o", dictionary, *case.options)
        learned[dictionary] = seconds_of_commands() - before
    images, truth = case.lifted(data)
    lifted = write_images(folder / "lifted.h5", images)
    taken = learned[dictionary]
    result = folder / "result.h5"
    run("fit", lifted, "-d", dictionary, "-o", result, "--set", f"method={case.method}")
    shapes = read_results(result).as_columns()
    signs = [np.array([[1.0], [1.0], [sign]]) for sign in (1.0, -1.0)]
    error = min(float(np.nanmean(case.judged(sign * shapes, truth))) for sign in signs)
    met = "met" if error <= case.goal else "missed"
    return (
        case.name,
        case.published,
        f"{case.goal:g}",
        f"{error:.4f}",
        met,
        f"{taken:.0f}",
    )


def run(*arguments: str | Path) -> None:
    """Run a command of shapefit with one thread; single images may fail. Raises
    SystemExit where it fails.
    """
    command = [sys.executable, "-m", "shapefit", *map(str, arguments)]
    threads = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    done = subprocess.run(command, check=False, env=os.environ | threads)
    if done.returncode not in (0, 1):
        raise SystemExit(f"{' '.join(command)} ended with {done.returncode}")


def seconds_of_commands() -> float:
    """Return the seconds of the processor that all commands so far have used."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def main() -> None:
    """Measure the cases and write the table of all that were ever measured."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=Path("../shared/data"))
    parser.add_argument("cases", nargs="*", help="names of cases; all by default")
    given = parser.parse_args()
    learned: dict[Path, float] = {}
    for case in CASES:
        if not given.cases or case.name in given.cases:
            row = measure(case, given.data, learned)
            (FOLDER / case.name / ROW).write_text(json.dumps(row), encoding="utf-8")
            print(" | ".join(row), flush=True)
    measured = [FOLDER / case.name / ROW for case in CASES]
    rows = [
        json.loads(path.read_text(encoding="utf-8"))
        for path in measured
        if path.exists()
    ]
    header = ("case", "published", "goal", "error", "", "seconds")
    (FOLDER / "index.md").write_text(
        markdown_table(header, rows) + "\n", encoding="utf-8"
    )


if __name__ == "__main__":
    main()

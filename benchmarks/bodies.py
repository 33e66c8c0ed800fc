"""The dictionary `people` on bodies that it has not seen: each of its ten left out once.

`python -m benchmarks.bodies --data FOLDER` learns by configs/people/learn-box.yaml without a body,
lifts turntable views of that body, and writes the table into results/bodies/index.md, beside the
same by the dictionary of subject 86 alone. `posterior` is judged by images of all sequences,
`sequences` by every sixth sequence.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmarks.judged import (
    CONFIGS,
    DATA,
    mean_errors,
    read_bodies,
    read_images,
    run,
    settings,
    write_images,
    write_page,
)
from shapefit.evaluation.report import markdown_table
from shapefit.io import write_shapes
from shapefit.io.records import ShapeSet

FOLDER = Path("results/bodies")
FILES = ("subject86", "subject13", "subject14", "other_subjects")
ALONE = "86"
"""The body of the dictionary to compare with."""

CONFIG = {"posterior": CONFIGS / "people/fit.yaml", "sequences": CONFIGS / "people/sequences.yaml"}
EVERY = {"posterior": 1, "sequences": 6}
"""Every so many sequences of a body are lifted."""

MOST = 3000
"""Images of a body that `posterior`, which lifts each alone, is judged by: spread evenly."""

HEADS = (": images", f", {ALONE} alone", ", all others", ", ratio")


def learn(training: Sequence[Path], target: Path, config: Path, given: Sequence[str]) -> Path:
    """Learn a dictionary, once."""
    if not target.exists():
        run("learn-dict", "-c", config, *training, "-o", target, *settings(given))
    return target


def look(shapes: ShapeSet, method: str, folder: Path) -> tuple[Path, Path]:
    """Write turntable views of sequences of a body for a method: landmarks, truth."""
    every = EVERY[method]
    names = list(dict.fromkeys(shapes.sequences or ()))[::every]
    rows = np.flatnonzero(np.isin(np.array(shapes.sequences), names))
    truth, landmarks = folder / f"truth-{every}.h5", folder / f"landmarks-{every}.h5"
    write_shapes(truth, shapes.take(rows))
    run("project", "-c", CONFIGS / "mocap/project.yaml", truth, "-o", landmarks)
    if method == "posterior":
        thin = slice(None, None, -(-len(rows) // MOST))
        write_images(landmarks, read_images(landmarks).take(thin))
    return landmarks, truth


def judge(
    method: str, dictionary: Path, landmarks: Path, truth: Path, folder: Path
) -> tuple[float, float]:
    """Fit by a method; return the mean error over the sequences, normalised and in metres."""
    result = folder / f"{method}-{dictionary.stem}.h5"
    run("fit", "-c", CONFIG[method], landmarks, "-d", dictionary, "-o", result, failures=True)
    run("eval", "-c", CONFIGS / "detected/eval.yaml", result, "--truth", truth,
        "-o", result.with_suffix(""), "--set", "plots=false", failures=True)  # fmt: skip
    result.unlink()
    found = mean_errors(result.with_suffix("") / "report.json")
    return found[result.stem, "normalised"], found[result.stem, "m"]


def text_of(errors: tuple[float, float]) -> str:
    """Return both errors as the table has them."""
    return f"{errors[0]:.3f} ({1000 * errors[1]:.0f} mm)"


def main() -> None:
    """Measure all bodies and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=DATA / "mocap")
    parser.add_argument("--bodies", nargs="*", default=[], help="bodies to know; all by default")
    parser.add_argument("--only", nargs="*", default=[], help="bodies to judge; all by default")
    parser.add_argument("--methods", nargs="*", default=list(CONFIG), choices=list(CONFIG))
    parser.add_argument("--set", nargs="*", default=[], dest="settings", help="of learn-dict")
    parser.add_argument("--folder", type=Path, default=FOLDER)
    given = parser.parse_args()
    known = dict(sorted(read_bodies(given.data, FILES).items()))
    bodies = {name: known[name] for name in given.bodies or known}
    files = {name: given.folder / f"{name}.h5" for name in bodies}
    given.folder.mkdir(parents=True, exist_ok=True)
    for name, shapes in bodies.items():
        write_shapes(files[name], shapes)
    alone = None
    if ALONE in bodies:
        alone = learn(
            [files[ALONE]], given.folder / "alone.h5", CONFIGS / "people/learn-dict.yaml", []
        )
    rows = []
    for name in given.only or bodies:
        shapes = bodies[name]
        folder = given.folder / name
        folder.mkdir(exist_ok=True)
        others = [file for other, file in files.items() if other != name]
        without = learn(
            others, folder / "without.h5", CONFIGS / "people/learn-box.yaml", given.settings
        )
        row = [name]
        for method in given.methods:
            landmarks, truth = look(shapes, method, folder)
            errors = judge(method, without, landmarks, truth, folder)
            images = f"{len(read_images(landmarks)):,}"
            if alone is None or name == ALONE:
                row += [images, "", text_of(errors), ""]
            else:
                one = judge(method, alone, landmarks, truth, folder)
                row += [images, text_of(one), text_of(errors), f"{errors[0] / one[0]:.2f}"]
        rows.append(row)
        print(" | ".join(row), flush=True)
    heads = [f"{method}{head}" for method in given.methods for head in HEADS]
    table = markdown_table(["body", *heads], rows)
    text = f"# Bodies left out\n\nMean similarity error, normalised (mm).\n\n{table}\n"
    write_page(given.folder, text)


if __name__ == "__main__":
    main()

"""The dictionary `people` on bodies that it has not seen: each of its ten left out once.

`python -m benchmarks.bodies --data FOLDER` learns by configs/people/learn-box.yaml without a body,
lifts turntable views of that body, and writes the table into results/bodies/index.md, beside the
same by the dictionary of subject 86 alone. `posterior` is judged by images of all sequences,
`sequences` by every sixth sequence.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from shapefit.evaluation.report import markdown_table
from shapefit.io import landmark_writer, open_landmarks, read_shapes, write_shapes
from shapefit.io.records import ShapeSet
from shapefit.io.whole.atomic import atomic_path

CONFIGS = Path(__file__).resolve().parent.parent / "configs"
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


@dataclass(frozen=True)
class Errors:
    """Means over the sequences of a body of its mean similarity error: normalised, and in mm."""

    normalised: float
    millimetres: float

    def __str__(self) -> str:
        """Return both as a table shows them."""
        return f"{self.normalised:.3f} ({self.millimetres:.0f} mm)"


def run(*arguments: str | Path) -> None:
    """Run shapefit; single items may fail."""
    command = [str(Path(sys.executable).with_name("shapefit")), *map(str, arguments)]
    code = subprocess.run(command, check=False, stdout=subprocess.DEVNULL).returncode
    if code not in (0, 1):
        raise SystemExit(f"failed: {' '.join(command)}")


def split(data: Path) -> dict[str, ShapeSet]:
    """Return the shapes of each body, by the number that its sequences begin with."""
    bodies: dict[str, ShapeSet] = {}
    for name in FILES:
        shapes = read_shapes([data / f"{name}_24fps.h5"])
        numbers = np.array([sequence.split("_")[0] for sequence in shapes.sequences or ()])
        for number in dict.fromkeys(numbers.tolist()):
            bodies[number] = shapes.take(np.flatnonzero(numbers == number))
    return dict(sorted(bodies.items()))


def learn(training: Sequence[Path], target: Path, config: Path, settings: Iterable[str]) -> Path:
    """Learn a dictionary, once."""
    if not target.exists():
        options = [part for setting in settings for part in ("--set", setting)]
        run("learn-dict", "-c", config, *training, "-o", target, *options)
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
        thin(landmarks, -(-len(rows) // MOST))
    return landmarks, truth


def thin(landmarks: Path, every: int) -> None:
    """Keep every so many images of a file."""
    with open_landmarks([landmarks]) as source:
        (images,) = source.batches(max(source.count, 1))
    with landmark_writer(landmarks) as writer:
        writer.append(images.take(np.arange(0, len(images), every)))


def judge(
    method: str, dictionary: Path, landmarks: Path, truth: Path, folder: Path
) -> tuple[Errors, int]:
    """Fit by a method, and compare with the truth; the errors and the number of images."""
    result = folder / f"{method}-{dictionary.stem}.h5"
    report = folder / f"{method}-{dictionary.stem}"
    run("fit", "-c", CONFIG[method], landmarks, "-d", dictionary, "-o", result)
    run("eval", "-c", CONFIGS / "detected/eval.yaml", result, "--truth", truth, "-o", report,
        "--set", "plots=false")  # fmt: skip
    result.unlink()
    found, images = {}, 0
    for row in json.loads((report / "report.json").read_text(encoding="utf-8"))["summaries"]:
        if row["metric"] == "similarity" and row["sequence"] is None:
            found[row["unit"]] = row["mean"]
            images = row["images"]
    return Errors(found["normalised"], 1000 * found["m"]), images


def main() -> None:
    """Measure all bodies and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=Path("../shared/data/mocap"))
    parser.add_argument("--bodies", nargs="*", default=[], help="bodies to know; all by default")
    parser.add_argument("--only", nargs="*", default=[], help="bodies to judge; all by default")
    parser.add_argument("--methods", nargs="*", default=list(CONFIG), choices=list(CONFIG))
    parser.add_argument("--set", nargs="*", default=[], dest="settings", help="of learn-dict")
    parser.add_argument("--folder", type=Path, default=FOLDER)
    given = parser.parse_args()
    known = split(given.data)
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
            errors, images = judge(method, without, landmarks, truth, folder)
            one = None
            if alone is not None and name != ALONE:
                one, _ = judge(method, alone, landmarks, truth, folder)
            ratio = "" if one is None else f"{errors.normalised / one.normalised:.2f}"
            row += [f"{images:,}", "" if one is None else str(one), str(errors), ratio]
        rows.append(row)
        print(" | ".join(row), flush=True)
    heads = [f"{method}{head}" for method in given.methods for head in HEADS]
    table = markdown_table(["body", *heads], rows)
    text = f"# Bodies left out\n\nMean similarity error, normalised (mm).\n\n{table}\n"
    with atomic_path(given.folder / "index.md") as path:
        path.write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()

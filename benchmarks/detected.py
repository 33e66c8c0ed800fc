"""Real detections against their 3D truth: each set by each method, in one table.

`python -m benchmarks.detected --data FOLDER` learns the dictionaries, fits, judges, and
writes results/detected/index.md. Of `dlc_reaching` and `fly` the first half of the
frames trains and the last 40% are judged; the other sets are judged whole. Then follow
the errors of trusted and of doubtful frames.
"""

from __future__ import annotations

import argparse
import csv
import json
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

import shapefit
from benchmarks.coverage import (
    CONFIGS,
    DATA,
    WITH_BARS,
    coverage_cells,
    error_cells,
    errors_and_bars,
    read_images,
    run,
    set_options,
    write_images,
    write_page,
)
from shapefit.evaluation.report import markdown_table
from shapefit.io import (
    read_shapes,
    write_shapes,
)
from shapefit.records import Shapes

FOLDER = Path("results/detected")
METHODS = ("convex", "alternate", "posterior", "sequences")
JUDGED = 0.4
KNOWN = 0.9
"""Share of the training frames in which a landmark must be known to be learned."""

PEOPLE = (CONFIGS / "mocap/best/learn-dict.yaml", CONFIGS / "people/learn-dict.yaml")
ARM = ("Shoulder", "Elbow", "Wrist")
SIDES = {"left": "l", "right": "r"}
DESK = {
    f"{s}_{j}": t + j
    for s, t in SIDES.items()
    for j in ("shoulder", "elbow", "wrist", "hip")
}


@dataclass(frozen=True)
class Case:
    """A file of detections with its truth, and what is learned and fitted on it.

    learn: configs of learn-dict for the methods without and with a prior, None where
    the first half of the frames trains; lambdas of convex and alternate; methods that
    know what the names of its landmarks are; landmarks of the truth that are judged,
    all by default.
    """

    name: str
    landmarks: str
    truth: str
    learn: tuple[Path, Path] | None
    rename: dict[str, str] = field(default_factory=dict)
    lambdas: tuple[float, float] = (0.1, 0.1)
    settings: tuple[str, ...] = ()
    methods: tuple[str, ...] = METHODS
    judged: tuple[str, ...] = ()


RAT = (CONFIGS / "detected/learn-rat.yaml",) * 2
BEAM = "pose2sim_balancing/cam{0}_joints13"
BY_NAME = "pose2sim_balancing/cam{0}"
THIRTEEN = ("Head", *(s + j for s in "LR" for j in ("Hip", "Knee", "Ankle", *ARM)))
CASES = (
    *(
        Case(
            f"beam, camera {n}",
            BEAM.format(n),
            BEAM.format(n) + "_truth",
            PEOPLE,
            lambdas=(0.03, 0.03),
            settings=("frame_rate=60",),
        )
        for n in ("01", "03")
    ),
    *(
        Case(
            f"beam by OpenPose's names, camera {n}",
            BY_NAME.format(n),
            BY_NAME.format(n) + "_truth",
            PEOPLE,
            methods=WITH_BARS,
            settings=("frame_rate=60",),
            judged=THIRTEEN,
        )
        for n in ("01", "03")
    ),
    *(
        Case(
            f"rat, camera {n}{what}",
            f"rat7m/camera{n}",
            f"rat7m/camera{n}_truth{which}",
            RAT,
        )
        for n in (1, 3, 5)
        for what, which in (("", "_complete"), (", all landmarks", ""))
    ),
    Case("reaching mouse", "dlc_reaching/camera1", "dlc_reaching/camera1_truth", None),
    *(
        Case(f"fly, camera {n}", f"fly/Cam-{n}", f"fly/Cam-{n}_truth", None)
        for n in "AC"
    ),
    *(
        Case(
            f"desk, camera {n}",
            f"pyxy3d_desk/port_{n}",
            f"pyxy3d_desk/port_{n}_truth",
            PEOPLE,
            rename=DESK,
            lambdas=(0.03, 0.03),
        )
        for n in (1, 3)
    ),
)


def learn(config: Path, data: Path) -> Path:
    """Learn the dictionary of a config, if that has not been done yet; return its path.

    data: the folder of the detections; that of motion capture is `mocap` beside it.
    """
    target = FOLDER / f"{config.parent.name}-{config.stem}.h5"
    if not target.exists():
        of_mocap = config.parent.name != "detected"
        folder = data.parent / "mocap" if of_mocap else data
        run("learn-dict", "-c", config, "-o", target, "--set", f"data={folder}")
    return target


def split(case: Case, data: Path, folder: Path) -> tuple[Path, Path, Path]:
    """Split a case by time: write training shapes, landmarks to fit and their truth
    into the folder, and return the three paths.
    """
    truth = read_shapes([data / f"{case.truth}.h5"], gaps=True)
    images = read_images(data / f"{case.landmarks}.h5")
    n = len(truth)
    half, last = slice(0, n // 2), slice(n - round(JUDGED * n), n)
    known = np.asarray(np.isfinite(truth.shapes[half]).all(axis=2), dtype=bool)
    columns = np.flatnonzero(known.mean(axis=0) >= KNOWN)
    rows = np.flatnonzero(known[:, columns].all(axis=1))
    paths = tuple(folder / name for name in ("training.h5", "landmarks.h5", "truth.h5"))
    write_shapes(paths[0], take_landmarks(truth.take(rows), columns))
    write_images(paths[1], images.take(last))
    write_shapes(paths[2], truth.take(last))
    return paths[0], paths[1], paths[2]


def take_landmarks(
    shapes: Shapes, columns: np.ndarray[tuple[int], np.dtype[np.intp]]
) -> Shapes:
    """Return shapes with the landmarks of these indices alone, and the edges between
    them.
    """
    place = {int(old): new for new, old in enumerate(columns)}
    edges = [] if shapes.edges is None else shapes.edges.tolist()
    retained = [(place[a], place[b]) for a, b in edges if a in place and b in place]
    return Shapes(
        shapes.shapes[:, columns],
        landmark_names=tuple(shapes.landmark_names[j] for j in columns.tolist()),
        items=shapes.items,
        sequences=shapes.sequences,
        edges=np.array(retained, dtype=np.int64).reshape(-1, 2),
        unit=shapes.unit,
        frame_rate=shapes.frame_rate,
    )


def measure(case: Case, data: Path, methods: Sequence[str], people: str = "") -> Path:
    """Fit a case by each of the methods and compare with its truth; return the path of
    the report in JSON.

    `people` is the dictionary of people with a prior, by default the one of subject 86.
    """
    folder = FOLDER / case.name.replace(", ", "-").replace(" ", "-")
    folder.mkdir(parents=True, exist_ok=True)
    if case.learn is None:
        training, landmarks, truth = split(case, data, folder)
        plain = prior = folder / "dictionary.h5"
        run(
            "learn-dict",
            "-c",
            CONFIGS / "detected/learn-half.yaml",
            training,
            "-o",
            plain,
        )
    else:
        plain, prior = (learn(config, data) for config in case.learn)
        landmarks, truth = (
            data / f"{name}.h5" for name in (case.landmarks, case.truth)
        )
        if people and case.learn is PEOPLE:
            prior = Path(people)
    if case.judged:
        whole = read_shapes([truth], gaps=True)
        truth = folder / "truth.h5"
        columns = np.flatnonzero(np.isin(np.array(whole.landmark_names), case.judged))
        write_shapes(truth, take_landmarks(whole, columns))
    methods = [method for method in methods if method in case.methods]
    rename = case.rename and {
        old: new
        for old, new in case.rename.items()
        if old in read_images(landmarks).landmark_names
    }
    renamed = ["--set", f"rename={json.dumps(rename)}"] if rename else []
    lambdas = dict(zip(("convex", "alternate"), case.lambdas, strict=True))
    results = []
    for method in methods:
        result = folder / f"{method}.h5"
        dictionary = plain if method in lambdas else prior
        own = ["--set", f"lambda={lambdas[method]}"] if method in lambdas else []
        if method == "sequences":
            own += set_options(case.settings)
        config = CONFIGS / f"detected/fit-{method}.yaml"
        run(
            "fit",
            "-c",
            config,
            landmarks,
            "-d",
            dictionary,
            "-o",
            result,
            *own,
            *renamed,
            failures=True,
        )
        results.append(result)
    run(
        "eval",
        "-c",
        CONFIGS / "detected/eval.yaml",
        *results,
        "--truth",
        truth,
        "-o",
        folder / "report",
        *renamed,
        failures=True,
    )
    return folder / "report/report.json"


def verdict_tables(folder: Path) -> str:
    """Return the errors of frames that are trusted and that are not, as Markdown: a
    table by set and method, and one by reason over all sets.
    """
    rows: list[list[str]] = []
    reasons: dict[str, list[float]] = defaultdict(list)
    for report in sorted(folder.glob("*/report/per_image.csv")):
        for method in WITH_BARS:
            with report.open(encoding="utf-8") as file:
                errors = {
                    row["item"]: float(row["error"] or "nan")
                    for row in csv.DictReader(file)
                    if (row["method"], row["metric"]) == (method, "similarity")
                    and row["unit"] == "normalised"
                }
            found = shapefit.read_results(report.parents[1] / f"{method}.h5")
            items = list(found.items or ())
            stated = np.array(found.reasons, dtype=str)
            own = np.array([errors.get(item, np.nan) for item in items])
            judged = np.array([item in errors for item in items])
            for reason in np.unique(stated[judged]):
                reasons[reason or "trusted"] += own[
                    judged & (stated == reason)
                ].tolist()
            bad = judged & (stated != "")
            name = report.parents[1].name
            counts = f"{bad.sum()} of {judged.sum()}"
            rows.append(
                [
                    name,
                    method,
                    counts,
                    _mean_as_text(own[judged & ~bad]),
                    _mean_as_text(own[bad]),
                ]
            )
    of_reasons = [
        [reason, str(len(own)), _mean_as_text(own)]
        for reason, own in sorted(reasons.items())
    ]
    first = markdown_table(
        ["set", "method", "doubted", "error, trusted", "error, doubted"], rows
    )
    return f"{first}\n\n{markdown_table(['reasons', 'frames', 'error'], of_reasons)}\n"


def _mean_as_text(values: Sequence[float]) -> str:
    known = np.array([value for value in values if np.isfinite(value)])
    return f"{known.mean():.3f}" if len(known) else "-"


def main() -> None:
    """Measure the cases by the methods and write the page of their tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=DATA / "detected")
    parser.add_argument(
        "--only", nargs="*", default=[], help="beginnings of the names of cases"
    )
    parser.add_argument("--methods", nargs="*", default=METHODS, choices=METHODS)
    parser.add_argument(
        "--people", default="", help="dictionary in place of subject 86's: people"
    )
    given = parser.parse_args()
    FOLDER.mkdir(parents=True, exist_ok=True)
    rows, regions = [], []
    for case in CASES:
        if not given.only or case.name.startswith(tuple(given.only)):
            report = measure(case, given.data, given.methods, given.people)
            rows.append([case.name, *error_cells(report, given.methods)])
            regions.append([case.name, *coverage_cells(report)])
            print(" | ".join(rows[-1]), flush=True)
    page = errors_and_bars(
        "# Detected landmarks", ["set", *given.methods], rows, regions
    )
    write_page(FOLDER, f"{page}\n{verdict_tables(FOLDER)}")


if __name__ == "__main__":
    main()

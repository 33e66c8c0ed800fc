"""Real detections against their 3D truth: each set by each method, in one table.

`python -m benchmarks.detected --data FOLDER` learns the dictionaries, fits, judges, and writes
results/detected/index.md. Of `dlc_reaching` and `fly` the first half of the frames trains and the
last 40% are judged; the other sets are judged whole.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from shapefit.evaluation.report import markdown_table
from shapefit.io import landmark_writer, open_landmarks, read_shapes, write_shapes
from shapefit.io.records import ShapeSet
from shapefit.io.whole.atomic import atomic_path

CONFIGS = Path(__file__).resolve().parent.parent / "configs"
FOLDER = Path("results/detected")
METHODS = ("convex", "alternate", "posterior", "sequences")
WITH_BARS = ("posterior", "sequences")
JUDGED = 0.4
KNOWN = 0.9
"""Share of the training frames in which a landmark must be known to be learned."""

PEOPLE = (CONFIGS / "mocap/best/learn-dict.yaml", CONFIGS / "people/learn-dict.yaml")
ARM = ("Shoulder", "Elbow", "Wrist")
SIDES = {"left": "l", "right": "r"}
DESK = {f"{s}_{j}": t + j for s, t in SIDES.items() for j in ("shoulder", "elbow", "wrist", "hip")}


@dataclass(frozen=True)
class Case:
    """A file of detections and its truth (with names of their own), learned as `learn` says.

    learn: configs of learn-dict for the methods without and with a prior, None where the first
    half of the frames trains; lambdas of convex and alternate; methods that know what the names
    of its landmarks are; landmarks of the truth that are judged, all by default.
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
        Case(f"beam, camera {n}", BEAM.format(n), BEAM.format(n) + "_truth", PEOPLE,
             lambdas=(0.03, 0.03), settings=("sequences.frame_rate=60",))
        for n in ("01", "03")
    ),
    *(
        Case(f"beam by OpenPose's names, camera {n}", BY_NAME.format(n),
             BY_NAME.format(n) + "_truth", PEOPLE, methods=WITH_BARS,
             settings=("sequences.frame_rate=60",), judged=THIRTEEN)
        for n in ("01", "03")
    ),
    *(
        Case(f"rat, camera {n}{what}", f"rat7m/camera{n}", f"rat7m/camera{n}_truth{which}", RAT)
        for n in (1, 3, 5)
        for what, which in (("", "_complete"), (", all landmarks", ""))
    ),
    Case("reaching mouse", "dlc_reaching/camera1", "dlc_reaching/camera1_truth", None),
    *(Case(f"fly, camera {n}", f"fly/Cam-{n}", f"fly/Cam-{n}_truth", None) for n in "AC"),
    *(
        Case(f"desk, camera {n}", f"pyxy3d_desk/port_{n}", f"pyxy3d_desk/port_{n}_truth", PEOPLE,
             rename=DESK, lambdas=(0.03, 0.03))
        for n in (1, 3)
    ),
)  # fmt: skip


def run(*arguments: str | Path, failures: bool = False) -> None:
    """Run shapefit; with `failures` single items may fail."""
    command = [str(Path(sys.executable).with_name("shapefit")), *map(str, arguments)]
    code = subprocess.run(command, check=False, stdout=subprocess.DEVNULL).returncode
    if code and not (failures and code == 1):
        raise SystemExit(f"failed: {' '.join(command)}")


def learn(config: Path, data: Path) -> Path:
    """Learn the dictionary of a config, once; the data are those of the detections or of mocap."""
    target = FOLDER / f"{config.parent.name}-{config.stem}.h5"
    if not target.exists():
        of_mocap = config.parent.name != "detected"
        folder = data.parent / "mocap" if of_mocap else data
        run("learn-dict", "-c", config, "-o", target, "--set", f"data={folder}")
    return target


def split(case: Case, data: Path, folder: Path) -> tuple[Path, Path, Path]:
    """Write training shapes, judged landmarks and their truth into the folder."""
    truth = read_shapes([data / f"{case.truth}.h5"], gaps=True)
    with open_landmarks([data / f"{case.landmarks}.h5"]) as source:
        (images,) = source.batches(max(source.count, 1))
    n = len(truth)
    half, last = slice(0, n // 2), slice(n - round(JUDGED * n), n)
    known = np.asarray(np.isfinite(truth.shapes[half]).all(axis=1), dtype=bool)
    columns = np.flatnonzero(known.mean(axis=0) >= KNOWN)
    rows = np.flatnonzero(known[:, columns].all(axis=1))
    paths = tuple(folder / name for name in ("training.h5", "landmarks.h5", "truth.h5"))
    write_shapes(paths[0], of_landmarks(truth.take(rows), columns))
    with landmark_writer(paths[1]) as writer:
        writer.append(images.take(last))
    write_shapes(paths[2], truth.take(last))
    return paths[0], paths[1], paths[2]


def of_landmarks(shapes: ShapeSet, columns: np.ndarray[tuple[int], np.dtype[np.intp]]) -> ShapeSet:
    """Return shapes with some of their landmarks, and the edges between these."""
    place = {int(old): new for new, old in enumerate(columns)}
    edges = [] if shapes.edges is None else shapes.edges.tolist()
    kept = [(place[a], place[b]) for a, b in edges if a in place and b in place]
    return ShapeSet(
        shapes=shapes.shapes[..., columns],
        landmark_names=tuple(shapes.landmark_names[j] for j in columns),
        items=shapes.items,
        sequences=shapes.sequences,
        edges=np.array(kept, dtype=np.int64).reshape(-1, 2),
        unit=shapes.unit,
        frame_rate=shapes.frame_rate,
        columns={},
    )


def measure(case: Case, data: Path, methods: Sequence[str], people: str = "") -> Path:
    """Fit one case by the methods and judge them; the report as JSON.

    `people` is the dictionary of people with a prior, by default the one of subject 86.
    """
    folder = FOLDER / case.name.replace(", ", "-").replace(" ", "-")
    folder.mkdir(parents=True, exist_ok=True)
    if case.learn is None:
        training, landmarks, truth = split(case, data, folder)
        plain = prior = folder / "dictionary.h5"
        run("learn-dict", "-c", CONFIGS / "detected/learn-half.yaml", training, "-o", plain)
    else:
        plain, prior = (learn(config, data) for config in case.learn)
        landmarks, truth = (data / f"{name}.h5" for name in (case.landmarks, case.truth))
        if people and case.learn is PEOPLE:
            prior = Path(people)
    if case.judged:
        whole = read_shapes([truth], gaps=True)
        truth = folder / "truth.h5"
        columns = np.flatnonzero(np.isin(np.array(whole.landmark_names), case.judged))
        write_shapes(truth, of_landmarks(whole, columns))
    methods = [method for method in methods if method in case.methods]
    known = names_of(landmarks)
    rename = {old: new for old, new in case.rename.items() if old in known}
    renamed = ["--set", f"rename={json.dumps(rename)}"] if rename else []
    lambdas = dict(zip(("convex", "alternate"), case.lambdas, strict=True))
    results = []
    for method in methods:
        result = folder / f"{method}.h5"
        dictionary = plain if method in lambdas else prior
        own = ["--set", f"lambda={lambdas[method]}"] if method in lambdas else []
        if method == "sequences":
            own += [part for setting in case.settings for part in ("--set", setting)]
        config = CONFIGS / f"detected/fit-{method}.yaml"
        run("fit", "-c", config, landmarks, "-d", dictionary, "-o", result, *own, *renamed,
            failures=True)  # fmt: skip
        results.append(result)
    run("eval", "-c", CONFIGS / "detected/eval.yaml", *results, "--truth", truth,
        "-o", folder / "report", *renamed, failures=True)  # fmt: skip
    return folder / "report/report.json"


def names_of(landmarks: Path) -> frozenset[str]:
    """Names of the landmarks of a file."""
    with open_landmarks([landmarks]) as source:
        return frozenset(source.head.landmark_names)


def cells(report: Path, methods: Sequence[str]) -> list[str]:
    """Mean normalised errors of the methods, with millimetres where the truth is in metres."""
    found = {}
    for row in json.loads(report.read_text(encoding="utf-8"))["summaries"]:
        if row["metric"] == "similarity" and row["sequence"] is None:
            found[row["method"], row["unit"]] = row["mean"]
    texts = []
    for method in methods:
        if (method, "normalised") not in found:
            texts.append("")
            continue
        text = f"{found[method, 'normalised']:.3f}"
        metres = found.get((method, "m"))
        texts.append(text if metres is None else f"{text} ({1000 * metres:.3g} mm)")
    return texts


def coverage(report: Path) -> list[str]:
    """Shares inside the 50% and 90% ellipsoids, and the normalised width, of methods with bars."""
    texts = {}
    for row in json.loads(report.read_text(encoding="utf-8"))["calibration"]:
        if row["landmark"] is None:
            half, most = (f"{100 * share:.0f}%" for share in row["inside"])
            texts[row["method"]] = f"{half} / {most} / {row['median_width']['normalised']:.2f}"
    return [texts.get(method, "") for method in WITH_BARS]


def write_page(
    folder: Path, title: str, head: list[str], rows: list[list[str]], regions: list[list[str]]
) -> None:
    """Write index.md: rows of `cells` under the head, and then those of `coverage`; print it."""
    table = markdown_table(head, rows)
    bars = markdown_table([head[0], *WITH_BARS], regions)
    text = (
        f"{title}\n\nMean similarity error, normalised.\n\n{table}\n\nShare of the "
        "truth inside the 50% and the 90% ellipsoids of the error bars, and the median width of "
        f"the latter, normalised.\n\n{bars}\n"
    )
    with atomic_path(folder / "index.md") as path:
        path.write_text(text, encoding="utf-8")
    print(text)


def main() -> None:
    """Measure all cases and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=Path("../shared/data/detected"))
    parser.add_argument("--only", nargs="*", default=[], help="beginnings of the names of cases")
    parser.add_argument("--methods", nargs="*", default=METHODS, choices=METHODS)
    parser.add_argument("--people", default="", help="dictionary in place of subject 86's: people")
    given = parser.parse_args()
    FOLDER.mkdir(parents=True, exist_ok=True)
    rows, regions = [], []
    for case in CASES:
        if not given.only or case.name.startswith(tuple(given.only)):
            report = measure(case, given.data, given.methods, given.people)
            rows.append([case.name, *cells(report, given.methods)])
            regions.append([case.name, *coverage(report)])
            print(" | ".join(rows[-1]), flush=True)
    write_page(FOLDER, "# Detected landmarks", ["set", *given.methods], rows, regions)


if __name__ == "__main__":
    main()

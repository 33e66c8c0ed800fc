"""The paper's experiments: each is a command, and `make paper` runs all of them.

`python -m experiments recovery FOLDER`       exact recovery of planted transforms
`python -m experiments sensitivity FOLDER`    timing, and errors against lambda, noise,
                                              ...
`python -m experiments cars FOLDER`           cars with wrong landmarks, by each search
`python -m experiments bodies FOLDER`         sedan, SUV and pick-up, by two methods
`python -m experiments published NAME FOLDER` the paper's numbers in a report of `eval`
`python -m experiments index FOLDER`          every table and figure beside the paper's
"""

from __future__ import annotations

import argparse
import csv
from collections.abc import Iterable, Sequence
from dataclasses import astuple, fields
from pathlib import Path

from experiments import pages, recovery, sensitivity
from experiments.car_bodies import write_bodies
from experiments.sensitivity import DATA, Experiment, Point


def write_recovery(
    folder: Path,
    landmarks: Iterable[int] = recovery.LANDMARKS,
    active: Iterable[int] = recovery.ACTIVE,
    trials: int = recovery.TRIALS,
) -> str:
    """Measure exact recovery and write recovery.csv (p,z,trials,success), recovery.md
    and recovery.png into the folder; return the page.
    """
    from experiments.figures import draw_shares

    shares = recovery.shares_of_transforms(tuple(landmarks), tuple(active), trials)
    paper = pages.quoted_shares()
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / "recovery.csv").open("w", newline="", encoding="utf-8") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(("p", "z", "trials", "success"))
        rows.writerows((p, z, trials, share) for (p, z), share in shares.items())
    page = recovery.recovery_page(
        shares, paper, trials, pages.quoted("recovery")["source"]
    )
    (folder / "recovery.md").write_text(page, encoding="utf-8")
    shown = {"Share recovered exactly": shares}
    if common := {at: paper[at] for at in shares if at in paper}:
        shown["Paper"] = common
    draw_shares(shown).savefig(folder / "recovery.png", dpi=150)
    return page


def write_points(folder: Path, points: Sequence[Point]) -> None:
    """Write the points of an experiment as sweep.csv, sweep.md and sweep.png into the
    folder.
    """
    from experiments.figures import draw_points

    folder.mkdir(parents=True, exist_ok=True)
    with (folder / "sweep.csv").open("w", newline="", encoding="utf-8") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(entry.name for entry in fields(Point))
        rows.writerows(map(astuple, points))
    page = [
        f"# Error against {points[0].key}",
        (
            "Each cell is mean / median over the images; of several sequences, the mean"
            " of the sequences' means and of their medians. Times are those of solving"
            " alone, without reading and writing, after one run to warm up."
        ),
        sensitivity.table_of(points),
        "![Errors and times](sweep.png)",
    ]
    (folder / "sweep.md").write_text("\n\n".join(page) + "\n", encoding="utf-8")
    draw_points(points).savefig(folder / "sweep.png", dpi=150)


def write_experiments(
    folder: Path, experiments: Iterable[Experiment], only: list[str]
) -> None:
    """Run the experiments whose names hold one of `only`, all if it is empty; write and
    print their tables.
    """
    for experiment in experiments:
        if not only or any(part in experiment.name for part in only):
            points = sensitivity.measure(experiment)
            write_points(folder / experiment.name, points)
            print(
                f"# {experiment.name}\n\n{sensitivity.table_of(points)}\n", flush=True
            )


def main() -> None:
    """Run the experiment that the command line names."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    names = ("recovery", "sensitivity", "cars", "bodies", "published", "index")
    parser.add_argument("experiment", choices=names)
    parser.add_argument("words", nargs="+", metavar="[NAME] FOLDER")
    parser.add_argument(
        "--data", type=Path, help="folder of the motion capture files, or cars"
    )
    parser.add_argument("--trials", type=int, help="in each cell of a recovery")
    parser.add_argument(
        "--only", nargs="*", default=[], help="parts of the names of experiments"
    )
    given = parser.parse_args()
    folder = Path(given.words[-1])
    folder.mkdir(parents=True, exist_ok=True)
    if given.experiment == "recovery":
        print(write_recovery(folder, trials=given.trials or recovery.TRIALS), end="")
    elif given.experiment == "sensitivity":
        data = given.data or DATA / "mocap"
        write_experiments(folder, sensitivity.paper_experiments(data), given.only)
    elif given.experiment == "cars":
        data = given.data or DATA / "cars"
        write_experiments(folder, sensitivity.car_experiments(data), given.only)
    elif given.experiment == "bodies":
        path = (given.data or DATA / "cars") / "fg3dcar_shapes.h5"
        print(write_bodies(folder, path, pages.quoted("cars")["bodies"]), end="")
    elif given.experiment == "published":
        print(pages.add_published(given.words[0], folder), end="")
    else:
        (folder / "index.md").write_text(pages.index(folder), encoding="utf-8")
        print(f"The index is {folder / 'index.md'}.")


if __name__ == "__main__":
    main()

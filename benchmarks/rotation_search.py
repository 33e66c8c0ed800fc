"""The search over all rotations beside the local method that it starts from, in one run.

`python -m benchmarks.rotation_search DATA [CARS]`, with folders of motion capture and cars, times
`global` and `convex+refine` on the same images, one thread, in processor time. Absolute times
depend on the machine and its load, the ratio hardly: it fails above CEILING, a fifth over the ratio
measured.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.cases import LAMBDA, Case, cars_case, hide, mocap_case
from shapefit.convex.newton import solve_newton
from shapefit.convex.problem import build_problem
from shapefit.convex.solution import Status
from shapefit.evaluation.report import markdown_table
from shapefit.lifting.methods import SearchOptions, Settings, choose_method

IMAGES = 256
CEILING = {
    "subject 13, 1%": 42.0,
    "subject 13, 0.1%": 60.0,
    "subject 13, 30% hidden, 1%": 44.0,
    "subject 13, 1%, modes within 5%": 84.0,
    "cars, 1%": 30.0,
}
"""Largest ratio of the times of `global` and `convex+refine`, by case."""


def measure(case: Case, tolerance: float, modes: float) -> tuple[float, float, float]:
    """Images per second of the search, its time over that of convex+refine, share certified."""
    spread = np.linspace(0, len(case.landmarks) - 1, IMAGES).astype(int)
    problem = build_problem(case.landmarks[spread], case.atoms, LAMBDA)
    solve = partial(solve_newton, tolerance=1e-6, threads=1)
    mean = case.atoms.mean(axis=0)
    settings = Settings(solve=solve, mean_shape=mean, tolerance=tolerance, threads=1)
    local = choose_method("convex+refine", settings)
    options = SearchOptions(modes=modes)
    search = choose_method("global", replace(settings, options=options))
    short, _ = timed(lambda: local(problem), 5)
    long, found = timed(lambda: search(problem), 1)
    certified = np.mean([status is Status.OPTIMAL for status in found.status])
    return IMAGES / long, long / short, float(certified)


def timed(work: Callable[[], Any], times: int) -> tuple[float, Any]:
    """Return the least processor time of a run, over three rounds, and what it returns."""
    work()
    best = np.inf
    for _ in range(3):
        began = time.process_time()
        for _ in range(times):
            found = work()
        best = min(best, (time.process_time() - began) / times)
    return best, found


def main() -> None:
    """Print the table; exit with 1 where a ratio is above its ceiling."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", type=Path)
    parser.add_argument("cars", type=Path, nargs="?")
    folders = parser.parse_args()
    people = mocap_case(folders.data)
    runs = [
        ("subject 13, 1%", people, 1e-2, 0.0),
        ("subject 13, 0.1%", people, 1e-3, 0.0),
        ("subject 13, 30% hidden, 1%", hide(people, 0.3), 1e-2, 0.0),
        ("subject 13, 1%, modes within 5%", people, 1e-2, 0.05),
    ]
    if folders.cars is not None:
        runs.append(("cars, 1%", cars_case(folders.cars, times=1), 1e-2, 0.0))
    rows, slow = [], []
    for name, case, tolerance, modes in runs:
        rate, ratio, certified = measure(case, tolerance, modes)
        rows.append(
            [name, f"{rate:.0f}", f"{ratio:.0f}", f"{CEILING[name]:.0f}", f"{certified:.1%}"]
        )
        slow += [name] if ratio > CEILING[name] else []
    header = ["case", "images/s", "times convex+refine", "at most", "certified"]
    print(markdown_table(header, rows))
    if slow:
        sys.exit(f"slower than the ceiling: {', '.join(slow)}")


if __name__ == "__main__":
    main()

"""What `optimal` at a tolerance means for the shape: each solved again, to a gap of 1e-9.

Usage: python -m benchmarks.tolerances FOLDER [--step N]. FOLDER holds the motion capture files;
every N-th frame of subject 13 is used. CPU is the processor time beside that at the first
tolerance. A shape differs by ||S - S'||_F / ||S'||_F in the frame of
the camera. The last row of a loss compares two solutions at 1e-9, of the images in order and in
reverse: what is left there is not determined by the program, or not by a gap in float64.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np

from benchmarks.cases import LAMBDA, hide, mocap_case
from shapefit.arrays import Floats
from shapefit.convex.newton import solve_newton
from shapefit.convex.problem import Loss, Problem, build_problem
from shapefit.convex.solution import Solution
from shapefit.lifting.reconstruction import reconstruct

TOLERANCES = (1e-4, 1e-5, 1e-6, 1e-7, 1e-8)
REFERENCE = 1e-9
REPEATS = 3


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--step", type=int, default=10)
    arguments = parser.parse_args()
    case = mocap_case(arguments.folder)
    case = case.replaced(landmarks=case.landmarks[:: arguments.step])
    print(f"{len(case.landmarks)} images, k = {len(case.atoms)}\n")
    print("| case | loss | tolerance | steps | CPU | median | 99 % | largest | beyond 1 % |")
    print("|---|---|--:|--:|--:|--:|--:|--:|--:|")
    for name, landmarks in (
        ("all seen", case.landmarks),
        ("20 % hidden", hide(case, 0.2).landmarks),
    ):
        for loss in Loss:
            lam = 1.0 if loss is Loss.EXACT else LAMBDA
            compare(name, build_problem(landmarks, case.atoms, lam, loss=loss))


def compare(name: str, problem: Problem) -> None:
    """Print the rows of one loss."""
    cost: dict[float, list[float]] = {tolerance: [] for tolerance in TOLERANCES}
    found = {}
    for _ in range(REPEATS):
        for tolerance in TOLERANCES:
            began = time.process_time()
            found[tolerance] = solve_newton(problem, tolerance=tolerance)
            cost[tolerance].append(time.process_time() - began)
    best = shapes_of(solve_newton(problem, tolerance=REFERENCE), problem)
    for tolerance, solution in found.items():
        spent = f"{min(cost[tolerance]) / min(cost[TOLERANCES[0]]):.2f}"
        row(name, problem, f"{tolerance:.0e}", spent, solution, shapes_of(solution, problem), best)
    back = np.arange(len(problem.landmarks))[::-1]
    again = solve_newton(problem.take(back), tolerance=REFERENCE)
    other = shapes_of(again, problem)[back]
    row(name, problem, f"{REFERENCE:.0e}, in reverse", "", again, other, best)


def shapes_of(solution: Solution, problem: Problem) -> Floats:
    """Return the shapes (n, 3, p) of a solution."""
    return reconstruct(solution.transforms, problem.atoms).shapes


def row(
    name: str,
    problem: Problem,
    tolerance: str,
    spent: str,
    found: Solution,
    shapes: Floats,
    best: Floats,
) -> None:
    """Print one row of the table."""
    off = np.linalg.norm(shapes - best, axis=(1, 2)) / np.linalg.norm(best, axis=(1, 2))
    short = sum(status.value != "optimal" for status in found.status)
    reached = f" ({short} not reached)" if short else ""
    middle, most = np.percentile(off, [50, 99])
    print(
        f"| {name} | {problem.loss.value} | {tolerance}{reached} | {found.iterations.mean():.1f} "
        f"| {spent} | {middle:.1e} | {most:.1e} | {off.max():.1e} | {(off > 0.01).sum()} |",
        flush=True,
    )


if __name__ == "__main__":
    main()

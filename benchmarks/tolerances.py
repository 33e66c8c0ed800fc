"""What `optimal` at a tolerance means for the shape: each solved again, to a gap of 1e-9.

Usage: python -m benchmarks.tolerances FOLDER [--step N]. FOLDER holds the motion capture files;
every N-th frame of subject 13 is used. A shape differs by ||S - S'||_F / ||S'||_F in the frame of
the camera. The last row of a loss compares two solutions at 1e-9, of the images in order and in
reverse: what is left there is not determined by the program, or not by a gap in float64.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np

from benchmarks.cases import LAMBDA, Floats, mocap_case
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
    landmarks = case.landmarks[:: arguments.step]
    print(f"{len(landmarks)} images, k = {len(case.atoms)}\n")
    print("| loss | tolerance | images/s | not reached | median | 99 % | largest |")
    print("|---|--:|--:|--:|--:|--:|--:|")
    for loss in Loss:
        lam = 1.0 if loss is Loss.EXACT else LAMBDA
        problem = build_problem(landmarks, case.atoms, lam, loss=loss)
        solve_newton(problem.take(np.arange(64)))
        reference = solve_newton(problem, tolerance=REFERENCE)
        best = shapes_of(reference, problem)
        for tolerance in TOLERANCES:
            times = []
            for _ in range(REPEATS):
                began = time.perf_counter()
                found = solve_newton(problem, tolerance=tolerance)
                times.append(time.perf_counter() - began)
            speed = len(landmarks) / np.median(times)
            row(loss.value, f"{tolerance:.0e}", speed, found, shapes_of(found, problem), best)
        back = np.arange(len(landmarks))[::-1]
        again = solve_newton(problem.take(back), tolerance=REFERENCE)
        other = shapes_of(again, problem)[back]
        row(loss.value, f"{REFERENCE:.0e}, in reverse", np.nan, again, other, best)


def shapes_of(solution: Solution, problem: Problem) -> Floats:
    """Return the shapes (n, 3, p) of a solution."""
    return reconstruct(solution.transforms, problem.atoms).shapes


def row(
    loss: str, tolerance: str, speed: float, found: Solution, shapes: Floats, best: Floats
) -> None:
    """Print one row of the table."""
    off = np.linalg.norm(shapes - best, axis=(1, 2)) / np.linalg.norm(best, axis=(1, 2))
    short = sum(status.value != "optimal" for status in found.status)
    middle, most = np.percentile(off, [50, 99])
    print(
        f"| {loss} | {tolerance} | {speed:,.0f} | {short} "
        f"| {middle:.2%} | {most:.2%} | {off.max():.2%} |",
        flush=True,
    )


if __name__ == "__main__":
    main()

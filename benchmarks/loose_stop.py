"""Does a loose stop lower the 3D error, or does lambda? Error against solver, stop and lambda.

Usage: python -m benchmarks.loose_stop FOLDER [--step N]. FOLDER holds the motion capture files;
every N-th frame of subjects 13 and 14 is used. Errors are similarity-aligned, for truth of unit
standard deviation, means of sequence means.
"""

from __future__ import annotations

import argparse
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.admm import solve_admm
from benchmarks.cases import learn_mocap, turntable_views
from shapefit.arrays import Floats
from shapefit.convex.newton import solve_newton
from shapefit.convex.problem import build_problem
from shapefit.convex.solution import Solution
from shapefit.evaluation.metrics import similarity, truth_scale
from shapefit.io import ShapeSet, read_shapes
from shapefit.lifting.reconstruction import reconstruct

SUBJECTS = ("13", "14")


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--step", type=int, default=10)
    arguments = parser.parse_args()
    atoms = learn_mocap(arguments.folder)
    tests = {}
    for subject in SUBJECTS:
        shapes = read_shapes([arguments.folder / f"subject{subject}_24fps.h5"])
        chosen = np.arange(0, len(shapes), arguments.step)
        tests[subject] = (turntable_views(shapes)[chosen], shapes.take(chosen))

    print("| solver | lambda | subject 13 | subject 14 | active atoms | mean relative gap |")
    print("|---|--:|--:|--:|--:|--:|")
    runs = [("ADMM, change 1e-2", 0.1, partial(solve_admm, stop="change", tolerance=1e-2))]
    runs += [("ADMM, change 1e-3", 0.1, partial(solve_admm, stop="change", tolerance=1e-3))]
    runs += [
        ("optimum, gap 1e-6", lam, partial(solve_newton, tolerance=1e-6))
        for lam in (0.2, 0.1, 0.05, 0.02, 0.01, 0.005, 0.002)
    ]
    for name, lam, solve in runs:
        errors, active, gaps = [], [], []
        for views, truth in tests.values():
            solution: Solution = solve(build_problem(views, atoms, lam))
            found = reconstruct(solution.transforms, atoms)
            errors.append(sequence_mean(found.shapes, truth))
            active.append(found.active_atoms.mean())
            gaps.append(solution.relative_gap.mean())
        print(
            f"| {name} | {lam:g} | {errors[0]:.4f} | {errors[1]:.4f} "
            f"| {np.mean(active):.1f} | {np.mean(gaps):.1e} |",
            flush=True,
        )


def sequence_mean(estimate: Floats, truth: ShapeSet) -> float:
    """Mean over sequences of the mean normalised similarity error."""
    errors = similarity(estimate, truth.shapes) / truth_scale(estimate, truth.shapes)
    names = np.array(truth.sequences)
    return float(np.mean([errors[names == name].mean() for name in np.unique(names)]))


if __name__ == "__main__":
    main()

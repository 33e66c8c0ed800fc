"""Solve a convex program as often as asked: a line on standard input each time, a line
of JSON out.

Usage: python -P benchmarks/worker.py INPUT.npz It runs in the environment that is
measured, this version's or an older one's, so it knows only what all measured versions
of shapefit share. The first line comes after a run that warms up. Seconds are those of
the processor, on one thread.
"""

from __future__ import annotations

import json
import sys
import time

import numpy as np

from shapefit.convex.problem import build_problem
from shapefit.convex.solver import solve_newton

TOLERANCE = 1e-4


def main() -> None:
    """Solve the program of the file given once for each line of standard input, and
    print what that took as JSON.
    """
    data = np.load(sys.argv[1])
    problem = build_problem(data["landmarks"], data["atoms"], float(data["lam"]))
    solve_newton(problem, tolerance=TOLERANCE, threads=1)
    print("ready", flush=True)
    for _ in sys.stdin:
        began = time.process_time()
        found = solve_newton(problem, tolerance=TOLERANCE, threads=1)
        seconds = time.process_time() - began
        well = float(np.mean([status.name == "OPTIMAL" for status in found.status]))
        total = float(np.nansum(found.objective))
        print(json.dumps({"seconds": seconds, "well": well, "sum": total}), flush=True)


if __name__ == "__main__":
    main()

"""Run one job as often as asked: a line on standard input each time, a line of JSON in return.

Usage: python -P benchmarks/worker.py JOB INPUT.npz key=value...
The option `clock` is one of CLOCKS. It runs in the environment that is measured, this version's or
an older one's, so it knows only what all measured versions of shapefit share. The first line comes
after a run that warms up.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

Arrays = Mapping[str, Any]
Verdict = dict[str, float]  # share of the images that ended well, and a sum to compare
Run = Callable[[], Callable[[], Verdict]]  # what is timed, and what looks at it afterwards


def newton(data: Arrays, tolerance: float, threads: float) -> Run:
    """Solve the convex program; each image must be certified."""
    from shapefit.convex.solver import solve_newton

    problem = build(data)

    def run() -> Callable[[], Verdict]:
        found = solve_newton(problem, tolerance=tolerance, threads=int(threads))
        return partial(verdict, found.status, found.objective)

    return run


def lift(data: Arrays, method: str, threads: float) -> Run:
    """Lift by one of the methods, from the convex program or the mean shape on."""
    from shapefit.convex.solver import solve_newton
    from shapefit.lifting.methods import Settings, choose_method

    solve = partial(solve_newton, tolerance=1e-4, threads=int(threads))
    settings = Settings(solve=solve, mean_shape=data["mean_shape"], threads=int(threads))
    estimate, problem = choose_method(method, settings), build(data)

    def run() -> Callable[[], Verdict]:
        found = estimate(problem)
        return partial(verdict, found.status, found.objective)

    return run


def posterior(data: Arrays, misfit: float, threads: float) -> Run:
    """Find the posterior of each image under a prior of many components."""
    from shapefit.convex.solver import solve_newton
    from shapefit.dictionary.mixture import Mixture
    from shapefit.lifting.methods import PosteriorOptions, Settings, choose_method

    solve = partial(solve_newton, tolerance=1e-3, threads=int(threads))
    settings = Settings(
        solve=solve,
        mean_shape=data["mean_shape"],
        needs={"prior": Mixture(data["weights"], data["means"], data["covariances"])},
        options=PosteriorOptions(misfit=misfit),
        threads=int(threads),
    )
    estimate, problem = choose_method("posterior", settings), build(data)

    def run() -> Callable[[], Verdict]:
        found = estimate(problem)
        return partial(verdict, found.status, found.objective)

    return run


def perspective(data: Arrays, threads: float) -> Run:
    """Refine under the full projection of known cameras."""
    from shapefit.geometry.pinhole import Camera
    from shapefit.lifting.perspective.view import PerspectiveOptions, refine_perspective

    camera = Camera(data["focal"], data["centre"], float(data["sign"]))
    options = PerspectiveOptions(ridge=0.3, softness=0.1, max_rounds=200, threads=int(threads))
    problem = build(data)
    rest = camera, data["rotation"], data["prior"], options

    def run() -> Callable[[], Verdict]:
        found = refine_perspective(problem.landmarks, problem.weights, problem.atoms, *rest)
        return partial(verdict, found.status, found.objective)

    return run


def ransac(data: Arrays, threads: float) -> Run:
    """Find the landmarks that agree with a pose of the mean shape."""
    from shapefit.lifting.consensus import find_consensus

    landmarks, shape = data["landmarks"], data["mean_shape"]
    weights = np.isfinite(landmarks).all(axis=1).astype(float)
    seeds = np.arange(len(landmarks), dtype=np.uint64)
    settings: dict[str, Any] = {
        "threshold": 0.25,
        "draws": 500,
        "max_rounds": 100,
        "threads": int(threads),
    }

    def run() -> Callable[[], Verdict]:
        inliers = find_consensus(landmarks, weights, shape, seeds, **settings)
        return lambda: {"well": float(inliers.any(axis=1).mean()), "sum": float(inliers.sum())}

    return run


def learn(data: Arrays, k: float) -> Run:
    """Learn a dictionary; all cores, as learn-dict does."""
    from shapefit.dictionary.learning import learn as rounds

    def run() -> Callable[[], Verdict]:
        *_, learned = rounds(data["shapes"], int(k), 0.1, iterations=15)
        return lambda: {"well": 1.0, "sum": float(np.abs(learned.atoms).sum())}

    return run


def build(data: Arrays) -> Any:
    """Build the problem; the solvers share its type."""
    from shapefit.convex.problem import build_problem

    return build_problem(data["landmarks"], data["atoms"], float(data["lam"]))


def verdict(status: Sequence[Any], objective: Any) -> Verdict:
    """Share of the images solved or converged, and the sum of the objectives."""
    well = [one.name in ("OPTIMAL", "CONVERGED") for one in status]
    return {"well": float(np.mean(well)), "sum": float(np.nansum(objective))}


JOBS: dict[str, Callable[..., Run]] = {
    "newton": newton,
    "lift": lift,
    "posterior": posterior,
    "perspective": perspective,
    "ransac": ransac,
    "learn": learn,
}


CLOCKS = {"processor": time.process_time, "wall": time.perf_counter}
"""Time of the processor, or that of the clock where threads are compared."""


def number_or_name(text: str) -> float | str:
    """Read the value of an option."""
    try:
        return float(text)
    except ValueError:
        return text


def main() -> None:
    """Answer until standard input ends."""
    job, path, *options = sys.argv[1:]
    told = {
        key: number_or_name(value) for key, _, value in (text.partition("=") for text in options)
    }
    clock = CLOCKS[str(told.pop("clock", "processor"))]
    run = JOBS[job](dict(np.load(path)), **told)
    run()
    print("ready", flush=True)
    for _ in sys.stdin:
        began = clock()
        found = run()
        seconds = clock() - began
        print(json.dumps({"seconds": seconds, **found()}), flush=True)


if __name__ == "__main__":
    main()

"""Run one job as often as asked: a line on standard input each time, a line of JSON in return.

Usage: python -P benchmarks/worker.py JOB INPUT.npz key=value...
It runs in the environment that is measured, this version's or
an older one's, so it knows only what all measured versions of shapefit share. The first line comes
after a run that warms up.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np

Arrays = Mapping[str, Any]
Run = Callable[[], Any]
"""What is timed; what it returns is looked at afterwards."""


def solver(tolerance: float) -> Any:
    """Return the solver of the convex program."""
    from shapefit.convex.solver import solve_newton

    return partial(solve_newton, tolerance=tolerance, threads=1)


def newton(data: Arrays, tolerance: float) -> Run:
    """Solve the convex program; each image must be certified."""
    return partial(solver(tolerance), build(data))


def lift(data: Arrays, method: str, tolerance: float = 1e-4, **further: Any) -> Run:
    """Lift by one of the methods, from the convex program or the mean shape on."""
    from shapefit.lifting.methods import Settings, choose_method

    settings = Settings(
        solve=solver(tolerance), mean_shape=data["mean_shape"], threads=1, **further
    )  # fmt: skip
    return partial(choose_method(method, settings), build(data))


def posterior(data: Arrays, residual_variance: float) -> Run:
    """Find the posterior of each image under a prior of many components."""
    from shapefit.dictionary.mixture import Mixture
    from shapefit.lifting.methods import PosteriorOptions

    needs = {"prior": Mixture(data["weights"], data["means"], data["covariances"])}
    renamed = hasattr(PosteriorOptions, "residual_variance")  # since 051afd75
    name = "residual_variance" if renamed else "misfit"
    options: Any = partial(PosteriorOptions, **{name: residual_variance})()  # type: ignore[arg-type]
    return lift(data, "posterior", 1e-3, needs=needs, options=options)


def perspective(data: Arrays) -> Run:
    """Refine under the full projection of known cameras."""
    from shapefit.geometry.pinhole import Camera
    from shapefit.lifting.perspective import PerspectiveOptions, refine_perspective

    problem = build(data)
    return partial(
        refine_perspective, problem.landmarks, problem.weights, problem.atoms,
        Camera(data["focal"], data["centre"], float(data["sign"])), data["rotation"],
        data["prior"],
        PerspectiveOptions(ridge=0.3, softness=0.1, max_rounds=200, threads=1),
    )  # fmt: skip


def ransac(data: Arrays) -> Run:
    """Find the landmarks that agree with a pose of the mean shape."""
    from shapefit.lifting.consensus import find_consensus

    landmarks = data["landmarks"]
    weights = np.isfinite(landmarks).all(axis=1).astype(float)
    return partial(
        find_consensus, landmarks, weights, data["mean_shape"],
        np.arange(len(landmarks), dtype=np.uint64),
        threshold=0.25, draws=500, max_rounds=100, threads=1,
    )  # fmt: skip


def build(data: Arrays) -> Any:
    """Build the problem; the solvers share its type."""
    from shapefit.convex.problem import build_problem

    return build_problem(data["landmarks"], data["atoms"], float(data["lam"]))


def verdict(found: Any) -> dict[str, float]:
    """Share of the images solved, converged or with inliers, and a sum to compare."""
    if isinstance(found, np.ndarray):
        well = found.any(axis=1) if found.dtype == bool else [True]
        return {"well": float(np.mean(well)), "sum": float(np.abs(found).sum())}
    well = [one.name in ("OPTIMAL", "CONVERGED") for one in found.status]
    return {"well": float(np.mean(well)), "sum": float(np.nansum(found.objective))}


JOBS: dict[str, Callable[..., Run]] = {
    job.__name__: job for job in (newton, lift, posterior, perspective, ransac)
}


def number_or_name(text: str) -> float | str:
    """Read the value of an option."""
    try:
        return float(text)
    except ValueError:
        return text


def main() -> None:
    """Answer until standard input ends."""
    job, path, *options = sys.argv[1:]
    pairs = (text.partition("=") for text in options)
    given = {key: number_or_name(value) for key, _, value in pairs}
    run = JOBS[job](dict(np.load(path)), **given)
    run()
    print("ready", flush=True)
    for _ in sys.stdin:
        began = time.process_time()
        found = run()
        seconds = time.process_time() - began
        print(json.dumps({"seconds": seconds, **verdict(found)}), flush=True)


if __name__ == "__main__":
    main()

"""Images a second of the fast solver against the paper's ADMM and Clarabel, in one run.

Usage: python -m benchmarks.solver [--quick] [--data FOLDER] [--cars FOLDER].
Prints a Markdown table. Every row runs in a process of its own, so that its peak memory is its own.
"""

from __future__ import annotations

import argparse
import platform
import resource
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import TypeVar

import numpy as np

from benchmarks.cases import LAMBDA, Case, cars_case, hide, made_case, mocap_case
from shapefit.convex.admm import solve_admm
from shapefit.convex.newton import solve_newton
from shapefit.convex.problem import build_problem
from shapefit.convex.solution import Solution, Status

REPEATS = 5
Result = TypeVar("Result")


@dataclass(frozen=True)
class Row:
    """Median images a second, largest relative gap reached, share optimal, peak MB."""

    case: str
    solver: str
    images: int
    rate: float
    gap: float
    optimal: float
    memory: float


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="fewer and smaller cases")
    parser.add_argument("--data", type=Path, help="folder with the motion capture files")
    parser.add_argument("--cars", type=Path, help="folder with the files of annotated cars")
    arguments = parser.parse_args()
    print(f"{platform.processor() or platform.machine()}, {platform.python_version()}\n")
    print("| case | solver | images | images/s | largest gap | optimal | peak MB | first is |")
    print("|---|---|--:|--:|--:|--:|--:|--:|")
    for build in list(cases(arguments)):
        best = 0.0
        for measure in measures(arguments.quick):
            row = alone(partial(measure, build))
            best = best or row.rate
            print(
                f"| {row.case} | {row.solver} | {row.images} | {row.rate:,.0f} | {row.gap:.1e} "
                f"| {row.optimal:.1%} | {row.memory:.0f} | {best / row.rate:,.1f}x |",
                flush=True,
            )


def cases(arguments: argparse.Namespace) -> Iterator[Callable[[], Case]]:
    """Yield the builders of all cases."""
    if arguments.data:
        yield partial(mocap_case, arguments.data)
        yield partial(hidden, partial(mocap_case, arguments.data))
        yield partial(mocap_case, arguments.data, 128)
    if arguments.cars:
        yield partial(cars_case, arguments.cars)
    for k in (32, 64) if arguments.quick else (32, 64, 128, 256):
        for p in (15,) if arguments.quick else (15, 33, 66):
            made = partial(made_case, 500 if arguments.quick else 2000, k, p)
            yield made
            yield partial(hidden, made)


def hidden(build: Callable[[], Case]) -> Case:
    """Hide 30% of the landmarks of a case."""
    return hide(build(), 0.3)


def measures(quick: bool) -> Iterator[Callable[[Callable[[], Case]], Row]]:
    """Yield what is measured on each case; the first is what the others are compared with."""
    yield partial(measure_newton, threads=2, tolerance=1e-4)
    yield partial(measure_newton, threads=1, tolerance=1e-4)
    yield partial(measure_newton, threads=2, tolerance=1e-6)
    yield partial(measure_admm, images=100 if quick else 400)
    yield partial(measure_clarabel, images=3 if quick else 10)


def alone(measure: Callable[[], Row]) -> Row:
    """Run in a fresh process."""
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        return pool.submit(measure).result()


def measure_newton(build: Callable[[], Case], threads: int, tolerance: float) -> Row:
    """Time the fast solver, warm, on all images."""
    case = build()
    problem = build_problem(case.landmarks, case.atoms, LAMBDA)
    solve = partial(solve_newton, tolerance=tolerance, threads=threads)
    solve(problem)
    solution, seconds = timed(lambda: solve(problem))
    return row(case, f"newton {tolerance:g}, {threads} threads", len(case.landmarks), seconds,
               float(solution.relative_gap.max()), optimal(solution))  # fmt: skip


def measure_admm(build: Callable[[], Case], images: int) -> Row:
    """Time the paper's ADMM in NumPy on evenly chosen images."""
    case = build()
    chosen = np.linspace(0, len(case.landmarks) - 1, images).round().astype(int)
    problem = build_problem(case.landmarks[chosen], case.atoms, LAMBDA)
    solution, seconds = timed(lambda: solve_admm(problem, tolerance=1e-4), repeats=1)
    return row(case, "ADMM (NumPy, batch) 1e-4", images, seconds,
               float(solution.relative_gap.max()), optimal(solution))  # fmt: skip


def measure_clarabel(build: Callable[[], Case], images: int) -> Row:
    """Time cvxpy with Clarabel, the problem compiled once, on a few images."""
    import cvxpy as cp

    case = build()
    k, _, p = case.atoms.shape
    chosen = np.linspace(0, len(case.landmarks) - 1, images).round().astype(int)
    M = [cp.Variable((2, 3)) for _ in range(k)]
    T, W, omega = cp.Variable((2, 1)), cp.Parameter((2, p)), cp.Parameter((2, p))
    fitted = sum(m @ b for m, b in zip(M, case.atoms, strict=True)) + T @ np.ones((1, p))
    loss = 0.5 * cp.sum_squares(W - cp.multiply(omega, fitted))
    problem = cp.Problem(cp.Minimize(loss + LAMBDA * sum(cp.sigma_max(m) for m in M)))

    def solve(image: int) -> float:
        seen = np.isfinite(case.landmarks[image])
        omega.value = seen.astype(float)
        W.value = np.where(seen, case.landmarks[image], 0.0)
        return float(problem.solve(solver=cp.CLARABEL))

    solve(chosen[0])
    _, seconds = timed(lambda: [solve(image) for image in chosen], repeats=1)
    return row(case, "cvxpy + Clarabel 1e-8", images, seconds, np.nan, 1.0)


def optimal(solution: Solution) -> float:
    """Share of the images solved to the tolerance."""
    return float(np.mean([status is Status.OPTIMAL for status in solution.status]))


def timed(work: Callable[[], Result], repeats: int = REPEATS) -> tuple[Result, float]:
    """Result and median seconds of repeated runs."""
    seconds = []
    for _ in range(repeats):
        began = time.perf_counter()
        result = work()
        seconds.append(time.perf_counter() - began)
    return result, float(np.median(seconds))


def row(case: Case, solver: str, images: int, seconds: float, gap: float, optimal: float) -> Row:
    """Add up a row."""
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return Row(case.name, solver, images, images / seconds, gap, optimal, memory)


if __name__ == "__main__":
    main()

"""Images a second of other solvers of the same program: the paper's ADMM, and Clarabel."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.comparing import Row
from benchmarks.kernels import LAMBDA, Case, cars_case, made_case, mocap_case
from shapefit.convex.problem import build_problem
from shapefit.convex.solver import Status, solve_newton
from tests.convex.admm import solve_admm


def peer_cases(
    folder: Path | None, cars: Path | None, quick: bool
) -> Iterator[tuple[str, Callable[[], Row]]]:
    """The fast solver on all cores against each peer."""
    cases: dict[str, Callable[[], Case]] = {"made, k=64, p=15": partial(made_case, 2000, 64, 15)}
    if folder:
        cases["subject 13"] = partial(mocap_case, folder)
    if cars:
        cases["cars"] = partial(cars_case, cars)
    for name, build in cases.items():
        admm, clarabel = f"ADMM in NumPy, {name}", f"Clarabel, {name}"
        yield admm, partial(beside_admm, admm, build, 100 if quick else 400)
        yield clarabel, partial(beside_clarabel, clarabel, build, 3 if quick else 10)


def beside_admm(name: str, build: Callable[[], Case], images: int) -> Row:
    """Compare with the paper's ADMM at a gap of 1e-4."""
    case = build()
    rate, reached = admm_rate(case, images)
    now = newton_rate(case)
    return Row(name, f"{rate:,.0f}/s ({reached:.0%} reach 1e-4)", f"{now:,.0f}/s", now / rate)


def beside_clarabel(name: str, build: Callable[[], Case], images: int) -> Row:
    """Compare with cvxpy and Clarabel, at their gap of 1e-8."""
    case = build()
    rate, now = clarabel_rate(case, images), newton_rate(case)
    return Row(name, f"{rate:,.0f}/s", f"{now:,.0f}/s", now / rate)


def newton_rate(case: Case) -> float:
    """Time the fast solver on all images and cores: median of five runs after a warm-up."""
    problem = build_problem(case.landmarks, case.atoms, LAMBDA)
    solve_newton(problem)
    seconds = []
    for _ in range(5):
        began = time.perf_counter()
        solve_newton(problem)
        seconds.append(time.perf_counter() - began)
    return len(case.landmarks) / float(np.median(seconds))


def admm_rate(case: Case, images: int) -> tuple[float, float]:
    """Time the paper's ADMM in NumPy on evenly chosen images; with the share that reached 1e-4."""
    problem = build_problem(case.landmarks[evenly(case, images)], case.atoms, LAMBDA)
    began = time.perf_counter()
    solution = solve_admm(problem, tolerance=1e-4)
    seconds = time.perf_counter() - began
    return images / seconds, float(np.mean([s is Status.OPTIMAL for s in solution.status]))


def clarabel_rate(case: Case, images: int) -> float:
    """Time cvxpy with Clarabel, the program compiled once, to a gap of 1e-8 on a few images."""
    import cvxpy as cp

    k, _, p = case.atoms.shape
    M = [cp.Variable((2, 3)) for _ in range(k)]
    T, W, omega = cp.Variable((2, 1)), cp.Parameter((2, p)), cp.Parameter((2, p))
    fitted = sum(m @ b for m, b in zip(M, case.atoms, strict=True)) + T @ np.ones((1, p))
    loss = 0.5 * cp.sum_squares(W - cp.multiply(omega, fitted))
    problem = cp.Problem(cp.Minimize(loss + LAMBDA * sum(cp.sigma_max(m) for m in M)))

    def solve(image: int) -> None:
        seen = np.isfinite(case.landmarks[image])
        omega.value = seen.astype(float)
        W.value = np.where(seen, case.landmarks[image], 0.0)
        problem.solve(solver=cp.CLARABEL)

    chosen = evenly(case, images).tolist()
    solve(chosen[0])
    began = time.perf_counter()
    for image in chosen:
        solve(image)
    return images / (time.perf_counter() - began)


def evenly(case: Case, images: int) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    """Choose images at even distances."""
    return np.linspace(0, len(case.landmarks) - 1, images).round().astype(np.int64)

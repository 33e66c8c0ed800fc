"""Solve a convex program by what a reader of the paper has without this project: the
paper's ADMM in NumPy, or CVXPY with Clarabel.

    min  1/2 ||W - sum_i M_i B_i||_F^2 + lambda sum_i ||M_i||_2

Usage: python -P benchmarks/peers.py INPUT.npz admm|clarabel
Asked and answered like worker.py, once for each line of standard input. ADMM stops
after so many iterations as the image needs to a relative gap of TOLERANCE; how many is
found beforehand, by the optimum in the input, and is not timed.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

TOLERANCE = 1e-4
"""Relative gap, that of worker.py."""

MU = 0.05
"""The step size of ADMM. Of 0.01 to 1 in steps of two or three it is the fastest on
motion capture.
"""

MAX_ITERATIONS = 5000

Array = np.ndarray[Any, np.dtype[np.float64]]

Solve = Callable[[], float]
"""Solves one image and returns its objective."""


def main() -> None:
    """Solve the program of the file given once for each line of standard input, and
    print what that took as JSON.
    """
    data = np.load(sys.argv[1])
    peer = sys.argv[2]
    make = {"admm": admm_solvers, "clarabel": clarabel_solvers}[peer]
    optimum = data["optimum"]
    solvers = make(data["landmarks"], data["atoms"], float(data["lam"]), optimum)
    solvers[0]()
    print("ready", flush=True)
    for _ in sys.stdin:
        began = time.process_time()
        objective = np.array([solve() for solve in solvers])
        seconds = time.process_time() - began
        well = float(np.mean(objective <= (1 + 2 * TOLERANCE) * optimum))
        total = float(objective.sum())
        print(json.dumps({"seconds": seconds, "well": well, "sum": total}), flush=True)


def admm_solvers(W: Array, B: Array, lam: float, optimum: Array) -> list[Solve]:
    """Return a function for each image that solves it by ADMM (paper, section 3.3)."""
    B = np.concatenate(B)  # (3 k, p)
    inverse = inverse_of_gram(B)
    solvers: list[Solve] = []
    for w, best in zip(W, optimum, strict=True):
        enough = (1 + TOLERANCE) * best
        iterations = count_iterations(w, B, lam, inverse, enough)
        solvers.append(partial(run_admm, w, B, lam, inverse, iterations))
    return solvers


def inverse_of_gram(B: Array) -> Array:
    """Return (B B^T + mu I)^-1 (3k, 3k), by which each iteration multiplies."""
    return np.asarray(np.linalg.inv(B @ B.T + MU * np.eye(len(B))), np.float64)


def count_iterations(
    W: Array, B: Array, lam: float, inverse: Array, enough: float
) -> int:
    """Return how many iterations ADMM takes to an objective that is low enough.

    It is looked at after each doubling, then in between.
    """
    last = 1
    while last < MAX_ITERATIONS and run_admm(W, B, lam, inverse, last) > enough:
        last *= 2
    first = last // 2
    while last - first > 1:
        middle = (first + last) // 2
        if run_admm(W, B, lam, inverse, middle) > enough:
            first = middle
        else:
            last = middle
    return last


def run_admm(W: Array, B: Array, lam: float, inverse: Array, iterations: int) -> float:
    """Return the objective after so many iterations of ADMM from zero.

    W (2, p), B (3k, p); inverse, (B B^T + mu I)^-1 (3k, 3k).
    """
    WB = W @ B.T
    M = Z = Y = np.zeros_like(WB)
    for _ in range(iterations):
        M = shrink_transforms(Z - Y / MU, lam / MU)
        Z = (WB + MU * M + Y) @ inverse
        Y = Y + MU * (M - Z)
    norms = np.linalg.norm(as_blocks(M), ord=2, axis=(1, 2))
    residual = W - M @ B
    return float((residual**2).sum() / 2 + lam * norms.sum())


def shrink_transforms(Q: Array, size: float) -> Array:
    """Return the proximal operator of size ||.||_2 at each block (2, 3) of Q (2, 3k).

    Singular values become min(s, theta), where s - min(s, theta) sum to `size`, or 0.
    """
    U, s, V = np.linalg.svd(as_blocks(Q), full_matrices=False)
    theta = np.maximum((s.sum(axis=1) - size) / 2, s[:, 0] - size)
    s = np.minimum(s, np.maximum(theta, 0.0)[:, None])
    blocks = (U * s[:, None]) @ V
    return np.asarray(blocks.transpose(1, 0, 2).reshape(2, -1))


def as_blocks(M: Array) -> Array:
    """Return the blocks M_i (k, 2, 3) of M (2, 3k)."""
    return M.reshape(2, -1, 3).transpose(1, 0, 2)


def clarabel_solvers(W: Array, B: Array, lam: float, _: Array) -> list[Solve]:
    """Return a function for each image that solves it by CVXPY with Clarabel.

    The program is compiled once, with the image as its parameter.
    """
    import cvxpy as cp

    w = cp.Parameter(W.shape[1:])
    M = [cp.Variable((2, 3)) for _ in B]
    residual = w - cp.hstack(M) @ np.concatenate(B)
    norms = cp.hstack([cp.sigma_max(block) for block in M])
    objective = cp.sum_squares(residual) / 2 + lam * cp.sum(norms)
    program = cp.Problem(cp.Minimize(objective))
    names = "tol_gap_rel", "tol_gap_abs", "tol_feas"
    # objectives are then within TOLERANCE of the optimum
    tolerances = dict.fromkeys(names, TOLERANCE / 10)

    def solve(image: Array) -> float:
        w.value = image
        program.solve(solver="CLARABEL", **tolerances)
        return float(program.value)

    return [partial(solve, image) for image in W]


if __name__ == "__main__":
    main()

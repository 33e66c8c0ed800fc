"""Exact recovery: plant transforms or one rotation, solve, and count how often they
come back.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial

import numpy as np

from shapefit.arrays import Floats
from shapefit.convex.problem import Loss, build_problem
from shapefit.convex.solver import Solution, solve_newton
from shapefit.evaluation.report import markdown_table
from shapefit.geometry.rotations import random_rotations

ATOMS = 50
ACTIVE = tuple(range(1, 11))
LANDMARKS = tuple(range(5, 51, 5))
TRIALS = 100
SUCCESS = 1e-3
"""Relative error of the transforms below which they are recovered exactly."""

Shares = Mapping[tuple[int, int], float]
"""(p, z) -> share of the trials with p landmarks and z active atoms that are recovered.
"""


@dataclass(frozen=True)
class Planted:
    """An instance whose transforms are known: landmarks W (2, p) = sum_i M_i B_i, atoms
    B (k, 3, p), M_i = c_i R_i[:2].

    rotations R (k, 3, 3); coefficients c (k,).
    """

    landmarks: Floats
    atoms: Floats
    rotations: Floats
    coefficients: Floats

    @property
    def transforms(self) -> Floats:
        """Return the transforms M (k, 2, 3)."""
        M: Floats = self.coefficients[:, None, None] * self.rotations[:, :2]
        return M


def random_stream(p: int, z: int, trial: int) -> np.random.Generator:
    """Return the generator of the random numbers of a trial with p landmarks and z
    active atoms, which depend on nothing else.
    """
    return np.random.default_rng(np.random.SeedSequence(0, spawn_key=(p, z, trial)))


def plant(k: int, p: int, z: int, rng: np.random.Generator) -> Planted:
    """Draw a random instance of p landmarks and k atoms, z of them active (paper,
    section Simulation).

    Entries of B_i are N(0, 1), rotations uniform, z coefficients at random places U(0,
    1) and the others 0.
    """
    B = rng.standard_normal((k, 3, p))
    R = random_rotations(k, rng)
    c = np.zeros(k)
    c[rng.choice(k, z, replace=False)] = rng.uniform(size=z)
    W = np.einsum("iab,ibp->ap", c[:, None, None] * R[:, :2], B)
    return Planted(W, B, R, c)


def recover(planted: Planted) -> Solution:
    """Solve min sum_i ||M_i||_2 s.t. W = sum_i M_i B_i + T 1^T for the landmarks and
    atoms of an instance (paper, eq. finalnoiseless).

    T is free, which is the same as centring the rows of W and of all B_i. One thread.
    """
    problem = build_problem(planted.landmarks, planted.atoms, lam=1.0, loss=Loss.EXACT)
    return solve_newton(problem, tolerance=1e-6, max_iterations=10000, threads=1)


def transform_error(planted: Planted, found: Solution) -> float:
    """||M_found - M||_F / ||M||_F of the transforms of a solution and an instance."""
    M = planted.transforms
    return float(np.linalg.norm(found.transforms.dense()[0] - M) / np.linalg.norm(M))


def shares_of_transforms(
    landmarks: Sequence[int] = LANDMARKS,
    active: Sequence[int] = ACTIVE,
    trials: int = TRIALS,
) -> Shares:
    """Return (landmarks p, active atoms z) -> share of random instances whose
    transforms are recovered exactly.
    """

    def succeeds(p: int, z: int, trial: int) -> bool:
        planted = plant(ATOMS, p, z, random_stream(p, z, trial))
        return transform_error(planted, recover(planted)) < SUCCESS

    # Every trial has atoms of its own and so is a problem of its own; the kernels
    # release the GIL.
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        return {
            (p, z): sum(pool.map(partial(succeeds, p, z), range(trials))) / trials
            for p in landmarks
            for z in active
        }


def shares_table(shares: Shares, style: str = ".2f") -> str:
    """Return shares as a table in Markdown, landmarks p down and active atoms z
    across.
    """
    down, across = (sorted(set(numbers)) for numbers in zip(*shares, strict=True))
    rows = [[str(p), *(format(shares[p, z], style) for z in across)] for p in down]
    return markdown_table(["p \\ z", *map(str, across)], rows)


def recovery_page(shares: Shares, paper: Shares, trials: int, source: str) -> str:
    """Return a page in Markdown: the shares of exact recoveries, the paper's, and the
    differences.
    """
    parts = [
        "# Exact recovery",
        (
            "min sum ||M_i||_2 subject to W = sum M_i B_i + T 1^T (the paper's program"
            f" on centred data), with {ATOMS} atoms. Share of {trials} random instances"
            " per cell whose transforms are recovered with a relative error below"
            f" {SUCCESS:g}. Rows: p landmarks; columns: z atoms in use."
        ),
        shares_table(shares),
    ]
    differences = {at: shares[at] - paper[at] for at in shares if at in paper}
    if differences:
        (p, z), most = max(differences.items(), key=lambda item: abs(item[1]))
        parts += [
            "## Published",
            source,
            shares_table({at: paper[at] for at in differences}),
            "## Ours minus published",
            f"The largest deviation is {most:+.2f}, at p = {p} and z = {z}.",
            shares_table(differences, "+.2f"),
        ]
    return "\n\n".join(parts) + "\n"

"""Exact recovery: plant transforms or one rotation, solve, and count how often they come back."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from shapefit.arrays import Floats
from shapefit.convex.problem import Loss, build_problem
from shapefit.convex.solver import Solution, Status, solve_newton
from shapefit.evaluation.report import markdown_table
from shapefit.geometry.rotations import random_rotations, rotation_angle
from shapefit.lifting.methods import Settings, choose_method

ATOMS = 50
ACTIVE = tuple(range(1, 11))
LANDMARKS = tuple(range(5, 51, 5))
TRIALS = 100
SUCCESS = 1e-3
"""Relative error of the transforms below which they are recovered exactly."""

Shares = Mapping[tuple[int, int], float]
"""(p, z) -> share of the trials with p landmarks and z active atoms that are recovered."""


@dataclass(frozen=True)
class Planted:
    """W (2, p) = sum_i M_i B_i without noise, atoms B (k, 3, p), M_i = c_i R_i[:2] (k, 2, 3).

    rotations R (k, 3, 3); coefficients c (k,).
    """

    landmarks: Floats
    atoms: Floats
    rotations: Floats
    coefficients: Floats

    @property
    def transforms(self) -> Floats:
        """M (k, 2, 3)."""
        M: Floats = self.coefficients[:, None, None] * self.rotations[:, :2]
        return M

    @property
    def shape(self) -> Floats:
        """S = sum_i c_i R_i B_i (3, p)."""
        S: Floats = np.einsum("i,iab,ibp->ap", self.coefficients, self.rotations, self.atoms)
        return S


def random_stream(p: int, z: int, trial: int) -> np.random.Generator:
    """Return the random numbers of a trial: they depend neither on other cells nor on threads."""
    return np.random.default_rng(np.random.SeedSequence(0, spawn_key=(p, z, trial)))


def plant(
    k: int, p: int, z: int, rng: np.random.Generator, *, one_rotation: bool = False
) -> Planted:
    """Draw an instance with k atoms, z of them active (paper, section Simulation).

    Entries of B_i are N(0, 1), rotations uniform (with `one_rotation` the same for all atoms), z
    coefficients at random places U(0, 1) and the others 0.
    """
    B = rng.standard_normal((k, 3, p))
    R = np.broadcast_to(random_rotations(1 if one_rotation else k, rng), (k, 3, 3))
    c = np.zeros(k)
    c[rng.choice(k, z, replace=False)] = rng.uniform(size=z)
    W = np.einsum("iab,ibp->ap", c[:, None, None] * R[:, :2], B)
    return Planted(W, B, R, c)


def recover(
    planted: Planted, *, free_translation: bool = True, tolerance: float = 1e-6
) -> Solution:
    """Solve min sum_i ||M_i||_2 s.t. W = sum_i M_i B_i + T 1^T (paper, eq. finalnoiseless).

    T is free, which is the same as centring the rows of W and of all B_i, or 0: then each atom has
    one more landmark at the origin, seen at the origin, whose constraint is 0 = 0 + T. One thread.
    """
    W, B = planted.landmarks, planted.atoms
    if not free_translation:
        W = np.hstack([W, np.zeros((2, 1))])
        B = np.concatenate([B, np.zeros((len(B), 3, 1))], axis=2)
    problem = build_problem(W, B, lam=1.0, loss=Loss.EXACT)
    return solve_newton(problem, tolerance=tolerance, max_iterations=10000, threads=1)


def transform_error(planted: Planted, found: Solution) -> float:
    """||M_found - M||_F / ||M||_F."""
    M = planted.transforms
    return float(np.linalg.norm(found.transforms.dense()[0] - M) / np.linalg.norm(M))


def shares_of_transforms(
    landmarks: Sequence[int] = LANDMARKS, active: Sequence[int] = ACTIVE, trials: int = TRIALS
) -> Shares:
    """Return the share of each cell whose transforms are recovered exactly."""

    def succeeds(p: int, z: int, trial: int) -> bool:
        planted = plant(ATOMS, p, z, random_stream(p, z, trial))
        return transform_error(planted, recover(planted)) < SUCCESS

    # Every trial has atoms of its own and so is a problem of its own; the kernels release the GIL.
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        return {
            (p, z): sum(pool.map(partial(succeeds, p, z), range(trials))) / trials
            for p in landmarks
            for z in active
        }


def shares_table(shares: Shares, style: str = ".2f") -> str:
    """Return numbers of cells as a table, p down and z across."""
    down, across = (sorted(set(numbers)) for numbers in zip(*shares, strict=True))
    rows = [[str(p), *(format(shares[p, z], style) for z in across)] for p in down]
    return markdown_table(["p \\ z", *map(str, across)], rows)


def recovery_page(shares: Shares, paper: Shares, trials: int, source: str) -> str:
    """Return the shares, the paper's beside them, and the differences, as Markdown."""
    parts = [
        "# Exact recovery",
        "min sum ||M_i||_2 subject to W = sum M_i B_i + T 1^T (the paper's program on centred "
        f"data), with {ATOMS} atoms. Share of {trials} random instances per cell whose transforms "
        f"are recovered with a relative error below {SUCCESS:g}. Rows: p landmarks; columns: z "
        "atoms in use.",
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


METHODS = ("global", "convex+refine", "alternate", "convex")
ROTATION_LANDMARKS = (5, 10, 15, 20, 30, 40)
ROTATION_TRIALS = 50
LAMBDA = 1e-3
"""So small that its bias stays far below what counts as recovered."""

DEGREES, ERROR = 1.0, 1e-2
"""Recovered: within DEGREES of the planted rotation, and relative error of the shape below ERROR.

Of the shape in the frame of the camera, both centred.
"""


@dataclass(frozen=True)
class RotationCell:
    """What happened in the trials with p landmarks, z active atoms and one rotation for all.

    recovered, share by method; certified, share of trials that global solves to 1%; missed, number
    that global does not recover: better of them with an objective below the planted one's, and
    stopped of them above it, where the search reached its limit.
    """

    p: int
    z: int
    trials: int
    recovered: dict[str, float]
    certified: float
    missed: int
    better: int
    stopped: int


def run_rotation_cell(p: int, z: int, trials: int, k: int = ATOMS) -> RotationCell:
    """Plant S = R sum_i c_i B_i and lift its exact landmarks by each method, so many times."""
    recovered = np.zeros((trials, len(METHODS)), dtype=bool)
    certified = missed = better = stopped = 0
    for trial in range(trials):
        planted = plant(k, p, z, random_stream(p, z, trial), one_rotation=True)
        problem = build_problem(planted.landmarks[None], planted.atoms, LAMBDA)
        settings = Settings(
            solve=partial(solve_newton, tolerance=1e-6, threads=1),
            mean_shape=planted.atoms.mean(axis=0),
            threads=1,
        )
        for column, name in enumerate(METHODS):
            found = choose_method(name, settings)(problem)
            recovered[trial, column] = is_recovered(planted, found.shapes[0], found.rotation[0])
            if name != "global":
                continue
            optimal = found.status[0] is Status.OPTIMAL
            certified += optimal
            if not recovered[trial, column]:
                missed += 1
                below = bool(found.objective[0] < LAMBDA * planted.coefficients.sum())
                better += below
                stopped += not below and not optimal
    shares = dict(zip(METHODS, recovered.mean(axis=0).tolist(), strict=True))
    return RotationCell(p, z, trials, shares, certified / trials, missed, better, stopped)


def is_recovered(planted: Planted, shape: Floats, rotation: Floats) -> bool:
    """Whether a shape (3, p), wherever it stands, and its rotation are the planted ones."""
    S = planted.shape
    truth = S - S.mean(axis=1, keepdims=True)
    found = shape - shape.mean(axis=1, keepdims=True)
    error = np.linalg.norm(found - truth) / np.linalg.norm(truth)
    return bool(error < ERROR and rotation_angle(rotation, planted.rotations[0]) < DEGREES)


def write_rotation_recovery(path: Path, trials: int = ROTATION_TRIALS) -> None:
    """Run the grid of planted rotations and write its cells as JSON."""
    cells = [asdict(run_rotation_cell(p, z, trials)) for p in ROTATION_LANDMARKS for z in ACTIVE]
    path.write_text(json.dumps(cells, indent=2) + "\n", encoding="utf-8")


def rotation_sections(path: Path) -> list[str]:
    """Return the section on planted rotations; nothing where they were not run."""
    if not path.exists():
        return []
    cells: list[dict[str, Any]] = json.loads(path.read_text(encoding="utf-8"))
    trials = sum(cell["trials"] for cell in cells)
    certified = sum(cell["certified"] * cell["trials"] for cell in cells) / trials
    missed, better, stopped = (sum(c[n] for c in cells) for n in ("missed", "better", "stopped"))
    shares = {(cell["p"], cell["z"]): cell["recovered"] for cell in cells}
    across = sorted({z for _, z in shares})
    rows = [
        [f"{p}, `{name}`", *(f"{100 * shares[p, z][name]:.0f}" for z in across)]
        for p in sorted({p for p, _ in shares})
        for name in METHODS
    ]
    return [
        "### Recovery of one planted rotation",
        f"Percentage of {cells[0]['trials']} trials per cell in which the rotation is within "
        f"{DEGREES:g} degree of the planted one and the relative error of the shape below "
        f"{ERROR:g}; z of {ATOMS} atoms are active, landmarks are exact.",
        markdown_table(["p, method \\ z", *map(str, across)], rows),
        f"`global` certified {certified:.1%} of {trials:,} trials. It missed the planted shape in "
        f"{missed:,}: in {better:,} its objective is below the planted one's, in {stopped:,} the "
        "search reached its limit first.",
    ]

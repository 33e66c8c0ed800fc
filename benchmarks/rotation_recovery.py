"""How often a planted rotation is recovered, against the number of active atoms, by each method.

`python -m benchmarks.rotation_recovery FOLDER` plants shapes S = R sum_i c_i B_i with one rotation
for all atoms, lifts their exact landmarks, and writes FOLDER/rotation-recovery.json. Atoms and
coefficients are those of `simulate`; lambda is so small that its bias stays far below what counts
as recovered.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from shapefit.arrays import Floats
from shapefit.convex.newton import solve_newton
from shapefit.convex.problem import build_problem
from shapefit.convex.solution import Status
from shapefit.evaluation.report import markdown_table
from shapefit.geometry.rotations import random_rotations, rotation_angle
from shapefit.io.whole.atomic import atomic_path
from shapefit.lifting.methods import Settings, choose_method

METHODS = ("global", "convex+refine", "alternate", "convex")
ATOMS = 50
LANDMARKS = (5, 10, 15, 20, 30, 40)
ACTIVE = tuple(range(1, 11))
TRIALS = 50
LAMBDA = 1e-3
DEGREES = 1.0
ERROR = 1e-2
"""Recovered: within DEGREES of the planted rotation, and relative error of the shape below ERROR.

Of the shape in the frame of the camera, both centred.
"""


@dataclass(frozen=True)
class Planted:
    """S = R sum_i c_i B_i (3, p) without noise, atoms B (k, 3, p), the rotation R, ||c||_1."""

    shape: Floats
    atoms: Floats
    rotation: Floats
    size: float


@dataclass(frozen=True)
class Cell:
    """What happened in the trials with p landmarks and z active atoms.

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


def plant(k: int, p: int, z: int, rng: np.random.Generator) -> Planted:
    """Return a shape of z among k atoms: entries of B_i N(0, 1), R uniform, c_i > 0 U(0, 1)."""
    B = rng.standard_normal((k, 3, p))
    R = random_rotations(1, rng)[0]
    c = np.zeros(k)
    c[rng.choice(k, z, replace=False)] = rng.uniform(size=z)
    return Planted(R @ np.tensordot(c, B, 1), B, R, float(c.sum()))


def run_cell(p: int, z: int, trials: int, k: int = ATOMS, seed: int = 0) -> Cell:
    """Plant and lift so many shapes; their random numbers depend on cell and trial only."""
    recovered = np.zeros((trials, len(METHODS)), dtype=bool)
    certified = missed = better = stopped = 0
    for trial in range(trials):
        stream = np.random.SeedSequence(seed, spawn_key=(p, z, trial))
        planted = plant(k, p, z, np.random.default_rng(stream))
        problem = build_problem(planted.shape[None, :2], planted.atoms, LAMBDA)
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
                below = bool(found.objective[0] < LAMBDA * planted.size)
                better += below
                stopped += not below and not optimal
    shares = dict(zip(METHODS, recovered.mean(axis=0).tolist(), strict=True))
    return Cell(p, z, trials, shares, certified / trials, missed, better, stopped)


def is_recovered(planted: Planted, shape: Floats, rotation: Floats) -> bool:
    """Whether a shape (3, p), wherever it stands, and its rotation are the planted ones."""
    truth = planted.shape - planted.shape.mean(axis=1, keepdims=True)
    found = shape - shape.mean(axis=1, keepdims=True)
    error = np.linalg.norm(found - truth) / np.linalg.norm(truth)
    return bool(error < ERROR and rotation_angle(rotation, planted.rotation) < DEGREES)


def table(cells: Sequence[Mapping[str, Any]]) -> str:
    """Return the shares in percent: a row for each number of landmarks and method, z across."""
    across = sorted({cell["z"] for cell in cells})
    at = {(cell["p"], cell["z"]): cell["recovered"] for cell in cells}
    rows = [
        [f"{p}, `{name}`", *(f"{100 * at[p, z][name]:.0f}" for z in across)]
        for p in sorted({cell["p"] for cell in cells})
        for name in METHODS
    ]
    return markdown_table(["p, method \\ z", *map(str, across)], rows)


def sections(folder: Path) -> list[str]:
    """Return the section of the index of `make paper`; nothing where this was not run."""
    path = folder / "rotation-recovery.json"
    if not path.exists():
        return []
    cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
    trials = sum(cell["trials"] for cell in cells)
    certified = sum(cell["certified"] * cell["trials"] for cell in cells) / trials
    total = {name: sum(cell[name] for cell in cells) for name in ("missed", "better", "stopped")}
    return [
        "### Recovery of one planted rotation",
        f"Percentage of {cells[0]['trials']} trials per cell in which the rotation is within "
        f"{DEGREES:g} degree of the planted one and the relative error of the shape below "
        f"{ERROR:g}; z of {ATOMS} atoms are active, landmarks are exact.",
        table(cells),
        f"`global` certified {certified:.1%} of {trials:,} trials. It missed the planted shape in "
        f"{total['missed']:,}: in {total['better']:,} its objective is below the planted one's, in "
        f"{total['stopped']:,} the search reached its limit first.",
    ]


def main() -> None:
    """Run the grid, write the numbers and print the section."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--trials", type=int, default=TRIALS)
    options = parser.parse_args()
    cells = [asdict(run_cell(p, z, options.trials)) for p in LANDMARKS for z in ACTIVE]
    document = {"atoms": ATOMS, "lambda": LAMBDA, "degrees": DEGREES, "error": ERROR}
    with atomic_path(options.folder / "rotation-recovery.json") as path:
        path.write_text(json.dumps({**document, "cells": cells}, indent=2) + "\n", encoding="utf-8")
    print("\n\n".join(sections(options.folder)))


if __name__ == "__main__":
    main()

"""Objectives at a gap of 1e-10 against those of the solver that this one replaced.

objectives.json holds what commit 0fff6c6, before the compiled core, reached. To make it
anew, run `python -m tests.convex.test_objectives FOLDER` with that version installed.
"""

import json
import sys
from collections.abc import Iterator
from pathlib import Path

import h5py
import numpy as np
import pytest

from shapefit.convex.problem import Loss, Problem, build_problem
from shapefit.convex.solver import solve_newton
from shapefit.geometry.cameras import project, turntable
from shapefit.geometry.normalisation import normalise

STORED = Path(__file__).with_name("objectives.json")
TOLERANCE, AGREEMENT = 1e-10, 1e-9
REACHED = "optimal"


def real_views(folder: Path, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Turntable views of subject 13 and 64 training shapes of unit norm as atoms."""

    def shapes(name: str, count: int) -> np.ndarray:
        with h5py.File(folder / "mocap" / name) as file:
            whole = file["shapes"]
            at = np.linspace(0, len(whole) - 1, count).astype(int)
            return normalise(whole[at].transpose(0, 2, 1).astype(float)).points

    atoms = shapes("subject86_24fps.h5", 64)
    atoms /= np.linalg.norm(atoms, axis=(1, 2), keepdims=True)
    people = shapes("subject13_24fps.h5", count)
    return normalise(project(people, turntable(np.linspace(0, 20, count), "y"))).points, atoms


def real_problems(folder: Path) -> Iterator[tuple[str, Problem]]:
    """All losses, lambda from 1e-6 to 1, landmarks hidden and weighted."""
    landmarks, atoms = real_views(folder, 96)
    rng = np.random.default_rng(5)
    weights = rng.uniform(0.2, 1.0, (96, 15)) * (rng.random((96, 15)) > 0.3)
    weights[:, :3] = 1.0
    for loss in Loss:
        yield f"views, {loss.value}", build_problem(landmarks, atoms, 0.1, loss=loss)
        yield (
            f"weighted views, {loss.value}",
            build_problem(landmarks, atoms, 0.1, weights=weights, loss=loss),
        )
    for lam in (1e-6, 1e-3, 1.0):
        yield f"views, lambda {lam:g}", build_problem(landmarks[::4], atoms, lam)


def made_problems() -> Iterator[tuple[str, Problem]]:
    """Hard cases: weights over six orders, a tiny lambda, duplicates, 256 landmarks with l1."""

    def made(n: int, k: int, p: int) -> tuple[np.ndarray, np.ndarray, np.random.Generator]:
        rng = np.random.default_rng(7)
        atoms = rng.standard_normal((k, 3, p))
        atoms -= atoms.mean(axis=2, keepdims=True)
        mixed = rng.standard_normal((n, 4, 2, 3))
        landmarks = np.einsum("nkab,kbp->nap", mixed, atoms[:4])
        return landmarks + 0.3 * rng.standard_normal(landmarks.shape), atoms, rng

    for loss in (Loss.SQUARED, Loss.ABSOLUTE, Loss.SPARSE_ERROR):
        landmarks, atoms, rng = made(16, 16, 12)
        weights = 10 ** rng.uniform(-3, 3, (16, 12))
        name = loss.value
        yield (
            f"six orders, {name}",
            build_problem(landmarks, atoms, 0.1, weights=weights, loss=loss),
        )
        yield f"lambda 1e-6, {name}", build_problem(landmarks, atoms, 1e-6, loss=loss)
        again = np.concatenate([landmarks, landmarks[..., :4]], axis=2)
        atoms_again = np.concatenate([atoms, atoms[..., :4]], axis=2)
        yield f"duplicated landmarks, {name}", build_problem(again, atoms_again, 0.1, loss=loss)
    landmarks, atoms, rng = made(2, 20, 256)
    gross = landmarks + 5 * (rng.random((2, 1, 256)) < 0.3)
    yield "256 landmarks, l1", build_problem(gross, atoms, 0.1, loss=Loss.ABSOLUTE)
    landmarks, atoms, _ = made(16, 16, 12)
    exact = (
        landmarks
        - landmarks
        + np.einsum(
            "nkab,kbp->nap", np.random.default_rng(8).standard_normal((16, 3, 2, 3)), atoms[:3]
        )
    )
    yield "exact", build_problem(exact, atoms, 1.0, loss=Loss.EXACT)


def compare(name: str, problem: Problem) -> None:
    stored = json.loads(STORED.read_text(encoding="utf-8"))[name]
    found = solve_newton(problem, tolerance=TOLERANCE)
    reached = np.array([status.value == REACHED for status in found.status])
    before = np.array([status == REACHED for status in stored["status"]])
    assert (reached | ~before).all(), f"{name}: images that were solved before are not"
    np.testing.assert_allclose(
        found.objective[before], np.array(stored["objective"])[before], rtol=AGREEMENT
    )


@pytest.mark.parametrize("name", [name for name, _ in made_problems()])
def test_made_problems_have_the_same_optimum_as_before(name: str) -> None:
    compare(name, dict(made_problems())[name])


@pytest.mark.real_data
def test_real_problems_have_the_same_optimum_as_before(real_data: Path) -> None:
    for name, problem in real_problems(real_data):
        compare(name, problem)


def write(folder: Path) -> None:
    """Solve all problems with the version that is installed, and store what it reaches."""
    stored = {}
    for name, problem in [*real_problems(folder), *made_problems()]:
        found = solve_newton(problem, tolerance=TOLERANCE)
        status = [status.value for status in found.status]
        stored[name] = {"objective": found.objective.tolist(), "status": status}
    STORED.write_text(json.dumps(stored, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    write(Path(sys.argv[1]))

"""Draw the cells of docs/global.md: python docs/cells_picture.py.

One made image: the rotations exp(x e_1 + y e_2) R about the optimum R, in a plane of turns that
contains it, and the cells of a proof to 1% that they lie in.
"""

from __future__ import annotations

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from shapefit import core
from shapefit.convex.problem import Problem, build_problem
from shapefit.geometry.normalisation import normalise
from shapefit.geometry.rotations import rotation_about
from shapefit.io import read_shapes
from shapefit.lifting.global_optimum.optimum import find_optimum
from shapefit.lifting.global_optimum.tree import record_tree
from shapefit.verification.tree import Tree, unfold

PROJECT = Path(__file__).resolve().parents[1]
REACH, STEPS = 100, 260  # degrees to each side, points

Floats = NDArray[np.float64]


def main() -> None:
    """Draw v and the cells side by side."""
    problem = made_problem()
    best = find_optimum(problem, tolerance=1e-3)
    bound = 0.99 * best.objective[0]
    tree = record_tree(problem, 0, bound)
    assert tree is not None
    leaves = unfold(Tree(tree.splits, tree.vertices, tree.multipliers))
    assert leaves is not None
    q = tree.vertices[leaves]
    corners = q * np.sign(np.einsum("le,lae->la", q[:, 0], q))[..., None]
    turns = np.linspace(-REACH, REACH, STEPS)
    x, y = np.meshgrid(turns, turns)
    about = Rotation.from_rotvec(np.stack([x, y, 0 * x], axis=-1).reshape(-1, 3), degrees=True)
    turned = about * Rotation.from_matrix(best.rotation[0])
    R = turned.as_matrix()
    cell = find_cells(turned.as_quat(scalar_first=True), corners).reshape(x.shape)
    value = objectives(problem, R).reshape(x.shape) / best.objective[0]

    figure, axes = plt.subplots(1, 2, figsize=(9.2, 4.4), layout="constrained", sharey=True)
    levels = [1, 1.1, 1.3, 1.6, 2, 3, 4, 6, 8, 12]
    drawn = axes[0].contourf(x, y, np.minimum(value, 11.9), levels, cmap="viridis_r")
    figure.colorbar(drawn, ax=axes[0], label="objective / optimum")
    sizes = np.array([np.rad2deg(size) for size in diameters(corners)])
    shown = axes[1].pcolormesh(x, y, sizes[cell], cmap="viridis_r", vmin=0, shading="nearest")
    edges = (np.diff(cell, axis=0)[:, 1:] != 0) | (np.diff(cell, axis=1)[1:] != 0)
    axes[1].contour(x[1:, 1:], y[1:, 1:], edges, [0.5], colors="white", linewidths=0.4)
    figure.colorbar(shown, ax=axes[1], label="longest edge of the cell, degrees")
    for one, title in zip(axes, ("objective", f"{len(leaves)} cells prove 1%"), strict=True):
        one.plot(0, 0, "r+", markersize=9)
        one.set(title=title, xlabel="turn about x, degrees", aspect="equal")
    axes[0].set_ylabel("turn about y, degrees")
    figure.savefig(PROJECT / "docs/images/cells.png", dpi=80)


def made_problem() -> Problem:
    """Return one view of the sample data, with every tenth training shape as an atom."""
    atoms = read_shapes([PROJECT / "sample_data/people_train.h5"]).shapes[::10]
    truth = read_shapes([PROJECT / "sample_data/people_test.h5"]).shapes[40:41]
    view = rotation_about(np.array([0.3, 1.0, 0.0]), np.array([0.7]))
    return build_problem(normalise((view @ truth)[:, :2]).points, normalise(atoms).points, 0.1)


def find_cells(q: Floats, corners: Floats) -> NDArray[np.intp]:
    """Return the cell (m,) of cells (l, 4, 4) that holds each quaternion (m, 4)."""
    inverse = np.linalg.inv(corners.swapaxes(1, 2)).reshape(-1, 4).T
    found = np.zeros(len(q), np.intp)
    for start in range(0, len(q), 1024):
        mu = (q[start : start + 1024] @ inverse).reshape(-1, len(corners), 4)
        least = np.maximum(mu.min(axis=2), -mu.max(axis=2))
        found[start : start + 1024] = least.argmax(axis=1)
    return found


def objectives(problem: Problem, R: Floats) -> Floats:
    """v (m,) of the one image at rotations (m, 3, 3)."""
    many = problem.take(np.zeros(len(R), np.intp))
    value = np.zeros(len(R))
    core.find_coefficients(
        landmarks=many.landmarks,
        weights=many.weights,
        atoms=many.atoms,
        lam=many.lam,
        rotation=R,
        coefficients=np.zeros((len(R), len(problem.atoms))),
        objective=value,
        threads=0,
    )
    return value


def diameters(corners: Floats) -> Floats:
    """Longest edges (l,) of cells (l, 4, 4), in radians of rotation."""
    inner = np.einsum("lae,lbe->lab", corners, corners)
    longest: Floats = 2 * np.arccos(np.clip(inner.min(axis=(1, 2)), -1, 1))
    return longest


if __name__ == "__main__":
    main()

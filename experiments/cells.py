"""Draw the cells of docs/global.md: the objective about its optimum, and the proof.

One made image: the rotations exp(x e_1 + y e_2) R about the optimum R, in a plane of
turns that contains it, and the cells of a proof to 1% that they lie in.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial.transform import Rotation

from shapefit.arrays import Floats, Indices
from shapefit.convex.problem import Problem, build_problem
from shapefit.geometry.normalisation import normalise
from shapefit.geometry.rotations import rotation_about
from shapefit.io import read_shapes
from shapefit.lifting.global_optimum import DroppedCells, find_optimum

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PROJECT = Path(__file__).resolve().parents[1]

REACH = 100
"""Degrees to each side of the optimum."""

OBJECTIVE_STEPS = 100
"""Points along a side at which the objective is computed."""

CELL_STEPS = 260
"""Points along a side whose cell is found."""

ATOM_STEP = 30
"""Every so many-th training shape is an atom."""

LAM = 0.1

GAP = 0.01
"""Of the proof."""

MAX_CELLS = 20_000
"""Cells of the proof that are kept."""

ROUNDS = 150
"""Of the proximal gradient, after which the picture no longer changes."""

ROTATIONS_AT_ONCE = 500

LEVELS = (1, 1.1, 1.3, 1.6, 2, 3, 4, 6, 8, 12)
"""Of the objective over its optimum."""


def draw_cells() -> Figure:
    """Draw two maps of rotations about the optimum: the objective, and the cells of the
    proof.
    """
    from matplotlib.figure import Figure

    problem = _made_problem()
    dropped = DroppedCells.allocate(1, MAX_CELLS)
    best = find_optimum(problem, tolerance=GAP, dropped=dropped)
    corners = dropped.corners[0, : dropped.number[0]]
    signs = np.sign(np.einsum("le,lae->la", corners[:, 0], corners))
    corners = corners * signs[..., None]
    x, y, around = _rotations_about(best.rotation[0], OBJECTIVE_STEPS)
    objective = _objectives(problem, around.as_matrix()).reshape(x.shape)
    value = objective / best.objective[0]

    figure = Figure(figsize=(9.2, 4.2), layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True)
    drawn = left.contourf(x, y, np.minimum(value, 11.9), LEVELS, cmap="viridis_r")
    figure.colorbar(drawn, ax=left, label="objective / optimum")
    sizes = np.rad2deg(_diameters(corners))
    x, y, around = _rotations_about(best.rotation[0], CELL_STEPS)
    quaternions = around.as_quat(scalar_first=True)
    cell = _find_cells(quaternions, corners).reshape(x.shape)
    shown = right.pcolormesh(
        x, y, sizes[cell], cmap="viridis_r", vmin=0, shading="nearest"
    )
    edges = (np.diff(cell, axis=0)[:, 1:] != 0) | (np.diff(cell, axis=1)[1:] != 0)
    right.contour(x[1:, 1:], y[1:, 1:], edges, [0.5], colors="white", linewidths=0.4)
    figure.colorbar(shown, ax=right, label="longest edge of the cell, degrees")
    titles = ("objective", f"{len(corners):,} cells prove {GAP:.0%}")
    for axes, title in zip((left, right), titles, strict=True):
        axes.plot(0, 0, "r+", markersize=9)
        axes.set(title=title, xlabel="turn about x, degrees", aspect="equal")
    left.set_ylabel("turn about y, degrees")
    return figure


def _rotations_about(optimum: Floats, steps: int) -> tuple[Floats, Floats, Rotation]:
    """Return a grid of turns x, y (steps, steps) in degrees, and the optimum turned by
    each of them.
    """
    turns = np.linspace(-REACH, REACH, steps)
    x, y = np.meshgrid(turns, turns)
    vectors = np.stack([x, y, np.zeros_like(x)], axis=-1).reshape(-1, 3)
    about = Rotation.from_rotvec(vectors, degrees=True)
    return x, y, about * Rotation.from_matrix(optimum)


def _made_problem() -> Problem:
    """Return the problem of one view of the sample data, with training shapes as
    atoms.
    """
    train = read_shapes([PROJECT / "sample_data/people_train.h5"]).as_columns()
    test = read_shapes([PROJECT / "sample_data/people_test.h5"]).as_columns()
    view = rotation_about(np.array([0.3, 1.0, 0.0]), np.array([0.7]))
    landmarks = normalise((view @ test[40:41])[:, :2]).points
    return build_problem(landmarks, normalise(train[::ATOM_STEP]).points, LAM)


def _find_cells(quaternions: Floats, corners: Floats) -> Indices:
    """Return the indices (m,) of the cells that hold the quaternions (m, 4), by the
    corners of the cells (l, 4, 4).
    """
    inverse = np.linalg.inv(corners.swapaxes(1, 2)).reshape(-1, 4).T
    found = np.zeros(len(quaternions), np.intp)
    for start in range(0, len(quaternions), ROTATIONS_AT_ONCE):
        rows = slice(start, start + ROTATIONS_AT_ONCE)
        shares = (quaternions[rows] @ inverse).reshape(-1, len(corners), 4)
        least = np.maximum(shares.min(axis=2), -shares.max(axis=2))
        found[rows] = least.argmax(axis=1)
    return found


def _objectives(problem: Problem, rotations: Floats) -> Floats:
    """Return the least objective (m,) of the one image at rotations (m, 3, 3).

    min over c >= 0 of 1/2 ||W - Rbar sum_i c_i B_i||_F^2 + lambda sum c, by the
    proximal gradient with momentum; W and B are centred.
    """
    w = problem.landmarks[0] - problem.landmarks[0].mean(axis=1, keepdims=True)
    atoms = problem.atoms - problem.atoms.mean(axis=2, keepdims=True)
    values = []
    for start in range(0, len(rotations), ROTATIONS_AT_ONCE):
        R = rotations[start : start + ROTATIONS_AT_ONCE, None, :2]
        A = (R @ atoms).reshape(len(R), len(atoms), -1)
        transposed = np.ascontiguousarray(A.swapaxes(1, 2))
        step = 1 / np.linalg.norm(A, ord=2, axis=(1, 2))[:, None, None] ** 2
        c = np.zeros((len(R), len(atoms), 1))
        ahead = c
        momentum = 1.0
        for _ in range(ROUNDS):
            gradient = A @ (transposed @ ahead - w.reshape(-1, 1)) + LAM
            last, c = c, np.maximum(ahead - step * gradient, 0.0)
            following = (1 + np.sqrt(1 + 4 * momentum**2)) / 2
            ahead = c + (momentum - 1) / following * (c - last)
            momentum = following
        residual = transposed @ c - w.reshape(-1, 1)
        values.append(0.5 * (residual**2).sum(axis=(1, 2)) + LAM * c.sum(axis=(1, 2)))
    return np.concatenate(values)


def _diameters(corners: Floats) -> Floats:
    """Return the length (l,) of the longest edge of each cell, by its corners (l, 4,
    4), in radians of rotation.
    """
    inner = np.einsum("lae,lbe->lab", corners, corners)
    longest: Floats = 2 * np.arccos(np.clip(inner.min(axis=(1, 2)), -1, 1))
    return longest

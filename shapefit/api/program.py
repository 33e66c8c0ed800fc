"""The convex program alone, on arrays, with its certificate."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from shapefit.api.arguments import with_suggestions
from shapefit.arrays import Floats
from shapefit.convex.problem import Loss, build_problem
from shapefit.convex.solver import Status, solve_newton
from shapefit.errors import counted


@dataclass(frozen=True, eq=False, repr=False)
class Optimum:
    """The optimum of the convex program; without the axis n for a single image.

    Attributes
    ----------
    transforms : array of shape (n, k, 2, 3)
        M, most of them 0.
    translation : array of shape (n, 2)
        T.
    dual : array of shape (n, 2, p)
        Y: with sum_j omega_j Y_j = 0 and ||(Omega o Y) B_i^T||_* <= lambda, its value
        <W, Omega o Y> - 1/2 ||Y||^2 (squared loss) is a lower bound.
    objective : array of shape (n,)
        Of M and T.
    relative_gap : array of shape (n,)
        How far the objective may be above the optimum, as a share of it.
    status : str, or tuple of str
        "optimal", or why not.

    """

    transforms: Floats
    translation: Floats
    dual: Floats
    objective: Floats
    relative_gap: Floats
    status: str | tuple[str, ...]

    def __repr__(self) -> str:
        images = self.transforms.reshape(-1, *self.transforms.shape[-3:])
        used = int(images.any(axis=(2, 3)).sum(axis=1).max(initial=0))
        words = (self.status,) if isinstance(self.status, str) else self.status
        optimal = words.count(Status.OPTIMAL.value)
        state = "optimal" if optimal == len(words) else f"{optimal} optimal"
        gap = np.max(self.relative_gap, initial=0.0)
        atoms = f"at most {used} of {counted(images.shape[1], 'atom')}"
        parts = [counted(len(images), "image"), atoms, state, f"gap {gap:.1e}"]
        return f"<shapefit.Optimum: {', '.join(parts)}>"


@with_suggestions
def solve(
    landmarks: ArrayLike,
    atoms: ArrayLike,
    lam: float,
    *,
    weights: ArrayLike | None = None,
    loss: Literal["squared", "exact", "l1", "sparse-error"] = "squared",
    beta: float = 0.1,
    tolerance: float = 1e-6,
    max_iterations: int = 1000,
    threads: int = 0,
) -> Optimum:
    """Solve the convex program of images, and return its optimum with a certificate.

    It is min_{M,T} f(Omega o (W - sum_i M_i B_i - T 1^T)) + lambda sum_i ||M_i||_2.
    Nothing is normalised or centred, as `fit` does. The method:
    shapefit/core/convex/newton.hpp.

    Parameters
    ----------
    landmarks : array of shape (2, p) or (n, 2, p)
        W of one image or of several, NaN where unseen.
    atoms : array of shape (k, 3, p)
        B.
    lam : float
        lambda, the weight of the sum of spectral norms.
    weights : array of shape (p,) or (n, p)
        Omega >= 0; 0 is hidden.
    loss : str
        f.
    beta : float
        Weight of the sparse error.
    tolerance : float
        Relative gap of a solved image.
    max_iterations : int
        Steps of the solver.
    threads : int
        Threads to solve with; 0 is one per core.

    Returns
    -------
    Optimum

    Raises
    ------
    ValueError
        On what does not fit together.

    """
    W = np.asarray(landmarks, np.float64)
    B = np.asarray(atoms, np.float64)
    omega = None if weights is None else np.asarray(weights, np.float64)
    problem = build_problem(W, B, lam, weights=omega, loss=Loss(loss), beta=beta)
    solution = solve_newton(
        problem, tolerance=tolerance, max_iterations=max_iterations, threads=threads
    )
    only = 0 if W.ndim == 2 else slice(None)
    status = tuple(code.value for code in solution.status)
    return Optimum(
        solution.transforms.dense()[only],
        solution.translation[only],
        solution.dual[only],
        solution.objective[only],
        solution.relative_gap[only],
        status[0] if W.ndim == 2 else status,
    )

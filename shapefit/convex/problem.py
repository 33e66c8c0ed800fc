"""Data of the convex program, and the losses it can carry."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats

if TYPE_CHECKING:
    from shapefit.geometry.pinhole import Camera


class Loss(Enum):
    """Data term f(Omega o (W - sum M_i B_i - T 1^T)) of the program.

    SQUARED        1/2 ||r||_F^2                                 (paper, eq. finalnoisy)
    EXACT          0 where r = 0, infinite elsewhere             (paper, eq.
                   finalnoiseless)
    ABSOLUTE       ||r||_1                                       (paper, Discussion)
    SPARSE_ERROR   min_E 1/2 ||r - E||_F^2 + beta ||E||_1        (Huber's function of r)
    """

    SQUARED = "squared"
    EXACT = "exact"
    ABSOLUTE = "l1"
    SPARSE_ERROR = "sparse-error"

    @property
    def has_quadratic(self) -> bool:
        """Return whether the conjugate of the loss holds the term 1/2 ||Y||_F^2."""
        return self in (Loss.SQUARED, Loss.SPARSE_ERROR)


@dataclass(frozen=True)
class Problem:
    """min_{M,T} f(Omega o (W - sum_i M_i B_i - T 1^T)) + lambda sum_i ||M_i||_2 for n
    images.

    landmarks W (n, 2, p), weights Omega (n, p) >= 0 with 0 = hidden (what W holds there
    is irrelevant), atoms B (k, 3, p) shared by all images, lam (n,) > 0, loss f, and
    beta > 0, the weight of ||E||_1 where the loss is SPARSE_ERROR. noise (n, p, 2, 2),
    the covariance of each landmark's measurement, and camera, that of the images in the
    unit of W, are no part of the program: methods that start from its solution may use
    them where they are known. Raises ValueError on shapes or values that do not fit.
    """

    landmarks: Floats
    weights: Floats
    atoms: Floats
    lam: Floats
    loss: Loss = Loss.SQUARED
    beta: float = 0.1
    noise: Floats | None = None
    camera: Camera | None = None

    def __post_init__(self) -> None:
        for name in ("landmarks", "weights", "atoms", "lam"):
            # one memory layout, the one that kernels read
            values = np.require(getattr(self, name), np.float64, ("C", "W"))
            object.__setattr__(self, name, values)
        W, omega, B, lam = self.landmarks, self.weights, self.atoms, self.lam
        n, two, p = W.shape
        k, three, q = B.shape
        if two != 2 or three != 3 or p != q or k == 0:
            raise ValueError(
                f"landmarks {W.shape} and atoms {B.shape} must be (n, 2, p), (k, 3, p)"
            )
        if omega.shape != (n, p) or lam.shape != (n,):
            raise ValueError(
                f"weights {omega.shape}, lam {lam.shape} must be ({n}, {p}), ({n},)"
            )
        for holds, rule in (
            (
                np.isfinite(omega).all() and (omega >= 0).all(),
                "weights must be finite and >= 0",
            ),
            (np.isfinite(lam).all() and (lam > 0).all(), "lam must be finite and > 0"),
            (np.isfinite(B).all(), "atoms must be finite"),
            (self.beta > 0, "beta must be > 0"),
        ):
            if not holds:
                raise ValueError(rule)

    def take(self, images: NDArray[np.intp] | NDArray[np.bool_]) -> Problem:
        """Keep some of the images."""
        rows = np.arange(len(self.landmarks))[images]
        return replace(
            self,
            landmarks=self.landmarks[images],
            weights=self.weights[images],
            lam=self.lam[images],
            noise=None if self.noise is None else self.noise[images],
            camera=None if self.camera is None else self.camera.take(rows),
        )

    @property
    def arrays(self) -> dict[str, Any]:
        """What every kernel needs of it, by the names of its arguments."""
        names = ("landmarks", "weights", "atoms", "lam")
        return {name: getattr(self, name) for name in names}

    def require_squared(self, method: str) -> None:
        """Raise ValueError, which names the method, unless the loss is the squared
        one.
        """
        if self.loss is not Loss.SQUARED:
            raise ValueError(
                f"{method} knows the squared loss only, not {self.loss.value}"
            )

    @property
    def bound(self) -> float:
        """Bound on the entries of the dual Y: beta, 1 or none, by the loss."""
        return {Loss.SPARSE_ERROR: self.beta, Loss.ABSOLUTE: 1.0}.get(self.loss, np.inf)


def build_problem(
    landmarks: Floats,
    atoms: Floats,
    lam: Floats | float,
    *,
    weights: Floats | None = None,
    loss: Loss = Loss.SQUARED,
    beta: float = 0.1,
) -> Problem:
    """Problem with defaults filled in: one lambda for all, weight 1 where W is finite,
    else 0.

    landmarks (n, 2, p) or (2, p) for a single image; hidden landmarks may be nan. Under
    the EXACT loss a weight says only whether a landmark is seen: all positive weights
    become 1.
    """
    W = landmarks if landmarks.ndim == 3 else landmarks[None]
    visible = np.all(np.isfinite(W), axis=1)
    omega = np.broadcast_to(
        visible.astype(float) if weights is None else weights, visible.shape
    )
    if loss is Loss.EXACT:
        omega = np.where(omega > 0, 1.0, omega)
    if not visible[omega > 0].all():
        raise ValueError("landmarks of positive weight must be finite")
    W = np.where((omega > 0)[:, None, :], W, 0.0)
    return Problem(W, omega, atoms, np.broadcast_to(lam, (len(W),)), loss, beta)

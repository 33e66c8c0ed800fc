"""Data of the convex program, and the losses it can carry."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum
from typing import TYPE_CHECKING, TypedDict

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Flags, Floats, Integers
from shapefit.core import IMAGES_PER_BLOCK

if TYPE_CHECKING:
    from shapefit.geometry.pinhole import Camera


class Loss(Enum):
    """How the program measures residuals: f(r), r = Omega o (W - sum M_i B_i - T 1^T).

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


class ProblemArrays(TypedDict):
    """What every kernel needs of a problem, by the names of its arguments."""

    landmarks: Floats
    weights: Floats
    atoms: Floats
    lam: Floats


@dataclass(frozen=True, eq=False, repr=False)
class Problem:
    """The convex program of n images, one for each.

    min_{M,T} f(Omega o (W - sum_i M_i B_i - T 1^T)) + lambda sum_i ||M_i||_2, landmarks
    W (n, 2, p), weights Omega (n, p) >= 0 with 0 = hidden (what W holds there is
    irrelevant), atoms B (k, 3, p) shared by all images, lam (n,) > 0, loss f, and beta
    > 0, the weight of ||E||_1 where the loss is SPARSE_ERROR. noise (n, p, 2, 2), the
    covariance of each landmark's measurement, and camera, that of the images in the
    unit of W, are no part of the program: methods that start from its solution may use
    them where they are known. group (n,), a number for each image: images start from
    the solutions of others of their group alone; by default they are one group. Raises
    ValueError on shapes or values that do not fit.
    """

    landmarks: Floats
    weights: Floats
    atoms: Floats
    lam: Floats
    loss: Loss = Loss.SQUARED
    beta: float = 0.1
    noise: Floats | None = None
    camera: Camera | None = None
    group: Integers | None = None

    def __post_init__(self) -> None:
        for name in ("landmarks", "weights", "atoms", "lam"):
            # one memory layout, the one that kernels read
            values = np.require(getattr(self, name), np.float64, ("C", "W"))
            object.__setattr__(self, name, values)
        self._check_shapes()
        self._check_values()

    def _check_shapes(self) -> None:
        """Raise ValueError where the shapes of the arrays do not fit each other."""
        n, two, p = self.landmarks.shape
        k, three, q = self.atoms.shape
        if two != 2 or three != 3 or p != q or k == 0:
            raise ValueError(
                f"landmarks {self.landmarks.shape} and atoms {self.atoms.shape} must be"
                " (n, 2, p), (k, 3, p)"
            )
        if self.weights.shape != (n, p) or self.lam.shape != (n,):
            raise ValueError(
                f"weights {self.weights.shape}, lam {self.lam.shape} must be"
                f" ({n}, {p}), ({n},)"
            )

    def _check_values(self) -> None:
        """Raise ValueError for weights, lambdas, atoms or a beta out of range."""
        if not (np.isfinite(self.weights).all() and (self.weights >= 0).all()):
            raise ValueError("weights must be finite and >= 0")
        if not (np.isfinite(self.lam).all() and (self.lam > 0).all()):
            raise ValueError("lam must be finite and > 0")
        if not np.isfinite(self.atoms).all():
            raise ValueError("atoms must be finite")
        if not self.beta > 0:  # a beta that is not a number fails too
            raise ValueError("beta must be > 0")

    def take(self, images: NDArray[np.intp] | NDArray[np.bool_]) -> Problem:
        """Return the problem of the images that indices or a mask select."""
        noise = None
        if self.noise is not None:
            noise = self.noise[images]
        camera = None
        if self.camera is not None:
            camera = self.camera.take(np.arange(len(self.landmarks))[images])
        group = None
        if self.group is not None:
            group = self.group[images]
        return replace(
            self,
            landmarks=self.landmarks[images],
            weights=self.weights[images],
            lam=self.lam[images],
            noise=noise,
            camera=camera,
            group=group,
        )

    @property
    def begins(self) -> Flags:
        """Return which images (n,) begin a block, see `find_blocks`."""
        group = self.group
        if group is None:
            group = np.zeros(len(self.lam), np.int64)
        return find_blocks(group)

    @property
    def arrays(self) -> ProblemArrays:
        """Return the arrays that every kernel needs, by the names of its arguments."""
        return {
            "landmarks": self.landmarks,
            "weights": self.weights,
            "atoms": self.atoms,
            "lam": self.lam,
        }

    def require_squared(self, method: str) -> None:
        """Raise ValueError, which names the method, unless the loss is squared."""
        if self.loss is not Loss.SQUARED:
            raise ValueError(
                f"{method} knows the squared loss only, not {self.loss.value}"
            )

    @property
    def max_dual_entry(self) -> float:
        """Return the largest absolute entry that the loss allows in the dual Y.

        beta for sparse errors, 1 for the absolute loss, and inf for others.
        """
        if self.loss is Loss.SPARSE_ERROR:
            return self.beta
        if self.loss is Loss.ABSOLUTE:
            return 1.0
        return np.inf


def find_blocks(group: Integers) -> Flags:
    """Return which images (n,) begin a block: IMAGES_PER_BLOCK images or fewer of one
    group, one after the other.

    group (n,), a number for each image. Images start from solutions of their block.
    """
    place = np.arange(len(group))
    is_new = np.diff(group, prepend=group[:1] - 1) != 0
    first: Integers = np.maximum.accumulate(np.where(is_new, place, 0))
    begins: Flags = (place - first) % IMAGES_PER_BLOCK == 0
    return begins


def build_problem(
    landmarks: Floats,
    atoms: Floats,
    lam: Floats | float,
    *,
    weights: Floats | None = None,
    loss: Loss = Loss.SQUARED,
    beta: float = 0.1,
    group: Integers | None = None,
) -> Problem:
    """Return the convex program of landmarks and atoms, with defaults filled in.

    landmarks (n, 2, p), or (2, p) of a single image; hidden landmarks may be nan.
    Weights are by default 1 where a landmark is finite, else 0. lam (n,), or one number
    for all images; group, as in `Problem`. Under the EXACT loss a weight says only
    whether a landmark is seen: all positive weights become 1. Raises ValueError where a
    landmark of positive weight is not finite, or shapes or values do not fit.
    """
    W = landmarks if landmarks.ndim == 3 else landmarks[None]
    visible = np.all(np.isfinite(W), axis=1)
    if weights is None:
        weights = visible.astype(float)
    omega = np.broadcast_to(weights, visible.shape)
    if loss is Loss.EXACT:
        omega = np.where(omega > 0, 1.0, omega)
    if not visible[omega > 0].all():
        raise ValueError("landmarks of positive weight must be finite")
    W = np.where((omega > 0)[:, None, :], W, 0.0)
    lam_of_each = np.broadcast_to(lam, (len(W),))
    return Problem(W, omega, atoms, lam_of_each, loss, beta, group=group)

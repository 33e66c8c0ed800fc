"""The model of landmarks without 3D examples: one Gaussian over shapes, seen from unknown views.

    w_nj = s_n P R_n x_nj + t_n + e_nj,    e_nj ~ N(0, sigma^2 / omega_nj^2 I),
    x_n  = mu + V z_n + d_n,               z_n ~ N(0, I),  d_n ~ N(0, rho I),
    log s_n ~ N(log size of the sequence, tau^2),

P takes the first two rows, t is any translation. A landmark is gross with the chance epsilon; then
it falls with the density u per area. Close to the Procrustean normal distribution of
Lee, Cho, Choi and Oh (CVPR 2013) and to the model of Torresani, Hertzmann and Bregler (PAMI 2008).
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Indices = NDArray[np.intp]
Mask = NDArray[np.bool_]
Record = TypeVar("Record", bound=Any)


@dataclass(frozen=True)
class Images:
    """n images: landmarks w (n, 2, p), weights omega (n, p), 0 where hidden, sequence (n,).

    The landmarks of each sequence, numbered from 0, are of comparable size, and lie anywhere where
    they are gross (n, p); None where all are believed.
    """

    landmarks: Floats
    weights: Floats
    sequence: Indices
    gross: Mask | None = None

    def __len__(self) -> int:
        return len(self.landmarks)

    def __getitem__(self, rows: slice | Indices) -> Images:
        gross = None if self.gross is None else self.gross[rows]
        return Images(self.landmarks[rows], self.weights[rows], self.sequence[rows], gross)

    @property
    def seen(self) -> Mask:
        """Landmarks (n, p) that have a weight and are not gross."""
        there = self.weights > 0
        return there if self.gross is None else there & ~self.gross

    def hiding(self, landmarks: Mask) -> Images:
        """Return the images with these landmarks (n, p) hidden, and none that is gross."""
        return Images(self.landmarks, np.where(landmarks, 0.0, self.weights), self.sequence)


@dataclass(frozen=True)
class Views:
    """Rotations R (n, 3, 3) and log s (n,)."""

    rotation: Floats
    log_scale: Floats

    def __getitem__(self, rows: slice | Indices) -> Views:
        return Views(self.rotation[rows], self.log_scale[rows])


@dataclass(frozen=True)
class Gaussian:
    """mean mu (3, p), modes V (3, p, q), rest rho, noise sigma^2; log_size (sequences,), tau^2."""

    mean: Floats
    modes: Floats
    rest: float
    noise: float
    log_size: Floats
    spread: float

    @property
    def covariance(self) -> Floats:
        """V V^T + rho I (3p, 3p), all x first, then y, then z."""
        V = self.modes.reshape(self.mean.size, -1)
        found: Floats = V @ V.T + self.rest * np.eye(len(V))
        return found


def choose(mask: Mask, yes: Record, no: Record) -> Record:
    """Return the record whose rows are those of `yes` where the mask (n,) is True, else of `no`."""

    def rows(name: str) -> Floats:
        one, other = getattr(yes, name), getattr(no, name)
        return np.where(mask.reshape(-1, *(1,) * (one.ndim - 1)), one, other)

    return type(yes)(**{each.name: rows(each.name) for each in fields(yes)})


def evenly(n: int, most: int) -> Indices:
    """Return at most so many indices out of n that lie evenly."""
    return np.unique(np.linspace(0, n - 1, min(n, most)).astype(np.intp))


def hide(seen: Mask) -> Mask:
    """Choose a tenth of the seen landmarks (n, p), at random; enough of an image stays."""
    hidden = seen & (np.random.default_rng(0).random(seen.shape) < 0.1)
    chosen: Mask = hidden & ((seen & ~hidden).sum(axis=1, keepdims=True) > 3)
    return chosen

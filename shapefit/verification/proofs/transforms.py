"""The transforms of a result, completed to rotations times coefficients, and what they make."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats
from shapefit.verification.proofs.block_norms import polar_rows, spectral_norms, third_rows

Indices = NDArray[np.integer]

MOST_CONDITION = 2.0**52


@dataclass(frozen=True)
class Atoms:
    """The dictionary: rows (3 k, p), for shapes; columns (p, 3 k), for correlations.

    The columns hold x, y and z of all atoms one after the other. `reach` is the largest distance
    of a landmark of an atom from its origin.
    """

    rows: Floats
    columns: Floats
    count: int
    reach: float

    @classmethod
    def of(cls, atoms: Floats) -> Atoms:
        """Lay out atoms B (k, 3, p)."""
        k, _, p = atoms.shape
        rows = np.ascontiguousarray(atoms.reshape(3 * k, p))
        columns = np.ascontiguousarray(atoms.transpose(2, 1, 0).reshape(p, 3 * k))
        return cls(rows, columns, k, float(np.sqrt((atoms**2).sum(axis=1)).max()))


@dataclass(frozen=True)
class Transforms:
    """The transforms of n images that are not 0, image after image.

    image and atom (a,): whose they are; blocks M (a, 2, 3); norms (a,), their spectral norms.
    """

    image: Indices
    atom: Indices
    blocks: Floats
    norms: Floats
    images: int
    atoms: int

    @classmethod
    def of(cls, blocks: Floats, atom: Indices, counts: Indices, atoms: int) -> Transforms:
        """Gather transforms by the numbers of them (n,) that the images have."""
        image = np.repeat(np.arange(len(counts)), counts)
        return cls(image, atom, blocks, spectral_norms(blocks), len(counts), atoms)

    def in_order(self) -> NDArray[np.bool_]:
        """Whether the atoms of each image (n,) are in order, each at most once."""
        good = np.ones(self.images, dtype=bool)
        again = (np.diff(self.atom) <= 0) & (np.diff(self.image) == 0)
        good[self.image[1:][again]] = False
        return good

    @property
    def coefficients(self) -> Floats:
        """c_i = ||M_i||_2, 0 for the other atoms (n, k)."""
        c = np.zeros((self.images, self.atoms))
        c[self.image, self.atom] = self.norms
        return c

    @property
    def skewness(self) -> Floats:
        """||M M^T / c^2 - I||_F of each transform (a,): 0 where its rows are orthonormal."""
        square = self.norms**2
        x, y = self.blocks[:, 0], self.blocks[:, 1]
        xx, yy, xy = (np.einsum("ai,ai->a", *pair) / square for pair in ((x, x), (y, y), (x, y)))
        skewness: Floats = np.sqrt((xx - 1) ** 2 + (yy - 1) ** 2 + 2 * xy**2)
        return skewness

    def total(self, values: Floats) -> Floats:
        """Sum over the transforms of each image: (n, ...) of values (a, ...)."""
        sums = np.zeros((self.images, *values.shape[1:]))
        counts = np.bincount(self.image, minlength=self.images)
        some = counts > 0
        if some.any():
            sums[some] = np.add.reduceat(values, (np.cumsum(counts) - counts)[some], axis=0)
        return sums

    def completed(self, *, orthogonal: bool) -> tuple[Floats, Floats]:
        """c_i R_i (a, 3, 3), and a bound (n,) on what `orthogonal` adds to their errors.

        The rows of M_i and their cross product over c_i; where `orthogonal` c_i times the nearest
        orthonormal rows and theirs. These are as ill determined as s1 / s2 of M_i is large: the
        bound is sum_i c_i s1 / s2, at most 2 c_i / u, which is all there is.
        """
        rows, doubt = self.blocks, np.zeros(self.images)
        if orthogonal:
            rows, condition = polar_rows(self.blocks, self.norms)
            doubt = self.total(self.norms * np.minimum(condition, MOST_CONDITION))
        third = third_rows(rows, self.norms)
        return np.concatenate([rows, third[:, None]], axis=1), doubt

    def combine(self, turned: Floats, atoms: Atoms) -> Floats:
        """sum_i T_i B_i (n, d, p) of transforms T (a, d, 3) of the same atoms."""
        d = turned.shape[1]
        dense = np.zeros((self.images, d, self.atoms, 3))
        dense[self.image, :, self.atom] = turned
        shapes: Floats = dense.reshape(self.images * d, 3 * self.atoms) @ atoms.rows
        return shapes.reshape(self.images, d, -1)

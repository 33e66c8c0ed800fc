"""The transforms of the convex program, most of them 0, and the norm of their blocks.

For a 2x3 block Q the singular values satisfy s1^2 + s2^2 = ||Q||_F^2 and s1 s2 = |q_1 x
q_2|, the length of the rows' cross product; no SVD is needed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypedDict

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats, Integers


class TransformArrays(TypedDict):
    """What a kernel needs of transforms, by the names of its arguments."""

    first: Integers
    count: Integers
    atom: Integers
    blocks: Floats


@dataclass(frozen=True, eq=False, repr=False)
class Transforms:
    """The transforms M (n, k, 2, 3) of n images, as a list of blocks that are not 0.

    They stand image by image, in the order of the atoms: count (n,), how many each
    image has; atom (a,) and block (a, 2, 3) of each; k atoms in all.
    """

    count: Integers
    atom: Integers
    blocks: Floats
    k: int

    @classmethod
    def of(cls, M: Floats) -> Transforms:
        """Make the transforms of an array M (n, k, 2, 3): the blocks that are not 0."""
        image, atom = np.nonzero(M.any(axis=(2, 3)))
        count = np.bincount(image, minlength=len(M))
        return cls(count, atom, M[image, atom], M.shape[1])

    @classmethod
    def with_one_rotation(cls, c: Floats, R: Floats) -> Transforms:
        """Make M_i = c_i Rbar from coefficients c (n, k) and rotations R (n, 3, 3)."""
        image, atom = np.nonzero(c)
        count = np.bincount(image, minlength=len(c))
        blocks = c[image, atom, None, None] * R[image, :2]
        return cls(count, atom, blocks, c.shape[1])

    @classmethod
    def gather(
        cls, first: Integers, count: Integers, atom: Integers, blocks: Floats, k: int
    ) -> Transforms:
        """Make the transforms of n images from a list of atoms and blocks in any order.

        The blocks of image i are `count[i]` from `first[i]` on. A list that is in the
        order of the images is not copied.
        """
        shift = first - starts_of(count)
        total = count.sum()
        if not shift.any():
            return cls(count, atom[:total], blocks[:total], k)
        place = np.repeat(shift, count) + np.arange(total)
        return cls(count, atom[place], blocks.take(place, axis=0), k)

    @classmethod
    def concatenate(cls, parts: Sequence[Transforms]) -> Transforms:
        """Concatenate the transforms of several sets of images, for the same atoms."""
        count = np.concatenate([part.count for part in parts])
        atom = np.concatenate([part.atom for part in parts])
        blocks = np.concatenate([part.blocks for part in parts])
        return cls(count, atom, blocks, parts[0].k)

    @property
    def image(self) -> NDArray[np.intp]:
        """Return the index (a,) of the image of each block."""
        return np.repeat(np.arange(len(self.count)), self.count)

    @property
    def arrays(self) -> TransformArrays:
        """Return the arrays that kernels need, by the names of their arguments."""
        return {
            "first": starts_of(self.count),
            "count": self.count,
            "atom": self.atom,
            "blocks": self.blocks,
        }

    def take(
        self, images: NDArray[np.intp] | NDArray[np.bool_] | Sequence[int]
    ) -> Transforms:
        """Return the transforms of the images that indices or a mask select."""
        first = starts_of(self.count)[images]
        count = self.count[images]
        return Transforms.gather(first, count, self.atom, self.blocks, self.k)

    def scatter(self, values: Floats) -> Floats:
        """Put a value (a, ...) for each block into an array (n, k, ...), else 0."""
        full = np.zeros((len(self.count), self.k, *values.shape[1:]))
        full[self.image, self.atom] = values
        return full

    def dense(self) -> Floats:
        """Return all transforms M (n, k, 2, 3), those that are 0 included."""
        return self.scatter(self.blocks)


def starts_of(count: Integers) -> Integers:
    """Return where each list starts (n,) if lists of `count` (n,) are concatenated."""
    return np.cumsum(count) - count


def nuclear_norm(Q: Floats) -> Floats:
    """Return the sum of the singular values (...) of blocks (..., 2, 3).

    ||Q||_* = s1 + s2, the dual norm of the spectral norm.
    """
    cross = np.cross(Q[..., 0, :], Q[..., 1, :])
    product = np.linalg.norm(cross, axis=-1)
    squares = (Q**2).sum(axis=(-2, -1))
    norm: Floats = np.sqrt(squares + 2 * product)
    return norm

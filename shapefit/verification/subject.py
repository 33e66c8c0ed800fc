"""What is verified together: some images of a result, with the atoms and the terms of their fit."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Flags, Floats
from shapefit.errors import input_error
from shapefit.io import ResultSet
from shapefit.verification.images import Images, stated_by
from shapefit.verification.proofs.transforms import Atoms, Transforms
from shapefit.verification.terms import Terms

Rows = NDArray[np.intp]


@dataclass(frozen=True)
class Subject:
    """The images `rows` (n,) of a result, those that have a shape.

    kept (n, k): the atoms that each image could use, None for all; file: named in messages.
    """

    result: ResultSet
    rows: Rows
    images: Images
    atoms: Atoms
    kept: Flags | None
    terms: Terms
    file: Path

    def of(self, values: NDArray[Any]) -> NDArray[Any]:
        """Return the rows of the images, which ascend; a copy only where they are not all."""
        return values if len(self.rows) == len(values) else values[self.rows]

    def stated(self, name: str) -> Floats:
        """Return what the result says of the images, a dataset of numbers."""
        return self.of(stated_by(self.result, name, self.file))

    def words(self) -> NDArray[np.str_]:
        """Return the status of each image."""
        return self.of(stated_by(self.result, "status", self.file)).astype(str)

    def transforms(self) -> Transforms:
        """Return the active transforms. Raises InputError for atoms that are not there."""
        r = self.result
        assert r.transform_count is not None
        assert r.transform_atom is not None
        assert r.active_transforms is not None
        k = self.atoms.count
        if ((r.transform_atom < 0) | (r.transform_atom >= k)).any():
            found = f"transforms of atoms that are not among the {k}"
            raise input_error(self.file, found, "give the dictionary of the fit")
        fitted = np.zeros(len(r), dtype=bool)
        fitted[self.rows] = True
        mine = slice(None) if fitted.all() else np.repeat(fitted, r.transform_count)
        counts = self.of(r.transform_count)
        return Transforms.of(r.active_transforms[mine], r.transform_atom[mine], counts, k)

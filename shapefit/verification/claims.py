"""All that a result claims of some images, checked: the chapters of this package put together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from shapefit.arrays import Flags, Floats
from shapefit.verification.checks import Checks, Columns
from shapefit.verification.fit import Fit, Images, check_statement, read_images
from shapefit.verification.program import Atoms, check_one_rotation, check_program, check_proper
from shapefit.verification.shapes import check_bars, check_inputs, check_residual, check_seen
from shapefit.verification.tree import check_tree


@dataclass(frozen=True)
class Model:
    """What images are fitted with: atoms (k, 3, p) of the joints, and A (p, p) of what is seen.

    atom_items: the training shapes that the atoms are, where they are such; dependent (p,): those
    that were lifted without what images show of them; rows (m, p): weights of the joints that give
    the landmarks of the files, None where there are none.
    """

    atoms: Floats
    A: Floats
    atom_items: Sequence[str] | None
    dependent: Flags
    rows: Floats | None = None

    @cached_property
    def seen(self) -> Floats:
        """The atoms (k, 3, p) as landmarks show them."""
        return np.asarray(self.atoms @ self.A.T)

    @cached_property
    def laid_out(self) -> Atoms:
        """The same, laid out for sums and correlations."""
        return Atoms.of(self.seen)


def check_images(
    columns: Columns, items: Sequence[str], model: Model, fit: Fit
) -> tuple[Checks, Images, Flags]:
    """Return the checks of what a result claims of its n images, these, and which have a proof."""
    images = read_images(columns, model.dependent, fit)
    checks, D, shape = Checks(images.fitted, columns), None, None
    proved = np.zeros(len(images.fitted), dtype=bool)
    check_statement(images, checks)
    kept = check_left_out(images, items, model.atom_items or (), checks) if fit.left_out else None
    check_proper(images, checks)
    if "dual" in columns:
        D = check_program(images, model.laid_out, kept, checks)
        proved |= fit.is_program
    if fit.has_one_rotation:
        shape = check_one_rotation(images, model.laid_out, kept, D, checks)
        proved |= fit.has_gap and D is not None
    if fit.is_global and "tree_cells" in columns:
        proved |= check_tree(images, model.laid_out, kept, checks)
    check_seen(images, model.A, shape, checks)
    check_residual(images, checks)
    if fit.has_posterior:
        check_bars(images, checks)
    if model.rows is not None and "input_shapes" in columns:
        check_inputs(images, model.rows, checks)
    return checks, images, proved


def check_left_out(
    images: Images, items: Sequence[str], atom_items: Sequence[str], checks: Checks
) -> Flags:
    """Check which item each image did without; returns the atoms (n, k) that it could use."""
    columns, dataset, known = images.columns, images.fit.left_out, np.array(atom_items, dtype=str)
    named = columns.get(f"input_{dataset}", columns.get(dataset, items))
    shown = np.array(items if dataset == "item" else named).astype(str)
    stated = columns["left_out"].astype(str)
    same = stated == np.where(np.isin(shown, known), shown, "")
    checks.hold("left_out is the item that the image shows", same, "left_out")
    return np.asarray(stated[:, None] != known)

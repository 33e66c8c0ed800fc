"""All that a result claims of some images, checked: the chapters of this package put together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from shapefit.arrays import Flags, Floats
from shapefit.verification.checks import Checks
from shapefit.verification.fit import (
    DRAWS,
    PROOF,
    Columns,
    Fit,
    check_lambda,
    check_left_out,
    check_statement,
    draw_noise,
    read_images,
)
from shapefit.verification.program import Atoms, Transforms, check_program, nuclear_norms
from shapefit.verification.rotation import check_proper
from shapefit.verification.shapes import (
    check_bars,
    check_inputs,
    check_metres,
    check_one_rotation,
    check_position,
    check_residual,
    check_seen,
)
from shapefit.verification.tree import check_certificate


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
    def seen(self) -> Atoms:
        """The atoms as landmarks show them."""
        return Atoms.of(self.atoms @ self.A.T)

    @cached_property
    def noise(self) -> float:
        """E max_i ||G B_i^T||_* over draws of noise G."""
        G = draw_noise(self.atoms.shape[2])
        N = (G.reshape(2 * DRAWS, -1) @ self.seen.columns).reshape(DRAWS, 2, 3, -1)
        return float(nuclear_norms(N[:, 0], N[:, 1]).max(axis=1).mean())


def check_images(
    columns: Columns,
    items: Sequence[str],
    model: Model,
    fit: Fit,
    metres: Floats | None,
    unit: Floats | None,
) -> tuple[Checks, Flags]:
    """Return the checks of all that a result claims of its n images, and which are proved (n,).

    metres (n,) in a unit of each shape, and the dictionary's units in one of the atoms (n,), where
    the dictionary knows them.
    """
    checks = Checks(np.asarray(np.isfinite(columns["scale"])), columns)
    proved = np.zeros(len(checks.fitted), dtype=bool)
    with np.errstate(all="ignore"):  # what is not finite holds for nothing
        images = read_images(columns, model.dependent, fit)
        check_statement(images, model.dependent, checks)
        kept, D = None, None
        if fit.left_out:
            kept = check_left_out(images, items, model.atom_items or (), checks)
        auto = fit.key("lambda") == "auto" and fit.loss != "exact"
        check_lambda(images, model.noise if auto else 0.0, checks)
        check_proper(columns["rotation"], images.factor, checks)
        if fit.solves_program and all(name in columns for name in PROOF):
            M = Transforms.of(images, len(model.atoms))
            D = check_program(images, M, model.seen, kept, checks)
            proved |= fit.is_program
        if fit.has_one_rotation:
            check_one_rotation(images, model.seen, kept, D, checks)
            proved |= fit.has_gap and D is not None
        if fit.is_global:
            proved |= check_certificate(images, model.seen, kept, checks)
        check_seen(images, model.A, checks)
        check_residual(images, checks)
        if fit.has_posterior:
            check_bars(images, checks)
        if model.rows is not None and "input_shapes" in columns:
            check_inputs(images, model.rows, checks)
        if metres is not None and "metres_per_unit" in columns:
            check_metres(images, metres, checks)
        if unit is not None and "position" in columns:
            check_position(images, unit, checks)
    return checks, proved & checks.fitted & ~checks.missed()

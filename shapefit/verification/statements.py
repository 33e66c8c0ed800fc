"""What a result states in words, and what it must not have used: no arithmetic is needed."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Flags
from shapefit.errors import input_error
from shapefit.geometry.normalisation import LARGEST, SMALLEST
from shapefit.io import ResultSet
from shapefit.verification.check import Check, check, flagged
from shapefit.verification.images import Images, stated_by, stated_confidence
from shapefit.verification.proofs.block_norms import nuclear_norms
from shapefit.verification.proofs.transforms import Atoms
from shapefit.verification.terms import Terms

Rows = NDArray[np.intp]

WITHOUT_SHAPE = ("degenerate input", "numerical failure")
OPTIMAL = "optimal"
LIMITED = "iteration limit"
HIDDEN = "left_out"

DRAWS, SEED = 512, 1504_01507
LEAST, MOST = 1e-3, 1e30
"""Of `lambda: auto`: draws of noise, their seed, and the bounds (docs/lambda.md)."""

FEWEST, FLAT = 3, 1e-9
"""Visible landmarks that a shape needs, and singular values whose ratio makes them a line."""


def check_lambda(images: Images, atoms: Atoms, terms: Terms) -> Check:
    """Check that lambda is the one of the config; where that is `auto`, that it follows from it.

    Then it is noise / size E max_i ||G B_i^T||_* sqrt(visible share), the expectation over seeded
    draws of centred noise G, in bounds. Where atoms are left out it has to be a number only.
    """
    lam = 1.0 if terms.loss == "exact" else terms.lam
    if lam is not None:
        return check("lambda is that of the config", np.abs(images.lam - lam), 0.0)
    if terms.left_out:
        return flagged("lambda is above 0", images.lam > 0)
    p = images.points.shape[2]
    G = np.random.default_rng(SEED).standard_normal((DRAWS, 2, p))
    G -= G.mean(axis=-1, keepdims=True)
    N = (G.reshape(2 * DRAWS, p) @ atoms.columns).reshape(DRAWS, 2, 3, atoms.count)
    unit = float(nuclear_norms(N[:, 0], N[:, 1]).max(axis=1).mean())
    share = np.sqrt((images.weights > 0).mean(axis=1))
    found = np.clip(terms.noise / images.size * unit * share, LEAST, MOST)
    doubt = 3 * images.factor * (1 + images.extent / images.size)
    return check("lambda follows from the noise", np.abs(images.lam - found), doubt * found)


def find_kept(
    result: ResultSet, rows: Rows, atom_items: Sequence[str] | None, terms: Terms, file: Path
) -> Flags | None:
    """Return the atoms (n, k) that are not of the item that an image had to do without."""
    if not terms.left_out:
        return None
    if atom_items is None:
        found = f"models were left out (`leave_out: {terms.left_out}`)"
        raise input_error(file, found, "give the dictionary of the fit, whose atoms have items")
    left_out = stated_by(result, HIDDEN, file)[rows].astype(str)
    return left_out[:, None] != np.array(atom_items, dtype=str)


def check_left_out(
    result: ResultSet, rows: Rows, atom_items: Sequence[str], terms: Terms, file: Path
) -> Check:
    """Check that each image did without the item that its dataset names."""
    if terms.left_out == "item":
        named = np.array(result.items, dtype=str)[rows]
    else:
        renamed = f"input_{terms.left_out}"
        name = renamed if renamed in result.columns else terms.left_out
        named = stated_by(result, name, file)[rows].astype(str)
    named = np.where(np.isin(named, np.array(atom_items, dtype=str)), named, "")
    stated = stated_by(result, HIDDEN, file)[rows].astype(str)
    return flagged("left_out is the item that the image shows", stated == named)


def check_words(result: ResultSet, fitted: Flags, terms: Terms, file: Path) -> Check:
    """Check that the status is one that the method can end with."""
    words = stated_by(result, "status", file).astype(str)
    good = {LIMITED, OPTIMAL if terms.is_program or terms.is_global else "converged"}
    right = np.where(fitted, np.isin(words, list(good)), np.isin(words, WITHOUT_SHAPE))
    return flagged("status is one of the method", right)


def check_degenerate(result: ResultSet, fitted: Flags, aside: Flags, file: Path) -> Check:
    """Check that images without a shape have landmarks that no method could lift.

    Those are fewer than 3 visible ones, or ones on a line, or of sizes whose squares float64 does
    not hold. What a method, a camera or a search for outliers made of others cannot be computed
    again: then the image is not proved to have no shape.
    """
    without = ~fitted
    raw = stated_by(result, "landmarks", file)[without].swapaxes(1, 2)
    visible = np.isfinite(raw).all(axis=1) & ~aside & (stated_confidence(result, file)[without] > 0)
    count = visible.sum(axis=1)
    points = np.where(visible[:, None], raw, 0.0)
    size = np.abs(points).max(axis=(1, 2), initial=0.0)
    points = points / np.where(size > 0, size, 1.0)[:, None, None]
    centred = points - (points.sum(axis=2) / np.maximum(count, 1)[:, None])[..., None]
    centred = np.where(visible[:, None], centred, 0.0)
    extent = np.minimum(size, LARGEST) * np.abs(centred).max(axis=(1, 2), initial=0.0)
    s = np.linalg.svd(centred, compute_uv=False)
    off = np.zeros(len(result))
    flat = (s[:, 1] <= FLAT * s[:, 0]) | (s[:, 0] == 0)
    degenerate = (count < FEWEST) | flat | (size > LARGEST) | (extent < SMALLEST)
    off[without] = np.where(degenerate, 0.0, np.inf)
    return check("an image without a shape has degenerate landmarks", off, 0.0, without)


def check_absence(result: ResultSet, fitted: Flags) -> Check:
    """Check that images without a scale have no shape and no transform, and the others a shape."""
    whole = np.isfinite(result.shapes).all(axis=(1, 2))
    empty = np.isnan(result.shapes).all(axis=(1, 2))
    if result.transform_count is not None:
        empty &= result.transform_count == 0
    return flagged("a shape is whole or absent", np.where(fitted, whole, empty))

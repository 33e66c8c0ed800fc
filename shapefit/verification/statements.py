"""What a result states in words, and what it must not have used: no arithmetic is needed."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from shapefit.errors import input_error
from shapefit.io import ResultSet
from shapefit.verification.check import Check, check, flagged
from shapefit.verification.images import Images, needed
from shapefit.verification.subject import words_of
from shapefit.verification.terms import CONVEX, Terms

Flags = NDArray[np.bool_]
Rows = NDArray[np.intp]

WITHOUT_SHAPE = ("degenerate input", "numerical failure")
OPTIMAL = "optimal"
HIDDEN = "left_out"


def check_lambda(images: Images, terms: Terms) -> Check:
    """Check that lambda is the one of the config; where that is `auto`, that it is one."""
    lam = 1.0 if terms.loss == "exact" else terms.lam
    off = np.where(images.lam > 0, 0.0, np.inf) if lam is None else np.abs(images.lam - lam)
    return check("lambda is that of the config", off, 0.0)


def find_kept(
    result: ResultSet, rows: Rows, atom_items: Sequence[str] | None, terms: Terms, file: Path
) -> Flags | None:
    """Return the atoms (n, k) that are not of the item that an image had to do without."""
    if not terms.left_out:
        return None
    if atom_items is None:
        found = f"models were left out (`leave_out: {terms.left_out}`)"
        raise input_error(file, found, "give the dictionary of the fit, whose atoms have items")
    left_out = needed(result, HIDDEN, file, text=True)[rows]
    return left_out[:, None] != np.array(atom_items, dtype=str)


def check_left_out(
    result: ResultSet, rows: Rows, atom_items: Sequence[str], terms: Terms, file: Path
) -> Check:
    """Check that each image did without the item that its dataset names."""
    if terms.left_out == "item":
        named = np.array(result.items, dtype=str)[rows]
    else:
        renamed = f"input_{terms.left_out}"
        name = renamed if renamed in result.extras else terms.left_out
        named = needed(result, name, file, text=True)[rows]
    named = np.where(np.isin(named, np.array(atom_items, dtype=str)), named, "")
    stated = needed(result, HIDDEN, file, text=True)[rows]
    return flagged("left_out is the item that the image shows", stated == named)


def check_words(result: ResultSet, fitted: Flags, terms: Terms, file: Path) -> Check:
    """Check that the status is one that the method can end with."""
    words = words_of(result, file)
    good = {"iteration limit", OPTIMAL if terms.is_program or terms.is_global else "converged"}
    if terms.by_change and terms.method == CONVEX:
        good.add("converged")
    right = np.where(fitted, np.isin(words, list(good)), np.isin(words, WITHOUT_SHAPE))
    return flagged("status is one of the method", right)


def check_absence(result: ResultSet, fitted: Flags) -> Check:
    """Check that images without a scale have no shape and no transform, and the others a shape."""
    whole = np.isfinite(result.shapes).all(axis=(1, 2))
    empty = np.isnan(result.shapes).all(axis=(1, 2))
    if result.transform_count is not None:
        empty &= result.transform_count == 0
    return flagged("a shape is whole or absent", np.where(fitted, whole, empty))

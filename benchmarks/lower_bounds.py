"""What a dictionary leaves of the truth at best: similarity errors that no fit can do
without.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

import shapefit
from shapefit.arrays import Floats
from shapefit.dictionary.coding import sparse_code
from shapefit.dictionary.model import Dictionary
from shapefit.evaluation.metrics import (
    MIN_COMMON_LANDMARKS,
    similarity_error,
    truth_scale,
)
from shapefit.geometry.procrustes import rotation_onto
from shapefit.io import read_dictionary, read_shapes
from shapefit.io.arrange import arrange

ORACLES: Mapping[str, Callable[[Floats, Dictionary], Floats]] = {
    "Mean shape (oracle)": lambda true, dictionary: similarity_error(
        np.broadcast_to(dictionary.mean_shape, true.shape), true
    ),
    "Nearest atom (oracle)": lambda true, dictionary: nearest_atom(
        true, dictionary.atoms
    ),
    "Best combination (oracle)": lambda true, dictionary: similarity_error(
        best_combination(true, dictionary.atoms), true
    ),
}
"""Name of a row -> its errors (n,) for true shapes (n, 3, p) and a dictionary of p
landmarks.
"""


def oracle_rows(config: Mapping[str, Any]) -> list[list[str]]:
    """Return a row of texts for each oracle, an estimate that knows the truth: its mean
    / median error, normalised and in the unit of the truth.

    config: that of an evaluation. The dictionary is that of its first result, without
    the atoms of the shape that an image shows where the fit left these out. Shapes have
    its landmarks.
    """
    found = shapefit.read_results(next(iter(config["results"].values()))[0])
    fitted = json.loads(str(found.attributes["config"]))
    dictionary = read_dictionary(Path(fitted["dictionary"]))
    truth = read_shapes([Path(path) for path in config["truth"]])
    truth = arrange(truth, dictionary.landmark_names)
    shapes_of = truth.as_columns()
    row_of = {item: row for row, item in enumerate(truth.items)}
    assert found.landmarks is not None, "every fit has them"
    visible = np.isfinite(found.landmarks).all(axis=2).sum(axis=1)
    retained = np.flatnonzero(visible >= config.get("least_visible", 0))
    shown = np.array([row_of[name] for name in _entries(found, config["match"])])[
        retained
    ]
    left_out = np.array(_entries(found, fitted.get("leave_one_out")))[retained]
    rows = []
    for name, oracle in ORACLES.items():
        error = np.full(len(shown), np.nan)
        for item in np.unique(left_out):
            own = left_out == item
            known = dictionary.without(str(item)) if item else dictionary
            shapes, back = np.unique(shown[own], return_inverse=True)
            error[own] = oracle(shapes_of[shapes], known)[back]
        size = truth_scale(shapes_of, shapes_of)[shown]
        cells = [
            f"{np.mean(e):.3f} / {np.median(e):.3f}" for e in (error / size, error)
        ]
        rows.append([name, *cells])
    return rows


def _entries(found: shapefit.Fit, dataset: str | None) -> list[str]:
    """Return the entry of a dataset of a result for each image, as a text; "" without a
    dataset.
    """
    if dataset is None:
        return [""] * len(found)
    return (
        list(found.items or ())
        if dataset == "item"
        else list(map(str, np.asarray(found.column(dataset))))
    )


STILL = 1e-9
"""Fall of the squared residual, as a share of the shape's square, that ends the
alternation.
"""
MAX_ROUNDS = 200


def nearest_atom(shapes: Floats, atoms: Floats) -> Floats:
    """Return the similarity error (n,) of the nearest atom to each shape, for shapes
    (n, 3, p) and atoms (k, 3, p).
    """
    errors = [
        similarity_error(np.broadcast_to(atom, shapes.shape), shapes) for atom in atoms
    ]
    nearest: Floats = np.min(errors, axis=0)
    return nearest


def best_combination(shapes: Floats, atoms: Floats) -> Floats:
    """argmin over E = sum_i c_i B_i, c >= 0 of min over R, t of ||E - R S - t
    1^T||_F^2.

    shapes (n, 3, p) with nan where a landmark is unknown, atoms (k, 3, p); returns E
    (n, 3, p) in the frame of the atoms, nan at unknown landmarks and where fewer than
    three are known. R and c take turns, once from the rotation onto the mean of the
    atoms and once from that onto the nearest atom, and the better end counts: it is
    never worse than any single atom, but may be a local minimum.
    """
    known = np.isfinite(shapes).all(axis=-2)
    best = np.full(shapes.shape, np.nan)
    for pattern in np.unique(known, axis=0):
        if pattern.sum() >= MIN_COMMON_LANDMARKS:
            rows = np.flatnonzero((known == pattern).all(axis=-1))
            place = np.ix_(rows, np.arange(3), np.flatnonzero(pattern))
            best[place] = _combine(
                _centred(shapes[place]), _centred(atoms[..., pattern])
            )
    return best


def _combine(shapes: Floats, atoms: Floats) -> Floats:
    """Return the better combination (n, 3, p) of two alternations: from the mean of the
    atoms, and from the nearest atom; all are centred, no landmark is hidden.
    """
    sizes = np.linalg.norm(atoms, axis=(-2, -1), keepdims=True)
    directions = atoms / np.maximum(
        sizes, np.finfo(np.float64).tiny
    )  # an atom may be 0
    overlap = [
        ((rotation_onto(shapes, B) @ shapes) * B).sum(axis=(-2, -1)) for B in directions
    ]
    nearest = atoms[np.argmax(overlap, axis=0)]
    mean = np.broadcast_to(atoms.mean(axis=0), shapes.shape)
    (first, remains), (second, leaves) = (
        _alternate(shapes, atoms, at) for at in (mean, nearest)
    )
    return np.where((leaves < remains)[:, None, None], second, first)


def _alternate(shapes: Floats, atoms: Floats, start: Floats) -> tuple[Floats, Floats]:
    """Alternate between rotations of the shapes and non-negative least squares, from
    the rotations onto start (n, 3, p); return combinations (n, 3, p) and squared
    residuals (n,).
    """
    size = (shapes**2).sum(axis=(-2, -1))
    combined, coefficients = start, None
    before = np.full(len(shapes), np.inf)
    for _ in range(MAX_ROUNDS):
        targets = rotation_onto(shapes, combined) @ shapes
        coefficients = sparse_code(targets, atoms, beta=0.0, start=coefficients)
        combined = np.tensordot(coefficients, atoms, axes=1)
        residual = ((combined - targets) ** 2).sum(axis=(-2, -1))
        if (before - residual <= STILL * size).all():
            break
        before = residual
    return combined, residual


def _centred(points: Floats) -> Floats:
    centred: Floats = points - points.mean(axis=-1, keepdims=True)
    return centred

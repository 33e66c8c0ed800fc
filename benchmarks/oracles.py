"""What a dictionary leaves of the truth at best: similarity errors that no fit can do without."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from shapefit.arrays import Floats
from shapefit.dictionary.coding import sparse_code
from shapefit.dictionary.model import Dictionary
from shapefit.evaluation.metrics import FEWEST_LANDMARKS, similarity, truth_scale
from shapefit.evaluation.summaries import (
    ALL,
    NORMALISED,
    ImageErrors,
    Summary,
    labels_of,
    summarise,
)
from shapefit.geometry.procrustes import rotation_onto
from shapefit.io import read_dictionary, read_results, read_shapes
from shapefit.pipelines.evaluate.judge import take_visible
from shapefit.pipelines.items import named_items

ORACLES: Mapping[str, Callable[[Floats, Dictionary], Floats]] = {
    "Mean shape (oracle)": lambda true, dictionary: similarity(
        np.broadcast_to(dictionary.mean_shape, true.shape), true
    ),
    "Nearest atom (oracle)": lambda true, dictionary: nearest_atom(true, dictionary.atoms),
    "Best combination (oracle)": lambda true, dictionary: similarity(
        best_combination(true, dictionary.atoms), true
    ),
}
"""Name of a row -> its errors (n,) for true shapes (n, 3, p) and a dictionary of p landmarks."""


def oracle_rows(folder: Path) -> list[Summary]:
    """Return the rows of the oracles for the images of an evaluation in `folder`.

    The dictionary is that of its first result, without the atoms of the shape that an image shows
    where the fit left these out. Shapes have the landmarks of the dictionary.
    """
    stated = json.loads((folder / "report.json").read_text(encoding="utf-8"))["config"]
    match, least = stated["match"], stated.get("least_visible", 0)
    file = Path(next(iter(stated["results"].values()))[0])
    results, _ = take_visible(file, read_results(file), least)
    fitted = json.loads(str(results.attributes["config"]))
    dictionary = read_dictionary(Path(fitted["dictionary"]))
    truth = read_shapes([Path(path) for path in stated["truth"]])
    truth = truth.arrange(dictionary.landmark_names)
    row = {item: row for row, item in enumerate(truth.items)}
    rows = np.array([row[item] for item in named_items(results, match, file, "match")])
    left_out = ["" for _ in rows]
    if key := fitted.get("leave_out"):
        left_out = list(named_items(results, key, file, "leave_out"))
    shown = list(dict.fromkeys(zip(rows.tolist(), left_out, strict=True)))
    place = {each: i for i, each in enumerate(shown)}
    of_image = [place[each] for each in zip(rows.tolist(), left_out, strict=True)]
    true = truth.shapes[[shape for shape, _ in shown]]
    found: list[Summary] = []
    for name, oracle in ORACLES.items():
        error = np.full(len(shown), np.nan)
        for item in dict.fromkeys(item for _, item in shown):
            own = [i for i, (_, other) in enumerate(shown) if other == item]
            known = dictionary.without(item) if item else dictionary
            error[own] = oracle(true[own], known)
        for unit, values in {
            NORMALISED: error / truth_scale(true, true),
            truth.unit: error,
        }.items():
            labels = labels_of((ALL,) * len(rows))
            images = ImageErrors(name, "similarity", unit, results.items, labels, values[of_image])
            found += summarise(images, {ALL: (ALL,)})
    return found


STILL = 1e-9
"""Fall of the squared residual, as a share of the shape's square, that ends the alternation."""
MAX_ROUNDS = 200


def nearest_atom(shapes: Floats, atoms: Floats) -> Floats:
    """Return min over i of similarity(B_i, S) for each shape; (n, 3, p), (k, 3, p) -> (n,)."""
    errors = [similarity(np.broadcast_to(atom, shapes.shape), shapes) for atom in atoms]
    return np.min(errors, axis=0)


def best_combination(shapes: Floats, atoms: Floats) -> Floats:
    """argmin over E = sum_i c_i B_i, c >= 0 of min over R, t of ||E - R S - t 1^T||_F^2.

    shapes (n, 3, p) with nan where a landmark is unknown, atoms (k, 3, p); returns E (n, 3, p) in
    the frame of the atoms, nan at unknown landmarks and where fewer than three are known. R and c
    take turns, once from the rotation onto the mean of the atoms and once from that onto the
    nearest atom, and the better end counts: it is never worse than any single atom, but may be a
    local minimum.
    """
    known = np.isfinite(shapes).all(axis=-2)
    best = np.full(shapes.shape, np.nan)
    for pattern in np.unique(known, axis=0):
        if pattern.sum() >= FEWEST_LANDMARKS:
            rows = np.flatnonzero((known == pattern).all(axis=-1))
            place = np.ix_(rows, np.arange(3), np.flatnonzero(pattern))
            best[place] = _combine(_centred(shapes[place]), _centred(atoms[..., pattern]))
    return best


def _combine(shapes: Floats, atoms: Floats) -> Floats:
    """Return the better of the two ends; all centred, none hidden."""
    sizes = np.linalg.norm(atoms, axis=(-2, -1), keepdims=True)
    directions = atoms / np.maximum(sizes, np.finfo(np.float64).tiny)  # an atom may be 0
    overlap = [((rotation_onto(shapes, B) @ shapes) * B).sum(axis=(-2, -1)) for B in directions]
    nearest = atoms[np.argmax(overlap, axis=0)]
    mean = np.broadcast_to(atoms.mean(axis=0), shapes.shape)
    (first, remains), (second, leaves) = (_alternate(shapes, atoms, at) for at in (mean, nearest))
    return np.where((leaves < remains)[:, None, None], second, first)


def _alternate(shapes: Floats, atoms: Floats, start: Floats) -> tuple[Floats, Floats]:
    """Take turns between rotations and non-negative least squares, from the rotations onto start.

    Returns the combinations (n, 3, p) and their squared residuals (n,).
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
    return points - points.mean(axis=-1, keepdims=True)

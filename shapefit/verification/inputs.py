"""Landmarks and digests: whether a result is that of the inputs it names."""

from __future__ import annotations

import math
import operator
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats
from shapefit.geometry.lens import complete, distort, undistort
from shapefit.io import LandmarkSet, ResultSet
from shapefit.io.layout import free_names
from shapefit.verification.check import Check, check, flagged
from shapefit.verification.fates import DATASETS
from shapefit.verification.folder import config_digest
from shapefit.verification.terms import Terms

DISTORTION = "distortion"
REMOVED = "removed_distortion"
"""Dataset of a result: the coefficients of the distortion that its landmarks no longer have."""

BOUND = 1e-8
"""Of the largest coordinate by which the inverse of the model may miss."""

CALIBRATED = ("camera_matrix", "image_size", "extrinsic_rotation", "extrinsic_translation")
"""Datasets that a calibration may have stated in place of the landmarks."""

AS_IN_FILE = "{}: as in the file of landmarks"

Given = tuple[Path, str, str]
"""A file that is given, the name of the input of the fit that it stands for, its digest."""

UNKNOWN = "stream"
"""Stands for the digest of what could not be read twice."""


def check_landmarks(result: ResultSet, images: LandmarkSet) -> list[Check]:
    """Check that n results have the landmarks of a file, and all that came with these.

    Where the fit removed the distortion of a lens, the lens must put its landmarks onto those.
    """
    seen = np.asarray(np.isfinite(images.landmarks).all(axis=1))
    if images.confidence is not None:
        seen = seen & (images.confidence > 0)
    given = images.landmarks.swapaxes(1, 2)
    bound: float | Floats = 0.0
    stated = np.asarray(result.columns.get("landmarks", np.full_like(given, np.nan)))
    if REMOVED in result.columns:
        seen = seen & shown(given, result.columns, result.y_axis)
        stated = bent_again(stated, result.columns, result.y_axis)
        bound = BOUND * np.nanmax(np.abs(given), initial=1.0)
    expected = np.where(seen[..., None], given, np.nan)
    with np.errstate(invalid="ignore", over="ignore"):
        off = np.where(np.isnan(stated) & np.isnan(expected), 0.0, np.abs(stated - expected))
    checks = [
        _same_texts("items", result.items, images.items),
        check("landmarks are those of the file", off, bound),
    ]
    n = len(result)
    if result.sequences is not None or images.sequences is not None:
        both = (names or ("",) * n for names in (result.sequences, images.sequences))
        checks.append(_same_texts("sequences", *both))
    if images.confidence is not None or "confidence" in result.columns:
        own = np.ones(given.shape[:2]) if images.confidence is None else images.confidence
        checks.append(_same("confidence", result.columns.get("confidence", np.nan), own))
    carried, of_file = carried_by(images)
    for name in carried.keys() - of_file:
        checks.append(_same(name, result.per_item(name), carried[name]))
    return checks


def _same_texts(name: str, stated: Sequence[str], expected: Sequence[str]) -> Check:
    """Check that each image has the same text in both."""
    same = np.fromiter(map(operator.eq, stated, expected), bool, len(expected))
    return flagged(AS_IN_FILE.format(name), same)


def _same(name: str, stated: Any, expected: NDArray[Any]) -> Check:
    """Check that each image has the same (n, ...) in both, nan where it is nan."""
    claim, n = AS_IN_FILE.format(name), len(expected)
    if np.shape(stated) not in (expected.shape, ()) or stated is None:
        return flagged(claim, np.zeros(n, dtype=bool))
    stated = np.broadcast_to(stated, expected.shape)
    if expected.dtype.kind not in "biufc" or stated.dtype.kind not in "biufc":
        same = stated.astype(str) == expected.astype(str)
    else:
        same = (stated == expected) | (np.isnan(stated) & np.isnan(expected))
    return flagged(claim, same.reshape(n, math.prod(same.shape[1:])).all(axis=1))


def carried_by(images: LandmarkSet) -> tuple[dict[str, Any], frozenset[str]]:
    """Return the datasets that a fit carries from landmarks into its result, as it names them,
    and which of them belong to the file.

    The lens keeps its name no longer, since its distortion was removed.
    """
    lens = {DISTORTION, REMOVED}
    names = free_names(images.further, DATASETS)
    carried = {names[n]: values for n, values in images.further.items() if names[n] not in lens}
    return carried, frozenset(names[name] for name in images.of_file)


def false_heads(result: ResultSet, images: LandmarkSet, terms: Terms) -> list[tuple[str, str]]:
    """Return what a result states of all its images otherwise than the landmarks and the config."""
    rate = terms.frame_rate or images.frame_rate
    pairs = {
        "unit": (result.unit, images.unit),
        "y_axis": (result.y_axis, images.y_axis),
        "frame_rate": (result.frame_rate, rate),
    }
    wrong = [
        (name, f"is {stated}, and that of the landmarks {given}")
        for name, (stated, given) in pairs.items()
        if stated != given
    ]
    carried, of_file = carried_by(images)
    for name in (name for name in carried if name in of_file):
        if terms.calibrated and name in CALIBRATED:
            continue
        stated = result.columns[name] if name in result.of_file else None
        if not np.array_equal(np.asarray(stated), np.asarray(carried[name])):
            wrong.append((name, "is not that of the landmarks"))
    return wrong


def false_inputs(
    attributes: Mapping[str, Any], terms: Terms, given: Sequence[Given]
) -> list[tuple[str, str]]:
    """Return each input, or the config, that is not the one the result was made from, and why.

    The result names its inputs with their SHA-256; without one there is nothing to compare.
    """
    wrong = [
        (name, "is absent, and every fit writes it: there is nothing to compare with")
        for name in ("config_digest", "inputs")
        if name not in attributes
    ]
    stated = attributes.get("config_digest")
    if stated is not None and stated != config_digest(str(attributes["config"])):
        wrong.append(("config", "is not the file with the stored digest"))
    if attributes.get("method") != terms.method:
        wrong.append(("method", f"is not that of the config, {terms.method}"))
    for path, name, found in given:
        known = terms.inputs.get(name, UNKNOWN)
        if UNKNOWN not in (known, found) and known != found:
            reason = f"is not the file of the fit, {name}: the digests differ"
            wrong.append((str(path), f"{reason} ({found[:12]}... and {known[:12]}...)"))
    return wrong


def unknown_inputs(terms: Terms) -> list[str]:
    """Return the inputs whose digests the result does not state: they may be any files."""
    named = (terms.dictionary, *terms.landmarks)
    return [name for name in named if terms.inputs.get(name, UNKNOWN) == UNKNOWN]


def bent_again(stated: Floats, columns: Mapping[str, Any], y_axis: str) -> Floats:
    """Return landmarks (n, p, 2) of a result where its lens puts them: those of the file."""
    coefficients, focal, centre = _lens(columns, y_axis)
    return centre + focal * _through(distort, (stated - centre) / focal, coefficients)


def shown(given: Floats, columns: Mapping[str, Any], y_axis: str) -> NDArray[np.bool_]:
    """Whether the lens puts some point of the scene at each landmark (n, p, 2) of the file."""
    coefficients, focal, centre = _lens(columns, y_axis)
    straight = _through(undistort, (given - centre) / focal, coefficients)
    return np.asarray(np.isfinite(straight).all(axis=2))


def _lens(columns: Mapping[str, Any], y_axis: str) -> tuple[Floats, Floats, Floats]:
    """Return coefficients (..., 8), and focal lengths and centres, (..., 1, 2)."""
    matrix = np.asarray(columns["camera_matrix"], dtype=np.float64)
    coefficients = complete(np.asarray(columns[REMOVED], dtype=np.float64))
    if y_axis == "up":
        coefficients = coefficients * np.array([1.0, 1.0, -1.0, 1.0, 1.0, 1.0, 1.0, 1.0])
    focal = np.stack([matrix[..., 0, 0], matrix[..., 1, 1]], axis=-1)
    return coefficients, focal[..., None, :], matrix[..., None, :2, 2]


def _through(lens: Any, points: Floats, coefficients: Floats) -> Floats:
    every = np.broadcast_to(coefficients, (len(points), coefficients.shape[-1]))
    moved: Floats = lens(points.swapaxes(1, 2), every).swapaxes(1, 2)
    return moved

"""Landmarks and digests: whether a result is that of the inputs it names."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shapefit.io import LandmarkSet, ResultSet, digest
from shapefit.verification.check import Check, check
from shapefit.verification.lens import BOUND, REMOVED, bent_again, shown
from shapefit.verification.terms import Terms

Floats = NDArray[np.float64]

UNKNOWN = "stream"
"""Stands for the digest of what could not be read twice."""


def check_landmarks(result: ResultSet, images: LandmarkSet) -> list[Check]:
    """Check that landmarks and confidence of n results are those of the images of a file.

    Where the fit removed the distortion of a lens, the lens must put its landmarks onto those.
    """
    seen = np.asarray(np.isfinite(images.landmarks).all(axis=1))
    if images.confidence is not None:
        seen = seen & (images.confidence > 0)
    given = images.landmarks.swapaxes(1, 2)
    bound: float | Floats = 0.0
    stated = np.asarray(result.extras.get("landmarks", np.full_like(given, np.nan)))
    if REMOVED in result.extras:
        seen = seen & shown(given, result.extras, result.y_axis)
        stated = bent_again(stated, result.extras, result.y_axis)
        bound = BOUND * np.nanmax(np.abs(given), initial=1.0)
    expected = np.where(seen[..., None], given, np.nan)
    with np.errstate(invalid="ignore", over="ignore"):
        off = np.where(np.isnan(stated) & np.isnan(expected), 0.0, np.abs(stated - expected))
    same = np.array(result.items, dtype=object) == np.array(images.items, dtype=object)
    checks = [
        check("items are those of the file", np.where(same, 0.0, np.inf), 0.0),
        check("landmarks are those of the file", off, bound),
    ]
    if images.confidence is not None:
        confidence = np.asarray(result.extras.get("confidence", np.nan))
        off = np.abs(np.broadcast_to(confidence, images.confidence.shape) - images.confidence)
        checks.append(check("confidence is that of the file", off, 0.0))
    return checks


def false_inputs(
    attributes: Mapping[str, Any], terms: Terms, dictionary: Path, landmarks: Sequence[Path]
) -> list[tuple[str, str]]:
    """Return each input, or the config, that is not the one the result was made from, and why.

    The result names its inputs with their SHA-256; without one there is nothing to compare.
    """
    wrong: list[tuple[str, str]] = []
    stated = attributes.get("config_digest")
    if stated is not None and stated != config_digest(str(attributes["config"])):
        wrong.append(("config", "is not the file with the stored digest"))
    pairs = [(dictionary, terms.dictionary)]
    if landmarks:
        if len(landmarks) != len(terms.landmarks):
            found = f"the fit had {len(terms.landmarks)} files of landmarks"
            wrong.append((str(landmarks[0]), found))
        pairs += zip(landmarks, terms.landmarks, strict=False)
    for path, name in pairs:
        known, found = terms.inputs.get(name, UNKNOWN), digest(path)
        if UNKNOWN not in (known, found) and known != found:
            reason = f"is not the file of the fit, {name}: the digests differ"
            wrong.append((str(path), f"{reason} ({found[:12]}... and {known[:12]}...)"))
    return wrong


def config_digest(config: str) -> str:
    """Return the SHA-256 of the text of a config."""
    return hashlib.sha256(config.encode()).hexdigest()

"""Landmarks to 3D shapes, as the command `fit`."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from shapefit.config import FitConfig
from shapefit.errors import input_error
from shapefit.face.options import config_of, default, plain
from shapefit.face.records import (
    Dictionary,
    Fit,
    Landmarks,
    dictionary_model,
    fit_of,
    landmark_set,
)
from shapefit.io.extras import Extras
from shapefit.io.kinds.given import check_given_dictionary, given_source
from shapefit.io.records import LandmarkSet, concatenate
from shapefit.pipelines.fit.landmark_names import name_warnings
from shapefit.pipelines.fit.plan import plan_fit
from shapefit.pipelines.fit.report import Report
from shapefit.pipelines.fit.run import attributes_of, lift_source
from shapefit.pipelines.outcome import Counted, Note, add_up

CAMERA = "camera_matrix"
"""Dataset that holds the matrices given as `camera`."""

FILES = {
    "landmarks": (Path("landmarks"),),
    "dictionary": Path("dictionary"),
    "output": Path("result"),
}
"""What stands for the files of the command in messages."""


def fit(
    landmarks: Landmarks | ArrayLike,
    dictionary: Dictionary,
    lam: float | Literal["auto"] = default(FitConfig, "lam"),
    weights: ArrayLike | None = None,
    method: str = default(FitConfig, "method"),
    camera: Mapping[str, Any] | ArrayLike | None = None,
    **options: Any,
) -> Fit:
    """Lift 2D landmarks to 3D shapes; equal bit for bit to what the command `fit` writes.

    landmarks (n, p, 2), NaN where unseen, those of the dictionary in its order, or Landmarks with
    names; weights (n, p) >= 0, 0 = hidden, in place of a confidence; lam and method as `lambda`
    and `method` of the command. camera: matrices (3, 3) or (n, 3, 3) for a refinement under
    perspective, or the section `camera` of the command, where `intrinsics` may be such matrices.
    options are further keys of the command, sections as mappings, such as
    `outliers={"method": "ransac"}` (docs/config.md). Images without a shape are in `failures` of
    the result; what the command warns of is a Python warning. Raises InputError.
    """
    section, matrices = _camera(camera)
    given = {"lambda": lam, "method": method} | ({} if section is None else {"camera": section})
    config = config_of(FitConfig, "fit", given, options, FILES)
    atoms = dictionary_model(dictionary)
    check_given_dictionary(atoms, "dictionary")
    images = _with_weights(landmark_set(landmarks, atoms.landmark_names), weights)
    if matrices is not None:
        extras = Extras.of(dict(images.extras) | {CAMERA: matrices}, len(images))
        images = replace(images, extras=extras)
    plan = plan_fit(config, atoms)
    report = Report(plan.report, atoms)
    records, seconds = [], 0.0
    failures: dict[str, str] = {}
    messages: dict[str, str | Counted] = {text: text for text in plan.warnings}
    with given_source(images, "landmarks", config.input.rename) as source:
        names = name_warnings(source.head.landmark_names, atoms.landmark_names)
        for batch in lift_source(source, plan):
            outcome = report.of(batch)
            records.append(batch.record)
            seconds += batch.seconds
            failures |= {failure.item: failure.reason for failure in outcome.failures}
            for warning in outcome.warnings:
                add_up(messages, warning)
    for message in (*messages.values(), *names, *report.warnings):
        if not isinstance(message, Note):
            warnings.warn(str(message), stacklevel=2)
    whole = concatenate(records)
    attributes = attributes_of(config, {}, seconds, len(whole))
    return fit_of(replace(whole, attributes=attributes), failures)


def _camera(
    camera: Mapping[str, Any] | ArrayLike | None,
) -> tuple[dict[str, Any] | None, np.ndarray[Any, Any] | None]:
    """Return the section `camera` of the config, and matrices that it names."""
    if camera is None:
        return None, None
    section = dict(camera) if isinstance(camera, Mapping) else {"intrinsics": camera}
    section.setdefault("model", "perspective")
    matrices = section.get("intrinsics")
    if matrices is None or isinstance(matrices, str):
        return plain(section), None
    return plain(section | {"intrinsics": CAMERA}), np.asarray(matrices)


def _with_weights(images: LandmarkSet, weights: ArrayLike | None) -> LandmarkSet:
    if weights is None:
        return images
    values = np.asarray(weights, dtype=np.float64)
    expected = (len(images), len(images.landmark_names))
    if values.shape != expected:
        raise input_error("weights", f"has the shape {values.shape}", f"it must be {expected}")
    return replace(images, confidence=values)

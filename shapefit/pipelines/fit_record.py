"""How `fit` lays out what it found, chunk by chunk."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from shapefit.config import FitConfig
from shapefit.dictionary.model import Dictionary
from shapefit.io import LandmarkSet, LandmarkSource, ResultSet
from shapefit.io.extras import Extras, names_apart
from shapefit.io.layout import RESULTS
from shapefit.io.sources import is_csv_target
from shapefit.lifting.lift import Lifting, PerspectiveView
from shapefit.pipelines.landmark_weights import find_seen

if TYPE_CHECKING:
    from shapefit.lifting.path import Path

Floats = NDArray[np.float64]

OF_A_RESULT = RESULTS.names | {
    *("landmarks", "lambda", "residual", "active_atoms", "tight", "outliers"),
    *("path_lambda", "path_objective", "path_relative_gap", "path_residual", "path_active_atoms"),
    *("camera_translation", "focal", "principal_point", "position"),
}
"""Datasets that a fit can write: what came with the landmarks is never mistaken for one of them."""


def as_result(
    images: LandmarkSet,
    lifting: Lifting,
    path: Path | None,
    config: FitConfig,
    dictionary: Dictionary,
) -> ResultSet:
    """Lay out a chunk as it is stored, with the observed landmarks beside the fitted ones."""
    found = lifting.estimate
    failed = np.isnan(lifting.scale)

    def where_fitted(values: Floats | None) -> Floats | None:
        if values is None:
            return None
        shape = (-1,) + (1,) * (values.ndim - 1)
        return np.where(failed.reshape(shape), np.nan, values)

    return ResultSet(
        shapes=lifting.shapes,
        landmarks_fitted=lifting.landmarks_fitted,
        coefficients=where_fitted(found.coefficients),
        rotation=where_fitted(found.rotation),
        translation=lifting.translation,
        scale=lifting.scale,
        objective=where_fitted(found.objective),
        relative_gap=where_fitted(found.relative_gap),
        iterations=found.iterations,
        status=np.array([status.value for status in found.status], dtype=object),
        landmark_names=images.landmark_names,
        items=images.items,
        sequences=images.sequences,
        transforms=where_fitted(found.transforms) if config.transforms else None,
        unit=images.unit,
        y_axis=images.y_axis,
        extras=further_datasets(images, lifting, path, dictionary),
    )


def further_datasets(
    images: LandmarkSet, lifting: Lifting, path: Path | None, dictionary: Dictionary
) -> Extras:
    """Join what came with the landmarks with what only some fits have."""
    found = lifting.estimate
    seen = find_seen(images)[:, None, :]
    own: dict[str, NDArray[Any] | None] = {
        "landmarks": np.where(seen, images.landmarks, np.nan).swapaxes(1, 2),
        "confidence": images.confidence,
        "lambda": lifting.problem.lam,
        "residual": found.residual,
        "active_atoms": found.active_atoms,
        "tight": found.tight,
        "outliers": found.outliers,
    }
    if path is not None:
        own["path_lambda"] = path.lam
        own["path_objective"] = path.objective
        own["path_relative_gap"] = path.relative_gap
        own["path_residual"] = path.residual
        own["path_active_atoms"] = path.active_atoms
    if lifting.perspective is not None:
        own |= perspective_datasets(lifting.perspective, found.coefficients, dictionary)
    present = {name: values for name, values in own.items() if values is not None}
    carried = Extras.of(images.extras, len(images))
    return carried.apart_from(OF_A_RESULT) | present


def find_renamed(source: LandmarkSource, config: FitConfig) -> tuple[str, ...]:
    """Warn of datasets of the landmarks that a result cannot store under their names."""
    names = names_apart(source.further_datasets, OF_A_RESULT)
    stored = [f"{name} is stored as {new}" for name, new in names.items() if new != name]
    if not stored or is_csv_target(config.output):
        return ()
    return (f"datasets of the landmarks are named like those of a result: {', '.join(stored)}",)


def perspective_datasets(
    view: PerspectiveView, coefficients: Floats | None, dictionary: Dictionary
) -> dict[str, NDArray[Any] | None]:
    """Lay out a perspective view; the position is in the unit of a dictionary that has sizes."""
    from shapefit.meshes.dense import metric_scale

    position = None
    if dictionary.atom_scale is not None and coefficients is not None:
        unit = metric_scale(dictionary.atoms, coefficients, dictionary.atom_scale)
        position = unit[:, None] * view.translation
    return {
        "camera_translation": view.translation,
        "focal": view.camera.focal,
        "principal_point": view.camera.centre,
        "position": position,
    }

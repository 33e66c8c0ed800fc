"""How `fit` lays out what it found, chunk by chunk."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats
from shapefit.config import FitConfig
from shapefit.dictionary.model import Dictionary
from shapefit.dictionary.size import has_lengths, knows_size, metres_per_unit
from shapefit.io import LandmarkSet, LandmarkSource, ResultSet
from shapefit.io.extras import METRES_FROM, METRES_PER_UNIT, Extras, names_apart
from shapefit.io.formats import find_target_format
from shapefit.io.layout import RESULTS
from shapefit.lifting.lift import Lifting, PerspectiveView
from shapefit.lifting.methods import METHODS
from shapefit.lifting.verdict import DOUBT, TRUSTED, find_doubts
from shapefit.pipelines.fit.left_out_items import find_left_out
from shapefit.pipelines.fit.searched import with_readings, with_trees

OF_A_RESULT = RESULTS.names | {
    *("landmarks", "lambda", "residual", "active_atoms", "tight", "outliers"),
    *("camera_translation", "focal", "principal_point", "position", "left_out"),
    *("shape_covariance", METRES_PER_UNIT, TRUSTED, DOUBT),
    *(name for method in METHODS.values() for name in method.further),
}
"""Datasets that a fit can write: what came with the landmarks is never mistaken for one of them."""


def as_result(
    images: LandmarkSet,
    lifting: Lifting,
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

    unwanted = find_target_format(config.output).points_only and not config.posterior.csv_deviations
    record = ResultSet(
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
        shape_sd=None if unwanted else scaled_deviation(lifting),
        transforms=where_fitted(found.transforms) if config.transforms else None,
        unit=images.unit,
        y_axis=images.y_axis,
        frame_rate=config.sequences.frame_rate or images.frame_rate,
        attributes=size_attributes(dictionary),
        extras=further_datasets(images, lifting, config, dictionary),
    )
    record = with_trees(with_readings(record, lifting), lifting)
    return with_proof(record, lifting, config) if config.proof else record


def size_attributes(dictionary: Dictionary) -> dict[str, str | float | int]:
    """Say by what the sizes of the shapes in metres were found, where they are known."""
    if not knows_size(dictionary):
        return {}
    return {METRES_FROM: "edges" if has_lengths(dictionary) else "spread"}


def scaled_deviation(lifting: Lifting) -> Floats | None:
    """Return the standard deviations of the shapes (n, 3, p) in the unit of the landmarks."""
    deviation = lifting.estimate.deviation
    return None if deviation is None else lifting.scale[:, None, None] * deviation


def covariance_by_landmark(lifting: Lifting) -> Floats | None:
    """Return the covariance (n, 3p, 3p) of x, y, z of one landmark after the other, likewise."""
    covariance = lifting.estimate.covariance
    if covariance is None:
        return None
    n, d, _ = covariance.shape
    blocks = covariance.reshape(n, 3, d // 3, 3, d // 3).transpose(0, 2, 1, 4, 3)
    return lifting.scale[:, None, None] ** 2 * blocks.reshape(n, d, d)


def with_proof(record: ResultSet, lifting: Lifting, config: FitConfig) -> ResultSet:
    """Add what proves the optimum of the convex program, where the method solves one.

    Images without a shape have no proof: nan, and no transforms.
    """
    proof = lifting.estimate.convex_proof
    if proof is None:
        return record
    failed = np.isnan(lifting.scale)
    active = proof.transforms.any(axis=(2, 3)) & ~failed[:, None]
    optimal = METHODS[config.method].proves == "optimum"
    of_the_program = optimal and lifting.perspective is None
    return replace(
        record,
        dual=np.where(failed[:, None, None], np.nan, proof.dual),
        convex_translation=np.where(failed[:, None], np.nan, proof.translation),
        convex_objective=None if of_the_program else np.where(failed, np.nan, proof.objective),
        convex_relative_gap=(
            None if of_the_program else np.where(failed, np.nan, proof.relative_gap)
        ),
        transform_count=active.sum(axis=1),
        transform_atom=np.nonzero(active)[1],
        active_transforms=proof.transforms[active],
    )


def further_datasets(
    images: LandmarkSet,
    lifting: Lifting,
    config: FitConfig,
    dictionary: Dictionary,
) -> Extras:
    """Join what came with the landmarks with what only some fits have."""
    found = lifting.estimate
    seen = images.seen()[:, None, :]
    own: dict[str, NDArray[Any] | None] = {
        "landmarks": np.where(seen, images.landmarks, np.nan).swapaxes(1, 2),
        "confidence": images.confidence,
        "lambda": lifting.problem.lam,
        "residual": found.residual,
        "active_atoms": found.active_atoms,
        "tight": found.tight,
        "outliers": found.outliers,
        "shape_covariance": covariance_by_landmark(lifting),
        METRES_PER_UNIT: metres_per_unit(lifting.shapes, dictionary),
        **found.further,
        **verdict(images, lifting, config),
    }
    if config.leave_out is not None:
        own["left_out"] = find_left_out(images, config.leave_out, dictionary).astype(object)
    if lifting.perspective is not None:
        own |= perspective_datasets(lifting.perspective, found.coefficients, dictionary)
    present = {name: values for name, values in own.items() if values is not None}
    carried = Extras.of(images.extras, len(images))
    return carried.apart_from(OF_A_RESULT) | present


def verdict(
    images: LandmarkSet, lifting: Lifting, config: FitConfig
) -> dict[str, NDArray[Any] | None]:
    """Say of each image whether its shape is to be trusted, where the method knows its error."""
    found = lifting.estimate
    if found.deviation is None:
        return {}
    doubt = find_doubts(
        np.where(np.isnan(lifting.scale)[:, None, None], np.nan, found.shapes),
        found.deviation,
        images.seen(),
        found.further["plausibility"],
        found.status,
        implausible=config.posterior.implausible,
        widest=config.posterior.widest,
    )
    return {TRUSTED: doubt == "", DOUBT: doubt}


def find_renamed(source: LandmarkSource, config: FitConfig) -> tuple[str, ...]:
    """Warn of datasets of the landmarks that a result cannot store under their names."""
    names = names_apart(source.further_datasets, OF_A_RESULT)
    stored = [f"{name} is stored as {new}" for name, new in names.items() if new != name]
    if not stored or find_target_format(config.output).points_only:
        return ()
    return (f"datasets of the landmarks have names that a result uses: {', '.join(stored)}",)


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

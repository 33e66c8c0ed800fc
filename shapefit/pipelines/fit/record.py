"""The record of a fit: what was found in a batch of images, as it is stored."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats
from shapefit.dictionary.bodies import has_lengths, knows_size, metres_per_unit
from shapefit.dictionary.model import Dictionary
from shapefit.io import LandmarkSet, ResultSet
from shapefit.io.layout import METRES_FROM, METRES_PER_UNIT, RESULTS, free_names
from shapefit.lifting.expected_error import EXPECTED_ERROR, expected_error
from shapefit.lifting.lift import Lifting, PerspectiveView
from shapefit.lifting.methods import METHODS
from shapefit.lifting.verdict import (
    P_VALUE,
    REASONS,
    SIDES,
    START_DISTANCE,
    TRUSTED,
    find_reasons,
)
from shapefit.pipelines.fit.lift import find_left_out

if TYPE_CHECKING:
    from shapefit.pipelines.fit.prepare import Setup

OF_A_RESULT = RESULTS.all.keys()
"""Datasets that a fit can write: what came with the landmarks is never mistaken for one of them."""


def as_result(
    images: LandmarkSet, lifting: Lifting, setup: Setup, inputs: Mapping[str, NDArray[Any]]
) -> ResultSet:
    """Lay out a batch as it is stored, with the observed landmarks beside the fitted ones.

    inputs are the landmarks of the files in 3D, where they are not those of the dictionary.
    """
    config, found = setup.config, lifting.estimate
    bars = found.in_unit(lifting.scale[:, None, None])
    failed = np.isnan(lifting.scale)

    def where_fitted(values: Floats | None) -> Floats | None:
        if values is None or not failed.any():
            return values
        shape = (-1,) + (1,) * (values.ndim - 1)
        return np.where(failed.reshape(shape), np.nan, values)

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
        status=found.status_words(),
        landmark_names=images.landmark_names,
        items=images.items,
        sequences=images.sequences,
        shape_sd=bars.deviation,
        transforms=None,
        unit=images.unit,
        y_axis=images.y_axis,
        frame_rate=config.frame_rate or images.frame_rate,
        attributes=size_attributes(setup.dictionary),
        **further_datasets(images, lifting, setup, inputs, bars.covariance),
    )
    return with_proof(record, lifting, config.method) if config.saves_proof else record


def size_attributes(dictionary: Dictionary) -> dict[str, str | float | int]:
    """Return attributes that say how the sizes in metres were found, where they are known."""
    if not knows_size(dictionary):
        return {}
    return {METRES_FROM: "edges" if has_lengths(dictionary) else "spread"}


def by_landmark(covariance: Floats | None) -> Floats | None:
    """Return a covariance (n, 3p, 3p) with x, y, z of one landmark after the other."""
    if covariance is None:
        return None
    n, d, _ = covariance.shape
    blocks = covariance.reshape(n, 3, d // 3, 3, d // 3).transpose(0, 2, 1, 4, 3)
    return blocks.reshape(n, d, d)


def with_proof(record: ResultSet, lifting: Lifting, method: str) -> ResultSet:
    """Add what proves the optimum of the convex program, where the method solves one.

    Where that program is the method, the result states its objective and gap. Images without a
    shape have no proof: nan, and no transforms.
    """
    proof = lifting.estimate.convex_proof
    if proof is None:
        return record
    failed = np.isnan(lifting.scale)
    M = proof.transforms
    if failed.any():
        kept = ~failed[M.image]
        M = replace(M, count=np.where(failed, 0, M.count), atom=M.atom[kept], blocks=M.blocks[kept])
    of_the_program = METHODS[method].proves == "optimum" and lifting.perspective is None
    return record.replaced(
        dual=np.where(failed[:, None, None], np.nan, proof.dual),
        convex_translation=np.where(failed[:, None], np.nan, proof.translation),
        convex_objective=None if of_the_program else np.where(failed, np.nan, proof.objective),
        convex_relative_gap=(
            None if of_the_program else np.where(failed, np.nan, proof.relative_gap)
        ),
        transform_count=M.count,
        transform_atom=M.atom,
        active_transforms=M.blocks,
    )


def further_datasets(
    images: LandmarkSet,
    lifting: Lifting,
    setup: Setup,
    inputs: Mapping[str, NDArray[Any]],
    covariance: Floats | None,
) -> dict[str, dict[str, NDArray[Any]]]:
    """Join what came with the landmarks with what only some fits have: `columns` and `whole`."""
    found, dictionary = lifting.estimate, setup.dictionary
    seen = images.seen()[:, None, :]
    own: dict[str, NDArray[Any] | None] = {
        "landmarks": np.where(seen, images.landmarks, np.nan).swapaxes(1, 2),
        "confidence": images.confidence,
        "lambda": lifting.problem.lam,
        "residual": found.residual,
        "active_atoms": found.active_atoms,
        "tight": found.tight,
        "outliers": found.outliers,
        "shape_covariance": by_landmark(covariance) if setup.config.save.covariance else None,
        METRES_PER_UNIT: metres_per_unit(lifting.shapes, dictionary),
        **found.further,
        **verdict(lifting, setup),
    }
    if setup.config.leave_one_out is not None:
        own["left_out"] = find_left_out(images, setup.lifter).astype(object)
    if lifting.perspective is not None:
        own |= perspective_datasets(lifting.perspective, found.coefficients, dictionary)
    present = {name: values for name, values in own.items() if values is not None}
    names = free_names(images.further, OF_A_RESULT)
    carried = {names[name]: v for name, v in images.per_item.items() if name in names}
    whole = {names[name]: values for name, values in images.whole.items()}
    whole |= {} if dictionary.edges is None else {"edges": dictionary.edges}
    return {"columns": {**carried, **present, **inputs}, "whole": whole}


def verdict(lifting: Lifting, setup: Setup) -> dict[str, NDArray[Any] | None]:
    """Say of each image whether its shape is to be trusted, where the method knows its error.

    From what the result stores, and the error that is to be expected.
    """
    bars = lifting.estimate.in_unit(lifting.scale[:, None, None])
    if bars.deviation is None:
        return {}
    further = bars.further
    reasons = find_reasons(
        lifting.shapes,
        bars.deviation,
        np.isfinite(further["inlier_probability"]).sum(axis=1),
        further[P_VALUE],
        further[START_DISTANCE],
        bars.status,
        sides=further.get(SIDES),
        depth_ambiguity=setup.dictionary.depth_ambiguity,
    )
    if setup.estimates.doubt:
        reasons[reasons == ""] = setup.estimates.doubt
    found: dict[str, NDArray[Any] | None] = {TRUSTED: reasons == "", REASONS: reasons}
    if bars.covariance is not None:
        found[EXPECTED_ERROR] = expected_error(lifting.shapes, bars.covariance)
    return found


def warn_of_names(datasets: Iterable[str]) -> tuple[str, ...]:
    """Warn of datasets of the landmarks that a result cannot store under their names."""
    names = free_names(datasets, OF_A_RESULT)
    stored = [f"{name} is stored as {new}" for name, new in names.items() if new != name]
    if not stored:
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

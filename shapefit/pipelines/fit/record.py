"""The record of a fit: what a batch of images is stored as."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from shapefit import __version__
from shapefit.arrays import Floats
from shapefit.dictionary.bodies import has_lengths, knows_size, metres_per_unit
from shapefit.dictionary.model import Dictionary
from shapefit.io import LandmarkSet, ResultSet
from shapefit.io.layout import METRES_FROM, METRES_PER_UNIT, RESULTS, free_names
from shapefit.lifting.estimate import Estimate
from shapefit.lifting.lift import Lifting, PerspectiveView
from shapefit.lifting.methods import METHODS
from shapefit.lifting.trust import (
    EXPECTED_ERROR,
    GAIN,
    IMAGE_ERROR,
    P_VALUE,
    REASONS,
    SIDES,
    START_DISTANCE,
    TRUSTED,
    expected_error,
    find_reasons,
)
from shapefit.pipelines.fit.lift import find_omitted

if TYPE_CHECKING:
    from shapefit.pipelines.fit.prepare import Setup

Datasets = dict[str, NDArray[Any] | None]

OF_A_RESULT = RESULTS.all.keys()
"""Datasets that a fit can write: what came with the landmarks is never mistaken for one of them."""


def as_result(
    images: LandmarkSet, lifting: Lifting, setup: Setup, inputs: Mapping[str, NDArray[Any]]
) -> ResultSet:
    """Lay out a batch as it is stored, with the observed landmarks and what came with them.

    inputs are the landmarks of the files in 3D, where they are not those of the dictionary.
    """
    estimate, dictionary = lifting.estimate, setup.dictionary
    scaled = estimate.in_unit(lifting.scale[:, None, None])
    failed = np.isnan(lifting.scale)

    def blank(values: Floats | None) -> Floats | None:
        """Return values that are nan where an image has no shape."""
        if values is None or not failed.any():
            return values
        return np.where(failed.reshape(-1, *(1,) * (values.ndim - 1)), np.nan, values)

    visible = images.visible()[:, None, :]
    datasets: Datasets = {
        "landmarks": np.where(visible, images.landmarks, np.nan).swapaxes(1, 2),
        "landmarks_fitted": lifting.landmarks_fitted if is_projected(lifting, setup) else None,
        "confidence": images.confidence,
        "lambda": lifting.problem.lam,
        "coefficients": blank(estimate.coefficients),
        "rotation": blank(estimate.rotation),
        "objective": blank(estimate.objective),
        "relative_gap": blank(estimate.relative_gap),
        "residual": estimate.residual,
        "active_atoms": estimate.active_atoms,
        "tight": estimate.tight,
        "outliers": estimate.outliers,
        METRES_PER_UNIT: metres_per_unit(lifting.shapes, dictionary),
        **estimate.further,
        **verdict(lifting, scaled, setup),
    }
    if setup.config.save.covariance:
        datasets["shape_covariance"] = by_landmark(scaled.covariance)
    if setup.config.leave_one_out is not None:
        datasets["omitted"] = find_omitted(images, setup.lifter).astype(object)
    if lifting.perspective is not None:
        datasets |= perspective_datasets(lifting.perspective, estimate.coefficients, dictionary)
    if setup.config.saves_proof:
        datasets |= proof(lifting, setup.config.method, blank)
    names = free_names(images.further, OF_A_RESULT)
    carried = {names[name]: v for name, v in images.per_item.items() if name in names}
    whole = {names[name]: values for name, values in images.whole.items() if name in names}
    whole |= {} if dictionary.edges is None else {"edges": dictionary.edges}
    present = {name: values for name, values in datasets.items() if values is not None}
    return ResultSet(
        shapes=lifting.shapes,
        shape_sd=scaled.deviation,
        translation=lifting.translation,
        scale=lifting.scale,
        iterations=estimate.iterations,
        status=estimate.status_words(),
        landmark_names=images.landmark_names,
        items=images.items,
        sequences=images.sequences,
        unit=images.unit,
        y_axis=images.y_axis,
        frame_rate=setup.config.frame_rate or images.frame_rate,
        attributes=size_attributes(dictionary),
        columns={**carried, **present, **inputs},
        whole=whole,
    )


def is_projected(lifting: Lifting, setup: Setup) -> bool:
    """Whether the shapes are seen elsewhere than at their x and y."""
    return lifting.perspective is not None or setup.mapped.moves


def size_attributes(dictionary: Dictionary) -> dict[str, str | float | int]:
    """Return attributes that say how the sizes in metres were found, where they are known."""
    if not knows_size(dictionary):
        return {}
    return {METRES_FROM: "edges" if has_lengths(dictionary) else "spread"}


def verdict(lifting: Lifting, scaled: Estimate, setup: Setup) -> Datasets:
    """Decide for each image whether its shape is to be trusted, where the method knows its error.

    From what the result stores: scaled, error bars in its unit. With the error that is expected.
    """
    if scaled.deviation is None:
        return {}
    further, expected = scaled.further, np.full(len(lifting.shapes), np.nan)
    if scaled.covariance is not None:
        expected = expected_error(lifting.shapes, scaled.covariance)
        expected = np.fmax(expected, GAIN * further.get(IMAGE_ERROR, np.nan))
    reasons = find_reasons(
        lifting.shapes,
        expected,
        np.isfinite(further["inlier_probability"]).sum(axis=1),
        further[P_VALUE],
        further[START_DISTANCE],
        scaled.status,
        sides=further.get(SIDES),
        depth_ambiguity=setup.dictionary.depth_ambiguity,
    )
    if setup.estimates.reason:
        reasons[reasons == ""] = setup.estimates.reason
    return {TRUSTED: reasons == "", REASONS: reasons, EXPECTED_ERROR: expected}


def by_landmark(covariance: Floats | None) -> Floats | None:
    """Return a covariance (n, 3p, 3p) with x, y, z of one landmark after the other."""
    if covariance is None:
        return None
    n, d, _ = covariance.shape
    blocks = covariance.reshape(n, 3, d // 3, 3, d // 3).transpose(0, 2, 1, 4, 3)
    return blocks.reshape(n, d, d)


def perspective_datasets(
    view: PerspectiveView, coefficients: Floats | None, dictionary: Dictionary
) -> Datasets:
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


def proof(lifting: Lifting, method: str, blank: Any) -> Datasets:
    """Lay out what proves the optimum of the convex program, where the method solves one.

    Where that program is the method, the result states its objective and gap. Images without a
    shape have no proof: nan, and no transforms.
    """
    certificate = lifting.estimate.convex_proof
    if certificate is None:
        return {}
    failed, M = np.isnan(lifting.scale), certificate.transforms
    if failed.any():
        retained = ~failed[M.image]
        M = replace(
            M, count=np.where(failed, 0, M.count), atom=M.atom[retained], blocks=M.blocks[retained]
        )
    of_start = METHODS[method].proves != "optimum" or lifting.perspective is not None
    return {
        "dual": blank(certificate.dual),
        "convex_translation": blank(certificate.translation),
        "convex_objective": blank(certificate.objective) if of_start else None,
        "convex_relative_gap": blank(certificate.relative_gap) if of_start else None,
        "transform_count": M.count,
        "transform_atom": M.atom,
        "active_transforms": M.blocks,
    }


def attributes_of(
    setup: Setup, inputs: Mapping[str, str], seconds: float, images: int
) -> dict[str, str | float | int]:
    """Return what is stored of a fit beside its images; `inputs` are the digests of its files.

    `training_inputs` are those of the files that the dictionary was learned from: `eval` warns
    where one of them is the truth. `estimated` lists what was found or assumed before lifting.
    """
    config = setup.config.as_json()
    return {
        "method": setup.config.method,
        "version": __version__,
        "config": config,
        "config_digest": hashlib.sha256(config.encode()).hexdigest(),
        "inputs": json.dumps(inputs),
        "estimated": "; ".join(setup.estimates.lines),
        **{name: value for name, value in setup.estimates.numbers.items() if value == value},
        "training_inputs": setup.dictionary.provenance.get("inputs", "{}"),
        "solve_seconds": seconds,
        "images_per_second": images / seconds if seconds > 0 else 0.0,
    }

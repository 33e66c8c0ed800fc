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
from shapefit.arrays import Flags, Floats
from shapefit.dictionary.bodies import has_lengths, knows_size, metres_per_unit
from shapefit.io import LandmarkSet, ResultSet
from shapefit.io.layout import METRES_FROM, METRES_PER_UNIT, RESULTS, free_names
from shapefit.lifting import trust
from shapefit.lifting.estimate import Estimate
from shapefit.lifting.lift import Lifting
from shapefit.lifting.methods import METHODS
from shapefit.pipelines.fit.lift import find_omitted

if TYPE_CHECKING:
    from shapefit.pipelines.fit.prepare import Setup

Datasets = Mapping[str, NDArray[Any] | None]


def as_result(
    images: LandmarkSet, lifting: Lifting, setup: Setup, inputs: Mapping[str, NDArray[Any]]
) -> ResultSet:
    """Lay out a batch as it is stored, with what came with its landmarks.

    inputs are the landmarks of the files in 3D, where they are not those of the dictionary.
    """
    estimate, dictionary, config = lifting.estimate, setup.dictionary, setup.config
    scaled, failed = estimate.in_unit(lifting.scale[:, None, None]), np.isnan(lifting.scale)
    projected = lifting.perspective is not None or setup.matched.moves
    datasets: Datasets = {
        "landmarks": np.where(images.visible()[:, None], images.landmarks, np.nan).swapaxes(1, 2),
        "landmarks_fitted": lifting.landmarks_fitted if projected else None,
        "confidence": images.confidence,
        "lambda": lifting.problem.lam,
        "coefficients": blank(estimate.coefficients, failed),
        "rotation": blank(estimate.rotation, failed),
        "objective": blank(estimate.objective, failed),
        "relative_gap": blank(estimate.relative_gap, failed),
        "residual": estimate.residual,
        "active_atoms": estimate.active_atoms,
        "tight": estimate.tight,
        "outliers": estimate.outliers,
        METRES_PER_UNIT: metres_per_unit(lifting.shapes, dictionary),
        **estimate.further,
        **trusted(lifting, scaled, setup),
        **of_camera(lifting, setup),
        **(proof(lifting, config.method, failed) if config.save.proof else {}),
        "shape_covariance": by_landmark(scaled.covariance) if config.save.covariance else None,
    }
    stored = {name: values for name, values in datasets.items() if values is not None}
    if config.leave_one_out is not None:
        stored["omitted"] = find_omitted(images, setup.lifter).astype(object)
    free = free_names(images.further, RESULTS.all.keys())
    carried = {free[name]: v for name, v in images.per_item.items() if name in free}
    whole = {free[name]: values for name, values in images.whole.items() if name in free}
    whole |= {} if dictionary.edges is None else {"edges": dictionary.edges}
    sizes = {METRES_FROM: "edges" if has_lengths(dictionary) else "spread"}
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
        frame_rate=config.frame_rate or images.frame_rate,
        attributes=sizes if knows_size(dictionary) else {},
        columns={**carried, **stored, **inputs},
        whole=whole,
    )


def blank(values: Floats | None, failed: Flags) -> Floats | None:
    """Return values (n, ...) that are nan where an image has no shape: failed (n,)."""
    if values is None or not failed.any():
        return values
    return np.where(failed.reshape(-1, *(1,) * (values.ndim - 1)), np.nan, values)


def trusted(lifting: Lifting, scaled: Estimate, setup: Setup) -> Datasets:
    """Decide which shapes are to be trusted, by error bars in the unit of the result (scaled)."""
    if scaled.deviation is None:
        return {}
    further, expected = scaled.further, np.full(len(lifting.shapes), np.nan)
    if scaled.covariance is not None:
        expected = trust.expected_error(lifting.shapes, scaled.covariance)
        of_image = further.get(trust.IMAGE_ERROR, np.nan)
        expected = np.fmax(expected, trust.GAIN * of_image)
    reasons = trust.find_reasons(
        lifting.shapes,
        expected,
        np.isfinite(further["inlier_probability"]).sum(axis=1),
        further[trust.P_VALUE],
        further[trust.START_DISTANCE],
        scaled.status,
        sides=further.get(trust.SIDES),
        depth_ambiguity=setup.dictionary.depth_ambiguity,
    )
    reasons[reasons == ""] = setup.estimates.reason
    names = (trust.TRUSTED, trust.REASONS, trust.EXPECTED_ERROR)
    return dict(zip(names, (reasons == "", reasons, expected), strict=True))


def by_landmark(covariance: Floats | None) -> Floats | None:
    """Return a covariance (n, 3p, 3p) with x, y, z of one landmark after the other."""
    if covariance is None:
        return None
    n, d, _ = covariance.shape
    blocks = covariance.reshape(n, 3, d // 3, 3, d // 3).transpose(0, 2, 1, 4, 3)
    return blocks.reshape(n, d, d)


def of_camera(lifting: Lifting, setup: Setup) -> Datasets:
    """Lay out a perspective view; the position is in the unit of a dictionary that has sizes."""
    view, dictionary, position = lifting.perspective, setup.dictionary, None
    if view is None:
        return {}
    coefficients = lifting.estimate.coefficients
    if dictionary.atom_scale is not None and coefficients is not None:
        from shapefit.meshes.dense import metric_scale

        unit = metric_scale(dictionary.atoms, coefficients, dictionary.atom_scale)
        position = unit[:, None] * view.translation
    return {
        "camera_translation": view.translation,
        "focal": view.camera.focal,
        "principal_point": view.camera.centre,
        "position": position,
    }


def proof(lifting: Lifting, method: str, failed: Flags) -> Datasets:
    """Lay out what proves the optimum of the convex program; images that failed (n,) have nan."""
    certificate = lifting.estimate.convex_proof
    if certificate is None:
        return {}
    M = certificate.transforms
    if failed.any():
        retained, count = ~failed[M.image], np.where(failed, 0, M.count)
        M = replace(M, count=count, atom=M.atom[retained], blocks=M.blocks[retained])
    datasets = {
        "dual": blank(certificate.dual, failed),
        "convex_translation": blank(certificate.translation, failed),
        "transform_count": M.count,
        "transform_atom": M.atom,
        "active_transforms": M.blocks,
    }
    if METHODS[method].proves != "optimum" or lifting.perspective is not None:
        datasets["convex_objective"] = blank(certificate.objective, failed)
        datasets["convex_relative_gap"] = blank(certificate.relative_gap, failed)
    return datasets


def attributes_of(setup: Setup, inputs: Mapping[str, str]) -> dict[str, str | float | int]:
    """Return what is stored of a fit beside its images; `inputs` are the digests of its files."""
    config, numbers = setup.config.as_json(), setup.estimates.numbers
    return {
        "method": setup.config.method,
        "version": __version__,
        "config": config,
        "config_digest": hashlib.sha256(config.encode()).hexdigest(),
        "inputs": json.dumps(inputs),
        "estimated": "; ".join(setup.estimates.lines),
        **{name: value for name, value in numbers.items() if value == value},
        "training_inputs": setup.dictionary.provenance.get("inputs", "{}"),
    }

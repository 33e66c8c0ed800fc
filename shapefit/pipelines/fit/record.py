"""A batch as it is stored, and what is stored of a fit beside its images."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from shapefit import __version__
from shapefit.arrays import Floats
from shapefit.config import FitConfig
from shapefit.dictionary.bodies import has_lengths, knows_size, metres_per_unit
from shapefit.dictionary.model import Dictionary
from shapefit.io.layout import FOCAL_ASSUMED, METRES_FROM, free_names
from shapefit.lifting.estimate import AtomEstimate, Estimate
from shapefit.lifting.lift import Lifting
from shapefit.pipelines.fit.columns import as_rows, blank_failed
from shapefit.pipelines.fit.family import Calibration, LiftedImages
from shapefit.pipelines.joints import DetectorShapes
from shapefit.records import Fit, Landmarks
from shapefit.records.columns import Array, columns_of

if TYPE_CHECKING:
    from shapefit.pipelines.fit.fit import FitPlan


def to_record(images: Landmarks, lifted: LiftedImages, plan: FitPlan) -> Fit:
    """Return the record of a lifted batch, with the extras of its images."""
    lifting = lifted.lifting
    estimate = lifting.estimate
    dictionary = plan.match.dictionary
    failed = np.isnan(lifting.scale)
    visible = images.visible()[..., None]
    extras, file_extras = extras_of_fit(images)
    fit = Fit(
        lifting.shapes.swapaxes(1, 2),
        landmark_names=images.landmark_names,
        items=images.items,
        sequences=images.sequences,
        frames=images.frames,
        times=images.times,
        edges=images.edges if dictionary.edges is None else dictionary.edges,
        unit=images.unit,
        y_axis=images.y_axis,
        frame_rate=plan.config.frame_rate or images.frame_rate,
        landmarks=np.where(visible, images.landmarks, np.nan),
        confidence=images.confidence,
        lam=lifting.problem.lam,
        rotation=blank_failed(estimate.rotation, failed),
        translation=lifting.translation,
        scale=lifting.scale,
        objective=blank_failed(estimate.objective, failed),
        residual=estimate.residual,
        iterations=estimate.iterations,
        status=estimate.status_words(),
        outliers=estimate.outliers,
        omitted=None if lifted.omitted is None else lifted.omitted.astype(object),
        metres_per_unit=metres_per_unit(lifting.shapes, dictionary),
        stated_height=stated_height(plan.config, len(images)),
        attributes=size_attributes(dictionary),
        extras=extras,
        file_extras=file_extras,
    )
    if lifting.perspective is not None or plan.match.has_displaced:
        fit = replace(fit, landmarks_fitted=as_rows(lifting.landmarks_fitted))
    fit = with_camera(fit, lifting, dictionary)
    fit = with_detected(fit, lifted.detected)
    return plan.family.add_columns(fit, lifting)


Carried = dict[str, Array]
"""Datasets that came with landmarks, by the names that they get."""


def extras_of_fit(images: Landmarks) -> tuple[Carried, Carried]:
    """Return the extras of landmarks that a fit keeps: per image, and of the file.

    One whose name a dataset of a result has gets another name.
    """
    taken = {column.name for column in columns_of(Fit)}
    free = free_names([*images.extras, *images.file_extras], taken)
    extras = {free[name]: values for name, values in images.extras.items()}
    of_file = {free[name]: values for name, values in images.file_extras.items()}
    return extras, of_file


def stated_height(config: FitConfig, images: int) -> Floats | None:
    """Return the height (n,) in metres that the config states for all, else None."""
    return None if config.height is None else np.full(images, config.height)


def with_camera(fit: Fit, lifting: Lifting[Estimate], dictionary: Dictionary) -> Fit:
    """Add camera and positions to a fit in perspective; return others unchanged.

    Positions are in the unit of the dictionary, None where it has no sizes.
    """
    view = lifting.perspective
    if view is None:
        return fit
    return replace(
        fit,
        camera_translation=view.translation,
        focal=view.camera.focal,
        principal_point=view.camera.centre,
        position=find_position(lifting, dictionary),
    )


def with_detected(fit: Fit, detected: DetectorShapes | None) -> Fit:
    """Add a detector's landmarks in 3D to a fit, if they are not the joints."""
    if detected is None:
        return fit
    return replace(
        fit,
        input_landmark_names=detected.names,
        input_shapes=detected.shapes,
        input_shape_sd=detected.sd,
        input_shape_correlation=detected.correlation,
    )


def find_position(
    lifting: Lifting[Estimate], dictionary: Dictionary
) -> NDArray[np.float64] | None:
    """Return positions (n, 3) of objects in the frame of the camera, None if unknown.

    They are in the dictionary's unit.
    """
    view = lifting.perspective
    estimate = lifting.estimate
    if view is None or dictionary.atom_scale is None:
        return None
    if not isinstance(estimate, AtomEstimate) or estimate.coefficients is None:
        return None
    from shapefit.meshes.dense import metric_scale

    unit = metric_scale(dictionary.atoms, estimate.coefficients, dictionary.atom_scale)
    return unit[:, None] * view.translation


def size_attributes(dictionary: Dictionary) -> dict[str, str]:
    """Return the attribute that names the source of metres, {} without a known size.

    That is "edges" for lengths of bones, or "spread" for the size of the whole shape.
    """
    if not knows_size(dictionary):
        return {}
    return {METRES_FROM: "edges" if has_lengths(dictionary) else "spread"}


def provenance(
    plan: FitPlan, inputs: Mapping[str, str]
) -> dict[str, str | float | int]:
    """Return the attributes of a result: method, version, config and calibration.

    `inputs` are the digests of the files of the fit.
    """
    config = plan.config.as_json()
    calibration = plan.calibration
    dictionary = plan.match.dictionary
    numbers = {
        name: value
        for name, value in calibration.numbers.items()
        if not math.isnan(value)
    }
    return {
        "method": plan.config.method,
        "version": __version__,
        "config": config,
        "config_digest": hashlib.sha256(config.encode()).hexdigest(),
        "inputs": json.dumps(inputs),
        "estimated": "; ".join(calibration.lines),
        **assumed_camera(calibration),
        **numbers,
        **shown_landmarks(calibration, dictionary),
        "training_inputs": dictionary.provenance.get("inputs", "{}"),
    }


def assumed_camera(calibration: Calibration) -> dict[str, float]:
    """Return the attribute with the focal length that was assumed, {} if none was.

    Only an assumed camera is settled as a number.
    """
    focal = calibration.camera.get("focal")
    return {FOCAL_ASSUMED: focal} if isinstance(focal, int | float) else {}


def shown_landmarks(calibration: Calibration, dictionary: Dictionary) -> dict[str, str]:
    """Return the attribute with the landmarks that most images show, {} if unknown."""
    names = dictionary.landmark_names
    both = zip(names, calibration.shown, strict=False)
    shown = [name for name, seen in both if seen]
    return {"shown_landmarks": " ".join(shown)} if shown else {}

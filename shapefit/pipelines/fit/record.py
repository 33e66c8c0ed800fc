"""A batch as it is stored, and what is stored of a fit beside its images."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from shapefit import __version__
from shapefit.dictionary.bodies import has_lengths, knows_size, metres_per_unit
from shapefit.dictionary.model import Dictionary
from shapefit.io import LandmarkSet, ResultSet
from shapefit.io.layout import (
    FRAME,
    LANDMARKS,
    METRES_FROM,
    METRES_PER_UNIT,
    RESULTS,
    STATED_HEIGHT,
    TIME,
    free_names,
)
from shapefit.lifting.estimate import AtomEstimate, Estimate
from shapefit.lifting.lift import Lifting
from shapefit.pipelines.fit.columns import Columns, blank
from shapefit.pipelines.fit.family import Calibration, Lifted

if TYPE_CHECKING:
    from shapefit.pipelines.fit.fit import Plan


def to_record(images: LandmarkSet, lifted: Lifted, plan: Plan) -> ResultSet:
    """Lay out a batch as it is stored, with what came with its landmarks."""
    lifting = lifted.lifting
    estimate = lifting.estimate
    config = plan.config
    dictionary = plan.match.dictionary
    failed = np.isnan(lifting.scale)
    visible = images.visible()[:, None]
    projected = lifting.perspective is not None or plan.match.moves
    height = None if config.height is None else np.full(len(images), config.height)
    columns: Columns = {
        "landmarks": np.where(visible, images.landmarks, np.nan).swapaxes(1, 2),
        "landmarks_fitted": lifting.landmarks_fitted if projected else None,
        "confidence": images.confidence,
        FRAME: images.frame,
        TIME: images.time,
        "lambda": lifting.problem.lam,
        "rotation": blank(estimate.rotation, failed),
        "objective": blank(estimate.objective, failed),
        "residual": estimate.residual,
        "outliers": estimate.outliers,
        METRES_PER_UNIT: metres_per_unit(lifting.shapes, dictionary),
        STATED_HEIGHT: height,
        **camera_columns(lifting, dictionary),
        **plan.family.columns(images, lifting),
        **lifted.detector,
    }
    carried, of_file = carry(images)
    if dictionary.edges is not None:
        of_file["edges"] = dictionary.edges
    return ResultSet(
        shapes=lifting.shapes,
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
        attributes=size_attributes(dictionary),
        columns={
            **carried,
            **{name: v for name, v in columns.items() if v is not None},
        },
        whole=of_file,
    )


def carry(
    images: LandmarkSet,
) -> tuple[dict[str, NDArray[Any]], dict[str, NDArray[Any]]]:
    """Return what came with the landmarks, of each image and of the file, under names
    that no dataset of a result has.
    """
    others = [name for name in images.further if name not in LANDMARKS.further]
    free = free_names(others, RESULTS.all.keys())
    per_item = {free[name]: v for name, v in images.per_item.items() if name in free}
    of_file = {free[name]: v for name, v in images.whole.items() if name in free}
    return per_item, of_file


def camera_columns(lifting: Lifting[Estimate], dictionary: Dictionary) -> Columns:
    """Lay out a perspective view; the position is in the unit of a dictionary that has
    sizes.
    """
    view = lifting.perspective
    if view is None:
        return {}
    return {
        "camera_translation": view.translation,
        "focal": view.camera.focal,
        "principal_point": view.camera.centre,
        "position": find_position(lifting, dictionary),
    }


def find_position(
    lifting: Lifting[Estimate], dictionary: Dictionary
) -> NDArray[np.float64] | None:
    """Return where objects stand before the camera (n, 3), None without sizes."""
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
    """Say by what the size of shapes in metres is found, where it is known."""
    if not knows_size(dictionary):
        return {}
    return {METRES_FROM: "edges" if has_lengths(dictionary) else "spread"}


def provenance(plan: Plan, inputs: Mapping[str, str]) -> dict[str, str | float | int]:
    """Return what is stored of a fit beside its images; `inputs` are the digests of its
    files.
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
        **numbers,
        **shown_landmarks(calibration, dictionary),
        "training_inputs": dictionary.provenance.get("inputs", "{}"),
    }


def shown_landmarks(calibration: Calibration, dictionary: Dictionary) -> dict[str, str]:
    """Return the names of the landmarks whose errors are expected ones, where known."""
    names = dictionary.landmark_names
    both = zip(names, calibration.shown, strict=False)
    shown = [name for name, seen in both if seen]
    return {"shown_landmarks": " ".join(shown)} if shown else {}

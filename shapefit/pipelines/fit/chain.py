"""The chain of `fit`, from landmarks to 3D shapes, step by step."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats
from shapefit.dictionary.model import Dictionary
from shapefit.errors import input_error
from shapefit.io import LandmarkSet
from shapefit.io.layout import LANDMARK_COVARIANCE
from shapefit.lifting.estimate import Estimator
from shapefit.lifting.lift import Lifting, Program, fail_nonfinite, lift

if TYPE_CHECKING:
    from shapefit.geometry.pinhole import Camera
    from shapefit.pipelines.fit.outlier_search import Agreement

Lifter = Callable[[LandmarkSet, Dictionary], Lifting]
"""Lifts images, whose landmarks are those of the dictionary."""

Search = Callable[[LandmarkSet, Floats, Dictionary], "Agreement"]
View = Callable[[Lifting, LandmarkSet, Dictionary], Lifting]
Refinement = Callable[[Lifting, LandmarkSet], Lifting]


@dataclass(frozen=True, kw_only=True)
class Chain:
    """What was chosen for each step of a fit; None for a step that it goes without.

    aside (p,) are landmarks that are lifted without what images show of them, see place_aside.

    What only some fits need is imported where it is chosen: before the clock of solving starts.
    """

    leave_out: Callable[[LandmarkSet, Dictionary, Lifter], Lifting] | None
    weigh: Callable[[LandmarkSet], Floats]
    aside: NDArray[np.bool_] | None
    search: Search | None
    program: Program
    precisions: bool
    method: Callable[[Dictionary], Estimator]
    camera: Callable[[LandmarkSet], Camera] | None
    view: View | None
    sequences: Refinement | None


def fit_images(images: LandmarkSet, dictionary: Dictionary, chain: Chain) -> Lifting:
    """From the landmarks of a chunk of images to their shapes: the chain of `fit`.

    The images have the landmarks of the dictionary. Where a model is left out, groups of images
    go through `lift_images` with the atoms that are theirs; else all go with all atoms.
    """
    if chain.leave_out is None:
        lifting = lift_images(images, dictionary, chain)
    else:
        lifting = chain.leave_out(images, dictionary, partial(lift_images, chain=chain))
    if chain.sequences is not None:
        lifting = chain.sequences(lifting, images)
    return fail_nonfinite(lifting)


def lift_images(images: LandmarkSet, dictionary: Dictionary, chain: Chain) -> Lifting:
    """Weigh the landmarks, set outliers aside, lift, and refine as the camera sees it."""
    weights = chain.weigh(images)
    if chain.aside is not None:
        weights = np.where(chain.aside, 0.0, weights)
    agreed = None if chain.search is None else chain.search(images, weights, dictionary)
    if agreed is not None:
        weights = np.where(agreed.inliers, weights, 0.0)
    lifting = lift(
        images.landmarks,
        weights,
        dictionary.atoms,
        chain.program,
        chain.method(dictionary),
        find_covariance(images) if chain.precisions else None,
        None if chain.camera is None else chain.camera(images),
    )
    if agreed is not None:
        lifting = agreed.label(lifting)
    if chain.view is not None:
        lifting = chain.view(lifting, images, dictionary)
    return lifting


def weigh_seen(images: LandmarkSet, least: float) -> Floats:
    """Weights (n, p): 1 where the confidence is `least` or more, 0 elsewhere.

    A score says how sure a detector is that a landmark is where it found it, not how exactly.
    Landmarks with covariances keep their confidences.
    """
    weights = images.weights()
    if LANDMARK_COVARIANCE in images.columns:
        return weights
    return ((weights > 0) & (weights >= least)).astype(np.float64)


def find_covariance(images: LandmarkSet) -> Floats | None:
    """Return the covariance (n, p, 2, 2) of the landmarks that came with them, if it did.

    Raises InputError where the dataset holds no covariances.
    """
    name = LANDMARK_COVARIANCE
    values = images.columns.get(name)
    if values is None:
        return None
    shape = (len(images), len(images.landmark_names), 2, 2)
    fix = "give each landmark a symmetric, positive semi-definite 2 x 2 matrix"
    if np.shape(values) != shape:
        raise input_error(name, f"has the shape {np.shape(values)}, not {shape}", fix)
    covariance = np.where(images.seen()[..., None, None], values, 0.0).astype(np.float64)
    if not np.isfinite(covariance).all() or (covariance != covariance.swapaxes(2, 3)).any():
        raise input_error(name, "holds what is no covariance", fix)
    if (np.linalg.eigvalsh(covariance) < -1e-9 * np.abs(covariance).max()).any():
        raise input_error(name, "holds a matrix with a negative variance", fix)
    return covariance

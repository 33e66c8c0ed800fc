"""The chain of `fit`, from landmarks to 3D shapes, and what the config chooses for each step."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from shapefit.arrays import Floats
from shapefit.config import FitConfig
from shapefit.convex.newton import solve_newton
from shapefit.convex.problem import Loss
from shapefit.dictionary.model import Dictionary
from shapefit.errors import input_error
from shapefit.io import LandmarkSet
from shapefit.io.extras import LANDMARK_COVARIANCE
from shapefit.lifting.estimate import Estimator
from shapefit.lifting.lift import Lifting, Program, fail_nonfinite, lift
from shapefit.lifting.methods import (
    METHODS,
    ROBUST,
    AlternationOptions,
    Settings,
    choose_method,
)
from shapefit.lifting.options import PerspectiveOptions
from shapefit.pipelines.fit.dictionary_kind import check_needs

if TYPE_CHECKING:
    from shapefit.geometry.pinhole import Camera
    from shapefit.lifting.methods import Solve
    from shapefit.pipelines.fit.outlier_search import Agreement

Lifter = Callable[[LandmarkSet, Dictionary], Lifting]
"""Lifts images, whose landmarks are those of the dictionary."""

Search = Callable[[LandmarkSet, Floats, Dictionary], "Agreement"]
View = Callable[[Lifting, LandmarkSet, Dictionary], Lifting]
Refinement = Callable[[Lifting, LandmarkSet], Lifting]


@dataclass(frozen=True, kw_only=True)
class Chain:
    """What the config chose for each step of a fit; None for a step that it goes without.

    What only some fits need is imported where it is chosen: before the clock of solving starts.
    """

    leave_out: Callable[[LandmarkSet, Dictionary, Lifter], Lifting] | None
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
    weights = images.weights()
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


def choose_chain(config: FitConfig, dictionary: Dictionary) -> Chain:
    """Return the steps that the config asks for.

    Raises InputError where the dictionary lacks what they need.
    """
    check_needs(config, dictionary)
    METHODS[config.method].load()
    solve = choose_solver(config)
    return Chain(
        sequences=choose_refinement(config, dictionary),
        program=choose_program(config),
        precisions=METHODS[config.method].precisions,
        search=choose_search(config, solve),
        method=lambda part: choose_method(config.method, choose_settings(config, part, solve)),
        camera=choose_camera(config),
        view=choose_view(config),
        leave_out=choose_groups(config, dictionary),
    )


def choose_groups(
    config: FitConfig, dictionary: Dictionary
) -> Callable[[LandmarkSet, Dictionary, Lifter], Lifting] | None:
    """Return what lifts each image without the model that it shows, if the config asks for it."""
    if config.leave_out is None:
        return None
    from shapefit.pipelines.fit.left_out import check_items, lift_left_out

    check_items(dictionary)
    return partial(lift_left_out, dataset=config.leave_out, threads=config.threads)


def choose_search(config: FitConfig, solve: Solve) -> Search | None:
    """Return the search for outliers that the config names, if any."""
    if config.outliers.method in ("none", *ROBUST):
        return None
    from shapefit.pipelines.fit.outlier_search import choose_search as choose
    from shapefit.pipelines.fit.outlier_search import find_inliers

    search = choose(config.outliers, solve, config.threads)
    return partial(find_inliers, search)


def choose_view(config: FitConfig) -> View | None:
    """Return what follows weak perspective: nothing, or refinement under the full projection."""
    if config.camera.model == "weak-perspective" or METHODS[config.method].perspective != "refined":
        return None
    from shapefit.pipelines.fit.intrinsics import refine_through_camera

    options = choose_options(config)
    views = AlternationOptions(views=config.alternation.views).number_of_views
    return partial(refine_through_camera, config=config.camera, options=options, views=views)


def choose_camera(config: FitConfig) -> Callable[[LandmarkSet], Camera] | None:
    """Return what finds the cameras of images for a method that looks through them itself."""
    if config.camera.model == "weak-perspective" or METHODS[config.method].perspective != "own":
        return None
    from shapefit.pipelines.fit.intrinsics import find_camera

    return partial(find_camera, config=config.camera)


def choose_options(config: FitConfig) -> PerspectiveOptions:
    """Return how the config wants shapes refined under perspective."""
    return PerspectiveOptions(
        ridge=config.camera.ridge,
        softness=config.camera.softness,
        threads=config.threads,
    )


def choose_refinement(config: FitConfig, dictionary: Dictionary) -> Refinement | None:
    """Return the inference over whole sequences, where the method is for these."""
    if not METHODS[config.method].sequences:
        return None
    from shapefit.lifting.sequences.method import refine_lifting
    from shapefit.lifting.sequences.through_camera import refine_through_camera
    from shapefit.pipelines.fit.motion import find_lengths, find_motion

    lengths = find_lengths(config, dictionary)

    def refine(lifting: Lifting, images: LandmarkSet) -> Lifting:
        rate = config.sequences.frame_rate or images.frame_rate
        motion = find_motion(dictionary, rate, lengths)

        def refine_weak(lifting: Lifting, landmarks: Floats) -> Lifting:
            return refine_lifting(
                lifting,
                landmarks,
                images.sequences or (),
                motion,
                config.posterior.misfit,
                config.posterior.widening,
                config.threads,
            )

        return refine_through_camera(lifting, images.landmarks, refine_weak)

    return refine


def find_covariance(images: LandmarkSet) -> Floats | None:
    """Return the covariance (n, p, 2, 2) of the landmarks that came with them, if it did.

    Raises InputError where the dataset holds no covariances.
    """
    name = LANDMARK_COVARIANCE
    values = images.extras.get(name)
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


def choose_program(config: FitConfig) -> Program:
    """Return the convex program that the config names."""
    return Program(
        lam=None if config.lam == "auto" else config.lam,
        loss=Loss(config.data_term),
        beta=config.outliers.limit,
        noise=config.noise or 0.0,
    )


def choose_settings(config: FitConfig, dictionary: Dictionary, solve: Solve) -> Settings:
    """Return what the methods need besides the problem."""
    method = METHODS[config.method]
    options = None
    if method.section is not None:
        name, kind = method.section
        section = getattr(config, name)
        keys = type(section).model_fields.keys() & {key.name for key in fields(kind)}
        options = kind(**{key: getattr(section, key) for key in keys})
    return Settings(
        solve=solve,
        mean_shape=dictionary.mean_shape,
        needs={need.name: getattr(dictionary, need.name) for need in method.needs},
        options=options,
        orthogonal=config.rotations == "orthogonal",
        tolerance=config.solver.tolerance,
        threads=config.threads,
    )


def choose_solver(config: FitConfig) -> Solve:
    """Return the solver with the options of the config.

    Where the tolerance is that of another gap, the convex program is solved at its own default.
    """
    options, tolerance = config.solver, config.solver.tolerance
    if METHODS[config.method].proves == "global":
        tolerance = min(tolerance, METHODS["convex"].tolerance)
    return partial(
        solve_newton,
        tolerance=tolerance,
        max_iterations=options.max_iterations,
        threads=config.threads,
    )

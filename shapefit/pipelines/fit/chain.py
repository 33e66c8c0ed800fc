"""The chain that takes landmarks to 3D shapes, put together as the config of `fit` says."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from shapefit.config import FitConfig
from shapefit.convex.newton import solve_newton
from shapefit.convex.problem import Loss
from shapefit.dictionary.model import Dictionary
from shapefit.errors import input_error
from shapefit.io import LandmarkSet
from shapefit.io.extras import LANDMARK_COVARIANCE
from shapefit.lifting.lift import Lifting, Program, fail_nonfinite, lift
from shapefit.lifting.methods import METHODS, Settings, choose_method
from shapefit.pipelines.fit.dictionary_kind import check_needs

if TYPE_CHECKING:
    from shapefit.lifting.methods import Solve
    from shapefit.lifting.path import WarmSolve
    from shapefit.lifting.perspective.refinement import PerspectiveOptions

Floats = NDArray[np.float64]
Lifter = Callable[[LandmarkSet, Dictionary], Lifting]
"""Lifts images, whose landmarks are those of the dictionary."""

View = Callable[[Lifting, LandmarkSet, Dictionary], Lifting]
Refinement = Callable[[Lifting, LandmarkSet], Lifting]

# What only some fits need is imported where it is chosen: before the clock of solving starts.


def choose_lifter(config: FitConfig, dictionary: Dictionary) -> Lifter:
    """Return what lifts a chunk of images, whose landmarks are those of the dictionary.

    Raises InputError where the dictionary lacks what the config asks for.
    """
    check_needs(config, dictionary)
    METHODS[config.method].load()
    refinement = choose_refinement(config, dictionary)
    program, solve = choose_program(config), choose_solver(config)
    search = None
    if config.outliers.method != "none":
        from shapefit.pipelines.fit.outlier_search import choose_search, lift_inliers

        search = choose_search(config.outliers, solve, config.threads)
    view = choose_view(config)

    def lift_with(images: LandmarkSet, part: Dictionary) -> Lifting:
        estimator = choose_method(config.method, choose_settings(config, part, solve))

        def lift_weighted(weights: Floats) -> Lifting:
            return lift(
                images.landmarks,
                weights,
                part.atoms,
                program,
                estimator,
                find_covariance(images, config),
            )

        weights = images.weights()
        if search is None:
            lifting = lift_weighted(weights)
        else:
            lifting = lift_inliers(search, images, weights, part, lift_weighted)
        return view(lifting, images, part)

    lifter: Lifter = lift_with
    if config.leave_out is not None:
        from shapefit.pipelines.fit.left_out import leaving_out

        lifter = leaving_out(lift_with, config.leave_out, dictionary, config.threads)
    return lambda images, whole: fail_nonfinite(refinement(lifter(images, whole), images))


def choose_view(config: FitConfig) -> View:
    """Return what follows weak perspective: nothing, or refinement under the full projection."""
    if config.camera.model == "weak-perspective":
        return lambda lifting, images, dictionary: lifting
    from shapefit.lifting.perspective.view import refine_view
    from shapefit.pipelines.fit.intrinsics import find_camera

    options = choose_options(config)

    def view(lifting: Lifting, images: LandmarkSet, dictionary: Dictionary) -> Lifting:
        camera = find_camera(images, config.camera)
        return refine_view(
            lifting, images.landmarks, camera, dictionary, options, views=config.alternation.views
        )

    return view


def choose_options(config: FitConfig) -> PerspectiveOptions:
    """Return how the config wants shapes refined under perspective."""
    from shapefit.lifting.perspective.refinement import PerspectiveOptions

    return PerspectiveOptions(
        ridge=config.camera.ridge,
        softness=config.camera.softness,
        max_rounds=config.camera.max_rounds,
        threads=config.threads,
    )


def choose_refinement(config: FitConfig, dictionary: Dictionary) -> Refinement:
    """Return what follows single images: nothing, or the inference over whole sequences."""
    if not METHODS[config.method].sequences:
        return lambda lifting, _: lifting
    from shapefit.lifting.sequences.method import refine_lifting
    from shapefit.pipelines.fit.motion import find_lengths, find_motion

    lengths = find_lengths(config, dictionary)

    def refine(lifting: Lifting, images: LandmarkSet) -> Lifting:
        rate = config.sequences.frame_rate or images.frame_rate
        return refine_lifting(
            lifting,
            images.landmarks,
            images.sequences or (),
            find_motion(dictionary, rate, lengths),
            config.posterior.misfit,
            config.posterior.widening,
        )

    return refine


def find_covariance(images: LandmarkSet, config: FitConfig) -> Floats | None:
    """Return the covariance (n, p, 2, 2) of the landmarks that came with them, if it did.

    Raises InputError where the dataset holds no covariances.
    """
    name = LANDMARK_COVARIANCE
    values = images.extras.get(name) if config.method == "posterior" else None
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
        loss=Loss(config.loss),
        beta=config.beta,
        noise=config.noise or 0.0,
    )


def choose_settings(config: FitConfig, dictionary: Dictionary, solve: Solve) -> Settings:
    """Return what the methods need besides the problem."""
    method = METHODS[config.method]
    options = None
    if method.section is not None:
        name, kind = method.section
        options = kind(
            **{key.name: getattr(getattr(config, name), key.name) for key in fields(kind)}
        )
    return Settings(
        solve=solve,
        mean_shape=dictionary.mean_shape,
        needs={need.name: getattr(dictionary, need.name) for need in method.needs},
        options=options,
        orthogonal=config.orthogonal,
        threads=config.threads,
    )


def choose_solver(config: FitConfig) -> Solve:
    """Return the solver that the config names, with its options."""
    options = config.solver
    if options.name == "admm":
        from shapefit.convex.admm import solve_admm

        return partial(
            solve_admm,
            tolerance=options.tolerance,
            stop=options.stop,
            max_iterations=options.max_iterations,
        )
    return choose_newton(config)


def choose_newton(config: FitConfig) -> WarmSolve:
    """Return the fast solver with the options of the config."""
    options = config.solver
    return partial(
        solve_newton,
        tolerance=options.tolerance,
        max_iterations=options.max_iterations,
        threads=config.threads,
    )

"""The method `posterior`: what the landmarks and a prior over shapes say of the shape together."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from shapefit.arrays import Floats
from shapefit.convex.problem import Problem
from shapefit.convex.solution import Solution, Status
from shapefit.geometry.pinhole import Camera, project
from shapefit.lifting.estimate import CORRELATION, ConvexProof, Estimate, fit_translation
from shapefit.lifting.methods import PosteriorOptions, Settings
from shapefit.lifting.posterior.plausibility import Model, find_plausibility
from shapefit.lifting.posterior.posterior import Gross, Posterior, find_posterior
from shapefit.lifting.posterior.rays import face, find_rays, place, stretch_noise
from shapefit.lifting.reconstruction import reconstruct
from shapefit.lifting.shared_rotation.pose import (
    find_moments,
    find_pose,
    spread_views,
    turn_in_plane,
)

NEARLY_EXACT = 3e-3
"""Misfit below which landmarks look gross from any view but the right one."""

COARSE = 1e-2
"""Misfit with which their views are first sought."""

VIEWS = 6
"""From which the mean shape is posed where the convex program finds no rotation."""

FAILED = (Status.DEGENERATE, Status.NUMERICAL_FAILURE)


def lift_to_posterior(problem: Problem, settings: Settings, modes: int = 0) -> Estimate:
    """Return the posterior mean, its standard deviations, and what the images are worth.

    The convex program finds the view to start from; its proof goes with the result, and is one of
    that program only. An image that the program cannot solve has no posterior. `modes` of each
    image, the most likely ones, are kept.
    """
    options: PosteriorOptions = settings.options
    solution = settings.solve(problem)
    failed = np.isin([status.value for status in solution.status], [s.value for s in FAILED])
    starts = np.where(failed[:, None, None, None], np.nan, find_starts(problem, solution, settings))
    landmarks, noise, slopes = problem.landmarks, find_noise(problem), None
    seen, camera = problem.weights > 0, problem.camera
    gross = Gross(options.gross_chance, options.gross_density)
    if camera is not None:
        rays = find_rays(landmarks, camera)
        starts = face(starts, landmarks, seen, camera)
        landmarks, noise, slopes = rays.landmarks, stretch_noise(noise, camera), rays.slopes
    find = partial(
        find_posterior,
        landmarks,
        noise=noise,
        prior=settings.needs["prior"],
        gross=gross,
        slopes=slopes,
        threads=settings.threads,
    )
    if options.misfit < NEARLY_EXACT:
        coarse = find(find_misfit(problem, COARSE), starts=starts)
        starts = coarse.rotation[:, None]
    found = find(
        find_misfit(problem, options.misfit),
        starts=starts,
        modes=modes,
        covariance=options.covariance,
    )
    lost = np.isnan(found.log_evidence)
    translation = found.mean[:, :2].mean(axis=2)
    shapes = found.mean.copy()
    shapes[:, :2] -= translation[:, :, None]
    widening = np.sqrt(options.widening)
    plausibility = np.full(len(lost), np.nan)
    if options.plausibility:
        plausibility = find_plausibility(
            found.surprise,
            seen.sum(axis=1),
            np.where(seen, found.belief, 0.0).sum(axis=1),
            Model(settings.needs["prior"], options.misfit, gross),
            settings.threads,
        )
    estimate = Estimate(
        shapes=np.where(lost[:, None, None], 0.0, shapes),
        translation=np.where(lost[:, None], 0.0, translation),
        rotation=found.rotation,
        objective=-found.log_evidence,
        residual=fit_translation(problem, shapes[:, :2], translation).residual,
        iterations=solution.iterations + found.rounds,
        status=tuple(
            status
            if status in FAILED
            else Status.NUMERICAL_FAILURE
            if gone
            else Status.CONVERGED
            if stationary
            else Status.ITERATION_LIMIT
            for status, gone, stationary in zip(
                solution.status, lost.tolist(), found.stationary.tolist(), strict=True
            )
        ),
        deviation=widening * found.deviation,
        covariance=None if found.covariance is None else options.widening * found.covariance,
        posterior_modes=found.modes if modes else None,
        convex_proof=ConvexProof.of(solution),
        further={
            "log_evidence": found.log_evidence,
            "plausibility": plausibility,
            "belief": np.where(seen, found.belief, np.nan),
            CORRELATION: found.correlation.swapaxes(1, 2).astype(np.float32),
        },
    )
    return estimate if camera is None else look_through(estimate, found, problem, camera)


def find_starts(problem: Problem, solution: Solution, settings: Settings) -> Floats:
    """Rotations (n, 1 + views, 3, 3): the consensus of the convex program's rotations.

    Where they are all 0, the best pose of the mean shape. Then the views of the options, each
    turned in the plane onto the landmarks.
    """
    M = solution.transforms
    rotation = reconstruct(M, problem.atoms, threads=settings.threads).rotation
    empty = np.flatnonzero(M.count == 0)
    if len(empty):
        part = problem.take(empty)
        views = spread_views(VIEWS)
        rotation[empty] = find_pose(
            part, settings.mean_shape, views, threads=settings.threads
        ).rotation
    if settings.options.views == 0:
        return rotation[:, None]
    _, by_shape = find_moments(problem, settings.mean_shape)
    turned = turn_in_plane(spread_views(settings.options.views), by_shape)
    return np.concatenate([rotation[:, None], turned], axis=1)


def look_through(
    estimate: Estimate, found: Posterior, problem: Problem, camera: Camera
) -> Estimate:
    """The same estimate with shapes in the unit of the dictionary, placed before the camera."""
    lost = np.isnan(found.scale)
    at = place(found.mean, found.scale, find_rays(problem.landmarks, camera), camera)
    projected = project(camera, at.shapes + at.translation[..., None])
    # what is hidden may lie behind the camera, and counts for nothing
    shown = np.where(problem.weights[:, None] > 0, projected, 0.0)
    return replace(
        estimate.in_unit(shrink=found.scale[:, None, None]),
        shapes=np.where(lost[:, None, None], 0.0, at.shapes),
        translation=np.where(lost[:, None], 0.0, at.middle),
        camera_translation=at.translation,
        residual=fit_translation(problem, shown, np.zeros((len(lost), 2))).residual,
    )


def find_misfit(problem: Problem, misfit: float) -> Floats:
    """Variance v / omega^2 (n, p) in the unit of shapes; inf where a landmark is hidden."""
    omega = problem.weights
    square = np.where(omega > 0, omega, 1.0) ** 2
    return np.where(omega > 0, misfit / square, np.inf)


def find_noise(problem: Problem) -> Floats:
    """Covariance V / omega^2 (n, p, 2, 2) of the measurement, normalised; 0 where not known."""
    n, p = problem.weights.shape
    if problem.noise is None:
        return np.zeros((n, p, 2, 2))
    square = np.where(problem.weights > 0, problem.weights, 1.0) ** 2
    noise: Floats = problem.noise / square[..., None, None]
    return noise

"""The method `posterior`: what the landmarks and a prior over shapes say of the shape
together.

Before a pinhole camera the posterior is found in the rays on which the landmarks lie. A
shape whose middle is at the depth D of a camera with the focal length f is s = f / D
times as large in the image as it is. In that unit its middle lies at the depth f, and
landmark j, which is seen in the direction u_j, at

    s (X_j + t) = u_j (f +- s Z_j)     in x and y,

+ where z points away from the camera. So f u_j = s (X_j + t -+ u_j Z_j) + e_j: linear
in the shape, like weak perspective, with the slope +-u_j for each landmark.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats
from shapefit.convex.problem import Problem
from shapefit.convex.solver import Solution, Status
from shapefit.convex.transforms import Transforms
from shapefit.geometry.pinhole import Camera, project_pinhole
from shapefit.geometry.procrustes import similarity_errors
from shapefit.geometry.rotations import shortest_rotations
from shapefit.lifting.degeneracy import normalise_visible
from shapefit.lifting.estimate import (
    ConvexProof,
    PosteriorEstimate,
    Solve,
    fit_translation,
)
from shapefit.lifting.posterior.model import PosteriorModel
from shapefit.lifting.posterior.p_value import find_p_values
from shapefit.lifting.posterior.posterior import Posterior, find_posterior
from shapefit.lifting.posterior.usual_lengths import LimbLengths
from shapefit.lifting.reconstruction import reconstruct
from shapefit.lifting.shared_rotation import find_pose
from shapefit.lifting.trust import LIMITS, MIN_INLIER_PROBABILITY

NEARLY_EXACT_VARIANCE = 3e-3
"""Residual variance below which landmarks look like outliers from any view but the
right one.
"""

COARSE_VARIANCE = 1e-2
"""Residual variance with which their views are first sought."""

FAILED_STATUSES = (Status.DEGENERATE, Status.NUMERICAL_FAILURE)


def lift_to_posterior(
    problem: Problem,
    model: PosteriorModel,
    *,
    solve: Solve,
    modes: int = 0,
    threads: int = 0,
) -> PosteriorEstimate:
    """Lift by the method `posterior`: the mean shapes of the posterior, and error bars.

    The convex program, which `solve` solves, finds the view to start from; its proof
    goes with the result, and is one of that program only. An image that the program
    cannot solve has no posterior. `modes` of each image, the most likely ones, are
    kept.
    """
    solution = solve(problem)
    failed = np.array(
        [status in FAILED_STATUSES for status in solution.status], dtype=bool
    )
    starts = find_starts(problem, solution, model.mean_shape, threads=threads)
    starts = np.where(failed[:, None, None, None], np.nan, starts)
    visible = problem.weights > 0
    camera = problem.camera
    if camera is not None:
        starts = turn_towards_landmarks(starts, problem.landmarks, visible, camera)
    posterior = find_posterior_from(
        problem,
        starts,
        model,
        lengths=model.limbs,
        modes=modes,
        covariance=model.covariance,
        threads=threads,
    )
    estimate = describe_posterior(problem, model, solution, posterior)
    if modes:
        estimate = replace(estimate, modes=posterior.modes)
    if camera is not None:
        estimate = convert_to_pinhole(estimate, posterior, problem, camera)
    return estimate


def describe_posterior(
    problem: Problem, model: PosteriorModel, solution: Solution, posterior: Posterior
) -> PosteriorEstimate:
    """Return posteriors as an estimate, with the error bars scaled as the model says.

    solution: that of the convex program, from which they started, and its proof. The
    covariances of the posterior are written over.
    """
    lost = np.isnan(posterior.log_evidence)
    translation = posterior.mean[:, :2].mean(axis=2)
    shapes = posterior.mean.copy()
    shapes[:, :2] -= translation[:, :, None]
    placement = fit_translation(problem, shapes[:, :2], translation)
    factors = scale_of_bars(model.bar_scale, model.growth, problem.weights.shape[1])
    covariance = scale_covariance(
        posterior.covariance, factors, out=posterior.covariance
    )
    visible = problem.weights > 0
    return PosteriorEstimate(
        shapes=np.where(lost[:, None, None], 0.0, shapes),
        translation=np.where(lost[:, None], 0.0, translation),
        rotation=posterior.rotation,
        objective=-posterior.log_evidence,
        residual=placement.residual,
        iterations=solution.iterations + posterior.rounds,
        status=find_statuses(solution, posterior),
        convex_proof=ConvexProof.of(solution),
        deviation=factors * posterior.deviation,
        correlation=posterior.correlation.astype(np.float32),
        covariance=covariance,
        log_evidence=posterior.log_evidence,
        inlier_probability=np.where(visible, posterior.inlier_probability, np.nan),
        squared_mahalanobis=posterior.squared_mahalanobis,
    )


def find_statuses(solution: Solution, posterior: Posterior) -> tuple[Status, ...]:
    """Return the status of each image: that of its convex program where this failed."""
    status = np.full(len(posterior.log_evidence), Status.ITERATION_LIMIT, dtype=object)
    status[posterior.stationary] = Status.CONVERGED
    status[np.isnan(posterior.log_evidence)] = Status.NUMERICAL_FAILURE
    failed = np.array([end in FAILED_STATUSES for end in solution.status], dtype=bool)
    status[failed] = np.array(solution.status, dtype=object)[failed]
    return tuple(status.tolist())


def scale_of_bars(bar_scale: float, growth: Sequence[float], landmarks: int) -> Floats:
    """Return factors (p,) on standard deviations: sqrt(bar_scale growth).

    bar_scale, of all landmarks, and growth (p,), of each, are factors on covariances;
    an empty growth stands for 1 for each landmark.
    """
    factor: Floats = np.sqrt(
        bar_scale * (np.array(growth) if growth else np.ones(landmarks))
    )
    return factor


def scale_covariance(
    covariance: Floats | None, factor: Floats, out: Floats | None = None
) -> Floats | None:
    """Return D C D (n, 3p, 3p) of covariances C, D with factors (p,) on its diagonal.

    Standard deviations of a landmark, in x, y and z, are multiplied by its factor.
    `out` may be C; None for None.
    """
    if covariance is None:
        return None
    D = np.tile(factor, 3)
    grown: Floats = np.multiply(covariance, D[:, None] * D, out=out)
    return grown


def find_posterior_from(
    problem: Problem,
    starts: Floats,
    model: PosteriorModel,
    *,
    lengths: LimbLengths | None = None,
    modes: int = 0,
    covariance: bool = False,
    threads: int = 0,
) -> Posterior:
    """Return the posteriors of n images, sought from S rotations (n, S, 3, 3) each.

    A problem with a camera is seen through it. lengths, modes and covariance as in
    `find_posterior`.
    """
    landmarks = problem.landmarks
    noise = find_noise(problem)
    slopes = None
    if problem.camera is not None:
        rays = find_rays(landmarks, problem.camera)
        landmarks = rays.landmarks
        slopes = rays.slopes
        noise = noise_of_rays(noise, rays, problem.camera)
    find = partial(
        find_posterior,
        landmarks,
        noise=noise,
        prior=model.prior,
        outliers=model.outliers,
        slopes=slopes,
        threads=threads,
    )
    if model.residual_variance < NEARLY_EXACT_VARIANCE:
        variance = find_residual_variance(problem, COARSE_VARIANCE)
        coarse = find(variance, starts=starts, shapes=False)
        starts = coarse.rotation[:, None]
    return find(
        find_residual_variance(problem, model.residual_variance),
        starts=starts,
        lengths=lengths,
        modes=modes,
        covariance=covariance,
    )


def with_p_value(
    estimate: PosteriorEstimate,
    problem: Problem,
    model: PosteriorModel,
    *,
    solve: Solve,
    threads: int = 0,
) -> PosteriorEstimate:
    """Return the estimate of `lift_to_posterior` with p-values and start distances."""
    assert model.p_value_table is not None, "it comes with the dictionary"
    p_value = find_p_values(
        estimate.squared_mahalanobis,
        (problem.weights > 0).sum(axis=1),
        np.nansum(estimate.inlier_probability, axis=1),
        model.p_value_table,
    )
    distance = find_start_distance(estimate, problem, solve=solve, threads=threads)
    return replace(estimate, p_value=p_value, start_distance=distance)


def find_start_distance(
    estimate: PosteriorEstimate, problem: Problem, *, solve: Solve, threads: int = 0
) -> Floats:
    """Return the distances (n,) of posteriors from the convex shapes they started from.

    Mean distances of inliers after a similarity, in sizes of the posterior's; nan where
    either does not exist. The convex program knows neither outliers nor perspective. So
    images beyond the limit are solved again without the outliers, and with the
    landmarks that weak perspective would have of the shapes found, c + (w - c) (t_z +
    Z_j) / t_z.
    """
    assert estimate.convex_proof is not None, "the posterior starts from it"
    camera = problem.camera
    inliers = np.nan_to_num(estimate.inlier_probability) >= MIN_INLIER_PROBABILITY

    def distance(M: Transforms, rows: NDArray[np.intp]) -> Floats:
        """Return the distances of posteriors of images `rows` from the shapes of M."""
        start = reconstruct(M, problem.atoms, threads=threads).shapes
        shown = inliers[rows] & (M.count > 0)[:, None]
        return relative_distance(
            np.where(shown[:, None], start, np.nan), estimate.shapes[rows]
        )

    every = np.arange(len(inliers))
    start_distance = distance(estimate.convex_proof.transforms, every)
    saw_more = (inliers != (problem.weights > 0)).any(axis=1)
    again = camera is not None or saw_more
    far = np.flatnonzero((start_distance > LIMITS.max_distance) & again)
    if not len(far):
        return start_distance
    part = problem.take(far)
    part.weights[~inliers[far]] = 0.0
    landmarks = part.landmarks
    t = estimate.camera_translation
    if part.camera is not None and t is not None:
        centre = part.camera.centre[..., None]
        depth = t[far, 2][:, None]
        nearer = (depth + estimate.shapes[far, 2]) / depth
        landmarks = centre + (landmarks - centre) * nearer[:, None]
    norm, _ = normalise_visible(landmarks, part.weights)
    solved = solve(replace(part, landmarks=norm.points, camera=None))
    start_distance[far] = np.fmin(start_distance[far], distance(solved.transforms, far))
    return start_distance


def relative_distance(estimate: Floats, shapes: Floats) -> Floats:
    """Return mean distances (n,) of landmarks, once aligned, in sizes of the shapes.

    Mean over j of ||s R e_j + t - x_j|| for the least-squares s, R, t, over the size of
    x. Estimates e, shapes x (n, 3, p), nan where a landmark of e does not count; the
    size is the mean over coordinates of the standard deviation of those x_j that count.
    nan where fewer than three do.
    """
    errors = similarity_errors(estimate, shapes)
    finite = np.isfinite(estimate)
    count = np.maximum(finite.sum(axis=2), 1)
    mean = np.where(finite, shapes, 0.0).sum(axis=2) / count
    away = np.where(finite, shapes - mean[..., None], 0.0)
    size = np.sqrt((away**2).sum(axis=2) / count).mean(axis=1)
    distance: Floats = np.divide(
        errors, size, out=np.full_like(errors, np.nan), where=size > 0
    )
    return distance


def find_starts(
    problem: Problem, solution: Solution, mean_shape: Floats, *, threads: int = 0
) -> Floats:
    """Return the rotation (n, 1, 3, 3) from which to seek the posterior of each image.

    The consensus of the convex program's rotations; where all transforms are 0, the
    best pose of the mean shape (3, p).
    """
    M = solution.transforms
    rotation = reconstruct(M, problem.atoms, threads=threads).rotation
    empty = np.flatnonzero(M.count == 0)
    if len(empty):
        pose = find_pose(problem.take(empty), mean_shape, threads=threads)
        rotation[empty] = pose.rotation
    return rotation[:, None]


def convert_to_pinhole(
    estimate: PosteriorEstimate, posterior: Posterior, problem: Problem, camera: Camera
) -> PosteriorEstimate:
    """Convert an estimate to shapes in front of a camera, in the dictionary's unit.

    Translation, residual and error bars follow.
    """
    lost = np.isnan(posterior.scale)
    size = posterior.scale[:, None, None]
    middle = posterior.mean[:, :2].mean(axis=2)
    focal = find_rays(problem.landmarks, camera).focal
    t = np.concatenate([middle, camera.sign * focal[:, None]], axis=1)
    t /= posterior.scale[:, None]
    shapes = posterior.mean / size
    shapes[:, :2] -= t[:, :2, None]
    projected = project_pinhole(camera, shapes + t[..., None])
    # what is hidden may lie behind the camera, and counts for nothing
    shown = np.where(problem.weights[:, None] > 0, projected, 0.0)
    origin = camera.centre + camera.focal * middle / focal[:, None]
    return replace(
        estimate.scale_error_bars(divisor=size),
        shapes=np.where(lost[:, None, None], 0.0, shapes),
        translation=np.where(lost[:, None], 0.0, origin),
        camera_translation=t,
        residual=fit_translation(problem, shown, np.zeros((len(lost), 2))).residual,
    )


def find_residual_variance(problem: Problem, residual_variance: float) -> Floats:
    """Return the variance v / omega^2 (n, p) of landmarks that no shape explains.

    omega are the weights; in the unit of shapes, inf where a landmark is hidden.
    """
    omega = problem.weights
    square = np.where(omega > 0, omega, 1.0) ** 2
    return np.where(omega > 0, residual_variance / square, np.inf)


def find_noise(problem: Problem) -> Floats:
    """Return the covariance V / omega^2 (n, p, 2, 2) of the noise of landmarks.

    omega are the weights; in normalised units, 0 where the problem states no noise.
    """
    n, p = problem.weights.shape
    if problem.noise is None:
        return np.zeros((n, p, 2, 2))
    square = np.where(problem.weights > 0, problem.weights, 1.0) ** 2
    noise: Floats = problem.noise / square[..., None, None]
    return noise


class Rays(NamedTuple):
    """The rays of n images of landmarks seen by a pinhole camera, see above.

    landmarks f u (n, 2, p), slopes +-u (n, 2, p), and focal f (n,), the geometric mean
    of both focal lengths.
    """

    landmarks: Floats
    slopes: Floats
    focal: Floats


def find_rays(landmarks: Floats, camera: Camera) -> Rays:
    """Return the rays of landmarks (n, 2, p), in the unit of the camera."""
    directions = (landmarks - camera.centre[..., None]) / camera.focal[..., None]
    focal = np.sqrt(camera.focal.prod(axis=1))
    return Rays(focal[:, None, None] * directions, camera.sign * directions, focal)


def noise_of_rays(noise: Floats, rays: Rays, camera: Camera) -> Floats:
    """Convert covariances (n, p, 2, 2) of noise to those of the landmarks f u of rays.

    An uncertain focal length adds to them. Where the logarithm of f is off by e, a
    point at the depth z of the shape is seen e u z away. Depths have about the size of
    the shape, which is 1 for normalised landmarks.
    """
    to_one_focal = np.sqrt(camera.focal.prod(axis=1))[:, None] / camera.focal
    stretched = noise * to_one_focal[:, None, :, None] * to_one_focal[:, None, None, :]
    off = camera.focal_sd * rays.slopes.swapaxes(1, 2)
    noisy: Floats = stretched + off[..., None] * off[..., None, :]
    return noisy


def turn_towards_landmarks(
    rotations: Floats, landmarks: Floats, visible: NDArray[np.bool_], camera: Camera
) -> Floats:
    """Convert rotations (n, S, 3, 3) of weak perspective to those of a pinhole camera.

    Weak perspective looks along the ray to the landmarks. So they are turned by the
    least turn of the optical axis onto the ray to the middle of the seen landmarks (n,
    2, p): an object off to the side shows its side.
    """
    count = np.maximum(visible.sum(axis=1), 1)[:, None]
    middle = np.where(visible[:, None], landmarks, 0.0).sum(axis=2) / count
    ray = np.empty((len(landmarks), 3))
    ray[:, :2] = (middle - camera.centre) / camera.focal
    ray[:, 2] = camera.sign
    ray /= np.linalg.norm(ray, axis=1, keepdims=True)
    turns = shortest_rotations(np.array([0.0, 0.0, camera.sign]), ray)
    return turns[:, None] @ rotations

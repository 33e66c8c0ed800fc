"""The model of landmarks alone: one Gaussian over shapes, seen from unknown views.

    w_nj = s_n P R_n x_nj + t_n + e_nj,    e_nj ~ N(0, sigma^2 / omega_nj^2 I),
    x_n  = mu + V z_n + d_n,               z_n ~ N(0, I),  d_n ~ N(0, rho I),
    log s_n ~ N(log size of the sequence, tau^2),

P takes the first two rows, t is any translation. A landmark is an outlier with the
chance epsilon; then it falls with the density u per area. Close to the Procrustean
normal distribution of Lee, Cho, Choi and Oh (CVPR 2013) and to the model of Torresani,
Hertzmann and Bregler (PAMI 2008).

The expectation is that of the compiled kernel, core/learn/expectation.cpp. With v_j =
s^2 rho + sigma^2 / omega_j^2, the residuals e_j of the landmarks and their covariance
H_j by the other unknowns, what the others say of landmark j, seen, is

    log p_j = 1/2 log |A| - 1/2 e_j^T A^-1 e_j / v_j - log(2 pi v_j),
    A = I - H_j / v_j,

and of an outlier the same with A = I + H_j / v_j and -1/2 log |A|.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil
from typing import NamedTuple, TypedDict

import numpy as np

from shapefit import core
from shapefit.arrays import Flags, Floats, Indices
from shapefit.core import IMAGES_PER_BLOCK
from shapefit.geometry.rotations import exponential
from shapefit.threads import thread_count

VIEW_DIRECTIONS = 4
"""In which a view moves: turns about the axes of the camera, and log s."""

TRANSLATION_PRECISION = 1e-9
"""Before the image is seen."""

OUTLIER_LOG_DENSITY = np.log(0.02 / (1 - 0.02) * 0.05)
"""With the odds that a landmark is an outlier."""

MAX_VIEW_STEP = 0.3
"""In radians and log s."""

MAX_MODES = 64
"""Modes V of a model at most."""

MIN_REST = 1e-9
"""Variance of a coordinate beside the modes at least."""


@dataclass(frozen=True, eq=False)
class Images:
    """n images of landmarks.

    landmarks w (n, 2, p), weights omega (n, p), 0 where hidden, sequence (n,). The
    landmarks of each sequence, numbered from 0, are of comparable size, and lie
    anywhere where they are outliers (n, p); None where all count as inliers.
    """

    landmarks: Floats
    weights: Floats
    sequence: Indices
    outliers: Flags | None = None

    def __len__(self) -> int:
        return len(self.landmarks)

    def __getitem__(self, rows: slice | Indices) -> Images:
        outliers = None if self.outliers is None else self.outliers[rows]
        return Images(
            self.landmarks[rows], self.weights[rows], self.sequence[rows], outliers
        )

    @property
    def visible(self) -> Flags:
        """Return which landmarks (n, p) have a weight and are inliers."""
        is_there = self.weights > 0
        return is_there if self.outliers is None else is_there & ~self.outliers

    def hiding(self, landmarks: Flags) -> Images:
        """Return the images with these landmarks (n, p) hidden, all others inliers."""
        weights = np.where(landmarks, 0.0, self.weights)
        return Images(self.landmarks, weights, self.sequence)


@dataclass(frozen=True, eq=False)
class Views:
    """Where each image is seen from: rotation R (n, 3, 3) and log_scale log s (n,)."""

    rotation: Floats
    log_scale: Floats

    def __getitem__(self, rows: slice | Indices) -> Views:
        return Views(self.rotation[rows], self.log_scale[rows])


@dataclass(frozen=True, eq=False)
class Gaussian:
    """The model of shapes and of what is seen of them.

    mean mu (3, p), modes V (3, p, q), rest rho, noise sigma^2; log_size (sequences,)
    and the size_variance tau^2.
    """

    mean: Floats
    modes: Floats
    rest: float
    noise: float
    log_size: Floats
    size_variance: float

    @property
    def covariance(self) -> Floats:
        """Return the covariance of shapes (3p, 3p), all x first, then y, then z."""
        V = self.modes.reshape(self.mean.size, -1)
        C: Floats = V @ V.T + self.rest * np.eye(len(V))
        return C


@dataclass(frozen=True, eq=False)
class Expected:
    """What a model expects of n images.

    log_density (n,), shapes E x (n, 3, p) and translation (n, 2); gradient (n, 4) and
    information (n, 4, 4) of the log density by the view, and covariance (3p, 3p), the
    sum of those of the shapes, None where they were not asked for; residual_variance
    (n,), the sum over the visible landmarks of omega^2 E |e|^2; flip_gain (n, p), the
    log density that an image gains where one landmark becomes an outlier, or stops to
    be one.
    """

    log_density: Floats
    flip_gain: Floats
    shapes: Floats
    translation: Floats
    gradient: Floats | None
    information: Floats | None
    covariance: Floats | None
    residual_variance: Floats


def posterior_mean(
    images: Images,
    views: Views,
    model: Gaussian,
    *,
    slopes: bool = False,
    covariance: bool = False,
) -> Expected:
    """Return the posterior moments of the shapes in the images, given their views.

    With `slopes` also the gradient and the information of the log density by the views.
    The gradient is that of the expected log density of image and shape together
    (Fisher's identity); the information is that of the mean shape, its covariance held.
    With `covariance` also the sum of the covariances of the shapes.
    """
    n, _, p = images.landmarks.shape
    seen = _project(images, views, model)
    log_density = np.empty(n)
    shapes = np.empty((n, 3, p))
    translation = np.empty((n, 2))
    left = np.empty((n, 2, p))
    H = np.empty((n, p, 2, 2))
    m = n if slopes else 0
    gradient = np.empty((m, VIEW_DIRECTIONS))
    information = np.empty((m, VIEW_DIRECTIONS, VIEW_DIRECTIONS))
    blocks = ceil(n / IMAGES_PER_BLOCK) if covariance else 0
    of_blocks = np.empty((blocks, 3 * p, 3 * p))
    core.expect_shapes(
        **_kernel_arrays(seen, views, model),
        log_density=log_density,
        mean=np.ascontiguousarray(model.mean),
        rest=model.rest,
        shapes=shapes,
        translation=translation,
        left=left,
        uncertainty=H,
        gradient=gradient,
        information=information,
        covariance=of_blocks,
        threads=thread_count(0),
    )
    if slopes:
        deviation = views.log_scale - model.log_size[images.sequence]
        gradient[:, 3] -= deviation / model.size_variance
        information[:, 3, 3] += 1 / model.size_variance
    flip_gain = find_flip_gain(left, H, seen.variances, images.visible)
    return Expected(
        log_density=log_density + _other_log_density(images, views, model, seen),
        flip_gain=np.where(images.weights > 0, flip_gain, -np.inf),
        shapes=shapes,
        translation=translation,
        gradient=gradient if slopes else None,
        information=information if slopes else None,
        covariance=_add_rest(of_blocks, views, model, seen) if covariance else None,
        residual_variance=_residual_variance(images, seen, left, H),
    )


def find_log_density(images: Images, views: Views, model: Gaussian) -> Floats:
    """Return the log density (n,) of the images and of the sizes of their views."""
    seen = _project(images, views, model)
    log_density = np.empty(len(images))
    core.find_view_densities(
        **_kernel_arrays(seen, views, model),
        log_density=log_density,
        threads=thread_count(0),
    )
    return log_density + _other_log_density(images, views, model, seen)


class _Projected(NamedTuple):
    """The mean shape and the errors of landmarks, seen by the views.

    scale s (n,); residuals w - s P R mu (n, 2, p), 0 where hidden; rest s^2 rho (n, 1);
    variances v (n, p) and precisions 1 / v, 0 for landmarks that do not count (n, p).
    """

    scale: Floats
    residuals: Floats
    rest: Floats
    variances: Floats
    precisions: Floats


def _project(images: Images, views: Views, model: Gaussian) -> _Projected:
    """Project the mean shape into images by their views."""
    s = np.exp(views.log_scale)
    mean = s[:, None, None] * (views.rotation[:, :2] @ model.mean)
    is_there = images.weights > 0
    rest = (s**2 * model.rest)[:, None]
    v = rest + model.noise / np.where(is_there, images.weights, 1.0) ** 2
    return _Projected(
        scale=s,
        residuals=np.where(is_there[:, None], images.landmarks - mean, 0.0),
        rest=rest,
        variances=v,
        precisions=np.where(images.visible, 1.0 / v, 0.0),
    )


class _KernelArrays(TypedDict):
    """What every kernel needs of images in their views, by the names of arguments."""

    residuals: Floats
    precisions: Floats
    rotation: Floats
    scale: Floats
    modes: Floats
    translation_precision: float


def _kernel_arrays(seen: _Projected, views: Views, model: Gaussian) -> _KernelArrays:
    """Return what every kernel needs of images, their views and the model."""
    return _KernelArrays(
        residuals=seen.residuals,
        precisions=seen.precisions,
        rotation=np.ascontiguousarray(views.rotation),
        scale=seen.scale,
        modes=np.ascontiguousarray(model.modes),
        translation_precision=TRANSLATION_PRECISION,
    )


def _other_log_density(
    images: Images, views: Views, model: Gaussian, seen: _Projected
) -> Floats:
    """Return the terms (n,) of the log density that the modes have no part in.

    Those of the variances of landmarks, of outliers and of the sizes of the views.
    """
    visible = images.visible
    of_variances = np.where(visible, np.log(2 * np.pi * seen.variances), 0.0)
    outliers = ((images.weights > 0) & ~visible).sum(axis=1)
    deviation = views.log_scale - model.log_size[images.sequence]
    variance = model.size_variance
    of_sizes = 0.5 * (deviation**2 / variance + np.log(2 * np.pi * variance))
    return np.asarray(
        OUTLIER_LOG_DENSITY * outliers - of_variances.sum(axis=1) - of_sizes
    )


def _residual_variance(
    images: Images, seen: _Projected, residuals: Floats, covariance: Floats
) -> Floats:
    """Return the expected error omega^2 E |e|^2 (n,), summed over visible landmarks."""
    omega = images.weights
    share = np.where(images.visible, 1 - seen.rest * seen.precisions, 0.0)
    squares = (residuals**2).sum(axis=1) + covariance[..., 0, 0] + covariance[..., 1, 1]
    of_landmark = omega**2 * share**2 * squares + 2 * omega**2 * share * seen.rest
    return np.asarray(of_landmark.sum(axis=1))


def _add_rest(
    blocks: Floats, views: Views, model: Gaussian, seen: _Projected
) -> Floats:
    """Return the sum of the covariances (3p, 3p) of all shapes.

    blocks (b, 3p, 3p), sums over images of what landmarks share; the rest rho of each
    landmark by itself is added, less what is seen of it.
    """
    total = np.zeros(blocks.shape[1:])
    for block in blocks:
        total += block
    n, p = seen.precisions.shape
    PR = views.rotation[:, :2]
    across = (PR.transpose(0, 2, 1) @ PR).reshape(n, 9)
    gain = seen.rest * seen.precisions
    retained = (gain.T @ across).reshape(p, 3, 3)
    j = np.arange(p)
    of_itself = total.reshape(3, p, 3, p)
    of_itself[:, j, :, j] += model.rest * (n * np.eye(3) - retained)
    return total


def find_flip_gain(
    residuals: Floats, covariance: Floats, variance: Floats, visible: Flags
) -> Floats:
    """Return the log density gained (n, p) by changing a landmark to outlier or back.

    An inlier becomes an outlier, an outlier an inlier. residuals (n, 2, p), their
    covariance (n, p, 2, 2) and variance (n, p); visible (n, p): the inliers.
    """
    sign = np.where(visible, -1 / variance, 1 / variance)
    A = np.eye(2) + sign[..., None, None] * covariance
    size = np.maximum(A[..., 0, 0] * A[..., 1, 1] - A[..., 0, 1] ** 2, 1e-12)
    a = residuals[:, 0]
    b = residuals[:, 1]
    square = A[..., 1, 1] * a**2 - 2 * A[..., 0, 1] * a * b + A[..., 0, 0] * b**2
    alone = -0.5 * square / (size * variance) - np.log(2 * np.pi * variance)
    alone += np.where(visible, 0.5, -0.5) * np.log(size)
    gained: Floats = np.where(
        visible, OUTLIER_LOG_DENSITY - alone, alone - OUTLIER_LOG_DENSITY
    )
    return gained


def change_inliers(images: Images, flip_gain: Floats) -> Flags:
    """Flip the label of the landmark of each image that gains most; return outliers.

    (n, p). It is the one that gains most log density, if any gains. At least half of
    the landmarks that are seen stay inliers.
    """
    visible = images.visible
    is_there = images.weights > 0
    has_few_inliers = 2 * visible.sum(axis=1) <= is_there.sum(axis=1) + 1
    must_stay = has_few_inliers[:, None] & visible
    gained = np.where(must_stay, -np.inf, flip_gain)
    rows = np.arange(len(images))
    most = gained.argmax(axis=1)
    outliers = is_there & ~visible
    outliers[rows, most] ^= gained[rows, most] > 0
    return outliers


def step_views(views: Views, expected: Expected, damping: Floats) -> Views:
    """Step each view, damped, towards a higher log density of its image.

    damping (n,). By Fisher scoring, from the slopes, which must be there; at most
    `MAX_VIEW_STEP` in a direction.
    """
    assert expected.gradient is not None
    assert expected.information is not None
    trace = expected.information.trace(axis1=1, axis2=2)[:, None, None]
    damped = damping[:, None, None] * (trace / VIEW_DIRECTIONS) + 1e-12
    H = expected.information + damped * np.eye(VIEW_DIRECTIONS)
    step = np.linalg.solve(H, expected.gradient[..., None])[..., 0]
    longest = np.abs(step).max(axis=1, keepdims=True)
    step *= np.minimum(1.0, MAX_VIEW_STEP / np.maximum(longest, 1e-300))
    rotation = exponential(step[:, :3]) @ views.rotation
    return Views(rotation, views.log_scale + step[:, 3])


def split_ppca(
    mean: Floats, covariance: Floats, min_left: int = 1, max_modes: int = MAX_MODES
) -> Gaussian:
    """Split a covariance (3p, 3p) about the mean (3, p) into leading modes and a rest.

    The likeliest split: rho is the mean of the eigenvalues that are left (Tipping and
    Bishop 1999). At least `min_left` eigenvalues are, or the rest is next to nothing;
    there are at most `max_modes` modes. Noise and views stay to be set.
    """
    p = mean.shape[1]
    centred = covariance.reshape(3, p, 3, p)
    centred = centred - centred.mean(axis=1, keepdims=True)
    centred = centred - centred.mean(axis=3, keepdims=True)
    size, axes = np.linalg.eigh(centred.reshape(3 * p, 3 * p))
    q = min(max_modes, 3 * p - 3 - min_left)
    others = size[3 : 3 * p - q]  # the first three are translations
    rest = MIN_REST
    if len(others):
        rest = max(float(others.mean()), MIN_REST)
    modes = axes[:, -q:] * np.sqrt(np.maximum(size[-q:] - rest, 0.0))
    return Gaussian(
        mean=mean - mean.mean(axis=1, keepdims=True),
        modes=modes.reshape(3, p, q),
        rest=rest,
        noise=1.0,
        log_size=np.zeros(1),
        size_variance=1.0,
    )


def hide_some(visible: Flags) -> Flags:
    """Choose a tenth of the visible landmarks (n, p) at random, to be hidden.

    None of an image that would show three or fewer. Always the same ones.
    """
    hidden = visible & (np.random.default_rng(0).random(visible.shape) < 0.1)
    left = (visible & ~hidden).sum(axis=1, keepdims=True)
    chosen: Flags = hidden & (left > 3)
    return chosen

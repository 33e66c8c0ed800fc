"""The model of landmarks alone: one Gaussian over shapes, seen from unknown views.

    w_nj = s_n P R_n x_nj + t_n + e_nj,    e_nj ~ N(0, sigma^2 / omega_nj^2 I),
    x_n  = mu + V z_n + d_n,               z_n ~ N(0, I),  d_n ~ N(0, rho I),
    log s_n ~ N(log size of the sequence, tau^2),

P takes the first two rows, t is any translation. A landmark is an outlier with the
chance epsilon; then it falls with the density u per area. Close to the Procrustean
normal distribution of Lee, Cho, Choi and Oh (CVPR 2013) and to the model of Torresani,
Hertzmann and Bregler (PAMI 2008).

Expectation: with v_j = s^2 rho + sigma^2 / omega_j^2, B = s P R V and the translation
as two more columns of B with a flat prior, the landmarks less s P R mu, r, have

    M = diag(I, 0) + B^T v^-1 B,   z^ = M^-1 B^T v^-1 r,   alpha = v^-1 (r - B z^),
    log p = -1/2 (r^T alpha + log |M| + sum 2 log(2 pi v_j)),
    log p_j = -1/2 (a^T A^-1 a / v_j - log |A|) - log(2 pi v_j),

with A = I - B_j M^-1 B_j^T / v_j, a = (r - B z^)_j and p_j what the other landmarks say
of landmark j, seen; for an outlier A^-1 = I + B_j M^-1 B_j^T / v_j,

and the landmarks of the shape x_j = mu_j + V_j z + (s rho / v_j) (P R)^T (r - B z)_j.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any, NamedTuple, TypeVar

import numpy as np

from shapefit import core
from shapefit.arrays import Flags, Floats, Indices
from shapefit.geometry.rotations import exponential

VIEW_DIRECTIONS = 4
"""In which a view moves: turns about the axes of the camera, and log s."""

TRANSLATION_PRECISION = 1e-9
"""Before the image is seen."""

OUTLIER_LOG_DENSITY = np.log(0.02 / (1 - 0.02) * 0.05)
"""With the odds that a landmark is an outlier."""

MAX_VIEW_STEP = 0.3
"""In radians and log s."""

VIEW_MOTIONS = np.array(
    [
        [[0.0, 0.0, 0.0], [0.0, 0.0, -1.0]],
        [[0.0, 0.0, 1.0], [0.0, 0.0, 0.0]],
        [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0]],
        [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
    ]
)
"""P K_o (4, 2, 3): how the image of a point moves in each direction of a view."""

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

    log_density (n,), shapes E x (n, 3, p) and translation (n, 2). root (n, 3p, q + 2),
    a root of the covariance of shapes but for what landmarks alone tell, and gain (n,
    p) = s^2 rho / v, from which that follows; gradient (n, 4) and information (n, 4, 4)
    of the log density by the view, None where they were not asked for;
    residual_variance (n,), the sum over the visible landmarks of omega^2 E |e|^2;
    flip_gain (n, p), the log density that an image gains where one landmark becomes an
    outlier, or stops to be one.
    """

    log_density: Floats
    flip_gain: Floats
    shapes: Floats
    translation: Floats
    root: Floats
    gain: Floats
    gradient: Floats | None
    information: Floats | None
    residual_variance: Floats


OfImages = TypeVar("OfImages", Views, Expected)


def posterior_mean(
    images: Images, views: Views, model: Gaussian, *, slopes: bool = False
) -> Expected:
    """Return the posterior moments of the shapes in the images, given their views.

    With `slopes` also the gradient and the information of the log density by the views.
    With U U^T = M^-1 all that is needed follows from V U, by landmark. The gradient is
    that of the expected log density of image and shape together (Fisher's identity);
    the information is that of the mean shape, the covariance held.
    """
    n, _, p = images.landmarks.shape
    q = model.modes.shape[2]
    projected = _project(images, views, model)
    B, u = projected.B, projected.u
    U = _root_of_covariance(B, u, q)
    linear_term = (u[:, None] * projected.r).reshape(n, 1, 2 * p) @ B
    z = (U @ (linear_term @ U)[:, 0, :, None])[..., 0]
    left = projected.r - (B @ z[..., None]).reshape(n, 2, p)
    alpha = u[:, None] * left
    gain = projected.rest * u
    back = gain / projected.s[:, None]
    RP = projected.PR.transpose(0, 2, 1)
    V = model.modes.reshape(3 * p, q)
    deformation = (z[:, :q] @ V.T).reshape(n, 3, p)
    shapes = model.mean + deformation + back[:, None] * (RP @ left)
    VU = (V @ U[:, :q]).reshape(n, 3, -1)
    half = (projected.sPR @ VU).reshape(n, 2, p, q + 2)
    half += U[:, q:, None]
    # H = B M^-1 B^T of each landmark with itself: what the others leave open of it
    H = np.einsum("ncpk,ndpk->npcd", half, half)
    half *= u[:, None, :, None]
    weighted = half.reshape(n, 2, -1)
    gradient = information = None
    if slopes:
        # d log p = alpha^T dA x^ - tr(dA C A^T Sigma^-1), of which the second takes the
        # blocks of each landmark with itself
        stays = back[..., None, None] * (np.eye(2) - u[..., None, None] * H)
        of_landmark = weighted @ VU.transpose(0, 2, 1)
        of_landmark = of_landmark + stays.sum(axis=1) @ projected.PR
        moved = alpha @ shapes.transpose(0, 2, 1) - of_landmark
        gradient, information = _slopes(views, model, projected, U, moved)
        _add_slopes_of_size(gradient, information, images, views, model)
    root = VU
    root -= (projected.s * model.rest)[:, None, None] * RP @ weighted
    flip_gain = find_flip_gain(left, H, projected.v, images.visible)
    return Expected(
        log_density=_log_density(images, views, model, projected, U, alpha),
        flip_gain=np.where(images.weights > 0, flip_gain, -np.inf),
        shapes=shapes,
        translation=z[:, q:],
        root=root.reshape(n, 3 * p, -1),
        gain=gain,
        gradient=gradient,
        information=information,
        residual_variance=_residual_variance(images, projected, gain, left, H),
    )


class _Projected(NamedTuple):
    """A model projected into images by their views.

    s (n,); P R (n, 2, 3) and s P R; s^2 rho (n, 1); v and u = 1 / v of visible
    landmarks, else 0 (n, p); B (n, 2p, q + 2) and residuals r (n, 2, p).
    """

    s: Floats
    PR: Floats
    sPR: Floats
    rest: Floats
    v: Floats
    u: Floats
    B: Floats
    r: Floats


def _project(images: Images, views: Views, model: Gaussian) -> _Projected:
    """Project the mean and the modes of a model into images by their views."""
    n, _, p = images.landmarks.shape
    q = model.modes.shape[2]
    s = np.exp(views.log_scale)
    PR = views.rotation[:, :2]
    sPR = s[:, None, None] * PR
    is_there = images.weights > 0
    rest = (s**2 * model.rest)[:, None]
    v = rest + model.noise / np.where(is_there, images.weights, 1.0) ** 2
    u = np.where(images.visible, 1.0 / v, 0.0)
    modes = sPR.reshape(2 * n, 3) @ model.modes.reshape(3, p * q)
    B = np.zeros((n, 2, p, q + 2))
    B[..., :q] = modes.reshape(n, 2, p, q)
    B[:, 0, :, q] = 1.0
    B[:, 1, :, q + 1] = 1.0
    r = np.where(is_there[:, None], images.landmarks - sPR @ model.mean, 0.0)
    return _Projected(s, PR, sPR, rest, v, u, B.reshape(n, 2 * p, q + 2), r)


def _root_of_covariance(B: Floats, u: Floats, q: int) -> Floats:
    """Return upper U (n, q + 2, q + 2), U U^T = (B^T diag(u, u) B + prior)^-1."""
    n, _, columns = B.shape
    uB = (u[:, None, :, None] * B.reshape(n, 2, u.shape[1], columns)).reshape(B.shape)
    M = uB.transpose(0, 2, 1) @ B
    M[:, np.arange(q), np.arange(q)] += 1.0
    M[:, [q, q + 1], [q, q + 1]] += TRANSLATION_PRECISION
    core.invert_factors(matrices=M, threads=1)
    return M.transpose(0, 2, 1)


def _log_density(
    images: Images,
    views: Views,
    model: Gaussian,
    projected: _Projected,
    root: Floats,
    weighted_residuals: Floats,
) -> Floats:
    """Return the log density (n,) of the images and of the sizes of their views."""
    visible = images.visible
    log_density = -0.5 * (projected.r * weighted_residuals).sum(axis=(1, 2))
    log_density += np.log(np.einsum("nqq->nq", root)).sum(axis=1)
    log_density -= np.where(visible, np.log(2 * np.pi * projected.v), 0.0).sum(axis=1)
    outliers = ((images.weights > 0) & ~visible).sum(axis=1)
    log_density += OUTLIER_LOG_DENSITY * outliers
    deviation = views.log_scale - model.log_size[images.sequence]
    variance = model.size_variance
    log_density -= 0.5 * (deviation**2 / variance + np.log(2 * np.pi * variance))
    return np.asarray(log_density)


def _residual_variance(
    images: Images,
    projected: _Projected,
    gain: Floats,
    residuals: Floats,
    covariance: Floats,
) -> Floats:
    """Return the expected error omega^2 E |e|^2 (n,), summed over visible landmarks."""
    omega = images.weights
    share = np.where(images.visible, 1 - gain, 0.0)
    squares = (residuals**2).sum(axis=1) + covariance[..., 0, 0] + covariance[..., 1, 1]
    of_landmark = omega**2 * share**2 * squares + 2 * omega**2 * share * projected.rest
    return np.asarray(of_landmark.sum(axis=1))


def _slopes(
    views: Views, model: Gaussian, projected: _Projected, root: Floats, slope: Floats
) -> tuple[Floats, Floats]:
    """Return gradient (n, 4) and information (n, 4, 4) of log densities by the views.

    slope (n, 2, 3): the derivative of the log density by s P R.
    """
    n = len(projected.s)
    B, u = projected.B, projected.u
    turned = np.einsum("oca,nai->noci", VIEW_MOTIONS, views.rotation)
    D = projected.s[:, None, None, None] * turned
    gradient = np.einsum("noci,nci->no", D, slope)
    J = (D.reshape(-1, 3) @ model.mean).reshape(n, VIEW_DIRECTIONS, B.shape[1])
    uJ = J * np.tile(u, 2)[:, None]
    JB = uJ @ B @ root
    information = J @ uJ.transpose(0, 2, 1) - JB @ JB.transpose(0, 2, 1)
    return gradient, information


def _add_slopes_of_size(
    gradient: Floats,
    information: Floats,
    images: Images,
    views: Views,
    model: Gaussian,
) -> None:
    """Add the slopes of the prior of log s to gradient and information, in place."""
    deviation = views.log_scale - model.log_size[images.sequence]
    gradient[:, 3] -= deviation / model.size_variance
    information[:, 3, 3] += 1 / model.size_variance


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


def sum_covariances(expected: Expected, views: Views, model: Gaussian) -> Floats:
    """Return the sum over images of the covariance (3p, 3p) of their shapes."""
    n, _, p = expected.shapes.shape
    PR = views.rotation[:, :2]
    root = expected.root.transpose(1, 0, 2).reshape(3 * p, -1)
    total: Floats = root @ root.T
    across = (PR.transpose(0, 2, 1) @ PR).reshape(n, 9)
    retained = (expected.gain.T @ across).reshape(p, 3, 3)
    j = np.arange(p)
    of_itself = total.reshape(3, p, 3, p)
    of_itself[:, j, :, j] += model.rest * (n * np.eye(3) - retained)
    return total


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


def choose_rows(mask: Flags, yes: OfImages, no: OfImages) -> OfImages:
    """Return the rows of `yes` where the mask (n,) is True, else those of `no`.

    Of each field, None where one of the two has none.
    """
    chosen: dict[str, Any] = {}
    for column in fields(yes):
        a = getattr(yes, column.name)
        b = getattr(no, column.name)
        if a is None or b is None:
            chosen[column.name] = None
        else:
            of_each = mask.reshape(-1, *[1] * (a.ndim - 1))
            chosen[column.name] = np.where(of_each, a, b)
    return replace(yes, **chosen)


def hide_some(visible: Flags) -> Flags:
    """Choose a tenth of the visible landmarks (n, p) at random, to be hidden.

    None of an image that would show three or fewer. Always the same ones.
    """
    hidden = visible & (np.random.default_rng(0).random(visible.shape) < 0.1)
    left = (visible & ~hidden).sum(axis=1, keepdims=True)
    chosen: Flags = hidden & (left > 3)
    return chosen

"""The model of landmarks without 3D examples: one Gaussian over shapes, seen from
unknown views.

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
    log p_j = -1/2 (a^T A^-1 a / v_j - log |A|) - log(2 pi v_j),  A = I - B_j M^-1 B_j^T
                                                                  / v_j,

with a = (r - B z^)_j and p_j what the other landmarks say of landmark j, seen; for an
outlier A^-1 = I + B_j M^-1 B_j^T / v_j,

and the landmarks of the shape x_j = mu_j + V_j z + (s rho / v_j) (P R)^T (r - B z)_j.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from shapefit import core
from shapefit.arrays import Floats
from shapefit.geometry.rotations import exponential

Indices = NDArray[np.intp]
Mask = NDArray[np.bool_]
Record = TypeVar("Record", bound=Any)

DIRECTIONS = 4
"""Of a view: turns about the axes of the camera, and log s."""

FLAT = 1e-9
"""Precision of the translation before the image is seen."""

OUTLIERS = np.log(0.02 / (1 - 0.02) * 0.05)
"""Log density of an outlier, with the odds that it is one."""

LONGEST = 0.3
"""Step of a view, in radians and log s."""

TURNS = np.array(
    [
        [[0.0, 0.0, 0.0], [0.0, 0.0, -1.0]],
        [[0.0, 0.0, 1.0], [0.0, 0.0, 0.0]],
        [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0]],
        [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
    ]
)
"""P K_o (4, 2, 3): how the image of a point of the camera's frame moves in each
direction.
"""

MOST_MODES = 64
"""Modes V of a model at most."""

LEAST_REST = 1e-9
"""Variance of a coordinate beside the modes at least."""


@dataclass(frozen=True)
class Images:
    """n images: landmarks w (n, 2, p), weights omega (n, p), 0 where hidden, sequence
    (n,).

    The landmarks of each sequence, numbered from 0, are of comparable size, and lie
    anywhere where they are outliers (n, p); None where all count as inliers.
    """

    landmarks: Floats
    weights: Floats
    sequence: Indices
    outliers: Mask | None = None

    def __len__(self) -> int:
        return len(self.landmarks)

    def __getitem__(self, rows: slice | Indices) -> Images:
        outliers = None if self.outliers is None else self.outliers[rows]
        return Images(
            self.landmarks[rows], self.weights[rows], self.sequence[rows], outliers
        )

    @property
    def visible(self) -> Mask:
        """Landmarks (n, p) that have a weight and are inliers."""
        there = self.weights > 0
        return there if self.outliers is None else there & ~self.outliers

    def hiding(self, landmarks: Mask) -> Images:
        """Return the images with these landmarks (n, p) hidden, and no outlier."""
        return Images(
            self.landmarks, np.where(landmarks, 0.0, self.weights), self.sequence
        )


@dataclass(frozen=True)
class Views:
    """Rotations R (n, 3, 3) and log s (n,)."""

    rotation: Floats
    log_scale: Floats

    def __getitem__(self, rows: slice | Indices) -> Views:
        return Views(self.rotation[rows], self.log_scale[rows])


@dataclass(frozen=True)
class Gaussian:
    """mean mu (3, p), modes V (3, p, q), rest rho, noise sigma^2; log_size
    (sequences,), tau^2.
    """

    mean: Floats
    modes: Floats
    rest: float
    noise: float
    log_size: Floats
    size_variance: float

    @property
    def covariance(self) -> Floats:
        """V V^T + rho I (3p, 3p), all x first, then y, then z."""
        V = self.modes.reshape(self.mean.size, -1)
        C: Floats = V @ V.T + self.rest * np.eye(len(V))
        return C


@dataclass(frozen=True)
class Expected:
    """Of n images: log_density (n,), shapes E x (n, 3, p) and translation (n, 2).

    root (n, 3p, q + 2), a root of the covariance of shapes but for what landmarks alone
    tell, and gain (n, p) = s^2 rho / v, from which that follows; gradient (n, 4) and
    information (n, 4, 4) of the log density by the view, None where they were not asked
    for; residual_variance (n,), the sum over the visible landmarks of omega^2 E |e|^2;
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


def posterior_mean(
    images: Images, views: Views, model: Gaussian, *, slopes: bool = False
) -> Expected:
    """Expectation step: shapes given their images, with the slopes of the log density
    by the views.

    With U U^T = M^-1 all that is needed of it follows from V U, by landmark. The
    gradient is that of the expected log density of image and shape together (Fisher's
    identity); the information is that of the mean shape, the covariance held.
    """
    n, _, p = images.landmarks.shape
    q = model.modes.shape[2]
    s = np.exp(views.log_scale)
    PR = views.rotation[:, :2]
    sPR = s[:, None, None] * PR
    omega = images.weights
    visible, there = images.visible, omega > 0
    rest = (s**2 * model.rest)[:, None]
    v = rest + model.noise / np.where(there, omega, 1.0) ** 2
    u = np.where(visible, 1.0 / v, 0.0)
    B = np.zeros((n, 2, p, q + 2))
    B[..., :q] = (sPR.reshape(2 * n, 3) @ model.modes.reshape(3, p * q)).reshape(
        n, 2, p, q
    )
    B[:, 0, :, q] = B[:, 1, :, q + 1] = 1.0
    flat = B.reshape(n, 2 * p, q + 2)
    r = np.where(there[:, None], images.landmarks - sPR @ model.mean, 0.0)
    M = (u[:, None, :, None] * B).reshape(flat.shape).transpose(0, 2, 1) @ flat
    M[:, np.arange(q), np.arange(q)] += 1.0
    M[:, [q, q + 1], [q, q + 1]] += FLAT
    core.invert_factors(matrices=M, threads=1)
    U = M.transpose(0, 2, 1)
    linear_term = (u[:, None] * r).reshape(n, 1, 2 * p) @ flat
    z = (U @ (linear_term @ U)[:, 0, :, None])[..., 0]
    left = r - (flat @ z[..., None]).reshape(n, 2, p)
    alpha = u[:, None] * left
    log_density = -0.5 * (r * alpha).sum(axis=(1, 2))
    log_density += np.log(np.einsum("nqq->nq", U)).sum(axis=1)
    log_density -= np.where(visible, np.log(2 * np.pi * v), 0.0).sum(axis=1)
    log_density += OUTLIERS * (there & ~visible).sum(axis=1)
    deviation = views.log_scale - model.log_size[images.sequence]
    variance = model.size_variance
    log_density -= 0.5 * (deviation**2 / variance + np.log(2 * np.pi * variance))
    gain = rest * u
    back = gain / s[:, None]
    RP = PR.transpose(0, 2, 1)
    V = model.modes.reshape(3 * p, q)
    shapes = (
        model.mean + (z[:, :q] @ V.T).reshape(n, 3, p) + back[:, None] * (RP @ left)
    )
    VU = (V @ U[:, :q]).reshape(n, 3, -1)
    half = (sPR @ VU).reshape(n, 2, p, q + 2)
    half += U[:, q:, None]
    # H = B M^-1 B^T of each landmark with itself: what the others leave open of it
    H = np.einsum("ncpk,ndpk->npcd", half, half)
    half *= u[:, None, :, None]
    weighted = half.reshape(n, 2, -1)
    share = np.where(visible, 1 - gain, 0.0)
    flip_gain = np.where(there, flip_gain_of(left, H, v, visible), -np.inf)
    residual_variance = (
        omega**2 * share**2 * ((left**2).sum(axis=1) + H[..., 0, 0] + H[..., 1, 1])
        + 2 * omega**2 * share * rest
    ).sum(axis=1)
    gradient = information = None
    if slopes:
        # d log p = alpha^T dA x^ - tr(dA C A^T Sigma^-1), of which the second takes the
        # blocks of each landmark with itself
        stays = back[..., None, None] * (np.eye(2) - u[..., None, None] * H)
        of_landmark = weighted @ VU.transpose(0, 2, 1) + stays.sum(axis=1) @ PR
        D = s[:, None, None, None] * np.einsum("oca,nai->noci", TURNS, views.rotation)
        moved = alpha @ shapes.transpose(0, 2, 1)
        gradient = np.einsum("noci,nci->no", D, moved - of_landmark)
        J = (D.reshape(-1, 3) @ model.mean).reshape(n, DIRECTIONS, 2 * p)
        uJ = J * np.tile(u, 2)[:, None]
        JB = uJ @ flat @ U
        information = J @ uJ.transpose(0, 2, 1) - JB @ JB.transpose(0, 2, 1)
        gradient[:, 3] -= deviation / variance
        information[:, 3, 3] += 1 / variance
    root = VU
    root -= (s * model.rest)[:, None, None] * RP @ weighted
    return Expected(
        log_density,
        flip_gain,
        shapes,
        z[:, q:],
        root.reshape(n, 3 * p, -1),
        gain,
        gradient,
        information,
        residual_variance,
    )


def flip_gain_of(left: Floats, H: Floats, v: Floats, visible: Mask) -> Floats:
    """Log density gained (n, p) where one landmark becomes an outlier, or one stops to
    be one.
    """
    A = np.eye(2) + np.where(visible, -1 / v, 1 / v)[..., None, None] * H
    size = np.maximum(A[..., 0, 0] * A[..., 1, 1] - A[..., 0, 1] ** 2, 1e-12)
    a, b = left[:, 0], left[:, 1]
    square = A[..., 1, 1] * a**2 - 2 * A[..., 0, 1] * a * b + A[..., 0, 0] * b**2
    alone = -0.5 * square / (size * v) - np.log(2 * np.pi * v)
    alone += np.where(visible, 0.5, -0.5) * np.log(size)
    gained: Floats = np.where(visible, OUTLIERS - alone, alone - OUTLIERS)
    return gained


def change_inliers(images: Images, flip_gain: Floats) -> Mask:
    """Flip whether the most doubtful landmark of an image is an outlier; at least half
    are not.
    """
    visible, rows = images.visible, np.arange(len(images))
    few = 2 * visible.sum(axis=1) <= (images.weights > 0).sum(axis=1) + 1
    gained = np.where(few[:, None] & visible, -np.inf, flip_gain)
    most = gained.argmax(axis=1)
    outliers = (images.weights > 0) & ~visible
    outliers[rows, most] ^= gained[rows, most] > 0
    return outliers


def scatter(expected: Expected, views: Views, model: Gaussian) -> Floats:
    """sum_n Cov x_n (3p, 3p)."""
    n, _, p = expected.shapes.shape
    PR = views.rotation[:, :2]
    root = expected.root.transpose(1, 0, 2).reshape(3 * p, -1)
    total: Floats = root @ root.T
    retained = expected.gain.T @ (PR.transpose(0, 2, 1) @ PR).reshape(n, 9)
    j = np.arange(p)
    total.reshape(3, p, 3, p)[:, j, :, j] += model.rest * (
        n * np.eye(3) - retained.reshape(p, 3, 3)
    )
    return total


def ascent(views: Views, expected: Expected, damping: Floats) -> Views:
    """Take a damped scoring step of each view (n,) towards more log density."""
    assert expected.gradient is not None
    assert expected.information is not None
    trace = expected.information.trace(axis1=1, axis2=2)[:, None, None] / DIRECTIONS
    H = expected.information + (damping[:, None, None] * trace + 1e-12) * np.eye(
        DIRECTIONS
    )
    step = np.linalg.solve(H, expected.gradient[..., None])[..., 0]
    step *= np.minimum(
        1.0, LONGEST / np.maximum(np.abs(step).max(axis=1, keepdims=True), 1e-300)
    )
    return Views(
        exponential(step[:, :3]) @ views.rotation, views.log_scale + step[:, 3]
    )


def split_ppca(
    mean: Floats, covariance: Floats, left: int = 1, most: int = MOST_MODES
) -> Gaussian:
    """Split a covariance (3p, 3p) about the mean (3, p) into leading modes and a rest
    rho.

    The likeliest split: rho is the mean of the eigenvalues that are left (Tipping and
    Bishop 1999). At least `left` eigenvalues are, or the rest is next to nothing; modes
    are at `most` so many. Noise and views stay to be set.
    """
    p = mean.shape[1]
    centred = covariance.reshape(3, p, 3, p)
    centred = centred - centred.mean(axis=1, keepdims=True)
    centred = centred - centred.mean(axis=3, keepdims=True)
    size, axes = np.linalg.eigh(centred.reshape(3 * p, 3 * p))
    q = min(most, 3 * p - 3 - left)
    others = size[3 : 3 * p - q]  # the first three are translations
    rest = max(float(others.mean()), LEAST_REST) if len(others) else LEAST_REST
    modes = axes[:, -q:] * np.sqrt(np.maximum(size[-q:] - rest, 0.0))
    return Gaussian(
        mean - mean.mean(axis=1, keepdims=True),
        modes.reshape(3, p, q),
        rest,
        1.0,
        np.zeros(1),
        1.0,
    )


def choose(mask: Mask, yes: Record, no: Record) -> Record:
    """Return the record whose rows are those of `yes` where the mask (n,) is True, else
    of `no`.
    """
    pairs = (
        (getattr(yes, entry.name), getattr(no, entry.name)) for entry in fields(yes)
    )
    rows = (
        (
            None
            if a is None or b is None
            else np.where(mask.reshape(-1, *(1,) * (a.ndim - 1)), a, b)
        )
        for a, b in pairs
    )
    chosen: Record = type(yes)(*rows)
    return chosen


def hide(visible: Mask) -> Mask:
    """Choose a tenth of the seen landmarks (n, p), at random; enough of an image
    stays.
    """
    hidden = visible & (np.random.default_rng(0).random(visible.shape) < 0.1)
    chosen: Mask = hidden & ((visible & ~hidden).sum(axis=1, keepdims=True) > 3)
    return chosen

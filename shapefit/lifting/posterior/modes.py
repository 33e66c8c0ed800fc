"""The modes of the posterior over shape and view, image by image."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from shapefit.dictionary.mixture import Mixture
from shapefit.geometry.rotations import rotation_about
from shapefit.lifting.posterior.marginal import Gross, Marginal, Views, find_marginal

Floats = NDArray[np.float64]

SAME_VIEW = 1e-2
"""Rotations closer than this (Frobenius norm) are one mode of a component."""

ROUNDS = 30
STEP = 1e-4  # of the differences that carry the uncertainty of the view


@dataclass(frozen=True)
class Mode:
    """A local maximum over the view of one component, in normalised units.

    component; rotation R (3, 3); scale s; translation t (2,); mean (3, p) of y = s R x + t, the
    shape in the frame of the camera, where the image is, with mean depth 0; covariance (3p, 3p) of
    y, flattened x first, then y, then z, the uncertainty of the view included; belief (p,) that a
    landmark is not gross; log_evidence of the component and the image together, the view
    integrated out by Laplace's approximation: a mode's share of the posterior is
    exp(log_evidence) beside the sum over all modes.
    """

    component: int
    rotation: Floats
    scale: float
    translation: Floats
    mean: Floats
    covariance: Floats
    belief: Floats
    log_evidence: float
    half: float = 0.0


def find_modes(
    landmarks: Floats,
    precision: Floats,
    prior: Mixture,
    starts: Floats,
    gross: Gross | None = None,
) -> list[list[Mode]]:
    """Return the modes of n images, the most likely first.

    landmarks (n, 2, p), normalised; precision (n, p, 2, 2), the inverse covariance of each
    landmark's noise, 0 where it is hidden; starts (n, s, 3, 3), rotations from the frame of the
    prior to that of the camera, nan where there are fewer. Every start is climbed under every
    component, and those that arrive at the same view count once.
    """
    gross = gross or Gross()
    n, _, p = landmarks.shape
    image, start = np.nonzero(np.isfinite(starts).all(axis=(2, 3)))
    k = len(prior)
    image, start = np.repeat(image, k), np.repeat(start, k)
    component = np.tile(np.arange(k), len(image) // max(k, 1))
    given = (
        landmarks[image],
        precision[image],
        prior.means[component],
        prior.covariances[component],
    )
    rotation = starts[image, start]
    scale = first_scale(given[0], precision[image], rotation @ given[2])
    begin = Views(rotation, np.log(scale), np.ones((len(image), p)))
    views, found = climb(given, begin, gross)
    H = measure_curvature(given, views, gross)
    size = np.linalg.slogdet(H)
    fine = (size.sign > 0) & (np.linalg.eigvalsh(H)[:, 0] > 0)
    H = np.where(fine[:, None, None], H, found.curvature)
    evidence = found.value + np.log(prior.weights)[component]
    evidence += 2 * np.log(2 * np.pi) - 0.5 * np.linalg.slogdet(H)[1]
    covariance = found.covariance + carry_view(given, views, gross, H)
    mean, covariance = centre_depth(found.shape, covariance)
    modes: list[list[Mode]] = [[] for _ in range(n)]
    for row in np.argsort(-evidence, kind="stable").tolist():
        others = modes[image[row]]
        R = views.rotation[row]
        if any(
            other.component == component[row] and np.linalg.norm(other.rotation - R) < SAME_VIEW
            for other in others
        ):
            continue
        s = float(np.exp(views.log_scale[row]))
        inner = mean[row, :2].mean(axis=1)
        others.append(
            Mode(
                component=int(component[row]),
                rotation=R,
                scale=s,
                translation=inner,
                mean=mean[row],
                covariance=covariance[row],
                belief=views.belief[row],
                log_evidence=float(evidence[row]),
                half=float(0.5 * np.linalg.slogdet(H[row])[1] - 2 * np.log(2 * np.pi)),
            )
        )
    return modes


def shares(modes: list[Mode]) -> Floats:
    """Each mode's share of the posterior; they add up to 1."""
    log = np.array([mode.log_evidence for mode in modes])
    share = np.exp(log - log.max())
    found: Floats = share / share.sum()
    return found


def combine(modes: list[Mode]) -> tuple[Floats, Floats]:
    """Mean (3, p) and covariance (3p, 3p) of the mixture of the modes."""
    share = shares(modes)
    means = np.stack([mode.mean for mode in modes])
    mean = np.tensordot(share, means, axes=1)
    covariance = np.tensordot(share, np.stack([mode.covariance for mode in modes]), axes=1)
    apart = (means - mean).reshape(len(modes), -1)
    return mean, covariance + np.einsum("m,mi,mj->ij", share, apart, apart)


Given = tuple[Floats, Floats, Floats, Floats]


def first_scale(landmarks: Floats, precision: Floats, turned: Floats) -> Floats:
    """Return the s that fits s R_2 mu + t to the seen landmarks best, and at least 0.1."""
    seen = (precision[:, :, 0, 0] > 0)[:, None]
    count = np.maximum(seen.sum(axis=2, keepdims=True), 1)

    def centred(points: Floats) -> Floats:
        middle = np.where(seen, points, 0.0).sum(axis=2, keepdims=True) / count
        return np.where(seen, points - middle, 0.0)

    w, m = centred(landmarks), centred(turned[:, :2])
    size = np.maximum((m * m).sum(axis=(1, 2)), 1e-300)
    scale: Floats = np.maximum((w * m).sum(axis=(1, 2)) / size, 0.1)
    return scale


def moved(views: Views, theta: Floats) -> Views:
    """Turn by theta[:, :3] in the frame of the camera, and grow by exp(theta[:, 3])."""
    angle = np.linalg.norm(theta[:, :3], axis=1)
    axis = np.where(angle[:, None] > 0, theta[:, :3], [1.0, 0.0, 0.0])
    axis = axis / np.linalg.norm(axis, axis=1, keepdims=True)
    x, y, z = axis.T
    zero = np.zeros_like(x)
    cross = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)
    turned = (
        np.eye(3)
        + np.sin(angle)[:, None, None] * cross
        + (1 - np.cos(angle))[:, None, None] * (cross @ cross)
    )
    return Views(turned @ views.rotation, views.log_scale + theta[:, 3], views.belief)


def climb(given: Given, views: Views, gross: Gross) -> tuple[Views, Marginal]:
    """Maximise the marginal likelihood over the views: Levenberg-Marquardt, never downhill.

    The belief moves to its fixed point after every step, which raises the bound too.
    """
    n = len(given[0])
    damping = np.full(n, 1e-3)
    found = find_marginal(*given, views, gross)
    if gross.chance > 0:
        views = Views(views.rotation, views.log_scale, found.belief)
        found = find_marginal(*given, views, gross)
    active = np.arange(n)
    for _ in range(ROUNDS):
        part = tuple(a[active] for a in given)
        now = Views(*(a[active] for a in (views.rotation, views.log_scale, views.belief)))
        H, g = found.curvature[active], found.gradient[active]
        diagonal = np.einsum("nii->ni", H)[:, :, None] * np.eye(4) + 1e-9 * np.eye(4)
        step = -np.linalg.solve(H + damping[active, None, None] * diagonal, g[..., None])[..., 0]
        length = np.linalg.norm(step, axis=1)
        step *= np.minimum(1, 0.5 / np.maximum(length, 1e-300))[:, None]
        tried = moved(now, step)
        new = find_marginal(*part, tried, gross)  # type: ignore[arg-type]
        if gross.chance > 0:
            tried = Views(tried.rotation, tried.log_scale, new.belief)
            new = find_marginal(*part, tried, gross)  # type: ignore[arg-type]
        better = new.value >= found.value[active] - 1e-12
        gain = new.value - found.value[active]
        rows = active[better]
        for name in ("rotation", "log_scale", "belief"):
            getattr(views, name)[rows] = getattr(tried, name)[better]
        for name in Marginal.__dataclass_fields__:
            getattr(found, name)[rows] = getattr(new, name)[better]
        damping[active] = np.where(better, damping[active] / 5, damping[active] * 10)
        still = better & (np.abs(gain) < 1e-9) & (length < 1e-6)
        active = active[~(still | (damping[active] > 1e8))]
        if not len(active):
            break
    return views, found


def measure_curvature(given: Given, views: Views, gross: Gross) -> Floats:
    """Hessian (N, 4, 4) of the negative log marginal over theta, belief held, by differences."""
    H = np.empty((len(given[0]), 4, 4))
    for i in range(4):
        step = np.zeros((len(H), 4))
        step[:, i] = STEP
        ahead = find_marginal(*given, moved(views, step), gross).gradient
        behind = find_marginal(*given, moved(views, -step), gross).gradient
        H[:, i] = (ahead - behind) / (2 * STEP)
    symmetric: Floats = 0.5 * (H + H.swapaxes(1, 2))
    return symmetric


def carry_view(given: Given, views: Views, gross: Gross, curvature: Floats) -> Floats:
    """J H^-1 J^T (N, 3p, 3p), J the derivative of the conditional mean over theta."""
    n, _, p = given[0].shape
    J = np.empty((n, 3 * p, 4))
    for i in range(4):
        step = np.zeros((n, 4))
        step[:, i] = STEP
        ahead = find_marginal(*given, moved(views, step), gross).shape
        behind = find_marginal(*given, moved(views, -step), gross).shape
        J[:, :, i] = ((ahead - behind) / (2 * STEP)).reshape(n, -1)
    carried: Floats = J @ np.linalg.solve(curvature, J.swapaxes(1, 2))
    return carried


def centre_depth(shape: Floats, covariance: Floats) -> tuple[Floats, Floats]:
    """Take the mean depth out: it cannot be seen."""
    p = shape.shape[2]
    Z = np.eye(3 * p)
    Z[2 * p :, 2 * p :] -= 1 / p
    return (Z @ shape.reshape(len(shape), -1, 1)).reshape(shape.shape), Z @ covariance @ Z.T

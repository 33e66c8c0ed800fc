"""A mixture over shapes, adapted to landmarks: expectation maximisation from a start.

The shapes of component k are x = mu_k + V_k (m_k + L_k z) + d, z ~ N(0, I), with mu_k, V_k and d of
the start, for which m = 0 and L = I. With C = L L^T and the hypotheses i of image n,

    max over pi, m, L, tau, R, s of  sum_n log sum_i pi_k p(w_n | R_i, s_i, m_k, L_k) p(s_i)
        + kappa sum_k pi0_k (log pi_k - 1/2 (log |C_k| + tr(C_k^-1 (I + m_k m_k^T))))
        - n / 2 (log tau^2 + SCALE^2 / tau^2):

the start counts as kappa images whose shapes are known, a normal-inverse-Wishart prior of each
component. A hypothesis is a component and a view; no round lowers the objective.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from shapefit.dictionary.from_2d.learning import BLOCK, SCALE, SPREAD, STILL
from shapefit.dictionary.from_2d.model import (
    Floats,
    Gaussian,
    Images,
    Indices,
    Views,
    choose,
    climb,
    expect,
    maximise,
)
from shapefit.dictionary.mixture import Mixture
from shapefit.geometry.procrustes import similarity_transform

HYPOTHESES = 8
"""Components of each image: those under which its shape as the start lifts it is likeliest."""

LEAST_SHARE = 1e-3
"""Of an image, at first, below which a hypothesis is left out."""

MOST_ROUNDS = 20


@dataclass(frozen=True, kw_only=True)
class Start:
    """The mixture to start from, and how images show it.

    landmark_map A (p, p): the landmarks are those of the shapes A x; noise sigma^2 of a
    coordinate; weight kappa in images.
    """

    prior: Mixture
    landmark_map: Floats
    noise: float
    weight: float


@dataclass(frozen=True)
class Adapted:
    """weights pi (K,), m (K, q), L (K, q, q); log_size (sequences,), tau^2.

    The objective is that of the mixture before.
    """

    weights: Floats
    shift: Floats
    factor: Floats
    log_size: Floats
    spread: float
    objective: float = -np.inf


@dataclass(frozen=True)
class Hypotheses:
    """r components and views that images might show: image (r,), component (r,), damping (r,)."""

    image: Indices
    component: Indices
    views: Views
    damping: Floats

    def __len__(self) -> int:
        return len(self.image)

    def __getitem__(self, rows: Indices) -> Hypotheses:
        return Hypotheses(
            self.image[rows], self.component[rows], self.views[rows], self.damping[rows]
        )


@dataclass(frozen=True)
class Responsibilities:
    """Hypotheses after a step of their views, and how far each explains its image.

    log_density (n,) of the images, share (r,) of each hypothesis in its image, E z (r, q) and its
    covariance (r, q, q).
    """

    hypotheses: Hypotheses
    log_density: Floats
    share: Floats
    mean: Floats
    covariance: Floats


def adapt(images: Images, shapes: Floats, start: Start) -> Iterator[tuple[Mixture, float]]:
    """Yield the mixture and the objective before it, round by round.

    shapes (n, 3, p) A x of the images before the camera, as the start has lifted them.
    """
    given = start.prior
    # all that the start allows is in its modes: the rest does not adapt
    both = zip(given.means, given.covariances, strict=True)
    models = [maximise(mean, covariance, left=0) for mean, covariance in both]
    k, q = len(given), models[0].modes.shape[2]
    hypotheses = first_hypotheses(shapes, start)
    state = Adapted(
        given.weights,
        np.zeros((k, q)),
        np.tile(np.eye(q), (k, 1, 1)),
        sizes(images, hypotheses, np.ones(len(hypotheses))),
        SPREAD**2,
    )
    first = expectation_step(images, hypotheses, seen_models(state, models, start), state.weights)
    hypotheses = first.hypotheses[np.flatnonzero(first.share > LEAST_SHARE)]
    coordinates = 2 * int((images.weights > 0).sum())
    for _ in range(MOST_ROUNDS):
        before = state
        found = expectation_step(
            images, hypotheses, seen_models(state, models, start), state.weights
        )
        hypotheses, state = found.hypotheses, maximisation_step(images, found, state, start)
        yield mixture_of(state, models, given), state.objective
        if state.objective - before.objective < STILL * coordinates:
            return


def first_hypotheses(shapes: Floats, start: Start) -> Hypotheses:
    """Return the likeliest components of shapes (n, 3, p), and views of their means."""
    given, A = start.prior, start.landmark_map
    mean = np.einsum("k,kip->ip", given.weights, given.means)
    # of the shapes x: A is near the identity, and may be inverted
    aligned = similarity_transform(shapes, mean @ A.T).apply(shapes) @ np.linalg.inv(A).T
    most = min(HYPOTHESES, len(given))
    order = np.argsort(-given.log_density(aligned), axis=1, kind="stable")
    component, image = order[:, :most].ravel(), np.repeat(np.arange(len(shapes)), most)
    onto = similarity_transform(given.means[component] @ A.T, shapes[image])
    views = Views(onto.rotation, np.log(np.maximum(onto.scale, 1e-3)))
    return Hypotheses(image, component, views, np.full(len(image), 0.1))


def seen_models(state: Adapted, models: Sequence[Gaussian], start: Start) -> list[Gaussian]:
    """Return the components as the images see them, through the map of the landmarks."""
    A = start.landmark_map
    return [
        Gaussian(
            (model.mean + model.modes @ m) @ A.T,
            np.einsum("jp,ipq->ijq", A, model.modes @ L),
            model.rest,
            start.noise,
            state.log_size,
            state.spread,
        )
        for model, m, L in zip(models, state.shift, state.factor, strict=True)
    ]


def expectation_step(
    images: Images, hypotheses: Hypotheses, models: Sequence[Gaussian], weights: Floats
) -> Responsibilities:
    """Take a step of each view, and return the responsibilities of the hypotheses."""
    n, r, q = len(images), len(hypotheses), models[0].modes.shape[2]
    density, mean, covariance = np.empty(r), np.empty((r, q)), np.empty((r, q, q))
    rotation, log_scale, damping = np.empty((r, 3, 3)), np.empty(r), np.empty(r)
    for k, model in enumerate(models):
        own = np.flatnonzero(hypotheses.component == k)
        for at in range(0, len(own), BLOCK):
            rows = own[at : at + BLOCK]
            block, before = images[hypotheses.image[rows]], hypotheses[rows]
            found = expect(block, before.views, model)
            tried = climb(before.views, found, before.damping)
            then = expect(block, tried, model)
            better = then.log_density > found.log_density
            found, views = choose(better, then, found), choose(better, tried, before.views)
            rotation[rows], log_scale[rows] = views.rotation, views.log_scale
            damping[rows] = np.clip(np.where(better, 0.3, 10.0) * before.damping, 1e-3, 1e3)
            density[rows] = found.log_density + np.log(weights[k])
            mean[rows], covariance[rows] = found.deformation, found.inverse[:, :q, :q]
    top = np.full(n, -np.inf)
    np.maximum.at(top, hypotheses.image, density)
    total = top + np.log(np.bincount(hypotheses.image, np.exp(density - top[hypotheses.image]), n))
    climbed = replace(hypotheses, views=Views(rotation, log_scale), damping=damping)
    share = np.exp(density - total[hypotheses.image])
    return Responsibilities(climbed, total, share, mean, covariance)


def maximisation_step(
    images: Images, found: Responsibilities, state: Adapted, start: Start
) -> Adapted:
    """Return the parameters that maximise the expected log density of images and start."""
    n, pi0, kappa = len(images), start.prior.weights, start.weight
    hypotheses, share, eye = found.hypotheses, found.share, np.eye(state.shift.shape[1])
    count = np.bincount(hypotheses.component, share, len(pi0))
    shift, factor, prior = np.empty_like(state.shift), np.empty_like(state.factor), 0.0
    for k, (m, L) in enumerate(zip(state.shift, state.factor, strict=True)):
        C = L @ L.T
        prior += pi0[k] * np.log(state.weights[k])
        prior -= 0.5 * pi0[k] * np.linalg.slogdet(C)[1]
        prior -= 0.5 * pi0[k] * np.linalg.solve(C, eye + np.outer(m, m)).trace()
        own = np.flatnonzero(hypotheses.component == k)
        r, z = share[own], m + found.mean[own] @ L.T
        whole = kappa * pi0[k] + count[k]
        shift[k] = (r @ z) / whole
        apart = z - shift[k]
        S = (r[:, None] * apart).T @ apart + L @ np.tensordot(r, found.covariance[own], 1) @ L.T
        S += kappa * pi0[k] * (eye + np.outer(shift[k], shift[k]))
        factor[k] = np.linalg.cholesky(S / whole)
    log_scale, sequence = hypotheses.views.log_scale, images.sequence[hypotheses.image]
    log_size = sizes(images, hypotheses, share)
    on_scale = -0.5 * n * (np.log(state.spread) + SCALE**2 / state.spread)
    return Adapted(
        (kappa * pi0 + count) / (kappa + n),
        shift,
        factor,
        log_size=log_size,
        spread=float(share @ (log_scale - log_size[sequence]) ** 2 / n + SCALE**2) / 2,
        objective=float(found.log_density.sum() + kappa * prior + on_scale),
    )


def sizes(images: Images, hypotheses: Hypotheses, share: Floats) -> Floats:
    """Mean log s (sequences,) of hypotheses that have a share (r,)."""
    sequence = images.sequence[hypotheses.image]
    count = np.maximum(np.bincount(sequence, share), 1e-9)
    found: Floats = np.bincount(sequence, share * hypotheses.views.log_scale) / count
    return found


def mixture_of(state: Adapted, models: Sequence[Gaussian], start: Mixture) -> Mixture:
    """C' = M C M^T, M = 1 + V (L - 1) V^+, and m' = m + V m_z: the mixture over shapes.

    What the modes V of the start do not span stays as it is; where landmarks of a body are left out
    its middle moves together with the modes, since these are of shapes about their middle.
    """
    means, covariances = start.means.copy(), start.covariances.copy()
    for k, model in enumerate(models):
        V = model.modes.reshape(model.mean.size, -1)
        M = np.eye(len(V)) + V @ (state.factor[k] - np.eye(V.shape[1])) @ np.linalg.pinv(V)
        means[k] += model.modes @ state.shift[k]
        covariances[k] = M @ covariances[k] @ M.T
    return Mixture(state.weights, means, covariances)

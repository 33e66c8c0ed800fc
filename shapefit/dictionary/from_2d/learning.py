"""Learning from landmarks alone: expectation maximisation from factorised views.

max over mu, V, rho, sigma, tau, R, s of  sum_n log p(w_n | R_n, s_n) + log p(s_n)
                                          - n / 2 (log tau^2 + SCALE^2 / tau^2),

the depths and the deformations integrated out. No round lowers it: views are kept where
they raise the density of their image, and the noise goes no farther than to its best
value.

First views: the landmarks of all images, W (2n, p), have a few leading factors L (2n,
r). However the shape deforms, three columns Q (r, 3) make L Q the first two rows of the
rotations (Akhter, Sheikh, Khan and Kanade, PAMI 2011). Q has few unknowns and many
local optima: it grows from the rigid solution, r = 3, a factor at a time, by Levenberg
and Marquardt's method.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from shapefit.arrays import Floats, evenly
from shapefit.dictionary.from_2d.model import (
    MOST_MODES,
    Gaussian,
    Images,
    Indices,
    Mask,
    Views,
    ascent,
    change_inliers,
    choose,
    hide,
    posterior_mean,
    scatter,
    split_ppca,
)
from shapefit.geometry.rotations import complete_rotation
from shapefit.threads import on_threads

RANKS = (5, 9, 13)
"""Factors from which views are found; evidence chooses among them."""

HOLD = 5
"""Rounds at first in which the views rest, until the model knows how shapes deform."""

COOLING = 0.7
"""Least factor of the noise from round to round; faster, the views freeze."""

CLEARLY = 0.85
"""Factor of the error of hidden landmarks below which it pays to believe that some are
outliers.
"""

TRIAL, TRIAL_IMAGES = 10, 200
"""Rounds and images by which starts are judged."""

MOST_ROUNDS, LEAST_GAIN = 35, 1e-3
"""Rounds end where one raises the objective by less than this for each coordinate."""

IMAGES_PER_MODE = 4
"""Images that a mode needs at least, or it is one of their noise."""

EXACT = 5e-4
"""Noise, in the size of the shapes, below which landmarks count as exact."""

SIZE_STD, SCALE = 0.1, 0.01
"""First deviation of log s, and that of the images that its prior stands for."""

BLOCK = 16
"""Images at a time: what they take fits in the cache."""

COMPLETION_ROUNDS = 30
UPGRADE_ROUNDS = 30

FAR, NEAR = 4.0, 0.02
"""A landmark is an outlier, at first, so many medians from where the factors have it;
or so many times a share of the size of a shape, if that is more.
"""

MOST = 0.25
"""Share of the landmarks of an image beyond which they show a rare pose, and none is an
outlier.
"""

SAME_SIZE = 1.0
"""Weight of the size of an image beside the angle and the ratio of its axes."""


@dataclass(frozen=True)
class State:
    """Views, the model that follows from them, damping of their steps (n,); outliers
    (n, p).

    shapes (n, 3, p) and the objective are those of the views under the model before.
    """

    views: Views
    model: Gaussian
    damping: Floats
    shapes: Floats
    outliers: Mask
    objective: float = -np.inf

    @property
    def in_camera(self) -> Floats:
        """Shapes s R x (n, 3, p) in the frame of the camera."""
        s = np.exp(self.views.log_scale)[:, None, None]
        points: Floats = s * (self.views.rotation @ self.shapes)
        return points


def learn(images: Images) -> Iterator[State]:
    """Yield the state after each round from the best start.

    Starts are judged by the objective after some rounds with images that lie evenly.
    Landmarks are outliers only where others, hidden, are then predicted clearly better:
    rare poses of a class that is no Gaussian look like outliers, too.
    """
    ranks = tuple(sorted({min(rank, images.landmarks.shape[2] - 1) for rank in RANKS}))
    some = evenly(len(images), TRIAL_IMAGES)
    hidden = hide(images[some].weights > 0)
    remaining = images[some].hiding(hidden)
    W, _ = complete(images, max(RANKS))
    starts = find_views(W, ranks)
    trials = [run_trial(remaining, W[some], views[some]) for views in starts]
    best = int(np.argmax([trial.objective for trial in trials]))
    first = first_state(images, W, starts[best])
    W, outliers = complete(images, max(RANKS), doubting=True)
    if outliers[some].any():
        (views,) = find_views(W, ranks[best : best + 1])
        without = replace(remaining, outliers=outliers[some] & ~hidden)
        doubting = run_trial(without, W[some], views[some])
        errors = [
            hidden_error(images[some], hidden, of) for of in (doubting, trials[best])
        ]
        if errors[0] < CLEARLY * errors[1]:
            images = replace(images, outliers=outliers)
            first = first_state(images, W, views)
    yield from improve(images, first)


def run_trial(images: Images, W: Floats, views: Views) -> State:
    """Return the state after the rounds by which a start is judged."""
    state = first_state(images, W, views)
    for k in range(TRIAL):
        state = learn_round(images, state, hold=k < HOLD)
    return state


def hidden_error(images: Images, hidden: Mask, state: State) -> float:
    """Median distance of the hidden landmarks (n, p) from where the model has them."""
    distance = np.linalg.norm(
        predict(images.hiding(hidden | state.outliers), state) - images.landmarks,
        axis=1,
    )
    return float(np.median(distance[hidden])) if hidden.any() else 0.0


def predict(images: Images, state: State) -> Floats:
    """Return where the model has all landmarks (n, 2, p), hidden ones too."""
    expected = posterior_mean(images, state.views, state.model)
    shapes = replace(state, shapes=expected.shapes).in_camera
    placed: Floats = shapes[:, :2] + expected.translation[:, :, None]
    return placed


def improve(
    images: Images, state: State, rounds: int = MOST_ROUNDS, *, turning: bool = True
) -> Iterator[State]:
    """Yield the state after each round, until the objective stands still.

    The views climb where they are turning.
    """
    coordinates = 2 * int((images.weights > 0).sum())
    for k in range(rounds):
        before, state = state, learn_round(images, state, hold=k < HOLD or not turning)
        yield state
        gain = (state.objective - before.objective) / coordinates
        if k > HOLD and (gain < LEAST_GAIN or state.model.noise < EXACT**2):
            return


def first_state(images: Images, W: Floats, views: Views) -> State:
    """Return the rigid model of completed landmarks W (n, 2, p), with outliers, in
    given views.
    """
    n, _, p = W.shape
    A = np.exp(views.log_scale)[:, None, None] * views.rotation[:, :2]
    mean = np.asarray(
        np.linalg.lstsq(A.reshape(2 * n, 3), W.reshape(2 * n, p))[0], np.float64
    )
    mean = mean - mean.mean(axis=1, keepdims=True)
    left = max(float(((W - A @ mean) ** 2).mean()), EXACT**2)
    size = sequence_means(views.log_scale, images.sequence)
    model = Gaussian(mean, np.zeros((3, p, 0)), left, left / 2, size, SIZE_STD**2)
    outliers = np.zeros((n, p), bool) if images.outliers is None else images.outliers
    return State(
        views, model, np.full(n, 0.1), np.broadcast_to(mean, (n, 3, p)), outliers
    )


def learn_round(images: Images, state: State, *, hold: bool) -> State:
    """Take one round: a step of each view unless `hold`, expectation, and
    maximisation.

    Blocks of images are taken side by side on all cores, and what adds up over them
    is added in their order.
    """
    n, p = images.weights.shape
    model = state.model
    blocks = on_threads(
        lambda rows: advance(images, state, rows, hold=hold),
        [slice(at, at + BLOCK) for at in range(0, n, BLOCK)],
        0,
    )
    views = Views(
        np.concatenate([block.views.rotation for block in blocks]),
        np.concatenate([block.views.log_scale for block in blocks]),
    )
    damping = np.concatenate([block.damping for block in blocks])
    outliers = np.concatenate([block.outliers for block in blocks])
    shapes = np.concatenate([block.shapes for block in blocks])
    covariance = np.zeros((3 * p, 3 * p))
    for block in blocks:
        covariance += block.scatter
    density = sum(block.log_density for block in blocks)
    residual_variance = sum(block.residual_variance for block in blocks)
    mean = shapes.mean(axis=0)
    centred = (shapes - mean).reshape(n, 3 * p)
    noise = residual_variance / (2 * int(((images.weights > 0) & ~outliers).sum()))
    size = sequence_means(views.log_scale, images.sequence)
    off_size = views.log_scale - size[images.sequence]
    size_variance = float(((off_size**2).mean() + SCALE**2) / 2)
    most = min(MOST_MODES, max(n // IMAGES_PER_MODE, 1))
    following = replace(
        split_ppca(mean, (covariance + centred.T @ centred) / n, most=most),
        noise=max(noise, COOLING * model.noise),
        log_size=size,
        size_variance=size_variance,
    )
    prior = -0.5 * n * (np.log(model.size_variance) + SCALE**2 / model.size_variance)
    return State(views, following, damping, shapes, outliers, density + prior)


class Block(NamedTuple):
    """Some images after a step: views, damping (m,), outliers (m, p) and shapes
    (m, 3, p); sums over the images of the log density, of the covariances of shapes
    (3p, 3p) and of residual variances.
    """

    views: Views
    damping: Floats
    outliers: Mask
    shapes: Floats
    log_density: float
    scatter: Floats
    residual_variance: float


def advance(images: Images, state: State, rows: slice, *, hold: bool) -> Block:
    """Take a step with some images: of their views unless `hold`, and of what counts as
    an outlier where that is open. Each image takes the steps that raise its density.
    """
    model, views, damping = state.model, state.views[rows], state.damping[rows]
    outliers, doubting = state.outliers[rows], images.outliers is not None
    block = replace(images[rows], outliers=outliers)
    expected = posterior_mean(block, views, model, slopes=not hold)
    if doubting or not hold:
        doubted = change_inliers(block, expected.flip_gain) if doubting else outliers
        moved = views if hold else ascent(views, expected, damping)
        then = posterior_mean(replace(block, outliers=doubted), moved, model)
        better = then.log_density > expected.log_density
        expected = choose(better, then, expected)
        views = choose(better, moved, views)
        outliers = np.where(better[:, None], doubted, outliers)
    if not hold:
        damping = np.clip(np.where(better, 0.3, 10.0) * damping, 1e-3, 1e3)
    return Block(
        views,
        damping,
        outliers,
        expected.shapes,
        float(expected.log_density.sum()),
        scatter(expected, views, model),
        float(expected.residual_variance.sum()),
    )


def sequence_means(values: Floats, sequence: Indices) -> Floats:
    """Means (sequences,) of values (n,)."""
    means: Floats = np.bincount(sequence, values) / np.maximum(np.bincount(sequence), 1)
    return means


def complete(
    images: Images, rank: int, *, doubting: bool = False
) -> tuple[Floats, Mask]:
    """Return the landmarks (n, 2, p), centred, and which are outliers (n, p), where it
    is open.

    Hidden and outliers are as factors of the rank have them; these are found by turns.
    """
    w, there = images.landmarks, images.weights > 0
    visible, placed = there, np.zeros_like(w)
    for k in range(COMPLETION_ROUNDS if doubting or not there.all() else 0):
        W, middle = filled(w, visible, placed)
        flat = W.reshape(-1, W.shape[2])
        leading = np.linalg.eigh(flat.T @ flat)[1][:, -min(3 + k // 3, rank) :]
        placed = (flat @ leading @ leading.T).reshape(W.shape)
        if doubting:
            residual = np.linalg.norm(w - middle - placed, axis=1)
            near = residual < FAR * max(float(np.median(residual[there])), NEAR)
            rare = (there & ~near).sum(axis=1) > MOST * there.sum(axis=1)
            visible = there & (near | rare[:, None])
    return filled(w, visible, placed)[0], there & ~visible


def filled(w: Floats, visible: Mask, placed: Floats) -> tuple[Floats, Floats]:
    """Fill hidden landmarks of w (n, 2, p) by `placed`; return it centred, and the
    centre.
    """
    count = np.maximum(visible.sum(axis=1), 1)[:, None, None]
    middle = (
        np.where(visible[:, None], w - placed, 0.0).sum(axis=2, keepdims=True) / count
    )
    W = np.where(visible[:, None], w - middle, placed)
    return W - W.mean(axis=2, keepdims=True), middle


def find_views(W: Floats, ranks: tuple[int, ...]) -> list[Views]:
    """Return the views of landmarks W (n, 2, p), complete and centred, for each rank
    r.
    """
    n, _, p = W.shape
    U = np.linalg.svd(W.reshape(2 * n, p), full_matrices=False)[0]
    views = []
    L = (U * np.sqrt(2 * n / 3)).reshape(n, 2, -1)
    Q = rigid_upgrade(L[:, :, :3])
    for r in range(3, max(ranks) + 1):
        Q = upgrade(L[:, :, :r], np.concatenate([Q, np.zeros((r - len(Q), 3))]))
        if r in ranks:
            rows = L[:, :, :r] @ Q
            log_scale = np.log(np.maximum((rows**2).sum(axis=(1, 2)) / 2, 1e-4)) / 2
            views.append(Views(complete_rotation(rows), log_scale))
    return views


def rigid_upgrade(L: Floats) -> Floats:
    """Return Q (3, 3) with Q Q^T nearest to making L Q (n, 2, 3) orthonormal, linear in
    Q Q^T.
    """
    i, j = np.triu_indices(3)
    products = L[:, [0, 1, 0]][..., i] * L[:, [0, 1, 1]][..., j]
    products += np.where(i != j, L[:, [0, 1, 0]][..., j] * L[:, [0, 1, 1]][..., i], 0.0)
    target = np.tile([1.0, 1.0, 0.0], len(L))
    G = np.empty((3, 3))
    G[i, j] = G[j, i] = np.linalg.lstsq(products.reshape(-1, 6), target, rcond=None)[0]
    size, axes = np.linalg.eigh(G)
    upgrade: Floats = axes * np.sqrt(np.maximum(size, 1e-2 * max(size[-1], 1e-2)))
    return upgrade


def upgrade(L: Floats, Q: Floats) -> Floats:
    """min over Q (r, 3) of sum_n (a b)^2 + (a a - b b)^2 / 4 + (a a + b b - 2)^2 / 4,
    rows a, b.
    """
    r, damping = len(Q), 1e-3

    def residuals(Q: Floats) -> tuple[Floats, Floats]:
        M = L @ Q
        a, b = M[:, 0], M[:, 1]
        aa, bb, ab = (a * a).sum(axis=1), (b * b).sum(axis=1), (a * b).sum(axis=1)
        return M, np.stack([ab, (aa - bb) / 2, SAME_SIZE * (aa + bb - 2) / 2])

    M, c = residuals(Q)
    floor = 1e-9 * len(L) * np.eye(3 * r)
    for _ in range(UPGRADE_ROUNDS):
        da = L[:, 0, :, None] * M[:, 0, None]  # half the derivative of a a
        db = L[:, 1, :, None] * M[:, 1, None]
        dab = L[:, 0, :, None] * M[:, 1, None] + L[:, 1, :, None] * M[:, 0, None]
        J = np.stack([dab, da - db, SAME_SIZE * (da + db)]).reshape(-1, 3 * r)
        H, g = J.T @ J, J.T @ c.ravel()
        step = np.linalg.solve(H + damping * np.diag(np.diag(H)) + floor, g).reshape(
            r, 3
        )
        tried, left = residuals(Q - step)
        if (left**2).sum() < (c**2).sum():
            done = (left**2).sum() > (1 - 1e-4) * (c**2).sum()
            Q, M, c, damping = Q - step, tried, left, damping * 0.3
            if done:
                break
        else:
            damping *= 5
    return Q

"""Learning from landmarks alone: expectation maximisation from factorised views.

max over mu, V, rho, sigma, tau, R, s of  sum_n log p(w_n | R_n, s_n) + log p(s_n)
                                          - n / 2 (log tau^2 + PRIOR_SIZE_SD^2 / tau^2),

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

from shapefit.arrays import Flags, Floats, Indices, evenly
from shapefit.dictionary.from_2d.model import (
    MAX_MODES,
    Gaussian,
    Images,
    Views,
    change_inliers,
    find_log_density,
    hide_some,
    posterior_mean,
    split_ppca,
    step_views,
)
from shapefit.geometry.rotations import complete_rotation

START_RANKS = (5, 9, 13)
"""Factors from which views are found; evidence chooses among them."""

HELD_ROUNDS = 5
"""Rounds at first in which the views rest, until the model knows how shapes deform."""

MIN_NOISE_FACTOR = 0.7
"""Of the noise from round to round; faster, the views freeze."""

CLEARLY_BETTER_BELOW = 0.85
"""Factor of the error of hidden landmarks from which on outliers are believed in."""

TRIAL_ROUNDS = 10
"""Rounds by which starts are judged."""

TRIAL_IMAGES = 200
"""Images by which starts are judged."""

MAX_LEARNING_ROUNDS = 35
"""Rounds, which end earlier where the objective stands still."""

MIN_COORDINATE_GAIN = 1e-3
"""Rounds end where one raises the objective by less than this for each coordinate."""

MIN_IMAGES_PER_MODE = 4
"""Images that a mode needs at least, or it is one of their noise."""

EXACT_NOISE = 5e-4
"""Noise, in the size of the shapes, below which landmarks count as exact."""

FIRST_SIZE_SD = 0.1
"""First deviation of log s."""

PRIOR_SIZE_SD = 0.01
"""Deviation of log s of the images that its prior stands for."""

COMPLETION_ROUNDS = 30
"""In which hidden landmarks are fill_hidden in; a factor more every three rounds."""

MAX_UPGRADE_ROUNDS = 30
"""Of Levenberg and Marquardt's method."""

OUTLIER_MEDIANS = 4.0
"""Median residuals, from where the factors have it, at which a landmark is an outlier
at first.
"""

MIN_MEDIAN_RESIDUAL = 0.02
"""Least median that counts, as a share of the size of a shape."""

MAX_OUTLIER_SHARE = 0.25
"""Of the landmarks of an image, beyond which they show a rare pose and none is one."""

SIZE_WEIGHT = 1.0
"""Weight of the size of an image beside the angle and the ratio of its axes."""


@dataclass(frozen=True, eq=False)
class ClassState:
    """What is learned of the images and their class of shapes after a round.

    views, the model that follows from them, damping of their steps (n,); outliers (n,
    p); shapes (n, 3, p) and the objective are those of the views under the model
    before.
    """

    views: Views
    model: Gaussian
    damping: Floats
    shapes: Floats
    outliers: Flags
    objective: float = -np.inf

    @property
    def in_camera(self) -> Floats:
        """Return the shapes s R x (n, 3, p) in the frame of the camera."""
        s = np.exp(self.views.log_scale)[:, None, None]
        points: Floats = s * (self.views.rotation @ self.shapes)
        return points


def learn_class(images: Images) -> Iterator[ClassState]:
    """Learn a class of shapes from 2D landmarks; yield the state after each round.

    From the best of several starts. They are judged by the objective after some rounds
    with images that lie evenly. Landmarks are outliers only where others, hidden, are
    then predicted clearly better: rare poses of a class that is no Gaussian look like
    outliers, too.
    """
    p = images.landmarks.shape[2]
    ranks = tuple(sorted({min(rank, p - 1) for rank in START_RANKS}))
    some = evenly(len(images), TRIAL_IMAGES)
    hidden = hide_some(images[some].weights > 0)
    remaining = images[some].hiding(hidden)
    W, _ = complete_landmarks(images, max(START_RANKS))
    starts = find_views(W, ranks)
    trials = [run_trial(remaining, W[some], views[some]) for views in starts]
    best = int(np.argmax([trial.objective for trial in trials]))
    first = first_state(images, W, starts[best])
    W, outliers = complete_landmarks(images, max(START_RANKS), seek_outliers=True)
    if outliers[some].any():
        (views,) = find_views(W, ranks[best : best + 1])
        without = replace(remaining, outliers=outliers[some] & ~hidden)
        doubting = run_trial(without, W[some], views[some])
        error_of_doubting = hidden_error(images[some], hidden, doubting)
        error_of_believing = hidden_error(images[some], hidden, trials[best])
        if error_of_doubting < CLEARLY_BETTER_BELOW * error_of_believing:
            images = replace(images, outliers=outliers)
            first = first_state(images, W, views)
    yield from improve(images, first)


def run_trial(images: Images, landmarks: Floats, views: Views) -> ClassState:
    """Learn for `TRIAL_ROUNDS` rounds from these views, and return the last state.

    landmarks (n, 2, p): the landmarks, hidden ones filled in.
    """
    state = first_state(images, landmarks, views)
    for k in range(TRIAL_ROUNDS):
        state = learn_round(images, state, hold=k < HELD_ROUNDS)
    return state


def hidden_error(images: Images, hidden: Flags, state: ClassState) -> float:
    """Return the median distance of hidden landmarks (n, p) from their predictions.

    0 where none is hidden.
    """
    predicted = predict(images.hiding(hidden | state.outliers), state)
    distance = np.linalg.norm(predicted - images.landmarks, axis=1)
    return float(np.median(distance[hidden])) if hidden.any() else 0.0


def predict(images: Images, state: ClassState) -> Floats:
    """Predict all landmarks (n, 2, p) of the images, hidden ones too, by the model."""
    expected = posterior_mean(images, state.views, state.model)
    shapes = replace(state, shapes=expected.shapes).in_camera
    placed: Floats = shapes[:, :2] + expected.translation[:, :, None]
    return placed


def improve(
    images: Images,
    state: ClassState,
    rounds: int = MAX_LEARNING_ROUNDS,
    *,
    turning: bool = True,
) -> Iterator[ClassState]:
    """Learn in further rounds until the objective converges; yield each state.

    `rounds` at most. turning: whether views change, too, and not the model alone.
    """
    coordinates = 2 * int((images.weights > 0).sum())
    for k in range(rounds):
        before = state
        state = learn_round(images, state, hold=k < HELD_ROUNDS or not turning)
        yield state
        gain = (state.objective - before.objective) / coordinates
        is_exact = state.model.noise < EXACT_NOISE**2
        if k > HELD_ROUNDS and (gain < MIN_COORDINATE_GAIN or is_exact):
            return


def first_state(images: Images, landmarks: Floats, views: Views) -> ClassState:
    """Return the first state of learning: the rigid model of landmarks in these views.

    landmarks (n, 2, p): the landmarks, hidden ones filled in.
    """
    n, _, p = landmarks.shape
    A = np.exp(views.log_scale)[:, None, None] * views.rotation[:, :2]
    solution = np.linalg.lstsq(A.reshape(2 * n, 3), landmarks.reshape(2 * n, p))[0]
    mean = np.asarray(solution, np.float64)
    mean = mean - mean.mean(axis=1, keepdims=True)
    left = max(float(((landmarks - A @ mean) ** 2).mean()), EXACT_NOISE**2)
    model = Gaussian(
        mean=mean,
        modes=np.zeros((3, p, 0)),
        rest=left,
        noise=left / 2,
        log_size=sequence_means(views.log_scale, images.sequence),
        size_variance=FIRST_SIZE_SD**2,
    )
    outliers = images.outliers
    return ClassState(
        views=views,
        model=model,
        damping=np.full(n, 0.1),
        shapes=np.broadcast_to(mean, (n, 3, p)),
        outliers=np.zeros((n, p), bool) if outliers is None else outliers,
    )


def learn_round(images: Images, state: ClassState, *, hold: bool) -> ClassState:
    """Take one round of learning: step the views, infer the shapes, fit the model.

    With `hold` the views stay as they are.
    """
    n = len(images.weights)
    expectation = expect(images, state, hold=hold)
    variance = state.model.size_variance
    prior = -0.5 * n * (np.log(variance) + PRIOR_SIZE_SD**2 / variance)
    return ClassState(
        views=expectation.views,
        model=maximise_class(images, state.model, expectation),
        damping=expectation.damping,
        shapes=expectation.shapes,
        outliers=expectation.outliers,
        objective=expectation.log_density + prior,
    )


class Expectation(NamedTuple):
    """What a round expects of n images.

    damping (n,), outliers (n, p), shapes (n, 3, p); covariance (3p, 3p), log_density
    and residual_variance are sums over the images.
    """

    views: Views
    damping: Floats
    shapes: Floats
    outliers: Flags
    covariance: Floats
    log_density: float
    residual_variance: float


def expect(images: Images, state: ClassState, *, hold: bool) -> Expectation:
    """Step the views of the images, and return the moments of their shapes.

    hold, whether views stay as they are: then there is no step. A step, and with or
    without it a change of outliers, is taken where it raises the log density.
    """
    model = state.model
    views = state.views
    damping = state.damping
    outliers = state.outliers
    is_doubting = images.outliers is not None
    if is_doubting or not hold:
        images = replace(images, outliers=outliers)
        before = posterior_mean(images, views, model, slopes=not hold)
        doubted = outliers
        if is_doubting:
            doubted = change_inliers(images, before.flip_gain)
        moved = views
        if not hold:
            moved = step_views(views, before, damping)
        after = find_log_density(replace(images, outliers=doubted), moved, model)
        is_better = after > before.log_density
        views = choose_views(is_better, moved, views)
        outliers = np.where(is_better[:, None], doubted, outliers)
        if not hold:
            factor = np.where(is_better, 0.3, 10.0)
            damping = np.clip(factor * damping, 1e-3, 1e3)
    images = replace(images, outliers=outliers)
    expected = posterior_mean(images, views, model, covariance=True)
    assert expected.covariance is not None
    return Expectation(
        views=views,
        damping=damping,
        shapes=expected.shapes,
        outliers=outliers,
        covariance=expected.covariance,
        log_density=float(expected.log_density.sum()),
        residual_variance=float(expected.residual_variance.sum()),
    )


def choose_views(mask: Flags, yes: Views, no: Views) -> Views:
    """Return the views `yes` where the mask (n,) is True, else `no`."""
    return Views(
        rotation=np.where(mask[:, None, None], yes.rotation, no.rotation),
        log_scale=np.where(mask, yes.log_scale, no.log_scale),
    )


def maximise_class(
    images: Images, model: Gaussian, expectation: Expectation
) -> Gaussian:
    """Return the likeliest model, given the expected moments of the shapes of images.

    Its noise falls to `MIN_NOISE_FACTOR` of that of the model before at most.
    """
    n, p = images.weights.shape
    shapes = expectation.shapes
    mean = shapes.mean(axis=0)
    centred = (shapes - mean).reshape(n, 3 * p)
    covariance = (expectation.covariance + centred.T @ centred) / n
    inliers = int(((images.weights > 0) & ~expectation.outliers).sum())
    noise = expectation.residual_variance / (2 * inliers)
    log_scale = expectation.views.log_scale
    size = sequence_means(log_scale, images.sequence)
    squares = (log_scale - size[images.sequence]) ** 2
    most = min(MAX_MODES, max(n // MIN_IMAGES_PER_MODE, 1))
    return replace(
        split_ppca(mean, covariance, max_modes=most),
        noise=max(noise, MIN_NOISE_FACTOR * model.noise),
        log_size=size,
        size_variance=float((squares.mean() + PRIOR_SIZE_SD**2) / 2),
    )


def sequence_means(values: Floats, sequence: Indices) -> Floats:
    """Return the means of values (n,) by sequence, a number in `sequence` (n,)."""
    count = np.maximum(np.bincount(sequence), 1)
    means: Floats = np.bincount(sequence, values) / count
    return means


def complete_landmarks(
    images: Images, rank: int, *, seek_outliers: bool = False
) -> tuple[Floats, Flags]:
    """Fill in hidden landmarks by factors; return all, centred, and outliers (n, p).

    The landmarks (n, 2, p) that are hidden or outliers are where a matrix of `rank`
    leading factors has them. Outliers are sought only with `seek_outliers`, by turns
    with the factors.
    """
    w = images.landmarks
    is_there = images.weights > 0
    visible = is_there
    placed = np.zeros_like(w)
    rounds = COMPLETION_ROUNDS if seek_outliers or not is_there.all() else 0
    for k in range(rounds):
        W, middle = fill_hidden(w, visible, placed)
        flat = W.reshape(-1, W.shape[2])
        axes = np.linalg.eigh(flat.T @ flat)[1]
        leading = axes[:, -min(3 + k // 3, rank) :]
        placed = (flat @ leading @ leading.T).reshape(W.shape)
        if seek_outliers:
            residual = np.linalg.norm(w - middle - placed, axis=1)
            usual = max(float(np.median(residual[is_there])), MIN_MEDIAN_RESIDUAL)
            is_near = residual < OUTLIER_MEDIANS * usual
            far = (is_there & ~is_near).sum(axis=1)
            is_rare_pose = far > MAX_OUTLIER_SHARE * is_there.sum(axis=1)
            visible = is_there & (is_near | is_rare_pose[:, None])
    return fill_hidden(w, visible, placed)[0], is_there & ~visible


def fill_hidden(w: Floats, visible: Flags, placed: Floats) -> tuple[Floats, Floats]:
    """Fill in hidden landmarks of w (n, 2, p) by the model's `placed`, and centre all.

    placed (n, 2, p) is centred. Returns the landmarks, and the mean offset (n, 2, 1) of
    visible landmarks from placed.
    """
    count = np.maximum(visible.sum(axis=1), 1)[:, None, None]
    offset = np.where(visible[:, None], w - placed, 0.0)
    middle = offset.sum(axis=2, keepdims=True) / count
    W = np.where(visible[:, None], w - middle, placed)
    return W - W.mean(axis=2, keepdims=True), middle


def find_views(landmarks: Floats, ranks: tuple[int, ...]) -> list[Views]:
    """Return the views of all images by factorisation, one set for each rank.

    landmarks (n, 2, p), centred, hidden ones filled in; ranks: numbers of factors,
    ascending, 3 or more.
    """
    n, _, p = landmarks.shape
    U = np.linalg.svd(landmarks.reshape(2 * n, p), full_matrices=False)[0]
    views = []
    L = (U * np.sqrt(2 * n / 3)).reshape(n, 2, -1)
    Q = rigid_upgrade(L[:, :, :3])
    for r in range(3, max(ranks) + 1):
        without_more = np.concatenate([Q, np.zeros((r - len(Q), 3))])
        Q = upgrade(L[:, :, :r], without_more)
        if r in ranks:
            rows = L[:, :, :r] @ Q
            squares = (rows**2).sum(axis=(1, 2)) / 2
            log_scale = np.log(np.maximum(squares, 1e-4)) / 2
            views.append(Views(complete_rotation(rows), log_scale))
    return views


def rigid_upgrade(L: Floats) -> Floats:
    """Return Q (3, 3) that turns three factors L (n, 2, 3) into rows of rotations.

    L Q is as near to orthonormal as Q Q^T can make it. That is linear in Q Q^T = G: a G
    a = 1, b G b = 1, a G b = 0 for rows a, b of L.
    """
    i, j = np.triu_indices(3)
    left = L[:, [0, 1, 0]]
    right = L[:, [0, 1, 1]]
    products = left[..., i] * right[..., j]
    products += np.where(i != j, left[..., j] * right[..., i], 0.0)
    target = np.tile([1.0, 1.0, 0.0], len(L))
    entries = np.linalg.lstsq(products.reshape(-1, 6), target, rcond=None)[0]
    G = np.empty((3, 3))
    G[i, j] = entries
    G[j, i] = entries
    size, axes = np.linalg.eigh(G)
    upgrade: Floats = axes * np.sqrt(np.maximum(size, 1e-2 * max(size[-1], 1e-2)))
    return upgrade


def upgrade(L: Floats, Q: Floats) -> Floats:
    """Improve Q (r, 3), which turns r factors L (n, 2, r) into rows of rotations.

    min over Q of sum_n (a b)^2 + (a a - b b)^2 / 4 + (a a + b b - 2)^2 / 4 with a, b
    the rows of L Q: a local minimum, from the given Q on. Levenberg and Marquardt's
    method.
    """
    r = len(Q)
    damping = 1e-3
    M, c = _orthonormality(L, Q)
    floor = 1e-9 * len(L) * np.eye(3 * r)
    for _ in range(MAX_UPGRADE_ROUNDS):
        da = L[:, 0, :, None] * M[:, 0, None]  # half the derivative of a a
        db = L[:, 1, :, None] * M[:, 1, None]
        dab = L[:, 0, :, None] * M[:, 1, None] + L[:, 1, :, None] * M[:, 0, None]
        J = np.stack([dab, da - db, SIZE_WEIGHT * (da + db)]).reshape(-1, 3 * r)
        H = J.T @ J
        g = J.T @ c.ravel()
        damped = H + damping * np.diag(np.diag(H)) + floor
        tried = Q - np.linalg.solve(damped, g).reshape(r, 3)
        M_tried, c_tried = _orthonormality(L, tried)
        before = (c**2).sum()
        after = (c_tried**2).sum()
        if after < before:
            Q, M, c = tried, M_tried, c_tried
            damping *= 0.3
            if after > (1 - 1e-4) * before:
                break
        else:
            damping *= 5
    return Q


def _orthonormality(L: Floats, Q: Floats) -> tuple[Floats, Floats]:
    """Return M = L Q (n, 2, 3), and how its rows differ from orthonormal (3, n)."""
    M = L @ Q
    a = M[:, 0]
    b = M[:, 1]
    aa = (a * a).sum(axis=1)
    bb = (b * b).sum(axis=1)
    ab = (a * b).sum(axis=1)
    return M, np.stack([ab, (aa - bb) / 2, SIZE_WEIGHT * (aa + bb - 2) / 2])

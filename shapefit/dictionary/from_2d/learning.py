"""Learning from landmarks alone: expectation maximisation from factorised views.

max over mu, V, rho, sigma, tau, R, s of  sum_n log p(w_n | R_n, s_n) + log p(s_n)
                                          - n / 2 (log tau^2 + SCALE^2 / tau^2),

the depths and the deformations integrated out. No round lowers it: views are kept where they raise
the density of their image, and the noise goes no farther than to its best value.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from shapefit.dictionary.from_2d.expectation import change_belief, climb, expect, scatter
from shapefit.dictionary.from_2d.factorisation import complete, find_views
from shapefit.dictionary.from_2d.maximisation import MOST_MODES, maximise
from shapefit.dictionary.from_2d.model import (
    Floats,
    Gaussian,
    Images,
    Indices,
    Mask,
    Views,
    choose,
    evenly,
    hide,
)

RANKS = (5, 9, 13)
"""Factors from which views are found; evidence chooses among them."""

HOLD = 5
"""Rounds at first in which the views rest, until the model knows how shapes deform."""

COOLING = 0.7
"""Least factor of the noise from round to round; faster, the views freeze."""

CLEARLY = 0.85
"""Factor of the error of hidden landmarks below which it pays to believe that some are gross."""

TRIAL, TRIAL_IMAGES = 10, 200
"""Rounds and images by which starts are judged."""

MOST_ROUNDS, STILL = 35, 1e-3
"""Rounds end where one raises the objective by less than this for each coordinate."""

IMAGES_PER_MODE = 4
"""Images that a mode needs at least, or it is one of their noise."""

EXACT = 5e-4
"""Noise, in the size of the shapes, below which landmarks count as exact."""

SPREAD, SCALE = 0.1, 0.01
"""First deviation of log s, and that of the images that its prior stands for."""

BLOCK = 256
"""Images at a time: what they take fits in the cache."""


@dataclass(frozen=True)
class State:
    """Views, the model that follows from them, damping of their steps (n,); gross (n, p).

    shapes (n, 3, p) and the objective are those of the views under the model before.
    """

    views: Views
    model: Gaussian
    damping: Floats
    shapes: Floats
    gross: Mask
    objective: float = -np.inf

    @property
    def in_camera(self) -> Floats:
        """Shapes s R x (n, 3, p) in the frame of the camera."""
        s = np.exp(self.views.log_scale)[:, None, None]
        found: Floats = s * (self.views.rotation @ self.shapes)
        return found


def learn(images: Images) -> Iterator[State]:
    """Yield the state after each round from the best start.

    Starts are judged by the objective after some rounds with images that lie evenly. Landmarks are
    believed to be gross only where others, hidden, are then predicted clearly better: rare poses
    of a class that is no Gaussian look gross, too.
    """
    ranks = tuple(sorted({min(rank, images.landmarks.shape[2] - 1) for rank in RANKS}))
    some = evenly(len(images), TRIAL_IMAGES)
    hidden = hide(images[some].weights > 0)
    known = images[some].hiding(hidden)
    W, _ = complete(images, max(RANKS))
    starts = find_views(W, ranks)
    trials = [tried(known, W[some], views[some]) for views in starts]
    best = int(np.argmax([trial.objective for trial in trials]))
    first = first_state(images, W, starts[best])
    W, gross = complete(images, max(RANKS), doubting=True)
    if gross[some].any():
        (views,) = find_views(W, ranks[best : best + 1])
        doubting = tried(replace(known, gross=gross[some] & ~hidden), W[some], views[some])
        errors = [hidden_error(images[some], hidden, of) for of in (doubting, trials[best])]
        if errors[0] < CLEARLY * errors[1]:
            images = replace(images, gross=gross)
            first = first_state(images, W, views)
    yield from improve(images, first)


def tried(images: Images, W: Floats, views: Views) -> State:
    """Return the state after the rounds by which a start is judged."""
    state = first_state(images, W, views)
    for k in range(TRIAL):
        state = learn_round(images, state, still=k < HOLD)
    return state


def hidden_error(images: Images, hidden: Mask, state: State) -> float:
    """Median distance of the hidden landmarks (n, p) from where the model has them."""
    apart = np.linalg.norm(
        predict(images.hiding(hidden | state.gross), state) - images.landmarks, axis=1
    )
    return float(np.median(apart[hidden])) if hidden.any() else 0.0


def predict(images: Images, state: State) -> Floats:
    """Return where the model has all landmarks (n, 2, p), hidden ones too."""
    found = expect(images, state.views, state.model)
    shapes = replace(state, shapes=found.shapes).in_camera
    placed: Floats = shapes[:, :2] + found.translation[:, :, None]
    return placed


def improve(
    images: Images, state: State, rounds: int = MOST_ROUNDS, *, turning: bool = True
) -> Iterator[State]:
    """Yield the state after each round, until the objective stands still.

    The views climb where they are turning.
    """
    coordinates = 2 * int((images.weights > 0).sum())
    for k in range(rounds):
        before, state = state, learn_round(images, state, still=k < HOLD or not turning)
        yield state
        gain = (state.objective - before.objective) / coordinates
        if k > HOLD and (gain < STILL or state.model.noise < EXACT**2):
            return


def first_state(images: Images, W: Floats, views: Views) -> State:
    """Return the rigid model of completed landmarks W (n, 2, p) in given views, gross as given."""
    n, _, p = W.shape
    A = np.exp(views.log_scale)[:, None, None] * views.rotation[:, :2]
    mean = np.asarray(np.linalg.lstsq(A.reshape(2 * n, 3), W.reshape(2 * n, p))[0], np.float64)
    mean = mean - mean.mean(axis=1, keepdims=True)
    left = max(float(((W - A @ mean) ** 2).mean()), EXACT**2)
    size = sequence_means(views.log_scale, images.sequence)
    model = Gaussian(mean, np.zeros((3, p, 0)), left, left / 2, size, SPREAD**2)
    gross = np.zeros((n, p), bool) if images.gross is None else images.gross
    return State(views, model, np.full(n, 0.1), np.broadcast_to(mean, (n, 3, p)), gross)


def learn_round(images: Images, state: State, *, still: bool) -> State:
    """Take a round: the views climb or stay still, the images speak, the model follows them."""
    n, p = images.weights.shape
    model, damping, doubting = state.model, state.damping.copy(), images.gross is not None
    rotation, log_scale = state.views.rotation.copy(), state.views.log_scale.copy()
    shapes, gross, density = np.empty((n, 3, p)), state.gross.copy(), 0.0
    covariance, misfit = np.zeros((3 * p, 3 * p)), 0.0
    for at in range(0, n, BLOCK):
        rows = slice(at, at + BLOCK)
        block, views = replace(images[rows], gross=gross[rows]), state.views[rows]
        found = expect(block, views, model)
        if doubting or not still:
            doubted = change_belief(block, found.doubt) if doubting else gross[rows]
            climbed = views if still else climb(views, found, damping[rows])
            then = expect(replace(block, gross=doubted), climbed, model)
            better = then.log_density > found.log_density
            found, views = choose(better, then, found), choose(better, climbed, views)
            gross[rows] = np.where(better[:, None], doubted, gross[rows])
        if not still:
            damping[rows] = np.clip(np.where(better, 0.3, 10.0) * damping[rows], 1e-3, 1e3)
        rotation[rows], log_scale[rows], shapes[rows] = (
            views.rotation,
            views.log_scale,
            found.shapes,
        )
        density += float(found.log_density.sum())
        covariance += scatter(found, views, model)
        misfit += float(found.misfit.sum())
    mean = shapes.mean(axis=0)
    apart = (shapes - mean).reshape(n, 3 * p)
    noise = misfit / (2 * int(((images.weights > 0) & ~gross).sum()))
    size = sequence_means(log_scale, images.sequence)
    spread = float((((log_scale - size[images.sequence]) ** 2).mean() + SCALE**2) / 2)
    following = replace(
        maximise(
            mean,
            (covariance + apart.T @ apart) / n,
            most=min(MOST_MODES, max(n // IMAGES_PER_MODE, 1)),
        ),
        noise=max(noise, COOLING * model.noise),
        log_size=size,
        spread=spread,
    )
    prior = -0.5 * n * (np.log(model.spread) + SCALE**2 / model.spread)
    return State(
        Views(rotation, log_scale),
        following,
        damping,
        shapes,
        gross,
        density + prior,
    )


def sequence_means(values: Floats, sequence: Indices) -> Floats:
    """Means (sequences,) of values (n,)."""
    found: Floats = np.bincount(sequence, values) / np.maximum(np.bincount(sequence), 1)
    return found

"""Whether depth was learned: by evidence beyond simpler models, and by halves that
agree.

The rigid model has no deformations, the flat one no views: every image shows the same
side, as it is or rolled about the axis of the camera.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shapefit.arrays import Floats, evenly
from shapefit.dictionary.from_2d.learning import (
    State,
    complete,
    find_views,
    first_state,
    improve,
    predict,
)
from shapefit.dictionary.from_2d.model import Images, Views, hide, posterior_mean
from shapefit.geometry.rotations import rotation_about_axis

SAMPLE, ROUNDS, RANK, MEANS = 200, 15, 9, 10
TURNS, ROLL = slice(0, 3), slice(2, 3)

GAIN = 0.05
"""Log evidence a landmark that views must bring, beyond a flat model.

A stiff body that turns by 60 degrees brings 0.4. One that bends may bring less although
its depth is right, where flat modes, three for each in depth, explain it as well.
"""

REST = -0.2
"""The same, below which nothing has turned unless halves agree: planted bodies before a
camera that rests or rolls bring -0.3 to -1.1, people that turn by chance -0.03 to 0.2.
"""

SAME = 0.5
"""Share of what shapes differ from their mean, up to which those of halves count as the
same.
"""

CLOSE = 0.05
"""Share of the size of shapes up to which those of halves count as the same, however
stiff.
"""

BLIND = 1.0
"""Error of hidden landmarks that the middle of an image has, in the size of the shapes.
"""

ROLLED = 0.5
"""Roll of an image in radians, from which on a flat class may have rolled."""

THIN = 0.05
"""Depth of the mean shape, as a share of its width, below which a class is flat."""


@dataclass(frozen=True)
class Judgement:
    """What speaks for a class, and the verdict.

    hidden_error is the root mean square error of hidden landmarks, in the size of the
    shapes; gain the log evidence a landmark of the model beyond that of the flat one;
    turn the angle between the outermost directions of view, in degrees; half_distance
    how far the shapes are from those that each half of the images has by itself, mean
    ||X - X'|| / ||X||.
    """

    hidden_error: float
    gain: float
    turn: float
    half_distance: float
    verdict: str

    @property
    def fine(self) -> bool:
        """Whether a class was learned, possibly with doubtful depth."""
        return self.verdict in (LEARNED, DOUBTFUL)


LEARNED = "learned"
DOUBTFUL = "learned, but doubtful"
ALIKE = "views too alike: depth is not determined"
UNLIKE = "nothing in common: hidden landmarks are not predicted"


def evaluate_class(images: Images, state: State) -> Judgement:
    """Judge whether depth was learned, by hiding landmarks of a sample of the
    images.
    """
    some = images.hiding(state.outliers)[evenly(len(images), SAMPLE)]
    hidden = hide(some.weights > 0)
    remaining = some.hiding(hidden)
    n, p = remaining.weights.shape
    rigid = rigid_state(remaining)
    W, _ = complete(remaining, RANK)
    flat, evidence_of_flat = flat_state(remaining, W, np.zeros(n)), -np.inf
    angle = roll_angles(W)
    if np.abs(angle).max() > ROLLED:
        rolled = flat_state(remaining, W, angle)
        evidence_of_flat = rolled.objective - price_of_views(remaining, rolled, ROLL)
    evidence_of_flat = max(evidence_of_flat, flat.objective)
    *_, learned = improve(remaining, rigid, ROUNDS)
    forward = state.views.rotation[:, 2]
    half_distance = halves_distance(remaining, learned)
    closest = np.abs(forward @ forward[evenly(len(forward), SAMPLE)].T).min()
    gain = (
        learned.objective - price_of_views(remaining, learned, TURNS) - evidence_of_flat
    ) / (n * p)
    size = np.linalg.svd(state.model.mean, compute_uv=False)
    deep = gain > GAIN
    deforms = np.sqrt(learned.model.covariance.trace()) / np.linalg.norm(
        learned.model.mean
    )
    residual = (predict(remaining, learned) - some.landmarks)[
        hidden[:, None].repeat(2, axis=1)
    ]
    hidden_error = (
        float(np.sqrt((residual**2).mean())) if residual.size else float("nan")
    )
    same = half_distance < max(SAME * deforms, CLOSE)
    doubtful = deep or same or gain > REST
    verdict = LEARNED if deep and same else DOUBTFUL if doubtful else ALIKE
    if size[2] <= THIN * size[0]:
        verdict = ALIKE
    return Judgement(
        hidden_error=hidden_error,
        gain=gain,
        turn=float(np.degrees(np.arccos(min(closest, 1.0)))),
        half_distance=half_distance,
        verdict=UNLIKE if hidden_error > BLIND else verdict,
    )


def flat_state(images: Images, W: Floats, angle: Floats) -> State:
    """Return the flat model of completed landmarks W (n, 2, p), each image rolled by
    its angle.
    """
    views = Views(rotation_about_axis(2, angle), np.zeros(len(W)))
    *_, flat = improve(images, first_state(images, W, views), ROUNDS, turning=False)
    return flat


def roll_angles(W: Floats) -> Floats:
    """Angles (n,) by which images (n, 2, p) are rolled in their plane from their
    mean.
    """
    z = W[:, 0] + 1j * W[:, 1]
    mean = z[0]
    angle: Floats = np.zeros(len(W))
    for _ in range(MEANS):
        angle = np.angle(z @ mean.conj())
        mean = (z * np.exp(-1j * angle)[:, None]).mean(axis=0)
    return angle


def rigid_state(images: Images) -> State:
    """Return the rigid model of the images."""
    W, _ = complete(images, RANK)
    (views,) = find_views(W, (min(RANK, W.shape[2] - 1),))
    return first_state(images, W, views)


def halves_distance(images: Images, learned: State) -> float:
    """mean ||X - X'|| / ||X||: how far shapes X are from X', learned from half of the
    images.

    Each half, in the order of the images, is learned from by itself. The error
    of what was learned is less where the halves show the same poses from other sides.
    Near and far of a half may be exchanged.
    """
    n, distances = len(images), []
    for half in (np.arange(n // 2), np.arange(n // 2, n)):
        *_, by_itself = improve(images[half], rigid_state(images[half]), ROUNDS)
        X, tried = learned.in_camera[half], by_itself.in_camera
        size = np.linalg.norm(X, axis=(1, 2))
        mirrored = tried * np.array([1.0, 1.0, -1.0])[:, None]
        distances.append(
            min(
                float((np.linalg.norm(X - Y, axis=(1, 2)) / size).mean())
                for Y in (tried, mirrored)
            )
        )
    return float(np.mean(distances))


def price_of_views(images: Images, state: State, axes: slice) -> float:
    """sum_n log(S |H_n|^(1/2) / (2 pi)^(d/2)): what it costs that rotations were
    chosen.

    By Laplace's method for a uniform prior over the d axes; H is the information of a
    rotation about them, S = 8 pi^2 the size of all rotations, or 2 pi of those about
    one axis.
    """
    information = posterior_mean(
        images, state.views, state.model, slopes=True
    ).information
    assert information is not None
    H = information[:, axes, axes]
    d = H.shape[1]
    size = 8 * np.pi**2 if d > 1 else 2 * np.pi
    log_det = np.linalg.slogdet(H + 1e-9 * np.eye(d))[1]
    return float((np.log(size) - 0.5 * d * np.log(2 * np.pi) + 0.5 * log_det).sum())

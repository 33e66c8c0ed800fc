"""Whether depth was learned: hidden landmarks, predicted by the model and by simpler ones.

The rigid model has no deformations, the flat one no views: every image shows the same side.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from shapefit.dictionary.from_2d.expectation import expect
from shapefit.dictionary.from_2d.factorisation import complete, find_views
from shapefit.dictionary.from_2d.learning import State, first_state, improve
from shapefit.dictionary.from_2d.model import Floats, Images, Views, evenly, hide

SAMPLE, ROUNDS, RANK = 200, 15, 9

GAIN = 0.05
"""Log evidence a landmark that views must bring, beyond a flat model.

A body before a camera at rest brings up to 0.1, one that turns by 60 degrees 0.4.
"""

THIN = 0.05
"""Depth of the mean shape, as a share of its width, below which a class is flat."""


@dataclass(frozen=True)
class Judgement:
    """Root mean square errors of hidden landmarks, in the size of the shapes; and the verdict.

    gain is the log evidence a landmark of the model beyond that of the flat one; turn is the angle
    between the outermost directions of view, in degrees, seen from the shape; mean_error is the
    standard error of a coordinate of the mean shape.
    """

    learned: float
    rigid: float
    flat: float
    gain: float
    turn: float
    mean_error: float
    verdict: str

    @property
    def fine(self) -> bool:
        """Whether a class was learned."""
        return self.verdict == LEARNED


LEARNED = "learned"
ALIKE = "views too alike: depth is not determined"


def judge(images: Images, state: State) -> Judgement:
    """Judge what was learned of the images by a sample of them, part of whose landmarks hide."""
    some = images[evenly(len(images), SAMPLE)]
    hidden = hide(some.weights > 0)
    known = replace(some, weights=np.where(hidden, 0.0, some.weights))
    W = complete(known, RANK)
    n, _, p = W.shape
    (views,) = find_views(W, (min(RANK, p - 1),))
    rigid = first_state(known, W, views)
    one_view = Views(np.broadcast_to(np.eye(3), (n, 3, 3)).copy(), np.zeros(n))
    *_, flat = improve(known, first_state(known, W, one_view), ROUNDS, turning=False)
    *_, learned = improve(known, rigid, ROUNDS)

    def error(of: State) -> float:
        apart = (predict(known, of) - some.landmarks)[hidden[:, None].repeat(2, axis=1)]
        return float(np.sqrt((apart**2).mean())) if apart.size else float("nan")

    forward = state.views.rotation[:, 2]
    closest = np.abs(forward @ forward[evenly(len(forward), SAMPLE)].T).min()
    gain = (learned.objective - price_of_views(known, learned) - flat.objective) / (n * p)
    size = np.linalg.svd(state.model.mean, compute_uv=False)
    return Judgement(
        learned=error(learned),
        rigid=error(rigid),
        flat=error(flat),
        gain=gain,
        turn=float(np.degrees(np.arccos(min(closest, 1.0)))),
        mean_error=float(np.sqrt(np.diag(state.model.covariance).mean() / len(images))),
        verdict=LEARNED if gain > GAIN and size[2] > THIN * size[0] else ALIKE,
    )


def price_of_views(images: Images, state: State) -> float:
    """sum_n log(8 pi^2 |H_n|^(1/2) / (2 pi)^(3/2)): what it costs that rotations were chosen.

    By Laplace's method for a uniform prior over rotations; H is the information of a rotation.
    """
    H = expect(images, state.views, state.model).information[:, :3, :3]
    log_det = np.linalg.slogdet(H + 1e-9 * np.eye(3))[1]
    return float((np.log(8 * np.pi**2) - 1.5 * np.log(2 * np.pi) + 0.5 * log_det).sum())


def predict(images: Images, state: State) -> Floats:
    """Return where the model has all landmarks (n, 2, p), hidden ones too."""
    found = expect(images, state.views, state.model)
    shapes = replace(state, shapes=found.shapes).in_camera
    placed: Floats = shapes[:, :2] + found.translation[:, :, None]
    return placed

"""Whether depth was learned: by evidence beyond simpler models, by halves that agree.

The rigid model has no deformations, the flat one no views: every image shows the same
side, as it is or rolled about the axis of the camera.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shapefit.arrays import Floats, evenly
from shapefit.dictionary.from_2d.learning import (
    ClassState,
    complete_landmarks,
    find_views,
    first_state,
    improve,
    predict,
)
from shapefit.dictionary.from_2d.model import (
    Gaussian,
    Images,
    Views,
    hide_some,
    posterior_mean,
)
from shapefit.geometry.rotations import rotation_about_axis

JUDGED_IMAGES = 200
"""Images, evenly over all, by which a class is judged."""

JUDGED_ROUNDS = 15
"""Rounds of learning of each model that is compared."""

COMPLETION_RANK = 9
"""Factors by which hidden landmarks are filled in."""

ROLL_ROUNDS = 10
"""Rounds in which the roll of images and their mean are found."""

ALL_AXES = slice(0, 3)
"""About which a view turns."""

CAMERA_AXIS = slice(2, 3)
"""About which an image rolls."""

DEEP_GAIN = 0.05
"""Log evidence a landmark that views must bring, beyond a flat model.

A stiff body that turns by 60 degrees brings 0.4. One that bends may bring less although
its depth is right, where flat modes, three for each in depth, explain it as well.
"""

RESTING_GAIN = -0.2
"""The same, below which nothing has turned unless halves agree: planted bodies before a
camera that rests or rolls bring -0.3 to -1.1, people that turn by chance -0.03 to 0.2.
"""

SAME_DEFORMATION_SHARE = 0.5
"""Of what shapes differ from their mean, up to which those of halves are the same."""

SAME_SIZE_SHARE = 0.05
"""Of the size of shapes, up to which those of halves are the same, however stiff."""

BLIND_ERROR = 1.0
"""Of hidden landmarks in the middle of an image, in the size of the shapes."""

MIN_ROLL = 0.5
"""Roll of an image in radians, from which on a flat class may have rolled."""

FLAT_DEPTH_SHARE = 0.05
"""Depth of the mean shape, as a share of its width, below which a class is flat."""

LEARNED = "learned"
DOUBTFUL_DEPTH = "learned, but doubtful"
VIEWS_ALIKE = "views too alike: depth is not determined"
NOTHING_IN_COMMON = "nothing in common: hidden landmarks are not predicted"


@dataclass(frozen=True)
class Judgement:
    """How well a class was learned from 2D landmarks, and the verdict.

    verdict is `LEARNED`, `DOUBTFUL_DEPTH`, `VIEWS_ALIKE` or `NOTHING_IN_COMMON`.
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
    def is_learned(self) -> bool:
        """Whether a class was learned, possibly with doubtful depth."""
        return self.verdict in (LEARNED, DOUBTFUL_DEPTH)


def evaluate_class(images: Images, state: ClassState) -> Judgement:
    """Judge on a sample of the images whether a class and its depth were learned.

    By the error of hidden landmarks, the evidence beyond a flat model, and two halves
    that agree. state: what was learned from all images.
    """
    some = images.hiding(state.outliers)[evenly(len(images), JUDGED_IMAGES)]
    hidden = hide_some(some.weights > 0)
    remaining = some.hiding(hidden)
    n, p = remaining.weights.shape
    *_, learned = improve(remaining, rigid_state(remaining), JUDGED_ROUNDS)
    price = penalty_of_views(remaining, learned, ALL_AXES)
    gain = (learned.objective - price - flat_evidence(remaining)) / (n * p)
    half_distance = halves_distance(remaining, learned)
    residual = predict(remaining, learned) - some.landmarks
    residual = residual[hidden[:, None].repeat(2, axis=1)]
    hidden_error = float("nan")
    if residual.size:
        hidden_error = float(np.sqrt((residual**2).mean()))
    if hidden_error > BLIND_ERROR:
        verdict = NOTHING_IN_COMMON
    elif is_flat_class(state.model):
        verdict = VIEWS_ALIKE
    else:
        verdict = judge_depth(learned.model, gain, half_distance)
    return Judgement(
        hidden_error=hidden_error,
        gain=gain,
        turn=widest_turn(state.views),
        half_distance=half_distance,
        verdict=verdict,
    )


def judge_depth(model: Gaussian, gain: float, half_distance: float) -> str:
    """Return the verdict on depth: `LEARNED`, `DOUBTFUL_DEPTH` or `VIEWS_ALIKE`.

    Of a class that is not flat. gain: log evidence a landmark beyond a flat model;
    half_distance: of shapes learned from each half of the images, in sizes of a shape;
    see `Judgement`.
    """
    deforms = np.sqrt(model.covariance.trace()) / np.linalg.norm(model.mean)
    is_deep = gain > DEEP_GAIN
    is_same = half_distance < max(SAME_DEFORMATION_SHARE * deforms, SAME_SIZE_SHARE)
    if is_deep and is_same:
        return LEARNED
    if is_deep or is_same or gain > RESTING_GAIN:
        return DOUBTFUL_DEPTH
    return VIEWS_ALIKE


def is_flat_class(model: Gaussian) -> bool:
    """Whether the mean shape is flat: next to no extent along its thinnest axis."""
    size = np.linalg.svd(model.mean, compute_uv=False)
    return bool(size[2] <= FLAT_DEPTH_SHARE * size[0])


def widest_turn(views: Views) -> float:
    """Return the angle between the outermost directions of view, in degrees up to 90.

    Opposite directions count as one. Of `JUDGED_IMAGES` images at most.
    """
    forward = views.rotation[:, 2]
    some = forward[evenly(len(forward), JUDGED_IMAGES)]
    closest = np.abs(forward @ some.T).min()
    return float(np.degrees(np.arccos(min(closest, 1.0))))


def flat_evidence(images: Images) -> float:
    """Return the log evidence of the images if all show one flat shape.

    That is the flat model above. Of images rolled in their plane or not, whichever is
    larger.
    """
    W, _ = complete_landmarks(images, COMPLETION_RANK)
    upright = flat_state(images, W, np.zeros(len(images)))
    angle = roll_angles(W)
    if np.abs(angle).max() <= MIN_ROLL:
        return upright.objective
    rolled = flat_state(images, W, angle)
    price = penalty_of_views(images, rolled, CAMERA_AXIS)
    return max(rolled.objective - price, upright.objective)


def flat_state(images: Images, landmarks: Floats, angle: Floats) -> ClassState:
    """Learn the flat model: all views the same but for a roll by `angle` (n,).

    angle, in radians; landmarks (n, 2, p), hidden ones filled in.
    """
    views = Views(rotation_about_axis(2, angle), np.zeros(len(landmarks)))
    start = first_state(images, landmarks, views)
    *_, flat = improve(images, start, JUDGED_ROUNDS, turning=False)
    return flat


def roll_angles(landmarks: Floats) -> Floats:
    """Return the angles (n,) in radians by which images are rolled in their plane.

    From their mean; landmarks (n, 2, p), hidden ones filled in.
    """
    z = landmarks[:, 0] + 1j * landmarks[:, 1]
    mean = z[0]
    angle: Floats = np.zeros(len(landmarks))
    for _ in range(ROLL_ROUNDS):
        angle = np.angle(z @ mean.conj())
        mean = (z * np.exp(-1j * angle)[:, None]).mean(axis=0)
    return angle


def rigid_state(images: Images) -> ClassState:
    """Learn the rigid model of the images: their views and one shape for all."""
    W, _ = complete_landmarks(images, COMPLETION_RANK)
    (views,) = find_views(W, (min(COMPLETION_RANK, W.shape[2] - 1),))
    return first_state(images, W, views)


def halves_distance(images: Images, learned: ClassState) -> float:
    """Return the mean distance of learned shapes from those of half the images alone.

    mean ||X - X'|| / ||X|| of shapes X, as learned from all, and X', learned from the
    first or the second half of the images. The error of what was learned is less where
    the halves show the same poses from other sides. Near and far of a half may be
    exchanged.
    """
    n = len(images)
    distances = []
    for half in (np.arange(n // 2), np.arange(n // 2, n)):
        start = rigid_state(images[half])
        *_, by_itself = improve(images[half], start, JUDGED_ROUNDS)
        X = learned.in_camera[half]
        seen = by_itself.in_camera
        mirrored = seen * np.array([1.0, 1.0, -1.0])[:, None]
        distances.append(min(_mean_distance(X, seen), _mean_distance(X, mirrored)))
    return float(np.mean(distances))


def _mean_distance(X: Floats, Y: Floats) -> float:
    """Return the mean of ||X - Y|| / ||X|| over shapes X and Y (n, 3, p)."""
    size = np.linalg.norm(X, axis=(1, 2))
    return float((np.linalg.norm(X - Y, axis=(1, 2)) / size).mean())


def penalty_of_views(images: Images, state: ClassState, axes: slice) -> float:
    """Return the Occam penalty of fitted views, to subtract from the log evidence.

    sum_n log(S |H_n|^(1/2) / (2 pi)^(d/2)), by Laplace's method for a uniform prior
    over the d axes; H is the information of a rotation about them, S = 8 pi^2 the size
    of all rotations, or 2 pi of those about one axis.
    """
    expected = posterior_mean(images, state.views, state.model, slopes=True)
    assert expected.information is not None
    H = expected.information[:, axes, axes]
    d = H.shape[1]
    size = 8 * np.pi**2 if d > 1 else 2 * np.pi
    log_det = np.linalg.slogdet(H + 1e-9 * np.eye(d))[1]
    penalty = np.log(size) - 0.5 * d * np.log(2 * np.pi) + 0.5 * log_det
    return float(penalty.sum())

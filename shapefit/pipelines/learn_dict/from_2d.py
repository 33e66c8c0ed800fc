"""A dictionary of 2D landmarks: shapes are lifted by what images share, then learned
from.

Landmarks that are hidden from the fit judge what was learned.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from shapefit.arrays import Floats, evenly
from shapefit.config import LearnDictConfig
from shapefit.config.commands.others import PriorConfig
from shapefit.dictionary.from_2d.judgement import (
    DOUBTFUL_DEPTH,
    NOTHING_IN_COMMON,
    VIEWS_ALIKE,
    evaluate_class,
)
from shapefit.dictionary.from_2d.learning import ClassState, learn_class
from shapefit.dictionary.from_2d.model import Images, hide_some
from shapefit.dictionary.mixture import Mixture
from shapefit.dictionary.model import (
    DEPTH_AMBIGUITY,
    LEARNED_FROM,
    OPEN,
    VERDICT,
    Dictionary,
)
from shapefit.errors import counted, input_error
from shapefit.geometry.normalisation import normalise, std
from shapefit.geometry.pinhole import CAMERA_MATRIX
from shapefit.geometry.procrustes import rotation_onto
from shapefit.io import LandmarkSource, digests
from shapefit.pipelines.fit.camera import find_camera, read_intrinsics
from shapefit.pipelines.fit.choices import check_needs
from shapefit.pipelines.fit.evidence import mean_gain
from shapefit.pipelines.fit.image_posterior import (
    ImagePosterior,
    PosteriorLifting,
)
from shapefit.pipelines.learn_dict.from_3d import (
    Learning,
    learn_from_shapes,
    number_of_components,
    place_of,
)
from shapefit.pipelines.result import Result
from shapefit.records import Landmarks, Shapes, concatenate

FEWEST_IMAGES, FEWEST_VISIBLE = 20, 4
"""Images from which depth can be learned, and landmarks that each must show: any three
fit any shape.
"""

FAR_OUT = 4.0
"""Medians of the distance from the middle of an image up to which landmarks count for
its size.
"""

MIN_RESIDUAL_VARIANCE = 1e-4
"""Variance of a normalised coordinate: below it, a landmark a little off is an outlier.
"""

SAMPLE, MIXTURES, QUICK = 500, 4, 3
"""Images by which dictionaries are compared; mixtures learned at most; rounds of
learning atoms that only have to find views.
"""

CLOSE = 1.1
"""Factor of the Gaussian's error of hidden landmarks up to which a mixture is kept in
its place: they say little of depth, of which a mixture that is as good in the image
knows more.
"""

LARGER = 2.0
"""Factor of size from one mixture to the next beyond which an image was misread."""

SURE = 5.0
"""Standard errors of the evidence beyond which perspective decides what is near."""

FIXES = {
    VIEWS_ALIKE: (
        "give images from more sides: the camera or the body must turn, and not be flat"
    ),
    NOTHING_IN_COMMON: (
        "give images of one class, whose landmarks are in the same order in all of them"
    ),
}
"""What to do about each verdict with which nothing is learned."""

MIRRORED = (
    "near and far cannot be distinguished in 2D landmarks alone, and no image that is"
    " lifted is trusted before they are: look at some shapes, and learn again with"
    " `flip=true` if near is far, `flip=false` if it is not"
)


def learn_from_landmarks(source: LandmarkSource, config: LearnDictConfig) -> Learning:
    """Lift the images by what they have in common, and learn a dictionary from the
    shapes.

    A mixture over shapes replaces the Gaussian that lifted them if it predicts hidden
    landmarks as well; at last near is distinguished from far. Raises InputError with
    the verdict where depth cannot be learned from the images.
    """
    place = place_of(config)
    given = usable_images(source, place)
    images = normalised_images(given)
    for state in learn_class(images):
        density = state.objective / (2 * int((images.weights > 0).sum()))
        yield Result(done=1, unit="round", note=f"evidence {density:.3f} a coordinate")
    judgement = evaluate_class(images, state)
    evidence = (
        f"{describe_prediction(judgement.hidden_error)}, evidence of depth"
        f" {judgement.gain:.2f} per landmark, views up to {judgement.turn:.0f} degrees"
        " apart"
    )
    if not judgement.fine:
        fix = FIXES[judgement.verdict]
        raise input_error(place, f"{judgement.verdict} ({evidence})", fix)
    outliers = f"{int(state.outliers.sum())} landmarks are outliers"
    line = (
        f"{counted(len(given), 'image')}: {judgement.verdict}; {evidence}; {outliers}"
    )
    yield Result(line=line)
    verdict = "doubtful" if judgement.verdict == DOUBTFUL_DEPTH else "learned"
    made = yield from learn_mixtures(given, images, state, config)
    made, decided_by = resolve_depth(given, made, config.flip)
    if decided_by == OPEN:
        yield Result(warnings=(MIRRORED,))
    further = {LEARNED_FROM: "landmarks", VERDICT: verdict, DEPTH_AMBIGUITY: decided_by}
    return replace(made, provenance={**made.provenance, **further})


def describe_prediction(error: float) -> str:
    """Say how well hidden landmarks are predicted, by their error in sizes of a shape;
    nan where there were none.
    """
    if np.isnan(error):
        return "no hidden landmark to predict"
    return f"hidden landmarks predicted to {error:.3f} of the size of a shape"


def usable_images(source: LandmarkSource, place: str) -> Landmarks:
    """Return the images that show enough landmarks, not all at one point.

    Raises InputError for too few of them, and for landmarks that none of them shows.
    """
    given = concatenate(list(source.batches(4096)))
    visible = given.visible()
    distinct = std(np.where(visible[:, None], given.as_columns(), 0.0), visible) > 0
    usable = given.take(
        np.flatnonzero(distinct & (visible.sum(axis=1) >= FEWEST_VISIBLE))
    )
    if len(usable) < FEWEST_IMAGES:
        fault = f"{len(usable)} of {len(given)} show {FEWEST_VISIBLE} landmarks or more"
        fix = f"give {FEWEST_IMAGES} at least, of different views"
        raise input_error(place, f"too few images: {fault}", fix)
    hidden = ~usable.visible().any(axis=0)
    if hidden.any():
        fault = f"no image shows {usable.landmark_names[int(hidden.argmax())]}"
        raise input_error(place, fault, "leave out landmarks that are never seen")
    return usable


def normalised_images(given: Landmarks) -> Images:
    """Bring the landmarks of each sequence, or of each image without one, to the size
    1.

    Landmarks that lie far out do not count for the size, as outliers do not.
    """
    w, visible = given.as_columns(), given.visible()
    middle = np.nanmedian(np.where(visible[:, None], w, np.nan), axis=2, keepdims=True)
    distance = np.where(visible, np.linalg.norm(w - middle, axis=1), np.nan)
    reach = FAR_OUT * np.nanmedian(distance, axis=1, keepdims=True)
    normalised = normalise(w, visible & ((distance <= reach) | (reach == 0)))
    size = normalised.scale
    sequence = np.zeros(len(given), np.intp)
    if given.sequences is not None:
        sequence = np.unique(np.array(given.sequences, dtype=str), return_inverse=True)[
            1
        ]
        squares = np.bincount(sequence, size**2) / np.bincount(sequence)
        size = np.sqrt(squares)[sequence]
    centred = np.where(visible[:, None], w - normalised.centroid[..., None], 0.0)
    return Images(centred / size[:, None, None], given.weights(), sequence)


def learn_mixtures(
    given: Landmarks, normalised: Images, state: ClassState, config: LearnDictConfig
) -> Learning:
    """Learn mixtures over the shapes that the prior before lifted, while they predict
    better.

    The prior of the dictionary is the best one, or, where bodies are to vary, one of
    varied shapes. Hidden landmarks judge how sure it is: shapes that were lifted, and
    not measured, say nothing.
    """
    inputs = digests(config.shapes)

    def learned(
        shapes: Shapes, components: int, rounds: int, *, varied: bool
    ) -> Learning:
        unchanged = {} if varied else {"bone_scale": 0.0, "exchange": 0.0}
        changed = config.changed(
            prior={"components": components, **unchanged}, iterations=rounds
        )
        return learn_from_shapes(shapes, changed, inputs)

    # Outliers stay: the posterior of a mixture weighs them anew.
    w = normalised.landmarks.swapaxes(1, 2)
    seen = np.where(given.visible()[..., None], w, np.nan)
    images = replace(given, landmarks=seen)
    shapes = Shapes(
        state.in_camera.swapaxes(1, 2),
        landmark_names=given.landmark_names,
        items=given.items,
        sequences=given.sequences,
        frame_rate=given.frame_rate,
        edges=given.edges,
    )
    prior = config.prior if config.prior.components else PriorConfig(components="auto")
    number = number_of_components(len(images), prior)
    made = yield from learned(shapes, 0, QUICK, varied=False)
    best = replace(made, **gaussian_prior(state, made.mean_shape))
    best_shapes, least = shapes, predict_hidden(images, best)
    for _ in range(MIXTURES):
        mixed = yield from learned(shapes, number, QUICK, varied=False)
        error = predict_hidden(images, mixed)
        gaussian = best.residual_variance is not None
        if error >= (CLOSE * least if gaussian and number > 1 else least):
            # no mixture after such a one was ever better, and some were read wrongly
            break
        best, best_shapes, least = mixed, shapes, error
        lifted = lift_images(images, mixed).shapes
        before = shapes.as_columns()
        grown = np.linalg.norm(lifted, axis=(1, 2)) / np.linalg.norm(
            before, axis=(1, 2)
        )
        well_read = (grown > 1 / LARGER) & (grown < LARGER)  # not so where it is nan
        read = np.where(well_read[:, None, None], lifted, before)
        shapes = replace(shapes, shapes=read.swapaxes(1, 2))
    if config.prior.bone_scale or config.prior.exchange:
        return (yield from learned(best_shapes, number, config.iterations, varied=True))
    made = yield from learned(best_shapes, 0, config.iterations, varied=False)
    return replace(made, prior=best.prior, residual_variance=best.residual_variance)


def gaussian_prior(state: ClassState, mean: Floats) -> dict[str, Any]:
    """Return what was learned as `prior` of normalised shapes, turned onto their mean
    (3, p).

    `residual_variance` is the variance of what it does not explain. The size of a shape
    is the image's to find, so that the covariance has no part along the mean.
    """
    model = state.model
    d = model.mean.size
    scale = float(normalise(model.mean).scale)
    turn = rotation_onto(model.mean, mean)
    mu = (turn @ model.mean) / scale
    unit = mu.ravel() / np.linalg.norm(mu)
    Q = (np.eye(d) - np.outer(unit, unit)) @ np.kron(turn, np.eye(d // 3)) / scale
    C = Q @ model.covariance @ Q.T + 1e-9 * np.eye(d)
    variance = max(model.noise / scale**2, MIN_RESIDUAL_VARIANCE)
    prior = Mixture(np.ones(1), mu[None], (C + C.T)[None] / 2)
    return {"prior": prior, "residual_variance": np.array([variance])}


def resolve_depth(
    images: Landmarks, made: Dictionary, flip: bool | None
) -> tuple[Dictionary, str]:
    """Return the dictionary, or its mirror image, and what has decided: `flip`, else
    cameras.
    """
    if flip is not None:
        return mirror_image(made) if flip else made, "stated by `flip`"
    if images.column(CAMERA_MATRIX) is not None:
        gain, deviation = evidence_of_mirror(images, made)
        if abs(gain) >= SURE * deviation:
            return mirror_image(made) if gain > 0 else made, "told by perspective"
    return made, OPEN


def mirror_image(made: Dictionary) -> Dictionary:
    """Return the dictionary with near and far exchanged."""
    prior = made.prior
    assert prior is not None, "learned from landmarks"
    mirror = np.array([[1.0], [1.0], [-1.0]])
    sign = np.repeat(mirror, made.mean_shape.shape[1])
    covariances = np.outer(sign, sign) * prior.covariances
    mirrored = Mixture(prior.weights, mirror * prior.means, covariances)
    atoms, mean_shape = mirror * made.atoms, mirror * made.mean_shape
    return replace(made, atoms=atoms, mean_shape=mean_shape, prior=mirrored)


def evidence_of_mirror(
    images: Landmarks, dictionary: Dictionary
) -> tuple[float, float]:
    """Log evidence an image that the class is mirrored, as the cameras see it; standard
    error.

    The mirror image of a class is seen as the class is in mirrored images.
    """
    sample = images.take(evenly(len(images), SAMPLE))
    middle = read_intrinsics(sample)[1][:, :1]
    w = sample.landmarks.copy()
    w[..., 0] = 2 * middle - w[..., 0]
    unchanged, mirrored = (
        lift_images(records, dictionary, perspective=True).estimate.log_evidence
        for records in (sample, replace(sample, landmarks=w))
    )
    return mean_gain(unchanged, mirrored)


def predict_hidden(images: Landmarks, dictionary: Dictionary) -> float:
    """Hide a tenth of the landmarks of a sample of the images, each by itself, and
    predict them.

    Returns the median distance from where they are, in the size of their image.
    """
    sample = images.take(evenly(len(images), SAMPLE))
    hidden = hide_some(sample.visible())
    shown = np.where(hidden[..., None], np.nan, sample.landmarks)
    others = replace(sample, landmarks=shown)
    predicted = lift_images(others, dictionary).shapes[:, :2]
    w = sample.as_columns()
    size = std(w, sample.visible())[:, None]
    residual = np.linalg.norm(predicted - w, axis=1) / size
    return float(np.nanmedian(residual[hidden]))


def lift_images(
    images: Landmarks, dictionary: Dictionary, *, perspective: bool = False
) -> PosteriorLifting:
    """Lift images one by one with what was learned so far, by weak perspective or as
    the cameras of the file see them.
    """
    check_needs("posterior", dictionary, "dictionary")
    posterior = ImagePosterior(
        dictionary=dictionary, camera=find_camera if perspective else None
    )
    return posterior.lift(images)

"""A dictionary of 2D landmarks: shapes are lifted by what images share, then learned.

Landmarks that are hidden from the fit judge what was learned.
"""

from __future__ import annotations

from dataclasses import replace

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
from shapefit.lifting.lift import PosteriorLifting
from shapefit.pipelines.fit.camera import find_camera, intrinsics_of
from shapefit.pipelines.fit.choices import check_needs
from shapefit.pipelines.fit.evidence import mean_gain
from shapefit.pipelines.fit.image_posterior import ImagePosterior
from shapefit.pipelines.learn_dict.from_3d import (
    Learning,
    learn_from_shapes,
    number_of_components,
    place_of,
)
from shapefit.pipelines.result import Result
from shapefit.records import Landmarks, Shapes, concatenate

MIN_TRAINING_IMAGES = 20
"""From which depth can be learned."""

MIN_SHOWN_LANDMARKS = 4
"""That each image must show: any three fit any shape."""

MAX_MEDIAN_DISTANCES = 4.0
"""Medians of the distance from the middle of an image up to which landmarks count for
its size.
"""

MIN_RESIDUAL_VARIANCE = 1e-4
"""Variance of a normalised coordinate: below it, a landmark a little off is an outlier.
"""

COMPARED_IMAGES = 500
"""By which dictionaries are compared."""

MAX_MIXTURES = 4
"""Mixtures learned, one after the other."""

ROUNDS_FOR_VIEWS = 3
"""Rounds of learning atoms that only have to find views."""

MAX_ERROR_RATIO = 1.1
"""Factor of the Gaussian's error of hidden landmarks up to which a mixture is kept in
its place: they say little of depth, of which a mixture that is as good in the image
knows more.
"""

MAX_GROWTH = 2.0
"""Factor of size from one mixture to the next beyond which an image was misread."""

MIN_STANDARD_ERRORS = 5.0
"""Of the evidence, from which on perspective decides what is near."""

FIXES = {
    VIEWS_ALIKE: (
        "give images from more sides: the camera or the body must turn, and not be flat"
    ),
    NOTHING_IN_COMMON: (
        "give images of one class, whose landmarks are in the same order in all of them"
    ),
}
"""What to do about each verdict with which nothing is learned."""

DEPTH_WARNING = (
    "near and far cannot be distinguished in 2D landmarks alone, and no image that is"
    " lifted is trusted before they are: look at some shapes, and learn again with"
    " `flip=true` if near is far, `flip=false` if it is not"
)


def learn_from_landmarks(source: LandmarkSource, config: LearnDictConfig) -> Learning:
    """Learn a dictionary from 2D landmarks, lifted by what the images have in common.

    A mixture over shapes replaces the Gaussian that lifted them if it predicts hidden
    landmarks as well; at last near is distinguished from far. Raises InputError with
    the verdict where depth cannot be learned from the images.
    """
    place = place_of(config)
    landmarks = select_usable_images(source, place)
    images = normalised_images(landmarks)
    for state in learn_class(images):
        density = state.objective / (2 * int((images.weights > 0).sum()))
        yield Result(done=1, unit="round", note=f"evidence {density:.3f} a coordinate")
    judgement = evaluate_class(images, state)
    evidence = (
        f"{describe_prediction(judgement.hidden_error)}, evidence of depth"
        f" {judgement.gain:.2f} per landmark, views up to {judgement.turn:.0f} degrees"
        " apart"
    )
    if not judgement.is_learned:
        fix = FIXES[judgement.verdict]
        raise input_error(place, f"{judgement.verdict} ({evidence})", fix)
    outliers = f"{int(state.outliers.sum())} landmarks are outliers"
    line = (
        f"{counted(len(landmarks), 'image')}: {judgement.verdict}; {evidence};"
        f" {outliers}"
    )
    yield Result(line=line)
    verdict = "doubtful" if judgement.verdict == DOUBTFUL_DEPTH else "learned"
    dictionary = yield from learn_mixtures(landmarks, images, state, config)
    dictionary, decided_by = resolve_depth(landmarks, dictionary, config.flip)
    if decided_by == OPEN:
        yield Result(warnings=(DEPTH_WARNING,))
    provenance = {
        **dictionary.provenance,
        LEARNED_FROM: "landmarks",
        VERDICT: verdict,
        DEPTH_AMBIGUITY: decided_by,
    }
    return replace(dictionary, provenance=provenance)


def describe_prediction(error: float) -> str:
    """Return a text on the error of hidden landmarks, in sizes of a shape.

    The error is nan where none was hidden.
    """
    if np.isnan(error):
        return "no hidden landmark to predict"
    return f"hidden landmarks predicted to {error:.3f} of the size of a shape"


def select_usable_images(source: LandmarkSource, place: str) -> Landmarks:
    """Return the images that show enough landmarks, not all at one point.

    Raises InputError for too few of them, and for landmarks that none of them shows;
    `place` names the files in it.
    """
    landmarks = concatenate(list(source.batches(4096)))
    visible = landmarks.visible()
    shown = np.where(visible[:, None], landmarks.as_columns(), 0.0)
    has_extent = std(shown, visible) > 0
    has_enough = visible.sum(axis=1) >= MIN_SHOWN_LANDMARKS
    usable = landmarks.take(np.flatnonzero(has_extent & has_enough))
    if len(usable) < MIN_TRAINING_IMAGES:
        share = f"{len(usable)} of {len(landmarks)}"
        fault = f"{share} show {MIN_SHOWN_LANDMARKS} landmarks or more"
        fix = f"give {MIN_TRAINING_IMAGES} at least, of different views"
        raise input_error(place, f"too few images: {fault}", fix)
    hidden = ~usable.visible().any(axis=0)
    if hidden.any():
        fault = f"no image shows {usable.landmark_names[int(hidden.argmax())]}"
        raise input_error(place, fault, "leave out landmarks that are never seen")
    return usable


def normalised_images(landmarks: Landmarks) -> Images:
    """Return the landmarks centred in each image, and of size 1 in each sequence.

    Without sequences each image has the size 1. Landmarks that lie far out do not
    count, as outliers do not.
    """
    w = landmarks.as_columns()
    visible = landmarks.visible()
    shown = np.where(visible[:, None], w, np.nan)
    middle = np.nanmedian(shown, axis=2, keepdims=True)
    distance = np.where(visible, np.linalg.norm(w - middle, axis=1), np.nan)
    farthest = MAX_MEDIAN_DISTANCES * np.nanmedian(distance, axis=1, keepdims=True)
    is_near = (distance <= farthest) | (farthest == 0)
    normalised = normalise(w, visible & is_near)
    size = normalised.scale
    sequence = np.zeros(len(landmarks), np.intp)
    if landmarks.sequences is not None:
        names = np.array(landmarks.sequences, dtype=str)
        _, sequence = np.unique(names, return_inverse=True)
        squares = np.bincount(sequence, size**2) / np.bincount(sequence)
        size = np.sqrt(squares)[sequence]
    centred = np.where(visible[:, None], w - normalised.centroid[..., None], 0.0)
    return Images(centred / size[:, None, None], landmarks.weights(), sequence)


def learn_mixtures(
    landmarks: Landmarks, images: Images, state: ClassState, config: LearnDictConfig
) -> Learning:
    """Learn a dictionary by turns: lift shapes, learn a mixture of them, lift again.

    state: the shapes and the Gaussian prior that were learned from the images, which
    are the landmarks normalised. Turns go on while the mixture predicts hidden
    landmarks better. The prior of the dictionary is the best of them, the Gaussian
    among them, or, where the config varies bodies, a mixture over varied shapes.
    """
    inputs = digests(config.shapes)

    def learn(
        shapes: Shapes, components: int, rounds: int, *, vary: bool = False
    ) -> Learning:
        """Learn a dictionary from shapes, with a prior of `components`; 0 for none."""
        prior: dict[str, float] = {"components": components}
        if not vary:
            prior |= {"bone_scale": 0.0, "exchange": 0.0}
        changed = config.changed(prior=prior, iterations=rounds)
        return learn_from_shapes(shapes, changed, inputs)

    # Outliers stay: the posterior of a mixture weighs them anew.
    w = images.landmarks.swapaxes(1, 2)
    seen = np.where(landmarks.visible()[..., None], w, np.nan)
    normalised = replace(landmarks, landmarks=seen)
    shapes = Shapes(
        state.in_camera.swapaxes(1, 2),
        landmark_names=landmarks.landmark_names,
        items=landmarks.items,
        sequences=landmarks.sequences,
        frame_rate=landmarks.frame_rate,
        edges=landmarks.edges,
    )
    prior = config.prior if config.prior.components else PriorConfig(components="auto")
    number = number_of_components(len(normalised), prior)
    dictionary = yield from learn(shapes, 0, ROUNDS_FOR_VIEWS)
    best = with_gaussian_prior(dictionary, state)
    best_shapes = shapes
    least_error = error_of_hidden(normalised, best)
    for _ in range(MAX_MIXTURES):
        mixed = yield from learn(shapes, number, ROUNDS_FOR_VIEWS)
        error = error_of_hidden(normalised, mixed)
        is_gaussian = best.residual_variance is not None
        allowed = least_error
        if is_gaussian and number > 1:
            allowed = MAX_ERROR_RATIO * least_error
        if error >= allowed:
            # no mixture after such a one was ever better, and some were read wrongly
            break
        best = mixed
        best_shapes = shapes
        least_error = error
        shapes = lift_anew(shapes, normalised, mixed)
    if config.prior.bone_scale or config.prior.exchange:
        return (yield from learn(best_shapes, number, config.iterations, vary=True))
    dictionary = yield from learn(best_shapes, 0, config.iterations)
    return replace(
        dictionary, prior=best.prior, residual_variance=best.residual_variance
    )


def lift_anew(shapes: Shapes, images: Landmarks, dictionary: Dictionary) -> Shapes:
    """Lift images with a dictionary, and return the new shapes in place of `shapes`.

    A shape whose size changes by more than MAX_GROWTH stays as it was.
    """
    lifted = lift_images(images, dictionary).shapes
    before = shapes.as_columns()
    size = np.linalg.norm(lifted, axis=(1, 2))
    growth = size / np.linalg.norm(before, axis=(1, 2))
    is_well_read = (growth > 1 / MAX_GROWTH) & (growth < MAX_GROWTH)  # nan is not
    chosen = np.where(is_well_read[:, None, None], lifted, before)
    return replace(shapes, shapes=chosen.swapaxes(1, 2))


def with_gaussian_prior(dictionary: Dictionary, state: ClassState) -> Dictionary:
    """Return the dictionary with the Gaussian of a learned class as its prior.

    It is scaled to normalised shapes, and turned onto the mean shape; residual_variance
    is the variance of what it does not explain. The size of a shape is the image's to
    find, so that the covariance has no part along the mean.
    """
    model = state.model
    d = model.mean.size
    scale = float(normalise(model.mean).scale)
    turn = rotation_onto(model.mean, dictionary.mean_shape)
    mu = (turn @ model.mean) / scale
    unit = mu.ravel() / np.linalg.norm(mu)
    Q = (np.eye(d) - np.outer(unit, unit)) @ np.kron(turn, np.eye(d // 3)) / scale
    C = Q @ model.covariance @ Q.T + 1e-9 * np.eye(d)
    variance = max(model.noise / scale**2, MIN_RESIDUAL_VARIANCE)
    prior = Mixture(np.ones(1), mu[None], (C + C.T)[None] / 2)
    return replace(dictionary, prior=prior, residual_variance=np.array([variance]))


def resolve_depth(
    images: Landmarks, dictionary: Dictionary, flip: bool | None
) -> tuple[Dictionary, str]:
    """Return the dictionary or its mirror image in depth, and a text on what decided.

    Weak perspective cannot distinguish the two. `flip` decides (True takes the mirror
    image), else perspective where the cameras are known; the text is OPEN where neither
    does.
    """
    decided_by = OPEN
    is_mirrored = False
    if flip is not None:
        decided_by = "stated by `flip`"
        is_mirrored = flip
    elif images.column(CAMERA_MATRIX) is not None:
        gain, standard_error = evidence_of_mirror(images, dictionary)
        if abs(gain) >= MIN_STANDARD_ERRORS * standard_error:
            decided_by = "told by perspective"
            is_mirrored = gain > 0
    return (mirror_image(dictionary) if is_mirrored else dictionary), decided_by


def mirror_image(dictionary: Dictionary) -> Dictionary:
    """Return the dictionary with near and far exchanged."""
    prior = dictionary.prior
    assert prior is not None, "learned from landmarks"
    mirror = np.array([[1.0], [1.0], [-1.0]])
    sign = np.repeat(mirror, dictionary.mean_shape.shape[1])
    covariances = np.outer(sign, sign) * prior.covariances
    return replace(
        dictionary,
        atoms=mirror * dictionary.atoms,
        mean_shape=mirror * dictionary.mean_shape,
        prior=Mixture(prior.weights, mirror * prior.means, covariances),
    )


def evidence_of_mirror(
    images: Landmarks, dictionary: Dictionary
) -> tuple[float, float]:
    """Return the mean log evidence for the mirror image, and its standard error.

    The evidence of an image by perspective, of the mirror image over the class itself.
    Cameras see the mirror image of a class as they see the class in mirrored images.
    """
    sample = images.take(evenly(len(images), COMPARED_IMAGES))
    middle = intrinsics_of(sample)[1][:, :1]
    w = sample.landmarks.copy()
    w[..., 0] = 2 * middle - w[..., 0]

    def evidence(images: Landmarks) -> Floats:
        """Return the log evidence (n,) of images in perspective."""
        lifting = lift_images(images, dictionary, perspective=True)
        return lifting.estimate.log_evidence

    return mean_gain(evidence(sample), evidence(replace(sample, landmarks=w)))


def error_of_hidden(images: Landmarks, dictionary: Dictionary) -> float:
    """Return the median error at which hidden landmarks of a sample are predicted.

    A tenth of them is hidden. The error is in sizes of the landmarks of an image.
    """
    sample = images.take(evenly(len(images), COMPARED_IMAGES))
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
    """Lift images one by one with a dictionary and its prior.

    By weak perspective, or as the cameras of the file see them.
    """
    check_needs("posterior", dictionary, "dictionary")
    posterior = ImagePosterior(
        dictionary=dictionary, camera=find_camera if perspective else None
    )
    return posterior.lift(images)

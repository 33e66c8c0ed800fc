"""Learning from 2D landmarks: they are lifted, learned from as 3D shapes, and lifted again."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats
from shapefit.config.commands.fit_sections import CAMERA_MATRIX
from shapefit.dictionary.from_2d.judgement import ALIKE, DOUBTFUL, UNLIKE, Judgement, judge
from shapefit.dictionary.from_2d.learning import State, learn
from shapefit.dictionary.from_2d.model import Images
from shapefit.dictionary.mixture import Mixture
from shapefit.dictionary.model import LEARNED_FROM, NEAR_AND_FAR, OPEN, VERDICT, Dictionary
from shapefit.errors import InputError, counted, input_error
from shapefit.geometry.normalisation import normalise, spread
from shapefit.geometry.procrustes import rotation_onto
from shapefit.io import LandmarkSet, LandmarkSource, ShapeSet
from shapefit.io.layout import EDGES
from shapefit.io.records import concatenate
from shapefit.pipelines.learn_dict.hidden import evidence_of_mirror, lift_by, predict_hidden
from shapefit.pipelines.outcome import Outcome

FEWEST_SEEN = 4
"""Landmarks of an image that say something of shapes: any three fit."""

FAR_OUT = 4.0
"""Medians of the distance from the middle of an image up to which landmarks count for its size."""

LEAST_MISFIT = 1e-4
"""Variance of a normalised coordinate: where less is believed, a landmark a little off is gross."""

FIX = {
    ALIKE: "give images from more sides: the camera or the body must turn, and not be flat",
    UNLIKE: "give images of one class, whose landmarks are in the same order in all of them",
}
"""What to do about each verdict with which nothing is learned."""

FEWEST_IMAGES = 20
"""Images from which depth can be learned at all."""


@dataclass(frozen=True)
class Learned:
    """The images that say something, their shapes before the camera, and what was learned.

    The landmarks of each sequence have the size 1, but for those `given`.
    """

    given: LandmarkSet
    images: LandmarkSet
    shapes: ShapeSet
    state: State
    judgement: Judgement
    flip: bool | None


def learn_from_landmarks(
    source: LandmarkSource, place: str, flip: bool | None
) -> Generator[Outcome, None, Learned]:
    """Lift the images by what they have in common; an outcome a round.

    Raises InputError with the verdict where depth cannot be learned from them.
    """
    given = concatenate(list(source.batches(4096))) if source.count else None
    some = None if given is None else given.take(says_something(given))
    if some is None or len(some) < FEWEST_IMAGES:
        raise too_few(0 if some is None else len(some), source.count, place)
    check_all_seen(some, place)
    images = images_of(some)
    state = None
    for state in learn(images):
        per = state.objective / (2 * int((images.weights > 0).sum()))
        yield Outcome(done=1, unit="round", note=f"evidence {per:.3f} a coordinate")
    assert state is not None
    judgement = judge(images, state)
    size = float(np.median(spread(some.landmarks, some.seen())))
    if not judgement.fine:
        raise input_error(
            place, f"{judgement.verdict} ({report(judgement, size)})", FIX[judgement.verdict]
        )
    shapes = ShapeSet(
        shapes=flipped(state.in_camera, flip),
        landmark_names=some.landmark_names,
        items=some.items,
        sequences=some.sequences,
        frame_rate=some.frame_rate,
        edges=some.columns.get(EDGES),
    )
    gross = f"{int(state.gross.sum())} of {counted(int(some.seen().sum()), 'landmark')}"
    yield Outcome(
        line=f"{counted(len(some), 'image')}: {judgement.verdict}; {report(judgement, size)}; "
        f"{gross} gross and set aside",
        warnings=tuple(find_doubts(judgement, flip is not None or CAMERA_MATRIX in some.columns)),
    )
    # the gross ones, too: a mixture may believe them, and sets aside those that it does not
    lifted = np.where(some.seen()[:, None], images.landmarks, np.nan)
    return Learned(some, some.replaced(landmarks=lifted), shapes, state, judgement, flip)


def says_something(given: LandmarkSet) -> NDArray[np.bool_]:
    """Whether each image shows enough landmarks, and not all at one point; (n,)."""
    seen = given.seen()
    apart: NDArray[np.bool_] = spread(np.where(seen[:, None], given.landmarks, 0.0), seen) > 0
    return apart & (seen.sum(axis=1) >= FEWEST_SEEN)


def too_few(usable: int, given: int, place: str) -> InputError:
    """Return the error that says that these images are not enough."""
    found = f"too few images: {usable} of {given} show {FEWEST_SEEN} landmarks or more"
    return input_error(place, found, f"give {FEWEST_IMAGES} at least, of different views")


def check_all_seen(given: LandmarkSet, place: str) -> None:
    """Raise InputError for landmarks that no image shows."""
    never = [given.landmark_names[j] for j in np.flatnonzero(~given.seen().any(axis=0))]
    if never:
        found = f"no image shows {', '.join(never[:3])}"
        raise input_error(place, found, "leave out landmarks that are never seen")


def images_of(given: LandmarkSet) -> Images:
    """Bring the landmarks of each sequence, or of each image without one, to the size 1.

    Of an image, landmarks that lie far out do not count, as gross ones do.
    """
    w, seen = given.landmarks, given.seen()
    middle = np.nanmedian(np.where(seen[:, None], w, np.nan), axis=2, keepdims=True)
    apart = np.where(seen, np.linalg.norm(w - middle, axis=1), np.nan)
    reach = FAR_OUT * np.nanmedian(apart, axis=1, keepdims=True)
    near = seen & ((apart <= reach) | (reach == 0))
    normalised = normalise(w, near)
    size = normalised.scale
    sequence = np.zeros(len(given), np.intp)
    if given.sequences is not None:
        sequence = np.unique(np.array(given.sequences, dtype=str), return_inverse=True)[1]
        squares = np.bincount(sequence, size**2) / np.bincount(sequence)
        size = np.sqrt(squares)[sequence]
    placed = np.where(seen[:, None], w - normalised.centroid[..., None], 0.0)
    return Images(placed / size[:, None, None], given.weights(), sequence)


def flipped(shapes: Floats, flip: bool | None) -> Floats:
    """Return shapes (n, 3, p), near and far exchanged where asked for."""
    return shapes * np.array([1.0, 1.0, -1.0 if flip else 1.0])[:, None]


def gaussian_prior(learned: Learned, mean: Floats) -> dict[str, Any]:
    """Return what was learned as `prior` of normalised shapes, turned onto their mean (3, p).

    `misfit` is the variance of what it cannot place. The size of a shape is the image's to find,
    so that the covariance has no part along the mean.
    """
    model = learned.state.model
    d = model.mean.size
    scale = float(normalise(model.mean).scale)
    # where the shapes were flipped, so is their mean
    mirror = np.diag([1.0, 1.0, -1.0 if learned.flip else 1.0])
    turn = rotation_onto(mirror @ model.mean, mean) @ mirror
    mu = (turn @ model.mean) / scale
    unit = mu.ravel() / np.linalg.norm(mu)
    Q = (np.eye(d) - np.outer(unit, unit)) @ np.kron(turn, np.eye(d // 3)) / scale
    C = Q @ model.covariance @ Q.T + 1e-9 * np.eye(d)
    prior = Mixture(np.ones(1), mu[None], (C + C.T)[None] / 2)
    return {"prior": prior, "misfit": np.array([max(model.noise / scale**2, LEAST_MISFIT)])}


def find_doubts(found: Judgement, sided: bool) -> Iterator[str]:
    """Say what may be wrong with shapes that were learned; sided: near and far are known."""
    if found.verdict == DOUBTFUL:
        yield (
            f"depth is doubtful: each half of the images by itself gives shapes {found.apart:.2f} "
            "of their size apart, which is much of what shapes differ: give poses from more sides"
        )
    if not sided:
        yield MIRRORED


def report(found: Judgement, size: float) -> str:
    """Say how well hidden landmarks were predicted, and what the views are worth.

    size of a shape in the unit of the landmarks, pixels as a rule.
    """
    return (
        f"hidden landmarks predicted to {size * found.learned:.3g} in the unit of the landmarks, "
        f"{found.learned:.3f} of the size of a shape (rigid "
        f"{found.rigid:.3f}, flat {found.flat:.3f}), evidence of depth {found.gain:.2f} per "
        f"landmark, views up to {found.turn:.0f} degrees apart, each half of the images by itself "
        f"{found.apart:.3f} off"
    )


MIRRORED = (
    "near and far cannot be distinguished in 2D landmarks alone, and no image that is lifted is "
    "trusted before they are: look at some shapes, and learn again with `flip=true` if near is "
    "far, `flip=false` if it is not"
)
SURE = 5.0
"""Standard errors of the evidence beyond which perspective decides what is near."""


def decide_what_is_near(learned: Learned, made: Dictionary) -> Generator[Outcome, None, Dictionary]:
    """Return the dictionary, or its mirror image where the known cameras see that one.

    Its provenance says what has decided; the key `flip` goes before cameras.
    """
    if learned.flip is not None:
        return with_near_and_far(made, "stated by `flip`")
    if CAMERA_MATRIX not in learned.given.columns:
        return with_near_and_far(made, OPEN)
    gain, deviation = evidence_of_mirror(learned.given, made)
    if abs(gain) < SURE * deviation:
        yield Outcome(warnings=(MIRRORED,))
        return with_near_and_far(made, OPEN)
    done = "exchanged" if gain > 0 else "kept"
    yield Outcome(
        line=f"perspective: near and far {done}, log evidence {abs(gain):.2f} +- {deviation:.2f} "
        "an image"
    )
    return with_near_and_far(mirror_image(made) if gain > 0 else made, "told by perspective")


def with_near_and_far(made: Dictionary, told: str) -> Dictionary:
    """Return the dictionary with what told near from far in its provenance."""
    return replace(made, provenance={**made.provenance, NEAR_AND_FAR: told})


def mirror_image(made: Dictionary) -> Dictionary:
    """Return the dictionary with near and far exchanged."""
    z = np.array([1.0, 1.0, -1.0])[:, None]
    sign = np.repeat(z, made.mean_shape.shape[1])
    prior = made.prior
    assert prior is not None, "learned from landmarks"
    mirrored = Mixture(prior.weights, z * prior.means, np.outer(sign, sign) * prior.covariances)
    return replace(made, atoms=z * made.atoms, mean_shape=z * made.mean_shape, prior=mirrored)


MIXTURES = 4
"""Rounds of learning a mixture at most."""

IMAGES_PER_COMPONENT, MOST_COMPONENTS = 150, 32

CLOSE = 1.1
"""Factor of the Gaussian's error up to which a mixture of several is kept.

They say little of depth, of which a mixture that is as good in the image knows more.
"""

LARGER = 2.0
"""Factor of size from one round to the next beyond which an image was misread."""

QUICK = 3
"""Rounds of learning atoms that only have to find views."""

Make = Callable[[ShapeSet, int, int, bool], Generator[Outcome, None, Dictionary]]
"""Makes a dictionary of shapes, with so many components of its prior, in so many rounds; whether
the prior is one of varied bodies."""


def relift(
    learned: Learned, make: Make, components: int, iterations: int, varied: bool
) -> Generator[Outcome, None, Dictionary]:
    """Learn mixtures of the shapes that the prior before lifted, while they predict better.

    components of the mixtures, 0 for as many as the images allow; iterations for the atoms. The
    last prior, if any, is `varied`: it is to lift other bodies, those before to lift these.
    """
    images, shapes = learned.images, learned.shapes
    method = "posterior" if images.sequences is None else "sequences"
    number = components or int(np.clip(len(images) // IMAGES_PER_COMPONENT, 1, MOST_COMPONENTS))
    made = yield from make(shapes, 0, QUICK, False)
    best = replace(made, **gaussian_prior(learned, made.mean_shape))
    error = predict_hidden(images, best).error
    of_best = shapes
    for _ in range(MIXTURES):
        mixed = yield from make(shapes, number, QUICK, False)
        found = predict_hidden(images, mixed).error
        gaussian = best.misfit is not None
        kept = found < (CLOSE * error if gaussian and number > 1 else error)
        yield Outcome(
            line=f"prior of {counted(number, 'component')}: hidden landmarks {found:.4f} off, "
            f"{error:.4f} before; {'kept' if kept else 'left out'}"
        )
        if not kept:  # no round after such a one was ever better, and some were read wrongly
            break
        best, error, of_best = mixed, found, shapes
        lifted = lift_by(images, mixed, method).shapes
        grown = np.linalg.norm(lifted, axis=(1, 2)) / np.linalg.norm(shapes.shapes, axis=(1, 2))
        fine = (grown > 1 / LARGER) & (grown < LARGER)  # not so where it is nan
        shapes = shapes.replaced(shapes=np.where(fine[:, None, None], lifted, shapes.shapes))
    made = yield from make(of_best, number if varied else 0, iterations, varied)
    verdict = "doubtful" if learned.judgement.verdict == DOUBTFUL else "learned"
    provenance = {**made.provenance, LEARNED_FROM: "landmarks", VERDICT: verdict}
    if varied:
        return replace(made, provenance=provenance)
    return replace(made, prior=best.prior, misfit=best.misfit, provenance=provenance)

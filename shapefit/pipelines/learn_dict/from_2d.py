"""A dictionary of 2D landmarks: shapes are lifted by what images share, then learned from.

Or the prior of a dictionary is adapted to the landmarks. Either way landmarks that are hidden from
the fit judge what was learned.
"""

from __future__ import annotations

import json
from collections.abc import Generator, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shapefit import __version__
from shapefit.arrays import Floats
from shapefit.config import FitConfig, LearnDictConfig
from shapefit.config.commands.fit_sections import ViewingConfig
from shapefit.dictionary.from_2d.adaptation import Start, adapt
from shapefit.dictionary.from_2d.judgement import ALIKE, DOUBTFUL, UNLIKE, Judgement, judge
from shapefit.dictionary.from_2d.learning import State, learn
from shapefit.dictionary.from_2d.model import Images, evenly, hide
from shapefit.dictionary.left_out import AS_LEARNED
from shapefit.dictionary.mixture import Mixture
from shapefit.dictionary.model import LEARNED_FROM, NEAR_AND_FAR, OPEN, VERDICT, Dictionary
from shapefit.errors import InputError, counted, input_error
from shapefit.geometry.normalisation import normalise, spread
from shapefit.geometry.pinhole import CAMERA_MATRIX
from shapefit.geometry.procrustes import rotation_onto
from shapefit.io import LandmarkSet, LandmarkSource, ShapeSet, digests, read_dictionary
from shapefit.io.layout import EDGES
from shapefit.io.records import concatenate
from shapefit.io.skeletons import part_names
from shapefit.lifting.lift import Lifting
from shapefit.lifting.methods import PosteriorOptions
from shapefit.pipelines.fit.camera import read_intrinsics
from shapefit.pipelines.fit.checks import mean_gain
from shapefit.pipelines.fit.lift import check_needs, find_residual_variance, lift_landmarks
from shapefit.pipelines.fit.prepare import set_up
from shapefit.pipelines.fit.run import read_images
from shapefit.pipelines.learn_dict.from_3d import Learning, learn_from_shapes
from shapefit.pipelines.learn_dict.training_shapes import place_of
from shapefit.pipelines.outcome import Outcome

FEWEST_IMAGES = 20
"""Images from which depth can be learned at all."""

FEWEST_SEEN = 4
"""Landmarks that an image must show: any three fit any shape."""

FAR_OUT = 4.0
"""Medians of the distance from the middle of an image up to which landmarks count for its size."""

LEAST_MISFIT = 1e-4
"""Variance of a normalised coordinate: where less is believed, a landmark a little off is gross."""

SAMPLE = 500
"""Images by which dictionaries are compared."""

MIXTURES, IMAGES_PER_COMPONENT, MOST_COMPONENTS = 4, 150, 32
"""Rounds of learning a mixture at most, and its components."""

CLOSE = 1.1
"""Factor of the Gaussian's error of hidden landmarks up to which a mixture is kept in its place.

They say little of depth, of which a mixture that is as good in the image knows more.
"""

LARGER = 2.0
"""Factor of size from one round to the next beyond which an image was misread."""

QUICK = 3
"""Rounds of learning atoms that only have to find views."""

SURE = 5.0
"""Standard errors of the evidence beyond which perspective decides what is near."""

BENT = 0.3
"""Share of the bends of knees and elbows, less that of the others, that tells near from far.

In 84 sequences of eight bodies it is 0.42 and more.
"""

FIX = {
    ALIKE: "give images from more sides: the camera or the body must turn, and not be flat",
    UNLIKE: "give images of one class, whose landmarks are in the same order in all of them",
}
"""What to do about each verdict with which nothing is learned."""

MIRRORED = (
    "near and far cannot be distinguished in 2D landmarks alone, and no image that is lifted is "
    "trusted before they are: look at some shapes, and learn again with `flip=true` if near is "
    "far, `flip=false` if it is not"
)

PARTS = 5
"""Parts of the images, whole sequences where there are some, one of which judges an adaptation."""

LEAST_GAIN = 0.01
"""Log density of a hidden landmark that adaptation must bring, beyond its standard error."""

BELIEVED = 0.5
"""Chance that a landmark is not gross, as the start has it, below which it is hidden."""


def learn_from_landmarks(source: LandmarkSource, config: LearnDictConfig) -> Learning:
    """Lift the images by what they have in common, and learn a dictionary from the shapes.

    A mixture over shapes takes the place of the Gaussian that lifted them while it predicts hidden
    landmarks; at last near is told from far. Raises InputError with the verdict where depth cannot
    be learned from the images.
    """
    place, inputs = place_of(config), digests(config.shapes)
    given = concatenate(list(source.batches(4096))) if source.count else None
    some = None if given is None else given.take(are_usable(given))
    if some is None or len(some) < FEWEST_IMAGES:
        raise too_few(0 if some is None else len(some), source.count, place)
    never = [some.landmark_names[j] for j in np.flatnonzero(~some.seen().any(axis=0))]
    if never:
        found = f"no image shows {', '.join(never[:3])}"
        raise input_error(place, found, "leave out landmarks that are never seen")

    images = images_of(some)
    state = None
    for state in learn(images):
        per = state.objective / (2 * int((images.weights > 0).sum()))
        yield Outcome(done=1, unit="round", note=f"evidence {per:.3f} a coordinate")
    assert state is not None
    judgement = judge(images, state)
    size = float(np.median(spread(some.landmarks, some.seen())))
    said = describe(judgement, size)
    if not judgement.fine:
        raise input_error(place, f"{judgement.verdict} ({said})", FIX[judgement.verdict])
    bend = find_bend(state.in_camera, some.landmark_names)
    sided = config.flip is not None or CAMERA_MATRIX in some.columns or abs(bend) > BENT
    gross = f"{int(state.gross.sum())} of {counted(int(some.seen().sum()), 'landmark')}"
    yield Outcome(
        line=f"{counted(len(some), 'image')}: {judgement.verdict}; {said}; {gross} gross and "
        "set aside",
        warnings=tuple(find_doubts(judgement, sided)),
    )

    # Gross landmarks stay: a mixture may believe them, and sets aside those that it does not.
    unit = some.replaced(landmarks=np.where(some.seen()[:, None], images.landmarks, np.nan))
    shapes = ShapeSet(
        shapes=state.in_camera * np.array([1.0, 1.0, -1.0 if config.flip else 1.0])[:, None],
        landmark_names=some.landmark_names,
        items=some.items,
        sequences=some.sequences,
        frame_rate=some.frame_rate,
        edges=some.columns.get(EDGES),
    )
    made = yield from learn_mixtures(unit, shapes, state, config, inputs)
    verdict = "doubtful" if judgement.verdict == DOUBTFUL else "learned"
    known = {LEARNED_FROM: "landmarks", VERDICT: verdict}
    made = replace(made, provenance={**made.provenance, **known})
    return (yield from decide_near_and_far(some, made, config.flip, bend))


def are_usable(given: LandmarkSet) -> NDArray[np.bool_]:
    """Whether each image (n,) shows enough landmarks, and not all at one point."""
    seen = given.seen()
    apart: NDArray[np.bool_] = spread(np.where(seen[:, None], given.landmarks, 0.0), seen) > 0
    return apart & (seen.sum(axis=1) >= FEWEST_SEEN)


def too_few(usable: int, given: int, place: str) -> InputError:
    """Return the error that says that these images are not enough."""
    found = f"too few images: {usable} of {given} show {FEWEST_SEEN} landmarks or more"
    return input_error(place, found, f"give {FEWEST_IMAGES} at least, of different views")


def images_of(given: LandmarkSet) -> Images:
    """Bring the landmarks of each sequence, or of each image without one, to the size 1.

    Landmarks that lie far out do not count for the size, as gross ones do not.
    """
    w, seen = given.landmarks, given.seen()
    middle = np.nanmedian(np.where(seen[:, None], w, np.nan), axis=2, keepdims=True)
    apart = np.where(seen, np.linalg.norm(w - middle, axis=1), np.nan)
    reach = FAR_OUT * np.nanmedian(apart, axis=1, keepdims=True)
    normalised = normalise(w, seen & ((apart <= reach) | (reach == 0)))
    size = normalised.scale
    sequence = np.zeros(len(given), np.intp)
    if given.sequences is not None:
        sequence = np.unique(np.array(given.sequences, dtype=str), return_inverse=True)[1]
        squares = np.bincount(sequence, size**2) / np.bincount(sequence)
        size = np.sqrt(squares)[sequence]
    placed = np.where(seen[:, None], w - normalised.centroid[..., None], 0.0)
    return Images(placed / size[:, None, None], given.weights(), sequence)


def describe(found: Judgement, size: float) -> str:
    """Say how well hidden landmarks are predicted, and how much the views vary.

    size of a shape in the unit of the landmarks, pixels as a rule.
    """
    return (
        f"hidden landmarks predicted to {size * found.learned:.3g} in the unit of the landmarks, "
        f"{found.learned:.3f} of the size of a shape (rigid "
        f"{found.rigid:.3f}, flat {found.flat:.3f}), evidence of depth {found.gain:.2f} per "
        f"landmark, views up to {found.turn:.0f} degrees apart, each half of the images by itself "
        f"{found.apart:.3f} off"
    )


def find_doubts(found: Judgement, sided: bool) -> Iterator[str]:
    """Say what may be wrong with shapes that were learned; sided: near and far are known."""
    if found.verdict == DOUBTFUL:
        yield (
            f"depth is doubtful: each half of the images by itself gives shapes {found.apart:.2f} "
            "of their size apart, which is much of what shapes differ: give poses from more sides"
        )
    if not sided:
        yield MIRRORED


def learn_mixtures(
    images: LandmarkSet,
    shapes: ShapeSet,
    state: State,
    config: LearnDictConfig,
    inputs: dict[str, str],
) -> Learning:
    """Learn mixtures over the shapes that the prior before lifted, while they predict better.

    images and their shapes, as `state` has them; the prior of the dictionary is the best one, or,
    where bodies are to vary, one of varied shapes. Hidden landmarks judge how sure it is, and
    shapes that were lifted, and not measured, say nothing of it.
    """

    def learned(shapes: ShapeSet, components: int, rounds: int, *, varied: bool) -> Learning:
        still = {} if varied else {"stretch": 0.0, "exchange": 0.0}
        open_keys = (key for key in AS_LEARNED._fields if getattr(config.prior, key) is None)
        sure = {key: getattr(AS_LEARNED, key) for key in open_keys}
        prior = {"components": components, **sure, **still}
        changed = config.changed(prior=prior, iterations=rounds)
        return learn_from_shapes(shapes, changed, inputs)

    method = "posterior" if images.sequences is None else "sequences"
    most = int(np.clip(len(images) // IMAGES_PER_COMPONENT, 1, MOST_COMPONENTS))
    number = config.prior.components or most
    made = yield from learned(shapes, 0, QUICK, varied=False)
    best = replace(made, **gaussian_prior(state, made.mean_shape, flipped=bool(config.flip)))
    error = predict_hidden(images, best).error
    best_shapes = shapes
    for _ in range(MIXTURES):
        mixed = yield from learned(shapes, number, QUICK, varied=False)
        found = predict_hidden(images, mixed).error
        gaussian = best.residual_variance is not None
        kept = found < (CLOSE * error if gaussian and number > 1 else error)
        yield Outcome(
            line=f"prior of {counted(number, 'component')}: hidden landmarks {found:.4f} off, "
            f"{error:.4f} before; {'kept' if kept else 'left out'}"
        )
        if not kept:  # no round after such a one was ever better, and some were read wrongly
            break
        best, error, best_shapes = mixed, found, shapes
        lifted = lift_by(images, mixed, method).shapes
        grown = np.linalg.norm(lifted, axis=(1, 2)) / np.linalg.norm(shapes.shapes, axis=(1, 2))
        fine = (grown > 1 / LARGER) & (grown < LARGER)  # not so where it is nan
        shapes = shapes.replaced(shapes=np.where(fine[:, None, None], lifted, shapes.shapes))
    if config.prior.stretch or config.prior.exchange:
        return (yield from learned(best_shapes, number, config.iterations, varied=True))
    made = yield from learned(best_shapes, 0, config.iterations, varied=False)
    return replace(made, prior=best.prior, residual_variance=best.residual_variance)


def gaussian_prior(state: State, mean: Floats, *, flipped: bool) -> dict[str, Any]:
    """Return what was learned as `prior` of normalised shapes, turned onto their mean (3, p).

    `residual_variance` is the variance of what it cannot place. The size of a shape is the
    image's to find, so that the covariance has no part along the mean.
    """
    model = state.model
    d = model.mean.size
    scale = float(normalise(model.mean).scale)
    mirror = np.diag([1.0, 1.0, -1.0 if flipped else 1.0])  # the shapes were flipped alike
    turn = rotation_onto(mirror @ model.mean, mean) @ mirror
    mu = (turn @ model.mean) / scale
    unit = mu.ravel() / np.linalg.norm(mu)
    Q = (np.eye(d) - np.outer(unit, unit)) @ np.kron(turn, np.eye(d // 3)) / scale
    C = Q @ model.covariance @ Q.T + 1e-9 * np.eye(d)
    prior = Mixture(np.ones(1), mu[None], (C + C.T)[None] / 2)
    return {
        "prior": prior,
        "residual_variance": np.array([max(model.noise / scale**2, LEAST_MISFIT)]),
    }


def decide_near_and_far(
    images: LandmarkSet, made: Dictionary, flip: bool | None, bend: float
) -> Generator[Outcome, None, Dictionary]:
    """Return the dictionary, or its mirror image where cameras see, or limbs bend like, that one.

    Its provenance says what has decided; the key `flip` goes before cameras, and these before
    limbs, see `find_bend`.
    """
    told = OPEN if flip is None else "stated by `flip`"
    if flip is None and CAMERA_MATRIX in images.columns:
        gain, deviation = evidence_of_mirror(images, made)
        if abs(gain) >= SURE * deviation:
            told = "told by perspective"
            made = mirror_image(made) if gain > 0 else made
            yield Outcome(
                line=f"perspective: near and far {'exchanged' if gain > 0 else 'kept'}, log "
                f"evidence {abs(gain):.2f} +- {deviation:.2f} an image"
            )
    if told == OPEN and abs(bend) > BENT:
        told = "told by knees and elbows"
        made = mirror_image(made) if bend < 0 else made
        yield Outcome(
            line=f"knees and elbows: near and far {'exchanged' if bend < 0 else 'kept'}, "
            f"{50 + 50 * abs(bend):.0f}% of what they bend is then the way that they can"
        )
    elif told == OPEN and CAMERA_MATRIX in images.columns:
        yield Outcome(warnings=(MIRRORED,))
    return replace(made, provenance={**made.provenance, NEAR_AND_FAR: told})


def find_bend(shapes: Floats, names: Sequence[str]) -> float:
    """Return how far knees of shapes (n, 3, p) bend forwards and elbows backwards, from -1 to 1.

        sum_t,limbs +-b f / sum_t,limbs |b f|

    for the vector b from the line of a limb's ends to its joint, and the direction f that the body
    faces: from right to left times from hips to shoulders. The mirror image of a body has the
    opposite sign. 0 where hips, shoulders, and the ends of a limb do not all have known names.
    """
    place = {part: names.index(name) for name, part in part_names(names).items()}
    at = {part: shapes[..., j] for part, j in place.items()}
    if not {f"{side}{part}" for side in "rl" for part in ("hip", "shoulder")} <= at.keys():
        return 0.0
    left = at["lhip"] - at["rhip"] + at["lshoulder"] - at["rshoulder"]
    up = at["lshoulder"] + at["rshoulder"] - at["lhip"] - at["rhip"]
    forward = np.cross(left, up)
    forward /= np.maximum(np.linalg.norm(forward, axis=1, keepdims=True), 1e-12)
    bends = [np.zeros(len(shapes))]
    for limb, sign in (("hip knee ankle", 1), ("shoulder elbow wrist", -1)):
        for side in "rl":
            ends = [side + part for part in limb.split()]
            if set(ends) <= at.keys():
                start, joint, stop = (at[end] for end in ends)
                along = stop - start
                share = ((joint - start) * along).sum(axis=1) / (along**2).sum(axis=1)
                off = joint - start - share[:, None] * along
                bends.append(sign * (off * forward).sum(axis=1))
    size = np.abs(bends).sum()
    return float(np.sum(bends) / size) if size > 0 else 0.0


def mirror_image(made: Dictionary) -> Dictionary:
    """Return the dictionary with near and far exchanged."""
    z = np.array([1.0, 1.0, -1.0])[:, None]
    sign = np.repeat(z, made.mean_shape.shape[1])
    prior = made.prior
    assert prior is not None, "learned from landmarks"
    mirrored = Mixture(prior.weights, z * prior.means, np.outer(sign, sign) * prior.covariances)
    return replace(made, atoms=z * made.atoms, mean_shape=z * made.mean_shape, prior=mirrored)


def evidence_of_mirror(images: LandmarkSet, dictionary: Dictionary) -> tuple[float, float]:
    """Log evidence an image that the class is mirrored, as the cameras see it; standard error.

    The mirror image of a class is seen as the class is in mirrored images.
    """
    some = images.take(evenly(len(images), SAMPLE))
    middle = read_intrinsics(some, CAMERA_MATRIX)[1][:, :1]
    w = some.landmarks.copy()
    w[:, 0] = 2 * middle - w[:, 0]
    kept, mirrored = (
        lift_by(each, dictionary, "posterior", CAMERA_MATRIX).estimate.further["log_evidence"]
        for each in (some, some.replaced(landmarks=w))
    )
    return mean_gain(kept, mirrored)[:2]


def adapt_to_landmarks(source: LandmarkSource, config: LearnDictConfig) -> Learning:
    """Adapt the prior of `start` to the images; all else of the dictionary stays as it is.

    The start counts as many images as there are. What is learned from four fifths of them must
    predict the landmarks of the rest better than the start does. Raises InputError where it does
    not.
    """
    assert config.start is not None
    place, inputs = place_of(config), digests((*config.shapes, config.start))
    fit = FitConfig.model_construct(
        landmarks=config.shapes, dictionary=config.start, output=config.output, method="posterior"
    )
    setup = set_up(fit, read_dictionary(config.start), source.head.landmark_names)
    start, joints, seen_start = setup.dictionary, setup.mapped, setup.seen
    assert start.prior is not None, "set_up needs one"
    prior = start.prior
    A = joints.joints.matrix(joints.theta) if joints.active else np.eye(len(start.landmark_names))

    given = concatenate(list(read_images(source, setup)))
    some = given.take(are_usable(given))
    found = lift_by(some, seen_start, "posterior") if len(some) else None
    lifted = np.zeros(0, bool) if found is None else np.isfinite(found.shapes).all(axis=(1, 2))
    if found is None or lifted.sum() < FEWEST_IMAGES:
        raise too_few(int(lifted.sum()), source.count, place)
    seen = np.nan_to_num(found.estimate.further["inlier_probability"]) > BELIEVED
    some = some.replaced(landmarks=np.where(seen[:, None], some.landmarks, np.nan))
    fine = np.flatnonzero(lifted & are_usable(some))
    some, shapes = some.take(fine), found.shapes[fine]

    def adapted(rows: NDArray[np.bool_]) -> Learning:
        part = some.take(rows)
        images = images_of(part.replaced(sequences=None))
        size = spread(part.landmarks, part.seen())[:, None, None]
        noise = find_residual_variance(fit, start)
        of_start = Start(prior=prior, landmark_map=A, noise=noise, weight=len(part))
        made = prior
        for mixture, objective in adapt(images, shapes[rows] / size, of_start):
            made = mixture
            per = objective / (2 * int((images.weights > 0).sum()))
            yield Outcome(done=1, unit="round", note=f"objective {per:.3f} a coordinate")
        return replace(start, prior=made)

    out = first_part(some)
    judged = some.take(out)
    trial = yield from adapted(~out)
    before, after = predict_hidden(judged, seen_start), predict_hidden(judged, joints.apply(trial))
    gain = after.log_density - before.log_density
    gain = gain[np.isfinite(gain)]
    deviation = gain.std() / np.sqrt(len(gain)) if len(gain) else np.nan
    said = (
        f"hidden landmarks of {counted(len(judged), 'image')} left out predicted to "
        f"{after.error:.4f} of the size of an image, {before.error:.4f} by the start, log density "
        f"{gain.mean():+.3f} +- {deviation:.3f}"
    )
    if not gain.mean() > deviation + LEAST_GAIN:
        fix = "take the start as it is, or give more images"
        why = "the log density of hidden landmarks, which decides, is no better than by the start"
        raise input_error(place, f"{why}: {said}", fix)
    whole = yield from adapted(np.ones(len(some), bool))
    yield Outcome(line=f"{counted(len(some), 'image')}: adapted; {said}")
    provenance = {
        **start.provenance,
        "version": __version__,
        "config": config.as_json(),
        "inputs": json.dumps(inputs),
    }
    return replace(whole, provenance=provenance)


def first_part(images: LandmarkSet) -> NDArray[np.bool_]:
    """Choose every fifth sequence (n,), or the first fifth of the images without several."""
    n, sequences = len(images), images.sequences
    if sequences is None or len(set(sequences)) < 2:
        return np.arange(n) * PARTS // n == 0
    number = {name: i for i, name in enumerate(dict.fromkeys(sequences))}
    return np.array([number[name] % PARTS == 0 for name in sequences])


@dataclass(frozen=True)
class Predicted:
    """Median distance of hidden landmarks from where they are, in the size of their image.

    log_density (n,) of them, the mean of each image, nan where none was hidden or predicted.
    """

    error: float
    log_density: Floats


def predict_hidden(images: LandmarkSet, dictionary: Dictionary) -> Predicted:
    """Hide a tenth of the landmarks of a sample of the images, each by itself, and predict them.

    Their density is that of `method: posterior`: normal, or, of gross ones, even.
    """
    some = images.take(evenly(len(images), SAMPLE))
    seen = some.seen()
    hidden = hide(seen)
    known = some.replaced(landmarks=np.where(hidden[:, None], np.nan, some.landmarks))
    found = lift_by(known, dictionary, "posterior")
    deviation = found.estimate.deviation
    assert deviation is not None, "a posterior has deviations"
    size = spread(some.landmarks, seen)[:, None]
    apart = (found.shapes[:, :2] - some.landmarks) / size[..., None]
    options, residual_variance = (
        PosteriorOptions(),
        find_residual_variance(_fit_config("posterior"), dictionary),
    )
    variance = (
        found.scale[:, None, None] / size[..., None] * deviation[:, :2]
    ) ** 2 + residual_variance
    normal = np.exp(-0.5 * (apart**2 / variance).sum(axis=1)) / (
        2 * np.pi * np.sqrt(variance.prod(axis=1))
    )
    chance = options.outlier_rate
    density = np.log((1 - chance) * normal + chance * options.gross_density)
    predicted = hidden & np.isfinite(density)
    count = predicted.sum(axis=1)
    total = np.where(predicted, density, 0.0).sum(axis=1)
    return Predicted(
        error=float(np.nanmedian(np.linalg.norm(apart, axis=1)[hidden])),
        log_density=np.where(count > 0, total / np.maximum(count, 1), np.nan),
    )


def lift_by(
    images: LandmarkSet, dictionary: Dictionary, method: str, camera: str | None = None
) -> Lifting:
    """Lift images as `fit` does with its defaults; they have the landmarks of the dictionary.

    camera names the dataset of their camera matrices, None for weak perspective.
    """
    config = _fit_config(method, camera)
    check_needs(config, dictionary)
    return lift_landmarks(images, dictionary, config)


def _fit_config(method: str, camera: str | None = None) -> FitConfig:
    viewing = ViewingConfig(model="perspective", intrinsics=camera) if camera else ViewingConfig()
    return FitConfig.model_construct(
        landmarks=(Path("landmarks"),),
        dictionary=Path("dictionary"),
        output=Path("result.h5"),
        method=method,
        camera=viewing,
    )

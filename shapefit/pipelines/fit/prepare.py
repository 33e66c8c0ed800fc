"""What a fit needs before it lifts, found once and given to all its parts.

The landmarks are matched to the dictionary, the camera is chosen, and of one sample of
the first images is estimated what is open. There the log evidence log p(w) of an image
under the posterior is compared for the skeleton theta of a detector of people, and for
factors f on the covariances of the prior and residual variances v:

    1/n sum_i log p(w_i | f, v),    f in {1, 2, 4, 8},  v in {v_0, 2 v_0, 4 v_0, 8 v_0},

where v_0 is that of the dictionary. Smaller ones are not tried: their evidence is flat
where error bars are far too narrow already. Of pairs that are as likely as the best by
the standard error of their difference, the widest prior is taken and, with it, the
least v.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from shapefit.arrays import Flags, Floats, evenly, median
from shapefit.config import FitConfig
from shapefit.config.paths import STANDARD_STREAM, ResultFolder
from shapefit.dictionary.model import LEARNED_FROM, Dictionary, describe_learning
from shapefit.errors import InputError, counted, input_error, parse_json
from shapefit.io import open_landmarks
from shapefit.io.formats import find_target_format
from shapefit.io.options import InputOptions, input_options
from shapefit.io.skeletons import THETA, installed_skeletons
from shapefit.lifting import trust
from shapefit.lifting.lift import Lifting
from shapefit.lifting.methods import AUTO, METHODS, find_conflict
from shapefit.pipelines.fit.aspect import describe_stretch, find_stretch, narrow
from shapefit.pipelines.fit.camera import choose_camera, say_outside, undistorted
from shapefit.pipelines.fit.lift import (
    Lifter,
    check_needs,
    check_omitted,
    lift_images,
    lifter_of,
    settings_of,
    weigh,
    with_p_values,
)
from shapefit.pipelines.joints import MEANS, Matched, match_names
from shapefit.pipelines.result import Result
from shapefit.records import Landmarks
from shapefit.timeline import ASSUMED_RATE

if TYPE_CHECKING:
    from shapefit.io.readers.calibration import CalibratedCamera
    from shapefit.lifting.posterior.usual_lengths import LimbLengths

FIRST = 1024
"""Images of which the sample is drawn: the same whatever the chunks and parts."""

FRAMES, COUNTED = 10, 4096
"""Frames of a sequence whose motion says something of its shapes; images that are
counted.
"""

LONG, TIMED = 60.0, 8
"""Seconds of a fit from which it is announced; images that are timed."""

POSTERIOR = 2e-10
"""Seconds of a core for an image, times p^3.5 (10 + components): p^3 operations, in
more memory. Measured on a Xeon with AVX-512: 0.3 to 1.6 of it for 30 to 240 landmarks,
1 to 32 components.
"""

OF_PEOPLE: Mapping[str, Mapping[str, float]] = {
    "posterior": {"residual_variance": 0.006, "bar_scale": 1.6},
    "sequences": {"residual_variance": 0.01, "bar_scale": 1.5},
}
"""Keys of `prior` for every dictionary that knows the usual lengths of limbs of people,
where they are not given.
"""

LARGEST, CALIBRATED, FEW, FEWEST = 96, 60, 24, 10
"""Images of a sample, of those with landmarks hidden in turn, of a first look, and the
least.
"""

FEWEST_VISIBLE, FEWEST_NAMES = 5, 4
"""Landmarks of an image of the sample (four fit almost any shape), and that names must
give.
"""

STEP = 0.5
"""Seconds between the two images of a pair."""

STEPS = (-0.2, -0.1, 0.0, 0.1, 0.2)
"""Of the logarithm of a parameter, tried about its mean, and half of them about the
best.
"""

SCALES, FACTORS = ("scale", "residual_variance"), (1.0, 2.0, 4.0, 8.0)
"""Keys of `prior` that are chosen by evidence, and the factors that are tried of
either.
"""

OUTLIER, MOSTLY = 0.5, 0.5
"""Inlier probability of an outlier; share of images from which a landmark itself is
doubted.
"""

DOUBTFUL = 0.25
"""Share of doubtful images from which other skeletons are tried; one that has less than
half of that share is named. Where names are right a few images in a hundred are
doubtful.
"""

FLAT = 0.01
"""Of the extent of shapes, their thickness below which they are flat."""

ATOMS = 0.05, 20.0
"""Norms of atoms from which on lambda means something else: in 1, and in that of
normalised shapes.
"""

NO_TRUST = "no shape of this file is to be trusted: "

KAPPA, DISTANCE = "calibration_kappa", "median_start_distance"
"""Numbers of the calibration that are stored as attributes."""

Pair = tuple[float, float]


class Estimates(NamedTuple):
    """What was estimated: values for keys of a config, lines about them, the camera's
    first.

    reason says why no image is to be trusted; growth (p,) are factors on covariances of
    landmarks; shown (p,), which of them most images show, empty if unknown.
    """

    values: Mapping[str, Any]
    lines: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    reason: str = ""
    growth: tuple[float, ...] = ()
    shown: tuple[bool, ...] = ()
    numbers: Mapping[str, float] = {}


class Setup(NamedTuple):
    """A fit in which nothing is left open: config with estimates, theta, skeleton of
    the detector.

    dictionary is the one that the files need; place is that of landmark names in
    messages.
    """

    config: FitConfig
    matched: Matched
    lifter: Lifter
    theta: Mapping[str, float]
    camera: CalibratedCamera | None
    estimates: Estimates
    place: str

    @property
    def dictionary(self) -> Dictionary:
        """The dictionary as the files need it."""
        return self.matched.dictionary

    def arrange(self, images: Landmarks) -> Landmarks:
        """Return images of the files without distortion, with the landmarks of the
        dictionary.
        """
        return self.matched.arrange(undistorted(images, self.camera), self.place)


Preparing = Generator[Result, None, Setup]
"""Yields what is to be shown before the first image is lifted, and returns the setup.
"""


def prepare(
    config: FitConfig,
    dictionary: Dictionary,
    landmark_names: Sequence[str],
    first: Callable[[], Landmarks],
    total: int,
    estimates: Estimates | None = None,
) -> Preparing:
    """Make what lifts a total of images with these landmarks; `first` gives those of
    the sample.
    """
    method, camera = METHODS[config.method], None
    if method.has_prior and dictionary.p_value_table is None:
        from shapefit.lifting.posterior.p_value import with_p_value_table

        dictionary = with_p_value_table(dictionary)  # not learned by this version
    place = ", ".join(map(str, config.landmarks)) + ": landmark names"
    matched = match_names(landmark_names, dictionary, place, in_place=method.has_prior)
    check_needs(config.method, matched.dictionary, config.dictionary)
    if config.camera.calibration is not None:
        from shapefit.io.readers.calibration import read_camera

        camera = read_camera(config.camera.calibration, config.camera.name)
    if estimates is None:
        images = undistorted(first(), camera)
        lifter = lifter_of(config, matched.dictionary)
        if config.leave_one_out is not None:
            check_omitted(images, lifter)
        if text := announce_time(matched.arrange(images, place), lifter, total):
            yield Result(line=text)
        estimates = estimate(config, dictionary, matched, images)
    config = config.changed(**estimates.values)
    theta = {**MEANS, **(config.skeleton or {})}
    lifter = lifter_of(config, matched.observed(theta))
    # with a prior covariances serve the expected error, and the error bars of joints
    wanted = lifter.posterior.covariance or method.has_prior
    options = replace(
        lifter.posterior, growth=tuple(estimates.growth), covariance=wanted
    )
    if method.has_prior:
        options = replace(options, limbs=limbs_of(lifter.dictionary))
    shown = np.array(estimates.shown, dtype=bool) if estimates.shown else None
    lifter = replace(lifter, posterior=options, shown=shown)
    return Setup(config, matched, lifter, theta, camera, estimates, place)


def limbs_of(dictionary: Dictionary) -> LimbLengths | None:
    """Return the usual lengths of limbs, None where they are unknown."""
    # Imported here, as fits by other methods do not need it.
    from shapefit.lifting.posterior.usual_lengths import find_limb_lengths

    return find_limb_lengths(dictionary)


def announce_time(images: Landmarks, lifter: Lifter, total: int) -> str:
    """Return how long all images may take, "" below LONG.

    With a prior that follows from sizes, and a sample is lifted as often as there are
    pairs of scales, and with landmarks hidden in turn. Other methods are timed by one
    of several images, then by some.
    """
    prior, liftings, per_image = lifter.dictionary.prior, total, 0.0
    if lifter.row.has_prior and prior is not None:
        p, cores = (
            lifter.dictionary.mean_shape.shape[1],
            lifter.threads or os.cpu_count() or 1,
        )
        per_image = POSTERIOR * p**3.5 * (10 + len(prior)) / min(cores, max(total, 1))
        if total >= FEWEST:
            from shapefit.lifting.posterior.calibration import MOST_HIDDEN

            hidden = min(min(total, CALIBRATED) * p, MOST_HIDDEN)
            liftings += min(total, LARGEST) * len(FACTORS) ** 2 + hidden
    elif total > 1:
        for number in (1, TIMED):  # the first call also imports
            timed = images.take(evenly(len(images), number))
            began = time.perf_counter()
            lift_images(timed, lifter)
            per_image = (time.perf_counter() - began) / max(len(timed), 1)
            if per_image * total < LONG:
                break
    if (seconds := per_image * liftings) < LONG:
        return ""
    duration = (
        f"{seconds:.0f} seconds" if seconds < 120 else f"{seconds / 60:,.0f} minutes"
    )
    duration += f", {per_image:.2g} s each" if total > 1 else ""
    fix = "give fewer landmarks, or a dictionary with fewer components or atoms"
    return f"{counted(total, 'image')} may take up to {duration}: {fix}"


def choose_method(
    config: FitConfig, dictionary: Dictionary, has_sequences: Callable[[], bool]
) -> tuple[FitConfig, str]:
    """Return the config with the method that suits dictionary and images, and a line
    about it.
    """
    line = ""
    if config.method == AUTO:
        prior = dictionary.prior is not None
        method = (
            ("sequences" if has_sequences() else "posterior") if prior else "convex"
        )
        if find_conflict(config.changed(method=method)) is not None:
            method = "convex"
        config = config.changed(method=method)
        if (conflict := find_conflict(config)) is not None:
            fault, _, fix = conflict.partition("; ")
            raise input_error("fit", fault, fix)
        line = (
            f"{method} (the dictionary has {'a' if prior else 'no'} prior; change with"
            " --method)"
        )
    if config.method in OF_PEOPLE and limbs_of(dictionary) is not None:
        given = config.prior.model_fields_set
        values = OF_PEOPLE[config.method].items()
        config = config.changed(
            prior={key: value for key, value in values if key not in given}
        )
    row, tolerance, proof = METHODS[config.method], config.tolerance, config.save.proof
    tolerance = row.tolerance if tolerance is None else tolerance
    proof = not row.has_prior if proof is None else proof
    return config.changed(tolerance=tolerance, save={"proof": proof}), line


def in_sequences(config: FitConfig) -> bool:
    """Whether the images are frames of sequences, by the first COUNTED of them."""
    if STANDARD_STREAM in config.landmarks:  # which cannot be read twice
        return False
    options = replace(input_options(config, "motion"), rename={})
    try:
        with open_landmarks(config.landmarks, options, head=True) as source:
            return are_long(source.first(COUNTED).sequences)
    except (
        InputError
    ):  # no frames of a video; what is wrong with files is reported by the fit
        return False


def are_long(sequences: Sequence[str] | None) -> bool:
    """Whether at least half of the images are of sequences of FRAMES or more."""
    if not sequences:
        return False
    _, which, counts = np.unique(sequences, return_inverse=True, return_counts=True)
    return median(counts[which]) >= FRAMES


def read_options(config: FitConfig) -> InputOptions:
    """Return how the landmark files are read; detections are tracked where motion is
    needed.
    """
    output, track = config.output, METHODS[config.method].sequences
    if not isinstance(output, ResultFolder):
        track = track or find_target_format(output).in_metres
    return input_options(config, "motion" if track else "none")


def files_of(config: FitConfig) -> dict[str, Path]:
    """Return the files that results depend on beside landmarks, by their keys."""
    files = {
        "dictionary": config.dictionary,
        "camera.calibration": config.camera.calibration,
        "prior.calibration": config.prior.calibration,
    }
    return {key: path for key, path in files.items() if path is not None}


def warn_of_dictionary(config: FitConfig, dictionary: Dictionary) -> tuple[str, ...]:
    """Say what is doubtful of a dictionary: how it was learned, and for which
    methods.
    """
    warnings = describe_learning(dictionary)
    learned, wanted = (
        dictionary.provenance.get("method"),
        METHODS[config.method].learned,
    )
    if learned is not None and wanted and learned not in wanted and not config.signed:
        made = f"{config.method} is made for {' or '.join(wanted)}"
        warnings += (f"the dictionary was learned with `method: {learned}`; {made}",)
    if not METHODS[config.method].mixes_atoms:
        return warnings
    atoms = dictionary.atoms
    if config.method == "convex" and is_flat(atoms):
        text = "all shapes of the dictionary are flat, which `convex` recovers badly"
        warnings += (f"{text}: compare `--method alternate`",)
    size = median(np.linalg.norm(atoms, axis=(1, 2)))
    most = atoms[0].size ** 0.5
    if not ATOMS[0] <= size <= ATOMS[1] * most:
        text = f"the atoms have a norm of {size:.3g}, and lambda is meant for 1 to"
        fix = "divide the atoms by their size, or multiply lambda by it"
        warnings += (f"{text} {most:.2g}: {fix}",)
    return warnings


def is_flat(atoms: Floats) -> bool:
    """Whether atoms (k, 3, p) lie in one plane, by singular values of all points; of
    three landmarks all do.
    """
    if atoms.shape[2] < 4:
        return False
    points = atoms.swapaxes(0, 1).reshape(3, -1)
    values = np.linalg.svd(points @ points.T, compute_uv=False) ** 0.5
    return bool(values[2] < FLAT * values[0])


def estimate(
    config: FitConfig, dictionary: Dictionary, matched: Matched, images: Landmarks
) -> Estimates:
    """Estimate the camera and, for methods with a prior, skeleton, prior scale and
    error bars.
    """
    learned_from = matched.dictionary.provenance.get(LEARNED_FROM) is not None
    camera, of_camera = choose_camera(config, images, from_landmarks=learned_from)
    of_size = say_outside(config, images)
    if not METHODS[config.method].has_prior:
        warnings = (of_size,) if of_size else ()
        return Estimates({"camera": camera}, (f"camera: {of_camera}",), warnings)
    bars, of_report = read_bar_scale(config)
    bar_scale = (
        config.prior.bar_scale
    )  # a report judged bars that hidden landmarks had widened
    config = config.changed(camera=camera, prior=bars)
    lifter = replace(lifter_of(config, matched.dictionary), method="posterior")
    in_file = draw_sample(
        images.take(np.flatnonzero(weigh(images, lifter).any(axis=1)))
    )
    sample = matched.arrange(in_file, "landmarks")

    skeleton, of_skeleton = choose_skeleton(config.skeleton, matched, sample, lifter)
    theta = {**MEANS, **(skeleton or {})}
    shown = find_shown(sample, lifter)
    lifter = replace(lifter, dictionary=matched.observed(theta), shown=shown)
    if len(sample) < FEWEST:
        sample = sample.take(slice(0))  # so few say nothing more, and are lifted once
    lifting = lift_sample(sample, lifter)
    warning = check_names(in_file, lifting, lifter, dictionary, theta)
    # a wide prior would take wrong names for poses that it lacks
    keys = [key for key in SCALES if getattr(config.prior, key) is None and not warning]
    lifter, of_scale = choose_scale(keys, sample, lifting, lifter)
    if of_scale:
        lifting = lift_sample(sample, lifter)
    reason = trust.NOT_OF_THE_CLASS if warning else ""
    if not warning and (stretch := stretch_of_people(sample, lifter)) != 1:
        warning = NO_TRUST + describe_stretch(stretch)
        reason = trust.STRETCHED
    growth, numbers, of_bars = calibrate_bars(sample, lifting, lifter, bar_scale)
    if numbers and not warning:
        share, doubtful = trust_in_sample(lifting, growth, shown)
        if trust.contradicts(numbers[KAPPA], numbers[DISTANCE], share, doubtful):
            fix = (
                "are the names of the landmarks right, and does the dictionary have"
                " such shapes?"
            )
            warning = f"{NO_TRUST}{of_bars}; {share:.0%} of a sample would be; {fix}"
            reason = trust.NOT_OF_THE_CLASS
    scale = {"scale": lifter.prior_scale, "residual_variance": lifter.variance}
    return Estimates(
        {"camera": camera, "prior": {**bars, **scale}, "skeleton": skeleton},
        tuple(
            filter(
                None,
                (f"camera: {of_camera}", of_skeleton, of_scale, of_report, of_bars),
            )
        ),
        tuple(filter(None, (warning, of_size))),
        reason,
        growth,
        () if shown is None else tuple(shown.tolist()),
        numbers,
    )


def read_bar_scale(config: FitConfig) -> tuple[dict[str, Any], str]:
    """Return the keys of `prior` that its `calibration` stands for, and a line about
    them.
    """
    path, method = config.prior.calibration, config.method
    if path is None:
        return {}, ""
    try:
        factors = parse_json(path.read_text(encoding="utf-8"))
        (only,) = [factors[method]] if method in factors else factors.values()
        factor = float(only["90%"])
    except (OSError, ValueError, KeyError, TypeError):
        factor = 0.0
    if not factor > 0:
        fix = (
            "give error_bars.json of a report of eval in which it was judged on enough"
            " images"
        )
        raise input_error(path, f"holds no factors of error bars of {method}", fix)
    values = {"bar_scale": config.prior.bar_scale * factor**2, "calibration": None}
    return values, f"error bars x {factor:.2f} ({path.name})"


def draw_sample(images: Landmarks) -> Landmarks:
    """Draw images that are spread over all; of long sequences pairs that are a step
    apart.
    """
    images = images.take(np.flatnonzero(images.visible().sum(axis=1) >= FEWEST_VISIBLE))
    n, rows = len(images), evenly(len(images), LARGEST)
    if images.sequences is not None and n > LARGEST:
        step = max(1, round(STEP * (images.frame_rate or ASSUMED_RATE)))
        rows = evenly(n, LARGEST // 2)
        second = rows[rows + step < n] + step
        rows = np.flatnonzero(np.bincount(np.concatenate((rows, second))))
    return images.take(rows)


def lift_sample(sample: Landmarks, lifter: Lifter) -> Lifting:
    """Lift a sample by the posterior, with p-values and covariances."""
    lifter = with_limbs(lifter)
    options = replace(lifter.posterior, covariance=True)
    lifter = replace(lifter, posterior=options)
    return with_p_values(lift_images(sample, lifter), lifter)


def with_limbs(lifter: Lifter) -> Lifter:
    """Return what lifts images given usual lengths of limbs, where they are known."""
    limbs = limbs_of(lifter.dictionary)
    return replace(lifter, posterior=replace(lifter.posterior, limbs=limbs))


def stretch_of_people(sample: Landmarks, lifter: Lifter) -> float:
    """Return how many times too wide a sample is, 1 where nothing is gained by that.

    Wrong names may look like a stretch, too; but they are doubtful at any width.
    """
    stretch = find_stretch(sample, with_limbs(lifter))
    if stretch == 1:
        return 1.0
    without_camera = replace(lifter, camera=None)
    _, doubtful = trust_in_sample(
        lift_sample(narrow(sample, stretch), without_camera), shown=lifter.shown
    )
    return stretch if doubtful <= DOUBTFUL else 1.0


def find_shown(sample: Landmarks, lifter: Lifter) -> Flags | None:
    """Return which landmarks (p,) most images of a sample show, None where none is.

    What few images show is guessed in the others, and what depends on other landmarks
    in all.
    """
    if not len(sample):
        return None
    often = (weigh(sample, lifter) > 0).mean(axis=0) >= MOSTLY
    shown: Flags = np.asarray(often & (lifter.dictionary.depends_on < 0))
    return shown if shown.any() else None


def log_evidence(images: Landmarks, lifter: Lifter) -> Floats:
    """Return log p(w) (n,) of images."""
    evidence: Floats = lift_images(images, lifter).estimate.further["log_evidence"]
    return evidence


def choose_skeleton(
    given: Mapping[str, float] | None,
    matched: Matched,
    sample: Landmarks,
    lifter: Lifter,
) -> tuple[dict[str, float] | None, str]:
    """Return the parameters of the skeleton, as given, else estimated, else usual; and
    a line.
    """
    if not matched.joints.markers:
        return None if given is None else dict(given), ""
    start = {**MEANS, **(given or {})}
    names = [name for name in matched.joints.parameters if name not in (given or {})]
    if not names or not len(sample):
        return start, ""
    few = sample.take(evenly(len(sample), FEW))

    def evidence(theta: Mapping[str, float]) -> float:
        observed = replace(lifter, dictionary=matched.observed(theta))
        return float(np.nansum(log_evidence(few, observed)))

    theta = maximise_theta(evidence, names, start)
    factors = ", ".join(f"{name} x {theta[name]:.2f}" for name in names)
    return theta, f"skeleton of the detector: {factors}"


def maximise_theta(
    evidence: Callable[[Mapping[str, float]], float],
    names: Sequence[str],
    start: dict[str, float],
) -> dict[str, float]:
    """Return theta that maximises log p(w | theta) + log p(theta), twice, one by one.

    Each is taken to the top of the parabola through the best value tried and its
    neighbours.
    """
    theta = dict(start)
    for factor in (1.0, 0.5):
        for name in names:
            x = np.log(theta[name]) + factor * np.array(STEPS)
            prior = -0.5 * ((x - np.log(THETA[name].mean)) / THETA[name].std) ** 2
            values = prior + [evidence(theta | {name: float(np.exp(at))}) for at in x]
            top, step = int(np.argmax(values)), x[1] - x[0]
            middle = min(max(top, 1), len(x) - 2)
            below, at, above = values[middle - 1 : middle + 2]
            curvature = (2 * at - below - above) / step**2
            best = x[top]
            if curvature > 0:
                best = x[middle] + np.clip(
                    (above - below) / (2 * step * curvature), -step, step
                )
            theta[name] = float(np.exp(best))
    return theta


def choose_scale(
    keys: Sequence[str], sample: Landmarks, lifting: Lifting, lifter: Lifter
) -> tuple[Lifter, str]:
    """Return the lifter with those keys of SCALES chosen by evidence, and a line about
    changes.

    lifting, of the sample by the lifter. Landmarks that are outliers in most images do
    not count: their errors say nothing of the others, but would make them all less
    exact.
    """

    def scaled(pair: Pair) -> Lifter:
        prior, variance = pair[0] * lifter.prior_scale, pair[1] * lifter.variance
        return replace(lifter, prior_scale=prior, residual_variance=variance)

    if not keys or len(sample) < FEWEST:
        return scaled((1.0, 1.0)), ""
    inlier_probability = lifting.estimate.further["inlier_probability"]
    visible = np.maximum(np.isfinite(inlier_probability).sum(axis=0), 1)
    hidden = (inlier_probability < OUTLIER).sum(axis=0) > MOSTLY * visible
    if (
        0 < hidden.sum() <= len(hidden) / 3
    ):  # with more, the prior is wrong, not the landmarks
        seen = np.where(hidden[:, None], np.nan, sample.landmarks)
        sample = replace(sample, landmarks=seen)
    factors = (FACTORS if key in keys else FACTORS[:1] for key in SCALES)
    pair = find_scale(
        lambda pair, images: log_evidence(images, scaled(pair)), sample, *factors
    )
    chosen, changes = scaled(pair), []
    if pair[0] != 1:
        changes.append(
            f"prior widened x {chosen.prior_scale:g}: poses unlike the training data"
        )
    if pair[1] != 1:
        changes.append(
            f"residual variance {chosen.variance:g} in place of {lifter.variance:g}"
        )
    return chosen, ", ".join(changes)


def find_scale(
    evidence: Callable[[Pair, Landmarks], Floats],
    images: Landmarks,
    scales: tuple[float, ...] = FACTORS,
    variances: tuple[float, ...] = FACTORS,
) -> Pair:
    """Choose among pairs of factors by their evidence (n,) of images, in order of both.

    All pairs are tried where, at first sight, the next scale or the next variance is
    likelier. Of pairs as likely as the best, the widest is taken; then the least
    variance.
    """
    first, few = (scales[0], variances[0]), images.take(evenly(len(images), FEW))
    near = [(f, first[1]) for f in scales[1:2]] + [
        (first[0], v) for v in variances[1:2]
    ]
    before = evidence(first, few)
    if not any(np.nansum(evidence(pair, few) - before) > 0 for pair in near):
        return first
    of_pair = {(f, v): evidence((f, v), images) for f in scales for v in variances}
    best = max(of_pair, key=lambda pair: float(np.nanmean(of_pair[pair])))
    gains = {
        pair: mean_gain(evidence, of_pair[best]) for pair, evidence in of_pair.items()
    }
    likely = [pair for pair, (lost, error) in gains.items() if lost <= error]
    return max(likely, key=lambda pair: (pair[0], -pair[1]))


def mean_gain(before: Floats, after: Floats) -> tuple[float, float]:
    """Return the mean of after - before where it is finite, and its standard error.

    By batch means, as neighbours resemble each other (Flegal and Jones, Annals of
    Statistics 2010).
    """
    gain = (after - before)[np.isfinite(after - before)]
    if len(gain) < 4:
        return 0.0, np.inf
    means = [block.mean() for block in np.array_split(gain, int(np.sqrt(len(gain))))]
    return float(gain.mean()), float(np.std(means, ddof=1) / np.sqrt(len(means)))


def calibrate_bars(
    sample: Landmarks, lifting: Lifting, lifter: Lifter, bar_scale: float
) -> tuple[tuple[float, ...], dict[str, float], str]:
    """Return factors (p,) on the covariances of landmarks, numbers to be stored, and a
    line.

    bar_scale, of all covariances without the factors of a report, which come on top.
    """
    if len(sample) < trust.LIMITS.fewest_images:
        return (), {}, ""
    from shapefit.lifting.posterior.calibration import calibrate

    rows, estimate = evenly(len(sample), CALIBRATED), lifting.estimate
    inliers, problem = (
        estimate.further["inlier_probability"],
        lifting.problem.take(rows),
    )
    settings = settings_of(lifter)
    calibration = calibrate(problem, estimate.rotation[rows], inliers[rows], settings)
    visible = np.isfinite(inliers).sum(axis=1)
    distance = trust.median_distance(estimate.further[trust.START_DISTANCE], visible)
    inside = {"hidden_landmarks_inside": calibration.inside}
    line = (
        f"of landmarks hidden in turn, {calibration.inside:.0%} lie in their 90%"
        " regions"
    )
    if np.isfinite(distance):
        line += f"; median distance from the convex shape {distance:.2f}"
    numbers = {KAPPA: calibration.kappa, **inside, DISTANCE: distance}
    return tuple(calibration.growth(bar_scale).tolist()), numbers, line


def trust_in_sample(
    lifting: Lifting, growth: Sequence[float] = (), shown: Flags | None = None
) -> tuple[float, float]:
    """Return the share of images that are trusted, and of those implausible or far from
    training.

    Covariances grow by factors (p,); shown (p,) are the landmarks whose errors count.
    """
    from shapefit.lifting.posterior.method import grow_covariance, scale_of_bars

    estimate = lifting.estimate
    shapes, covariance, further = estimate.shapes, estimate.covariance, estimate.further
    grown = grow_covariance(covariance, scale_of_bars(1.0, growth, shapes.shape[2]))
    assert grown is not None  # as `lift_sample` asks for
    visible = np.isfinite(further["inlier_probability"]).sum(axis=1)
    numbers = (further[trust.P_VALUE], further[trust.START_DISTANCE])
    expected = trust.expected_error(shapes, grown, shown)
    reasons = trust.find_reasons(
        shapes, expected, visible, *numbers, estimate.status, shown=shown
    )
    doubtful = np.isin(reasons, (trust.IMPLAUSIBLE, trust.FAR))
    return float((reasons == "").mean()), float(doubtful.mean())


def check_names(
    in_file: Landmarks,
    lifting: Lifting,
    lifter: Lifter,
    dictionary: Dictionary,
    theta: Mapping[str, float],
) -> str:
    """Return a warning where many images are doubtful, and few by the names of another
    skeleton.
    """
    names, shares = in_file.landmark_names, dict[str, float]()
    if len(in_file) < FEWEST or (share := trust_in_sample(lifting)[1]) <= DOUBTFUL:
        return ""
    for other in installed_skeletons().values():
        if len(other.landmark_names) != len(names) or other.landmark_names == names:
            continue
        try:
            matched = match_names(other.landmark_names, dictionary, other.name)
        except InputError:  # it has too few landmarks of the dictionary
            continue
        renamed = replace(in_file, landmark_names=other.landmark_names)
        images = matched.arrange(renamed, other.name)
        if images.visible().any(axis=0).sum() >= FEWEST_NAMES:
            as_other = replace(lifter, dictionary=matched.observed(theta))
            _, shares[other.name] = trust_in_sample(lift_sample(images, as_other))
    best = min(shares, key=lambda name: shares[name], default="")
    if not best or not shares[best] < share / 2:
        return ""
    return (
        f"{NO_TRUST}{share:.0%} of a sample of {len(in_file)} images contradict the"
        f" names of their landmarks, {shares[best]:.0%} those of {best}: is it {best}?"
        f" Set `keypoints: {best}`"
    )

"""What a sample of the images says of a fit with a prior: skeleton, scales, error bars,
and whether any image is to be trusted.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from shapefit.arrays import Flags, Floats, evenly
from shapefit.config.commands.fit import PriorConfig
from shapefit.errors import InputError, input_error, parse_json
from shapefit.io.skeletons import installed_skeletons
from shapefit.lifting import trust
from shapefit.lifting.lift import PosteriorLifting
from shapefit.lifting.posterior.calibration import hide_in_turn
from shapefit.lifting.posterior.method import scale_covariance, scale_of_bars
from shapefit.pipelines.fit.aspect import describe_stretch, divide_x, find_stretch
from shapefit.pipelines.fit.evidence import (
    FACTORS,
    FIRST_LOOK,
    Factors,
    choose_factors,
    maximise_theta,
)
from shapefit.pipelines.fit.family import Calibration
from shapefit.pipelines.fit.image_posterior import ImagePosterior
from shapefit.pipelines.joints import MEANS, LandmarkMatch, match_names
from shapefit.records import Landmarks
from shapefit.timeline import ASSUMED_RATE

MAX_SAMPLE = 96
"""Images of a sample."""

MIN_SAMPLE = 10
"""Images that say something of the scale of a prior; fewer are lifted once."""

MAX_HIDDEN_IN_TURN = 60
"""Images of the sample whose landmarks are hidden in turn."""

MIN_SAMPLE_LANDMARKS = 5
"""Of an image of the sample: four fit almost any shape."""

PAIR_SECONDS = 0.5
"""Between the two images of a pair, of a video."""

MIN_NAMED_LANDMARKS = 4
"""Landmarks that the names of another skeleton must give."""

OUTLIER_BELOW = 0.5
"""Inlier probability of an outlier."""

MAJORITY_SHARE = 0.5
"""Share of the images of a sample above which a landmark counts as shown, or as an
outlier, in the whole file.
"""

MAX_HIDDEN_SHARE = 1 / 3
"""Of the landmarks that may be outliers in most images: with more, the prior is wrong,
not the landmarks.
"""

DOUBTFUL_SHARE = 0.25
"""Of doubtful images, from which other skeletons are tried; one that has less than half
of that share is named. Where names are right a few images in a hundred are doubtful.
"""

NO_TRUST = "no shape of this file is to be trusted: "

KAPPA = "calibration_kappa"
"""Attribute of a result: by which the variances of hidden landmarks are too small."""

DISTANCE = "median_start_distance"
"""Attribute of a result: the median start distance of the sample."""

HIDDEN_INSIDE = "hidden_landmarks_inside"
"""Attribute of a result: share of hidden landmarks inside their 90% regions."""


class BarGrowth(NamedTuple):
    """How much larger error bars must be, by landmarks hidden in turn; else empty.

    growth (p,), factors on covariances; numbers, attributes of the result; line, a text
    about them. All are empty where the sample is too small.
    """

    growth: tuple[float, ...] = ()
    numbers: Mapping[str, float] = {}
    line: str = ""


class Verdict(NamedTuple):
    """Why no image of a file is to be trusted, and a warning; both "" by default.

    reason is `trust.NOT_OF_THE_CLASS` or `trust.STRETCHED`.
    """

    reason: str = ""
    warning: str = ""


def calibrate_by_sample(
    images: Landmarks,
    match: LandmarkMatch,
    posterior: ImagePosterior,
    method: str,
    prior: PriorConfig,
    skeleton: Mapping[str, float] | None,
) -> Calibration:
    """Estimate skeleton, scales and error bars by a sample, and if to trust the file.

    What the keys of `prior` and `skeleton` state stays. images as in the files;
    posterior, of the landmarks of the dictionary.
    """
    report = read_report(prior, method)
    posterior = replace(posterior, bar_scale=report.bar_scale)
    in_file = draw_sample(images, posterior)
    sample = match.arrange(in_file, "landmarks")

    theta, skeleton_line = choose_skeleton(skeleton, match, sample, posterior)
    observed = match.detector_dictionary({**MEANS, **(theta or {})})
    shown = find_shown_landmarks(sample, posterior)
    posterior = replace(posterior, dictionary=observed, shown=shown)
    if len(sample) < MIN_SAMPLE:
        sample = sample.take(slice(0))
    lifting = lift_sample(sample, posterior)
    verdict = judge_names(in_file, lifting, match, posterior, theta)
    # A wide prior would take wrong names for poses that it lacks.
    if not verdict.reason:
        posterior, scale_line = choose_scales(prior, sample, lifting, posterior)
    else:
        scale_line = ""
    if scale_line:
        lifting = lift_sample(sample, posterior)
    if not verdict.reason:
        verdict = judge_stretch(sample, posterior)
    bars = calibrate_bars(lifting, posterior, prior.bar_scale)
    if not verdict.reason:
        verdict = judge_sample(lifting, bars, shown)

    lines = (skeleton_line, scale_line, report.line, bars.line)
    return Calibration(
        lines=tuple(line for line in lines if line),
        warnings=(verdict.warning,) if verdict.warning else (),
        skeleton=theta,
        prior_scale=posterior.prior_scale,
        residual_variance=posterior.variance,
        bar_scale=report.bar_scale if report.line else None,
        growth=bars.growth,
        shown=() if shown is None else tuple(shown.tolist()),
        reason=verdict.reason,
        numbers=bars.numbers,
    )


class BarReport(NamedTuple):
    """The factor on covariances of error bars, and a line about it.

    The factor of a report of errors is in it; without a report the line is "".
    """

    bar_scale: float
    line: str = ""


def read_report(prior: PriorConfig, method: str) -> BarReport:
    """Return `bar_scale` times the squared factor of a report of `eval`, if given.

    The report is the file error_bars.json that `prior.calibration` names. Raises
    InputError for a file that holds no factor of the method.
    """
    path = prior.calibration
    if path is None:
        return BarReport(prior.bar_scale)
    try:
        factors = parse_json(path.read_text(encoding="utf-8"))
        if method in factors:
            of_method = factors[method]
        else:
            (of_method,) = factors.values()
        factor = float(of_method["90%"])
    except (OSError, ValueError, KeyError, TypeError):
        factor = 0.0
    if not factor > 0:
        fix = (
            "give error_bars.json of a report of eval in which it was judged on enough"
            " images"
        )
        raise input_error(path, f"holds no factors of error bars of {method}", fix)
    line = f"error bars x {factor:.2f} ({path.name})"
    return BarReport(prior.bar_scale * factor**2, line)


def draw_sample(images: Landmarks, posterior: ImagePosterior) -> Landmarks:
    """Return at most MAX_SAMPLE images, spread evenly over all that show enough.

    Enough is MIN_SAMPLE_LANDMARKS visible landmarks, and one that counts. Of more
    images of sequences, pairs are taken that are PAIR_SECONDS apart.
    """
    images = images.take(np.flatnonzero(posterior.weigh(images).any(axis=1)))
    enough = images.visible().sum(axis=1) >= MIN_SAMPLE_LANDMARKS
    images = images.take(np.flatnonzero(enough))
    n = len(images)
    rows = evenly(n, MAX_SAMPLE)
    if images.sequences is not None and n > MAX_SAMPLE:
        step = max(1, round(PAIR_SECONDS * (images.frame_rate or ASSUMED_RATE)))
        rows = evenly(n, MAX_SAMPLE // 2)
        second = rows[rows + step < n] + step
        rows = np.flatnonzero(np.bincount(np.concatenate((rows, second))))
    return images.take(rows)


def choose_skeleton(
    skeleton: Mapping[str, float] | None,
    match: LandmarkMatch,
    sample: Landmarks,
    posterior: ImagePosterior,
) -> tuple[dict[str, float] | None, str]:
    """Return the body proportions of a detector, by name, and a line about them.

    Each is as `skeleton` states it, else of the greatest evidence, else usual, where
    the sample is empty. The line is "" where none is estimated. Where no landmark of
    the detector stands for a joint of the dictionary, they are those of `skeleton`, or
    None.
    """
    if not match.joints.markers:
        return None if skeleton is None else dict(skeleton), ""
    stated = dict(skeleton or {})
    start = {**MEANS, **stated}
    names = [name for name in match.joints.parameters if name not in stated]
    if not names or not len(sample):
        return start, ""
    few = sample.take(evenly(len(sample), FIRST_LOOK))

    def evidence(theta: Mapping[str, float]) -> float:
        """Return the log evidence of some images at body proportions theta."""
        observed = replace(posterior, dictionary=match.detector_dictionary(theta))
        return float(np.nansum(observed.log_evidence(few)))

    theta = maximise_theta(evidence, names, start)
    factors = ", ".join(f"{name} x {theta[name]:.2f}" for name in names)
    return theta, f"skeleton of the detector: {factors}"


def find_shown_landmarks(sample: Landmarks, posterior: ImagePosterior) -> Flags | None:
    """Return which landmarks (p,) most images of a sample show, None where none is.

    What few images show is guessed in the others, and what depends on other landmarks
    in all.
    """
    if not len(sample):
        return None
    often = (posterior.weigh(sample) > 0).mean(axis=0) >= MAJORITY_SHARE
    independent = posterior.dictionary.depends_on < 0
    shown: Flags = np.asarray(often & independent)
    return shown if shown.any() else None


def lift_sample(sample: Landmarks, posterior: ImagePosterior) -> PosteriorLifting:
    """Lift a sample with p-values and covariances, given usual lengths of limbs."""
    judged = replace(posterior.with_limbs(), covariance=True)
    return judged.lift_with_p_values(sample)


def choose_scales(
    prior: PriorConfig,
    sample: Landmarks,
    lifting: PosteriorLifting,
    posterior: ImagePosterior,
) -> tuple[ImagePosterior, str]:
    """Return the posterior with scales chosen by evidence, and a line about changes.

    They are the factor on the prior's covariances and the residual variance, where
    `prior` leaves them open. lifting, of the sample by the posterior. The line is ""
    where nothing changes.
    """
    unchanged = replace(posterior, residual_variance=posterior.variance)
    is_open = prior.scale is None or prior.residual_variance is None
    if not is_open or len(sample) < MIN_SAMPLE:
        return unchanged, ""

    def scaled(factors: Factors) -> ImagePosterior:
        """Return the posterior with both scales multiplied by factors."""
        return replace(
            posterior,
            prior_scale=factors.prior * posterior.prior_scale,
            residual_variance=factors.variance * posterior.variance,
        )

    factors = choose_factors(
        lambda factors, images: scaled(factors).log_evidence(images),
        without_outliers(sample, lifting.estimate.inlier_probability),
        scales=FACTORS if prior.scale is None else FACTORS[:1],
        variances=FACTORS if prior.residual_variance is None else FACTORS[:1],
    )
    chosen = scaled(factors)
    changes = []
    if factors.prior != 1:
        widened = f"prior widened x {chosen.prior_scale:g}"
        changes.append(f"{widened}: poses unlike the training data")
    if factors.variance != 1:
        changed = f"residual variance {chosen.variance:g}"
        changes.append(f"{changed} in place of {posterior.variance:g}")
    return chosen, ", ".join(changes)


def without_outliers(sample: Landmarks, inlier_probability: Floats) -> Landmarks:
    """Return the sample without landmarks that are outliers in most images.

    Their errors say nothing of the others, but would make them all less exact. Where
    these are more than MAX_HIDDEN_SHARE, all stay.
    """
    visible = np.maximum(np.isfinite(inlier_probability).sum(axis=0), 1)
    hidden = (inlier_probability < OUTLIER_BELOW).sum(axis=0) > MAJORITY_SHARE * visible
    if not 0 < hidden.sum() <= MAX_HIDDEN_SHARE * len(hidden):
        return sample
    shown = np.where(hidden[:, None], np.nan, sample.landmarks)
    return replace(sample, landmarks=shown)


def calibrate_bars(
    lifting: PosteriorLifting, posterior: ImagePosterior, bar_scale: float
) -> BarGrowth:
    """Estimate factors on error bars from the errors of landmarks hidden in turn.

    It is empty for too few images. bar_scale, of all covariances without the factors of
    a report, which come on top.
    """
    n = len(lifting.scale)
    if n < trust.LIMITS.min_images:
        return BarGrowth()
    rows = evenly(n, MAX_HIDDEN_IN_TURN)
    estimate = lifting.estimate
    inliers = estimate.inlier_probability
    hidden = hide_in_turn(
        lifting.problem.take(rows),
        estimate.rotation[rows],
        inliers[rows],
        posterior.model,
        threads=posterior.threads,
    )
    assert estimate.start_distance is not None, "the sample was lifted with it"
    visible = np.isfinite(inliers).sum(axis=1)
    distance = trust.median_distance(estimate.start_distance, visible)
    facts = []
    if hidden.predictions:
        inside = f"{hidden.inside:.0%} lie in their 90% regions"
        facts.append(f"of landmarks hidden in turn, {inside}")
    if np.isfinite(distance):
        facts.append(f"median distance from the convex shape {distance:.2f}")
    numbers = {KAPPA: hidden.kappa, HIDDEN_INSIDE: hidden.inside, DISTANCE: distance}
    growth = tuple(hidden.growth(bar_scale).tolist())
    return BarGrowth(growth, numbers, "; ".join(facts))


def judge_names(
    in_file: Landmarks,
    lifting: PosteriorLifting,
    match: LandmarkMatch,
    posterior: ImagePosterior,
    theta: Mapping[str, float] | None,
) -> Verdict:
    """Return a verdict on a file whose landmarks may go by names of another skeleton.

    It trusts no image where many are doubtful, and few by the names of that skeleton;
    it is empty otherwise. lifting, of the images of the file.
    """
    if len(in_file) < MIN_SAMPLE:
        return Verdict()
    share = judge_shares(lifting).doubtful
    if share <= DOUBTFUL_SHARE:
        return Verdict()
    shares = {}
    for name in installed_skeletons():
        doubtful = doubtful_share(name, in_file, match, posterior, theta)
        if doubtful is not None:
            shares[name] = doubtful
    best = min(shares, key=lambda name: shares[name], default="")
    if not best or not shares[best] < share / 2:
        return Verdict()
    warning = (
        f"{NO_TRUST}{share:.0%} of a sample of {len(in_file)} images contradict the"
        f" names of their landmarks, {shares[best]:.0%} those of {best}: is it {best}?"
        f" Set `keypoints: {best}`"
    )
    return Verdict(trust.NOT_OF_THE_CLASS, warning)


def doubtful_share(
    name: str,
    in_file: Landmarks,
    match: LandmarkMatch,
    posterior: ImagePosterior,
    theta: Mapping[str, float] | None,
) -> float | None:
    """Return the share of images that are doubtful by the names of another skeleton.

    name: that of an installed one; None where its names are those of the file, or not
    as many.
    """
    names = installed_skeletons()[name].landmark_names
    if len(names) != len(in_file.landmark_names) or names == in_file.landmark_names:
        return None
    try:
        other = match_names(names, match.whole, name)
    except InputError:  # it has too few landmarks of the dictionary
        return None
    images = other.arrange(replace(in_file, landmark_names=names), name)
    if images.visible().any(axis=0).sum() < MIN_NAMED_LANDMARKS:
        return None
    observed = other.detector_dictionary({**MEANS, **(theta or {})})
    lifting = lift_sample(images, replace(posterior, dictionary=observed))
    return judge_shares(lifting).doubtful


def judge_stretch(sample: Landmarks, posterior: ImagePosterior) -> Verdict:
    """Return a verdict on images of people whose x and y have different scales.

    It trusts none of them, and is empty otherwise. Wrong names may look like a stretch,
    too; but they are doubtful at any width.
    """
    stretch = find_stretch(sample, posterior.with_limbs())
    if stretch == 1:
        return Verdict()
    without_camera = replace(posterior, camera=None)
    lifting = lift_sample(divide_x(sample, stretch), without_camera)
    if judge_shares(lifting, shown=posterior.shown).doubtful > DOUBTFUL_SHARE:
        return Verdict()
    return Verdict(trust.STRETCHED, NO_TRUST + describe_stretch(stretch))


def judge_sample(
    lifting: PosteriorLifting, bars: BarGrowth, shown: Flags | None
) -> Verdict:
    """Return a verdict on a file whose sample contradicts the dictionary.

    It trusts no image, and is empty otherwise, and where the sample is too small.
    """
    if not bars.numbers:
        return Verdict()
    shares = judge_shares(lifting, bars.growth, shown)
    kappa = bars.numbers[KAPPA]
    distance = bars.numbers[DISTANCE]
    if not trust.contradicts_dictionary(
        kappa, distance, shares.trusted, shares.doubtful
    ):
        return Verdict()
    fix = (
        "are the names of the landmarks right, and does the dictionary have such"
        " shapes?"
    )
    warning = f"{NO_TRUST}{bars.line}; {shares.trusted:.0%} of a sample would be; {fix}"
    return Verdict(trust.NOT_OF_THE_CLASS, warning)


class Shares(NamedTuple):
    """Shares of images: trusted ones, and implausible ones or far from training."""

    trusted: float
    doubtful: float


def judge_shares(
    lifting: PosteriorLifting,
    growth: Sequence[float] = (),
    shown: Flags | None = None,
) -> Shares:
    """Return the shares of a sample's images that are trusted, and doubtful.

    Covariances grow by factors (p,); shown (p,) are the landmarks whose errors count.
    """
    estimate = lifting.estimate
    factors = scale_of_bars(1.0, growth, estimate.shapes.shape[2])
    covariance = scale_covariance(estimate.covariance, factors)
    assert covariance is not None, "the sample was lifted with it"
    assert estimate.p_value is not None, "likewise"
    assert estimate.start_distance is not None, "likewise"
    reasons = trust.find_reasons(
        estimate.shapes,
        trust.expected_error(estimate.shapes, covariance, shown),
        np.isfinite(estimate.inlier_probability).sum(axis=1),
        estimate.p_value,
        estimate.start_distance,
        estimate.status,
        shown=shown,
    )
    doubtful = np.isin(reasons, (trust.IMPLAUSIBLE, trust.FAR_FROM_TRAINING))
    return Shares(float((reasons == "").mean()), float(doubtful.mean()))

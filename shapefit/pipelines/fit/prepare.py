"""What a fit needs before it lifts: names, camera, and one sample for all that is estimated.

Camera, skeleton and prior scale are estimated once, of all inputs together, and every part is given
the same.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from pydantic import BaseModel

from shapefit.arrays import median
from shapefit.config import FitConfig
from shapefit.config.paths import STANDARD_STREAM, ResultFolder
from shapefit.dictionary.model import LEARNED_FROM, SUITS, Dictionary, describe_learning
from shapefit.errors import InputError, input_error
from shapefit.io import LandmarkSet, open_landmarks
from shapefit.io.formats import HDF5, FileFormat, find_target_format
from shapefit.io.options import InputOptions, input_options
from shapefit.lifting.methods import AUTO, METHODS, find_conflict
from shapefit.lifting.trust import NOT_OF_THE_CLASS
from shapefit.pipelines.fit.camera import choose_camera, find_calibrated, undistorted
from shapefit.pipelines.fit.checks import calibrate_bars, check_skeleton
from shapefit.pipelines.fit.lift import Lifter, check_items, check_needs, lifter_of, weigh
from shapefit.pipelines.fit.sample import choose_scale, choose_skeleton, draw_sample
from shapefit.pipelines.joints import LandmarkMap, Matched, match_names

if TYPE_CHECKING:
    from shapefit.io.readers.calibration import CalibratedCamera

FIRST = 1024
"""Images of which the sample is drawn: the same whatever the chunks and parts."""

FRAMES, COUNTED = 10, 4096
"""Frames of a sequence whose motion says something of its shapes; images that are counted."""

PEOPLE = "people"
OF_PEOPLE: Mapping[str, Mapping[str, float]] = {
    "posterior": {"residual_variance": 0.006, "bar_scale": 1.6},
    "sequences": {"residual_variance": 0.01, "bar_scale": 1.5},
}
"""Keys of `prior` for dictionaries of people, where they are not given."""

NOT_READ = ("output",)
"""Keys of one file that results do not depend on."""

SCALES = ("scale", "residual_variance")
"""Keys of `prior` that are chosen by evidence."""


@dataclass(frozen=True)
class Estimates:
    """What was estimated: values for keys of a config, lines about them, and warnings.

    values are as `FitConfig.changed` takes them and JSON holds them; the camera line is the first.
    reason says why no image is to be trusted, "" for nothing; growth (p,) and numbers, see `Bars`.
    """

    values: Mapping[str, Any]
    lines: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    reason: str = ""
    growth: tuple[float, ...] = ()
    numbers: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class Setup:
    """A fit in which nothing is left open.

    config      with what was estimated
    matched     the landmarks of the files beside the dictionary, as these files need it
    mapped      where the landmarks lie that stand for its joints
    lifter      lifts images that have the landmarks of the dictionary
    camera      the calibrated camera that took the images, where one is given
    place       of the landmark names of the files, for messages
    """

    config: FitConfig
    matched: Matched
    mapped: LandmarkMap
    lifter: Lifter
    camera: CalibratedCamera | None
    estimates: Estimates
    place: str

    @property
    def dictionary(self) -> Dictionary:
        """The dictionary, as the files need it."""
        return self.matched.dictionary

    def arrange(self, images: LandmarkSet) -> LandmarkSet:
        """Return images of the files without distortion, with the landmarks of the dictionary."""
        return self.matched.arrange(undistorted(images, self.camera), self.place)


def prepare(
    config: FitConfig,
    dictionary: Dictionary,
    landmark_names: Sequence[str],
    first: Callable[[], LandmarkSet],
    estimates: Estimates | None = None,
) -> Setup:
    """Return what lifts landmarks of these names; estimate what is open, where nobody has yet.

    `first` reads the first images. Raises InputError where the dictionary lacks what the method
    needs, it and the landmarks have too few names in common, or the camera is not known.
    """
    method = METHODS[config.method]
    place = ", ".join(map(str, config.landmarks)) + ": landmark names"
    matched = match_names(landmark_names, dictionary, place, in_place=method.has_prior)
    check_needs(config.method, matched.dictionary, config.dictionary)
    camera = find_calibrated(config.camera)
    if estimates is None:
        estimates = estimate(config, dictionary, matched, undistorted(first(), camera))
    config = config.changed(**estimates.values)
    mapped = LandmarkMap.of(matched, config.skeleton, prior=method.has_prior)
    observed = mapped.apply(matched.dictionary)
    if config.leave_one_out is not None:
        check_items(observed)
    lifter = lifter_of(config, observed)
    # with a prior covariances serve the expected error, and the error bars of joints
    options = replace(
        lifter.posterior,
        growth=tuple(estimates.growth),
        covariance=lifter.posterior.covariance or method.has_prior,
    )
    return Setup(
        config=config,
        matched=matched,
        mapped=replace(mapped, residual_variance=lifter.variance),
        lifter=replace(lifter, posterior=options),
        camera=camera,
        estimates=estimates,
        place=place,
    )


def choose_method(
    config: FitConfig, dictionary: Dictionary, has_sequences: Callable[[], bool]
) -> tuple[FitConfig, str]:
    """Return the config with the method that suits dictionary and images, and a line about it.

    has_sequences tells whether the images are frames of sequences. Raises InputError where the
    config asks for what its method does not have.
    """
    line = ""
    if config.method == AUTO:
        prior = dictionary.prior is not None
        method = ("sequences" if has_sequences() else "posterior") if prior else "convex"
        if find_conflict(config.changed(method=method)) is not None:
            method = "convex"
        config = config.changed(method=method)
        if (conflict := find_conflict(config)) is not None:
            found, _, fix = conflict.partition("; ")
            raise input_error("fit", found, fix)
        why = "the dictionary has a prior" if prior else "the dictionary has no prior"
        line = f"{method} ({why}; change with --method)"
    if PEOPLE in dictionary.provenance.get(SUITS, "").split() and config.method in OF_PEOPLE:
        given = config.prior.model_fields_set
        values = OF_PEOPLE[config.method].items()
        config = config.changed(prior={key: value for key, value in values if key not in given})
    resolved = {"tolerance": config.solver_tolerance, "save": {"proof": config.saves_proof}}
    return config.changed(**resolved), line


def in_sequences(config: FitConfig) -> bool:
    """Whether the images are frames of sequences, by the first COUNTED of them.

    Those of standard input cannot be read twice.
    """
    if not config.landmarks or STANDARD_STREAM in config.landmarks:
        return False
    options = replace(input_options(config, "motion"), rename={})
    try:
        with open_landmarks(config.landmarks, options) as source:
            return are_long(source.first(COUNTED).sequences)
    except InputError:  # no frames of a video; what is wrong with files is reported by the fit
        return False


def are_long(sequences: Sequence[str] | None) -> bool:
    """Whether at least half of the images are of sequences of FRAMES or more."""
    if not sequences:
        return False
    _, which, counts = np.unique(sequences, return_inverse=True, return_counts=True)
    return median(counts[which]) >= FRAMES


def estimate(
    config: FitConfig, dictionary: Dictionary, matched: Matched, images: LandmarkSet
) -> Estimates:
    """Estimate the camera and, for methods with a prior, skeleton and prior scale by evidence.

    Of one sample of the first images, which also tells whether names are right.
    """
    learned_from = matched.dictionary.provenance.get(LEARNED_FROM) is not None
    camera, of_camera = choose_camera(config, images, from_landmarks=learned_from)
    if not METHODS[config.method].has_prior:
        return Estimates({"camera": camera}, (f"camera: {of_camera}",))
    bars, of_report = read_bar_scale(config)
    bar_scale = config.prior.bar_scale  # a report judged bars that hidden landmarks had widened
    config = config.changed(camera=camera, prior=bars)
    lifter = replace(lifter_of(config, matched.dictionary), method="posterior")
    visible = np.flatnonzero(weigh(images, lifter).any(axis=1))
    sample = draw_sample(images.take(visible), matched)

    mapped = LandmarkMap.of(matched, config.skeleton, prior=True)
    skeleton, of_skeleton = choose_skeleton(config.skeleton, mapped, sample, lifter)
    mapped = LandmarkMap.of(matched, skeleton, prior=True)
    lifter = replace(lifter, dictionary=mapped.apply(matched.dictionary))
    as_learned = sample.lift(lifter)
    warning = check_skeleton(sample, as_learned, lifter, dictionary, mapped.theta)
    # a wide prior would take wrong names for poses that it lacks
    open_keys = () if warning else tuple(k for k in SCALES if getattr(config.prior, k) is None)
    scale, of_scale = choose_scale(open_keys, sample, as_learned, lifter)
    scaled = replace(
        lifter, prior_scale=scale["scale"], residual_variance=scale["residual_variance"]
    )
    same = (lifter.prior_scale, lifter.variance) == (scaled.prior_scale, scaled.variance)
    lifting = as_learned if same else sample.lift(scaled)
    calibrated = calibrate_bars(sample, lifting, scaled, bar_scale)
    warning = warning or calibrated.warning
    lines = (f"camera: {of_camera}", of_skeleton, of_scale, of_report, calibrated.line)
    return Estimates(
        {"camera": camera, "prior": {**bars, **scale}, "skeleton": skeleton},
        tuple(filter(None, lines)),
        (warning,) if warning else (),
        NOT_OF_THE_CLASS if warning else "",
        calibrated.growth,
        calibrated.numbers,
    )


def read_bar_scale(config: FitConfig) -> tuple[dict[str, Any], str]:
    """Return the keys of `prior` that its `calibration` stands for, and a line about them.

    By the factors of the method, or of the only one of the report. Raises InputError for a file
    that has none.
    """
    path = config.prior.calibration
    if path is None:
        return {}, ""
    try:
        factors = json.loads(path.read_text(encoding="utf-8"))
        (only,) = factors.values() if config.method not in factors else (factors[config.method],)
        factor = float(only["90%"])
        if not factor > 0:
            raise ValueError(factor)
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        fix = "give error_bars.json of a report of eval in which it was judged on enough images"
        raise input_error(path, f"holds no factors of error bars of {config.method}", fix) from None
    values = {"bar_scale": config.prior.bar_scale * factor**2, "calibration": None}
    return values, f"error bars x {factor:.2f} ({path.name})"


def warn_of_dictionary(config: FitConfig, dictionary: Dictionary) -> tuple[str, ...]:
    """Say what is doubtful of a dictionary: how it was learned, and for which methods.

    One that does not state how it was learned passes, and any where signs are free.
    """
    learned, wanted = dictionary.provenance.get("method"), METHODS[config.method].learned
    of_learning = describe_learning(dictionary)
    if learned is None or not wanted or config.signed or learned in wanted:
        return of_learning
    found = f"the dictionary was learned with `method: {learned}`"
    return (f"{found}; {config.method} is made for {' or '.join(wanted)}", *of_learning)


def output_format(config: FitConfig) -> FileFormat:
    """Return the format of the results."""
    return HDF5 if isinstance(config.output, ResultFolder) else find_target_format(config.output)


def read_options(config: FitConfig) -> InputOptions:
    """Return how the landmark files are read.

    Detections without identity are joined to sequences where those are needed.
    """
    joined = output_format(config).in_metres or METHODS[config.method].sequences
    return input_options(config, "motion" if joined else "none")


def files_of(config: BaseModel, prefix: str = "") -> dict[str, Path]:
    """Return what results depend on beside landmarks: the keys of a config that name one file."""
    files: dict[str, Path] = {}
    for key in type(config).model_fields:
        value = getattr(config, key)
        if isinstance(value, BaseModel):
            files |= files_of(value, f"{prefix}{key}.")
        elif isinstance(value, Path) and key not in NOT_READ and value.is_file():
            files[f"{prefix}{key}"] = value
    return files

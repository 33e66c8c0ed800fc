"""What a fit needs before it lifts, found once and given to all its parts."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from shapefit.arrays import median
from shapefit.config import FitConfig
from shapefit.config.paths import STANDARD_STREAM, ResultFolder
from shapefit.dictionary.model import SUITS, Dictionary, describe_learning
from shapefit.errors import InputError, input_error
from shapefit.io import LandmarkSet, open_landmarks
from shapefit.io.formats import find_target_format
from shapefit.io.options import InputOptions, input_options
from shapefit.lifting.methods import AUTO, METHODS, find_conflict
from shapefit.pipelines.fit.camera import undistorted
from shapefit.pipelines.fit.lift import check_omitted
from shapefit.pipelines.fit.lifter import Lifter, check_needs, lifter_of
from shapefit.pipelines.fit.sample import Estimates, estimate
from shapefit.pipelines.joints import MEANS, Matched, match_names

if TYPE_CHECKING:
    from shapefit.io.readers.calibration import CalibratedCamera

FIRST = 1024
"""Images of which the sample is drawn: the same whatever the chunks and parts."""

FRAMES, COUNTED = 10, 4096
"""Frames of a sequence whose motion says something of its shapes; images that are counted."""

OF_PEOPLE: Mapping[str, Mapping[str, float]] = {
    "posterior": {"residual_variance": 0.006, "bar_scale": 1.6},
    "sequences": {"residual_variance": 0.01, "bar_scale": 1.5},
}
"""Keys of `prior` for dictionaries of people, where they are not given."""


@dataclass(frozen=True)
class Setup:
    """A fit in which nothing is left open: config with estimates, theta, skeleton of the detector.

    place is that of landmark names in messages.
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
    """Return what lifts landmarks of these names; of `first` images what is open is estimated."""
    method, camera = METHODS[config.method], None
    if method.has_prior and dictionary.p_value_table is None:
        from shapefit.pipelines.learn_dict.from_3d import with_p_value_table

        dictionary = with_p_value_table(dictionary)  # not learned by this version
    place = ", ".join(map(str, config.landmarks)) + ": landmark names"
    matched = match_names(landmark_names, dictionary, place, in_place=method.has_prior)
    check_needs(config.method, matched.dictionary, config.dictionary)
    if config.camera.calibration is not None:
        from shapefit.io.readers.calibration import read_camera

        camera = read_camera(config.camera.calibration, config.camera.name)
    if estimates is None:
        images = undistorted(first(), camera)
        if config.leave_one_out is not None:
            check_omitted(images, lifter_of(config, dictionary))
        estimates = estimate(config, dictionary, matched, images)
    config = config.changed(**estimates.values)
    theta = {**MEANS, **(config.skeleton or {})}
    lifter = lifter_of(config, matched.observed(theta))
    # with a prior covariances serve the expected error, and the error bars of joints
    wanted = lifter.posterior.covariance or method.has_prior
    options = replace(lifter.posterior, growth=tuple(estimates.growth), covariance=wanted)
    lifter = replace(lifter, posterior=options)
    return Setup(config, matched, lifter, theta, camera, estimates, place)


def choose_method(
    config: FitConfig, dictionary: Dictionary, has_sequences: Callable[[], bool]
) -> tuple[FitConfig, str]:
    """Return the config with the method that suits dictionary and images, and a line about it."""
    line = ""
    if config.method == AUTO:
        prior = dictionary.prior is not None
        method = ("sequences" if has_sequences() else "posterior") if prior else "convex"
        if find_conflict(config.changed(method=method)) is not None:
            method = "convex"
        config = config.changed(method=method)
        if (conflict := find_conflict(config)) is not None:
            fault, _, fix = conflict.partition("; ")
            raise input_error("fit", fault, fix)
        line = f"{method} (the dictionary has {'a' if prior else 'no'} prior; change with --method)"
    if "people" in dictionary.provenance.get(SUITS, "").split() and config.method in OF_PEOPLE:
        given = config.prior.model_fields_set
        values = OF_PEOPLE[config.method].items()
        config = config.changed(prior={key: value for key, value in values if key not in given})
    resolved = {"tolerance": config.solver_tolerance, "save": {"proof": config.saves_proof}}
    return config.changed(**resolved), line


def in_sequences(config: FitConfig) -> bool:
    """Whether the images are frames of sequences, by the first COUNTED of them."""
    if STANDARD_STREAM in config.landmarks:  # which cannot be read twice
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


def read_options(config: FitConfig) -> InputOptions:
    """Return how the landmark files are read; detections are tracked where motion is needed."""
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
    """Say what is doubtful of a dictionary: how it was learned, and for which methods."""
    warnings = describe_learning(dictionary)
    learned, wanted = dictionary.provenance.get("method"), METHODS[config.method].learned
    if learned is not None and wanted and learned not in wanted and not config.signed:
        made = f"{config.method} is made for {' or '.join(wanted)}"
        warnings += (f"the dictionary was learned with `method: {learned}`; {made}",)
    return warnings

"""What a fit needs before it lifts: the default config, estimates of the first images, the setup.

Camera and skeleton are estimated once, of all inputs together, and every part is given the same.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from shapefit.arrays import Floats, median
from shapefit.config import FitConfig, find_config, load_config
from shapefit.config.commands.fit_sections import CAMERA_MATRIX, PosteriorConfig
from shapefit.config.loader import find_presets
from shapefit.config.paths import STANDARD_STREAM, ResultFolder
from shapefit.dictionary.model import LEARNED_FROM, SUITS, Dictionary, describe_learning
from shapefit.errors import InputError, input_error
from shapefit.io import LandmarkSet, open_landmarks
from shapefit.io.dictionaries import has_prior, read_provenance
from shapefit.io.formats import HDF5, FileFormat, detect_format, group_inputs
from shapefit.io.options import InputOptions, input_options
from shapefit.io.records import concatenate
from shapefit.io.skeletons import THETA
from shapefit.io.writing import find_target_format
from shapefit.lifting.methods import METHODS, find_conflict
from shapefit.pipelines.fit.camera import (
    DISTORTION,
    IMAGE_SIZE,
    choose_camera,
    find_calibrated,
    straightened,
    without_camera,
)
from shapefit.pipelines.fit.checks import check_camera, check_labels, log_evidence
from shapefit.pipelines.fit.lift import check_items, check_needs, find_misfit, load_steps
from shapefit.pipelines.items import spread
from shapefit.pipelines.joints import (
    MEANS,
    Joints,
    LandmarkMap,
    find_dependents,
    find_joints,
    is_of_people,
    match_names,
    of_files,
)

if TYPE_CHECKING:
    from shapefit.io.foreign.calibration import CalibratedCamera

FIRST = 1024
"""Images that are looked at: the same whatever the chunks and parts."""

IMAGES, FEWEST_SEEN = 20, 8
"""Images that are lifted, spread over those that are looked at, and landmarks of each of them."""

STEPS = (-0.2, -0.1, 0.0, 0.1, 0.2)
"""Of the logarithm of a parameter, tried about its mean, and half of them about the best."""

OF_CAMERAS = (CAMERA_MATRIX, DISTORTION, IMAGE_SIZE)
"""Datasets of landmarks that say how the camera saw them."""

KEYS = {"camera": ("model", "focal", "intrinsics", "principal_point"), "posterior": ("widening",)}
"""Keys of sections that are estimated; `theta` is the other one."""

ENOUGH = 10
"""Frames of a sequence whose motion says something of its shapes."""

LOOKED_AT = 4096
"""Images whose sequences are counted."""

WITH_PRIOR = ("posterior", "sequences")
"""The methods of a dictionary with a prior: for single images, for whole sequences."""


@dataclass(frozen=True, kw_only=True)
class Setup:
    """A fit in which nothing is left open.

    config      with what was estimated
    dictionary  as these files need it, and its own landmarks
    mapped      which landmarks of the files stand for joints of the dictionary, and where they lie
    seen        the dictionary of these landmarks
    camera      the calibrated camera that took the images, where one is given
    lengths     (e,) of the bones, where the config knows them
    place       of the landmark names of the files, for messages
    leave_out   whether the files have landmarks that the fit does without
    """

    config: FitConfig
    dictionary: Dictionary
    mapped: LandmarkMap
    seen: Dictionary
    camera: CalibratedCamera | None
    lengths: Floats | None
    place: str
    leave_out: bool

    @property
    def joints(self) -> Joints:
        """The landmarks of the files that stand for joints."""
        return self.mapped.joints


def set_up(config: FitConfig, dictionary: Dictionary, landmark_names: Sequence[str]) -> Setup:
    """Return what lifts landmarks of these names.

    Raises InputError where the dictionary lacks what the method needs, it and the landmarks have
    too few names in common, or the output cannot hold what the config asks for.
    """
    method = METHODS[config.method]
    dictionary = of_files(dictionary, landmark_names, in_place=method.has_prior)
    if config.transforms and output_format(config).points_only:
        found = f"cannot be stored in {config.output}: CSV holds points only"
        raise input_error("transforms", found, "name an HDF5 output, or leave it out")
    place = ", ".join(map(str, config.landmarks)) + ": landmark names"
    joints, unknown = match_names(
        landmark_names, dictionary.landmark_names, place, in_place=method.has_prior
    )
    calibrated = find_calibrated(config.camera)
    dependents = find_dependents(dictionary)
    mapped = LandmarkMap(
        joints,
        config.theta or MEANS,
        method.has_prior and bool(joints.markers or dependents is not None),
        config.posterior.covariance,
        dependents,
        find_misfit(config, dictionary),
    )
    seen, lengths = mapped.apply(dictionary), None
    check_needs(config, seen)
    if method.sequences and config.sequences.lengths is not None:
        from shapefit.pipelines.fit.sequences import find_lengths

        lengths = find_lengths(config.sequences.lengths, seen)
    if config.leave_out is not None:
        check_items(seen)
    load_steps(config)
    return Setup(
        config=config,
        dictionary=dictionary,
        mapped=mapped,
        seen=seen,
        camera=calibrated,
        lengths=lengths,
        place=place,
        leave_out=bool(unknown),
    )


def warn_of_dictionary(config: FitConfig, dictionary: Dictionary) -> tuple[str, ...]:
    """Say what is doubtful of a dictionary: how it was learned, and for which methods.

    One that does not state how it was learned passes, and any where signs are free.
    """
    learned, wanted = dictionary.provenance.get("method"), METHODS[config.method].learned
    of_learning = describe_learning(dictionary)
    if learned is None or not wanted or config.alternation.signed or learned in wanted:
        return of_learning
    kinds = " or ".join(f"`{kind}`" for kind in wanted)
    if len(wanted) == 1:
        kinds = f"`method: {wanted[0]}`"
    found = f"the dictionary was learned with `method: {learned}`"
    return (f"{found}; {config.method} is made for {kinds}", *of_learning)


def output_format(config: FitConfig) -> FileFormat:
    """Return the format of the results."""
    if isinstance(config.output, ResultFolder):
        return HDF5
    return find_target_format(config.output)


def read_options(config: FitConfig) -> InputOptions:
    """Return how the landmark files are read.

    Detections without identity are joined to sequences where those are needed.
    """
    joined = output_format(config).by_sequence or METHODS[config.method].sequences
    return input_options(config.input, "motion" if joined else "none")


@dataclass(frozen=True)
class Estimates:
    """What was estimated: values for keys of a config, lines that say so, and warnings.

    sections (name -> key -> value) and theta are as JSON holds them.
    """

    sections: Mapping[str, Mapping[str, Any]]
    theta: Mapping[str, float] | None
    lines: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()

    @classmethod
    def of(
        cls, config: FitConfig, lines: tuple[str, ...] = (), warnings: tuple[str, ...] = ()
    ) -> Estimates:
        """Return what a config holds that has nothing left open."""
        sections = {
            name: {key: getattr(getattr(config, name), key) for key in keys}
            for name, keys in KEYS.items()
        }
        return cls(sections, config.theta, lines, warnings)

    @classmethod
    def restored(cls, plain: Mapping[str, Any]) -> Estimates:
        """Return the estimates that JSON holds; other keys are ignored."""
        texts = (tuple(plain[name]) for name in ("lines", "warnings"))
        return cls(plain["sections"], plain["theta"], *texts)

    def apply(self, config: FitConfig) -> FitConfig:
        """Return the config with nothing left open."""
        changed: dict[str, object] = {"theta": None if self.theta is None else dict(self.theta)}
        for name, values in self.sections.items():
            own = {key: tuple(v) if isinstance(v, list) else v for key, v in values.items()}
            changed[name] = getattr(config, name).model_copy(update=own)
        posterior = changed["posterior"]
        assert isinstance(posterior, PosteriorConfig)
        changed["posterior"] = posterior.model_copy(update={"calibration": None})
        return config.model_copy(update=changed)


def prepare(
    config: FitConfig, dictionary: Dictionary, first: Callable[[], LandmarkSet]
) -> Estimates:
    """Estimate the camera, then the skeleton as it sees it, and check both on a sample.

    `first` reads the first images; methods without a prior estimate nothing. A class that was
    learned of landmarks under weak perspective is seen so unless a calibration is given: it has the
    sizes that weak perspective gave it, and a matrix of the files has told near from far already.
    Raises InputError where the dictionary lacks what the method needs, and as `find_calibrated`.
    """
    check_needs(config, dictionary)
    calibrated = find_calibrated(config.camera)
    if not METHODS[config.method].has_prior:
        return Estimates.of(without_camera(config))
    images = first()
    config, of_bars = with_calibration(config)
    images = straightened(images, calibrated)
    own = of_files(dictionary, images.landmark_names)
    if LEARNED_FROM in own.provenance and calibrated is None:
        config = without_camera(config)
    measured = calibrated is not None or CAMERA_MATRIX in images.columns
    is_checked = measured and config.camera.model == "auto"
    of_people = is_of_people(own.landmark_names)
    config, of_camera = choose_camera(config, images, of_people=of_people, paths=config.landmarks)
    seen = np.flatnonzero(images.seen().sum(axis=1) >= FEWEST_SEEN)
    sample = images.take(seen[list(spread(IMAGES, len(seen)))])
    config, of_skeleton = with_theta(config, sample, own)
    warnings = check_camera(sample, config, own) if is_checked else ()
    warnings += check_labels(config, images, dictionary)
    return Estimates.of(config, of_camera + of_skeleton + of_bars, warnings)


def first_images(config: FitConfig) -> LandmarkSet:
    """Return the FIRST images of all inputs, each read by itself, with what else estimates need.

    Inputs that cannot be read are left out: their part reports them. Raises InputError where none
    of them can be read.
    """
    options, found, count = read_options(config), list[LandmarkSet](), 0
    unreadable: InputError | None = None
    for paths in _recordings(config.landmarks, options.format):
        try:
            known = detect_format(paths[0], options.format)
            rows = None if known.reader is None else slice(0, FIRST - count)
            with open_landmarks(paths, options, rows) as source:
                images = source.first(FIRST - count)
        except InputError as error:
            unreadable = unreadable or error
            continue
        found.append(images)
        count += len(images)
        if count >= FIRST:
            break
    if unreadable is not None and not count:
        raise unreadable
    return _joined([images for images in found if len(images)] or found[:1])


def _recordings(paths: Sequence[Path], name: str) -> Iterator[tuple[Path, ...]]:
    """Yield the inputs in order, those that are one recording together; few are looked at."""
    done = set[Path]()
    for path in paths:
        if path in done:
            continue
        try:
            together = detect_format(path, name).together and not path.is_dir()
        except InputError:
            together = False
        own: tuple[Path, ...] = (path,)
        if together:
            near = [each for each in paths if each.parent == path.parent]
            groups = group_inputs(near, InputOptions(format=name))
            own = next(own for _, own in groups if path in own)
        done |= {*own}
        yield own


def _joined(sets: Sequence[LandmarkSet]) -> LandmarkSet:
    """Join images of several inputs; of their datasets those of cameras that all of them have."""
    first = sets[0]
    if len(sets) == 1:
        return first
    names = tuple(dict.fromkeys(name for images in sets for name in images.landmark_names))
    kept = [name for name in OF_CAMERAS if all(name in images.columns for images in sets)]
    scored = any(images.confidence is not None for images in sets)
    following = all(images.sequences is not None for images in sets)

    def alike(images: LandmarkSet) -> LandmarkSet:
        n, values = len(images), {name: np.asarray(images.columns[name]) for name in kept}
        confidence = images.confidence
        if scored and confidence is None:
            confidence = np.ones((n, len(images.landmark_names)))
        bare = images.without(images.further.keys()).replaced(
            confidence=confidence, sequences=images.sequences if following else None
        )
        of_each = {
            name: np.broadcast_to(v, (n, *v.shape)) if name in images.of_file else v
            for name, v in values.items()
        }
        return bare.arrange(names).with_columns(of_each)

    joined = concatenate([alike(images) for images in sets])
    whole = {name for name in kept if all(name in images.of_file for images in sets)}
    values = {name: joined.columns[name] for name in whole}
    equal = {name: v[0] for name, v in values.items() if (v == v[0]).all()}
    return joined.with_columns(equal, of_file=equal)


def with_theta(
    config: FitConfig, sample: LandmarkSet, dictionary: Dictionary
) -> tuple[FitConfig, tuple[str, ...]]:
    """Return the config with the parameters of the skeleton: as given, else found, else usual."""
    joints = find_joints(sample.landmark_names, dictionary.landmark_names)
    given: Mapping[str, float] = config.theta or {}
    names = [name for name in joints.parameters if name not in given]
    if not joints.markers:
        return config, ()
    if not names or not len(sample):
        return config.model_copy(update={"theta": {**MEANS, **given}}), ()

    def evidence(theta: Mapping[str, float]) -> float:
        changed = config.model_copy(update={"theta": dict(theta)})
        return float(np.nansum(log_evidence(sample, changed, dictionary)))

    found = find_theta(evidence, names, given)
    told = ", ".join(
        f"{name} {found.theta[name]:.2f}"
        + (f" +- {found.theta[name] * found.spread[name]:.2f}" if name in found.spread else "")
        for name in names
    )
    return config.model_copy(update={"theta": found.theta}), (f"skeleton: {told}",)


class SkeletonParameters(NamedTuple):
    """A theta, and the standard deviations of the logarithms of its parameters."""

    theta: dict[str, float]
    spread: dict[str, float]


def find_theta(
    evidence: Callable[[Mapping[str, float]], float],
    names: Sequence[str],
    fixed: Mapping[str, float],
) -> SkeletonParameters:
    """Maximise the posterior of the named parameters, one after the other, twice.

    evidence is log p(w | theta); `fixed` parameters stay. Each is taken to the top of the parabola
    through the best value tried and its neighbours, whose curvature gives its spread.
    """
    theta = {name: parameter.mean for name, parameter in THETA.items()} | dict(fixed)
    spread: dict[str, float] = {}
    for factor in (1.0, 0.5):
        for name in names:
            if name in fixed:
                continue
            mean, wide = THETA[name].mean, THETA[name].spread
            tried = np.log(theta[name]) + factor * np.array(STEPS)
            values = np.array(
                [
                    evidence(theta | {name: float(np.exp(x))})
                    - 0.5 * ((x - np.log(mean)) / wide) ** 2
                    for x in tried
                ]
            )
            best = min(max(int(np.argmax(values)), 1), len(tried) - 2)
            below, at, above = values[best - 1 : best + 2]
            step = tried[1] - tried[0]
            curvature = (2 * at - below - above) / step**2
            top = tried[int(np.argmax(values))]
            if curvature > 0:
                top = tried[best] + np.clip((above - below) / (2 * step * curvature), -step, step)
                spread[name] = float(curvature**-0.5)
            theta[name] = float(np.exp(top))
    return SkeletonParameters(theta, spread)


def with_calibration(config: FitConfig) -> tuple[FitConfig, tuple[str, ...]]:
    """Return the config with covariances as much wider as `posterior.calibration` says, and a line.

    By the factors of its method, or of the only one of the report. Raises InputError for a file
    that has none.
    """
    path = config.posterior.calibration
    if path is None:
        return config, ()
    try:
        factors = json.loads(path.read_text(encoding="utf-8"))
        name = config.method if config.method in factors else next(iter(factors))
        half, most = (factors[name][level] for level in ("50%", "90%"))
        known = None in (half, most) or (half > 0 and most > 0)
    except (OSError, ValueError, KeyError, TypeError, StopIteration):
        known = False
    if not known:
        found = "holds no factors of error bars"
        raise input_error(path, found, "give error_bars.json of a report of eval")
    if name != config.method and len(factors) > 1:
        found = f"has factors of {', '.join(factors)}, not of {config.method}"
        raise input_error(path, found, f"judge one result alone, or call it {config.method}")
    if None in (half, most):
        found = "has no factor: too few landmarks, or error bars that are far too narrow"
        raise input_error(path, found, "judge more images, or with a larger `posterior.widening`")
    widening = config.posterior.widening * most**2
    posterior = config.posterior.model_copy(update={"widening": widening, "calibration": None})
    line = (
        f"error bars {most:.2f} times as wide, by {path.name}: 90% of that truth is in the 90% "
        f"ellipsoids, 50% in {half / most:.2f} times the 50% ellipsoids"
    )
    return config.model_copy(update={"posterior": posterior}), (line,)


class Default(NamedTuple):
    """The name of an installed config, or else a method; both None where the schema's serve."""

    config: str | None = None
    method: str | None = None


def choose_default(config: FitConfig) -> Default:
    """Return the default for the dictionary and the images of a config, which may lack its inputs.

    A dictionary names an installed config for single images and, after it, one for whole
    sequences. One that names none and has a prior over shapes is fitted by it, unless the config
    asks for what these methods do not have. Where the method is set, the config that has it is
    meant.
    """
    try:
        known = {} if config.dictionary is None else read_provenance(config.dictionary)
        prior = config.dictionary is not None and has_prior(config.dictionary)
    except InputError:  # the fit says what is wrong with it
        return Default()
    method = config.method if "method" in config.model_fields_set else None
    found = choose_by_dictionary(known, method, lambda: in_sequences(config), prior=prior)
    return found if fits(found, config) else Default()


def choose_by_dictionary(
    provenance: Mapping[str, str],
    method: str | None,
    has_sequences: Callable[[], bool],
    *,
    prior: bool,
) -> Default:
    """Choose by what a dictionary says of itself, and by whether the images are of sequences."""
    suits = [name for name in provenance.get(SUITS, "").split() if name in find_presets("fit")]
    if method is not None:
        return Default(next((name for name in suits if method_of(name) == method), None))
    if not suits and prior:
        return Default(method=WITH_PRIOR[has_sequences()])
    if len(suits) < 2:
        return Default(next(iter(suits), None))
    return Default(suits[has_sequences()])


def fits(default: Default, config: FitConfig) -> bool:
    """Whether nothing that the config asks for is in conflict with a default method."""
    if default.method is None:
        return True
    return find_conflict(config.model_copy(update={"method": default.method})) is None


def method_of(name: str) -> str:
    """Return the method of an installed config."""
    config = load_config("fit", find_config("fit", Path(name)), to_show=True)
    assert isinstance(config, FitConfig)
    return config.method


def in_sequences(config: FitConfig) -> bool:
    """Whether the images are frames of sequences: at least half of them of ENOUGH or more.

    The first LOOKED_AT are counted; what comes by standard input cannot be read twice.
    """
    if not config.landmarks or STANDARD_STREAM in config.landmarks:
        return False
    options = replace(input_options(config.input, "motion"), rename={})
    try:
        with open_landmarks(config.landmarks, options) as source:
            first = next(iter(source.batches(LOOKED_AT)), None)
    except InputError:  # no frames of a video; what is wrong with files the fit says itself
        return False
    return first is not None and are_long(first.sequences)


def are_long(sequences: Sequence[str] | None) -> bool:
    """Whether at least half of the images are of sequences of ENOUGH or more."""
    if not sequences:
        return False
    _, which, counts = np.unique(sequences, return_inverse=True, return_counts=True)
    return median(counts[which]) >= ENOUGH

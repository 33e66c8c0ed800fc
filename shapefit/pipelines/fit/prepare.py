"""What a fit needs before it lifts: the default config, estimates of the first images, the setup.

Camera and skeleton are estimated once, of all inputs together, and every part is given the same.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from pydantic import BaseModel

from shapefit.arrays import Floats
from shapefit.config import FitConfig
from shapefit.config.paths import ResultFolder
from shapefit.dictionary.model import LEARNED_FROM, Dictionary, describe_learning
from shapefit.errors import InputError, input_error
from shapefit.geometry.pinhole import CAMERA_MATRIX
from shapefit.io import LandmarkSet, open_landmarks
from shapefit.io.formats import HDF5, FileFormat, find_target_format
from shapefit.io.layout import LANDMARK_COVARIANCE
from shapefit.io.options import InputOptions, input_options
from shapefit.io.records import concatenate
from shapefit.io.skeletons import THETA
from shapefit.lifting.methods import METHODS
from shapefit.pipelines.fit.camera import (
    DISTORTION,
    IMAGE_SIZE,
    WEAK,
    choose_camera,
    find_calibrated,
    straightened,
)
from shapefit.pipelines.fit.checks import check_camera, check_labels, log_evidence
from shapefit.pipelines.fit.lift import check_items, check_needs, find_residual_variance, load_steps
from shapefit.pipelines.fit.width import choose_width
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
    from shapefit.io.readers.calibration import CalibratedCamera
    from shapefit.pipelines.partition.plan import Part

FIRST = 1024
"""Images that are looked at: the same whatever the chunks and parts."""

IMAGES, FEWEST_SEEN = 20, 8
"""Images that are lifted, spread over those that are looked at, and landmarks of each of them."""

OF_CAMERAS = (CAMERA_MATRIX, DISTORTION, IMAGE_SIZE)
"""Datasets of landmarks that say how the camera saw them."""

NOT_READ = ("output", "scheduler_file")
"""Keys of one file that results do not depend on."""

STEPS = (-0.2, -0.1, 0.0, 0.1, 0.2)
"""Of the logarithm of a parameter, tried about its mean, and half of them about the best."""


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
    place = ", ".join(map(str, config.landmarks)) + ": landmark names"
    joints, unknown = match_names(
        landmark_names, dictionary.landmark_names, place, in_place=method.has_prior
    )
    calibrated = find_calibrated(config.camera)
    dependents = find_dependents(dictionary)
    mapped = LandmarkMap(
        joints,
        config.skeleton or MEANS,
        method.has_prior and bool(joints.markers or dependents is not None),
        config.save.covariance,
        dependents,
        find_residual_variance(config, dictionary),
    )
    seen, lengths = mapped.apply(dictionary), None
    check_needs(config, seen)
    if method.sequences and config.bone_lengths is not None:
        from shapefit.pipelines.fit.sequences import find_lengths

        lengths = find_lengths(config.bone_lengths, seen)
    if config.leave_one_out is not None:
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
    if learned is None or not wanted or config.signed or learned in wanted:
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


def files_of(config: BaseModel, prefix: str = "") -> dict[str, Path]:
    """Return what results depend on beside landmarks: the keys of a config that name one file."""
    found: dict[str, Path] = {}
    for key in type(config).model_fields:
        value = getattr(config, key)
        if isinstance(value, BaseModel):
            found |= files_of(value, f"{prefix}{key}.")
        elif isinstance(value, Path) and key not in NOT_READ and value.is_file():
            found[f"{prefix}{key}"] = value
    return found


def read_options(config: FitConfig) -> InputOptions:
    """Return how the landmark files are read.

    Detections without identity are joined to sequences where those are needed.
    """
    joined = output_format(config).in_metres or METHODS[config.method].sequences
    return input_options(config, "motion" if joined else "none")


@dataclass(frozen=True)
class Estimates:
    """What was estimated: values for keys of a config, lines that say so, and warnings.

    values are as `FitConfig.changed` takes them and JSON holds them.
    """

    values: Mapping[str, Any]
    lines: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()


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
    is_open = config.camera.model == "auto"
    method = METHODS[config.method]
    if not method.has_prior:
        measured = calibrated is not None and method.perspective == "refined"
        camera = {"focal": "files"} if measured else WEAK
        return Estimates({"camera": camera} if is_open else {})
    images = first()
    bars, of_bars = read_widening(config)
    images = straightened(images, calibrated)
    own = of_files(dictionary, images.landmark_names)
    camera, of_camera = WEAK if is_open else {}, ""
    if LEARNED_FROM not in own.provenance or calibrated is not None:
        of_people = is_of_people(own.landmark_names)
        camera, of_camera = choose_camera(
            config, images, of_people=of_people, paths=config.landmarks
        )
    config = config.changed(camera=camera, prior=bars)
    seen = np.flatnonzero(images.seen().sum(axis=1) >= FEWEST_SEEN)
    sample = images.take(seen[list(spread(IMAGES, len(seen)))])
    theta, of_skeleton = choose_theta(config, sample, own)
    config = config.changed(skeleton=theta)
    measured = calibrated is not None or CAMERA_MATRIX in images.columns
    warnings = check_camera(sample, config, own) if measured and is_open and camera != WEAK else ()
    of_labels = check_labels(config, images, dictionary)
    # a wide prior would take wrong names for poses that it lacks
    width, of_width = choose_width(config, images, dictionary, learned=bool(of_labels))
    lines = tuple(filter(None, (of_camera, of_skeleton, of_width, of_bars)))
    values = {"camera": camera, "prior": {**bars, **width}, "skeleton": theta}
    return Estimates(values, lines, warnings + of_labels)


def read_widening(config: FitConfig) -> tuple[dict[str, Any], str]:
    """Return the keys of `posterior` that its `calibration` stands for, and a line about them.

    By the factors of the method, or of the only one of the report. Raises InputError for a file
    that has none.
    """
    path = config.prior.calibration
    if path is None:
        return {}, ""
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
        raise input_error(path, found, "judge more images, or with a larger `prior.bar_scale`")
    return {"bar_scale": config.prior.bar_scale * most**2, "calibration": None}, (
        f"error bars {most:.2f} times as wide, by {path.name}: 90% of that truth is in the 90% "
        f"ellipsoids, 50% in {half / most:.2f} times the 50% ellipsoids"
    )


def first_images(config: FitConfig, parts: Iterable[Part]) -> LandmarkSet:
    """Return the FIRST images of all parts, each read by itself, with what else estimates need.

    Inputs that cannot be read are left out: their part reports them. Raises InputError where none
    of them can be read.
    """
    options, found, left = read_options(config), list[LandmarkSet](), FIRST
    unreadable: InputError | None = None
    for part in parts:
        start, stop = part.rows or (0, FIRST)
        try:
            rows = slice(start, min(stop, start + left))
            with open_landmarks(part.inputs, options, rows) as source:
                found.append(source.first(left))
        except InputError as error:
            unreadable = unreadable or error
            continue
        left -= len(found[-1])
        if not left:
            break
    if unreadable is not None and left == FIRST:
        raise unreadable
    kept = (*OF_CAMERAS, LANDMARK_COVARIANCE, config.camera.matrices)
    return _joined([images for images in found if len(images)] or found[:1], filter(None, kept))


def _joined(sets: Sequence[LandmarkSet], datasets: Iterable[str]) -> LandmarkSet:
    """Join images of several inputs, with those of the datasets that all of them have.

    What is of the file becomes one of the images where the files differ.
    """
    first = sets[0]
    if len(sets) == 1:
        return first
    names = tuple(dict.fromkeys(name for images in sets for name in images.landmark_names))
    kept = [name for name in datasets if all(name in images.columns for images in sets)]
    scored = any(images.confidence is not None for images in sets)
    following = all(images.sequences is not None for images in sets)
    whole = {
        name
        for name in kept
        if all(name in each.whole for each in sets)
        and all(np.array_equal(each.columns[name], first.columns[name]) for each in sets)
    }

    def alike(images: LandmarkSet) -> LandmarkSet:
        images = images.arrange(names)
        columns = {name: np.asarray(images.columns[name]) for name in kept}
        for name in images.whole.keys() & columns.keys() - whole:
            columns[name] = np.broadcast_to(columns[name], (len(images), *columns[name].shape))
        bare = images.without(images.further.keys()).replaced(
            confidence=images.weights() if scored else None,
            sequences=images.sequences if following else None,
        )
        of_file = {name: columns.pop(name) for name in whole}
        return bare.with_columns(columns, of_file)

    return concatenate([alike(images) for images in sets])


def choose_theta(
    config: FitConfig, sample: LandmarkSet, dictionary: Dictionary
) -> tuple[dict[str, float] | None, str]:
    """Return the parameters of the skeleton, as given, else found, else usual; and a line."""
    joints = find_joints(sample.landmark_names, dictionary.landmark_names)
    given = dict(config.skeleton or {})
    names = [name for name in joints.parameters if name not in given]
    if not joints.markers:
        return config.skeleton, ""
    if not names or not len(sample):
        return {**MEANS, **given}, ""

    def evidence(theta: Mapping[str, float]) -> float:
        return float(np.nansum(log_evidence(sample, config.changed(skeleton=theta), dictionary)))

    theta, deviation = maximise_theta(evidence, names, {**MEANS, **given})
    told = ", ".join(
        f"{name} {theta[name]:.2f}"
        + (f" +- {theta[name] * deviation[name]:.2f}" if name in deviation else "")
        for name in names
    )
    return theta, f"skeleton: {told}"


def maximise_theta(
    evidence: Callable[[Mapping[str, float]], float], names: Sequence[str], start: dict[str, float]
) -> tuple[dict[str, float], dict[str, float]]:
    """Maximise log p(w | theta) + log p(theta) over the named parameters, one by one, twice.

    Each is taken to the top of the parabola through the best value tried and its neighbours.
    Returns theta, and the standard deviations of logarithms that the curvature gives.
    """
    theta, deviation = dict(start), dict[str, float]()
    for factor in (1.0, 0.5):
        for name in names:
            mean, wide = THETA[name].mean, THETA[name].std
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
                deviation[name] = float(curvature**-0.5)
            theta[name] = float(np.exp(top))
    return theta, deviation

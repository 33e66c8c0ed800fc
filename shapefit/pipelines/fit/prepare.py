"""What a fit needs before it lifts: names, camera, and one sample for all that is estimated.

Camera, skeleton and prior scale are estimated once, of all inputs together, and every part is given
the same.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from pydantic import BaseModel

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
from shapefit.lifting.methods import METHODS
from shapefit.pipelines.fit.camera import (
    DISTORTION,
    IMAGE_SIZE,
    choose_camera,
    find_calibrated,
    straightened,
)
from shapefit.pipelines.fit.checks import check_bars, check_sides, check_skeleton
from shapefit.pipelines.fit.lift import (
    Lifter,
    check_items,
    check_needs,
    lifter_of,
    load_steps,
    weigh,
)
from shapefit.pipelines.fit.sample import choose_scale, choose_skeleton, draw_sample
from shapefit.pipelines.joints import MEANS, LandmarkMap, Matched, find_dependents, match_names

if TYPE_CHECKING:
    from shapefit.io.readers.calibration import CalibratedCamera
    from shapefit.pipelines.partition.plan import Part

FIRST = 1024
"""Images of which the sample is drawn: the same whatever the chunks and parts."""

OF_CAMERAS = (CAMERA_MATRIX, DISTORTION, IMAGE_SIZE)
"""Datasets of landmarks that say how the camera saw them."""

NOT_READ = ("output", "scheduler_file")
"""Keys of one file that results do not depend on."""


@dataclass(frozen=True)
class Estimates:
    """What was estimated: values for keys of a config, lines that say so, and warnings.

    values are as `FitConfig.changed` takes them and JSON holds them; the camera line is the first.
    doubt says why no image is to be trusted, "" for nothing; growth (p,) and known, see `Bars`.
    """

    values: Mapping[str, Any]
    lines: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    doubt: str = ""
    growth: tuple[float, ...] = ()
    known: Mapping[str, float] = field(default_factory=dict)


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
        return self.matched.arrange(straightened(images, self.camera), self.place)


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
    estimates = estimates or estimate(config, dictionary, matched, camera, first)
    config = config.changed(**estimates.values)
    mapped = map_landmarks(config, matched)
    seen, lengths = mapped.apply(matched.dictionary), None
    if method.sequences and config.bone_lengths is not None:
        from shapefit.pipelines.fit.sequences import find_lengths

        lengths = find_lengths(config.bone_lengths, seen)
    if config.leave_one_out is not None:
        check_items(seen)
    lifter = replace(lifter_of(config, seen, lengths), growth=tuple(estimates.growth))
    if method.has_prior:  # for the expected error, and the error bars of joints
        lifter = replace(lifter, covariance=True)
    load_steps(lifter)
    return Setup(
        config=config,
        matched=matched,
        mapped=replace(mapped, residual_variance=lifter.variance),
        lifter=lifter,
        camera=camera,
        estimates=estimates,
        place=place,
    )


def map_landmarks(config: FitConfig, matched: Matched) -> LandmarkMap:
    """Return where the landmarks lie that stand for joints, by the skeleton of the config."""
    dependents = find_dependents(matched.dictionary)
    return LandmarkMap(
        matched.joints,
        {**MEANS, **(config.skeleton or {})},
        METHODS[config.method].has_prior and bool(matched.joints.markers or dependents is not None),
        METHODS[config.method].has_prior,
        dependents,
    )


def estimate(
    config: FitConfig,
    dictionary: Dictionary,
    matched: Matched,
    calibrated: CalibratedCamera | None,
    first: Callable[[], LandmarkSet],
) -> Estimates:
    """Estimate the camera and, for methods with a prior, skeleton and prior scale by evidence.

    Of one sample of the first images, which also says whether names and sides are right.
    """
    read: list[LandmarkSet] = []

    def images() -> LandmarkSet:
        if not read:
            read.append(straightened(first(), calibrated))
        return read[0]

    learned_from = matched.dictionary.provenance.get(LEARNED_FROM) is not None
    camera, line = choose_camera(config, images, from_landmarks=learned_from)
    values: dict[str, Any] = {"camera": camera}
    lines = [f"camera: {line}"]
    if not METHODS[config.method].has_prior:
        return Estimates(values, tuple(lines))
    bars, of_bars = read_bar_scale(config)
    widening = config.prior.bar_scale  # a report judged bars that hidden landmarks had widened
    config = config.changed(camera=camera, prior=bars)
    lifter = replace(lifter_of(config, matched.dictionary), method="posterior")
    visible = np.flatnonzero(weigh(images(), lifter).any(axis=1))  # the others say nothing
    sample = draw_sample(images().take(visible), matched)
    mapped = map_landmarks(config, matched)

    skeleton, of_skeleton = choose_skeleton(config.skeleton, mapped, sample, lifter)
    mapped = replace(mapped, theta={**MEANS, **(skeleton or {})})
    lifter = replace(lifter, dictionary=mapped.apply(matched.dictionary))
    as_learned = sample.lift(lifter)
    doubt = check_skeleton(sample, as_learned, lifter, dictionary, mapped.theta)
    doubt = doubt or check_sides(sample, as_learned, lifter)
    # a wide prior would take wrong names for poses that it lacks
    open_keys = () if doubt else tuple(k for k in SCALES if getattr(config.prior, k) is None)
    scale, of_scale = choose_scale(open_keys, sample, as_learned, lifter)
    scaled = replace(
        lifter, prior_scale=scale["scale"], residual_variance=scale["residual_variance"]
    )
    before, after = ((each.prior_scale, each.variance) for each in (lifter, scaled))
    found = as_learned if before == after else sample.lift(scaled)
    shown = check_bars(sample, found, scaled, widening)
    values |= {"prior": {**bars, **scale}, "skeleton": skeleton}
    lines += filter(None, (of_skeleton, of_scale, of_bars, shown.line))
    doubt = doubt or shown.doubt
    return Estimates(
        values,
        tuple(lines),
        () if doubt is None else (doubt.warning,),
        "" if doubt is None else doubt.reason,
        shown.growth,
        shown.known,
    )


SCALES = ("scale", "residual_variance")
"""Keys of `prior` that are chosen by evidence."""


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
    values = {"bar_scale": config.prior.bar_scale * most**2, "calibration": None}
    return values, f"error bars x {most:.2f} ({path.name})"


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

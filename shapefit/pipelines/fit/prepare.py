"""What is estimated once from the first images of all inputs, before any is lifted.

The camera, and the parameters theta of the skeleton. Every part of a fit is given the same.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from shapefit.config import FitConfig
from shapefit.config.commands.fit_sections import CAMERA_MATRIX, PosteriorConfig
from shapefit.dictionary.model import LEARNED_FROM, Dictionary
from shapefit.errors import InputError
from shapefit.io import LandmarkSet, LandmarkSource, open_landmarks
from shapefit.io.formats import detect_format, group_inputs
from shapefit.io.options import InputOptions
from shapefit.io.skeletons import THETA
from shapefit.lifting.methods import METHODS
from shapefit.pipelines.fit.assumed_camera import IMAGE_SIZE, choose_camera, without_camera
from shapefit.pipelines.fit.camera import DISTORTION, find_calibrated, straightened
from shapefit.pipelines.fit.checks import Sample, check_sample
from shapefit.pipelines.fit.error_bars import with_calibration
from shapefit.pipelines.fit.labels import check_labels
from shapefit.pipelines.fit.plan import check_needs, read_options
from shapefit.pipelines.items import spread
from shapefit.pipelines.joints import (
    MEANS,
    find_joints,
    is_of_people,
    of_files,
)

Theta = Mapping[str, float]

FIRST = 1024
"""Images that are looked at: the same whatever the chunks and parts."""

IMAGES = 20
"""Images that are lifted, spread over those that are looked at."""

FEWEST_SEEN = 8
"""Landmarks of an image that is lifted."""

STEPS = (-0.2, -0.1, 0.0, 0.1, 0.2)
"""Of the logarithm of a parameter, tried about its mean, and half of them about the best."""

OF_CAMERAS = (CAMERA_MATRIX, DISTORTION, IMAGE_SIZE)
"""Datasets of landmarks that say how the camera saw them."""

KEYS = {"camera": ("model", "focal", "intrinsics", "principal_point"), "posterior": ("widening",)}
"""Keys of sections that are filled in here; `theta` is the other one."""


@dataclass(frozen=True)
class Setup:
    """What was estimated: values for keys of a config, lines that say so, and warnings.

    sections (name -> key -> value) and theta are as JSON holds them.
    """

    sections: Mapping[str, Mapping[str, Any]]
    theta: Mapping[str, float] | None
    lines: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()

    @classmethod
    def of(cls, config: FitConfig, lines: tuple[str, ...], warnings: tuple[str, ...] = ()) -> Setup:
        """Return what a config holds that has nothing left open."""
        sections = {
            name: {key: getattr(getattr(config, name), key) for key in keys}
            for name, keys in KEYS.items()
        }
        return cls(sections, config.theta, lines, warnings)

    @classmethod
    def restored(cls, plain: Mapping[str, Any]) -> Setup:
        """Return the setup that JSON holds; other keys are ignored."""
        texts = (tuple(plain[name]) for name in ("lines", "warnings"))
        return cls(plain["sections"], plain["theta"], *texts)

    def apply(self, config: FitConfig) -> FitConfig:
        """Return the config with nothing left open."""
        changed: dict[str, object] = {"theta": None if self.theta is None else dict(self.theta)}
        for name, values in self.sections.items():
            own = {key: tuple(v) if isinstance(v, list) else v for key, v in values.items()}
            changed[name] = getattr(config, name).model_copy(update=own)
        if config.posterior.calibration is not None:
            posterior = changed["posterior"]
            assert isinstance(posterior, PosteriorConfig)
            changed["posterior"] = posterior.model_copy(update={"calibration": None})
        return config.model_copy(update=changed)


def prepare(config: FitConfig, dictionary: Dictionary, source: LandmarkSource) -> Setup:
    """Estimate by the first images of a source what the config leaves open.

    Raises InputError where the dictionary lacks what the method needs, and as `find_calibrated`.
    """
    check_needs(config, dictionary)
    if not METHODS[config.method].has_prior:
        find_calibrated(config.camera)
        return Setup.of(without_camera(config), ())
    return estimate(config, dictionary, next(source.batches(FIRST)))


def prepare_parts(config: FitConfig, dictionary: Dictionary) -> Setup:
    """Estimate the same of all inputs together, though each of them is read by itself.

    Inputs that cannot be read are left out: their part reports them. Raises InputError as
    `prepare`, and where no input can be read.
    """
    check_needs(config, dictionary)
    if not METHODS[config.method].has_prior:
        find_calibrated(config.camera)
        return Setup.of(without_camera(config), ())
    return estimate(config, dictionary, first_images(config))


def first_images(config: FitConfig) -> LandmarkSet:
    """Return the FIRST images of all inputs, with what else estimates need.

    Raises InputError where none of them can be read.
    """
    options, found, count = read_options(config), list[LandmarkSet](), 0
    unreadable: InputError | None = None
    for paths in _recordings(config.landmarks, options.format):
        try:
            known = detect_format(paths[0], options.format)
            rows = None if known.reader is None else slice(0, FIRST - count)
            with open_landmarks(paths, options, rows) as source:
                images = next(source.batches(FIRST - count))
        except InputError as error:
            unreadable = unreadable or error
            continue
        found.append(images)
        count += len(images)
        if count >= FIRST:
            break
    if unreadable is not None and not count:
        raise unreadable
    return _together([images for images in found if len(images)] or found[:1])


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


def _together(sets: Sequence[LandmarkSet]) -> LandmarkSet:
    """Join images of several inputs; of their datasets those of cameras that all of them have."""
    first = sets[0]
    if len(sets) == 1:
        return first
    names = tuple(dict.fromkeys(name for images in sets for name in images.landmark_names))
    kept = [name for name in OF_CAMERAS if all(name in images.columns for images in sets)]
    scored = any(images.confidence is not None for images in sets)
    following = all(images.sequences is not None for images in sets)
    columns = {name: np.concatenate([_for_each(images, name) for images in sets]) for name in kept}
    of_file = {
        name
        for name, values in columns.items()
        if all(name in images.of_file for images in sets) and (values == values[0]).all()
    }
    return LandmarkSet(
        np.concatenate([images.arrange(names, "landmarks").landmarks for images in sets]),
        names,
        tuple(item for images in sets for item in images.items),
        tuple(name for images in sets for name in images.sequences or ()) if following else None,
        unit=first.unit,
        y_axis=first.y_axis,
        frame_rate=first.frame_rate,
        confidence=np.concatenate([_scores(images, names) for images in sets]) if scored else None,
        columns={n: values[0] if n in of_file else values for n, values in columns.items()},
        of_file=of_file,
    )


def _scores(images: LandmarkSet, names: Sequence[str]) -> NDArray[np.float64]:
    """Return the confidence (n, p) of landmarks with these names: 1 where a file has none."""
    whole = images.confidence
    if whole is None:
        whole = np.ones((len(images), len(images.landmark_names)))
    arranged = images.replaced(confidence=whole).arrange(names, "landmarks").confidence
    assert arranged is not None
    return arranged


def _for_each(images: LandmarkSet, name: str) -> NDArray[Any]:
    """Return a dataset for each image, also where it is of the whole file."""
    values = np.asarray(images.columns[name])
    return (
        np.broadcast_to(values, (len(images), *values.shape)) if name in images.of_file else values
    )


def estimate(config: FitConfig, dictionary: Dictionary, first: LandmarkSet) -> Setup:
    """Estimate the camera, then the skeleton as it sees it, and check both on a sample.

    A class that was learned of landmarks under weak perspective is seen so unless a calibration is
    given: it has the sizes that weak perspective gave it, and a matrix of the files has told near
    from far already.
    """
    calibrated = find_calibrated(config.camera)
    config, of_bars = with_calibration(config)
    images = straightened(first, calibrated)
    whole = dictionary
    measured = calibrated is not None or CAMERA_MATRIX in images.columns
    dictionary = of_files(dictionary, images.landmark_names)
    if LEARNED_FROM in dictionary.provenance and calibrated is None:
        config = without_camera(config)
    is_open = config.camera.model == "auto"
    of_people = is_of_people(dictionary.landmark_names)
    config, of_camera = choose_camera(config, images, of_people=of_people, paths=config.landmarks)
    sample = choose_sample(config, dictionary, images)
    config, of_skeleton = with_theta(sample)
    warnings = check_sample(replace(sample, config=config), camera=is_open and measured)
    warnings += check_labels(config, images, whole)
    return Setup.of(config, of_camera + of_skeleton + of_bars, warnings)


def choose_sample(config: FitConfig, dictionary: Dictionary, images: LandmarkSet) -> Sample:
    """Return IMAGES of the images, spread evenly over those with enough landmarks."""
    joints = find_joints(images.landmark_names, dictionary.landmark_names)
    seen = np.flatnonzero(images.seen().sum(axis=1) >= FEWEST_SEEN)
    some = images.take(seen[list(spread(IMAGES, len(seen)))])
    return Sample(some, config, dictionary, joints)


class Found(NamedTuple):
    """A theta, and the standard deviations of the logarithms of its parameters."""

    theta: dict[str, float]
    spread: dict[str, float]


def with_theta(sample: Sample) -> tuple[FitConfig, tuple[str, ...]]:
    """Return the config with the parameters of the skeleton: as given, else found, else usual."""
    config, joints = sample.config, sample.joints
    given: Theta = config.theta or {}
    names = [name for name in joints.parameters if name not in given]
    if not joints.stand_ins:
        return config, ()
    if not names or not len(sample.images):
        return config.model_copy(update={"theta": {**MEANS, **given}}), ()
    found = find_theta(
        lambda theta: float(np.nansum(sample.log_evidence(theta=dict(theta)))), names, given
    )
    told = ", ".join(
        f"{name} {found.theta[name]:.2f}"
        + (f" +- {found.theta[name] * found.spread[name]:.2f}" if name in found.spread else "")
        for name in names
    )
    return config.model_copy(update={"theta": found.theta}), (f"skeleton: {told}",)


def find_theta(evidence: Callable[[Theta], float], names: Sequence[str], fixed: Theta) -> Found:
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
    return Found(theta, spread)

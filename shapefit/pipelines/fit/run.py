"""`fit`: landmarks in, chunk by chunk, 3D shapes with their certificates out."""

from __future__ import annotations

import hashlib
import json
import math
import time
from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np

from shapefit import __version__
from shapefit.config import FitConfig
from shapefit.convex.solution import Status
from shapefit.core import STRETCH
from shapefit.dictionary.model import Dictionary
from shapefit.errors import counted, input_error
from shapefit.io import (
    LandmarkSet,
    LandmarkSource,
    ResultSet,
    digests,
    open_landmarks,
    read_dictionary,
    result_writer,
)
from shapefit.io.formats import find_target_format
from shapefit.io.options import OutputOptions, Track
from shapefit.lifting.lift import Lifting
from shapefit.lifting.methods import METHODS
from shapefit.lifting.verdict import DOUBT, NO_SHAPE
from shapefit.pipelines.export.run import open_exports
from shapefit.pipelines.fit.chain import Chain, choose_chain, fit_images
from shapefit.pipelines.fit.dictionary_kind import mismatch
from shapefit.pipelines.fit.joints import as_joints, find_joints
from shapefit.pipelines.fit.landmark_names import check_enough, find_strange, name_warnings
from shapefit.pipelines.fit.lens import find_calibrated, find_doubts, straightened
from shapefit.pipelines.fit.record import as_result, find_renamed
from shapefit.pipelines.fit.searched import Ambiguous
from shapefit.pipelines.fit.standing import Standing, said_of_y
from shapefit.pipelines.fit.whole_sequences import whole_sequences
from shapefit.pipelines.outcome import Counted, Failure, Outcome, nothing_in
from shapefit.pipelines.reading import input_options
from shapefit.stores.copies import keep_copies

READ_AHEAD = 4096
"""Images that are read before the first whole sequences of them are lifted."""


def run(config: FitConfig, rows: slice | None = None) -> Iterator[Outcome]:
    """Lift every image of the landmark files, or these rows of the one; an Outcome per chunk."""
    check_holds_all(config)
    # A part of a file is known by the manifest: nobody reads the whole file for each part.
    read = (*(config.landmarks if rows is None else ()), config.dictionary)
    keep_copies(read)  # their digests take the whole of them
    calibrated = find_calibrated(config.camera)
    dictionary = read_dictionary(config.dictionary)
    chain = choose_chain(config, dictionary)
    unknown = None
    if config.leave_out:
        from shapefit.pipelines.fit.left_out import UnknownItems

        unknown = UnknownItems(config.leave_out, dictionary)
    ambiguous = Ambiguous(config.search.modes)
    standing = Standing(dictionary.landmark_names)
    options = input_options(config.input, default_track(config))
    solve_seconds, done = 0.0, 0
    with (
        open_landmarks(config.landmarks, options, rows) as source,
        open_exports(config, dictionary, source.count) as exports,
        result_writer(config.output, OutputOptions(height=config.height)) as writer,
    ):
        for images, lifting, record, seconds in fit_chunks(source, config, dictionary, chain):
            if unknown:
                unknown.add(images)
            ambiguous.add(lifting)
            standing.add(record)
            writer.append(record)
            exports.add(record, lifting.estimate.transforms)
            solve_seconds += seconds
            done += len(images)
            yield Outcome(
                done=len(images),
                total=source.count,
                failures=find_failures(images, lifting, config),
                items=images.items,
                warnings=find_warnings(images, lifting, config),
                doubts=count_doubts(record),
            )
        names = name_warnings(source.landmark_names, dictionary.landmark_names)
        left_in = unknown.warnings if unknown else ()
        inputs = digests(read)
        writer.attributes.update(attributes_of(config, inputs, solve_seconds, done))
        # Taken back where the result cannot be completed, which happens on leaving this block.
        exports.publish()
    yield Outcome(
        total=source.count,
        warnings=nothing_in(source.count, "images")
        + source.notes
        + mismatch(config, dictionary)
        + standing.warnings
        + find_renamed(source, config)
        + names
        + find_doubts(source.head.extras, calibrated)
        + left_in
        + ambiguous.warnings
        + exports.warnings
        + with_rate_warning(writer.summary.warnings, source.frame_rate, config),
        note="; ".join(filter(None, (said_of_y(source), exports.note, writer.summary.note))),
        written=(*(writer.summary.written or (config.output,)), *exports.folders, *exports.sheets),
    )


class Fitted(NamedTuple):
    """A chunk of images with what was found, and the seconds that it took to lift them."""

    images: LandmarkSet
    lifting: Lifting
    record: ResultSet
    seconds: float


def fit_chunks(
    source: LandmarkSource, config: FitConfig, dictionary: Dictionary, chain: Chain
) -> Iterator[Fitted]:
    """From landmarks to the records of a result, chunk by chunk."""
    names, place = dictionary.landmark_names, source_names(config)
    joints = find_joints(source.landmark_names, names)
    met = joints.rename(source.landmark_names)
    check_enough(met, names, place)
    strange = find_strange(met, names)
    calibrated = find_calibrated(config.camera)
    for chunk in find_chunks(source, config):
        straight = as_joints(straightened(chunk, calibrated), joints, place)
        images = straight.arrange(names, place, leave_out=bool(strange))
        began = time.perf_counter()
        lifting = fit_images(images, dictionary, chain)
        seconds = time.perf_counter() - began
        record = as_result(images, lifting, config, dictionary)
        yield Fitted(images, lifting, record, seconds)


def default_track(config: FitConfig) -> Track:
    """Return how detections without identity are joined: as sequences where those are needed."""
    by_sequence = find_target_format(config.output).by_sequence
    return "nearest" if by_sequence or METHODS[config.method].sequences else "none"


def attributes_of(
    config: FitConfig, inputs: Mapping[str, str], seconds: float, images: int
) -> dict[str, str | float | int]:
    """Return what is stored of a fit beside its images; `inputs` are the digests of its files."""
    return {
        "method": config.method,
        "version": __version__,
        "config": config.as_json(),
        "config_digest": hashlib.sha256(config.as_json().encode()).hexdigest(),
        "inputs": json.dumps(inputs),
        "solve_seconds": seconds,
        "images_per_second": images / seconds if seconds > 0 else 0.0,
    }


def check_holds_all(config: FitConfig) -> None:
    """Raise InputError where the config asks for more than the output can hold."""
    if config.transforms and find_target_format(config.output).points_only:
        found = f"cannot be stored in {config.output}: CSV holds points only"
        raise input_error("transforms", found, "name an HDF5 output, or leave it out")


def find_chunks(source: LandmarkSource, config: FitConfig) -> Iterator[LandmarkSet]:
    """Give out the images, cut where no result depends on `chunk`.

    An image starts from its neighbour's solution within a stretch, so chunks hold whole stretches.
    With `method: sequences` they hold whole sequences, READ_AHEAD or more images at a time.
    """
    if METHODS[config.method].sequences:
        return whole_sequences(map(with_sequences, source.chunks(READ_AHEAD)))
    return source.file_chunks(math.ceil(config.chunk / STRETCH) * STRETCH)


def with_sequences(images: LandmarkSet) -> LandmarkSet:
    """Return the images, and refuse them where they name no sequences."""
    if images.sequences is None:
        fix = "name the sequence of each image, or take `method: posterior`"
        raise input_error("method: sequences", "landmarks without `sequence`", fix)
    return images


def source_names(config: FitConfig) -> str:
    """Name the place of the landmark names for messages."""
    return ", ".join(str(path) for path in config.landmarks) + ": landmark names"


def with_rate_warning(
    of_writer: tuple[str, ...], rate: float | None, config: FitConfig
) -> tuple[str, ...]:
    """Add a warning where sequences are to be smoothed and nobody says how fast the images follow.

    It takes the place of the writer's about the same.
    """
    if not METHODS[config.method].sequences or rate or config.sequences.frame_rate:
        return of_writer
    from shapefit.io.written.motion import NO_RATE

    and_times = ", and times are numbers of frames" if NO_RATE in of_writer else ""
    return (
        "the frame rate is unknown, so the motion from image to image is taken for that of the "
        f"training shapes{and_times}; set `sequences.frame_rate`",
        *(each for each in of_writer if each != NO_RATE),
    )


def find_failures(images: LandmarkSet, lifting: Lifting, config: FitConfig) -> tuple[Failure, ...]:
    """List the items without a shape and, where `strict`, those that are not optimal."""
    reasons = dict(lifting.failures)
    if config.strict:
        for image, status in enumerate(lifting.estimate.status):
            if status not in (Status.OPTIMAL, Status.CONVERGED):
                reasons.setdefault(image, describe(lifting, image))
    return tuple(Failure(images.items[image], reasons[image]) for image in sorted(reasons))


def find_warnings(
    images: LandmarkSet, lifting: Lifting, config: FitConfig
) -> tuple[str | Counted, ...]:
    """Count images that stopped at the iteration limit, and warn where the camera looks wrong."""
    found: list[str | Counted] = []
    limited = [
        image
        for image, status in enumerate(lifting.estimate.status)
        if status is Status.ITERATION_LIMIT
    ]
    if limited and not config.strict:
        gap = lifting.estimate.relative_gap
        worst = limited[0] if gap is None else max(limited, key=lambda image: gap[image])
        found.append(
            Counted(
                len(limited),
                "image",
                "not optimal",
                worst=describe(lifting, worst),
                severity=0.0 if gap is None or np.isnan(gap[worst]) else float(gap[worst]),
            )
        )
    if images.confidence is not None and (images.confidence > 1).any():
        what = (
            "they make a landmark more precise than the model otherwise believes, whose standard "
            "deviations they divide"
            if METHODS[config.method].precisions
            else "they are weights, and larger ones count more against `lambda`"
        )
        fix = "divide them by their largest value if that is not intended"
        found.append(f"confidences above 1: {what}; {fix}")
    empty = find_empty(lifting)
    if empty:
        text = (
            "with an empty shape, all landmarks at one point: lambda is at or above lambda_max of "
            "the image; lower `lambda`"
        )
        found.append(Counted(len(empty), "image", text))
    if lifting.perspective:
        from shapefit.pipelines.fit.intrinsics import all_aside

        if all_aside(images.landmarks, lifting.perspective.camera):
            found.append(
                "all landmarks are far to one side of the optical axis; is "
                "`camera.principal_point` right?"
            )
    return tuple(found)


def count_doubts(record: ResultSet) -> tuple[Counted, ...]:
    """Count the images with a shape that is not to be trusted, by reason."""
    of_reason: dict[str, list[str]] = {}
    for item, reason in zip(record.items, record.extras.get(DOUBT, ()), strict=False):
        if reason not in ("", NO_SHAPE):  # which has failed
            of_reason.setdefault(reason, []).append(item)
    return tuple(
        Counted(len(items), "image", reason, items=tuple(items))
        for reason, items in of_reason.items()
    )


def find_empty(lifting: Lifting) -> list[int]:
    """List the images whose fitted shape is zero, and so has no rotation."""
    shapes = lifting.estimate.shapes
    zero = ~shapes.any(axis=(1, 2)) & np.isfinite(lifting.scale)
    return [image for image in np.flatnonzero(zero).tolist() if image not in lifting.failures]


def describe(lifting: Lifting, image: int) -> str:
    """Say how far an image got."""
    found = lifting.estimate
    reached = f"{found.status[image].value} after {counted(found.iterations[image], 'iteration')}"
    if found.relative_gap is None:
        return reached
    gap = found.relative_gap[image]
    if np.isnan(gap):  # the exact loss, where nothing is proved
        return f"{reached}, the landmarks are off by {found.residual[image]:.2g} of their spread"
    return f"{reached}, relative gap {gap:.2g}"

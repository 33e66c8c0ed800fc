"""`fit`: landmarks in, batch by batch, 3D shapes with their certificates out.

What config and files leave open is estimated of the first images; then each batch is read, lifted,
laid out and stored.
"""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Generator, Iterator, Mapping
from contextlib import AbstractContextManager, closing, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from shapefit import __version__
from shapefit.config import FitConfig
from shapefit.dictionary.model import Dictionary
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
from shapefit.io.options import OutputOptions
from shapefit.lifting.lift import Lifting
from shapefit.lifting.methods import METHODS
from shapefit.pipelines.fit.camera import doubts_of_lens
from shapefit.pipelines.fit.default import choose_default
from shapefit.pipelines.fit.lift import lift_batch, whole_stretches
from shapefit.pipelines.fit.prepare import (
    FIRST,
    Estimates,
    Setup,
    files_of,
    output_format,
    prepare,
    read_options,
    warn_of_dictionary,
)
from shapefit.pipelines.fit.record import as_result, warn_of_names
from shapefit.pipelines.fit.report import Counts, outcome_of, warn_of_all
from shapefit.pipelines.fit.summary import Tally, rows_of
from shapefit.pipelines.outcome import Outcome, nothing_in, reading
from shapefit.threads import side_by_side

if TYPE_CHECKING:
    from shapefit.pipelines.meshes import MeshWriter

CHUNK = 4096
"""Images that are lifted together, rounded up; no result depends on it."""

BATCH = 4096
"""Images that are read before the first whole sequences of them are lifted."""


class Batch(NamedTuple):
    """Images with what was found, and the seconds that it took to lift them."""

    images: LandmarkSet
    lifting: Lifting
    record: ResultSet
    seconds: float


def run(
    config: FitConfig,
    rows: slice | None = None,
    estimates: Estimates | None = None,
    dictionary: Dictionary | None = None,
    inputs: Mapping[str, str] | None = None,
) -> Iterator[Outcome]:
    """Lift every image of the landmark files, or these rows of the one; an Outcome per batch.

    estimates are those of all inputs, where these are a part of them, and `inputs` the digests of
    this part; the dictionary that of the config, where it was read before.
    """
    output = config.output
    assert isinstance(output, Path), "a folder is written part by part"
    config, chosen = choose_default(config)
    dictionary = dictionary or read_dictionary(config.dictionary)
    check_export(config, dictionary)
    if config.save.covariance is False and find_target_format(output).angles:
        config = config.changed(save={"covariance": True})  # an angle is that of several joints
    yield from reading(config.landmarks if inputs is None else ())
    with open_landmarks(config.landmarks, read_options(config), rows) as source:
        names = source.head.landmark_names
        setup = prepare(config, dictionary, names, lambda: source.first(FIRST), estimates)
        config, counts, seconds, known = setup.config, Counts(setup), 0.0, dict[str, str]()
        tally = Tally()
        options = OutputOptions(height=config.height, markers=config.markers)
        with (
            open_export(config, setup.dictionary) as export,
            result_writer(output, options) as writer,
            closing(lift_source(source, setup)) as batches,
        ):
            for batch in batches:
                if not known:  # while the next batch is lifted
                    landmarks = digests(config.landmarks) if inputs is None else inputs
                    known = {**landmarks, **digests(files_of(config).values())}
                counts.add(batch.images, batch.record)
                tally.add(batch.images, batch.record)
                yield outcome_of(batch.images, batch.lifting, batch.record, setup, source.count)
                writer.append(batch.record)
                if export is not None:
                    export.add(batch.record)
                seconds += batch.seconds
            writer.attributes.update(attributes_of(setup, known, seconds, counts.images))
            warnings = (*setup.estimates.warnings, *warn_of(source, setup), *warn_of_all(counts))
    lines = (chosen, say_y(source), *setup.estimates.lines, setup.matched.describe(names))
    yield Outcome(
        total=source.count,
        warnings=(
            *warnings,
            *(() if export is None else export.warnings),
            *warn_of_rate(config, source, writer.summary.warnings),
        ),
        note="; ".join(
            filter(None, (*lines, export.note if export else None, writer.summary.note))
        ),
        rows=rows_of(config, source, setup, tally, chosen, writer.summary.note),
        written=(*(writer.summary.written or (output,)), *(export.written if export else ())),
    )


def check_export(config: FitConfig, dictionary: Dictionary) -> None:
    """Raise InputError for all of the meshes that can be known to be wrong beforehand."""
    folder, to = config.export.folder, config.export.format
    if folder is None:
        return
    from shapefit.pipelines.meshes import check_dictionary, check_mesh_folder

    assert isinstance(config.output, Path), "a folder of results has no meshes"
    check_mesh_folder(folder, "export.folder", to, config.output)
    method, perspective = METHODS[config.method], config.camera.model == "perspective"
    mixes = method.mixes_atoms or (perspective and method.perspective == "refined")
    check_dictionary(dictionary, str(config.dictionary), mixes_atoms=mixes)


def open_export(
    config: FitConfig, dictionary: Dictionary
) -> AbstractContextManager[MeshWriter | None]:
    """Give the writer of meshes that the config asks for; the files appear on a clean exit."""
    if config.export.folder is None:
        return nullcontext()
    from shapefit.pipelines.meshes import mesh_writer

    return mesh_writer(dictionary, config.export.folder, config.export.format)


def lift_source(source: LandmarkSource, setup: Setup) -> Generator[Batch, None, None]:
    """From landmarks to the records of a result, batch by batch.

    While one is lifted, the next is read and the last is stored, but with `threads: 1`.
    """

    def lift(images: LandmarkSet) -> Batch:
        began = time.perf_counter()
        lifting, inputs = lift_batch(images, setup)
        seconds = time.perf_counter() - began
        return Batch(images, lifting, as_result(images, lifting, setup, inputs), seconds)

    several = setup.config.threads != 1 and source.count > (batch_size(setup.config) or BATCH)
    return side_by_side(lift, read_images(source, setup), workers=int(several))


def read_images(source: LandmarkSource, setup: Setup) -> Iterator[LandmarkSet]:
    """Yield the images batch by batch: without distortion, with the landmarks of the dictionary."""
    size = batch_size(setup.config)
    if size is None:
        from shapefit.pipelines.fit.sequences import whole_sequences

        batches = whole_sequences(source.batches(BATCH))
    else:
        batches = source.batches(size, by_file=True)
    for batch in batches:
        yield setup.arrange(batch)


def batch_size(config: FitConfig) -> int | None:
    """Images at a time, cut where no result depends on it; None for whole sequences."""
    return None if METHODS[config.method].sequences else whole_stretches(CHUNK)


def attributes_of(
    setup: Setup, inputs: Mapping[str, str], seconds: float, images: int
) -> dict[str, str | float | int]:
    """Return what is stored of a fit beside its images; `inputs` are the digests of its files.

    `training_inputs` are those of the files that the dictionary was learned from: `eval` warns
    where one of them is the truth. `estimated` says what was found or assumed before lifting.
    """
    config = setup.config.as_json()
    return {
        "method": setup.config.method,
        "version": __version__,
        "config": config,
        "config_digest": hashlib.sha256(config.encode()).hexdigest(),
        "inputs": json.dumps(inputs),
        "estimated": "; ".join(setup.estimates.lines),
        **{name: value for name, value in setup.estimates.known.items() if value == value},
        "training_inputs": setup.dictionary.provenance.get("inputs", "{}"),
        "solve_seconds": seconds,
        "images_per_second": images / seconds if seconds > 0 else 0.0,
    }


def warn_of(source: LandmarkSource, setup: Setup) -> tuple[str, ...]:
    """Say what is doubtful of the files, their landmarks and their lens, and of the dictionary."""
    further, stores_names = source.head.further, not output_format(setup.config).points_only
    return (
        *nothing_in(source.count, "images"),
        *source.notes,
        *setup.matched.warnings(source.head.landmark_names),
        *doubts_of_lens(further, setup.camera),
        *warn_of_dictionary(setup.config, setup.dictionary),
        *(warn_of_names(further) if stores_names else ()),
    )


def warn_of_rate(
    config: FitConfig, source: LandmarkSource, of_writer: tuple[str, ...]
) -> tuple[str, ...]:
    """Warn of sequences that are smoothed though nobody says how fast the images follow.

    Among the warnings of the writer that takes the place of its own about the same.
    """
    known = config.frame_rate or source.head.frame_rate
    if known or not METHODS[config.method].sequences:
        return of_writer
    from shapefit.io.writers.motion import NO_RATE

    and_times = ", and times are numbers of frames" if NO_RATE in of_writer else ""
    return (
        "the frame rate is unknown, so the motion from image to image is taken for that of the "
        f"training shapes{and_times}; set `frame_rate`",
        *(each for each in of_writer if each != NO_RATE),
    )


def say_y(source: LandmarkSource) -> str:
    """Say which way y was taken to point in the images."""
    taken = "" if source.states_y_axis else ", as no file says otherwise"
    return f"y {source.head.y_axis} in the images{taken}"

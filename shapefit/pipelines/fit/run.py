"""`fit`: landmarks in, batch by batch, 3D shapes with their certificates out.

Four steps hand on: the plan, the images that are read, the shapes that are lifted, what is written.
"""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Generator, Iterator, Mapping
from contextlib import closing
from dataclasses import replace
from pathlib import Path

from shapefit import __version__
from shapefit.config import FitConfig
from shapefit.dictionary.model import Dictionary
from shapefit.io import (
    LandmarkSet,
    LandmarkSource,
    digests,
    open_landmarks,
    read_dictionary,
    result_writer,
)
from shapefit.io.options import OutputOptions
from shapefit.lifting.verdict import cover_mirror_image
from shapefit.pipelines.export.run import open_exports, plan_exports
from shapefit.pipelines.fit.chain import fit_images
from shapefit.pipelines.fit.plan import Plan, plan_fit, read_options
from shapefit.pipelines.fit.prepare import Setup, prepare
from shapefit.pipelines.fit.read import read_images
from shapefit.pipelines.fit.record import as_result
from shapefit.pipelines.fit.report import Batch, Report, said_of_y
from shapefit.pipelines.joints import said_of_names
from shapefit.pipelines.outcome import Outcome
from shapefit.pipelines.overlap import side_by_side, written_behind
from shapefit.stores import UrlPath, local_copy, on_threads


def run(
    config: FitConfig, rows: slice | None = None, setup: Setup | None = None
) -> Iterator[Outcome]:
    """Lift every image of the landmark files, or these rows of the one; an Outcome per batch.

    setup is what was estimated of all inputs, where these are a part of them.
    """
    output = config.output
    assert isinstance(output, Path), "a folder is written part by part"
    # A part of a file is known by the manifest: nobody reads the whole file for each part.
    files = (*(config.landmarks if rows is None else ()), config.dictionary)
    # The digest of an object takes the whole of it.
    on_threads(local_copy, (path for path in files if isinstance(path, UrlPath)))
    dictionary = read_dictionary(config.dictionary)
    wanted = plan_exports(config, dictionary)
    seconds, done, inputs = 0.0, 0, dict[str, str]()
    with open_landmarks(config.landmarks, read_options(config), rows) as source:
        setup = setup or prepare(config, dictionary, source)
        config = setup.apply(config)
        said = (said_of_y(source), *setup.lines)
        wanted = wanted.seen_through(config.camera)
        plan = plan_fit(config, dictionary, source.head.landmark_names)
        dictionary = plan.dictionary
        with (
            open_exports(wanted, dictionary, source.count) as exports,
            result_writer(output, OutputOptions(height=config.height)) as writer,
            closing(lift_source(source, plan)) as batches,
            written_behind(writer.append, plan.lifts_at_a_time(source) > 0) as write,
        ):
            report = Report(plan.report, dictionary)
            for batch in batches:
                inputs = inputs or digests(files)  # while the next batches are lifted
                yield report.of(batch, source.count)
                write(batch.record)
                exports.add(batch.record, batch.lifting.estimate.transforms)
                seconds += batch.seconds
                done += len(batch.images)
            warnings = setup.warnings + plan.warn_of(source) + report.warnings
            writer.attributes.update(
                attributes_of(config, dictionary, setup, inputs, seconds, done)
            )
    of_writer = writer.summary.warnings
    if plan.needs_rate and not source.head.frame_rate:
        of_writer = with_rate_warning(of_writer)
    names = said_of_names(source.head.landmark_names, dictionary.landmark_names)
    yield Outcome(
        total=source.count,
        warnings=warnings + exports.warnings + of_writer,
        note="; ".join(filter(None, (*said, names, exports.note, writer.summary.note))),
        written=(*(writer.summary.written or (output,)), *exports.folders, *exports.sheets),
    )


def lift_source(source: LandmarkSource, plan: Plan) -> Generator[Batch, None, None]:
    """From landmarks to the records of a result, batch by batch."""
    seen, last = plan.mapped.see(plan.dictionary), 0.0

    def lift(images: LandmarkSet) -> tuple[Batch, float]:
        began = time.perf_counter()
        lifting = fit_images(images, seen, plan.lift)
        if plan.dictionary.depth_is_open:
            lifting = replace(lifting, estimate=cover_mirror_image(lifting.estimate))
        lifting, inputs = plan.mapped.back(lifting, images.landmarks, plan.lift.weigh(images) > 0)
        ended = time.perf_counter()
        record = as_result(images, lifting, plan.dictionary, plan.record, inputs)
        return Batch(images, lifting, record, ended - began), ended

    batches = side_by_side(lift, read_images(source, plan.read), plan.lifts_at_a_time(source))
    for batch, ended in batches:  # what two of them took at the same time counts once
        yield batch._replace(seconds=min(batch.seconds, ended - last))
        last = max(last, ended)


def attributes_of(
    config: FitConfig,
    dictionary: Dictionary,
    setup: Setup,
    inputs: Mapping[str, str],
    seconds: float,
    images: int,
) -> dict[str, str | float | int]:
    """Return what is stored of a fit beside its images; `inputs` are the digests of its files.

    `training_inputs` are those of the files that the dictionary was learned from: `eval` warns
    where one of them is the truth. `estimated` says what was found or assumed before lifting.
    """
    return {
        "method": config.method,
        "version": __version__,
        "config": config.as_json(),
        "config_digest": hashlib.sha256(config.as_json().encode()).hexdigest(),
        "inputs": json.dumps(inputs),
        "estimated": "; ".join(setup.lines),
        "training_inputs": dictionary.provenance.get("inputs", "{}"),
        "solve_seconds": seconds,
        "images_per_second": images / seconds if seconds > 0 else 0.0,
    }


def with_rate_warning(of_writer: tuple[str, ...]) -> tuple[str, ...]:
    """Add a warning that sequences are smoothed though nobody says how fast the images follow.

    It takes the place of the writer's about the same.
    """
    from shapefit.io.written.motion import NO_RATE

    and_times = ", and times are numbers of frames" if NO_RATE in of_writer else ""
    return (
        "the frame rate is unknown, so the motion from image to image is taken for that of the "
        f"training shapes{and_times}; set `sequences.frame_rate`",
        *(each for each in of_writer if each != NO_RATE),
    )

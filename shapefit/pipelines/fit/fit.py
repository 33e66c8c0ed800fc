"""`fit`: landmarks in, batch by batch, 3D shapes with their certificates or error bars
out, and a summary.
"""

from __future__ import annotations

from collections.abc import Generator, Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, closing
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from shapefit.config import FitConfig
from shapefit.dictionary.model import Dictionary
from shapefit.io import (
    LandmarkSource,
    open_landmarks,
    read_dictionary,
)
from shapefit.io.formats import HDF5, find_target_format, result_writer
from shapefit.io.inputs import State
from shapefit.io.layout import INPUT_ROWS
from shapefit.io.options import OutputOptions, RecordWriter, Summary
from shapefit.pipelines.fit.calibration import SAMPLE_POOL, calibrate
from shapefit.pipelines.fit.camera import read_calibrated_camera, remove_distortion
from shapefit.pipelines.fit.choices import (
    are_in_sequences,
    choose_family,
    choose_method,
    match_to_dictionary,
    place_of_names,
    reading_options,
    with_angle_covariance,
)
from shapefit.pipelines.fit.export import check_export, export_meshes
from shapefit.pipelines.fit.family import Batch, Calibration, Family, Pace
from shapefit.pipelines.fit.inputs import WatchedFiles
from shapefit.pipelines.fit.record import provenance, to_record
from shapefit.pipelines.fit.summary import (
    Ends,
    InputsRead,
    Tally,
    describe_batch,
    summarise_fit,
)
from shapefit.pipelines.joints import LandmarkMatch
from shapefit.pipelines.result import Result
from shapefit.records import Fit
from shapefit.threads import map_ahead

if TYPE_CHECKING:
    from shapefit.io.readers.calibration import CalibratedCamera

IMAGES_PER_BATCH = 4096
"""Images that are lifted together at most, or read before the first whole sequences are
lifted; no result depends on it.
"""


class FitPart(NamedTuple):
    """The rows of the input that a part of a fit lifts, and what all parts share.

    dictionary, as it was read; source of the images, where it is open; states of all
    files when they were found, and their digests.
    """

    rows: slice | None = None
    calibration: Calibration | None = None
    dictionary: Dictionary | None = None
    source: LandmarkSource | None = None
    digests: Mapping[str, str] | None = None
    states: Mapping[Path, State] | None = None


WHOLE_FIT = FitPart()


class FitPlan(NamedTuple):
    """All that lifting a batch takes: a config without open keys, and what it names."""

    config: FitConfig
    match: LandmarkMatch
    family: Family
    lens: CalibratedCamera | None
    calibration: Calibration


class LiftedBatch(NamedTuple):
    """A batch as it is stored, and how its images ended."""

    record: Fit
    ends: Ends

    def take(self, rows: slice) -> LiftedBatch:
        """Return the images `rows`, first to before the last."""
        return LiftedBatch(self.record.take(rows), self.ends.take(rows))

    @property
    def event(self) -> Result:
        """Return what is reported of the batch."""
        return describe_batch(self.record, self.ends)


class Written(NamedTuple):
    """What adds up over the batches of a fit, and what was written of them."""

    tally: Tally
    summary: Summary


def fit(config: FitConfig, part: FitPart = WHOLE_FIT) -> Iterator[Result]:
    """Lift the 2D landmarks of every image to a 3D shape, and write the result.

    Yields a Result per batch, and a last one that sums up. Raises InputError, and
    writes nothing, where a file changes meanwhile.
    """
    files = WatchedFiles.of_config(config, part.states, part.digests)
    dictionary = part.dictionary or read_dictionary(config.dictionary)
    config, chosen = choose_method(config, dictionary, lambda: are_in_sequences(config))
    config = with_angle_covariance(config)
    with part.source or open_source(config, part.rows) as source:
        match = match_to_dictionary(config, dictionary, source.head.landmark_names)
        calibration = part.calibration
        if calibration is None:
            sample = source.first(SAMPLE_POOL)
            calibration = yield from calibrate(config, match, sample, source.count)
        plan = plan_fit(config, match, calibration)
        check_export(plan.config, match.dictionary)

        read = InputsRead.of(source)
        with closing(lift_all(source, plan)) as batches:
            written = yield from write_result(plan, batches, read, files, part.rows)
    yield summarise_fit(read, plan, written.tally, chosen, written.summary)
    yield from export_meshes(plan.config)


def open_source(config: FitConfig, rows: slice | None) -> LandmarkSource:
    """Open the landmarks of a fit, or `rows` of them, as its keys say."""
    return open_landmarks(config.landmarks, reading_options(config), rows)


def plan_fit(
    config: FitConfig, match: LandmarkMatch, calibration: Calibration
) -> FitPlan:
    """Return the plan by which batches are lifted, with a config of no open keys."""
    config = calibration.apply_to(config)
    family = choose_family(config, match, calibration)
    return FitPlan(config, match, family, read_calibrated_camera(config), calibration)


def lift_all(
    source: LandmarkSource, plan: FitPlan
) -> Generator[LiftedBatch, None, None]:
    """Lift all images of a source; yields them batch by batch.

    While one batch is lifted, the next is read and the last is stored.
    """
    pace = Pace.of(IMAGES_PER_BATCH, plan.config.threads)

    def lift_timed(batch: Batch) -> LiftedBatch:
        """Lift a batch, and adapt the size of the next ones to its time."""
        with pace.timed(len(batch.images)):
            return lift_batch(batch, plan)

    batches = plan.family.read_batches(source, pace)
    several = plan.config.threads != 1 and source.count > IMAGES_PER_BATCH
    return map_ahead(lift_timed, batches, workers=int(several))


def lift_batch(batch: Batch, plan: FitPlan) -> LiftedBatch:
    """Lift a batch of images of the files; return its record and what is reported."""
    # each line is a stage with tests of its own
    straight = remove_distortion(batch.images, plan.lens)
    named = plan.match.arrange(straight, place_of_names(plan.config))
    lifted = plan.family.lift(named, batch.group)
    record = to_record(named, lifted, plan)
    return LiftedBatch(record, Ends.of(lifted.lifting))


def write_result(
    plan: FitPlan,
    batches: Iterable[LiftedBatch],
    read: InputsRead,
    files: WatchedFiles,
    rows: slice | None = None,
) -> Generator[Result, None, Written]:
    """Write the result of the batches of a fit; yields what is reported of each.

    rows of the input that they are, None for all. Returns what adds up over them, and
    what was written. Raises InputError, and writes nothing, where a file has changed.
    """
    tally = Tally()
    with open_writer(plan) as writer:
        writer.seal = rows_attribute(rows)
        for batch in batches:
            files.take_digests()  # while the next batch is lifted
            tally.add(batch.record)
            yield batch.event._replace(total=read.images)
            writer.append(batch.record)
        writer.attributes.update(provenance(plan, files.digests()))
        files.check_unchanged()
    return Written(tally, writer.summary)


def open_writer(plan: FitPlan) -> AbstractContextManager[RecordWriter[Fit]]:
    """Return the writer of the result file, which appears whole or not at all."""
    output = plan.config.output
    assert isinstance(output, Path), "a folder is written part by part"
    height = plan.config.height
    if find_target_format(output) is HDF5:
        height = None  # which each image states
    options = OutputOptions(height=height, markers=plan.config.markers)
    return result_writer(output, options=options)


def rows_attribute(rows: slice | None) -> dict[str, str]:
    """Return the attribute that states which rows of the input a part has, {} for all.

    The digest of the file (its seal) covers this attribute.
    """
    if rows is None:
        return {}
    return {INPUT_ROWS: f"{rows.start}:{rows.stop}"}

"""Small parts of a fit into a folder: lifted together, each written by itself."""

from __future__ import annotations

import time
from collections.abc import Hashable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import accumulate, pairwise
from typing import NamedTuple

import numpy as np

from shapefit.config import FitConfig
from shapefit.dictionary.model import Dictionary
from shapefit.io import LandmarkSource, open_landmarks
from shapefit.io.options import InputOptions
from shapefit.lifting.methods import METHODS
from shapefit.pipelines.fit.choices import match_to_dictionary
from shapefit.pipelines.fit.family import Batch, Calibration, Pace
from shapefit.pipelines.fit.fit import (
    IMAGES_PER_BATCH,
    FitPart,
    FitPlan,
    LiftedBatch,
    lift_batch,
    plan_fit,
    write_result,
)
from shapefit.pipelines.fit.inputs import WatchedFiles
from shapefit.pipelines.fit.summary import InputsRead, summarise_fit
from shapefit.pipelines.partition.manifest import Part
from shapefit.pipelines.result import Result
from shapefit.records import Landmarks
from shapefit.records.columns import present_columns
from shapefit.records.items import concatenate


class ReadPart(NamedTuple):
    """All images of a part, and what was read beside them; file, of its result."""

    file: str
    images: Landmarks
    read: InputsRead


class LiftedPart(NamedTuple):
    """A part that was lifted with others: their plan, what was read of it, its images.

    seconds, its share of the time.
    """

    plan: FitPlan
    read: InputsRead
    batch: LiftedBatch
    seconds: float


@dataclass(eq=False, repr=False)
class OpenParts:
    """The sources of parts that were opened before their turn, by their files.

    What is read whole, as all but HDF5 is, is read once, however often one looks at it.
    """

    options: InputOptions
    sources: dict[str, LandmarkSource] = field(default_factory=dict)

    @contextmanager
    def look_at(self, part: Part) -> Iterator[LandmarkSource]:
        """Give the source of a part, open; raises InputError as `open_landmarks`."""
        if part.file not in self.sources:
            source = open_landmarks(part.inputs, self.options, part.slice)
            self.sources[part.file] = source
        with self.sources[part.file] as source:  # whose files open when they are read
            yield source

    def pop(self, part: Part) -> LandmarkSource | None:
        """Return the source of a part, if one has looked at it."""
        return self.sources.pop(part.file, None)


@dataclass(eq=False, repr=False)
class TogetherLifter:
    """Lifts parts of few images together, as many as are lifted in a second or so.

    No bit of a part depends on the others, see `Batch`. config is that of the run,
    without open keys.
    """

    config: FitConfig
    dictionary: Dictionary
    calibration: Calibration
    opened: OpenParts
    pace: Pace = field(init=False)
    alone: set[str] = field(default_factory=set)
    """Files of parts that are lifted each by itself, as it went wrong together."""
    plans: dict[Sequence[str], FitPlan] = field(default_factory=dict)
    """The last plan, by the landmarks of the files for which it is."""

    def __post_init__(self) -> None:
        self.pace = Pace.of(IMAGES_PER_BATCH, self.config.threads)

    def lift_first(self, parts: Iterable[Part]) -> Sequence[LiftedPart]:
        """Lift the first of the parts, as many as go together.

        There are none where the first is to be lifted by itself: it has many images,
        the method takes sequences, or something is wrong, which it then reports.
        """
        if METHODS[self.config.method].takes_sequences:
            return ()
        began = time.perf_counter()
        group = [*self.read_group(parts)]
        if not group:
            return ()
        try:
            plan = self.plan_of(group[0].images.landmark_names)
            batches = self.lift([part.images for part in group], plan)
        except Exception:  # which the part that it comes of reports
            self.alone.update(part.file for part in group)
            return ()
        seconds = (time.perf_counter() - began) / len(group)
        return [
            LiftedPart(plan, part.read, batch, seconds)
            for part, batch in zip(group, batches, strict=True)
        ]

    def read_group(self, parts: Iterable[Part]) -> Iterator[ReadPart]:
        """Yield the first parts, read, that have few images and are otherwise alike."""
        room = self.pace.images
        kind: Hashable = None
        for part in parts:
            if part.file in self.alone:
                return
            try:
                with self.opened.look_at(part) as source:
                    its_kind = kind_of(source.head)
                    if not 0 < source.count <= room or kind not in (None, its_kind):
                        return
                    images = source.whole()
            except Exception:  # which the part reports
                return
            kind = its_kind
            room -= source.count
            yield ReadPart(part.file, images, InputsRead.of(source))

    def lift(self, files: Sequence[Landmarks], plan: FitPlan) -> list[LiftedBatch]:
        """Lift the images of several files together; return those of each."""
        images = concatenate(files)
        counts = [*map(len, files)]
        group = np.repeat(np.arange(len(files)), counts)
        with self.pace.timed(len(images)):
            lifted = lift_batch(Batch(images, group), plan)
        stops = accumulate(counts, initial=0)
        return [lifted.take(slice(start, stop)) for start, stop in pairwise(stops)]

    def plan_of(self, names: Sequence[str]) -> FitPlan:
        """Return the plan by which files that have these landmarks are lifted."""
        if names not in self.plans:
            match = match_to_dictionary(self.config, self.dictionary, names)
            self.plans = {names: plan_fit(self.config, match, self.calibration)}
        return self.plans[names]


def kind_of(head: Landmarks) -> Hashable:
    """Return what the heads of files have in common that can be one record.

    That is all but the images.
    """
    arrays = {column.name: np.asarray(v) for column, v in present_columns(head)}
    arrays |= {**head.extras, **head.file_extras}
    stated = (head.unit, head.frame_rate, head.y_axis, *head.attributes.items())
    return stated, *(
        (name, values.dtype.str, values.shape, values.tobytes())
        for name, values in arrays.items()
    )


def write_lifted(
    config: FitConfig, part: FitPart, lifted: LiftedPart
) -> Iterator[Result]:
    """Write the result of a part that is lifted, as `fit` does it."""
    plan = lifted.plan._replace(config=config)
    files = WatchedFiles.of_config(config, part.states, part.digests)
    batches = [lifted.batch]
    written = yield from write_result(plan, batches, lifted.read, files, part.rows)
    yield summarise_fit(lifted.read, plan, written.tally, "", written.summary)

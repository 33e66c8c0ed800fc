"""`fit`: landmarks in, batch by batch, 3D shapes with their certificates out.

What config and files leave open is estimated of the first images; then each batch is read, lifted,
laid out and stored.
"""

from __future__ import annotations

import math
import time
from collections.abc import Generator, Iterator, Mapping
from contextlib import closing, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from shapefit.config import FitConfig
from shapefit.core import IMAGES_PER_BLOCK
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
from shapefit.pipelines.fit.lift import lift_batch
from shapefit.pipelines.fit.prepare import (
    FIRST,
    Estimates,
    Setup,
    choose_method,
    files_of,
    in_sequences,
    prepare,
    read_options,
)
from shapefit.pipelines.fit.record import as_result, attributes_of
from shapefit.pipelines.fit.report import Counts, final_outcome, outcome_of, warn_of_all
from shapefit.pipelines.outcome import Outcome
from shapefit.threads import side_by_side

if TYPE_CHECKING:
    from shapefit.pipelines.meshes import MeshWriter

CHUNK = 4096
"""Images that are lifted together, or read before the first whole sequences are lifted; no result
depends on it."""


class Batch(NamedTuple):
    """Images with their lifting and record, and the seconds that it took to lift them."""

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
    dictionary = dictionary or read_dictionary(config.dictionary)
    config, chosen = choose_method(config, dictionary, lambda: in_sequences(config))
    if find_target_format(output).angles:
        config = config.changed(save={"covariance": True})  # an angle is that of several joints
    with open_landmarks(config.landmarks, read_options(config), rows) as source:
        names = source.head.landmark_names
        setup = prepare(config, dictionary, names, lambda: source.first(FIRST), estimates)
        options = OutputOptions(height=config.height, markers=config.markers)
        counts, seconds = Counts(), 0.0
        with (
            open_export(setup) as export,
            result_writer(output, options) as writer,
            closing(lift_source(source, setup)) as batches,
        ):
            for batch in batches:
                if not counts.images:  # while the next batch is lifted
                    inputs = digests(config.landmarks) if inputs is None else inputs
                    inputs = {**inputs, **digests(files_of(setup.config).values())}
                counts.add(batch.images, batch.record, setup)
                seconds += batch.seconds
                yield outcome_of(batch.images, batch.lifting, batch.record, setup, source.count)
                writer.append(batch.record)
                if export is not None:
                    export.add(batch.record)
            writer.attributes.update(attributes_of(setup, inputs or {}, seconds, counts.images))
            warnings = tuple(warn_of_all(counts, setup, source.head.y_axis))
    yield final_outcome(source, setup, counts, chosen, warnings, writer.summary, export)


@contextmanager
def open_export(setup: Setup) -> Iterator[MeshWriter | None]:
    """Give the writer of the meshes that the config asks for; they appear on a clean exit.

    Raises InputError, before an image is lifted, where there can be none.
    """
    config, method = setup.config, METHODS[setup.config.method]
    folder, to = config.export.folder, config.export.format
    if folder is None:
        yield None
        return
    from shapefit.pipelines.meshes import check_dictionary, check_mesh_folder, mesh_writer

    check_mesh_folder(folder, "export.folder", Path(str(config.output)))
    refined = config.camera.model == "perspective" and method.perspective == "refined"
    place, mixes_atoms = str(config.dictionary), method.mixes_atoms or refined
    check_dictionary(setup.dictionary, place, mixes_atoms=mixes_atoms)
    with mesh_writer(setup.dictionary, folder, to) as writer:
        yield writer


def lift_source(source: LandmarkSource, setup: Setup) -> Generator[Batch, None, None]:
    """From landmarks to the records of a result, batch by batch.

    While one is lifted, the next is read and the last is stored, but with `threads: 1`.
    """

    def lift(images: LandmarkSet) -> Batch:
        began = time.perf_counter()
        lifting, inputs = lift_batch(images, setup)
        seconds = time.perf_counter() - began
        return Batch(images, lifting, as_result(images, lifting, setup, inputs), seconds)

    several = setup.config.threads != 1 and source.count > CHUNK
    return side_by_side(lift, read_images(source, setup), workers=int(several))


def read_images(source: LandmarkSource, setup: Setup) -> Iterator[LandmarkSet]:
    """Yield the images batch by batch: without distortion, with the landmarks of the dictionary."""
    if METHODS[setup.config.method].sequences:
        from shapefit.pipelines.fit.sequences import in_pieces, whole_sequences

        batches = in_pieces(whole_sequences(source.batches(CHUNK)))
    else:
        batches = source.batches(whole_stretches(CHUNK), by_file=True)
    return map(setup.arrange, batches)


def whole_stretches(images: int) -> int:
    """Round up to whole stretches: within one, images start from their neighbours' solutions."""
    return math.ceil(images / IMAGES_PER_BLOCK) * IMAGES_PER_BLOCK

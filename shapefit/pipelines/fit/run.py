"""`fit`: landmarks in, batch by batch, 3D shapes with their certificates out."""

from __future__ import annotations

import math
from collections.abc import Generator, Iterator, Mapping
from contextlib import closing
from dataclasses import replace
from pathlib import Path

from shapefit.config import FitConfig
from shapefit.core import IMAGES_PER_BLOCK
from shapefit.dictionary.model import Dictionary
from shapefit.errors import input_error
from shapefit.io import LandmarkSet, LandmarkSource, digests, open_landmarks, read_dictionary
from shapefit.io.formats import HDF5, find_target_format, result_writer
from shapefit.io.options import OutputOptions
from shapefit.lifting.trust import SIDES, cover_mirror_image
from shapefit.pipelines.fit import prepare as preparing
from shapefit.pipelines.fit.lift import lift_landmarks, weigh
from shapefit.pipelines.fit.prepare import FIRST, Setup, prepare
from shapefit.pipelines.fit.record import as_result, attributes_of
from shapefit.pipelines.fit.report import Batch, Counts, result_of, summary_of
from shapefit.pipelines.fit.sample import Estimates
from shapefit.pipelines.result import Result
from shapefit.threads import side_by_side

CHUNK = 4096
"""Images that are lifted together, or read before the first whole sequences are lifted; no result
depends on it."""


def run(
    config: FitConfig,
    rows: slice | None = None,
    estimates: Estimates | None = None,
    dictionary: Dictionary | None = None,
    inputs: Mapping[str, str] | None = None,
) -> Iterator[Result]:
    """Lift every image, or these rows of the one file; of a part, what is known of all is given."""
    output = config.output
    assert isinstance(output, Path), "a folder is written part by part"
    dictionary = dictionary or read_dictionary(config.dictionary)
    config, method = preparing.choose_method(
        config, dictionary, lambda: preparing.in_sequences(config)
    )
    if find_target_format(output).angles:
        config = config.changed(save={"covariance": True})  # an angle is that of several joints
    with open_landmarks(config.landmarks, preparing.read_options(config), rows) as source:
        names = source.head.landmark_names
        setup = prepare(config, dictionary, names, lambda: source.first(FIRST), estimates)
        check_export(setup, output)
        options, counts = OutputOptions(height=config.height, markers=config.markers), Counts()
        with (
            result_writer(output, options) as writer,
            closing(lift_source(source, setup)) as batches,
        ):
            for batch in batches:
                if inputs is None:  # while the next batch is lifted
                    inputs = digests(config.landmarks)
                counts.add(batch.record)
                yield result_of(batch, setup, source.count)
                writer.append(batch.record)
            others = digests(preparing.files_of(setup.config).values())
            writer.attributes.update(attributes_of(setup, {**(inputs or {}), **others}))
    yield summary_of(source, setup, counts, method, writer.summary)
    if config.export.folder is not None:
        yield from export_meshes(config, output, config.export.folder)


def lift_source(source: LandmarkSource, setup: Setup) -> Generator[Batch, None, None]:
    """Lift batch by batch; while one is lifted, the next is read and the last is stored."""
    batches = source.batches(whole_blocks(CHUNK), by_file=True)
    if setup.lifter.row.sequences:
        from shapefit.pipelines.fit.sequences import whole_sequences

        batches = whole_sequences(source.batches(CHUNK))
    several = setup.config.threads != 1 and source.count > CHUNK
    images = map(setup.arrange, batches)
    return side_by_side(lambda batch: lift_batch(batch, setup), images, workers=int(several))


def whole_blocks(images: int) -> int:
    """Round up to whole blocks: within one, images start from their neighbours' solutions."""
    return math.ceil(images / IMAGES_PER_BLOCK) * IMAGES_PER_BLOCK


def lift_batch(images: LandmarkSet, setup: Setup) -> Batch:
    """Lift images that have the landmarks of the dictionary, and lay out their record."""
    lifter, lifted, further = setup.lifter, images, {}
    if lifter.row.sequences:
        from shapefit.pipelines.fit.sequences import restore_sides

        lifted, further[SIDES] = restore_sides(images, weigh(images, lifter) > 0, lifter)
    lifting = lift_landmarks(lifted, lifter)
    estimate = replace(lifting.estimate, further={**lifting.estimate.further, **further})
    if setup.dictionary.depth_ambiguity:
        estimate = cover_mirror_image(estimate)
    visible, lifting = weigh(lifted, lifter) > 0, replace(lifting, estimate=estimate)
    lifting, input_shapes = setup.matched.to_joints(
        lifting, setup.theta, lifted.landmarks, visible, lifter.variance
    )
    return Batch(images, lifting, as_result(images, lifting, setup, input_shapes))


def check_export(setup: Setup, result: Path) -> None:
    """Raise InputError where a result will have no meshes, if the config asks for them."""
    export, method = setup.config.export, setup.lifter.row
    if export.folder is not None:
        from shapefit.pipelines.meshes import check_dictionary, check_mesh_folder

        if find_target_format(result) is not HDF5:
            fix = "write the result as HDF5, -o result.h5"
            raise input_error("export.folder", "meshes are made of a result in HDF5", fix)
        check_mesh_folder(export.folder, "export.folder", result)
        refined = setup.lifter.camera is not None and method.perspective == "refined"
        mixes, place = method.mixes_atoms or refined, setup.config.dictionary
        check_dictionary(setup.dictionary, place, mixes_atoms=mixes)


def export_meshes(config: FitConfig, result: Path, folder: Path) -> Iterator[Result]:
    """Write the meshes of a result, as `convert` does."""
    from shapefit.config import ConvertConfig
    from shapefit.pipelines.convert import write_meshes

    to, dictionary = config.export.format, config.dictionary
    convert = ConvertConfig(files=(result,), dictionary=dictionary, output=folder, to=to)
    for part in write_meshes(convert):
        yield replace(part, done=0, total=None)  # its images are counted already

"""`convert`: landmarks, shapes or results in, the same in another format out."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import chain
from pathlib import Path

import numpy as np

from shapefit.config import ConvertConfig
from shapefit.errors import abbreviate, input_error
from shapefit.io import (
    LandmarkSource,
    ShapeSource,
    open_landmarks,
    open_shapes,
    read_dictionary,
    write_dictionary,
)
from shapefit.io.dictionaries import atoms_of
from shapefit.io.formats import (
    CSV,
    HDF5,
    MESH_FORMATS,
    FileFormat,
    find_target_format,
    record_writer,
)
from shapefit.io.inputs import is_stream
from shapefit.io.layout import LANDMARKS, RESULTS, SHAPES
from shapefit.io.options import AS_THEY_ARE, InputOptions, OutputOptions, input_options
from shapefit.io.source import AnyRecord, Kind, ResultSource, find_kind, open_results
from shapefit.pipelines.items import keys_of
from shapefit.pipelines.meshes import write_meshes
from shapefit.pipelines.result import Result, nothing_in

BATCH = 4096
"""Items in memory at a time."""

LAYOUTS = {"landmarks": LANDMARKS, "shapes": SHAPES, "result": RESULTS}

AnySource = LandmarkSource | ShapeSource | ResultSource


def run(config: ConvertConfig) -> Iterator[Result]:
    """Read the files and write them; yields a Result per batch."""
    if config.to in MESH_FORMATS:
        yield from write_meshes(
            config.files, config.dictionary, config.output, config.to
        )
        return
    target = find_target_format(config.output, config.to)
    options = input_options(config, "motion" if target.in_metres else "none")
    kind = find_common_kind(config.files, options)
    if kind == "dictionary":
        yield convert_dictionary(config, target)
        return
    keys = ("height", "unit", "up", "markers")
    output = OutputOptions(**{key: getattr(config, key) for key in keys})
    with (
        open_source(kind, config.files, options) as source,
        record_writer(config.output, LAYOUTS[kind], config.to, output) as writer,
    ):
        batches, count = select(source, config)
        noun = "shape" if kind == "shapes" else "image"
        for batch in batches:
            if rate := config.frame_rate or batch.frame_rate:
                batch = replace(batch, frame_rate=rate / config.every)
            writer.append(batch)
            yield Result(done=len(batch), total=count, unit=noun)
        warnings = source.notes + nothing_in(count, f"{noun}s")
    summary = writer.summary
    yield Result(
        total=count,
        warnings=warnings + summary.warnings,
        note="; ".join(filter(None, [summary.note, summary.angles])),
        written=summary.written or (config.output,),
    )


def convert_dictionary(config: ConvertConfig, target: FileFormat) -> Result:
    """Write a dictionary in the present version, or its atoms as a table of shapes.

    Raises InputError for several dictionaries, and for other formats.
    """
    if target not in (HDF5, CSV) or len(config.files) > 1:
        problem = "is a dictionary, which is written one at a time"
        fix = "name an output in .h5, or in .csv for its atoms as shapes"
        raise input_error(config.files[0], problem, fix)
    dictionary = read_dictionary(config.files[0], old=True)
    if target is HDF5:
        write_dictionary(config.output, dictionary)
        return Result(done=1, total=1, unit="dictionary", written=(config.output,))
    with record_writer(config.output, SHAPES, config.to) as writer:
        writer.append(atoms_of(dictionary))
    number = dictionary.k
    return Result(done=number, total=number, unit="shape", written=(config.output,))


def find_common_kind(files: Sequence[Path], options: InputOptions) -> Kind:
    """Return what the files hold. Raises InputError where they hold different
    things.
    """
    if any(map(is_stream, files)):
        return "landmarks"
    first = find_kind(files[0], options)
    for path in files[1:]:
        if (kind := find_kind(path, options)) != first:
            problem = f"holds {kind}, and {files[0]} holds {first}"
            raise input_error(path, problem, "convert them one after the other")
    return first


def open_source(kind: Kind, files: Sequence[Path], options: InputOptions) -> AnySource:
    """Open files of a kind. Raises InputError for options of reading that results do
    not have.
    """
    options = replace(options, individual=None)  # whom `select` selects
    if kind == "landmarks":
        return open_landmarks(files, options)
    if kind == "shapes":
        return open_shapes(files, options, gaps=True)
    for key, value in vars(options).items():
        if value != getattr(AS_THEY_ARE, key) and key not in ("format", "track"):
            problem = "has no effect on results, which are written as they are"
            raise input_error(key, problem, "leave it out")
    return open_results(files, without=(), old=True)


def select(source: AnySource, config: ConvertConfig) -> tuple[Iterator[AnyRecord], int]:
    """Return batches of the wanted individual's items, every n-th of each sequence; how
    many.

    The name of an individual is the last part of that of its sequence. Frames are
    thinned by their numbers, so that all individuals of a video keep the same ones, and
    are numbered anew; without numbers, by their order. Raises InputError where no
    individual has the name.
    """
    wanted, every = config.individual, config.every
    if (wanted is None and every == 1) or not source.count:
        return source.batches(BATCH), source.count
    sequences = np.array(list(chain.from_iterable(source.sequences())), object)
    rows = np.arange(source.count)
    if wanted is not None:
        rows = np.flatnonzero(
            [s == wanted or s.endswith(f"/{wanted}") for s in sequences]
        )
        if not len(rows):
            others = list(
                dict.fromkeys(name.rpartition("/")[2] for name in sequences if name)
            )
            fix = (
                f"there are {abbreviate(others)}"
                if others
                else "leave `individual` out"
            )
            place = ", ".join(map(str, config.files))
            raise input_error(place, f"has no individual {wanted!r}", fix)
    numbers = None
    if every > 1:
        keys = keys_of(source.batches(BATCH))
        frame = np.array(keys.by_frame()[1], np.int64)[rows]
        videos = [
            name if keys.frames is None else name.rpartition("/")[0]
            for name in sequences
        ]
        video = np.unique(np.array(videos, str)[rows], return_inverse=True)[1]
        first = np.full(len(rows), frame.max())
        np.minimum.at(first, video, frame)
        number, left = np.divmod(frame - first[video] % every, every)
        rows = rows[left == 0]
        numbers = None if keys.frames is None else number[left == 0]

    def batches() -> Iterator[AnyRecord]:
        done = 0
        for records in source.chosen(rows, BATCH):
            frame = None if numbers is None else numbers[done : done + len(records)]
            yield records if frame is None else replace(records, frames=frame)
            done += len(records)

    return batches(), len(rows)

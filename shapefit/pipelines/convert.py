"""`convert`: landmarks, shapes or results in, the same in another format out."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import chain
from pathlib import Path

import numpy as np

from shapefit.arrays import Indices, Integers
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
from shapefit.io.source import (
    AnyRecord,
    FileKind,
    ResultSource,
    find_kind,
    open_results,
)
from shapefit.pipelines.items import MatchKeys, join_match_keys
from shapefit.pipelines.meshes import write_meshes
from shapefit.pipelines.result import Result, warn_of_empty
from shapefit.pipelines.unfinished import describe_unfinished

ITEMS_AT_ONCE = 4096
"""Items in memory at a time."""

LAYOUT_OF_KIND = {"landmarks": LANDMARKS, "shapes": SHAPES, "result": RESULTS}

ConvertedSource = LandmarkSource | ShapeSource | ResultSource


def convert_files(config: ConvertConfig) -> Iterator[Result]:
    """Convert files to another format, as a config says; yields a Result per batch."""
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
    output = OutputOptions(
        height=config.height, unit=config.unit, up=config.up, markers=config.markers
    )
    layout = LAYOUT_OF_KIND[kind]
    with (
        open_source(kind, config.files, options) as source,
        record_writer(config.output, layout, config.to, output) as writer,
    ):
        batches, count = select_items(source, config)
        noun = "shape" if kind == "shapes" else "image"
        for batch in batches:
            rate = config.frame_rate or batch.frame_rate
            if rate:
                batch = replace(batch, frame_rate=rate / config.every)
            writer.append(batch)
            yield Result(done=len(batch), total=count, unit=noun)
        warnings = (
            *describe_unfinished(config.files),
            *source.notes,
            *warn_of_empty(count, f"{noun}s"),
        )
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


def find_common_kind(files: Sequence[Path], options: InputOptions) -> FileKind:
    """Return the kind of content that all files have; InputError where kinds differ.

    Streams cannot be looked into: with one among them it is "landmarks".
    """
    if any(map(is_stream, files)):
        return "landmarks"
    first = find_kind(files[0], options)
    for path in files[1:]:
        kind = find_kind(path, options)
        if kind != first:
            problem = f"holds {kind}, and {files[0]} holds {first}"
            raise input_error(path, problem, "convert them one after the other")
    return first


def open_source(
    kind: FileKind, files: Sequence[Path], options: InputOptions
) -> ConvertedSource:
    """Open files as landmarks, shapes or results, by their kind.

    Raises InputError for options that results do not have.
    """
    options = replace(options, individual=None)  # whom `select_items` selects
    if kind == "landmarks":
        return open_landmarks(files, options)
    if kind == "shapes":
        return open_shapes(files, options, gaps=True)
    for key, value in vars(options).items():
        if value != getattr(AS_THEY_ARE, key) and key not in ("format", "track"):
            problem = "has no effect on results, which are written as they are"
            raise input_error(key, problem, "leave it out")
    return open_results(files, without=(), old=True)


def select_items(
    source: ConvertedSource, config: ConvertConfig
) -> tuple[Iterator[AnyRecord], int]:
    """Return batches of the items that the config asks for, and the number of items.

    They are those of its `individual`, whose name is the last part of that of its
    sequence, and of each sequence every n-th. Raises InputError where no individual has
    the name.
    """
    if (config.individual is None and config.every == 1) or not source.count:
        return source.batches(ITEMS_AT_ONCE), source.count
    sequences = list(chain.from_iterable(source.sequences()))
    rows = np.arange(source.count)
    if config.individual is not None:
        rows = find_individual(sequences, config.individual, config.files)
    if config.every == 1:
        return source.select(rows, ITEMS_AT_ONCE), len(rows)
    keys = join_match_keys(source.batches(ITEMS_AT_ONCE))
    rows, numbers = thin_frames(rows, keys, sequences, config.every)
    if keys.frames is None:
        return source.select(rows, ITEMS_AT_ONCE), len(rows)

    def numbered_anew() -> Iterator[AnyRecord]:
        """Yield the wanted items with their new frame numbers."""
        done = 0
        for records in source.select(rows, ITEMS_AT_ONCE):
            yield replace(records, frames=numbers[done : done + len(records)])
            done += len(records)

    return numbered_anew(), len(rows)


def find_individual(
    sequences: Sequence[str], wanted: str, files: Sequence[Path]
) -> Indices:
    """Return the rows of the images of one individual; InputError for an unknown name.

    Its name is that of its sequence, or the last part of that.
    """
    is_wanted = [name == wanted or name.endswith(f"/{wanted}") for name in sequences]
    rows = np.flatnonzero(is_wanted)
    if not len(rows):
        individuals = [name.rpartition("/")[2] for name in sequences if name]
        fix = "leave `individual` out"
        if individuals:
            fix = f"there are {abbreviate(list(dict.fromkeys(individuals)))}"
        place = ", ".join(map(str, files))
        raise input_error(place, f"has no individual {wanted!r}", fix)
    return rows


def thin_frames(
    rows: Indices, keys: MatchKeys, sequences: Sequence[str], every: int
) -> tuple[Indices, Integers]:
    """Return every n-th of `rows` in each sequence, and the new frame numbers of these.

    Frames are thinned by their numbers, so that all individuals of a video keep the
    same ones; without numbers, by their order.
    """
    _, frames = keys.by_frame()
    frame = np.array(frames, np.int64)[rows]
    videos = sequences
    if keys.frames is not None:
        videos = [name.rpartition("/")[0] for name in sequences]
    _, video = np.unique(np.array(videos, str)[rows], return_inverse=True)
    first = np.full(len(rows), frame.max())
    np.minimum.at(first, video, frame)
    number, left = np.divmod(frame - first[video] % every, every)
    is_retained = left == 0
    return rows[is_retained], number[is_retained]

"""`convert`: landmarks, shapes or results in, the same in another format out."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

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
from shapefit.io.formats import CSV, HDF5, FileFormat, find_target_format, record_writer
from shapefit.io.inputs import is_stream
from shapefit.io.layout import LANDMARKS, RESULTS, SHAPES
from shapefit.io.listing import Kind, find_kind
from shapefit.io.options import AS_THEY_ARE, InputOptions, OutputOptions, input_options
from shapefit.io.source import ResultSource, open_results
from shapefit.pipelines.items import keys_of
from shapefit.pipelines.outcome import Outcome, nothing_in

if TYPE_CHECKING:
    from shapefit.meshes.export import MeshFormat

MESH_FORMATS = ("obj", "ply", "glb")
"""Of a folder with one file per image."""

BATCH = 4096
"""Items in memory at a time."""

SELECTING = {"format", "individual", "track"}
"""Options of inputs that results have, too."""
FORMS = {"landmarks": LANDMARKS, "shapes": SHAPES, "result": RESULTS}

Source = LandmarkSource | ShapeSource | ResultSource


def run(config: ConvertConfig) -> Iterator[Outcome]:
    """Read the files and write them, yield an Outcome per chunk."""
    if config.to in MESH_FORMATS:
        yield from write_meshes(config)
        return
    target = find_target_format(config.output, config.to)
    options = input_options(config, "motion" if target.in_metres else "none")
    kind = find_common_kind(config.files, options)
    if kind == "dictionary":
        yield rewrite_dictionary(config, target)
        return
    for key, value in vars(options).items() if kind == "result" else ():
        if key not in SELECTING and value != getattr(AS_THEY_ARE, key):
            found = "has no effect on results, which are written as they are"
            raise input_error(key, found, "leave it out")
    if config.frame_rate is not None and target is CSV:
        found = "`frame_rate` has no effect here: CSV does not hold it"
        raise input_error("frame_rate", found, "leave it out, or write .h5")
    height, unit, up, markers = config.height, config.unit, config.up, config.markers
    placed = OutputOptions(height=height, unit=unit, up=up, markers=markers)
    with (
        _open(kind, config.files, options) as source,
        record_writer(config.output, FORMS[kind], config.to, placed) as writer,
    ):
        chunks, count = _choose(source, config)
        noun = "shape" if kind == "shapes" else "image"
        for chunk in chunks:
            writer.append(_with_rate(chunk, config))
            yield Outcome(done=len(chunk), total=count, unit=noun)
        warnings = source.notes + nothing_in(count, f"{noun}s")
        yield Outcome(total=count, warnings=warnings)
    summary = writer.summary
    written = summary.written or (config.output,)
    yield Outcome(warnings=summary.warnings, note=summary.note, written=written)


def rewrite_dictionary(config: ConvertConfig, target: FileFormat) -> Outcome:
    """Write a dictionary as HDF5 of today's version. Raises InputError for other formats."""
    if target is not HDF5 or len(config.files) > 1:
        found = "is a dictionary, which is written as HDF5, one file at a time"
        raise input_error(config.files[0], found, "name one dictionary, and an output in .h5")
    write_dictionary(config.output, read_dictionary(config.files[0], old=True))
    return Outcome(done=1, total=1, unit="dictionary", written=(config.output,))


def write_meshes(config: ConvertConfig) -> Iterator[Outcome]:
    """Write a mesh of each image of the results into a folder; yields an Outcome per chunk."""
    from shapefit.pipelines.meshes import check_dictionary, check_mesh_folder, mesh_writer

    if config.dictionary is None:
        fix = "name the dictionary of the fit, for example -d cars.h5"
        raise input_error("dictionary", "meshes are made of those of a dictionary", fix)
    to: MeshFormat = config.to  # type: ignore[assignment]
    check_mesh_folder(config.output, "output", to)
    dictionary = read_dictionary(config.dictionary)
    with open_results(config.files, without=()) as source:
        if source.head.landmark_names != dictionary.landmark_names:
            found = f"its landmarks are not those of {config.files[0]}"
            raise input_error(config.dictionary, found, "name the dictionary of the fit")
        mixes = source.head.coefficients is not None
        check_dictionary(dictionary, config.files[0], mixes_atoms=mixes)
        with mesh_writer(dictionary, config.output, to) as writer:
            for chunk in source.batches(BATCH):
                writer.add(chunk)
                yield Outcome(done=len(chunk), total=source.count, unit="image")
        warnings = (*writer.warnings, *nothing_in(source.count, "images"))
        yield Outcome(
            total=source.count, warnings=warnings, note=writer.note, written=writer.written
        )


def find_common_kind(files: Sequence[Path], options: InputOptions) -> Kind:
    """Return what the files hold. Raises InputError where they hold different things."""
    if any(map(is_stream, files)):
        return "landmarks"
    kinds = {path: find_kind(path, options) for path in files}
    first = kinds[files[0]]
    for path, kind in kinds.items():
        if kind != first:
            found = f"holds {kind}, and {files[0]} holds {first}"
            raise input_error(path, found, "convert them one after the other")
    return first


def _open(kind: Kind, files: Sequence[Path], options: InputOptions) -> Source:
    if kind == "landmarks":
        return open_landmarks(files, options, selects=True)
    if kind == "shapes":
        return open_shapes(files, options, gaps=True, selects=True)
    return open_results(files, without=(), old=True)


def _choose(source: Source, config: ConvertConfig) -> tuple[Iterator[Any], int]:
    """Return the items of the individual that is wanted, every n-th of each sequence; how many.

    An individual is the last part of a sequence's name. Raises InputError where none is called so.
    """
    wanted, every = config.individual, config.every
    if wanted is None and every == 1:
        return source.batches(BATCH), source.count
    sequences = list(chain.from_iterable(source.sequences()))
    rows = np.arange(source.count)
    if wanted is not None:
        own = [name == wanted or name.endswith(f"/{wanted}") for name in sequences]
        rows = rows[np.array(own, dtype=bool)]
        if not len(rows) and source.count:
            names = dict.fromkeys(name.rpartition("/")[2] for name in sequences if name)
            fix = f"there are {abbreviate(list(names))}" if names else "leave `individual` out"
            found = f"has no individual {wanted!r}"
            raise input_error(", ".join(map(str, config.files)), found, fix)
    frames = None
    if every > 1:
        rows, frames = _thinned(source, rows, np.array(sequences, object)[rows], every)

    def parts() -> Iterator[Any]:
        for own in (slice(start, start + BATCH) for start in range(0, len(rows), BATCH)):
            records = source.take(rows[own])
            yield records if frames is None else records.replaced(frame=frames[own])

    return parts() if len(rows) else source.batches(BATCH), len(rows)


def _thinned(
    source: Source, rows: NDArray[np.intp], sequences: NDArray[Any], every: int
) -> tuple[NDArray[np.intp], NDArray[np.int64] | None]:
    """Return the rows of every n-th frame, and the numbers of these among those that stay.

    Where items have no number of a frame, every n-th of each sequence stays, without a number.
    The individuals of a video keep the same frames.
    """
    stated = keys_of(source.batches(BATCH)).frames
    videos = sequences if stated is None else [name.rpartition("/")[0] for name in sequences]
    video = np.unique(np.array(videos, str), return_inverse=True)[1]
    if stated is None:
        order = np.argsort(video, kind="stable")
        starts = np.searchsorted(video[order], np.arange(video.max(initial=-1) + 1))
        place = np.empty(len(rows), np.int64)
        place[order] = np.arange(len(rows)) - starts[video[order]]
        return rows[place % every == 0], None
    frames = np.array(stated, np.int64)[rows]
    first = np.full(video.max(initial=-1) + 1, np.iinfo(np.int64).max)
    np.minimum.at(first, video, frames)
    number, left = np.divmod(frames - first[video] % every, every)
    return rows[left == 0], number[left == 0]


def _with_rate(records: Any, config: ConvertConfig) -> Any:
    """Return the records with the frame rate that the config leaves them, where one is known."""
    rate = config.frame_rate or records.frame_rate
    if rate is None or (config.frame_rate is None and config.every == 1):
        return records
    return records.replaced(frame_rate=rate / config.every)

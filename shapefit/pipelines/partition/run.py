"""`fit` into a folder: parts of the images, one result each, and a manifest of those that are done.

Parts are files, recordings of several files, or ranges of rows of an HDF5 file. Running again does
the parts that are missing. Results that this run would not give are refused.
"""

from __future__ import annotations

import hashlib
import json
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import asdict, replace
from itertools import chain, count
from pathlib import Path
from typing import Any, NamedTuple

from shapefit.config import FitConfig
from shapefit.config.paths import DONE, ResultFolder
from shapefit.errors import InputError, abbreviate, counted, input_error, listed
from shapefit.io import LandmarkSet, digest, open_landmarks, read_dictionary
from shapefit.io.detect import group_inputs
from shapefit.io.formats import HDF5
from shapefit.io.inputs import is_stream
from shapefit.io.layout import LANDMARK_COVARIANCE
from shapefit.io.options import InputOptions
from shapefit.io.source import Source, SourceFile
from shapefit.lifting.methods import AUTO, METHODS
from shapefit.pipelines.fit.camera import OF_CAMERAS
from shapefit.pipelines.fit.prepare import (
    FIRST,
    Estimates,
    choose_method,
    files_of,
    in_sequences,
    prepare,
    read_options,
)
from shapefit.pipelines.fit.run import whole_blocks
from shapefit.pipelines.partition.executor import Job, do_jobs, find_state, once
from shapefit.pipelines.partition.manifest import Entry, Manifest, Part, locked, read_manifest
from shapefit.pipelines.result import Result

OF_THE_RUN = {"landmarks", "output", "dictionary", "data", "threads"}
"""Keys that do not change what a part holds; the dictionary counts by its digest."""


class Plan(NamedTuple):
    """What a run does to a folder: the parts that it is to have, and lines of those retained.

    removed are files of results of other inputs; refused says which would be lost, "" for none;
    digests are of all that every part depends on.
    """

    parts: Sequence[Part]
    retained: Mapping[str, Entry]
    removed: Sequence[str]
    refused: str
    digests: Mapping[str, str]


def run(config: FitConfig) -> Iterator[Result]:
    """Lift landmarks part by part into the folder that is the output."""
    folder = config.output
    assert isinstance(folder, ResultFolder), "the output is a folder"
    if any(map(is_stream, config.landmarks)):
        fault = "standard input cannot be divided into parts"
        raise input_error("landmarks", fault, "save it to a file and name that")
    if config.export.folder is not None:
        fix = "leave it out; `shapefit convert FOLDER -d DICT -o meshes/ --to ply` writes them"
        raise input_error("export.folder", "is not written for a folder of results", fix)
    manifest = read_manifest(folder.path)
    dictionary = once(read_dictionary, config.dictionary, find_state(config.dictionary))
    if config.method == AUTO and manifest is not None:
        config = config.changed(method=manifest.run["method"])
    config, chosen = choose_method(config, dictionary, lambda: in_sequences(config))
    plan = make_plan(config, folder, manifest)
    if plan.refused and not folder.replace:
        fix = "name another folder, or add --replace, which removes and redoes what differs"
        raise input_error(folder.path, f"holds results that differ: {plan.refused}", fix)
    if manifest is not None and plan.retained:
        estimates = Estimates(**manifest.run["estimated"])
    else:
        images = first_images(config, plan.parts)
        names, number = images.landmark_names, len(images)
        setup = yield from prepare(config, dictionary, names, lambda: images, number)
        estimates = setup.estimates
    first = {**plan.digests, "method": config.method, "estimated": asdict(estimates)}
    with locked(folder.path):
        yield from (Result(line=line) for line in (chosen, *estimates.lines))
        yield Result(warnings=estimates.warnings)
        manifest = Manifest(folder.manifest, first, dict(plan.retained))
        yield from do_parts(config, folder, plan, manifest, estimates)


def make_plan(config: FitConfig, folder: ResultFolder, manifest: Manifest | None) -> Plan:
    """Compare the parts that a config asks for with those that a folder has.

    A part stays where its result has the size that was written, and config and inputs are the same.
    """
    old = manifest or Manifest(folder.manifest, {})
    parts = find_parts(config, folder.partition, {key_of(p): f for f, p in old.parts.items()})
    plain = {key: value for key, value in config.as_plain().items() if key not in OF_THE_RUN}
    text = json.dumps(plain | {"partition": folder.partition}, sort_keys=True)
    digests = {"config": hashlib.sha256(text.encode()).hexdigest()}
    digests |= {key: digest(path) for key, path in files_of(config).items()}
    done, states = old.done, {part.file: part.describe()["states"] for part in parts}
    changed = [key for key in digests if done and old.run.get(key) != digests[key]]
    lost = [file for file in done if changed or states.get(file) != done[file]["states"]]
    names = dict.fromkeys(Path(path).name for file in lost for path in done[file]["inputs"])
    refused = f"of {abbreviate(list(names), 3)} before it changed, or not among the inputs"
    if changed:
        refused = f"of another {listed(changed, 'and')}"
    retained = {
        file: entry
        for file, entry in done.items()
        if file not in lost and find_state(folder.path / file)[0] == entry["bytes"]
    }
    removed = [file for file in lost if file not in states]
    return Plan(parts, retained, removed, refused if lost else "", digests)


def find_parts(
    config: FitConfig, size: int, named: Mapping[tuple[Any, ...], str] | None = None
) -> list[Part]:
    """Return the parts of a fit, of `size` images or more; those named already keep their files."""
    options, named = read_options(config), named or {}
    names = (f"part-{number:05}.h5" for number in count())
    free = (name for name in names if name not in named.values())
    parts = []
    for file_format, inputs in group_inputs(list(config.landmarks), options):
        ranges: Sequence[tuple[int, int] | None] = [None]
        if file_format is HDF5:
            ranges = divide(inputs, options, size, by_sequence=METHODS[config.method].sequences)
        for rows in ranges:
            part = Part("", inputs, rows, tuple(map(find_state, inputs)))
            file = named.get(key_of(part.describe()))
            parts.append(part._replace(file=file or next(free)))
    return parts


def divide(
    inputs: tuple[Path, ...], options: InputOptions, size: int, *, by_sequence: bool
) -> Sequence[tuple[int, int] | None]:
    """Return the ranges of rows of an HDF5 file that are parts, cut where no result changes.

    That is after whole blocks of images, which start from each other, or between sequences.
    """
    try:
        with open_landmarks(inputs, options, head=True) as source:
            total, cuts = source.count, list(range(0, source.count, whole_blocks(size)))
            if by_sequence:
                names, cuts = list(chain.from_iterable(source.sequences())), [0]
                for row in range(1, total):
                    if names[row] != names[row - 1] and row - cuts[-1] >= size:
                        cuts.append(row)
    except InputError:  # whoever does its part reports it
        return [None]
    return list(zip(cuts, [*cuts[1:], total], strict=True)) if len(cuts) > 1 else [None]


def key_of(entry: Mapping[str, Any]) -> tuple[Any, ...]:
    """Return what the part of a line is made of: paths of the inputs, and rows."""
    return tuple(entry["inputs"]), entry["rows"] and tuple(entry["rows"])


def first_images(config: FitConfig, parts: Sequence[Part]) -> LandmarkSet:
    """Return the FIRST images of all parts, with what else estimates need.

    Inputs that cannot be read, or do not go with the first, are left out: their part reports them.
    """
    options, files, images = read_options(config), list[SourceFile[LandmarkSet]](), 0
    needed = {*OF_CAMERAS, LANDMARK_COVARIANCE, config.leave_one_out}
    for part in parts:
        try:
            with open_landmarks(part.inputs, options, part.slice) as source:
                read = source.first(FIRST - images)
        except InputError as error:
            problem = error
            continue
        bare = read.without(read.further.keys() - needed)
        files.append(SourceFile.of(str(part), bare, y_axis=bare.y_axis))
        images += len(bare)
        if images >= FIRST:
            break
    if not files:
        raise problem
    try:
        return Source(files, check=False).first(FIRST)
    except InputError:
        return Source(files[:1]).first(FIRST)


def do_parts(
    config: FitConfig, folder: ResultFolder, plan: Plan, manifest: Manifest, estimates: Estimates
) -> Iterator[Result]:
    """Do the parts that are not retained, as they end; remove what is of no part."""
    if config.threads == 0 and (folder.workers or folder.scheduler or folder.scheduler_file):
        config = config.changed(threads=1)
    shared = config.changed(landmarks=(), **estimates.values)  # each part names its own
    todo = (part for part in plan.parts if part.file not in plan.retained)
    jobs = deque(Job(part, shared, folder.path, estimates) for part in todo)
    total, lost = counted(len(plan.parts), "part"), 0
    manifest.write()
    for file in plan.removed:
        (folder.path / file).unlink(missing_ok=True)
    with closing(do_jobs(jobs, folder)) as ended:
        for entry, result in ended:
            manifest.add(entry)
            lost += entry["status"] != DONE
            failed = f", {lost} failed" if lost else ""
            yield replace(result, note=f"{len(manifest.done)} of {total} done{failed}")
    note = f"{len(manifest.done)} of {total} done"
    yield Result(note=note, written=(manifest.path,))

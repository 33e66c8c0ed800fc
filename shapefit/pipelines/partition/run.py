"""`fit` into a folder: parts of the images, one result each, and a manifest of those that are done.

Running again does the parts that are missing, and those of inputs that were added. A folder that
holds results which this run would not give is refused, but with `replace`.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import asdict, replace
from pathlib import Path

from shapefit.config import FitConfig
from shapefit.config.paths import DONE, ResultFolder
from shapefit.errors import InputError, counted, input_error
from shapefit.io import LandmarkSet, open_landmarks
from shapefit.io.inputs import is_stream
from shapefit.io.layout import LANDMARK_COVARIANCE
from shapefit.io.source import Source, SourceFile, open_results
from shapefit.lifting.methods import AUTO
from shapefit.pipelines.fit.camera import OF_CAMERAS
from shapefit.pipelines.fit.prepare import (
    FIRST,
    Estimates,
    choose_method,
    in_sequences,
    prepare,
    read_options,
)
from shapefit.pipelines.outcome import Outcome
from shapefit.pipelines.partition.executor import Job, dictionary_of, do_jobs
from shapefit.pipelines.partition.manifest import Manifest, locked, read_manifest
from shapefit.pipelines.partition.plan import Part, Plan, find_state, make_plan, warn_of_large


def run(config: FitConfig) -> Iterator[Outcome]:
    """Lift landmarks part by part into the folder that is the output."""
    folder = config.output
    assert isinstance(folder, ResultFolder), "the output is a folder"
    if any(map(is_stream, config.landmarks)):
        found = "standard input cannot be divided into parts"
        raise input_error("landmarks", found, "save it to a file and name that")
    if config.export.folder is not None:
        fix = "leave it out; `shapefit convert FOLDER -d DICT -o meshes/ --to ply` writes them"
        raise input_error("export.folder", "is not written for a folder of results", fix)
    manifest = read_manifest(folder.path)
    dictionary = dictionary_of(config.dictionary, find_state(config.dictionary))
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
        estimates = prepare(config, dictionary, images.landmark_names, lambda: images).estimates
    first = {**plan.digests, "method": config.method, "estimated": asdict(estimates)}
    with locked(folder.path):
        yield from (Outcome(line=line) for line in (chosen, *estimates.lines))
        yield Outcome(warnings=(*estimates.warnings, *warn_of_large(plan.parts)))
        manifest = Manifest(folder.manifest, first, dict(plan.retained))
        yield from do_parts(config, folder, plan, manifest, estimates)


def first_images(config: FitConfig, parts: Sequence[Part]) -> LandmarkSet:
    """Return the FIRST images of all parts, with what else estimates need.

    Inputs that cannot be read, or do not go with the first, are left out: their part reports them.
    Raises InputError where none of them can be read.
    """
    options, read, unreadable = read_options(config), list[LandmarkSet](), list[InputError]()
    for part in parts:
        left = FIRST - sum(map(len, read))
        if left <= 0:
            break
        rows = (
            None
            if part.rows is None
            else slice(part.rows[0], min(part.rows[1], part.rows[0] + left))
        )
        try:
            with open_landmarks(part.inputs, options, rows) as source:
                read.append(source.first(left))
        except InputError as error:
            unreadable.append(error)
    if not read:
        raise unreadable[0]
    needed = {*OF_CAMERAS, LANDMARK_COVARIANCE}
    bare = [images.without(images.further.keys() - needed) for images in read]
    files = [SourceFile.of(str(n), images, y_axis=images.y_axis) for n, images in enumerate(bare)]
    try:
        return Source(files, check=False).first(FIRST)
    except InputError:
        return bare[0]


def do_parts(
    config: FitConfig, folder: ResultFolder, plan: Plan, manifest: Manifest, estimates: Estimates
) -> Iterator[Outcome]:
    """Do the parts that are not retained, as they end; remove what is of no part."""
    if config.threads == 0 and (folder.workers or folder.scheduler or folder.scheduler_file):
        config = config.changed(threads=1)
    shared = config.changed(landmarks=(), **estimates.values)  # each part names its own
    silent = replace(estimates, lines=(), warnings=())
    jobs = deque(Job(part, shared, folder.path, silent) for part in plan.todo)
    total, lost = counted(len(plan.parts), "part"), 0
    manifest.write()
    for file in plan.removed:
        (folder.path / file).unlink(missing_ok=True)
    with closing(do_jobs(jobs, folder)) as ended:
        for entry, outcome in ended:
            manifest.add(entry)
            lost += entry["status"] != DONE
            failed = f", {lost} failed" if lost else ""
            yield replace(outcome, note=f"{len(manifest.done)} of {total} done{failed}")
    yield Outcome(
        warnings=items_in_two(folder.path, sorted(manifest.done)) if plan.todo else (),
        note=f"{len(manifest.done)} of {total} done",
        written=(manifest.path,),
    )


def items_in_two(folder: Path, files: list[str]) -> tuple[str, ...]:
    """Warn of items that are in two or more parts, if there are any."""
    if not files:
        return ()
    with open_results([folder / file for file in files]) as source:
        return tuple(f"{note}; `eval` cannot tell them apart" for note in source.notes)

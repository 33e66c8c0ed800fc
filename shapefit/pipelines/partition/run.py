"""`fit` into a folder: parts of the images, one result each, and a manifest of those that are done.

Running again does the parts that are missing. Results that this run would not give are refused.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import asdict, replace

from shapefit.config import FitConfig
from shapefit.config.paths import DONE, ResultFolder
from shapefit.errors import InputError, counted, input_error
from shapefit.io import LandmarkSet, open_landmarks, read_dictionary
from shapefit.io.inputs import is_stream
from shapefit.io.layout import LANDMARK_COVARIANCE
from shapefit.io.source import Source, SourceFile
from shapefit.lifting.methods import AUTO
from shapefit.pipelines.fit.camera import OF_CAMERAS
from shapefit.pipelines.fit.prepare import FIRST, choose_method, in_sequences, prepare, read_options
from shapefit.pipelines.fit.sample import Estimates
from shapefit.pipelines.partition.executor import Job, do_jobs, once
from shapefit.pipelines.partition.manifest import Manifest, locked, read_manifest
from shapefit.pipelines.partition.plan import Part, Plan, find_state, make_plan
from shapefit.pipelines.result import Result


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
        estimates = prepare(config, dictionary, images.landmark_names, lambda: images).estimates
    first = {**plan.digests, "method": config.method, "estimated": asdict(estimates)}
    with locked(folder.path):
        yield from (Result(line=line) for line in (chosen, *estimates.lines))
        yield Result(warnings=estimates.warnings)
        manifest = Manifest(folder.manifest, first, dict(plan.retained))
        yield from do_parts(config, folder, plan, manifest, estimates)


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
        return files[0].read(slice(None))


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

"""`fit` into a folder: parts of the images, a result each, and a manifest of these.

Parts are files, recordings of several files, or ranges of rows of an HDF5 file. Running
again does the parts that are missing. Results that this run would not give are refused.
"""

from __future__ import annotations

import hashlib
import json
import logging
import multiprocessing
import os
import platform
import signal
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from concurrent import futures
from concurrent.futures import BrokenExecutor, Executor, Future
from contextlib import closing, contextmanager, suppress
from dataclasses import replace
from functools import lru_cache
from itertools import chain, count, pairwise
from pathlib import Path
from typing import Annotated, Any, NamedTuple

from pydantic import BaseModel, TypeAdapter

from shapefit import __version__, log
from shapefit.config import FitConfig
from shapefit.config.manifest import (
    DONE,
    FAILED,
    PartLine,
    RunLine,
    manifest_error,
    part_name,
    part_number,
)
from shapefit.config.paths import ResultFolder
from shapefit.dictionary.model import Dictionary
from shapefit.errors import (
    InputError,
    abbreviate,
    counted,
    input_error,
    listed,
    path_text,
    printable,
)
from shapefit.io import (
    LandmarkSource,
    digest,
    digests,
    open_landmarks,
    read_dictionary,
)
from shapefit.io.detect import group_inputs
from shapefit.io.formats import HDF5
from shapefit.io.inputs import State, find_state, is_stream
from shapefit.io.options import InputOptions
from shapefit.io.source import Source, SourceFile
from shapefit.lifting.methods import AUTO, METHODS
from shapefit.pipelines.fit.calibration import SAMPLE_POOL, Calibrating, calibrate
from shapefit.pipelines.fit.camera import CAMERA_DATASETS
from shapefit.pipelines.fit.choices import (
    are_in_sequences,
    choose_method,
    files_of,
    match_to_dictionary,
    reading_options,
)
from shapefit.pipelines.fit.family import Calibration, round_to_blocks
from shapefit.pipelines.fit.fit import FitPart, fit
from shapefit.pipelines.fit.summary import camera_numbers, format_gap
from shapefit.pipelines.partition.manifest import (
    Manifest,
    Part,
    find_unlisted,
    hold_lock,
    numbers_of_parts,
    read_manifest,
    refuse_unlisted,
)
from shapefit.pipelines.partition.together import (
    LiftedPart,
    OpenParts,
    TogetherLifter,
    write_lifted,
)
from shapefit.pipelines.result import Failure, Numbers, Result, merge_warnings
from shapefit.records import Landmarks
from shapefit.threads import make_pool

KEYS_OF_THE_RUN = {"landmarks", "output", "dictionary", "data", "threads"}
"""Keys that do not change what a part holds; the dictionary counts by its digest."""

PARTS_PER_THREAD = 4
"""That each thread of a cluster has waiting; more would only fill the scheduler."""

MAX_LISTED_OF_A_PART = 20
"""Failures and warnings of a part that are reported one by one."""

EndedPart = tuple[PartLine, Result]
"""The line in the manifest of a part that has ended, and its result."""

PartKey = tuple[tuple[str, ...], tuple[int, int] | None]
"""What a part is made of: paths of the inputs, and rows."""


BETWEEN_LOOKS = 0.5
"""Seconds in which a Dask worker learns that a part is not wanted any more."""


class Job(NamedTuple):
    """A part, the config of the run, the folder of its result, and what all parts
    share.

    states are those of the files beside landmarks that results depend on. lifted and
    source are of the part, where it was lifted with others, or opened, in this process.
    """

    part: Part
    config: FitConfig
    folder: Path
    calibration: Calibration | None = None
    states: Mapping[Path, State] = {}
    version: str = __version__
    lifted: LiftedPart | None = None
    source: LandmarkSource | None = None


class FolderPlan(NamedTuple):
    """What a run does to a folder: the parts that it is to have, and those retained.

    removed are files of results of other inputs; refused says which would be lost, ""
    for none; digests are of all that every part depends on, and states of the files
    among that.
    """

    parts: Sequence[Part]
    retained: Mapping[str, PartLine]
    removed: Sequence[str]
    refused: str
    digests: Mapping[str, str]
    states: Mapping[Path, State]


def fit_parts(config: FitConfig) -> Iterator[Result]:
    """Lift landmarks part by part into the folder that is the output."""
    folder = config.output
    assert isinstance(folder, ResultFolder), "the output is a folder"
    if any(map(is_stream, config.landmarks)):
        fault = "standard input cannot be divided into parts"
        raise input_error("landmarks", fault, "save it to a file and name that")
    if config.export.folder is not None:
        fault = "is not written for a folder of results"
        fix = (
            "leave it out; `shapefit convert FOLDER -d DICT -o meshes/ --to ply` writes"
            " them"
        )
        raise input_error("export.folder", fault, fix)
    with hold_lock(folder.path):
        yield from fit_locked_folder(config, folder)


def fit_locked_folder(config: FitConfig, folder: ResultFolder) -> Iterator[Result]:
    """Plan and lift the parts of a folder whose lock this run holds."""
    manifest = read_manifest(folder.path)
    unlisted = find_unlisted(folder.path, manifest)
    if not folder.replace:
        refuse_unlisted(folder.path, unlisted)
    dictionary = cached_read(
        read_dictionary, config.dictionary, find_state(config.dictionary)
    )
    if config.method == AUTO and manifest is not None:
        config = config.changed(method=method_of(manifest))
    config, chosen = choose_method(config, dictionary, lambda: are_in_sequences(config))
    plan = plan_folder(config, folder, manifest)
    if plan.refused and not folder.replace:
        fault = f"holds results that differ: {plan.refused}"
        fix = (
            "name another folder, or add --replace, which removes and redoes what"
            " differs"
        )
        raise input_error(folder.path, fault, fix)
    opened = OpenParts(reading_options(config))
    calibration = yield from settle(config, dictionary, plan, manifest, opened)
    for text in (chosen, *calibration.lines):
        yield Result(line=text)
    yield Result(warnings=calibration.warnings)
    line = RunLine(
        shapefit=__version__,
        method=config.method,
        estimated=calibration._asdict(),
        parts=tuple(part_number(part.file) for part in plan.parts),
        removed=tuple(map(part_number, plan.removed)),
        **plan.digests,
    )
    for path in unlisted:
        path.unlink(missing_ok=True)
    manifest = Manifest(folder.manifest, line, dict(plan.retained))
    if uses_other_processes(folder):
        opened.sources.clear()
        if config.threads == 0:
            config = config.changed(threads=1)
    shared = calibration.apply_to(config)
    shared = shared.changed(landmarks=())  # each part names its own
    lifter = TogetherLifter(shared, dictionary, calibration, opened)
    yield from run_parts(shared, folder, plan, manifest, lifter)


def settle(
    config: FitConfig,
    dictionary: Dictionary,
    plan: FolderPlan,
    manifest: Manifest | None,
    opened: OpenParts,
) -> Calibrating:
    """Estimate what the config leaves open, as `calibrate`, from images of all parts.

    Parts that are retained had a calibration, which the manifest states. opened gets
    the parts that are read.
    """
    if manifest is not None and plan.retained:
        return calibration_of(manifest, config)
    images = first_images(opened, plan.parts, config.leave_one_out)
    match = match_to_dictionary(config, dictionary, images.landmark_names)
    return (yield from calibrate(config, match, images, len(images)))


def method_of(manifest: Manifest) -> str:
    """Return the method of the results in a folder; InputError for an unknown one."""
    method = manifest.run.method
    if method not in METHODS:
        raise manifest_error(manifest.path, f"there is no method {method!r:.100}")
    return method


def calibration_of(manifest: Manifest, config: FitConfig) -> Calibration:
    """Return the Calibration that the manifest of a folder states.

    Raises InputError where that is not what a fit with this config settles.
    """
    try:
        kind = TypeAdapter(Calibration)
        calibration = kind.validate_python(dict(manifest.run.estimated))
        check_calibration(type(config), calibration.config_values(config))
    except (ValueError, TypeError) as error:  # pydantic's has several lines
        text = printable(" ".join(str(error).split()))
        raise manifest_error(manifest.path, f"estimated: {text}") from None
    return calibration


def check_calibration(schema: type[BaseModel], values: Mapping[str, Any]) -> None:
    """Raise ValueError or TypeError for values that keys of a config cannot have."""
    for name, value in values.items():
        if name not in schema.model_fields:
            raise ValueError(f"there is no key {name}")
        field = schema.model_fields[name]
        kind = field.annotation
        if isinstance(kind, type) and issubclass(kind, BaseModel):
            check_calibration(kind, dict(value))
        else:
            constrained = Annotated[kind, None, *field.metadata]  # type: ignore[valid-type]
            TypeAdapter(constrained).validate_python(value)


def plan_folder(
    config: FitConfig, folder: ResultFolder, manifest: Manifest | None
) -> FolderPlan:
    """Return which parts a folder is to have, which stay, and what is removed.

    A part stays where its result has the size that was written, and config and inputs
    are the same.
    """
    files = files_of(config)
    states_of_files = {path: find_state(path) for path in files.values()}
    digests = digest_run(config, folder, files)
    if manifest is None:
        parts = find_parts(config, folder.partition)
        return FolderPlan(parts, {}, [], "", digests, states_of_files)
    file_names = {part_key(line): file for file, line in manifest.parts.items()}
    parts = find_parts(config, folder.partition, file_names)
    states = {part.file: part.states for part in parts}
    done = manifest.done
    changed: list[str] = []
    if done:
        stated = manifest.run.digests
        changed = [key for key in digests if stated.get(key) != digests[key]]
    lost = [file for file in done if changed or states.get(file) != done[file].states]
    refused = ""
    if changed:
        refused = f"of another {listed(changed, 'and')}"
    elif lost:
        inputs = [Path(path).name for file in lost for path in done[file].inputs]
        names = abbreviate(list(dict.fromkeys(inputs)), 3)
        refused = f"of {names} before it changed, or not among the inputs"
    retained = {
        file: line
        for file, line in done.items()
        if file not in lost and find_state(folder.path / file)[0] == line.bytes
    }
    removed = sorted(manifest.files - states.keys())
    return FolderPlan(parts, retained, removed, refused, digests, states_of_files)


def digest_run(
    config: FitConfig, folder: ResultFolder, files: Mapping[str, Path]
) -> dict[str, str]:
    """Return digests of all that every part depends on: config and files, by key."""
    plain = {
        key: value
        for key, value in config.as_plain().items()
        if key not in KEYS_OF_THE_RUN
    }
    plain["partition"] = folder.partition
    text = json.dumps(plain, sort_keys=True)
    of_files = {key: digest(path) for key, path in files.items()}
    return {"config": hashlib.sha256(text.encode()).hexdigest(), **of_files}


def find_parts(
    config: FitConfig, size: int, file_names: Mapping[PartKey, str] | None = None
) -> list[Part]:
    """Divide the landmarks of a fit into parts of `size` images or more.

    Parts that are in `file_names` keep their files.
    """
    options = reading_options(config)
    file_names = file_names or {}
    names = map(part_name, count())
    free = (name for name in names if name not in file_names.values())
    parts = []
    for file_format, inputs in group_inputs(list(config.landmarks), options):
        ranges: Sequence[tuple[int, int] | None] = [None]
        if file_format is HDF5:
            ranges = divide_rows(
                inputs,
                options,
                size,
                by_sequence=METHODS[config.method].takes_sequences,
            )
        states = tuple(map(find_state, inputs))
        for rows in ranges:
            file = file_names.get((tuple(map(path_text, inputs)), rows))
            parts.append(Part(file or next(free), inputs, rows, states))
    return parts


def divide_rows(
    inputs: tuple[Path, ...], options: InputOptions, size: int, *, by_sequence: bool
) -> Sequence[tuple[int, int] | None]:
    """Return the ranges of rows of an HDF5 file that are parts.

    They are cut where no result changes, that is after whole blocks of images, which
    start from each other, or between sequences.
    """
    try:
        with open_landmarks(inputs, options, head=True) as source:
            total = source.count
            if by_sequence:
                names = list(chain.from_iterable(source.sequences()))
                starts = [0]
                for row in range(1, total):
                    if names[row] != names[row - 1] and row - starts[-1] >= size:
                        starts.append(row)
            else:
                starts = list(range(0, total, round_to_blocks(size)))
    except InputError:  # whoever does its part reports it
        return [None]
    if len(starts) <= 1:
        return [None]
    return list(pairwise([*starts, total]))


def part_key(line: PartLine) -> PartKey:
    """Return the inputs and rows of a part, by which it is recognised."""
    return line.inputs, line.rows


def first_images(
    opened: OpenParts, parts: Sequence[Part], leave_one_out: str | None = None
) -> Landmarks:
    """Return the first SAMPLE_POOL images of all parts, as a calibration needs them.

    Inputs that cannot be read, or do not go with the first, are left out: their part
    reports them. leave_one_out names a dataset that is needed, too.
    """
    needed = {*CAMERA_DATASETS, leave_one_out}
    files: list[SourceFile[Landmarks]] = []
    images = 0
    for part in parts:
        try:
            with opened.look_at(part) as source:
                read = source.first(SAMPLE_POOL - images)
        except InputError as error:
            problem = error
            continue
        bare = replace(
            read,
            frames=None,
            times=None,
            edges=None,
            extras={n: v for n, v in read.extras.items() if n in needed},
            file_extras={n: v for n, v in read.file_extras.items() if n in needed},
        )
        files.append(SourceFile.of(str(part), bare, y_axis=bare.y_axis))
        images += len(bare)
        if images >= SAMPLE_POOL:
            break
    if not files:
        raise problem
    try:
        return Source(files, check=False).first(SAMPLE_POOL)
    except InputError:
        return Source(files[:1]).first(SAMPLE_POOL)


def run_parts(
    config: FitConfig,
    folder: ResultFolder,
    plan: FolderPlan,
    manifest: Manifest,
    lifter: TogetherLifter,
) -> Iterator[Result]:
    """Lift the parts that are not retained; yield the result of each as it ends.

    Files in `plan.removed` are removed first; the last result sums up. config, of no
    open keys and no landmarks; lifter, which lifts small parts together.
    """
    jobs = deque(
        Job(part, config, folder.path, lifter.calibration, plan.states)
        for part in plan.parts
        if part.file not in plan.retained
    )
    manifest.write()
    for file in plan.removed:
        (folder.path / file).unlink(missing_ok=True)
    total = counted(len(plan.parts), "part")
    lost = 0
    with closing(run_jobs(jobs, folder, lifter)) as ended:
        for line, result in ended:
            manifest.add(line)
            if line.status != DONE:
                lost += 1
            failed = f", {lost} failed" if lost else ""
            yield result._replace(note=f"{len(manifest.done)} of {total} done{failed}")
    done = tuple(manifest.done.values())
    camera = camera_numbers(config.camera)
    numbers = numbers_of_parts(done)._replace(camera=camera)
    gap = format_gap(numbers.largest_gap, numbers.not_optimal)
    note = f"{len(done)} of {total} done{gap}"
    yield Result(note=note, numbers=numbers, written=(manifest.path,))


def uses_other_processes(folder: ResultFolder) -> bool:
    """Whether the parts of a folder are lifted by other processes than this one."""
    return bool(folder.workers or folder.scheduler or folder.scheduler_file)


def run_jobs(
    jobs: deque[Job], folder: ResultFolder, lifter: TogetherLifter | None = None
) -> Generator[EndedPart, None, None]:
    """Run jobs here, in processes or on a cluster; yield line and result of each.

    The folder says where; lifter, which lifts small parts together here. Where a
    process dies, the parts that were under way are done again, each alone in a new one.
    """
    if not uses_other_processes(folder):
        yield from run_here(jobs, lifter)
        return
    while jobs:
        running: dict[Future[EndedPart], Job] = {}
        with open_executor(folder) as (pool, at_once), suppress(BrokenExecutor):
            while jobs or running:
                while jobs and len(running) < at_once:
                    # it stays among the jobs until the pool has taken it
                    running[pool.submit(run_job, jobs[0])] = jobs[0]
                    jobs.popleft()
                ended = futures.wait(running, return_when=futures.FIRST_COMPLETED).done
                for future in ended:
                    yield await_job(future, running[future])
                    del running[future]
        for job in running.values():
            with open_executor(replace(folder, workers=1)) as (pool, _):
                try:
                    yield await_job(pool.submit(run_job, job), job)
                except BrokenExecutor:
                    reason = (
                        "its process died, twice: give it more memory, or less work"
                    )
                    yield failed_part(job, reason)


def run_here(jobs: deque[Job], lifter: TogetherLifter | None) -> Iterator[EndedPart]:
    """Run jobs in this process, those of small parts together where there is a lifter.

    Yields line and result of each.
    """
    while jobs:
        lifted: Sequence[LiftedPart | None] = ()
        if lifter is not None:
            lifted = lifter.lift_first(job.part for job in jobs)
        for part in lifted or (None,):
            job = jobs.popleft()
            source = None if lifter is None else lifter.opened.pop(job.part)
            yield run_job(job._replace(lifted=part, source=source))


@contextmanager
def open_executor(folder: ResultFolder) -> Iterator[tuple[Executor, int]]:
    """Give an executor of processes or of Dask, and how many parts to submit at a time.

    Raises InputError where no scheduler answers.
    """
    if folder.workers:
        with process_pool(folder.workers) as pool:
            yield pool, folder.workers
        return
    try:
        from distributed import Client

        logging.getLogger("distributed").setLevel(logging.CRITICAL)
        file = folder.scheduler_file and str(folder.scheduler_file)
        client = Client(folder.scheduler, scheduler_file=file, timeout=10)
    except ImportError:
        fix = "run `pip install distributed`; --workers does without"
        raise input_error("fit", "a cluster needs dask distributed", fix) from None
    except (OSError, ValueError, LookupError, TypeError, AssertionError) as error:
        fault = f"no scheduler answers ({error!r:.200})"
        fix = "start one with `dask scheduler`, or check its address or file"
        raise input_error("Dask", fault, fix) from None
    with client:
        threads = sum(client.nthreads().values())
        yield client.get_executor(pure=False), PARTS_PER_THREAD * max(1, threads)


@contextmanager
def process_pool(workers: int) -> Iterator[Executor]:
    """Give a pool of processes, which end with this one, however it ends."""
    context = multiprocessing.get_context("spawn")
    pool = futures.ProcessPoolExecutor(workers, context, initializer=end_with_parent)
    try:
        yield pool
    except BaseException:
        pool.shutdown(wait=False, cancel_futures=True)
        for process in multiprocessing.active_children():
            process.kill()
        raise
    pool.shutdown()


def end_with_parent() -> None:
    """Leave SIGINT to the first process, and end when it is gone, even if killed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    assert parent is not None

    def watch() -> None:
        """End this process with its parent."""
        parent.join()
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def await_job(future: Future[EndedPart], job: Job) -> EndedPart:
    """Wait for a job; return its line and result, a failed one where workers died.

    Raises InputError where scheduler or shapefit is missing.
    """
    try:
        return future.result()
    except (futures.CancelledError, ModuleNotFoundError, ValueError) as error:
        # distributed has a ValueError for a future that is lost; those of a job are its
        # result
        fault = getattr(error, "msg", None) or "the scheduler is gone"
        fix = (
            "start it, and workers with this version of shapefit; then run this command"
            " again"
        )
        raise input_error("Dask", fault, fix) from None
    except Exception as error:
        if type(error).__name__ != "KilledWorker":
            raise
        reason = (
            "one worker after another died of it: give it more memory, or less work"
        )
        return failed_part(job, reason)


def run_job(job: Job) -> EndedPart:
    """Lift a part; return its line and result, a failed one for whatever goes wrong.

    Raises InputError in a worker of another version.
    """
    if job.version != __version__:
        fault = (
            f"is a worker with shapefit {__version__}, but `fit` is version"
            f" {job.version}"
        )
        fix = "install the same version on all machines"
        raise input_error(platform.node(), fault, fix)
    try:
        return run_while_awaited(fit_part, job)
    except InputError as error:
        return failed_part(job, "; ".join(error.problems))
    except Exception as error:
        text = str(error).partition("\n")[0]
        return failed_part(job, ": ".join(filter(None, (type(error).__name__, text))))


def run_while_awaited(work: Callable[[Job], EndedPart], job: Job) -> EndedPart:
    """Run a job, or raise InputError once the process that waits for it has ended.

    That is so where a Dask worker does it, and `fit` was killed.
    """
    is_wanted = dask_task_check()
    if is_wanted is None:
        return work(job)
    with make_pool(1) as pool:
        doing = pool.submit(work, job)
        while not futures.wait([doing], timeout=BETWEEN_LOOKS).done:
            if not is_wanted():
                raise input_error("fit", "has ended", "run the command again")
        return doing.result()


def dask_task_check() -> Callable[[], bool] | None:
    """Return a function that says whether this thread's Dask task is still wanted.

    None where the thread has no such task.
    """
    distributed = sys.modules.get("distributed")
    if distributed is None:
        return None
    try:
        worker = distributed.get_worker()
        key = worker.get_current_task()
    except (ValueError, KeyError):  # another thread
        return None

    def is_wanted() -> bool:
        task = worker.state.tasks.get(key)
        return task is not None and task.state != "cancelled"

    return is_wanted


def failed_part(job: Job, error: str) -> EndedPart:
    """Return the line in the manifest and the result of a part that has failed."""
    reason = error if str(job.part.inputs[0]) in error else f"{job.part}: {error}"
    result = Result(failures=(Failure(job.part.file, reason),))
    return job.part.line(FAILED, error=reason), result


def fit_part(job: Job) -> EndedPart:
    """Lift the images of a part and write its result, whole or not at all."""
    log.follow_environment()  # of a worker
    began = time.perf_counter()
    part = job.part
    target = job.folder / part.file
    log.debug("parts", "%s begins: %s", part.file, part)
    config = job.config.changed(landmarks=part.inputs, output=target)
    dictionary = cached_read(
        read_dictionary, config.dictionary, find_state(config.dictionary)
    )
    states = {**dict(zip(part.inputs, part.states, strict=True)), **job.states}
    of_run = cached_read(digests, tuple(job.states), tuple(job.states.values()))
    of_part = cached_read(digests, part.inputs, part.states)
    images = 0
    failures: list[Failure] = []
    warnings: dict[str, Any] = {}
    reasons: dict[str, Any] = {}
    numbers = Numbers()
    contents = ""
    known = FitPart(
        rows=part.slice,
        calibration=job.calibration,
        dictionary=dictionary,
        source=job.source,
        digests={**of_run, **of_part},
        states=states,
    )
    if job.lifted is None:
        results = fit(config, known)
    else:
        results = write_lifted(config, known, job.lifted)
        began -= job.lifted.seconds
    for result in results:
        images += result.done
        failures += result.failures
        merge_warnings(warnings, result.warnings, MAX_LISTED_OF_A_PART)
        without_items = (replace(reason, items=()) for reason in result.reasons)
        merge_warnings(reasons, without_items)
        numbers = result.numbers or numbers
        contents = result.digest or contents
    total = Result(
        done=images,
        failures=tuple(failures[:MAX_LISTED_OF_A_PART]),
        warnings=tuple(warnings.values()),
        reasons=tuple(reasons.values()),
    )
    line = part.line(
        DONE,
        images=images,
        failed=len(failures),
        bytes=target.stat().st_size,
        digest=contents,
        seconds=round(time.perf_counter() - began, 3),
        trusted=numbers.trusted,
        optimal=numbers.optimal,
        not_optimal=numbers.not_optimal,
        largest_gap=numbers.largest_gap,
    )
    log.debug(
        "parts",
        "%s ends after %.3f s: %d images, %d failed",
        part.file,
        line.seconds,
        images,
        len(failures),
    )
    return line, total


@lru_cache(maxsize=8)
def cached_read(read: Callable[[Any], Any], files: Any, _states: Any) -> Any:
    """Return `read(files)`, done anew only where states of the files have changed."""
    return read(files)

"""Where parts are done: in this process, in processes of this machine, or on a Dask cluster."""

from __future__ import annotations

import logging
import multiprocessing
import os
import platform
import signal
import threading
import time
from collections import deque
from collections.abc import Generator, Iterator
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    CancelledError,
    Executor,
    Future,
    ProcessPoolExecutor,
    wait,
)
from contextlib import contextmanager
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

from shapefit import __version__
from shapefit.config import FitConfig
from shapefit.config.paths import DONE, FAILED, ResultFolder
from shapefit.dictionary.model import Dictionary
from shapefit.errors import InputError, input_error
from shapefit.io import read_dictionary
from shapefit.pipelines.fit.prepare import Estimates
from shapefit.pipelines.fit.run import run as fit
from shapefit.pipelines.outcome import Counted, Failure, Outcome, add_up
from shapefit.pipelines.partition.manifest import Entry
from shapefit.pipelines.partition.plan import Part, State, find_state, input_digests

AHEAD = 4
"""Parts that each thread of a cluster has waiting; more would only fill the scheduler."""

MOST_LISTED = 20
"""Failures and warnings of a part that are reported one by one."""

MEMORY = "give it more memory, or divide the images into smaller parts"


class Job(NamedTuple):
    """A part, the config of the run, the folder of its result, and what all parts have in common.

    version of the program that planned it.
    """

    part: Part
    config: FitConfig
    folder: Path
    estimates: Estimates | None = None
    version: str = __version__


class Done(NamedTuple):
    """The line in the manifest of a part that has ended, and its outcome."""

    entry: Entry
    outcome: Outcome


def do_jobs(jobs: deque[Job], folder: ResultFolder) -> Generator[Done, None, None]:
    """Do jobs where the folder says; yield each as it ends.

    Where a process dies, the parts that were under way are done again, each alone in a new one: the
    part at fault is then known, and reported.
    """
    while jobs:
        lost: list[Job] = []
        running: dict[Future[Done], Job] = {}
        with executor(folder) as (pool, at_once):
            while (jobs or running) and not lost:
                try:
                    while jobs and len(running) < at_once:
                        running[pool.submit(do_job, jobs[0])] = jobs[0]
                        jobs.popleft()
                except BrokenExecutor:
                    break
                for future in wait(running, return_when=FIRST_COMPLETED).done:
                    job = running.pop(future)
                    try:
                        yield result_of(future, job)
                    except BrokenExecutor:
                        lost.append(job)
        for job in (*lost, *running.values()):
            with executor(replace(folder, workers=1)) as (pool, _):
                try:
                    yield result_of(pool.submit(do_job, job), job)
                except BrokenExecutor:
                    yield failed(job, f"its process died, twice: {MEMORY}")


@contextmanager
def executor(folder: ResultFolder) -> Iterator[tuple[Executor, int]]:
    """Give the executor that a folder asks for, and how many parts it does at a time.

    Processes end with this one, however it ends. Raises InputError where Dask is not installed, and
    where no scheduler answers.
    """
    scheduler = {"address": folder.scheduler, "scheduler_file": folder.scheduler_file}
    scheduler = {key: str(value) for key, value in scheduler.items() if value is not None}
    if scheduler:
        try:
            from distributed import Client

            logging.getLogger("distributed").setLevel(logging.CRITICAL)
            client = Client(**scheduler, timeout=10)
        except ImportError:
            fix = "run `pip install distributed`; --workers does without"
            raise input_error("fit", "a cluster needs dask distributed", fix) from None
        except (OSError, ValueError, LookupError, TypeError, AssertionError) as error:
            found = f"no scheduler answers ({str(error).partition(chr(10))[0]})"
            fix = "start one with `dask scheduler`, or check its address or file"
            raise input_error("Dask", found, fix) from None
        with client:
            at_once = AHEAD * max(1, sum(client.nthreads().values()))
            yield client.get_executor(pure=False), at_once
    elif folder.workers:
        context = multiprocessing.get_context("spawn")
        pool = ProcessPoolExecutor(folder.workers, context, initializer=end_with_parent)
        try:
            yield pool, folder.workers
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            for process in multiprocessing.active_children():
                process.kill()
            raise
        pool.shutdown()
    else:
        yield InThisProcess(), 1


class InThisProcess(Executor):
    """Does what is submitted at once."""

    def submit(self, work: Any, /, *arguments: Any, **keys: Any) -> Future[Any]:
        """Do work; what goes wrong is raised here."""
        done: Future[Any] = Future()
        done.set_result(work(*arguments, **keys))
        return done


def end_with_parent() -> None:
    """Leave SIGINT to the first process, and end when it is gone, even if it was killed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    assert parent is not None

    def watch() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def result_of(future: Future[Done], job: Job) -> Done:
    """Return the result of a job; a failure where it killed one worker of Dask after another.

    Raises InputError where the scheduler is lost, and for workers without this version of shapefit.
    """
    try:
        return future.result()
    except CancelledError:
        fix = "start it and its workers again, and run the same command again"
        raise input_error("Dask", "the scheduler is gone; what is done stays", fix) from None
    except ModuleNotFoundError as error:
        fix = "install shapefit where the workers run, in the version of this one"
        raise input_error("Dask", f"its workers cannot import {error.name}", fix) from None
    except Exception as error:
        if type(error).__name__ != "KilledWorker":
            raise
        return failed(job, f"one worker after another died of it: {MEMORY}")


def do_job(job: Job) -> Done:
    """Lift a part; whatever goes wrong is its outcome.

    Raises InputError where this is not the version that planned it.
    """
    if job.version != __version__:
        found = f"is a worker with shapefit {__version__}, but `fit` is version {job.version}"
        raise input_error(platform.node(), found, "install the same version on all machines")
    try:
        return fit_part(job)
    except InputError as error:
        return failed(job, "; ".join(error.problems))
    except Exception as error:
        text = str(error).partition("\n")[0]
        return failed(job, ": ".join(filter(None, (type(error).__name__, text))))


def failed(job: Job, error: str) -> Done:
    """Return the end of a part without a result."""
    names_input = any(str(path) in error for path in job.part.inputs)
    reason = error if names_input else f"{job.part}: {error}"
    outcome = Outcome(failures=(Failure(job.part.file, reason),))
    return Done(job.part.describe() | {"status": FAILED, "error": reason}, outcome)


def fit_part(job: Job) -> Done:
    """Lift the images of a part and write its result, whole or not at all."""
    began, part, target = time.perf_counter(), job.part, job.folder / job.part.file
    config = job.config.changed(landmarks=part.inputs, output=target)
    images, without = 0, 0
    failures: list[Failure] = []
    warnings: dict[str, str | Counted] = {}
    reasons: dict[str, str | Counted] = {}
    dictionary = dictionary_of(config.dictionary, find_state(config.dictionary))
    inputs = input_digests(part.inputs, part.states)
    rows = None if part.rows is None else slice(*part.rows)
    for outcome in fit(config, rows, job.estimates, dictionary, inputs):
        images += outcome.done
        without += len(outcome.failures)
        failures += outcome.failures[: MOST_LISTED - len(failures)]
        add_up(warnings, outcome.warnings, MOST_LISTED)
        add_up(reasons, (replace(reason, items=()) for reason in outcome.reasons))
    entry = part.describe() | {
        "digests": inputs,
        "status": DONE,
        "images": images,
        "failed": without,
        "seconds": round(time.perf_counter() - began, 3),
        "bytes": target.stat().st_size,
    }
    outcome = Outcome(
        done=images,
        failures=tuple(failures),
        warnings=tuple(warnings.values()),
        reasons=tuple(reason for reason in reasons.values() if isinstance(reason, Counted)),
    )
    return Done(entry, outcome)


@lru_cache(maxsize=1)
def dictionary_of(path: Path, _state: State) -> Dictionary:
    """Read a dictionary, once as long as it does not change."""
    return read_dictionary(path)

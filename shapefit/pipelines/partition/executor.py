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
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

from shapefit import __version__
from shapefit.config import FitConfig
from shapefit.config.paths import DONE, ResultFolder
from shapefit.dictionary.model import Dictionary
from shapefit.errors import InputError, input_error
from shapefit.io import read_dictionary
from shapefit.pipelines.fit.prepare import Estimates
from shapefit.pipelines.fit.run import run as fit
from shapefit.pipelines.outcome import Counted, Failure, Outcome, add_up
from shapefit.pipelines.partition.manifest import remove_link, result_digest
from shapefit.pipelines.partition.plan import Part, State, find_state, input_digests

AHEAD = 4
"""Parts that each thread of a cluster has waiting; more would only fill the scheduler."""

MOST_LISTED = 20
"""Failures and warnings of a part that are reported one by one."""

MEMORY = "give it more memory, or divide the images into smaller parts"


@dataclass(frozen=True)
class Job:
    """A part, the config of the run, where the result goes, and what was estimated of all parts.

    version of the program that planned it.
    """

    part: Part
    config: FitConfig
    folder: Path
    estimates: Estimates | None = None
    version: str = __version__


@dataclass(frozen=True)
class Done:
    """A part that has ended: its outcome and line in the manifest, or why it has no result."""

    part: Part
    outcome: Outcome = field(default_factory=Outcome)
    entry: dict[str, Any] = field(default_factory=dict)
    error: str = ""


@contextmanager
def executor(workers: int | None, scheduler: Any = None) -> Iterator[tuple[Executor, int]]:
    """Give an executor and how many parts it does at a time.

    scheduler: keywords of a Dask client. Processes end with this one, however it ends. Raises
    InputError where Dask is not installed, and where no scheduler answers.
    """
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
    elif workers:
        context = multiprocessing.get_context("spawn")
        pool = ProcessPoolExecutor(workers, context, initializer=end_with_parent)
        try:
            yield pool, workers
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


def do_jobs(jobs: deque[Job], folder: ResultFolder) -> Generator[Done, None, None]:
    """Do jobs where the folder says; yield each as it ends.

    Where a process dies, the parts that were under way are done again, each alone in a new one: the
    part at fault is then known, and reported.
    """
    scheduler = {"address": folder.scheduler, "scheduler_file": folder.scheduler_file}
    client = {key: str(value) for key, value in scheduler.items() if value is not None}
    while jobs:
        lost: list[Job] = []
        running: dict[Future[Done], Job] = {}
        with executor(folder.workers, client) as (pool, at_once):
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
            with executor(1) as (pool, _):
                try:
                    yield result_of(pool.submit(do_job, job), job)
                except BrokenExecutor:
                    yield Done(job.part, error=f"its process died, twice: {MEMORY}")


def result_of(future: Future[Done], job: Job) -> Done:
    """Return what became of a job, also of one that killed one worker of Dask after another.

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
        return Done(job.part, error=f"one worker after another died of it: {MEMORY}")


def do_job(job: Job) -> Done:
    """Do a job; `error` says why it could not be done.

    Raises InputError where this is not the version that planned it.
    """
    if job.version != __version__:
        found = f"is a worker with shapefit {__version__}, but `fit` is version {job.version}"
        raise input_error(platform.node(), found, "install the same version on all machines")
    try:
        return fit_part(job)
    except InputError as error:
        return Done(job.part, error="; ".join(error.problems))
    except Exception as error:
        text = str(error).partition("\n")[0]
        return Done(job.part, error=": ".join(filter(None, (type(error).__name__, text))))


def fit_part(job: Job) -> Done:
    """Lift the images of a part and write its result, whole or not at all."""
    began, part, target = time.perf_counter(), job.part, job.folder / job.part.file
    config = job.config.changed(landmarks=part.inputs, output=target)
    remove_link(target)
    images, failed = 0, 0
    failures: list[Failure] = []
    warnings: dict[str, str | Counted] = {}
    reasons: dict[str, str | Counted] = {}
    dictionary = dictionary_of(config.dictionary, find_state(config.dictionary))
    inputs = input_digests(part.inputs, part.states)
    rows = None if part.rows is None else slice(*part.rows)
    for outcome in fit(config, rows, job.estimates, dictionary, inputs):
        images += outcome.done
        failed += len(outcome.failures)
        failures += outcome.failures[: MOST_LISTED - len(failures)]
        add_up(warnings, outcome.warnings, MOST_LISTED)
        add_up(reasons, (replace(reason, items=()) for reason in outcome.reasons))
    outcome = Outcome(
        done=images,
        failures=tuple(failures),
        warnings=tuple(warnings.values()),
        reasons=tuple(reason for reason in reasons.values() if isinstance(reason, Counted)),
    )
    entry = part.describe() | {
        "digests": inputs,
        "status": DONE,
        "images": images,
        "failed": failed,
        "failures": [[failure.item, failure.reason] for failure in failures],
        "seconds": round(time.perf_counter() - began, 3),
        "bytes": target.stat().st_size,
        "digest": result_digest(target),
    }
    return Done(part, outcome, entry)


@lru_cache(maxsize=1)
def dictionary_of(path: Path, _state: State) -> Dictionary:
    """Read a dictionary, once as long as it does not change."""
    return read_dictionary(path)

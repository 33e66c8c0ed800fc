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
from collections.abc import Callable, Generator, Iterator
from concurrent import futures
from concurrent.futures import BrokenExecutor, Executor, Future
from contextlib import contextmanager, suppress
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

from shapefit import __version__
from shapefit.config import FitConfig
from shapefit.config.paths import DONE, FAILED, ResultFolder
from shapefit.errors import InputError, input_error
from shapefit.io import digests, read_dictionary
from shapefit.pipelines.fit.prepare import Estimates
from shapefit.pipelines.fit.run import run as fit
from shapefit.pipelines.partition.manifest import Entry, Part, State
from shapefit.pipelines.result import Failure, Result, add_up

AHEAD = 4
"""Parts that each thread of a cluster has waiting; more would only fill the scheduler."""

MOST_LISTED = 20
"""Failures and warnings of a part that are reported one by one."""

Done = tuple[Entry, Result]
"""The line in the manifest of a part that has ended, and its result."""


class Job(NamedTuple):
    """A part, the config of the run, the folder of its result, and what all parts share."""

    part: Part
    config: FitConfig
    folder: Path
    estimates: Estimates | None = None
    version: str = __version__


def do_jobs(jobs: deque[Job], folder: ResultFolder) -> Generator[Done, None, None]:
    """Do jobs where the folder says; yield each as it ends.

    Where a process dies, the parts that were under way are done again, each alone in a new one.
    """
    if not (folder.workers or folder.scheduler or folder.scheduler_file):
        yield from map(do_job, jobs)
        return
    while jobs:
        running: dict[Future[Done], Job] = {}
        with executor(folder) as (pool, at_once), suppress(BrokenExecutor):
            while jobs or running:
                while jobs and len(running) < at_once:
                    running[pool.submit(do_job, jobs[0])] = jobs[0]
                    jobs.popleft()
                for future in futures.wait(running, return_when=futures.FIRST_COMPLETED).done:
                    yield result_of(future, running[future])
                    del running[future]
        for job in running.values():
            with executor(replace(folder, workers=1)) as (pool, _):
                try:
                    yield result_of(pool.submit(do_job, job), job)
                except BrokenExecutor:
                    yield failed(job, "its process died, twice: give it more memory, or less work")


@contextmanager
def executor(folder: ResultFolder) -> Iterator[tuple[Executor, int]]:
    """Give the executor that a folder asks for, and how many parts it does at a time.

    Processes end with this one, however it ends. Raises InputError where no scheduler answers.
    """
    if folder.workers:
        context = multiprocessing.get_context("spawn")
        pool = futures.ProcessPoolExecutor(folder.workers, context, initializer=end_with_parent)
        try:
            yield pool, folder.workers
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            for process in multiprocessing.active_children():
                process.kill()
            raise
        pool.shutdown()
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
        fix = "start one with `dask scheduler`, or check its address or file"
        raise input_error("Dask", f"no scheduler answers ({error!r:.200})", fix) from None
    with client:
        yield client.get_executor(pure=False), AHEAD * max(1, sum(client.nthreads().values()))


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
    """Return the result of a job. Raises InputError where the scheduler or shapefit is missing."""
    try:
        return future.result()
    except (futures.CancelledError, ModuleNotFoundError, ValueError) as error:
        # distributed has a ValueError for a future that is lost; those of a job are its result
        fault = getattr(error, "msg", None) or "the scheduler is gone"
        fix = "start it, and workers with this version of shapefit; then run this command again"
        raise input_error("Dask", fault, fix) from None
    except Exception as error:
        if type(error).__name__ != "KilledWorker":
            raise
        return failed(job, "one worker after another died of it: give it more memory, or less work")


def do_job(job: Job) -> Done:
    """Lift a part; whatever goes wrong is its result, but for a worker of another version."""
    if job.version != __version__:
        fault = f"is a worker with shapefit {__version__}, but `fit` is version {job.version}"
        raise input_error(platform.node(), fault, "install the same version on all machines")
    try:
        return fit_part(job)
    except InputError as error:
        return failed(job, "; ".join(error.problems))
    except Exception as error:
        text = str(error).partition("\n")[0]
        return failed(job, ": ".join(filter(None, (type(error).__name__, text))))


def failed(job: Job, error: str) -> Done:
    """Return the end of a part without a result."""
    reason = error if str(job.part.inputs[0]) in error else f"{job.part}: {error}"
    result = Result(failures=(Failure(job.part.file, reason),))
    return job.part.describe() | {"status": FAILED, "error": reason}, result


def fit_part(job: Job) -> Done:
    """Lift the images of a part and write its result, whole or not at all."""
    began, part, target = time.perf_counter(), job.part, job.folder / job.part.file
    config = job.config.changed(landmarks=part.inputs, output=target)
    dictionary = once(read_dictionary, config.dictionary, find_state(config.dictionary))
    inputs = once(digests, part.inputs, part.states)
    warnings, reasons = dict[str, Any](), dict[str, Any]()
    images, failures = 0, list[Failure]()
    for result in fit(config, part.slice, job.estimates, dictionary, inputs):
        images += result.done
        failures += result.failures
        add_up(warnings, result.warnings, MOST_LISTED)
        add_up(reasons, (replace(reason, items=()) for reason in result.reasons))
    total = Result(
        done=images,
        failures=tuple(failures[:MOST_LISTED]),
        warnings=tuple(warnings.values()),
        reasons=tuple(reasons.values()),
    )
    counts = {"status": DONE, "images": images, "failed": len(failures)}
    counts |= {"bytes": target.stat().st_size, "seconds": round(time.perf_counter() - began, 3)}
    return part.describe() | counts, total


@lru_cache(maxsize=8)
def once(read: Callable[[Any], Any], files: Any, _states: Any) -> Any:
    """Return what is read of files, once for many parts as long as their states do not change."""
    return read(files)


def find_state(path: Path) -> State:
    """Return the size and the time of change of a file; zeros where there is none."""
    try:
        state = path.stat()
    except OSError:
        return 0, 0
    return state.st_size, state.st_mtime_ns

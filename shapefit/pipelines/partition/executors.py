"""Parts on executors: this process, processes of this machine, or the workers of a Dask cluster."""

from __future__ import annotations

import json
import logging
import multiprocessing
import os
import platform
import signal
import threading
import time
from collections import Counter as Count
from collections import deque
from collections.abc import Callable, Generator, Iterator
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    CancelledError,
    Executor,
    Future,
    ProcessPoolExecutor,
    wait,
)
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from dataclasses import dataclass, field, replace
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from shapefit import __version__
from shapefit.config import FitConfig
from shapefit.config.paths import DONE
from shapefit.dictionary.model import Dictionary
from shapefit.errors import InputError, counted, input_error
from shapefit.io import digests, read_dictionary
from shapefit.pipelines.fit.prepare import Estimates
from shapefit.pipelines.fit.run import run
from shapefit.pipelines.outcome import Counted, Failure, Outcome, add_up
from shapefit.pipelines.partition.manifest import clear_way, result_digest
from shapefit.pipelines.partition.plan import Part, State, find_state

ADDRESS = "DASK_SCHEDULER_ADDRESS"
"""Variable of the environment that names a running scheduler."""

RETRIES = 2
"""Times that a part is tried again."""

AHEAD = 4
"""Parts that each thread of a cluster has waiting; more would only fill the scheduler."""

PATIENCE, CLOSING = 10, 5
"""Seconds to wait for the scheduler to answer, and at the end."""

MOST_LISTED = 20
"""Failures and warnings of a part that its worker reports one by one."""

Start = Callable[[int], AbstractContextManager[Executor]]
"""Gives an executor that does so many parts at a time."""


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
    """What became of a part: its line in the manifest, and what is reported of it.

    error    why it has no result
    passing  whether another try, or another machine, may do better
    """

    part: Part
    outcome: Outcome = field(default_factory=Outcome)
    entry: dict[str, Any] = field(default_factory=dict)
    error: str | None = None
    passing: bool = False


@contextmanager
def executor(config: FitConfig, *, idle: bool = False) -> Iterator[tuple[Start, int, str]]:
    """Give what starts the executor that the config names, parts at a time, and a line about it.

    Raises InputError where Dask is not installed, and where no scheduler answers.
    """
    if config.workers is not None:
        yield processes, config.workers, ""
    elif idle or not on_cluster(config):
        yield lambda _: nullcontext(InThisProcess()), 1, ""
    else:
        with connected(config) as client:
            workers, link = client.nthreads(), client.dashboard_link
            line = f"Dask: {counted(len(workers), 'worker')}"
            line += f"; dashboard: {link}" if link else ""
            at_once = AHEAD * max(1, sum(workers.values()))
            yield lambda _: nullcontext(client.get_executor(pure=False)), at_once, line


class InThisProcess(Executor):
    """Does what is submitted at once."""

    def submit(self, work: Any, /, *arguments: Any, **keys: Any) -> Future[Any]:
        """Do work; what goes wrong is raised here."""
        done: Future[Any] = Future()
        done.set_result(work(*arguments, **keys))
        return done


@contextmanager
def processes(count: int) -> Iterator[ProcessPoolExecutor]:
    """Give processes of this machine that end with this one, however it ends; no port is opened."""
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(count, context, initializer=_end_with_parent)
    try:
        yield pool
    except BaseException:
        pool.shutdown(wait=False, cancel_futures=True)
        for process in multiprocessing.active_children():
            process.kill()
        raise
    pool.shutdown()


def _end_with_parent() -> None:
    """Leave SIGINT to the first process, and end when it is gone, even if it was killed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    assert parent is not None

    def watch() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def on_cluster(config: FitConfig) -> bool:
    """Whether the parts are to run on a scheduler that config or environment name.

    Raises InputError where Dask is not installed.
    """
    named = config.scheduler or config.scheduler_file or os.environ.get(ADDRESS)
    if not named or config.workers is not None:
        return False
    if find_spec("distributed") is None:
        found = "a cluster needs dask distributed, which is not installed"
        fix = "run `pip install distributed`, or leave out --scheduler; --workers does without"
        raise input_error("fit", found, fix)
    return True


@contextmanager
def connected(config: FitConfig) -> Iterator[Any]:
    """Give a client of the cluster that the config names."""
    import distributed

    for name in ("distributed", "distributed.client", "tornado.application", "asyncio"):
        logging.getLogger(name).setLevel(logging.CRITICAL)
    address, file = config.scheduler or os.environ.get(ADDRESS, ""), config.scheduler_file
    if file is not None:
        try:
            address = str(json.loads(file.read_text(encoding="utf-8"))["address"])
        except (OSError, ValueError, KeyError, TypeError):
            fix = "name the one that `dask scheduler --scheduler-file FILE` wrote"
            raise input_error(file, "is not the file of a Dask scheduler", fix) from None
    try:
        client = distributed.Client(address, timeout=PATIENCE)
    except (OSError, ValueError) as error:
        found = f"no scheduler answers ({str(error).partition(chr(10))[0]})"
        raise input_error(address, found, "start one with `dask scheduler`, or check it") from None
    try:
        yield client
    finally:
        with suppress(Exception):  # of a scheduler that is gone there is nothing to let go
            client.close(timeout=CLOSING)


def do_jobs(jobs: deque[Job], start: Start, at_once: int) -> Generator[Done, None, None]:
    """Do jobs on an executor; yield what became of each, as they end.

    One that fails for what may pass is tried again. Where a process dies, the parts that were under
    way are done again one at a time, so that one which kills its process is known; it is reported.
    """
    deaths, tries = Count[str](), Count[str]()
    suspects: deque[Job] = deque()
    while suspects or jobs:
        queue, most = (suspects, 1) if suspects else (jobs, at_once)
        running: dict[Future[Done], Job] = {}
        lost: list[Job] = []
        with start(most) as pool:
            while not lost and (queue or running):
                while queue and len(running) < most:
                    job = queue.popleft()
                    try:
                        running[pool.submit(fit_part, job)] = job
                    except BrokenExecutor:
                        lost.append(job)
                        break
                for future in wait(running, return_when=FIRST_COMPLETED).done:
                    job = running.pop(future)
                    try:
                        done = result_of(future, job)
                    except BrokenExecutor:
                        lost.append(job)
                        continue
                    if done.passing and tries[job.part.file] < RETRIES:
                        tries[job.part.file] += 1
                        queue.append(job)
                    else:
                        yield done
            lost += running.values()
        for job in lost:
            deaths[job.part.file] += 1
            if deaths[job.part.file] > RETRIES:
                yield died(job, f"{deaths[job.part.file]} processes")
            else:
                suspects.append(job)


def result_of(future: Future[Done], job: Job) -> Done:
    """Return what became of a job, also of one that killed one worker of Dask after another.

    Raises InputError where the scheduler is lost, and for workers without this version of shapefit.
    """
    try:
        return future.result()
    except CancelledError:  # all that is asked for ends with the connection
        fix = "start it and its workers again, and run the same command again"
        raise input_error("Dask", "the scheduler is gone; what is done stays", fix) from None
    except ModuleNotFoundError as error:
        if not (error.name or "").startswith("shapefit"):
            raise
        fix = "install shapefit where the workers run, in the version of this one"
        raise input_error("Dask", f"its workers cannot import {error.name}", fix) from None
    except Exception as error:
        if type(error).__name__ != "KilledWorker":
            raise
        deaths = error.allowed_failures + 1  # type: ignore[attr-defined]
        return died(job, counted(deaths, "worker"))


def died(job: Job, those: str) -> Done:
    """Return the failure of a part that killed every worker that tried it."""
    fix = "give it more memory, or divide the images into smaller parts"
    return Done(job.part, error=f"{those} died of it, one after another: {fix}")


def fit_part(job: Job) -> Done:
    """Lift the images of a part and write its result, whole or not at all.

    `error` says why it could not be done; what a full disk or a library raises may pass, what is
    wrong with the input stays. Raises InputError where this is not the version that planned it.
    """
    if job.version != __version__:
        found = f"is a worker with shapefit {__version__}, but `fit` is version {job.version}"
        raise input_error(platform.node(), found, "install the same version on all machines")
    try:
        return _fit(job)
    except InputError as error:
        passing = isinstance(error.__cause__, OSError) and error.__cause__.errno is not None
        return Done(job.part, error="; ".join(error.problems), passing=passing)
    except Exception as error:
        kind, text = type(error).__name__, str(error).partition("\n")[0]
        return Done(job.part, error=f"{kind}: {text}" if text else kind, passing=True)


def _fit(job: Job) -> Done:
    began, part, target = time.perf_counter(), job.part, job.folder / job.part.file
    config = job.config.changed(landmarks=part.inputs, output=target)
    clear_way(job.folder, part.file)
    images, failed = 0, 0
    failures: list[Failure] = []
    warnings: dict[str, str | Counted] = {}
    doubts: dict[str, str | Counted] = {}
    dictionary = dictionary_of(config.dictionary, find_state(config.dictionary))
    inputs = input_digests(part.inputs, part.state)
    rows = None if part.rows is None else slice(*part.rows)
    for outcome in run(config, rows, job.estimates, dictionary, inputs=inputs):
        images += outcome.done
        failed += len(outcome.failures)
        failures += outcome.failures[: MOST_LISTED - len(failures)]
        add_up(warnings, outcome.warnings, MOST_LISTED)
        add_up(doubts, (replace(doubt, items=()) for doubt in outcome.doubts))
    report = Outcome(
        done=images,
        failures=tuple(failures),
        warnings=tuple(warnings.values()),
        doubts=tuple(doubt for doubt in doubts.values() if isinstance(doubt, Counted)),
    )
    entry = {
        "digests": inputs,
        "status": DONE,
        "images": images,
        "failed": failed,
        "failures": [[failure.item, failure.reason] for failure in failures],
        "seconds": round(time.perf_counter() - began, 3),
        "bytes": target.stat().st_size,
        "digest": result_digest(target),
    }
    return Done(part, report, part.describe() | entry)


@lru_cache(maxsize=1)
def dictionary_of(path: Path, _state: State) -> Dictionary:
    """Read a dictionary, once as long as it does not change."""
    return read_dictionary(path)


@lru_cache(maxsize=8)
def input_digests(inputs: tuple[Path, ...], _state: tuple[State, ...]) -> dict[str, str]:
    """Return the digests of files under their paths, once as long as they do not change."""
    return digests(inputs)

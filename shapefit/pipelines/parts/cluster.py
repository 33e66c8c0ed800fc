"""Parts on a Dask cluster that is running."""

from __future__ import annotations

import json
import logging
import os
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

from shapefit.config import FitConfig
from shapefit.errors import InputError, counted, input_error
from shapefit.pipelines.parts.part import Done, Job, describe, fit_part

ADDRESS = "DASK_SCHEDULER_ADDRESS"
"""Variable of the environment that names a running scheduler."""

RETRIES = 2
"""Times that a part is tried again, on other workers if there are some."""

MOST_RETRIES = 10
"""The same while a worker has not tried it: one that failed, and so is idle, may take it back."""

AHEAD = 4
"""Parts that each thread of the cluster has waiting; more would only fill the scheduler."""

PATIENCE = 10
"""Seconds to wait for the scheduler to answer."""

CLOSING = 5
"""Seconds to wait for it at the end."""


def wants_cluster(config: FitConfig) -> bool:
    """Whether the parts are to run on a scheduler that config or environment name."""
    named = config.scheduler or config.scheduler_file or os.environ.get(ADDRESS)
    return bool(named) and config.workers is None


@contextmanager
def connected(config: FitConfig) -> Iterator[Any]:
    """Give a client of the cluster that the config names.

    Raises InputError where Dask is not installed, and where no scheduler answers.
    """
    distributed = _dask()
    address = address_of(config)
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


def address_of(config: FitConfig) -> str:
    """Return the address of the scheduler that the config or the environment names.

    Raises InputError for a file that no scheduler wrote.
    """
    file = config.scheduler_file
    if file is None:
        return config.scheduler or os.environ[ADDRESS]
    try:
        return str(json.loads(file.read_text(encoding="utf-8"))["address"])
    except (OSError, ValueError, KeyError, TypeError):
        fix = "name the one that `dask scheduler --scheduler-file FILE` wrote"
        raise input_error(file, "is not the file of a Dask scheduler", fix) from None


def introduce(client: Any) -> str:
    """Return one line on the cluster: how large it is, and where its dashboard is."""
    workers = counted(len(client.nthreads()), "worker")
    link = client.dashboard_link
    return f"Dask: {workers}" + (f"; dashboard: {link}" if link else "")


def on_cluster(client: Any, jobs: deque[Job]) -> Iterator[Done]:
    """Do the jobs on the workers of a cluster; yield what became of each, as they end.

    Jobs are taken from the front; others may be added behind them meanwhile.
    A worker that dies has its part done by another one, and so has one that fails for what may
    pass, as a full disk. A part that fails again and again is reported with its error. Raises
    InputError where the scheduler is lost, and for workers without this version of shapefit.
    """
    from distributed import CancelledError, as_completed

    parts: dict[str, tuple[Job, tuple[str, ...]]] = {}
    address = client.scheduler.address

    def submitted(job: Job, failed_on: tuple[str, ...] = ()) -> Any:
        others = sorted(client.nthreads().keys() - set(failed_on)) if failed_on else None
        place = {"workers": others, "allow_other_workers": True} if others else {}
        future = client.submit(fit_part, job, pure=False, **place)
        parts[future.key] = job, failed_on
        return future

    most = AHEAD * max(1, sum(client.nthreads().values()))

    def next_ones() -> list[Any]:
        return [submitted(jobs.popleft()) for _ in range(min(len(jobs), most - len(parts)))]

    ended = as_completed(next_ones())
    for future in ended:
        job, failed_on = parts.pop(future.key)
        if future.status == "error":
            error = future.exception()
            _check_worker(error, address)
            yield failed(job, error)
        else:
            try:
                done = future.result()
            except (OSError, CancelledError):  # all that is asked for ends with the connection
                found = "the scheduler is gone; what is done stays"
                fix = "start it and its workers again, and run the same command again"
                raise input_error(address, found, fix) from None
            if done.passing:
                workers = next(iter(client.who_has([future]).values()), ())
                failed_on = (*failed_on, next(iter(workers), ""))
                untried = client.nthreads().keys() - set(failed_on)
                if len(failed_on) <= (MOST_RETRIES if untried else RETRIES):
                    ended.add(submitted(job, failed_on))
                    continue
            yield done
        ended.update(next_ones())


def _check_worker(error: BaseException, place: str) -> None:
    """Raise InputError for an error that no other part or try would spare."""
    if isinstance(error, InputError):  # of the version; what a part finds wrong is in its Done
        raise error
    if isinstance(error, ModuleNotFoundError) and (error.name or "").startswith("shapefit"):
        fix = "install shapefit where the workers run, in the version of this one"
        raise input_error(place, f"its workers cannot import {error.name}", fix) from None


def failed(job: Job, error: BaseException) -> Done:
    """Return that a part could not be done."""
    kind = type(error).__name__
    if kind == "KilledWorker":
        deaths = error.allowed_failures + 1  # type: ignore[attr-defined]
        text = f"{counted(deaths, 'worker')} died of it, one after another; see their logs, and "
        return Done(job.part, error=text + "give them more memory or take a smaller `partition`")
    return Done(job.part, error=describe(error))


def _dask() -> Any:
    """Return the library, which leaves talking to the command line."""
    try:
        import distributed
    except ImportError:
        found = "a cluster needs dask distributed, which is not installed"
        fix = "run `pip install distributed`, or leave out --scheduler; --workers does without"
        raise input_error("fit", found, fix) from None
    for name in ("distributed", "distributed.client", "asyncio"):
        logging.getLogger(name).setLevel(logging.CRITICAL)
    return distributed

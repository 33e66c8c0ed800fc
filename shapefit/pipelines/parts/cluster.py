"""Parts on a Dask cluster: one that is running, or one of this machine's processes."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Any

from shapefit.config import FitConfig
from shapefit.errors import input_error
from shapefit.pipelines.parts.part import Done, Job, fit_part

ADDRESS = "DASK_SCHEDULER_ADDRESS"
"""Variable of the environment that names a running scheduler."""

RETRIES = 2
"""Times that a part is tried again."""

AHEAD = 4
"""Parts that each thread of the cluster has waiting; more would only fill the scheduler."""

PATIENCE = 30
"""Seconds to wait for the scheduler to answer."""


def wants_cluster(config: FitConfig) -> bool:
    """Whether the parts are to run elsewhere than in this process."""
    named = config.scheduler or config.scheduler_file or os.environ.get(ADDRESS)
    return bool(named) or config.workers is not None


@contextmanager
def connected(config: FitConfig) -> Iterator[Any]:
    """Give a client of the cluster that the config names.

    Raises InputError where Dask is not installed, and where no scheduler answers.
    """
    try:
        import distributed
    except ImportError:
        found = "a cluster needs dask distributed, which is not installed"
        fix = "run `pip install 'shapefit[dask]'`, or leave out --workers and --scheduler"
        raise input_error("fit", found, fix) from None
    if config.workers is not None:
        cluster = distributed.LocalCluster(
            n_workers=config.workers, threads_per_worker=1, dashboard_address=":0"
        )
        with cluster, distributed.Client(cluster) as client:
            yield client
        return
    where: dict[str, Any] = {"timeout": PATIENCE}
    if config.scheduler_file:
        where["scheduler_file"] = str(config.scheduler_file)
    else:
        where["address"] = config.scheduler or os.environ[ADDRESS]
    name = where.get("scheduler_file") or where["address"]
    try:
        client = distributed.Client(**where)
    except (OSError, ValueError, TimeoutError) as error:
        found = f"no scheduler answers ({str(error).partition(chr(10))[0]})"
        raise input_error(name, found, "start one with `dask scheduler`, or check it") from None
    with client:
        yield client


def on_cluster(client: Any, jobs: Iterable[Job]) -> Iterator[Done]:
    """Do the jobs on the workers of a cluster; yield what became of each, as they end.

    A worker that dies has its part done by another one. A part that fails again and again is
    reported with its error.
    """
    from distributed import as_completed

    waiting = iter(jobs)
    threads = sum(client.nthreads().values()) or 1
    parts: dict[str, Job] = {}

    def submitted(most: int) -> list[Any]:
        new = []
        for job in waiting:
            future = client.submit(fit_part, job, pure=False, retries=RETRIES)
            parts[future.key] = job
            new.append(future)
            if len(new) == most:
                break
        return new

    ended = as_completed(submitted(AHEAD * threads))
    for future in ended:
        job = parts.pop(future.key)
        yield future.result() if future.status == "finished" else failed(job, future.exception())
        ended.update(submitted(1))


def failed(job: Job, error: BaseException) -> Done:
    """Return that a part could not be done."""
    text = str(error).partition("\n")[0]
    return Done(job.part, error=f"{type(error).__name__}: {text}" if text else type(error).__name__)

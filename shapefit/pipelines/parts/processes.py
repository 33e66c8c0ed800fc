"""Parts on processes of this machine: no scheduler, no open port, no files of their own."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections import Counter, deque
from collections.abc import Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager

from shapefit.pipelines.parts.part import Done, Job, fit_part

RETRIES = 2
"""Times that a part is tried again."""


def on_processes(jobs: deque[Job], count: int) -> Iterator[Done]:
    """Do jobs on so many processes; yield what became of each, as they end.

    Jobs are taken from the front; others may be added behind them meanwhile. One that fails for
    what may pass is tried again. Where a process dies, the parts that were under way are done again
    one at a time, so that one which kills its process is known; it is reported.
    """
    deaths, tried = Counter[str](), Counter[str]()
    suspects: deque[Job] = deque()
    while suspects or jobs:
        queue, most = (suspects, 1) if suspects else (jobs, count)
        running: dict[Future[Done], Job] = {}
        lost: list[Job] = []
        with started(most) as pool:
            while not lost and (queue or running):
                while queue and len(running) < most:
                    job = queue.popleft()
                    try:
                        running[pool.submit(fit_part, job)] = job
                    except BrokenProcessPool:
                        lost.append(job)
                        break
                for future in wait(running, return_when=FIRST_COMPLETED).done:
                    job = running.pop(future)
                    try:
                        done = future.result()
                    except BrokenProcessPool:
                        lost.append(job)
                        continue
                    if done.passing and tried[job.part.file] < RETRIES:
                        tried[job.part.file] += 1
                        queue.append(job)
                    else:
                        yield done
            lost += running.values()
        for job in lost:
            deaths[job.part.file] += 1
            if deaths[job.part.file] > RETRIES:
                died = f"{deaths[job.part.file]} processes"
                fix = "free some memory, or take a smaller `partition`"
                yield Done(job.part, error=f"{died} died of it, one after another: {fix}")
            else:
                suspects.append(job)


@contextmanager
def started(count: int) -> Iterator[ProcessPoolExecutor]:
    """Give processes that end with this one, however it ends."""
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

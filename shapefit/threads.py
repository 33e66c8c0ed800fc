"""Work on threads: on several parts at once, or while the next one is made."""

from __future__ import annotations

import os
import signal
import threading
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from concurrent.futures import Future, ThreadPoolExecutor

    import numpy as np
    from numpy.typing import NDArray

Item = TypeVar("Item")
Outcome = TypeVar("Outcome")


class _StopFlag(threading.local):
    """The flag (1,) that ends the kernels of this thread, once it is set."""

    stop: NDArray[np.bool_] | None = None


_stop_flag = _StopFlag()


@contextmanager
def make_pool(workers: int) -> Iterator[ThreadPoolExecutor]:
    """Yield a pool of threads, whose work an exception ends.

    An exception that leaves the block, such as that of a signal, ends the kernels that
    run there; those of a pool within a pool end with the outer one.
    """
    from concurrent.futures import ThreadPoolExecutor

    import numpy as np

    from shapefit import core

    outer = _stop_flag.stop
    stop = np.zeros(1, bool) if outer is None else outer

    def begin() -> None:
        """Make a new thread leave signals to the first, and stop at the flag `stop`."""
        if hasattr(signal, "pthread_sigmask"):
            # The first thread waits here, and only it wakes for a signal.
            signal.pthread_sigmask(signal.SIG_BLOCK, signal.valid_signals())
        _stop_flag.stop = stop
        core.set_stop_flag(stop=stop)

    with ThreadPoolExecutor(workers, initializer=begin) as pool:
        try:
            yield pool
        except BaseException:
            if outer is None:
                stop[0] = True
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def thread_count(threads: int) -> int:
    """Return the number of threads: `threads`, or with 0 one for each processor."""
    return threads or os.cpu_count() or 1


def on_threads(
    work: Callable[[Item], Outcome], items: Iterable[Item], threads: int
) -> list[Outcome]:
    """Return the list of work(item) of all items, in their order, computed on threads.

    `threads` = 0 means one per core. Work gains from threads where it waits for a disk,
    or releases the GIL.
    """
    tasks = list(items)
    workers = min(thread_count(threads), len(tasks))
    if workers <= 1:
        return [work(item) for item in tasks]
    with make_pool(workers) as pool:
        return list(pool.map(work, tasks))


def map_ahead(
    work: Callable[[Item], Outcome], items: Iterable[Item], workers: int
) -> Generator[Outcome, None, None]:
    """Yield work(item) of each item, in order; up to `workers` threads work ahead.

    They do so while the next item is read; with 0 all is done on this thread.
    """
    if not workers:
        yield from map(work, items)
        return
    waiting: deque[Future[Outcome]] = deque()
    with make_pool(workers) as pool:
        for item in items:
            waiting.append(pool.submit(work, item))
            if len(waiting) > workers:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()

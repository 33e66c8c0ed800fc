"""Work on threads: on several parts at once, or while the next one is made."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Generator, Iterable
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from concurrent.futures import Future

Part = TypeVar("Part")
Done = TypeVar("Done")


def on_threads(
    work: Callable[[Part], Done], parts: Iterable[Part], threads: int
) -> list[Done]:
    """Return what `work` makes of each part, in their order; `threads` = 0 means one
    per core.

    Work gains from threads where it waits for a disk, or releases the GIL.
    """
    tasks = list(parts)
    workers = min(threads or os.cpu_count() or 1, len(tasks))
    if workers <= 1:
        return [work(part) for part in tasks]
    from concurrent.futures import ThreadPoolExecutor

    with ThreadPoolExecutor(workers) as pool:
        return list(pool.map(work, tasks))


def side_by_side(
    work: Callable[[Part], Done], items: Iterable[Part], workers: int
) -> Generator[Done, None, None]:
    """Do work with so many items at a time, each on a thread of its own, but for 0
    workers.

    Results come in the order of the items, of which the next one is got meanwhile.
    """
    if not workers:
        yield from map(work, items)
        return
    from concurrent.futures import (
        ThreadPoolExecutor,
    )  # where there is more than one item

    waiting: deque[Future[Done]] = deque()
    with ThreadPoolExecutor(workers) as pool:
        for item in items:
            waiting.append(pool.submit(work, item))
            if len(waiting) > workers:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()

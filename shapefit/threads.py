"""Work on several parts or files at once, on threads."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from contextvars import copy_context
from typing import TypeVar

Part = TypeVar("Part")
Done = TypeVar("Done")


WAITING = 16
"""Threads that ask disks and stores, which answer several as fast as one."""


def on_threads(
    work: Callable[[Part], Done], parts: Iterable[Part], threads: int = WAITING
) -> list[Done]:
    """Return what `work` makes of each part, in their order; `threads` = 0 means one per core.

    Context variables (copies and options of stores) are those of this thread. Work gains from
    threads where it waits for a disk or a store, or releases the GIL.
    """
    known = list(parts)
    workers = min(threads or os.cpu_count() or 1, len(known))
    if workers <= 1:
        return [work(part) for part in known]
    from concurrent.futures import ThreadPoolExecutor

    own = [copy_context() for _ in known]
    with ThreadPoolExecutor(workers) as pool:
        return list(pool.map(lambda context, part: context.run(work, part), own, known))

"""Run a kernel over stretches of a batch on several threads."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from typing import TypeVar

Part = TypeVar("Part")
Done = TypeVar("Done")

# The convex program is solved from one image to the next within a stretch; its length is fixed, so
# that results do not depend on the number of threads.
STRETCH = 64


def run_stretches(count: int, work: Callable[[slice], None], threads: int) -> None:
    """Call `work` on slices that cover range(count); `threads` = 0 means one per core.

    `work` must release the GIL to gain from threads, and write to its own slice only.
    """
    parts = [slice(start, min(start + STRETCH, count)) for start in range(0, count, STRETCH)]
    on_threads(parts, work, threads)


def on_threads(parts: Sequence[Part], work: Callable[[Part], Done], threads: int) -> list[Done]:
    """Return what `work` makes of each part, in their order; `threads` = 0 means one per core."""
    workers = min(threads or os.cpu_count() or 1, len(parts))
    if workers <= 1:
        return [work(part) for part in parts]
    from concurrent.futures import ThreadPoolExecutor  # takes long to import

    with ThreadPoolExecutor(workers) as pool:
        return list(pool.map(work, parts))

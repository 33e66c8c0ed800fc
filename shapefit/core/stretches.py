"""Run Python work over the stretches of a batch on several threads, as the core runs kernels."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

from shapefit import core

Part = TypeVar("Part")
Done = TypeVar("Done")


def run_stretches(count: int, work: Callable[[slice], None], threads: int) -> None:
    """Call `work` on slices that cover range(count); `threads` = 0 means one per core.

    `work` must release the GIL to gain from threads, and write to its own slice only.
    """
    step = core.STRETCH
    on_threads([slice(at, min(at + step, count)) for at in range(0, count, step)], work, threads)


def on_threads(parts: Sequence[Part], work: Callable[[Part], Done], threads: int) -> list[Done]:
    """Return what `work` makes of each part, in their order; `threads` = 0 means one per core."""
    workers = min(threads or os.cpu_count() or 1, len(parts))
    if workers <= 1:
        return [work(part) for part in parts]
    with ThreadPoolExecutor(workers) as pool:
        return list(pool.map(work, parts))

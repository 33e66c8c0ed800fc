"""Work beside other work: batches side by side, and the last one written while others are made.

Threads are imported where there is more than one batch.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from concurrent.futures import Future

Item = TypeVar("Item")
Result = TypeVar("Result")


def side_by_side(
    work: Callable[[Item], Result], items: Iterable[Item], workers: int
) -> Iterator[Result]:
    """Do work with so many items at a time, each on a thread of its own, but for 0 workers.

    Results come in the order of the items, of which the next one is got meanwhile.
    """
    if not workers:
        yield from map(work, items)
        return
    from concurrent.futures import ThreadPoolExecutor

    waiting: deque[Future[Result]] = deque()
    with ThreadPoolExecutor(workers) as pool:
        for item in items:
            waiting.append(pool.submit(work, item))
            if len(waiting) > workers:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()


@contextmanager
def written_behind(
    write: Callable[[Item], None], on_thread: bool
) -> Iterator[Callable[[Item], None]]:
    """Give a function that writes items one after the other, on a thread of its own if it shall.

    What goes wrong with an item is then raised when the next one is given, or at the end.
    """
    if not on_thread:
        yield write
        return
    from concurrent.futures import ThreadPoolExecutor

    with ThreadPoolExecutor(1) as pool:
        last: list[Future[None]] = []

        def give(item: Item) -> None:
            while last:
                last.pop().result()
            last.append(pool.submit(write, item))

        yield give
        while last:
            last.pop().result()

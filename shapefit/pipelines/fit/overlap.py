"""Work beside other work: the next batch is read, and the last one written, while one is lifted.

Threads are imported where there is more than one batch.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import islice
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from concurrent.futures import Future

Item = TypeVar("Item")


def read_ahead(items: Iterator[Item], on_thread: bool) -> Iterator[Item]:
    """Give out the items, of which the next one is made on a thread of its own, if it shall be."""
    if not on_thread:
        yield from items
        return
    from concurrent.futures import ThreadPoolExecutor

    with ThreadPoolExecutor(1) as pool:
        coming = pool.submit(tuple, islice(items, 1))
        while found := coming.result():
            coming = pool.submit(tuple, islice(items, 1))
            yield from found


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

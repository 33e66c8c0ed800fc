"""Work beside other work: while one item is worked on, the next is made and the last one used."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Generator, Iterable
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from concurrent.futures import Future

Item = TypeVar("Item")
Result = TypeVar("Result")


def side_by_side(
    work: Callable[[Item], Result], items: Iterable[Item], workers: int
) -> Generator[Result, None, None]:
    """Do work with so many items at a time, each on a thread of its own, but for 0 workers.

    Results come in the order of the items, of which the next one is got meanwhile.
    """
    if not workers:
        yield from map(work, items)
        return
    from concurrent.futures import ThreadPoolExecutor  # where there is more than one item

    waiting: deque[Future[Result]] = deque()
    with ThreadPoolExecutor(workers) as pool:
        for item in items:
            waiting.append(pool.submit(work, item))
            if len(waiting) > workers:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()

"""Work side by side keeps order, items and errors."""

import threading
import time

import pytest

from shapefit.threads import map_ahead


@pytest.mark.parametrize("workers", [0, 1, 2, 3])
def test_results_come_in_order_few_ahead(workers):
    read, threads = [], set()

    def items():
        for number in range(20):
            read.append(number)
            yield number

    def work(number):
        threads.add(threading.get_ident())
        time.sleep(0.002 * (number % 3))
        return 10 * number

    found = []
    for result in map_ahead(work, items(), workers):
        assert len(read) <= result // 10 + workers + 1
        found.append(result)
    assert found == [10 * number for number in range(20)]
    assert (threading.get_ident() in threads) == (workers == 0)
    assert len(threads) <= max(workers, 1)


@pytest.mark.parametrize("workers", [0, 1, 2])
def test_an_error_of_the_work_comes_after_what_was_done(workers):
    def work(number):
        if number == 2:
            raise OSError("the disk is gone")
        return number

    numbers = map_ahead(work, range(9), workers)
    assert [next(numbers), next(numbers)] == [0, 1]
    with pytest.raises(OSError, match="disk is gone"):
        next(numbers)

"""Work side by side and writing behind keep order, items and errors."""

import threading
import time

import pytest

from shapefit.pipelines.overlap import side_by_side, written_behind


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
    for result in side_by_side(work, items(), workers):
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

    numbers = side_by_side(work, range(9), workers)
    assert [next(numbers), next(numbers)] == [0, 1]
    with pytest.raises(OSError, match="disk is gone"):
        next(numbers)


def test_all_is_written_in_order_before_the_end():
    written = []
    with written_behind(written.append, on_thread=True) as write:
        for number in range(20):
            write(number)
    assert written == list(range(20))


@pytest.mark.parametrize("last", [3, 9])
def test_an_error_of_the_writer_stops_the_work(last):
    """At the next item, or at the end."""
    written, given = [], []

    def store(number):
        if number == 3:
            raise OSError("the disk is full")
        written.append(number)

    def write_all():
        with written_behind(store, on_thread=True) as write:
            for number in range(last + 1):
                write(number)
                given.append(number)

    with pytest.raises(OSError, match="disk is full"):
        write_all()
    assert written == [0, 1, 2]
    assert max(given) == 3

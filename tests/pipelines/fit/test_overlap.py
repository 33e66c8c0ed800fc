"""Reading ahead and writing behind keep order, items and errors."""

import threading

import pytest

from shapefit.pipelines.fit.overlap import read_ahead, written_behind


def failing(count):
    yield from range(count)
    raise OSError("the disk is gone")


def test_items_come_in_order_one_ahead():
    made = []

    def items():
        for number in range(20):
            made.append((number, threading.get_ident()))
            yield number

    found = []
    for number in read_ahead(items(), on_thread=True):
        assert len(made) <= number + 2
        found.append(number)
    assert found == list(range(20))
    assert threading.get_ident() not in {ident for _, ident in made}


def test_an_error_of_the_reader_comes_after_what_was_read():
    numbers = read_ahead(failing(2), on_thread=True)
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

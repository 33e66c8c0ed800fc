"""Datasets of many small chunks: HDF5 asks for some kB of memory for each of those read at once."""

import h5py
import numpy as np
import pytest

from shapefit.errors import InputError
from shapefit.io.hdf5 import file as pieces
from shapefit.io.hdf5.file import Stored, read_rows

ROWS = [(), slice(None), slice(3, 9), slice(8, 100), slice(5, 5)]


@pytest.fixture
def dataset(tmp_path, rng):
    with h5py.File(tmp_path / "many.h5", "w") as file:
        yield lambda values, **keys: file.create_dataset("many", data=values, **keys)


@pytest.mark.parametrize("rows", ROWS)
@pytest.mark.parametrize("most", [1, 3, 7, 50, 10_000])
@pytest.mark.parametrize("chunks", [(1, 1, 1), (2, 3, 2), (11, 1, 2), (11, 5, 4)])
def test_pieces_make_the_whole(dataset, rng, monkeypatch, rows, most, chunks):
    values = rng.standard_normal((11, 5, 4))
    monkeypatch.setattr(pieces, "MOST_CHUNKS", most)
    found = read_rows(Stored.of(dataset(values, chunks=chunks)), rows)
    np.testing.assert_array_equal(found, values[rows])


@pytest.mark.parametrize("rows", ROWS)
def test_texts_are_texts(dataset, monkeypatch, rows):
    texts = np.array([f"café {number}" for number in range(11)], object)
    monkeypatch.setattr(pieces, "MOST_CHUNKS", 2)
    made = dataset(texts, dtype=h5py.string_dtype(), chunks=(1,))
    assert list(read_rows(Stored.of(made), rows)) == list(texts[rows])


@pytest.mark.parametrize("value", [np.float64(3), np.zeros((0, 3)), np.arange(4)])
def test_datasets_without_chunks(dataset, value):
    np.testing.assert_array_equal(read_rows(Stored.of(dataset(value)), ()), value)


def test_never_more_chunks_than_that(monkeypatch):
    monkeypatch.setattr(pieces, "MOST_CHUNKS", 12)
    shape, chunks = (9, 7, 50), (2, 1, 3)
    seen = np.zeros(shape, int)
    for piece in pieces._pieces(shape, chunks):
        seen[piece] += 1
        sizes = [part.stop - part.start for part in piece]
        assert np.prod([-(-size // chunk) for size, chunk in zip(sizes, chunks, strict=True)]) <= 12
    assert (seen == 1).all()


def test_many_chunks_do_not_take_gigabytes(tmp_path, run_python):
    with h5py.File(tmp_path / "many.h5", "w") as file:
        file.create_dataset("many", (100_000,), "f8", chunks=(1,))
    script = f"""
import re
import h5py
from shapefit.io.hdf5.file import read_rows
from shapefit.io.hdf5.file import Stored
with h5py.File("{tmp_path}/many.h5") as file:
    assert len(read_rows(Stored.of(file["many"]), ())) == 100_000
# the most of this program alone: what getrusage says includes the process that started it
print(int(re.search(r"VmHWM:\\s+(\\d+)", open("/proc/self/status").read())[1]) < 400_000)
"""
    assert run_python(script).stdout == "True\n"


def test_rows_in_too_many_chunks_are_refused(dataset, monkeypatch):
    monkeypatch.setattr(pieces, "MOST_CHUNKS", 2)
    monkeypatch.setattr(pieces, "MOST_AT_ONCE", 3)
    made = Stored.of(dataset(np.zeros((4, 2)), chunks=(1, 2)))
    assert read_rows(made, slice(1, 4)).shape == (3, 2)
    with pytest.raises(InputError, match=r"\.h5:/\w+: lies in 4 chunks; store it in larger ones$"):
        read_rows(made, ())

"""HDF5: values that do not fit in memory, or that the file cannot hold."""

import h5py
import pytest

from shapefit.io import (
    inputs,
    read_shapes,
)
from shapefit.io.hdf5_file import Hdf5File
from tests.io.files import READERS

MANY = 10**11


@pytest.fixture
def sparse(tmp_path):
    """Make a file of shapes of some kB whose datasets, all fill values, are of these
    sizes.
    """

    def make(n=1, p=1, **further):
        path = tmp_path / "sparse.h5"
        with h5py.File(path, "w") as file:
            file.attrs["format"] = "shapefit-shapes"
            file.attrs["version"] = 1
            write_texts(file, "landmark_names", p)
            write_texts(file, "item", n)
            file.create_dataset("shapes", (n, p, 3), "f8", chunks=(1, 1, 3))
            for name, shape in further.items():
                chunks = (100,) * len(shape)
                file.create_dataset(name, shape, "f8", chunks=chunks)
            if n == 1:
                file["item"][0] = b"a"
        assert path.stat().st_size < 50_000
        return path

    return make


def test_values_that_were_never_written_are_the_fill_value(tmp_path, monkeypatch):
    """HDF5 itself would go through the eight million chunks, by 14 GB of memory."""
    path = tmp_path / "unwritten.h5"
    with h5py.File(path, "w") as file:
        file.create_dataset("x", (10**6, 4, 2), "f8", chunks=(1, 1, 1), fillvalue=3.0)
    with Hdf5File(path) as file:
        monkeypatch.setattr(h5py.Dataset, "__getitem__", None)
        rows = file.read_rows("x", slice(2, 5))
    assert rows.shape == (3, 4, 2)
    assert (rows == 3).all()


def write_texts(file: h5py.File, name: str, size: int) -> None:
    """Write so many texts, all of them the fill value."""
    chunks = (10_000,) if size > 1 else None
    file.create_dataset(name, (size,), "S1", chunks=chunks, fillvalue=b"a")


TOO_LARGE = [
    ({"p": MANY}, "landmark_names", "B of memory, and "),
    ({"further": (MANY, 100)}, "further", "B of memory, and "),
    ({"further": (10**5, 100)}, "further", ": of its 80 MB the file holds 0 bytes; "),
    ({"n": MANY}, "item", " the file holds 0 bytes; "),
]
"""Sizes of a sparse file, the dataset that is told, and what is said of it."""


@pytest.mark.parametrize(("sizes", "place", "fault"), TOO_LARGE)
def test_a_file_of_some_kilobytes_that_would_take_more(
    sparse, problems, sizes, place, fault
):
    path = sparse(**sizes)
    (line,) = problems(read_shapes, [path])
    assert line.startswith(f"{path}:/{place}: ")
    assert fault in line


@pytest.mark.parametrize("kind", ["shapes", "dictionary", "results"])
def test_the_limit_is_what_is_free(request, problems, monkeypatch, kind):
    path = request.getfixturevalue(f"{kind.removesuffix('s')}_file")
    read = READERS[kind]
    monkeypatch.setattr(inputs, "ALWAYS_FITS", 0)
    monkeypatch.setattr(inputs, "free_memory", lambda: 10**5)
    read(path)
    monkeypatch.setattr(inputs, "free_memory", lambda: 10)
    (line,) = problems(read, path)
    assert line.startswith(f"{path}:/")
    assert "and 10 bytes are free; " in line

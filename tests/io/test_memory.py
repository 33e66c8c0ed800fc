"""What does not fit in memory, or in its file, is refused by name before it is asked for."""

import h5py
import numpy as np
import pytest

from shapefit.io import inputs, open_landmarks, read_dictionary, read_results, read_shapes

MANY = 10**11


@pytest.fixture
def sparse(tmp_path):
    """Make a file of shapes of some kB whose datasets, all fill values, are of these sizes."""

    def make(n=1, p=1, **further):
        path = tmp_path / "sparse.h5"
        with h5py.File(path, "w") as file:
            file.attrs.update({"format": "shapefit-shapes", "version": 1})
            for name, size in (("landmark_names", p), ("item", n)):
                chunks = (10_000,) if size > 1 else None
                file.create_dataset(name, (size,), "S1", chunks=chunks, fillvalue=b"a")
            file.create_dataset("shapes", (n, p, 3), "f8", chunks=(1, 1, 3))
            for name, shape in further.items():
                file.create_dataset(name, shape, "f8", chunks=(100,) * len(shape))
            if n == 1:
                file["item"][0] = b"a"
        assert path.stat().st_size < 50_000
        return path

    return make


@pytest.mark.parametrize(
    ("sizes", "place", "found"),
    [
        ({"p": MANY}, "landmark_names", "B of memory, and this machine has "),
        ({"further": (MANY, 100)}, "further", "B of memory, and this machine has "),
        ({"further": (10**5, 100)}, "further", ": of its 80 MB the file holds 0 bytes; "),
        ({"n": MANY}, "item", " the file holds 0 bytes; "),
    ],
)
def test_a_file_of_some_kilobytes_that_would_take_more(sparse, problems, sizes, place, found):
    path = sparse(**sizes)
    (line,) = problems(read_shapes, [path])
    assert line.startswith(f"{path}:/{place}: ")
    assert found in line


def test_the_limit_is_what_is_free(shape_file, dictionary_file, result_file, problems, monkeypatch):
    monkeypatch.setattr(inputs, "ALWAYS_FITS", 0)
    readers = (lambda path: read_shapes([path]), read_dictionary, read_results)
    for read, path in zip(readers, (shape_file, dictionary_file, result_file), strict=True):
        monkeypatch.setattr(inputs, "machine_memory", lambda: 10**5)
        read(path)
        monkeypatch.setattr(inputs, "machine_memory", lambda: 10)
        (line,) = problems(read, path)
        assert line.startswith(f"{path}:/")
        assert "and this machine has 10 bytes; " in line


def test_a_table_whose_rows_share_nothing(tmp_path, problems, monkeypatch):
    path = tmp_path / "diagonal.csv"
    rows = (f"item {row},landmark {row},0,0" for row in range(6_000))
    path.write_text("\n".join(["item,landmark,x,y", *rows]) + "\n")
    monkeypatch.setattr(inputs, "machine_memory", lambda: 10**8)
    (line,) = problems(open_landmarks, [path])
    assert line.startswith(f"{path}: it takes ")
    assert line.endswith(
        "this machine has 100 MB; divide the file, or use a machine with more memory"
    )


LARGE = 100 << 20


def landmark_file(path, **further):
    """Write three images, and what is beside them as datasets with gzip."""
    with h5py.File(path, "w") as file:
        file.attrs.update({"format": "shapefit-landmarks", "version": 1, "y_axis": "down"})
        file["landmark_names"], file["item"] = [b"a", b"b", b"c", b"d"], [b"x", b"y", b"z"]
        landmarks = np.arange(24.0).reshape(3, 4, 2) * 10
        file.create_dataset("landmarks", data=landmarks, chunks=(3, 4, 2), compression="gzip")
        for name, values in further.items():
            file.create_dataset(name, data=values, chunks=values.shape, compression="gzip")
    return path


def test_large_chunks_that_hold_what_they_declare_are_read(tmp_path, rng):
    noise = np.frombuffer(rng.bytes(100_000), np.uint8)
    with open_landmarks([landmark_file(tmp_path / "wide.h5", noise=noise)]) as source:
        found = source.whole()
    np.testing.assert_array_equal(found.whole["noise"], noise)
    assert found.landmarks[2, 1, 3] == 230

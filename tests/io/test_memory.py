"""What does not fit in memory: refused by name before it is asked for."""

import re

import h5py
import numpy as np
import pytest

from shapefit.io import (
    hdf5_records,
    memory,
    open_landmarks,
    open_shapes,
    read_dictionary,
    read_results,
    read_shapes,
    write_shapes,
)
from shapefit.io.hdf5_records import Hdf5Reader
from shapefit.io.layout import SHAPES
from shapefit.io.records import ShapeSet

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
    ("sizes", "dataset"),
    [({"p": MANY}, "landmark_names"), ({"further": (MANY, 100)}, "further")],
)
def test_a_file_of_some_kilobytes_that_would_take_terabytes(sparse, problems, sizes, dataset):
    path = sparse(**sizes)
    (line,) = problems(read_shapes, [path])
    assert line.startswith(f"{path}:/{dataset}: ")
    assert "B of memory, and " in line
    assert line.endswith("; divide the file, or use a machine with more memory")


def test_the_sum_of_the_datasets_counts(sparse, problems):
    path = sparse(n=MANY)
    with Hdf5Reader(path, SHAPES) as reader:
        (line,) = problems(reader.fields)
    assert line.startswith(f"{path}:/item: with the other datasets it takes 14.8 TB of memory")


@pytest.mark.parametrize("free", [10**5, 10**9])
def test_the_limit_is_what_is_free(
    shape_file, dictionary_file, result_file, problems, monkeypatch, free
):
    monkeypatch.setattr(memory, "ALWAYS_FITS", 0)
    monkeypatch.setattr(memory, "free_memory", lambda: free)
    readers = (lambda path: read_shapes([path]), read_dictionary, read_results)
    for read, path in zip(readers, (shape_file, dictionary_file, result_file), strict=True):
        read(path)
    monkeypatch.setattr(memory, "free_memory", lambda: 10)
    for read, path in zip(readers, (shape_file, dictionary_file, result_file), strict=True):
        (line,) = problems(read, path)
        assert line.startswith(f"{path}:/")
        assert "and 10 bytes are free; " in line


def test_shapes_can_be_read_in_chunks_where_they_do_not_fit_as_a_whole(
    tmp_path, problems, monkeypatch
):
    items = tuple(map(str, range(2000)))
    many = ShapeSet(np.zeros((2000, 3, 4)), tuple("abcd"), items)
    write_shapes(tmp_path / "many.h5", many)
    monkeypatch.setattr(memory, "ALWAYS_FITS", 0)
    monkeypatch.setattr(memory, "free_memory", lambda: 300_000)
    problems(read_shapes, [tmp_path / "many.h5"])
    monkeypatch.setattr(hdf5_records, "BLOCK_BYTES", 10_000)
    with open_shapes([tmp_path / "many.h5"]) as source:
        assert sum(map(len, source.batches(100))) == 2000


def test_a_check_reads_as_many_rows_as_fit_in_a_block(tmp_path, monkeypatch):
    rows, row_bytes = 3000, 192
    write_shapes(
        tmp_path / "many.h5",
        ShapeSet(np.zeros((rows, 3, 4)), tuple("abcd"), tuple(map(str, range(rows)))),
    )
    monkeypatch.setattr(hdf5_records, "BLOCK_BYTES", 400_000)
    with Hdf5Reader(tmp_path / "many.h5", SHAPES) as file:
        sizes = [len(block) for block in file.read_blocks("shapes")]
        part = [len(block) for block in file.read_blocks("shapes", slice(1000, 1500))]
        assert sum(sizes) == rows
        assert 1 < len(sizes) < 5
        assert sizes[0] * row_bytes <= 400_000
        assert part == [500]


def test_items_that_nobody_wrote_are_not_read_one_by_one(sparse, problems):
    path = sparse(n=MANY)
    assert problems(read_shapes, [path]) == (f"{path}:/item: was never written; name every item",)


def test_the_memory_that_is_free_is_known_here():
    assert memory.free_memory() > 10**7


def test_a_limit_of_the_process_counts(run_python):
    script = """
import resource
from shapefit.io.memory import free_memory
resource.setrlimit(resource.RLIMIT_AS, (2 << 30, 2 << 30))
print(0 < free_memory() < 2 << 30)
"""
    assert run_python(script).stdout == "True\n"


def test_a_limit_of_the_group_counts(tmp_path, monkeypatch):
    (tmp_path / "proc").mkdir()
    (tmp_path / "proc/cgroup").write_text("0::/job/1\n")
    (tmp_path / "groups/job/1").mkdir(parents=True)
    (tmp_path / "groups/job/1/memory.max").write_text("5000\n")
    (tmp_path / "groups/job/1/memory.current").write_text("2000\n")
    monkeypatch.setattr(memory, "PROCESS", tmp_path / "proc")
    monkeypatch.setattr(memory, "GROUPS", tmp_path / "groups")
    assert memory.free_memory() == 3000
    (tmp_path / "groups/job/1/memory.max").write_text("max\n")
    assert memory.free_memory() > 10**7


@pytest.mark.parametrize(
    ("size", "words"), [(10, "10 bytes"), (6.71e9, "6.71 GB"), (4e4, "40 kB"), (3e15, "3 PB")]
)
def test_sizes_in_words(size, words):
    assert memory.in_words(size) == words


def test_values_that_nobody_wrote_are_not_read(sparse, problems):
    path = sparse(further=(10**5, 100))
    (line,) = problems(read_shapes, [path])
    assert line == (
        f"{path}:/further: of its 80 MB the file holds 0 bytes; "
        "write its values, or make it smaller"
    )


@pytest.mark.parametrize("columns", ["item,landmark,x,y", "item,landmark,x,y,z,sequence"])
def test_a_table_whose_rows_share_nothing(tmp_path, problems, monkeypatch, columns):
    path = tmp_path / "diagonal.csv"
    cells = ",".join("0" * (columns.count(",") - 1))
    rows = (f"item {row},landmark {row},{cells}" for row in range(6_000))
    path.write_text("\n".join([columns, *rows]) + "\n")
    monkeypatch.setattr(memory, "free_memory", lambda: 10**8)
    (line,) = problems(read_shapes if "z" in columns else open_landmarks, [path])
    found = re.fullmatch(
        rf"{path}: a table of (\d+) items and (\d+) landmarks takes [0-9.]+ [MG]B of memory, and "
        "100 MB are free; divide the file, or use a machine with more memory",
        line,
    )
    assert found
    assert found[1] == found[2]
    assert int(found[1]) < 6_000  # not read to its end


def test_a_long_table_is_not_taken_for_a_wide_one(tmp_path, monkeypatch):
    path = tmp_path / "long.csv"
    rows = (f"item {row // 2},{'ab'[row % 2]},1,2" for row in range(20_000))
    path.write_text("\n".join(["item,landmark,x,y", *rows]) + "\n")
    monkeypatch.setattr(memory, "ALWAYS_FITS", 0)
    monkeypatch.setattr(memory, "free_memory", lambda: 2 * 10**6)
    with open_landmarks([path]) as source:
        assert source.count == 10_000
